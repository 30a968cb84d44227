"""Which of Mitsuba's BSDFs looks like a cosine-power lobe: the same roughness, the same energy.

Roughness: Phong's lobe becomes the Blinn-Phong lobe closest to it, of exponent p' (`blinn_exponent`), and that the
microfacet surface of roughness alpha = sqrt(2 / (p' + 2)). Energy: the specular albedo at normal incidence is the
lobe's own, measured on the target itself. `match` says in notes where a target cannot follow.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np

# What `--against` knows.
TARGETS = ("roughplastic", "roughconductor", "principled", "diffuse")

# Mitsuba's default for roughplastic: polypropylene.
USUAL_IOR = 1.49
# Beyond this (diamond has 2.4) a dielectric is none, and too little light reaches the diffuse base.
LARGEST_IOR = 3.0


@dataclass(frozen=True)
class Lobe:
    """A diffuse base and one cosine-power lobe, in the vocabulary of the scene; textures as their means."""

    plugin: str
    """`phong` or `blinnphong`."""
    diffuse: tuple[float, float, float]
    specular: tuple[float, float, float]
    exponent: float
    reflectances: bool = False
    """Whether the scales are reflectances (`diffuse_reflectance`, ...), not coefficients (`kd`, ...)."""

    @property
    def unit_albedo(self) -> float:
        """Specular albedo at normal incidence where the specular scale is 1."""
        p = self.exponent
        if self.reflectances:
            return 1.0
        return 2 / (p + 1) if self.plugin == "phong" else 8 * (1 - 2 ** (-p / 2 - 1)) / (p + 2)

    @property
    def blinn_exponent(self) -> float:
        """The exponent of the Blinn-Phong lobe that is closest to this one."""
        return blinn_exponent(self.exponent) if self.plugin == "phong" else self.exponent

    @property
    def alpha(self) -> float:
        """Microfacet roughness."""
        return roughness(self.blinn_exponent)


@dataclass(frozen=True)
class Carried:
    """A parameter that the target takes from the original as it stands, texture or not."""

    scale: str
    """`diffuse` or `specular`."""


@dataclass(frozen=True)
class Match:
    """A target's parameters, in the order to show them, and what they fail to match."""

    plugin: str
    parameters: dict[str, object]
    """Numbers, colours (tuples), words, or `Carried`."""
    notes: tuple[str, ...] = ()


def roughness(exponent: float) -> float:
    """Roughness alpha of the microfacets, Beckmann's, whose highlight looks like a Blinn-Phong lobe."""
    return math.sqrt(2 / (exponent + 2))


@cache
def blinn_exponent(p: float) -> float:
    """The p' for which cos(theta/2)^p' is closest, in least squares over the hemisphere, to Phong's cos(theta)^p.

    Theta is the angle of the outgoing direction to the normal, which at normal incidence is also the lobe's axis.
    p' is about 4 p for narrow lobes and up to 8 p for wide ones.
    """
    if p == 0:
        return 0.0
    # Gauss-Legendre nodes over the part of the hemisphere where either lobe is above e^-32.
    nodes, weights = np.polynomial.legendre.leggauss(200)
    end = min(math.pi / 2, 8 / math.sqrt(p))
    theta = end * (nodes + 1) / 2
    weights = weights * np.sin(theta)
    log_cos = [0.5 * np.log1p(-(np.sin(angle) ** 2)) for angle in (theta, theta / 2)]
    phong = np.exp(p * log_cos[0])

    def distance(log_ratio: float) -> float:
        return float(weights @ (phong - np.exp(p * math.exp(log_ratio) * log_cos[1])) ** 2)

    return p * math.exp(_minimum(distance, math.log(0.5), math.log(50)))


def match(
    plugin: str,
    lobe: Lobe,
    specular_albedo: Callable[[dict], float],
    given: Mapping[str, object] | None = None,
    textured: bool = False,
) -> Match:
    """The parameters of `plugin` that match `lobe`; those in `given` stay as they are.

    `specular_albedo` measures a BSDF, described as `mitsuba.load_dict` takes it, at normal
    incidence. `textured`: the specular scale is a texture.
    """
    if max(lobe.specular) == 0 and not textured and not given:
        return _with_base("diffuse", "reflectance", {}, lobe, {}, ["no highlight to match: became diffuse"])
    return _MATCHES[plugin](lobe, specular_albedo, dict(given or {}), textured)


def _roughplastic(lobe, specular_albedo, given, textured):
    parameters = {"distribution": "beckmann", "alpha": lobe.alpha, "int_ior": USUAL_IOR, **given}
    black = {"type": "roughplastic", "diffuse_reflectance": 0.0, **without(parameters, "specular_reflectance")}
    # A texture is carried over and cannot be scaled: the rest has to come from the index of refraction.
    wanted = lobe.unit_albedo * (1 if textured else max(lobe.specular))
    reached, notes = specular_albedo(black), []
    if "int_ior" not in given and (textured or wanted > reached):
        ior, reached = _ior(wanted, lambda ior: specular_albedo({**black, "int_ior": ior}))
        parameters["int_ior"] = black["int_ior"] = ior
        if ior > USUAL_IOR:
            notes.append(f"int_ior raised to {ior:.3g}: at {USUAL_IOR} the highlight cannot be as strong")
    if "specular_reflectance" not in given:
        if textured:
            parameters["specular_reflectance"] = Carried("specular")
            if wanted > reached * 1.001:
                notes.append(_too_weak(wanted, reached))
        else:
            parameters["specular_reflectance"] = _scaled(lobe, reached, notes)
    return _with_base("roughplastic", "diffuse_reflectance", parameters, lobe, given, notes)


def _roughconductor(lobe, specular_albedo, given, textured):
    parameters = {"distribution": "beckmann", "alpha": lobe.alpha, **given}
    if not {"material", "eta", "k"} & set(given):
        parameters["material"] = "none"
    notes = ["has no diffuse part: the lobe's is lost"] if max(lobe.diffuse) > 0 else []
    if "specular_reflectance" not in given:
        reached = specular_albedo({"type": "roughconductor", **parameters})
        parameters["specular_reflectance"] = _scaled(lobe, reached, notes)
        if textured:
            notes.append("the specular texture became its mean colour")
    return Match("roughconductor", parameters, tuple(notes))


def _principled(lobe, specular_albedo, given, textured):
    parameters = {"roughness": math.sqrt(lobe.alpha), **given}
    notes = []
    if not {"eta", "specular"} & set(given):
        black = {"type": "principled", **without(parameters, "base_color"), "base_color": 0.0}
        wanted = lobe.unit_albedo * sum(lobe.specular) / 3
        parameters["eta"], reached = _ior(wanted, lambda ior: specular_albedo({**black, "eta": ior}))
        if wanted > reached * 1.001:
            notes.append(_too_weak(wanted, reached))
    if textured or len(set(lobe.specular)) > 1:
        notes.append(f"its highlight is white: the specular {'texture' if textured else 'colour'} became its mean")
    notes.append("its microfacets are GGX, not Beckmann: a longer tail at the same alpha")
    return _with_base("principled", "base_color", parameters, lobe, given, notes)


def _diffuse(lobe, specular_albedo, given, textured):
    return _with_base("diffuse", "reflectance", given, lobe, given, ["has no highlight"])


_MATCHES = {
    "roughplastic": _roughplastic, "roughconductor": _roughconductor, "principled": _principled, "diffuse": _diffuse,
}  # fmt: skip


def _with_base(plugin, name, parameters, lobe, given, notes):
    """The match, with the diffuse part under the parameter `name`."""
    if name in given:
        return Match(plugin, parameters, tuple(notes))
    base = Carried("diffuse")
    if max(lobe.diffuse) > 1:
        base = tuple(min(x, 1.0) for x in lobe.diffuse)
        notes = [*notes, f"diffuse scale {max(lobe.diffuse):.3g} clamped to 1: a reflectance cannot be larger"]
    return Match(plugin, {name: base, **parameters}, tuple(notes))


def _scaled(lobe, reached, notes):
    """The specular reflectance that scales a target of albedo `reached` to the lobe's; notes where it is clamped."""
    wanted = [lobe.unit_albedo * x for x in lobe.specular]
    if max(wanted) > reached * 1.001:
        notes.append(_too_weak(max(wanted), reached))
    return tuple(min(x / reached, 1.0) if reached > 0 else 0.0 for x in wanted)


def _too_weak(wanted, reached):
    return f"the highlight is weaker than the lobe's: albedo {reached:.3g} at normal incidence, not {wanted:.3g}"


def _ior(wanted, albedo_at):
    """The index of refraction, at most LARGEST_IOR, of specular albedo `wanted`, and the albedo it has."""
    ior, reached = USUAL_IOR, albedo_at(USUAL_IOR)
    # The albedo is almost proportional to the reflectance at normal incidence: a few steps settle it.
    for _ in range(3):
        f0 = min(((ior - 1) / (ior + 1)) ** 2 * wanted / reached, 0.99) if reached > 0 else 0.0
        ior = min((1 + math.sqrt(f0)) / (1 - math.sqrt(f0)), LARGEST_IOR)
        reached = albedo_at(ior)
    return ior, reached


def without(parameters: Mapping[str, object], *names: str) -> dict[str, object]:
    """The parameters but for some."""
    return {name: value for name, value in parameters.items() if name not in names}


def _minimum(f: Callable[[float], float], low: float, high: float) -> float:
    """Where a function with one valley is smallest: golden section."""
    golden = (math.sqrt(5) - 1) / 2
    left, right = high - golden * (high - low), low + golden * (high - low)
    f_left, f_right = f(left), f(right)
    while high - low > 1e-9:
        if f_left < f_right:
            high, right, f_right = right, left, f_left
            left = high - golden * (high - low)
            f_left = f(left)
        else:
            low, left, f_left = left, right, f_right
            right = low + golden * (high - low)
            f_right = f(right)
    return (low + high) / 2
