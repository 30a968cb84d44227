"""Traces the rays of one camera through a scene, and records what they meet as `hits`.

Rays, shadows and mirrors are those of `whitted`, by the same `lights` and `spawn`; the formulas are in `shading.py`.
"""

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from ..tracing.facing import is_front
from ..tracing.geometry import Geometry
from ..tracing.lights import Lights
from ..tracing.spawn import Surfaces
from ..tracing.tracer import FAINTEST, MOST_BOUNCES
from .hits import Bounce, Hits, Light, Undiagnosable
from .known_surfaces import KnownSurface, name_of

# A convex surface hides a light behind it once; others are looked through this often.
OWN_HITS = 3


class Stage:
    """A loaded scene, ready to be traced. Raises `Undiagnosable` for what cannot be shaded by `shading.py`."""

    def __init__(self, scene, directions: Sequence[Sequence[float]] = ()):
        """`directions`: the vectors of the directional lights as they stand in the file."""
        _check_variant()
        self.scene, self.integrator = scene, scene.integrator()
        if self.integrator.depth == 1:
            raise Undiagnosable("with max_depth = 1 nothing is shaded")
        self.lights, self.surfaces, self.geometry = Lights(scene), Surfaces(scene), Geometry(scene)
        self.background = scene.environment()
        self.directions = [np.array(d, float) for d in directions]
        found = {}
        for number, shape in enumerate(scene.shapes(), 1):
            bsdf = shape.bsdf()
            if bsdf is None or shape.class_name() == "Instance":
                raise Undiagnosable(f"the shape '{shape.id()}' is not one that diagnosis knows")
            found.setdefault(bsdf.ptr, (bsdf, name_of(shape, bsdf, number)))
        self.surfaces_of = [(mi.BSDFPtr(bsdf), KnownSurface(bsdf, name)) for bsdf, name in found.values()]
        self.materials = [surface.material for _, surface in self.surfaces_of]
        spheres = [shape for shape in scene.shapes() if shape.class_name() == "Sphere"]
        self.radii = [(mi.ShapePtr(s), 0.5 * float(s.bbox().max.x - s.bbox().min.x)) for s in spheres]

    @property
    def most_hits(self) -> int:
        """How many surfaces of a path are shaded."""
        return self.integrator.depth - 1 if self.integrator.depth > 0 else MOST_BOUNCES + 1

    def trace(self, sensor, positions: np.ndarray, raw_mirrors: bool = False) -> Hits:
        """Trace camera rays through `positions`, (count, 2) in pixels from the top left of the picture.

        `raw_mirrors`: mirror directions are formed with normals that are not normalised.
        """
        ray, eye, lengths = self._camera_rays(sensor, positions)
        index, bounces, backgrounds = np.arange(len(positions)), [], []
        throughput = np.ones(len(positions))
        for depth in range(self.most_hits):
            bounce, background, ray = self._bounce(ray, eye, index, depth, raw_mirrors)
            eye = ray.o
            seen = np.zeros((len(positions), 3))
            seen[index] = background
            backgrounds.append(seen)
            bounces.append(bounce)
            throughput[bounce.ray] *= bounce.km.max(axis=-1)
            index = bounce.ray[mirroring(bounce)]
            if len(index) == 0 or throughput[index].max() < FAINTEST:
                break
        ambient = self.integrator.ambient
        colour = (
            np.zeros(3)
            if ambient.left_out
            else _array(mi.Color3f(ambient.value(dr.zeros(mi.SurfaceInteraction3f), True)))[0]
        )
        return Hits(len(positions), tuple(bounces), tuple(backgrounds), lengths, colour)

    @staticmethod
    def _camera_rays(sensor, positions: np.ndarray):
        """Rays, the point from where distances count, and how far away each meets a plane at distance 1."""
        width, height = (int(side) for side in sensor.film().crop_size())
        sample = mi.Point2f(positions[:, 0] / width, positions[:, 1] / height)
        ray, _ = sensor.sample_ray_differential(
            time=sensor.shutter_open(), sample1=0, sample2=sample, sample3=mi.Point2f(0.5)
        )
        axis = dr.normalize(sensor.world_transform() @ mi.Vector3f(0, 0, 1))
        lengths = 1 / _array(dr.abs(dr.dot(axis, ray.d)) + dr.zeros(mi.Float, len(positions)))[:, 0]
        # Rays of a perspective camera begin at the near clipping plane, distances in the eye.
        perspective = sensor.class_name() == "PerspectiveCamera"
        eye = sensor.world_transform() @ mi.Point3f(0) if perspective else ray.o
        return mi.Ray3f(ray.o, ray.d, ray.maxt, ray.time, ray.wavelengths), eye, lengths

    def _bounce(self, ray, eye, index, depth, raw_mirrors):
        """The hits of `ray`, what the rest of them sees, and the mirrored rays."""
        n = len(index)
        si = self.geometry.hit(ray, depth == 0, True)
        valid = si.is_valid() & dr.full(mi.Bool, True, n)
        background = np.zeros((n, 3))
        if self.background is not None and not (depth == 0 and self.integrator.hide_emitters):
            background = _array(dr.select(valid, 0, mi.Color3f(self.background.eval(si, ~valid))), n)
        si.p = self.surfaces.refine(si, ray)
        tolerance = self.surfaces.tolerance(si, valid)
        # Once for all that is asked about these hits.
        dr.eval(si, tolerance, valid)

        hit = np.array(valid)
        columns, two_sided = self._surface_columns(si, valid, n)
        radius = self._radius(si)
        front = is_front(si, -ray.d)
        # A surface with two sides that is seen from behind turns its normal to the viewer.
        facing = mi.Vector3f(si.sh_frame.n) * dr.select(mi.Bool(two_sided) & ~front, -1, 1)
        lights = tuple(self._light(i, si, tolerance, valid, hit) for i in range(self.lights.count))
        bounce = Bounce(
            ray=index[hit], normal=_unit(_array(facing, n)[hit]), normal_length=_array(radius, n)[hit, 0],
            front=(np.array(front) | two_sided)[hit],
            view=_unit(_array(-ray.d, n)[hit]), distance=_array(dr.norm(si.p - eye), n)[hit, 0],
            lights=lights,
            **{name: column[hit] for name, column in columns.items()},
        )  # fmt: skip
        onward = np.flatnonzero(hit)[mirroring(bounce)]
        return bounce, background, self._mirrored(si, ray, facing, tolerance, radius if raw_mirrors else None, onward)

    def _radius(self, si):
        """The radius of the sphere that was hit; 1 on other shapes."""
        radius = mi.Float(1)
        for shape, value in self.radii:
            radius = dr.select(si.shape == shape, value, radius)
        return radius

    def _mirrored(self, si, ray, normal, tolerance, length, onward):
        """The mirrored rays of the lanes `onward`; `length`: of normals that are not normalised, or None."""
        normal = normal if length is None else normal * length
        direction = dr.normalize(normal * (2 * dr.dot(normal, -ray.d)) + ray.d)
        origin = self.surfaces.leave(si, direction, tolerance)[0]
        if length is not None:
            # Such a direction can lead into the surface, which is then met from outside.
            origin = mi.Point3f(si.p + mi.Vector3f(si.n) * dr.sign(dr.dot(si.n, -ray.d)) * tolerance)
        lanes = mi.UInt32(onward)
        origin, direction = dr.gather(mi.Point3f, origin, lanes), dr.gather(mi.Vector3f, direction, lanes)
        dr.eval(origin, direction)
        return mi.Ray3f(origin, direction)

    def _surface_columns(self, si, valid, n):
        """The materials' constants at each lane, and whether the surface has two sides."""
        names = {"material": 1, "diffuse": 3, "specular": 3, "cosine": 1, "exponent": 1, "km": 3}
        columns: dict[str, np.ndarray] = {name: np.zeros((n, channels)) for name, channels in names.items()}
        two_sided = np.zeros(n, bool)
        bsdf = si.bsdf()
        for number, (pointer, surface) in enumerate(self.surfaces_of):
            here = np.array(valid & (bsdf == pointer) & dr.full(mi.Bool, True, n))
            if not here.any():
                continue
            values = surface.evaluate(si, mi.Bool(here))
            for name, value in {**values, "material": mi.Float(number)}.items():
                columns[name][here] = _array(value, n)[here]
            two_sided[here] = surface.two_sided
        for name in ("material", "cosine", "exponent"):
            columns[name] = columns[name][:, 0]
        columns["material"], columns["cosine"] = columns["material"].astype(int), columns["cosine"] > 0
        return columns, two_sided

    def _light(self, i, si, tolerance, valid, hit) -> Light:
        n = len(hit)
        direction, distance, intensity, has = self.lights.sample(i if self.lights.few else mi.UInt32(i), si, valid)
        shadow = self.surfaces.shadow_ray(si, direction, distance, tolerance)
        past = self.surfaces.shadow_ray(si, direction, dr.inf, tolerance)
        blocked = [self.geometry.blocked(ray, has) for ray in (shadow, past)]
        blocked.append(self._blocked_by_others(shadow, si.shape, has))
        dr.eval(direction, distance, intensity, has, blocked)
        visible = [_array(mi.Float(has & (b == False)), n)[hit, 0] > 0 for b in blocked]  # noqa: E712
        toward, distance = _unit(_array(direction, n)[hit]), _array(distance, n)[hit, 0]
        at_infinity = np.isinf(distance)
        length = np.where(at_infinity, self._length_in_file(toward), distance)
        falloff = np.where(at_infinity, 1, 1 / np.where(at_infinity, 1, distance) ** 2)
        return Light(toward, length, falloff, _array(mi.Color3f(intensity), n)[hit], *visible)

    def _length_in_file(self, toward: np.ndarray) -> float:
        """The length of a directional light's vector; 1 where the file says it in another way."""
        for direction in self.directions:
            length = np.linalg.norm(direction)
            if len(toward) and length > 0 and np.allclose(-direction / length, toward[0], atol=1e-5):
                return float(length)
        return 1.0

    def _blocked_by_others(self, ray, own, active):
        """Whether a shadow ray meets another shape than the one that it starts on."""
        blocked, reached = mi.Bool(False), mi.Float(0)
        for _ in range(OWN_HITS):
            si = self.geometry.hit(ray, False, active)
            met = active & si.is_valid()
            blocked = blocked | (met & (si.shape != own))
            active = met & (si.shape == own)
            reached = self.surfaces.tolerance(si, active) * 4
            ray = mi.Ray3f(ray(si.t + reached), ray.d, ray.maxt - si.t - reached, ray.time, ray.wavelengths)
        return blocked


def _check_variant() -> None:
    if not dr.is_jit_v(mi.Float) or not mi.is_rgb or mi.is_polarized:
        raise Undiagnosable(f"diagnosis needs a variant like llvm_ad_rgb, not {mi.variant()}")


def _array(value, n: int | None = None) -> np.ndarray:
    """A Dr.Jit number or vector as (n, channels), float64."""
    array = np.atleast_2d(np.array(value, np.float64))
    array = array.T if array.shape[0] != 1 or array.shape[1] == 1 else array.reshape(-1, 1)
    return array if n is None else np.broadcast_to(array, (n, array.shape[1]))


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def mirroring(bounce: Bounce) -> np.ndarray:
    """Whether a mirrored ray goes on from each hit, (n,)."""
    return (bounce.km.max(axis=-1) > 0) & bounce.front
