"""Integrator `whitted`: delta lights, shadows and mirrors, without a random number."""

import drjit as dr
import mitsuba as mi

from phong_bsdf.reflection.parameters import Parameter
from phong_bsdf.tracing.camera import WHOLE, CameraSamples
from phong_bsdf.tracing.films import channel_count, gradient_of_samples, is_plain, picture, splat, store
from phong_bsdf.tracing.needs import FEATURES, left_out
from phong_bsdf.tracing.sums import Sets, most_summed, put_blocks, set_sums
from phong_bsdf.tracing.tracer import Memory, Tracer

IS_JIT = dr.is_jit_v(mi.Float)

if IS_JIT:
    # Not `mi.ad.common`: that name is not reloaded when the variant changes.
    from mitsuba.python.ad.integrators.common import ADIntegrator as Base
else:
    Base = mi.SamplingIntegrator


# Of several passes each needs the derivatives of the parameters; a picture may not depend on them.
FORWARD = dr.ADFlag.ClearEdges | dr.ADFlag.ClearInterior | dr.ADFlag.AllowNoGrad


class Whitted(Base):
    r"""A Whitted ray tracer, deterministic, with the lecture's conventions.

    At every hit, over all lights j with direction l_j and visibility V_j,

        L_o = sum_j pi [f cos](v, l_j) I_j V_j + delta lobes,

    with I_j the emitter's `intensity` (point, spot, projector) or `irradiance` (directional)
    and no falloff. The factor pi makes `diffuse` of reflectance rho look like kd = rho and
    gives `phong` and `blinnphong` the lecture's formulas. `convention = physical` has the
    falloff 1/r^2 and no pi, and equals Mitsuba's `direct`, and `path` as far as that finds no
    light that is scattered twice, for delta lights.

    =============  ======================  =======  ==================================================
    name           type                    default  meaning
    =============  ======================  =======  ==================================================
    convention     `course` or `physical`  course   see above
    max_depth      integer >= 1, or -1     10       1: the background only, 2: direct light, one more
                                                    per mirror bounce; -1: until the throughput is
                                                    below 1e-6, 1000 bounces at most
    shadows        boolean                 true     whether surfaces block the lights
    ambient        number, RGB, spectrum   0        adds ambient * diffuse reflectance at every hit
    hide_emitters  boolean                 false    hides the background from the camera
    specialize     boolean                 true     leave out of the kernel what the scene does not need
    =============  ======================  =======  ==================================================

    Samples: spp = 1 traces pixel centres, spp = n^2 the centres of an n x n grid in each
    pixel; any other number uses the film's sampler, above 64 to 1024 samples (by the film) in sets
    of so many. However many they are, their sum loses at most 2e-6 of its value. When max_depth ends
    a chain of mirrors, the last `mirrorblend` shows its nested surface undiminished (course), or its
    mirrored part is lost (physical). `constant` and `envmap` emitters are a background: rays that leave the
    scene see them, they light nothing. Delta lobes of native BSDFs (`conductor`, `plastic`,
    `dielectric`, `thindielectric`, `mask`) are followed, all branches of them. Shadow rays
    stop at any surface. Area lights are an error, as are lights that are not finite. Media are left out, and Mitsuba
    draws stretched spheres round: of both there is one warning for each scene. In the course convention a surface is
    black from behind only where both its normals, geometric and shading, face away from the viewer.

    Source: Whitted, "An improved illumination model for shaded display", 1980.

    XML::

        <integrator type="whitted">
            <integer name="max_depth" value="10"/>
        </integrator>

    Python::

        {"type": "whitted", "max_depth": 10}
    """

    def __init__(self, props):
        self.convention = props.get("convention", "course")
        if self.convention not in ("course", "physical"):
            raise ValueError(f"whitted: 'convention' must be 'course' or 'physical', got '{self.convention}'")
        self.depth = props.get("max_depth", 10)
        if not isinstance(self.depth, int) or (self.depth < 1 and self.depth != -1):
            raise ValueError(f"whitted: 'max_depth' must be -1 or an integer >= 1, got {self.depth}")
        self.shadows = props.get("shadows", True)
        if not isinstance(self.shadows, bool):
            raise ValueError(f"whitted: 'shadows' must be true or false, got {self.shadows}")
        specialize = props.get("specialize", True)
        if not isinstance(specialize, bool):
            raise ValueError(f"whitted: 'specialize' must be true or false, got {specialize}")
        # Features that stay in the kernel though a scene does not need them: measurements set this.
        self.keep = frozenset() if specialize else frozenset(FEATURES)
        self.memory = Memory()
        # The part of the grid of samples that is rendered: a rendering in passes sets this.
        self.part = WHOLE
        # Hears the share done after each of several passes.
        self.on_progress = lambda share: None
        self.ambient = Parameter(props, "ambient", 0)
        super().__init__(props)

    def traverse(self, cb):
        self.ambient.settle()
        cb.put("ambient", self.ambient.texture, mi.ParamFlags.Differentiable)

    def parameters_changed(self, keys):
        self.ambient.changed_by(keys)

    def sample(self, scene, sampler, ray, medium=None, active=True, mode=None, **_):
        """Radiance along `ray`, in the form that Mitsuba expects of an integrator of this variant."""
        radiance, valid = self.tracer(scene, mode).trace(ray, active)
        return (radiance, valid, [], None) if IS_JIT else (radiance, valid, [])

    def prepare(self, sensor, seed=0, spp=0, aovs=(), most=None):
        """Prepares the film; returns the camera's samples, in sets of `most`, and the number of them per pixel."""
        samples = CameraSamples(sensor, seed, spp, self.part, most)
        sensor.film().prepare(list(aovs))
        return samples, samples.spp

    def sample_rays(self, scene, sensor, samples):
        """Camera rays of all samples, their weights, and their positions on the film."""
        return samples.all()

    def to_string(self):
        return f"Whitted[convention = {self.convention}, max_depth = {self.depth}, shadows = {self.shadows}]"

    def tracer(self, scene, mode=None):
        """What renders `scene`; `mode` is None or that of a derivative."""
        if self.memory.is_new(scene) and (said := left_out(scene)):
            mi.Log(mi.LogLevel.Warn, said)
        self.ambient.settle()
        return Tracer(
            scene,
            self.memory,
            convention=self.convention,
            max_depth=self.depth,
            shadows=self.shadows,
            ambient=None if self.ambient.left_out and "ambient" not in self.keep else self.ambient,
            hide_emitters=self.hide_emitters,
            mode=mode,
            keep=self.keep,
        )

    def features(self, scene, sensor, spp):
        """The features, of `needs.FEATURES`, of the kernel that renders `scene`."""
        features = self.tracer(scene).features()
        return features | {"film block"} if not IS_JIT or self._needs_block(sensor.film(), spp) else features

    def _needs_block(self, film, spp) -> bool:
        return spp > 1 or "film block" in self.keep or not is_plain(film)

    if IS_JIT:

        def render(self, scene, sensor=0, seed=0, spp=0, develop=True, evaluate=True):
            """One sample for each pixel is the picture; more, and other filters, go through the film's block, pass by
            pass where they are many."""
            sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
            film = sensor.film()
            spp = spp or sensor.sampler().sample_count()
            if not develop:
                raise ValueError("whitted: renders with develop = true only; sensor.film() has the rest afterwards")
            with dr.suspend_grad():
                samples, spp = self.prepare(sensor, seed, spp, self.aov_names(), most_summed(film, self))
                tracer = self.tracer(scene)
                if samples.sets > 1:
                    return self._render_sets(samples, tracer, film)
                if self._needs_block(film, spp):
                    return self._render_passes(samples, tracer, film)
                ray, weight, _ = samples.all()
                radiance, valid = tracer.trace(ray, True)
                channels = [*mi.Color3f(mi.unpolarized_spectrum(radiance) * weight)]
                if mi.has_flag(film.flags(), mi.FilmFlags.Alpha):
                    channels.append(dr.select(valid, mi.Float(1), mi.Float(0)))
                return store(film, channels)

        def _render_passes(self, samples, tracer, film):
            block = film.create_block()
            # The samples of a pixel are neighbours: added up before they are written.
            block.set_coalesce(block.coalesce() and samples.spp >= 4)
            passes = samples.passes()
            for part in passes:
                ray, weight, position = samples.part_rays(part)
                radiance, valid = tracer.trace(ray, True)
                alpha = dr.select(valid, mi.Float(1), mi.Float(0))
                Base._splat_to_block(block, film, position, radiance * weight, mi.Float(1), alpha, [], ray.wavelengths)
                if len(passes) > 1:
                    dr.eval(block.tensor())
                    dr.sync_thread()
                    self.on_progress((part.first + part.pixels) / samples.pixels)
            film.put_block(block)
            return film.develop()

        def _render_sets(self, samples, tracer, film):
            """The picture of more samples than a block adds up exactly enough."""
            sets = Sets(film)
            passes = samples.passes(sets.most)
            for i, part in enumerate(passes):
                if part.first == 0:
                    block = sets.block(part.sets)
                ray, weight, position = samples.part_rays(part)
                radiance, valid = tracer.trace(ray, True)
                counts = samples.counts(part)
                one, zero = mi.Float(1), mi.Float(0)
                _, number = part.index(dr.arange(mi.UInt32, part.lanes))
                Base._splat_to_block(
                    block, film, sets.position(position, number, part.sets), dr.select(counts, radiance * weight, 0),
                    dr.select(counts, one, zero), dr.select(valid & counts, one, zero), [], ray.wavelengths,
                )  # fmt: skip
                dr.eval(block.tensor())
                if part.first + part.pixels == samples.pixels:
                    sets.add(block, part.sets)
                if len(passes) > 1:
                    dr.sync_thread()
                    self.on_progress((i + 1) / len(passes))
            sets.put()
            return film.develop()

        def render_forward(self, scene, params, sensor=0, seed=0, spp=0):
            """The derivative of the picture, of its shape, in the direction of the gradients that `params` hold."""
            sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
            film = sensor.film()
            if not is_plain(film):
                return super().render_forward(scene, params, sensor, seed, spp)
            with dr.suspend_grad():
                samples, spp = self.prepare(sensor, seed, spp, most=most_summed(film, self))
                parts = {}
                for part in samples.passes():
                    with dr.resume_grad():
                        color = _color(self.tracer(scene, dr.ADMode.Forward), samples, part)
                        derivative = dr.forward_to(color, flags=FORWARD)
                    found = [set_sums(channel, part) / spp for channel in derivative]
                    before = parts.get(part.first)
                    parts[part.first] = [a + b for a, b in zip(before, found, strict=True)] if before else found
                    dr.eval(parts[part.first])
                found = zip(*parts.values(), strict=True)
                channels = [mi.Float(dr.concat(values) if len(values) > 1 else values[0]) for values in found]
                # Alpha has none.
                channels += [dr.zeros(mi.Float, samples.pixels)] * (channel_count(film) - 3)
                return picture(film, channels)

        def render_backward(self, scene, params, grad_in, sensor=0, seed=0, spp=0):
            """Adds to the gradients of `params` what `grad_in`, those of the picture, make of them.

            Pixels of the box filter are means of their samples: no film, hence no picture, is needed for it.
            """
            sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
            film = sensor.film()
            if not is_plain(film):
                super().render_backward(scene, params, grad_in, sensor, seed, spp)
                return
            with dr.suspend_grad():
                samples, spp = self.prepare(sensor, seed, spp, most=most_summed(film, self))
                for part in samples.passes():
                    gradient = gradient_of_samples(grad_in.array, channel_count(film), part, spp)
                    with dr.resume_grad():
                        tracer = self.tracer(scene, dr.ADMode.Backward)
                        # Loops are traced once less then, but a loop over lights in them cannot do without.
                        with dr.scoped_set_flag(dr.JitFlag.OptimizeLoops, not tracer.lights.few):
                            color = _color(tracer, samples, part)
                            dr.set_grad(color, gradient)
                            dr.enqueue(dr.ADMode.Backward, color)
                            dr.traverse(dr.ADMode.Backward)
                    # Mitsuba must not free the scene before this has run.
                    dr.eval()

    else:

        def render(self, scene, sensor=0, seed=0, spp=0, develop=True, evaluate=True):
            """Renders one sample after the other."""
            sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
            film = sensor.film()
            samples, _ = self.prepare(sensor, seed, spp, self.aov_names(), most_summed(film, self))
            blocks = [film.create_block() for _ in range(samples.sets)]
            tracer = self.tracer(scene)
            for index in range(samples.count):
                ray, weight, position = samples.rays(index)
                radiance, valid = tracer.trace(ray, True)
                block = blocks[index % samples.spp // samples.set_spp]
                splat(block, film, position, radiance * weight, ray.wavelengths, valid)
            put_blocks(film, blocks)
            return film.develop() if develop else mi.TensorXf()


def _color(tracer, samples, part):
    """The colour of each sample of a part, black where there is none."""
    ray, weight, _ = samples.part_rays(part)
    radiance, _ = tracer.trace(ray, True)
    return dr.select(samples.counts(part), mi.Color3f(mi.unpolarized_spectrum(radiance) * weight), 0)


mi.register_integrator("whitted", Whitted)
