"""What a surface reflects, from arrays, where all materials are this package's BSDFs.

Through Mitsuba a kernel holds, and each hit dispatches to, every BSDF of the scene. Constants
need none of that: they are gathered once for each hit, and the formulas stand in the loop.
Textures are called once for each hit, too.
The answers are those of `dispatch.py`, by the same operations in the same order.
"""

import itertools
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..reflection import lobes
from ..reflection.parameters import Watch
from .needs import has_instances
from .spawn import shape_numbers

# Each BSDF that can describe itself has another, for as long as the process lives.
SERIALS = itertools.count()


@dataclass(frozen=True)
class Material:
    """The constants of one BSDF."""

    model: tuple
    """(name of the lobe, whether it is in the vocabulary of reflectances)."""
    diffuse: tuple
    specular: tuple
    exponent: tuple
    scale: tuple
    """The energy rule's factor."""
    km: tuple
    """0 where there is no `mirrorblend`."""
    textures: tuple = ()
    """(name of the field, `Parameter`) of those that vary; their place above holds 0."""


def is_isotropic(scene) -> bool:
    """Whether all BSDFs are this package's, which reflect alike whatever frame there is about the normal."""
    own = all(getattr(shape.bsdf(), "serial", None) is not None for shape in scene.shapes())
    return own and not has_instances(scene)


class Table:
    """The constants of all shapes of the scene that was rendered last."""

    def __init__(self):
        self.serials, self.pointers, self.watch, self.materials, self.columns = None, None, None, None, {}

    def of(self, scene, keep=frozenset()):
        """`Materials` of `scene`; None where some BSDF is another, or is differentiated or recorded."""
        if mi.is_spectral or mi.is_polarized or not dr.is_jit_v(mi.Float) or dr.flag(dr.JitFlag.FreezingScope):
            return None
        shapes = scene.shapes()
        bsdfs = [shape.bsdf() for shape in shapes]
        serials = [getattr(bsdf, "serial", None) for bsdf in bsdfs]
        if not shapes or None in serials:
            return None
        # Scenes may share BSDFs, but their shapes have other numbers. While the array is kept, no other has its index.
        pointers = scene.shapes_dr()
        if serials != self.serials or pointers.index != self.pointers.index or self.watch.changed():
            self.pointers = pointers
            self._look(scene, bsdfs, serials)
        if self.materials is None:
            return None
        if keep not in self.columns:
            self.columns[keep] = Materials(scene, self.materials, keep)
        return self.columns[keep]

    def _look(self, scene, bsdfs, serials):
        self.serials, self.columns = serials, {}
        known = {bsdf.serial: bsdf for bsdf in bsdfs}
        self.watch = Watch([array for bsdf in known.values() for array in bsdf.arrays()])
        constants = {serial: bsdf.constants() for serial, bsdf in known.items()}
        whole = None not in constants.values() and not has_instances(scene)
        self.materials = [constants[serial] for serial in serials] if whole else None


class Materials:
    """The constants of all shapes. What is the same everywhere is not gathered; what is 0 everywhere is left out."""

    def __init__(self, scene, materials: list[Material], keep=frozenset()):
        self.models = sorted({material.model for material in materials})
        self.ids = shape_numbers(scene)
        self.gathers = "materials" in keep
        self.distinct = len(set(materials))
        self.several = self.distinct > 1 or self.gathers
        # What differs from shape to shape: a row of numbers for each, gathered in packets.
        self.rows = [[] for _ in materials]
        self.model = self._column([(self.models.index(m.model),) for m in materials])
        # The different sets of textures, and which of them a shape has; the first is none.
        self.textures = list(dict.fromkeys([(), *(m.textures for m in materials)]))
        self.varies = {name for textures in self.textures for name, _ in textures}
        self.which = self._column([(self.textures.index(m.textures),) for m in materials])
        self.diffuse, self.specular, self.exponent, self.km = (
            self._column([getattr(m, name) for m in materials], feature in keep or name in self.varies)
            for name, feature in zip(
                ("diffuse", "specular", "exponent", "km"),
                ("diffuse", "highlights", "highlights", "mirrors"),
                strict=True,
            )
        )
        scales = [m.scale for m in materials]
        self.scale = None if all(scale == (1.0,) for scale in scales) else self._column(scales)
        # How many packets of four numbers a row is.
        self.packets = -(-len(self.rows[0]) // 4)
        if self.packets:
            row_size = 4 * self.packets
            table = [0.0] * (row_size * (max(self.ids) + 1))
            for number, row in zip(self.ids, self.rows, strict=True):
                table[row_size * number : row_size * number + len(row)] = row
            self.table = mi.Float(table)

    def _column(self, values, keep=False):
        """For each channel: a number for all shapes, or its place in their rows; None where all are 0."""
        channels = max(map(len, values))
        values = [v if len(v) == channels else v * channels for v in values]
        if not keep and not any(map(any, values)):
            return None
        if all(len(set(v)) == 1 for v in values):
            values = [v[:1] for v in values]
        if len(set(values)) == 1 and not self.gathers:
            return [dr.opaque(mi.Float, x) for x in values[0]]
        first = len(self.rows[0])
        for row, value in zip(self.rows, values, strict=True):
            row += value
        return list(range(first, len(self.rows[0])))

    def at(self, si, active, front=None):
        """The constants of the material that was hit, for the other methods; None for what is 0 everywhere.

        `front`: the lanes on which the surface is seen from the front (None: where `si.wi` is above it).
        """
        first = dr.reinterpret_array(mi.UInt32, si.shape) * self.packets
        packets = [dr.gather(mi.Vector4f, self.table, first + i, active) for i in range(self.packets)]
        row = [number for packet in packets for number in packet]

        def read(column):
            if column is None:
                return None
            channels = [row[x] if isinstance(x, int) else x for x in column]
            return channels[0] if len(channels) == 1 else mi.Color3f(*channels)

        names = ("model", "diffuse", "specular", "exponent", "km", "scale")
        material = {name: read(getattr(self, name)) for name in names}
        material["front"] = mi.Frame3f.cos_theta(si.wi) > 0 if front is None else front
        if self.varies:
            constants = {name: _kind(name)(material[name]) for name in sorted(self.varies)}
            calls = [self._look_up(textures) for textures in self.textures]
            which = mi.UInt32(read(self.which))
            material |= dr.switch(which, calls, constants, si, active)
        return material

    @staticmethod
    def _look_up(textures):
        """A function that fills in the values of these textures."""

        def look_up(values, si, active):
            found = {n: (p.value_1 if n == "exponent" else p.value)(si, active) for n, p in textures}
            return {name: _kind(name)(found.get(name, value)) for name, value in values.items()}

        return look_up

    def eval(self, material, si, wo, last, active):
        """Smooth lobes, f cos(theta_o) toward `wo`; on the lanes `last` (None: on none) without the mirror."""
        cos_theta_o = mi.Frame3f.cos_theta(wo)
        active = active & material["front"] & (cos_theta_o > 0)
        lobe = factor = None
        if self.specular is not None:
            p = 0 if self.exponent is None else material["exponent"]
            lobe, factor = self._lobe(material, si.wi, wo, p)
        value = lobes.reflected(lobe, factor, cos_theta_o, material["diffuse"], material["specular"])
        value = value if self.scale is None else value * material["scale"]
        value = dr.select(active, value, 0)
        return mi.Spectrum(value * self._under_mirror(material, last))

    def _lobe(self, material, wi, wo, p):
        """The lobe, and what it is multiplied with where scales are reflectances."""
        names = {name for name, _ in self.models}
        if len(names) == 1:
            lobe = lobes.LOBES[next(iter(names))].value(wi, wo, p)
        else:
            lobe = lobes.either(self._where(material, lambda name, _: name == "phong"), wi, wo, p)
        factor = None
        for name in sorted(name for name, reflectances in self.models if reflectances):
            own = lobes.reflectance_factor(lobes.LOBES[name].normalization(p), mi.Frame3f.cos_theta(wo))
            here = self._where(material, lambda *model, name=name: model == (name, True))
            factor = dr.select(here, own, 1 if factor is None else factor)
        return lobe, factor

    def _where(self, material, condition):
        """The lanes whose model meets the condition."""
        found = mi.Mask(False)
        for i, model in enumerate(self.models):
            if condition(*model):
                found = found | (material["model"] == i) if len(self.models) > 1 else mi.Mask(True)
        return found

    def diffuse_reflectance(self, material, si, last, active):
        """Diffuse reflectance; `last` as in `eval`."""
        if self.diffuse is None:
            return mi.Spectrum(0)
        value = material["diffuse"] if self.scale is None else material["diffuse"] * material["scale"]
        return mi.Spectrum(value * self._under_mirror(material, last))

    def mirrors(self, material, si, active):
        """The mirrored ray: [(direction in world space, weight, lanes)]."""
        weight = dr.select(active & material["front"], material["km"], 0)
        return [(si.to_world(mi.reflect(si.wi)), mi.Spectrum(weight), active)]

    def _under_mirror(self, material, last):
        if material["km"] is None:
            return 1
        left = 1 - material["km"]
        return left if last is None else dr.select(last, 1, left)


def _kind(name):
    """The type of a parameter's values, constant or not."""
    return mi.Float if name == "exponent" else mi.UnpolarizedSpectrum
