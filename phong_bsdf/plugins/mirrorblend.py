"""BSDF `mirrorblend`: any BSDF, blended with a perfect mirror."""

from dataclasses import replace

import drjit as dr
import mitsuba as mi

from phong_bsdf.reflection import arguments
from phong_bsdf.reflection.parameters import FAINT, Parameter, is_recorded, mean, settling
from phong_bsdf.tracing.facing import toward_viewer
from phong_bsdf.tracing.materials import SERIALS
from phong_bsdf.tracing.needs import ALL_COMPONENTS, MIRRORLESS


class MirrorBlend(mi.BSDF):
    r"""The lecture's partially mirrored surface, around one nested BSDF.

        L = k_m L_r + (1 - k_m) L_nested,    L_r: what the mirror direction sees

    The nested BSDF is any plugin, native ones included. The mirror is on the sides that the
    nested BSDF has (`twosided` inside or outside: both).

    ====  ==============================  =========  =======  =============================
    name  type                            range      default  meaning
    ====  ==============================  =========  =======  =============================
    km    number, RGB, spectrum, texture  [0, 1]     0.5      mirrored part
    bsdf  BSDF                            exactly 1           the surface under the mirror
    ====  ==============================  =========  =======  =============================

    `km` is differentiable. Values of a texture outside the range are clamped to it. The
    delta lobe follows Mitsuba's `plastic`: the `pdf` of a mirror sample is the probability
    of choosing it, and `eval` and `pdf` leave the mirror out.

    XML::

        <bsdf type="mirrorblend">
            <float name="km" value="0.4"/>
            <bsdf type="blinnphong"/>
        </bsdf>

    Python::

        {"type": "mirrorblend", "km": 0.4, "nested": {"type": "blinnphong"}}
    """

    def __init__(self, props):
        super().__init__(props)
        self.km = Parameter(props, "km", 0.5, upper=1)
        nested = [value for value in _unnamed(props) if isinstance(value, mi.BSDF)]
        if len(nested) != 1:
            raise ValueError(f"mirrorblend: needs exactly one nested BSDF, got {len(nested)}")
        self.nested = nested[0]
        self.serial = None if getattr(self.nested, "serial", None) is None else next(SERIALS)
        self.unsettled, self.refused = self.km.unseen or getattr(self.nested, "unsettled", False), False
        self._find_components()

    def settle(self):
        """Before the first use: look at what the constructor could not. ValueError for a constant out of its range."""
        if not self.unsettled or (self.refused and is_recorded()):
            return
        with settling:
            self.refused = True
            self.km.settle()
            if hasattr(self.nested, "settle"):
                self.nested.settle()
            self.unsettled = False
            self._find_components()

    def traverse(self, cb):
        self.settle()
        cb.put("km", self.km.texture, mi.ParamFlags.Differentiable)
        cb.put("nested_bsdf", self.nested, mi.ParamFlags.Differentiable)

    def parameters_changed(self, keys):
        self.km.changed_by(keys)
        self._find_components()

    def _find_components(self):
        nested = [self.nested.flags(i) for i in range(self.nested.component_count())]
        self.both_sides = mi.has_flag(self.nested.flags(), mi.BSDFFlags.BackSide)
        self.nested_lobes = int(self.nested.flags()) & int(mi.BSDFFlags.All)
        self.mirrors = not self.km.left_out
        # Here Dr.Jit finds it when it freezes a function, and sees by the length whether it is left out.
        self.textures = [self.km.texture] * (1 if self.mirrors else 2)
        components = nested
        if self.mirrors:
            mirror = int(mi.BSDFFlags.DeltaReflection | mi.BSDFFlags.FrontSide) | MIRRORLESS
            if self.both_sides:
                mirror |= int(mi.BSDFFlags.BackSide)
            if self.km.varies:
                mirror |= int(mi.BSDFFlags.SpatiallyVarying)
            components = [mirror, *nested]
        self.m_components = components
        self.m_flags = 0
        for flags in components:
            self.m_flags |= flags

    def sample(self, ctx, si, sample1, sample2, active=True):
        sample1, sample2 = arguments.random_number(sample1), arguments.random_point(sample2)
        active = arguments.mask(active)
        mirror, nested_ctx = self._split(ctx)
        if not mirror and not nested_ctx:
            return dr.zeros(mi.BSDFSample3f), mi.Spectrum(0)
        if not mirror:
            bs, weight = self.nested.sample(nested_ctx, si, sample1, sample2, active)
            return self._shift(bs), weight * self._nested_scale(ctx, si, active)

        # The mirror: its pdf is the probability of choosing it.
        km = self.km.value(si, active)
        cos_theta_i = mi.Frame3f.cos_theta(si.wi)
        facing = active & ((cos_theta_i != 0) if self.both_sides else (cos_theta_i > 0))
        share = self._share(km) if nested_ctx else mi.Float(1)
        bs = dr.zeros(mi.BSDFSample3f)
        bs.wo = mi.reflect(toward_viewer(ctx, si))
        bs.eta = 1
        bs.pdf = dr.select(facing, share, 0)
        bs.sampled_type = mi.UInt32(int(mi.BSDFFlags.DeltaReflection))
        bs.sampled_component = mi.UInt32(0)
        weight = mi.depolarizer(dr.select(facing & (share > 0), km / dr.select(share > 0, share, 1), 0))
        if not nested_ctx:
            return bs, weight

        # Or the nested BSDF, with the rest of the random number.
        choose_mirror = sample1 < share
        rest = dr.select(share < 1, 1 - share, 1)
        nested, nested_weight = self.nested.sample(
            nested_ctx, si, (sample1 - share) / rest, sample2, active & (sample1 >= share)
        )
        nested = self._shift(nested)
        nested.pdf *= rest
        nested_weight = nested_weight * mi.Spectrum(self._rest(km) / rest)
        return dr.select(choose_mirror, bs, nested), dr.select(choose_mirror, weight, nested_weight)

    def eval(self, ctx, si, wo, active=True):
        wo, active = arguments.direction(wo), arguments.mask(active)
        nested_ctx = self._split(ctx)[1]
        if not nested_ctx:
            return mi.Spectrum(0)
        value = self.nested.eval(nested_ctx, si, wo, active)
        return value * self._nested_scale(ctx, si, active)

    def pdf(self, ctx, si, wo, active=True):
        wo, active = arguments.direction(wo), arguments.mask(active)
        mirror, nested_ctx = self._split(ctx)
        if not nested_ctx:
            return mi.Float(0)
        pdf = self.nested.pdf(nested_ctx, si, wo, active)
        return pdf * (1 - self._share(self.km.value(si, active))) if mirror else pdf

    def eval_pdf(self, ctx, si, wo, active=True):
        return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

    def eval_diffuse_reflectance(self, si, active=True):
        reflectance = mi.unpolarized_spectrum(self.nested.eval_diffuse_reflectance(si, active))
        return mi.Spectrum(reflectance * (1 - self.km.value(si, active)))

    def eval_null_transmission(self, si, active=True):
        transmission = mi.unpolarized_spectrum(self.nested.eval_null_transmission(si, active))
        return mi.Spectrum(transmission * self._rest(self.km.value(si, active)))

    def to_string(self):
        nested = str(self.nested).replace("\n", "\n  ")
        return f"MirrorBlend[\n  km = {self.km.texture},\n  nested_bsdf = {nested}\n]"

    def refresh(self):
        """Take in what has changed without a call of `parameters_changed`."""
        self.settle()
        if hasattr(self.nested, "refresh"):
            self.nested.refresh()
        if self.km.refresh():
            self.parameters_changed([])

    def constants(self):
        """What `phong_bsdf.tracing.materials` needs instead of this BSDF; None where a parameter is differentiated."""
        self.refresh()
        describe = getattr(self.nested, "constants", None)
        nested, km = describe() if describe else None, (0.0,) if self.km.varies else self.km.constant()
        # One mirror over another is no single material.
        if not nested or not km or self.km.differentiated or isinstance(self.nested, type(self)):
            return None
        return replace(nested, km=km, textures=nested.textures + (("km", self.km),) * self.km.varies)

    def arrays(self):
        """The arrays that hold the constants."""
        return [*self.km.arrays, *self.nested.arrays()]

    def _nested_scale(self, ctx, si, active):
        """What is left of the nested BSDF, as a factor that keeps polarization."""
        return mi.Spectrum(1 if ctx.type_mask & MIRRORLESS else self._rest(self.km.value(si, active)))

    def _rest(self, km):
        """What the mirror leaves to the nested BSDF."""
        return 1 - km + FAINT if self.km.differentiated else 1 - km

    def _split(self, ctx):
        """Whether the mirror is asked for, and the nested BSDF's context (None: it is not asked for)."""
        self.settle()
        if self.mirrors == self.km.left_out:
            # A 0 is being differentiated.
            self._find_components()
        first = 1 if self.mirrors else 0
        mirror = self.mirrors and ctx.is_enabled(mi.BSDFFlags.DeltaReflection, 0)
        if not ctx.type_mask & self.nested_lobes or ctx.component < first:
            return mirror, None
        if ctx.component == ALL_COMPONENTS:
            return mirror, ctx
        return mirror, mi.BSDFContext(ctx.mode, ctx.type_mask, ctx.component - first)

    def _share(self, km):
        """Probability of sampling the mirror. It is not differentiated: only what a sample carries is."""
        share = dr.detach(mean(km))
        # Neither of the two that are blended may be missing from a derivative.
        return dr.clip(share, 0.1, 0.9) if self.km.differentiated else share

    def _shift(self, bs):
        bs.sampled_component += 1 if self.mirrors else 0
        return bs


def _unnamed(props):
    """What the scene gives besides `km`. Only BSDFs count as read: the rest, a misspelt name say, Mitsuba refuses."""
    for name in props.unqueried():
        value = props[name]
        props.mark_queried(name, isinstance(value, mi.BSDF))
        yield value


mi.register_bsdf("mirrorblend", MirrorBlend)
