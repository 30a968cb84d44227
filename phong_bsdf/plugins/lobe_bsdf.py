"""A diffuse base and one cosine-power lobe: all that `phong` and `blinnphong` share."""

import drjit as dr
import mitsuba as mi

from phong_bsdf.parameters import Parameter

# name of the diffuse scale, of the lobe's scale, of the exponent
COEFFICIENTS = ("kd", "ks", "p")
REFLECTANCES = ("diffuse_reflectance", "specular_reflectance", "exponent")
DEFAULTS = (0.5, 0.2, 30.0)


class LobeBSDF(mi.BSDF):
    """Base class; the derived class says which lobe by four static methods.

    `lobe(wi, wo, p)`, `lobe_pdf(wi, wo, p)`, `sample_lobe(wi, p, xi)`, `lobe_albedo(p)`:
    see `phong_bsdf.lobes`.
    """

    def __init__(self, props):
        super().__init__(props)
        self.kd, self.ks, self.p = (
            Parameter(props, name, default) for name, default in zip(COEFFICIENTS, DEFAULTS, strict=True)
        )
        # Here Dr.Jit finds them when it freezes a function; inside of `Parameter` it would not.
        self.textures = [parameter.texture for parameter in (self.kd, self.ks, self.p)]
        self.parameters_changed([])

    def traverse(self, cb):
        for parameter in (self.kd, self.ks, self.p):
            cb.put(parameter.name, parameter.texture, mi.ParamFlags.Differentiable)

    def parameters_changed(self, keys):
        for parameter in (self.kd, self.ks, self.p):
            if parameter.name in keys:
                parameter.changed()
        # Only what can be non-zero is a component.
        components = []
        self.diffuse_index = self.glossy_index = None
        if not self.kd.is_zero:
            self.diffuse_index = len(components)
            components.append(mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide)
        if not self.ks.is_zero:
            self.glossy_index = len(components)
            components.append(mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide)
        if self.kd.varies or self.ks.varies or self.p.varies:
            components = [flags | mi.BSDFFlags.SpatiallyVarying for flags in components]
        self.m_components = [int(flags) for flags in components]
        self.m_flags = 0
        for flags in self.m_components:
            self.m_flags |= flags

    def sample(self, ctx, si, sample1, sample2, active=True):
        cos_theta_i = mi.Frame3f.cos_theta(si.wi)
        active = active & (cos_theta_i > 0)
        bs = dr.zeros(mi.BSDFSample3f)
        diffuse, glossy = self._enabled(ctx)
        if not (diffuse or glossy):
            return bs, mi.Spectrum(0)

        # Choose a lobe, then a direction.
        bs.eta = 1
        if glossy:
            p = self.p.value_1(si, active)
            choose_glossy = (sample1 < self._glossy_share(si, p, active)) if diffuse else True
            bs.wo = self.sample_lobe(si.wi, p, sample2)
            bs.sampled_type = mi.UInt32(int(mi.BSDFFlags.GlossyReflection))
            bs.sampled_component = mi.UInt32(self.glossy_index)
        if diffuse:
            wo = mi.warp.square_to_cosine_hemisphere(sample2)
            kind, index = mi.UInt32(int(mi.BSDFFlags.DiffuseReflection)), mi.UInt32(self.diffuse_index)
            bs.wo = dr.select(choose_glossy, bs.wo, wo) if glossy else wo
            bs.sampled_type = dr.select(choose_glossy, bs.sampled_type, kind) if glossy else kind
            bs.sampled_component = dr.select(choose_glossy, bs.sampled_component, index) if glossy else index

        value, bs.pdf = self.eval_pdf(ctx, si, bs.wo, active)
        active = active & (bs.pdf > 0)
        return bs, dr.select(active, value / dr.select(active, bs.pdf, 1), 0)

    def eval(self, ctx, si, wo, active=True):
        return self._eval_pdf(ctx, si, wo, active, pdf=False)[0]

    def pdf(self, ctx, si, wo, active=True):
        return self._eval_pdf(ctx, si, wo, active, value=False)[1]

    def eval_pdf(self, ctx, si, wo, active=True):
        return self._eval_pdf(ctx, si, wo, active)

    def eval_diffuse_reflectance(self, si, active=True):
        return mi.Spectrum(self.kd.value(si, active))

    def to_string(self):
        lines = [f"  {p.name} = {p.texture}".replace("\n", "\n  ") for p in (self.kd, self.ks, self.p)]
        return f"{type(self).__name__}[\n" + ",\n".join(lines) + "\n]"

    def _eval_pdf(self, ctx, si, wo, active, value=True, pdf=True):
        """Value f cos(theta_o) and density; either can be left out (its place then holds 0)."""
        cos_theta_o = mi.Frame3f.cos_theta(wo)
        active = active & (mi.Frame3f.cos_theta(si.wi) > 0) & (cos_theta_o > 0)
        diffuse, glossy = self._enabled(ctx)
        f, density = mi.UnpolarizedSpectrum(0), mi.Float(0)

        if glossy:
            p = self.p.value_1(si, active)
            if value:
                f = self.ks.value(si, active) * self.lobe(si.wi, wo, p)
            if pdf:
                density = self.lobe_pdf(si.wi, wo, p)
        if diffuse and value:
            f = f + self.kd.value(si, active) * cos_theta_o
        if diffuse and pdf:
            cosine = cos_theta_o * dr.inv_pi
            density = dr.lerp(cosine, density, self._glossy_share(si, p, active)) if glossy else cosine

        f = dr.select(active, f * dr.inv_pi, 0)
        return mi.depolarizer(f), dr.select(active, density, 0)

    def _enabled(self, ctx):
        """Whether the context asks for the diffuse and for the glossy component, and they exist."""

        def asked(index, flag):
            return index is not None and ctx.is_enabled(flag, index)

        return (
            asked(self.diffuse_index, mi.BSDFFlags.DiffuseReflection),
            asked(self.glossy_index, mi.BSDFFlags.GlossyReflection),
        )

    def _glossy_share(self, si, p, active):
        """Probability of sampling the lobe: its part of what is reflected at normal incidence."""
        diffuse = dr.mean(self.kd.value(si, active))
        glossy = dr.mean(self.ks.value(si, active)) * self.lobe_albedo(p)
        total = diffuse + glossy
        return dr.select(total > 0, glossy / dr.select(total > 0, total, 1), 0.5)
