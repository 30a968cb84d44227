"""What a surface reflects, asked of the scene's BSDFs through Mitsuba: any BSDF, native ones too.

`materials.py` gives the same answers, faster, for scenes of this package's BSDFs with constants.
"""

import drjit as dr
import mitsuba as mi

from .needs import ALL_COMPONENTS, COURSE, DELTA, MIRRORLESS, NULL, TILTED, delta_lobes_of


class Dispatch:
    """The BSDFs of a scene. `deltas` says which delta lobes some of them have, `told` what they are told of the side
    from which they are seen (a `facing.Told`; None: what Mitsuba shows)."""

    def __init__(self, deltas, told=None):
        self.jit = dr.is_jit_v(mi.Float)
        self.told = told
        self.mask = COURSE | TILTED * told.tilts if told else 0
        self.deltas, self.contexts = deltas, self._mirror_contexts(deltas)
        smooth = int(mi.BSDFFlags.All) & ~(DELTA | NULL)
        self.smooth, self.mirrorless = self._context(smooth), self._context(smooth | MIRRORLESS)

    def at(self, si, active, front=None):
        """The BSDF that was hit, and the interaction as it is to see it; with a `told` that needs `front`."""
        bsdf = si.bsdf()
        return bsdf, self.told.about(si, bsdf, front, si.to_world(si.wi)) if self.told else si

    def eval(self, material, si, wo, last, active):
        """Smooth lobes, f cos(theta_o); on the lanes `last` (None: none) without a `mirrorblend`'s mirror."""
        bsdf, told = material
        if last is None:
            value = bsdf.eval(self.smooth, told, wo, active)
        else:
            # Selected, not added up: in scalar variants Mitsuba's own BSDFs do not look at the mask.
            value = bsdf.eval(self.smooth, told, wo, active & (last == False))  # noqa: E712
            value = dr.select(last, bsdf.eval(self.mirrorless, told, wo, active & last), value)
        return si.to_world_mueller(value, -wo, si.wi)

    def diffuse_reflectance(self, material, si, last, active):
        """Diffuse reflectance, unpolarized; `last` as in `eval`."""
        bsdf, told = material
        reflectance = mi.unpolarized_spectrum(bsdf.eval_diffuse_reflectance(told, active))
        if (self.deltas if self.jit else self._deltas_of(bsdf)[0]).masks:
            # Mitsuba's `mask` forgets its opacity here.
            reflectance = reflectance * (1 - mi.unpolarized_spectrum(bsdf.eval_null_transmission(si, active)))
        if last is None:
            return reflectance
        # What a mirrorblend shows without its mirror, only `eval` tells: at normal incidence.
        context = self._context(int(mi.BSDFFlags.DiffuseReflection) | MIRRORLESS)
        # From the side that is seen; what has one side only is asked from that one.
        below = mi.has_flag(bsdf.flags(), mi.BSDFFlags.BackSide) & (mi.Frame3f.cos_theta(told.wi) < 0)
        normal = mi.Vector3f(0, 0, dr.select(below, mi.Float(-1), mi.Float(1)))
        along = mi.SurfaceInteraction3f(told)
        along.wi = normal
        bare = mi.unpolarized_spectrum(bsdf.eval(context, along, normal, last)) * dr.pi
        return dr.select(last, bare, reflectance)

    def mirrors(self, material, si, active):
        """Mirrored and refracted rays: a list of (direction in world space, weight, lanes), one for each delta lobe."""
        bsdf, told = material
        found = []

        def mirror(context, lanes, scale=1):
            bs, weight = bsdf.sample(context, told, 0, mi.Point2f(0), lanes)
            weight = si.to_world_mueller(weight, -bs.wo, si.wi) * scale
            found.append((si.to_world(bs.wo), weight, lanes & ((bs.sampled_type & DELTA) != 0)))

        deltas, contexts = (self.deltas, self.contexts) if self.jit else self._deltas_of(bsdf)
        for context, others in contexts:
            lanes = active
            for other in others:
                lanes = lanes & (bsdf != mi.BSDFPtr(other))
            mirror(context, lanes)
        if deltas.masks:
            # The contexts of Mitsuba's `mask` for single components are of no use: it lets through what they exclude.
            lanes = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Null)
            through = mi.Spectrum(mi.unpolarized_spectrum(bsdf.eval_null_transmission(si, lanes)))
            found.append((si.to_world(-si.wi), through, lanes))
            if deltas.masked_mirrors:
                mirror(self._context(DELTA | NULL), lanes, mi.Spectrum(1) - through)
        return found

    def _deltas_of(self, bsdf):
        """Scalar variants ask each BSDF when they meet it."""
        deltas = delta_lobes_of([bsdf])
        return deltas, self._mirror_contexts(deltas)

    def _mirror_contexts(self, deltas):
        """A context for each component at which some BSDF has a delta lobe, and the BSDFs that it is not for."""
        return [(self._context(DELTA, i), others) for i, others in deltas.mirrors]

    def _context(self, mask: int, component: int = ALL_COMPONENTS):
        """Context of the lobes in `mask`, of all components or of one, for what `at` says of a hit."""
        return mi.BSDFContext(mi.TransportMode.Radiance, mask | self.mask, component)
