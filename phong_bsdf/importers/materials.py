"""MTL materials -> BSDFs, as the MTL specification has it: the table of `illum`, transparency, maps.

The specification's sum over the lights, Kd n.l + Ks (n.h)^Ns, is what `blinnphong` with `kd`, `ks`, `p` shows
in `whitted`. What the table adds to that: nothing (1, 2), a mirror of strength Ks (3, 8), a mirror with Fresnel's
equations (5), glass (4, 6, 7, 9). 0 is a constant colour.
"""

from dataclasses import dataclass

from ..reflection.vocabulary import VOCABULARIES
from .maps import Maps
from .mtl import Material
from .records import Journal
from .values import refraction, set_color
from .xmlfile import Node

# What the specification leaves open.
DEFAULTS = {"kd": (0.8, 0.8, 0.8), "ks": (0.0, 0.0, 0.0), "tf": (1.0, 1.0, 1.0)}
EXPONENT, INDEX = 30.0, 1.5

# `whitted` adds ambient x diffuse reflectance at every hit. A surface of a constant colour is one that no light
# reaches, and that reflects its colour / AMBIENT; what the others get by it, no picture shows.
AMBIENT = 1e-6

# Of a perfect mirror this much is left for the surface under it, which is divided by what is left.
STRONGEST_MIRROR = 0.99

MIRRORS, GLASS, FRESNEL = (3, 8), (4, 6, 7, 9), 5
WITHOUT_RAYS = (8, 9)


@dataclass
class Materials:
    """Makes the BSDFs of one model."""

    vocabulary: str
    maps: Maps
    journal: Journal
    glows: bool = False
    """Whether a BSDF was made that needs `whitted`'s ambient light to be AMBIENT."""

    def default(self, line_of: Node, name: str) -> Node:
        """The BSDF of triangles whose material is unknown, or that have none."""
        bsdf = line_of.like("bsdf", type="twosided", id=name)
        self._lobe(bsdf, None, 1.0, shiny=False)
        return bsdf

    def bsdf(self, material: Material, place: Node, name: str) -> Node:
        """The BSDF of a material."""
        illum = self._illum(material)
        if "ka" in material.values and max(material.values["ka"]) > 0:
            self.journal.loss(
                material.place("ka"), f"Ka of '{material.name}'",
                "there is no ambient light; the parameter 'ambient' of 'whitted' adds ambient x Kd everywhere",
            )  # fmt: skip
        if "ka" in material.maps:
            self.journal.loss(material.place("map ka"), f"map_Ka of '{material.name}'", "there is no ambient light")
        made = place.like("bsdf", type="twosided", id=name)
        if illum in GLASS:
            made.set("type", "dielectric")
            self._glass(made, material, illum)
            return made
        inside = self._bumps(made, material)
        if illum == 0:
            self._glow(inside, material, "kd")
        elif illum == FRESNEL:
            self._fresnel(inside, material)
        elif illum in MIRRORS:
            self._mirror(inside, material)
        else:
            self._lit(inside, material, shiny=illum != 1)
        return self._dissolve(made, material, name)

    def _illum(self, material: Material) -> int:
        shiny = max(material.values.get("ks", (0.0,))) > 0 or "ks" in material.maps
        given = material.values.get("illum")
        if given is None:
            return 2 if shiny else 1
        if given[0] not in range(11):
            self.journal.loss(
                material.place("illum"), f"illum {given[0]:g} of '{material.name}'", "it should be 0 to 10; taken as 2"
            )
            return 2
        if given[0] == 10:
            self.journal.loss(
                material.place("illum"), f"illum 10 of '{material.name}'", "shadows cast onto nothing; taken as 1"
            )
            return 1
        if given[0] in WITHOUT_RAYS:
            why = "reflections without ray tracing; the scene is reflected"
            self.journal.change(material.place("illum"), f"illum {given[0]:g} of '{material.name}'", why)
        return int(given[0])

    # Surfaces ---------------------------------------------------------------------------------------------

    def _lobe(self, parent: Node, material: Material | None, gain: float | list[float], shiny: bool = True) -> Node:
        """`blinnphong`, all of it times `gain`."""
        made = parent.add("bsdf", type="blinnphong")
        kd, ks, p = VOCABULARIES[self.vocabulary]
        if material is None:
            set_color(made.add("rgb", name=kd), list(DEFAULTS["kd"]))
            made.add("float", name=ks, value="0")
            return made
        made.append(self.maps.color(material, "kd", kd, DEFAULTS["kd"], gain, made))
        if not shiny:
            made.add("float", name=ks, value="0")
            return made
        made.append(self.maps.color(material, "ks", ks, DEFAULTS["ks"], gain, made))
        exponent = material.values.get("ns")
        if exponent is None and self._is_shiny(material):
            self.journal.change(
                material.place(), f"'{material.name}' without Ns", f"its exponent is taken as {EXPONENT:g}"
            )
        value = max(exponent[0], 0.0) if exponent else EXPONENT
        made.append(self.maps.number(material, "ns", p, value, made))
        return made

    def _specular(self, material: Material) -> tuple[float, ...]:
        # A map of the highlight's colour without a colour means white.
        return (1.0, 1.0, 1.0) if "ks" in material.maps else DEFAULTS["ks"]

    def _is_shiny(self, material: Material) -> bool:
        return max(material.values.get("ks", self._specular(material))) > 0

    def _lit(self, parent: Node, material: Material, shiny: bool) -> None:
        """The sum over the lights, and what the surface emits."""
        emitted = material.values.get("ke", (1.0, 1.0, 1.0) if "ke" in material.maps else (0.0,))
        if max(emitted) == 0:
            self._lobe(parent, material, 1.0, shiny)
        elif self.vocabulary == "coefficients":
            blend = parent.add("bsdf", type="blendbsdf")
            blend.add("float", name="weight", value="0.5")
            self._lobe(blend, material, 2.0, shiny)
            self._glow(blend, material, "ke", 2.0)
        else:
            self.journal.loss(
                material.place("ke"), f"Ke of '{material.name}'",
                "a surface that emits and reflects needs --vocabulary coefficients; only what it reflects is left",
            )  # fmt: skip
            self._lobe(parent, material, 1.0, shiny)

    def _glow(self, parent: Node, material: Material, name: str, gain: float = 1.0) -> None:
        """A constant colour: the shading normal points into the surface, so that no light reaches it."""
        self.glows = True
        turned = parent.add("bsdf", type="normalmap")
        turned.add("rgb", name="normalmap", value="0.5, 0.5, 0")
        made = turned.add("bsdf", type="blinnphong")
        default = DEFAULTS["kd"] if name == "kd" else (1.0, 1.0, 1.0)
        made.append(self.maps.color(material, name, "kd", default, gain / AMBIENT, made))
        made.add("float", name="ks", value="0")
        self.journal.change(
            material.place("illum" if name == "kd" else "ke"),
            f"'{material.name}' shows a colour that no light changes",
            "only the ambient light of 'whitted' reaches it; other integrators show it black, and it lights nothing",
        )  # fmt: skip

    def _mirror(self, parent: Node, material: Material) -> None:
        """Ks times what the mirror direction sees, besides the sum over the lights, which is not diminished."""
        km = parent.add("bsdf", type="mirrorblend")
        strength = material.values.get("ks", self._specular(material))
        if "ks" in material.maps:
            self.journal.loss(
                material.place("map ks"),
                f"mirror '{material.name}' with map_Ks",
                "its lit part is diminished by the mirror",
            )
            km.append(self.maps.color(material, "ks", "km", DEFAULTS["ks"], 1.0, km, upper=1.0))
            self._lit(km, material, shiny=True)
            return
        limited = [min(max(s, 0.0), STRONGEST_MIRROR) for s in strength]
        if max(strength) > STRONGEST_MIRROR:
            self.journal.change(
                material.place("ks"),
                f"mirror '{material.name}' of strength {max(strength):g}",
                f"now {STRONGEST_MIRROR}",
            )
        set_color(km.add("rgb", name="km"), limited)
        if self.vocabulary == "reflectances":
            self._lit(km, material, shiny=True)
            return
        gain = [1 / (1 - s) for s in limited]
        if "ke" in material.values and max(material.values["ke"]) > 0:
            self.journal.loss(material.place("ke"), f"Ke of '{material.name}'", "left out: it is a mirror")
        self._lobe(km, material, gain if len(set(gain)) > 1 else gain[0])

    def _fresnel(self, parent: Node, material: Material) -> None:
        """illum 5: Ks is the reflectance at normal incidence."""
        strength = material.values.get("ks", self._specular(material))
        indices = [refraction(s) for s in strength]
        black = max(material.values.get("kd", DEFAULTS["kd"])) == 0 and "kd" not in material.maps
        why = "its highlights of the lights are left out: a mirror of points has none"
        if black:
            made = parent.add("bsdf", type="conductor")
            set_color(made.add("rgb", name="eta"), indices)
            made.add("float", name="k", value="0")
            self.journal.loss(material.place("illum"), f"illum 5 of '{material.name}' is now 'conductor'", why)
            return
        made = parent.add("bsdf", type="plastic")
        made.append(self.maps.color(material, "kd", "diffuse_reflectance", DEFAULTS["kd"], 1.0, made, upper=1.0))
        index = self._index(material) if material.values.get("ni", (1.0,))[0] > 1 else sum(indices) / 3
        made.add("float", name="int_ior", value=f"{max(index, 1.0001):.7g}")
        self.journal.loss(
            material.place("illum"), f"illum 5 of '{material.name}' is now 'plastic'",
            f"{why}; its diffuse part loses what is reflected",
        )  # fmt: skip

    def _glass(self, made: Node, material: Material, illum: int) -> None:
        """`dielectric`: Fresnel's equations, always."""
        made.add("float", name="int_ior", value=f"{self._index(material):.7g}")
        made.append(self.maps.color(material, "tf", "specular_transmittance", DEFAULTS["tf"], 1.0, made, upper=1.0))
        if max(material.values.get("ks", (0.0,))) > 0:
            made.append(self.maps.color(material, "ks", "specular_reflectance", DEFAULTS["ks"], 1.0, made, upper=1.0))
        why = "Kd and the highlights of the lights are left out"
        if illum == 6:
            why += "; reflection follows Fresnel's equations, which 6 would leave out"
        self.journal.loss(material.place("illum"), f"illum {illum} of '{material.name}' is now 'dielectric'", why)
        if self._opacity(material) < 1 or "d" in material.maps:
            self.journal.change(material.place("d"), f"opacity of '{material.name}'", "left out: glass is transparent")

    def _index(self, material: Material) -> float:
        given = material.values.get("ni")
        if given is None or not 0.001 <= given[0] <= 100:
            self.journal.change(
                material.place("ni"), f"'{material.name}' without a usable Ni", f"its index is taken as {INDEX:g}"
            )
            return INDEX
        return given[0]

    # Around the surface -----------------------------------------------------------------------------------

    def _bumps(self, parent: Node, material: Material) -> Node:
        """Bump and normal maps: the innermost of them, into which the surface goes."""
        for name, plugin in (("norm", "normalmap"), ("bump", "bumpmap")):
            texture = self.maps.bumps(material, name, parent)
            if texture is None:
                continue
            parent = parent.add("bsdf", type=plugin)
            texture.set("name", "normalmap" if name == "norm" else "bumps")
            parent.append(texture)
            if name == "bump":
                parent.add("float", name="scale", value=f"{material.maps[name].numbers('-bm', (1.0,))[0]:.7g}")
        return parent

    def _opacity(self, material: Material) -> float:
        d, tr = material.values.get("d"), material.values.get("tr")
        if d and tr and abs(d[0] - (1 - tr[0])) > 1e-3:
            self.journal.loss(
                material.place("tr"),
                f"'{material.name}' with d {d[0]:g} and Tr {tr[0]:g}",
                "they disagree (Tr = 1 - d); d counts",
            )
        return min(max(d[0] if d else 1 - tr[0] if tr else 1.0, 0.0), 1.0)

    def _dissolve(self, made: Node, material: Material, name: str) -> Node:
        opacity = self._opacity(material)
        if opacity == 1 and "d" not in material.maps:
            return made
        mask = made.like("bsdf", type="mask", id=name)
        del made.attrib["id"]
        mask.append(self.maps.number(material, "d", "opacity", opacity, mask, upper=1.0))
        mask.append(made)
        return mask
