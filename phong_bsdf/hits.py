"""What the rays of one camera meet, bounce by bounce, as NumPy arrays: traced once, to be shaded in many ways.

Rays, shadows and mirrors are those of `whitted`, by the same `lights` and `spawn`; the formulas are in `shading.py`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from .lights import Lights
from .spawn import Surfaces

# A convex surface hides a light behind it once; others are looked through this often.
OWN_HITS = 3


class Undiagnosable(ValueError):
    """A scene that cannot be shaded here; the words say why."""


@dataclass(frozen=True)
class Material:
    """One BSDF of the scene; colours and exponents that are textures are None."""

    name: str
    lobe: str
    """`phong`, `blinnphong`, or `diffuse`, which has no highlight."""
    specular: tuple[float, ...] | None
    exponent: float | None


@dataclass(frozen=True)
class Light:
    """One light as the hits of a bounce see it; arrays over the hits."""

    toward: np.ndarray
    """Unit vectors, (n, 3)."""
    length: np.ndarray
    """Of the vector that points to the light before it is normalised."""
    falloff: np.ndarray
    """1 / distance^2; 1 for directional lights."""
    intensity: np.ndarray
    visible: np.ndarray
    """Whether nothing is between surface and light."""
    visible_past: np.ndarray
    """Whether nothing is on the ray, even behind the light."""
    visible_through: np.ndarray
    """Whether nothing but the surface itself is between."""


@dataclass(frozen=True)
class Bounce:
    """The hits at one depth; arrays over them."""

    ray: np.ndarray
    """Which camera ray led here."""
    material: np.ndarray
    """Number of the `Material`."""
    normal: np.ndarray
    """Unit shading normals, (n, 3)."""
    normal_length: np.ndarray
    """Of the vector from the centre of the sphere that was hit; 1 on other shapes."""
    view: np.ndarray
    """Unit vectors back along the ray, (n, 3)."""
    distance: np.ndarray
    """To where the ray came from."""
    diffuse: np.ndarray
    specular: np.ndarray
    """Height of the highlight, (n, 3)."""
    cosine: np.ndarray
    """Whether the highlight carries the factor n.l: with reflectances, not with coefficients."""
    exponent: np.ndarray
    km: np.ndarray
    lights: tuple[Light, ...]


@dataclass(frozen=True)
class Hits:
    """All bounces of some camera rays."""

    count: int
    """Number of camera rays."""
    bounces: tuple[Bounce, ...]
    background: tuple[np.ndarray, ...]
    """What the rays of each depth see that meet nothing, (count, 3), 0 elsewhere."""
    ray_length: np.ndarray
    """Of the camera rays' vectors that end in a plane at distance 1, (count,)."""
    ambient: np.ndarray


class Stage:
    """A loaded scene, ready to be traced. Raises `Undiagnosable` for what cannot be shaded by `shading.py`."""

    def __init__(self, scene, directions: Sequence[Sequence[float]] = ()):
        """`directions`: the vectors of the directional lights as they stand in the file."""
        _check_variant()
        self.scene = scene
        self.integrator = scene.integrator()
        self.lights, self.surfaces = Lights(scene), Surfaces(scene)
        self.background = scene.environment()
        self.directions = [np.array(d, float) for d in directions]
        found = {}
        for number, shape in enumerate(scene.shapes(), 1):
            bsdf = shape.bsdf()
            if bsdf is None or shape.class_name() == "Instance":
                raise Undiagnosable(f"the shape '{shape.id()}' is not one that diagnosis knows")
            found.setdefault(bsdf.ptr, (bsdf, _name(shape, bsdf, number)))
        self.surfaces_of = [(mi.BSDFPtr(bsdf), _Surface(bsdf, name)) for bsdf, name in found.values()]
        self.materials = [surface.material for _, surface in self.surfaces_of]
        spheres = {
            s: 0.5 * float(s.bbox().max.x - s.bbox().min.x) for s in scene.shapes() if s.class_name() == "Sphere"
        }
        self.radii = [(mi.ShapePtr(shape), radius) for shape, radius in spheres.items() if radius != 1]

    @property
    def most_hits(self) -> int:
        """How many surfaces of a path are shaded."""
        # A path that never ends has faded long before.
        return self.integrator.depth - 1 if self.integrator.depth > 0 else 64

    def trace(self, sensor, positions: np.ndarray, raw_mirrors: bool = False) -> Hits:
        """Trace camera rays through `positions`, (count, 2) in pixels from the top left of the picture.

        `raw_mirrors`: mirror directions are formed with normals that are not normalised.
        """
        width, height = (int(side) for side in sensor.film().crop_size())
        sample = mi.Point2f(positions[:, 0] / width, positions[:, 1] / height)
        ray, _ = sensor.sample_ray_differential(
            time=sensor.shutter_open(), sample1=0, sample2=sample, sample3=mi.Point2f(0.5)
        )
        axis = sensor.world_transform() @ mi.Vector3f(0, 0, 1)
        lengths = 1 / _array(dr.abs(dr.dot(dr.normalize(axis), ray.d)) + dr.zeros(mi.Float, len(positions)))[:, 0]
        index, bounces, backgrounds = np.arange(len(positions)), [], []
        ray = mi.Ray3f(ray.o, ray.d, ray.maxt, ray.time, ray.wavelengths)
        eye = ray.o
        if sensor.class_name() == "PerspectiveCamera":
            # Where distances begin; rays begin at the near clipping plane.
            eye = sensor.world_transform() @ mi.Point3f(0)
        for depth in range(self.most_hits):
            bounce, background, ray = self._bounce(ray, eye, index, depth, raw_mirrors)
            eye = ray.o
            seen = np.zeros((len(positions), 3))
            seen[index] = background
            backgrounds.append(seen)
            bounces.append(bounce)
            index = bounce.ray[(bounce.km.max(axis=-1) > 0) & (_dot(bounce.normal, bounce.view) > 0)]
            if len(index) == 0:
                break
        ambient = self.integrator.ambient
        colour = np.zeros(3) if ambient.left_out else _array(mi.Color3f(ambient.value(_nowhere(), True)))[0]
        return Hits(len(positions), tuple(bounces), tuple(backgrounds), lengths, colour)

    def _bounce(self, ray, eye, index, depth, raw_mirrors):
        """The hits of `ray`, what the rest of them sees, and the mirrored rays."""
        n = len(index)
        si = self.scene.ray_intersect(ray, mi.RayFlags.All, coherent=depth == 0, active=True)
        valid = si.is_valid() & dr.full(mi.Bool, True, n)
        background = np.zeros((n, 3))
        if self.background is not None and not (depth == 0 and self.integrator.hide_emitters):
            background = _array(dr.select(valid, 0, mi.Color3f(self.background.eval(si, ~valid))), n)
        si.p = self.surfaces.refine(si, ray)
        tolerance = self.surfaces.tolerance(si, valid)
        # Once for all that is asked about these hits.
        dr.eval(si, tolerance, valid)

        hit = np.array(valid)
        distance = _array(dr.norm(si.p - eye), n)[hit, 0]
        view = _unit(_array(-ray.d, n)[hit])
        columns, flips = self._surface_columns(si, valid, n)
        # A surface with two sides turns its normal to the viewer.
        normal = _unit(_array(mi.Vector3f(si.sh_frame.n), n)[hit])
        normal = np.where(flips[hit] & (_dot(normal, view) < 0)[:, None], -normal, normal)
        radius = mi.Float(1)
        for shape, r in self.radii:
            radius = dr.select(si.shape == shape, r, radius)
        lights = tuple(self._light(i, si, tolerance, valid, hit) for i in range(self._light_count()))
        bounce = Bounce(
            ray=index[hit], normal=normal, view=view, distance=distance,
            lights=tuple(light for light in lights if light is not None),
            normal_length=_array(radius, n)[hit, 0], **{name: column[hit] for name, column in columns.items()},
        )  # fmt: skip

        # Where the mirror looks, from the normal as the kernel has it.
        raw = radius if raw_mirrors else mi.Float(1)
        facing = mi.Vector3f(si.sh_frame.n) * dr.select(mi.Bool(flips[:, 0]), dr.sign(si.wi.z), 1) * raw
        direction = dr.normalize(facing * (2 * dr.dot(facing, -ray.d)) + ray.d)
        onward = np.zeros(n, bool)
        onward[hit] = (bounce.km.max(axis=-1) > 0) & (_dot(normal, view) > 0)
        lanes = mi.UInt32(np.flatnonzero(onward))
        # Such a direction can lead into the surface, which is then met from outside.
        outward = mi.Vector3f(si.n) * dr.sign(dr.dot(si.n, -ray.d)) * tolerance
        origin = mi.Point3f(si.p + outward) if raw_mirrors else self.surfaces.leave(si, direction, tolerance)[0]
        origin, direction = dr.gather(mi.Point3f, origin, lanes), dr.gather(mi.Vector3f, direction, lanes)
        dr.eval(origin, direction)
        return bounce, background, mi.Ray3f(origin, direction)

    def _surface_columns(self, si, valid, n):
        """The materials' constants at each lane, and whether the surface has two sides."""
        names = {"material": 1, "diffuse": 3, "specular": 3, "cosine": 1, "exponent": 1, "km": 3}
        columns = {name: np.zeros((n, channels)) for name, channels in names.items()}
        flips = np.zeros((n, 1), bool)
        bsdf = si.bsdf()
        for number, (pointer, surface) in enumerate(self.surfaces_of):
            here = np.array(valid & (bsdf == pointer) & dr.full(mi.Bool, True, n))
            if not here.any():
                continue
            values = surface.evaluate(si, mi.Bool(here))
            for name, value in {**values, "material": mi.Float(number)}.items():
                columns[name][here] = _array(value, n)[here]
            flips[here] = surface.two_sided
        for name in ("material", "cosine", "exponent"):
            columns[name] = columns[name][:, 0]
        columns["material"], columns["cosine"] = columns["material"].astype(int), columns["cosine"] > 0
        return columns, flips

    def _light_count(self) -> int:
        if self.lights.count == 0:
            return 0
        return self.lights.count if self.lights.few else len(self.scene.emitters())

    def _light(self, i, si, tolerance, valid, hit) -> Light | None:
        if not self.lights.few and i == self.lights.skip:
            return None
        n = len(hit)
        direction, distance, intensity, has = self.lights.sample(i if self.lights.few else mi.UInt32(i), si, valid)
        shadow = self.surfaces.shadow_ray(si, direction, distance, tolerance)
        past = self.surfaces.shadow_ray(si, direction, dr.inf, tolerance)
        blocked = [self.scene.ray_test(ray, coherent=False, active=has) for ray in (shadow, past)]
        blocked.append(self._blocked_by_others(shadow, si.shape, has))
        dr.eval(direction, distance, intensity, has, blocked)
        visible = [_array(mi.Float(has & (b == False)), n)[hit, 0] > 0 for b in blocked]  # noqa: E712
        toward, distance = _unit(_array(direction, n)[hit]), _array(distance, n)[hit, 0]
        at_infinity = np.isinf(distance)
        length = np.where(at_infinity, self._length_in_file(toward), distance)
        falloff = np.where(at_infinity, 1, 1 / np.where(at_infinity, 1, distance) ** 2)
        return Light(toward, length, falloff, _array(mi.Color3f(intensity), n)[hit], *visible)

    def _length_in_file(self, toward: np.ndarray) -> float:
        """Of a directional light's vector; 1 where the file says it in another way."""
        for direction in self.directions:
            length = np.linalg.norm(direction)
            if len(toward) and length > 0 and np.allclose(-direction / length, toward[0], atol=1e-5):
                return float(length)
        return 1.0

    def _blocked_by_others(self, ray, own, active):
        """Whether a shadow ray meets another shape than the one that it starts on."""
        blocked, reached = mi.Bool(False), mi.Float(0)
        for _ in range(OWN_HITS):
            si = self.scene.ray_intersect(ray, mi.RayFlags.Minimal, coherent=False, active=active)
            met = active & si.is_valid()
            blocked = blocked | (met & (si.shape != own))
            active = met & (si.shape == own)
            reached = self.surfaces.tolerance(si, active) * 4
            ray = mi.Ray3f(ray(si.t + reached), ray.d, ray.maxt - si.t - reached, ray.time, ray.wavelengths)
        return blocked


class _Surface:
    """A BSDF as this module can read it: a lobe or a diffuse surface, perhaps in a mirrorblend, perhaps twosided."""

    def __init__(self, bsdf, name: str):
        self.two_sided, self.km = False, None
        while True:
            nested = _children(bsdf)
            if bsdf.class_name() == "TwoSidedBRDF" and len(nested) == 1:
                self.two_sided, bsdf = True, nested[0]
            elif type(bsdf).__name__ == "MirrorBlend" and self.km is None:
                self.km, bsdf = bsdf.km, bsdf.nested
            else:
                break
        self.bsdf, self.lobe = bsdf, getattr(bsdf, "NAME", None)
        if self.lobe is None and bsdf.class_name() != "SmoothDiffuse":
            raise Undiagnosable(f"the surface '{name}' is a {bsdf.class_name()}; diagnosis knows phong, blinnphong, "
                                "diffuse, mirrorblend and twosided")  # fmt: skip
        specular = exponent = None
        if self.lobe and not bsdf.reflectances:
            specular, exponent = bsdf.specular.constant(), bsdf.exponent.constant()
        self.material = Material(name, self.lobe or "diffuse", specular, exponent and exponent[0])

    def evaluate(self, si, active) -> dict[str, object]:
        km = mi.Color3f(0) if self.km is None else mi.Color3f(self.km.value(si, active))
        diffuse = mi.Color3f(self.bsdf.eval_diffuse_reflectance(si, active))
        if self.lobe is None:
            return {"diffuse": diffuse, "km": km}
        specular, exponent = mi.Color3f(self.bsdf.specular.value(si, active)), self.bsdf.exponent.value_1(si, active)
        if self.bsdf.reflectances:
            specular *= self.bsdf.lobe.normalization(exponent) * dr.pi * self.bsdf.scale
        return {
            "diffuse": diffuse, "specular": specular, "exponent": mi.Float(exponent), "km": km,
            "cosine": mi.Float(self.bsdf.reflectances),
        }  # fmt: skip


def _check_variant() -> None:
    if not dr.is_jit_v(mi.Float) or not mi.is_rgb or mi.is_polarized:
        raise Undiagnosable(f"diagnosis needs a variant like llvm_ad_rgb, not {mi.variant()}")


def _name(shape, bsdf, number: int) -> str:
    """What a user calls this surface."""
    for name in (bsdf.id(), shape.id()):
        if name and not name.startswith(("_unnamed", "__")) and not name.endswith("]"):
            return name
    return f"{shape.class_name().lower()} {number}"


def _children(bsdf) -> list:
    found = []

    class Callback(mi.TraversalCallback):
        def put(self, name, value, *_):
            found.extend([value] * isinstance(value, mi.BSDF))

    bsdf.traverse(Callback())
    return found


def _nowhere():
    return dr.zeros(mi.SurfaceInteraction3f)


def _array(value, n: int | None = None) -> np.ndarray:
    """A Dr.Jit number or vector as (n, channels), float64."""
    array = np.atleast_2d(np.array(value, np.float64))
    array = array.T if array.shape[0] != 1 or array.shape[1] == 1 else array.reshape(-1, 1)
    return array if n is None else np.broadcast_to(array, (n, array.shape[1]))


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("ij,ij->i", a, b)
