"""Follows camera rays through one scene: lights and shadows at each hit, then the mirrors.

The integrator `whitted` makes one `Tracer` for each rendering, which builds the kernel
without what the scene does not need (`needs.FEATURES`).
"""

from dataclasses import dataclass, field

import drjit as dr
import mitsuba as mi

from ..reflection.parameters import FAINT, is_recorded
from .dispatch import Dispatch
from .facing import Told, interpolates, is_front
from .geometry import Geometry, Tight
from .interfaces import Hits, Reflection
from .lights import Dark, Finite, Lights
from .materials import Table, is_isotropic
from .needs import DeltaLobes, UnsupportedScene, bsdfs_of, check_lights, delta_lobes, prepared, wake
from .spawn import Seen, Surfaces

# Unlimited depth: until the throughput is below this, after this many bounces at the latest.
FAINTEST = 1e-6
MOST_BOUNCES = 1000

# Room for the branches of a tree of refractions that wait for their turn. The fainter
# of two branches is followed first: it carries at most half of the light. Where 24 wait,
# it carries less than 1e-7, and is dropped for the brighter one.
MOST_WAITING = 24


@dataclass
class Memory:
    """What an integrator keeps of the scene that it rendered last, to look at what has changed only."""

    table: Table = field(default_factory=Table)
    dark: Dark = field(default_factory=Dark)
    finite: Finite = field(default_factory=Finite)
    seen: Seen = field(default_factory=Seen)
    tight: Tight = field(default_factory=Tight)
    scenes: dict = field(default_factory=dict)

    def is_new(self, scene) -> bool:
        """Whether `scene` was not seen before. It is not looked at while something is recorded."""
        # While the array is kept, no other has its number.
        pointers = scene.shapes_dr() if dr.is_jit_v(mi.Float) else None
        key = scene.ptr if pointers is None else pointers.index
        if key in self.scenes or is_recorded():
            return False
        self.scenes[key] = pointers
        return True


class Tracer:
    """An integrator's options and what one scene needs of it.

    `ambient` is None where it is 0. `keep` names features that stay in the kernel though the scene does not need them.
    """

    def __init__(
        self,
        scene,
        memory,
        *,
        convention,
        max_depth,
        shadows,
        ambient,
        hide_emitters,
        mode=None,
        keep=frozenset(),
    ):
        self.scene, self.forward = scene, mode == dr.ADMode.Forward
        gradients = mode in (dr.ADMode.Forward, dr.ADMode.Backward)
        if gradients:
            wake(scene)
            # A tree of rays has no backward derivative; only a scene that needs one is to fail.
            keep = keep - {"branches"}
        check_lights(scene)
        memory.finite.check(scene.emitters())
        self.lights = Lights(scene, None if gradients or "lights" in keep else memory.dark, keep)
        self.geometry: Hits = Geometry(scene, memory.tight)
        self.surfaces = Surfaces(scene, memory.seen)
        self.background = scene.environment()
        self.course = convention == "course"
        self.shadows = shadows
        self.ambient = ambient
        self.hide_background = hide_emitters
        self.gradients = gradients
        # Paths end where they carry no more. A mirror of weight 0 still has a derivative: it counts as FAINT then.
        self.faintest = FAINTEST if max_depth == -1 else 0
        if gradients:
            self.faintest = FAINTEST * FAINT if max_depth == -1 else -1
        self.jit = dr.is_jit_v(mi.Float)

        # How many surfaces of a path are shaded, and how many of its rays are traced: the
        # physical convention looks for the background behind the last mirror, as `path` does.
        self.unlimited = max_depth == -1
        self.most_hits = MOST_BOUNCES + 1 if self.unlimited else max_depth - 1
        self.most_rays = self.most_hits + (not self.course and self.background is not None)
        self.most_rays = max(self.most_rays, 1)

        self._find_materials(memory, keep)
        # Scalar variants ask each BSDF when they meet it.
        self.follows = (self.deltas.branches > 0 or not self.jit) and self.most_rays > 1
        self.fades = (self.deltas.fading or not self.jit) and self.course

    def _find_materials(self, memory, keep):
        """What surfaces are made of: a table where all BSDFs are the package's own, and which delta lobes there are."""
        self.table = None if self.gradients or "bsdf calls" in keep else memory.table.of(self.scene, keep)
        # A table is of such BSDFs only.
        self.isotropic = self.table is not None or is_isotropic(self.scene)
        if self.table:
            mirror = self.table.km is not None
            self.deltas = prepared(DeltaLobes(branches=int(mirror), fading=mirror), keep)
        else:
            self.deltas = delta_lobes(self.scene, keep)
        told = None if self.table else self._told()
        self.materials: Reflection = self.table or Dispatch(self.deltas, told)
        self.sided = told is not None or (self.table is not None and self.course and interpolates(self.scene))
        if self.gradients and self.deltas.branches > 1:
            raise UnsupportedScene(
                "whitted: no derivatives where a surface both reflects and refracts (dielectric, thindielectric), or "
                "has two mirrors (mask or mirrorblend over another); use a single mirror, or the integrator 'path'"
            )

    def _told(self):
        """What the course convention tells the BSDFs; None where it differs in nothing from what Mitsuba shows."""
        if not self.course:
            return None
        told = Told(bsdfs_of(self.scene))
        turned = told.tilts or interpolates(self.scene)
        return told if turned and not told.all_foreign else None

    def features(self) -> set[str]:
        """The features, of `needs.FEATURES`, that the kernel holds."""
        shades = self.lights.count > 0 and self.most_hits > 0
        has = {
            "bsdf calls": self.table is None,
            "materials": self.table is None or self.table.several,
            "diffuse": self.table is None or self.table.diffuse is not None,
            "highlights": self.table is None or self.table.specular is not None,
            "mirrors": self.follows,
            "branches": self.follows and self.deltas.branches > 1,
            "transparency": self.follows and self.deltas.masks,
            "last bounce": self.follows and self.fades,
            "lights": shades and not self.lights.few,
            "light calls": shades and not self.lights.uniform,
            "ambient": self.ambient is not None,
        }
        return {feature for feature, held in has.items() if held}

    def trace(self, ray, active):
        """Radiance along `ray`, and whether it meets a surface or the background."""
        if not self.jit:
            return self._trace_one(ray, active)
        if not self.follows:
            n = dr.width(ray.d)
            radiance, seen, _ = self._step(ray, mi.Spectrum(1), dr.zeros(mi.UInt32, n), mi.Mask(active))
            return radiance, seen
        if self.deltas.branches > 1:
            return self._trace_tree(ray, active)
        return self._trace_forward(ray, active) if self.forward else self._trace_path(ray, active)

    # Three ways to walk: one ray in scalar variants, paths, trees ---------------------------------

    def _trace_one(self, ray, active):
        radiance, valid = mi.Spectrum(0), False
        waiting = [(ray, mi.Spectrum(1), 0)] if active else []
        while waiting:
            ray, beta, depth = waiting.pop()
            light, seen, branches = self._step(ray, beta, depth, True)
            radiance += light
            valid = valid or (depth == 0 and seen)
            for o, d, weight, goes_on in branches:
                if goes_on:
                    waiting.append((mi.Ray3f(o, d, ray.time, ray.wavelengths), weight, depth + 1))
        return radiance, valid

    @dr.syntax
    def _trace_path(self, ray, active):
        o, d, beta, depth, alive, radiance, valid = self._start(ray, active)
        while dr.hint(alive != 0, max_iterations=self.most_rays, exclude=[ray, active], label="mirrors"):
            o, d, beta, depth, alive, radiance, valid = self._bounce(ray, o, d, beta, depth, alive, radiance, valid)
        return radiance, valid != 0

    def _trace_forward(self, ray, active):
        """As `_trace_path`, for forward derivatives: Dr.Jit 1.5 fails at some loops whose body calls BSDFs that call
        others, so the bounces stand in the kernel one by one."""
        *state, alive, radiance, valid = self._start(ray, active)
        for _ in range(self.most_rays):
            *state, alive, radiance, valid = self._bounce(ray, *state, alive, radiance, valid)
            if self.unlimited:
                dr.eval(state, alive, radiance, valid)
                if not dr.any(alive != 0):
                    break
        return radiance, valid != 0

    def _bounce(self, ray, o, d, beta, depth, alive, radiance, valid):
        """The next state of a path: that of `_start`."""
        here = mi.Ray3f(o, d, dr.select(depth == 0, ray.maxt, dr.inf), ray.time, ray.wavelengths)
        light, seen, branches = self._step(here, beta, depth, alive != 0)
        valid = dr.select((depth == 0) & seen, mi.UInt32(1), valid)
        o, d, beta, goes_on = self._only(branches)
        return o, d, beta, depth + 1, dr.select(goes_on, mi.UInt32(1), mi.UInt32(0)), radiance + light, valid

    @dr.syntax
    def _trace_tree(self, ray, active):
        o, d, beta, depth, alive, radiance, valid = self._start(ray, active)
        maxt, time, wavelengths = ray.maxt, ray.time, ray.wavelengths
        waiting = dr.zeros(mi.UInt32, dr.width(alive))
        room = min(self.most_rays, MOST_WAITING) * (self.deltas.branches - 1)
        stack_o, stack_d = dr.alloc_local(mi.Point3f, room), dr.alloc_local(mi.Vector3f, room)
        stack_beta, stack_depth = dr.alloc_local(mi.Spectrum, room), dr.alloc_local(mi.UInt32, room)

        while dr.hint(alive != 0, exclude=[maxt, time, wavelengths, ray, active], label="tree of mirrors"):
            here = mi.Ray3f(o, d, dr.select(depth == 0, maxt, dr.inf), time, wavelengths)
            light, seen, branches = self._step(here, beta, depth, alive != 0)
            radiance += light
            valid = dr.select((depth == 0) & seen, mi.UInt32(1), valid)
            depth += 1

            # Follow the faintest branch, and let the others wait.
            o, d, beta, follow = branches[0]
            for other in branches[1:]:
                o, d, beta, follow, wait_o, wait_d, wait_beta, wait = _fainter((o, d, beta, follow), other)
                full = wait & (waiting >= room)
                o, d, beta = dr.select(full, wait_o, o), dr.select(full, wait_d, d), dr.select(full, wait_beta, beta)
                wait = wait & ~full
                stack_o.write(wait_o, waiting, wait)
                stack_d.write(wait_d, waiting, wait)
                stack_beta.write(wait_beta, waiting, wait)
                stack_depth.write(depth, waiting, wait)
                waiting += dr.select(wait, mi.UInt32(1), mi.UInt32(0))

            # Where this path has ended, continue with one that waits.
            take = ~follow & (waiting > 0)
            waiting -= dr.select(take, mi.UInt32(1), mi.UInt32(0))
            o = dr.select(take, stack_o.read(waiting, take), o)
            d = dr.select(take, stack_d.read(waiting, take), d)
            beta = dr.select(take, stack_beta.read(waiting, take), beta)
            depth = dr.select(take, stack_depth.read(waiting, take), depth)
            alive = dr.select(follow | take, mi.UInt32(1), mi.UInt32(0))

        return radiance, valid != 0

    def _start(self, ray, active):
        """State of a walk. A Bool in the state of a differentiated loop aborts the process, so masks are numbers."""
        n = dr.width(ray.d)
        zero = dr.zeros(mi.UInt32, n)
        alive = dr.select(active, mi.UInt32(1), mi.UInt32(0)) + zero
        o, d = ray.o + dr.zeros(mi.Point3f, n), ray.d + dr.zeros(mi.Vector3f, n)
        return o, d, mi.Spectrum(1) + dr.zeros(mi.Spectrum, n), zero, alive, dr.zeros(mi.Spectrum, n), mi.UInt32(zero)

    @staticmethod
    def _only(branches):
        """The branches as one, where no lane has more than one of them."""
        o, d, beta, goes_on = branches[0]
        for other_o, other_d, other_beta, other in branches[1:]:
            o, d, beta = dr.select(other, other_o, o), dr.select(other, other_d, d), dr.select(other, other_beta, beta)
            goes_on = goes_on | other
        return o, d, beta, goes_on

    # One ray and the surface that it meets --------------------------------------------------------

    def _step(self, ray, beta, depth, active):
        """Traces `ray`, the `depth`-th of its path, of throughput `beta`.

        Returns the light that it brings, whether it meets anything, and the rays that
        go on: a list of (origin, direction, throughput, lanes).
        """
        si = self.geometry.hit(ray, depth == 0, active)
        hit = active & si.is_valid()
        escaped = active & (hit == False)  # noqa: E712  (~ is no logical not on a Python bool)
        light, seen = mi.Spectrum(0), hit
        if self.background is not None:
            escaped = escaped & (depth > 0) if self.hide_background else escaped
            light = dr.select(escaped, beta * self.background.eval(si, escaped), 0)
            seen = seen | escaped
        if self.most_hits == 0 or not (self.jit or hit):
            return light, seen, []

        si.p = self.surfaces.refine(si, ray)
        if self.isotropic:
            # Any frame about the normal serves: this one needs no derivatives of the surface.
            si.sh_frame = mi.Frame3f(si.sh_frame.n)
            si.wi = si.to_local(-ray.d)
        shaded = hit & (depth < self.most_hits)
        material = self.materials.at(si, shaded, is_front(si, -ray.d) if self.sided else None)
        tolerance = self.surfaces.tolerance(si, shaded)
        branches = self._reflect(si, material, tolerance, beta, depth, shaded) if self.follows else []
        last = self._ends(depth, shaded, branches) if self.fades else None
        return light + beta * self._shade(si, material, tolerance, last, shaded), seen, branches

    def _ends(self, depth, active, branches):
        """The lanes on which a chain of mirrors ends by a limit: the course takes the last mirror away."""
        last = depth == self.most_hits - 1
        if self.unlimited and branches:
            # Nothing goes on, and something would, were it not too faint.
            would, does = mi.Mask(False), mi.Mask(False)
            for _, _, weight, goes_on in branches:
                would = would | (dr.max(mi.unpolarized_spectrum(weight)) > 0)
                does = does | goes_on
            last = last | (would & (does == False))  # noqa: E712
        return active & last

    def _shade(self, si, material, tolerance, last, active):
        """Light from the lights and the ambient term, toward the viewer; on the lanes `last` (None: on none) without
        the mirror of a `mirrorblend`."""
        light = dr.zeros(mi.Spectrum, dr.width(si)) if self.jit else mi.Spectrum(0)
        if self.ambient is not None:
            reflectance = self.materials.diffuse_reflectance(material, si, last, active)
            ambient = self.ambient.value(si, active) * reflectance
            light += mi.depolarizer(dr.select(active, ambient, 0))
        if self.lights.count == 0:
            return light
        if not self.lights.few:
            return light + self._from_lights(si, material, tolerance, last, active)
        for i in range(self.lights.count):
            light = light + self._from_light(i, si, material, tolerance, last, active)
        return light

    @dr.syntax
    def _from_lights(self, si, material, tolerance, last, active):
        count = self.lights.limit
        light = dr.zeros(mi.Spectrum, dr.width(si)) if self.jit else mi.Spectrum(0)
        i = mi.UInt32(0)
        while dr.hint(i < count, max_iterations=-1, exclude=[count], label="lights"):
            light += self._from_light(i, si, material, tolerance, last, active)
            i += 1
        return light

    def _from_light(self, i, si, material, tolerance, last, active):
        direction, distance, intensity, active = self.lights.sample(i, si, active)
        wo = si.to_local(direction)
        value = self.materials.eval(material, si, wo, last, active)
        if self.course:
            intensity = intensity * dr.pi
        elif self.lights.any_positional:
            intensity = intensity * dr.select(distance < dr.inf, 1 / dr.square(distance), 1)
        value = value * mi.depolarizer(intensity)
        if not self.gradients:
            # A light that adds nothing needs no shadow ray; but nothing can have a derivative.
            active = active & (dr.max(dr.abs(mi.unpolarized_spectrum(value))) > 0)
        if self.shadows:
            shadow = self.surfaces.shadow_ray(si, direction, distance, tolerance)
            active = active & (self.geometry.blocked(shadow, active) == False)  # noqa: E712
        return dr.select(active, value, 0)

    def _reflect(self, si, material, tolerance, beta, depth, active):
        """The rays that go on from `si`, one for each kind of delta lobe."""
        active = active & (depth + 1 < self.most_rays)
        branches = []
        for direction, weight, lanes in self.materials.mirrors(material, si, active):
            onward = beta * weight
            lanes = lanes & (dr.max(mi.unpolarized_spectrum(onward)) > self.faintest)
            branches.append((self.surfaces.leave(si, direction, tolerance)[0], direction, onward, lanes))
        return branches


def _fainter(a, b):
    """Of two branches the one to follow, (o, d, beta, lanes), and the one to let wait."""
    power_a, power_b = (dr.max(mi.unpolarized_spectrum(beta)) for beta in (a[2], b[2]))
    first = a[3] & (~b[3] | (power_a <= power_b))
    follow = [dr.select(first, x, y) for x, y in zip(a[:3], b[:3], strict=True)]
    wait = [dr.select(first, y, x) for x, y in zip(a[:3], b[:3], strict=True)]
    return *follow, a[3] | b[3], *wait, a[3] & b[3]
