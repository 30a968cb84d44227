"""A diffuse base and one cosine-power lobe: all that `phong` and `blinnphong` share."""

import functools

import drjit as dr
import mitsuba as mi

from phong_bsdf.reflection import arguments, energy, lobes
from phong_bsdf.reflection.parameters import LARGEST, LARGEST_EXPONENT, Parameter, is_recorded, settling, unrecorded
from phong_bsdf.reflection.vocabulary import COEFFICIENTS, COSINE, DEFAULTS, ENERGY, MIXTURE, REFLECTANCES, SAMPLINGS
from phong_bsdf.tracing.facing import toward_viewer
from phong_bsdf.tracing.materials import SERIALS, Material


@functools.cache
def _albedo_table(lobe: str, reflectance: bool):
    """One for all BSDFs of a kind. This module is reloaded for each variant, and the cache with it."""
    # Only integrators that sample need it, and NumPy with it.
    from phong_bsdf.reflection import albedo

    return albedo.Table(lobe, reflectance, mi.Float)


class LobeBSDF(mi.BSDF):
    """Base class; the derived class says which lobe of `phong_bsdf.reflection.lobes.LOBES` by its `NAME`."""

    def __init__(self, props):
        super().__init__(props)
        names = _vocabulary(props)
        self.reflectances = names == REFLECTANCES
        self.diffuse, self.specular, self.exponent = (
            Parameter(props, name, default, largest=largest)
            for name, default, largest in zip(names, DEFAULTS, (LARGEST, LARGEST, LARGEST_EXPONENT), strict=True)
        )
        self.parameters = (self.diffuse, self.specular, self.exponent)
        self.serial = next(SERIALS)
        self.conserves_energy = self.reflectances and _boolean(props, ENERGY, True)
        self.sampling = props.get("sampling", MIXTURE)
        if self.sampling not in SAMPLINGS:
            raise ValueError(f"{self.NAME}: 'sampling' must be {', '.join(SAMPLINGS)}, got '{self.sampling}'")
        self.scale, self.scale_array = 1.0, mi.Float(1)
        # Here Dr.Jit finds the table's array when it freezes a function; inside of a helper object it would not.
        self.albedo_ratios = None
        known = bool(self.diffuse.known and self.specular.known)
        if known:
            self._apply_energy_rule()
        self.unsettled, self.refused = any(p.unseen for p in self.parameters), False
        # A warning waits, too: Mitsuba may be about to say something on another thread, and to ask Python for it.
        self.unsettled |= self.conserves_energy and (not known or self.scale != 1)
        self._find_components()

    @property
    def lobe(self):
        """The functions of this BSDF's lobe."""
        return lobes.LOBES[self.NAME]

    @property
    def albedo(self):
        """The directional albedo of this BSDF's lobe."""
        table = _albedo_table(self.NAME, self.reflectances)
        self.albedo_ratios = table.ratios
        return table

    def settle(self):
        """Before the first use: look at what the constructor could not. ValueError for a constant out of its range."""
        # Dr.Jit asks every BSDF that is alive. One that was refused is not to spoil the pictures of other scenes.
        if not self.unsettled or (self.refused and is_recorded()):
            return
        with settling:
            if self.unsettled:
                self.refused = True
                unrecorded(self._look)
                if dr.flag(dr.JitFlag.FreezingScope):
                    # A recording knows no array that was made elsewhere. The next one finds the scale as a number.
                    self.scale_array = mi.Float(self.scale)
                self.unsettled = False
                self._find_components()

    def _look(self):
        for parameter in self.parameters:
            if parameter.unseen:
                parameter.changed()
        self._apply_energy_rule()
        if self.scale != 1:
            mi.Log(
                mi.LogLevel.Warn,
                f"{self.NAME}: '{self.diffuse.name}' + '{self.specular.name}' exceed 1, so both are multiplied by "
                f"{self.scale:.3g}; set '{ENERGY}' to false to keep them",
            )

    def traverse(self, cb):
        self.settle()
        for parameter in self.parameters:
            cb.put(parameter.name, parameter.texture, mi.ParamFlags.Differentiable)

    def parameters_changed(self, keys):
        for parameter in self.parameters:
            parameter.changed_by(keys)
        self._find_components()
        self._apply_energy_rule()

    def _apply_energy_rule(self):
        # A frozen or differentiated parameter cannot be looked at: the last scale stays.
        blind = dr.flag(dr.JitFlag.FreezingScope) or self.diffuse.differentiated or self.specular.differentiated
        if self.conserves_energy and not blind:
            self.scale = energy.scale(self.diffuse, self.specular)
            # In an array, another scale is not another kernel.
            self.scale_array = dr.opaque(mi.Float, self.scale) if dr.is_jit_v(mi.Float) else self.scale

    def sample(self, ctx, si, sample1, sample2, active=True):
        sample1, sample2 = arguments.random_number(sample1), arguments.random_point(sample2)
        cos_theta_i = mi.Frame3f.cos_theta(si.wi)
        active = arguments.mask(active) & (cos_theta_i > 0)
        bs = dr.zeros(mi.BSDFSample3f)
        diffuse, glossy = self._enabled(ctx)
        if not (diffuse or glossy):
            return bs, mi.Spectrum(0)

        # Choose a lobe, then a direction.
        bs.eta = 1
        by_cosine, by_lobe = self._strategies(diffuse, glossy)
        if by_lobe:
            p = self.exponent.value_1(si, active)
            choose_lobe = (sample1 < self._glossy_share(si, p, active)) if by_cosine else True
            bs.wo = self.lobe.sample(si.wi, p, sample2)
            bs.sampled_type = mi.UInt32(int(mi.BSDFFlags.GlossyReflection))
            bs.sampled_component = mi.UInt32(self.glossy_index)
        if by_cosine:
            wo = mi.warp.square_to_cosine_hemisphere(sample2)
            kind = mi.UInt32(int(mi.BSDFFlags.DiffuseReflection if diffuse else mi.BSDFFlags.GlossyReflection))
            index = mi.UInt32(self.diffuse_index if diffuse else self.glossy_index)
            bs.wo = dr.select(choose_lobe, bs.wo, wo) if by_lobe else wo
            bs.sampled_type = dr.select(choose_lobe, bs.sampled_type, kind) if by_lobe else kind
            bs.sampled_component = dr.select(choose_lobe, bs.sampled_component, index) if by_lobe else index

        # Where samples go is not differentiated, so neither is how many go there: E[weight] has the right derivative.
        bs.wo = dr.detach(bs.wo)
        value, bs.pdf = self.eval_pdf(ctx, si, bs.wo, active)
        bs.pdf = dr.detach(bs.pdf)
        active = active & (bs.pdf > 0)
        return bs, dr.select(active, value / dr.select(active, bs.pdf, 1), 0)

    def eval(self, ctx, si, wo, active=True):
        return self._eval_pdf(ctx, si, wo, active, pdf=False)[0]

    def pdf(self, ctx, si, wo, active=True):
        return self._eval_pdf(ctx, si, wo, active, value=False)[1]

    def eval_pdf(self, ctx, si, wo, active=True):
        return self._eval_pdf(ctx, si, wo, active)

    def eval_diffuse_reflectance(self, si, active=True):
        return mi.Spectrum(self._scaled(self.diffuse.value(si, active)))

    def to_string(self):
        lines = [f"  {p.name} = {p.texture}".replace("\n", "\n  ") for p in self.parameters]
        return f"{type(self).__name__}[\n" + ",\n".join(lines) + "\n]"

    def refresh(self):
        """Take in what has changed without a call of `parameters_changed`."""
        self.settle()
        if any(parameter.refresh() for parameter in self.parameters):
            self.parameters_changed([])

    def constants(self):
        """What `phong_bsdf.tracing.materials` needs instead of this BSDF; None where a parameter is differentiated."""
        self.refresh()
        values = [(0.0,) if parameter.varies else parameter.constant() for parameter in self.parameters]
        # Of a colour, only Mitsuba knows which number an exponent is.
        if None in values or len(set(values[2])) > 1 or any(parameter.differentiated for parameter in self.parameters):
            return None
        names = ("diffuse", "specular", "exponent")
        textures = tuple((n, p) for n, p in zip(names, self.parameters, strict=True) if p.varies)
        return Material((self.NAME, self.reflectances), *values, scale=(self.scale,), km=(0.0,), textures=textures)

    def arrays(self):
        """The arrays that hold the constants."""
        return [array for parameter in self.parameters for array in parameter.arrays]

    def _eval_pdf(self, ctx, si, wo, active, value=True, pdf=True):
        """Value f cos(theta_o) and density; either can be left out (its place then holds 0)."""
        wo, active = arguments.direction(wo), arguments.mask(active)
        cos_theta_o = mi.Frame3f.cos_theta(wo)
        active = active & (mi.Frame3f.cos_theta(si.wi) > 0) & (cos_theta_o > 0)
        diffuse, glossy = self._enabled(ctx)
        f, density = mi.UnpolarizedSpectrum(0), mi.Float(0)

        if glossy:
            p = self.exponent.value_1(si, active)
        if value and (diffuse or glossy):
            kd = self.diffuse.value(si, active) if diffuse else None
            ks = self.specular.value(si, active) if glossy else None
            lobe = self.lobe.value(toward_viewer(ctx, si), wo, p) if glossy else None
            factor = None
            if self.reflectances and glossy:
                factor = lobes.reflectance_factor(self.lobe.normalization(p), cos_theta_o)
            f = dr.select(active, self._scaled(lobes.reflected(lobe, factor, cos_theta_o, kd, ks)), 0)
        by_cosine, by_lobe = self._strategies(diffuse, glossy)
        if pdf and by_lobe:
            density = self.lobe.pdf(si.wi, wo, p)
        if pdf and by_cosine:
            cosine = cos_theta_o * dr.inv_pi
            density = dr.lerp(cosine, density, self._glossy_share(si, p, active)) if by_lobe else cosine
        return mi.depolarizer(f), dr.select(active, density, 0)

    def _strategies(self, diffuse: bool, glossy: bool) -> tuple[bool, bool]:
        """Whether the cosine and whether the lobe draws directions, where these components are asked for."""
        if self.sampling == COSINE:
            return diffuse or glossy, False
        return diffuse and (self.sampling == MIXTURE or not glossy), glossy

    def _scaled(self, value):
        self.settle()
        return value * self.scale_array if self.conserves_energy else value

    def _glossy_share(self, si, p, active):
        """Probability of sampling the lobe: its part of what is reflected at this angle of incidence."""
        diffuse = self.diffuse.mean(si, active)
        glossy = self.specular.mean(si, active) * self.albedo(mi.Frame3f.cos_theta(si.wi), p)
        total = diffuse + glossy
        share = dr.detach(dr.select(total > 0, glossy / dr.select(total > 0, total, 1), 0.5))
        # Neither of the two may be missing from a derivative.
        differentiated = self.diffuse.differentiated or self.specular.differentiated
        return dr.clip(share, 0.1, 0.9) if differentiated else share

    # Only what can be non-zero is a component --------------------------------------------------------

    def _find_components(self):
        self.shown = not self.diffuse.left_out, not self.specular.left_out
        # As above. By the length of the list Dr.Jit also sees that a recording that left something out is of no use.
        self.textures = [self.exponent.texture, self.specular.texture, self.diffuse.texture]
        self.textures += [self.diffuse.texture] * self.shown[0] + [self.specular.texture] * (2 * self.shown[1])
        kinds = (mi.BSDFFlags.DiffuseReflection, mi.BSDFFlags.GlossyReflection)
        flags = int(mi.BSDFFlags.FrontSide)
        if any(parameter.varies for parameter in self.parameters):
            flags |= int(mi.BSDFFlags.SpatiallyVarying)
        self.m_components = [int(kind) | flags for kind, shown in zip(kinds, self.shown, strict=True) if shown]
        self.m_flags = 0
        for component in self.m_components:
            self.m_flags |= component
        self.diffuse_index, self.glossy_index = 0, int(self.shown[0])

    def _enabled(self, ctx):
        """Whether the context asks for the diffuse and for the glossy component, and they exist."""
        self.settle()
        if self.shown != (not self.diffuse.left_out, not self.specular.left_out):
            # A 0 is being differentiated.
            self._find_components()
        diffuse, glossy = self.shown
        return (
            diffuse and ctx.is_enabled(mi.BSDFFlags.DiffuseReflection, self.diffuse_index),
            glossy and ctx.is_enabled(mi.BSDFFlags.GlossyReflection, self.glossy_index),
        )


def _vocabulary(props) -> tuple[str, str, str]:
    """The names that the scene uses; the lecture's where it uses none."""
    coefficients = [name for name in COEFFICIENTS if name in props]
    reflectances = [name for name in (*REFLECTANCES, ENERGY) if name in props]
    if coefficients and reflectances:
        raise ValueError(
            f"{props.plugin_name()}: '{coefficients[0]}' and '{reflectances[0]}' belong to different vocabularies; "
            f"use {', '.join(COEFFICIENTS)} or {', '.join(REFLECTANCES)}"
        )
    return REFLECTANCES if reflectances else COEFFICIENTS


def _boolean(props, name: str, default: bool) -> bool:
    value = props.get(name, default)
    if not isinstance(value, bool):
        raise ValueError(f"{props.plugin_name()}: '{name}' must be true or false, got {value}")
    return value
