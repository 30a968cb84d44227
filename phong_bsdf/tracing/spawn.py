"""Hits, and the rays that leave them, as exact as float32 allows and no further off.

Mitsuba starts a secondary ray 9e-5 (1 + |p|) off the surface: a tenth of an object of
size 1e-3, yet too little on a sphere of radius 5000, whose shadow test in float32
misses the surface by up to 1e-3. The error of a hit grows with the size of the shape
that was hit and with its coordinates; so does the offset here.
"""

import drjit as dr
import mitsuba as mi

from .needs import axes, linear_part

# Rounding errors that a hit and the test of the ray that leaves it add up, in units of
# 2^-24 (coordinates + size of the shape). A sphere's shadow test, r^2 - |o - c|^2 in
# float32, needs about 3; Embree's triangles and the other shapes less.
ROUNDINGS = 4 * 2**-24

# Cosine below which a ray is moved off the surface along the normal rather than along itself.
STEEPEST = 0.1

# Instances that stretch more than this, so that a sphere becomes a needle, may have specks of shadow.
MOST_STRETCH = 16.0

# A sphere this many times larger than the smallest shape, or than the camera's distance
# from it, is hit so imprecisely that the hit is worth refining.
LARGE = 50


class Surfaces:
    """The sizes of the shapes of `scene`, and hits and ray origins that respect them."""

    def __init__(self, scene, seen=None):
        seen = seen or Seen()
        shapes = scene.shapes()
        kinds = [shape.class_name() for shape in shapes]
        boxes = seen.boxes(shapes)
        extents = [_extent(box) for box in boxes]
        curvatures = [_curvature(s) if kind == "Cylinder" else 0.0 for s, kind in zip(shapes, kinds, strict=True)]
        # The shapes inside of instances are not listed: they may be as large as any.
        hidden = "Instance" in kinds
        self.stretch = max(
            (_stretch(s) for s, kind in zip(shapes, kinds, strict=True) if kind == "Instance"), default=1
        )
        self.extent = seen.per_shape("extent", scene, extents, hidden)
        self.curvature = seen.per_shape("curvature", scene, curvatures, hidden)
        # The box of a camera is its position, known without reading an array.
        cameras = [sensor.bbox().min for sensor in scene.sensors()] if "Sphere" in kinds else []
        nearest = min(extents, default=0.0)
        self.spheres = [
            _Sphere(shape)
            for shape, kind, box in zip(shapes, kinds, boxes, strict=True)
            if kind == "Sphere" and _is_large(box, nearest, cameras)
        ]

    def refine(self, si, ray):
        """The hit point of `ray`, moved along it onto the surface where that is a large sphere."""
        p = si.p
        for sphere in self.spheres:
            # Not from si.p, which scalar variants have moved off the ray.
            t = si.t + sphere.correction(ray(si.t), ray.d)
            p = dr.select(is_shape(si, sphere.shape), ray(t), p)
        return p

    def tolerance(self, si, active):
        """Bound on the distance between the hit `si` and the surface that ray tests see, in world units."""
        # The ray's length stands for the coordinates of its origin, which may be far from the surface.
        size = dr.max(dr.abs(si.p)) + si.t + self.extent.at(si, active)
        if self.curvature.largest > 0:
            # A cylinder is intersected from where the ray starts: its error grows with the distance squared.
            size += dr.square(si.t) * self.curvature.at(si, active)
        # An instance is traced in its own space, where a ray is longer by what it squeezes.
        return ROUNDINGS * (self.stretch**2 * size if self.stretch > 1 else size)

    @staticmethod
    def leave(si, direction, tolerance):
        """Start of a ray that leaves the hit `si` in `direction`, and how far along the ray from the hit that is."""
        cos = dr.dot(si.n, direction)
        # Along the ray, which stays the same ray; at grazing angles, where that would lead far, along the normal.
        along = tolerance / dr.maximum(dr.abs(cos), STEEPEST)
        return mi.Point3f(si.p + direction * along + si.n * (dr.mulsign(tolerance, cos) - along * cos)), along

    def shadow_ray(self, si, direction, distance, tolerance):
        """Ray from `si` toward a light at `distance`; a surface that the light touches does not block it."""
        o, along = self.leave(si, direction, tolerance)
        maxt = dr.maximum(distance * (1 - 2 * ROUNDINGS) - along - tolerance, 0)
        return mi.Ray3f(o, direction, maxt, si.time, si.wavelengths)


class Seen:
    """What is looked at once of the shapes of the scene that was rendered last.

    While an array is kept, no other gets its number.
    """

    def __init__(self):
        self.of_meshes, self.numbers = {}, {}

    def boxes(self, shapes):
        """The bounding boxes of `shapes`."""
        before, self.of_meshes = self.of_meshes, {}
        return [self._box(shape, before) for shape in shapes]

    def per_shape(self, name, scene, values, hidden):
        """`PerShape` of these values, the one of the last rendering if they are the same."""
        if not dr.is_jit_v(mi.Float) or dr.flag(dr.JitFlag.FreezingScope):
            return PerShape(scene, values, hidden)
        pointers = scene.shapes_dr()
        key = (pointers.index, tuple(values), hidden)
        if name not in self.numbers or self.numbers[name][0] != key:
            self.numbers[name] = key, pointers, PerShape(scene, values, hidden)
        return self.numbers[name][2]

    def _box(self, shape, before):
        box = shape.bbox()
        if box.valid():
            return box
        # Mitsuba joins meshes of equal BSDFs, and forgets the box.
        positions = mi.traverse(shape)["vertex_positions"]
        key = positions.index if dr.is_jit_v(positions) else None
        if key is None or key not in before:
            box = _box_of(positions)
            before = {key: (box, dr.detach(positions))}
        self.of_meshes[key] = before[key]
        return before[key][0]


def _box_of(positions):
    # Slow to import, and needed here only.
    import numpy as np

    points = np.array(positions).reshape(-1, 3)
    return mi.ScalarBoundingBox3f(points.min(axis=0).tolist(), points.max(axis=0).tolist())


class PerShape:
    """A number for each shape of `scene`; one for all where they are of one order of magnitude, or some `hidden`."""

    # Exceptions from the smallest number that are compared one by one; more are looked up in a table.
    FEW = 8

    def __init__(self, scene, values, hidden):
        self.largest, self.smallest = max(values, default=1.0), min(values, default=1.0)
        self.table, self.exceptions = None, []
        others = [i for i, value in enumerate(values) if value > 8 * self.smallest]
        self.uniform = hidden or not others
        if self.uniform:
            return
        jit = dr.is_jit_v(mi.Float)
        ids = shape_numbers(scene) if jit else scene.shapes()
        if jit and len(others) > self.FEW:
            table = [0.0] * (max(ids) + 1)
            for number, value in zip(ids, values, strict=True):
                table[number] = value
            self.table = mi.Float(table)
        else:
            self.exceptions = [(dr.opaque(mi.UInt32, ids[i]) if jit else ids[i], values[i]) for i in others]

    def at(self, si, active):
        """The number of the shape that was hit."""
        if self.uniform:
            return self.largest
        if self.table is not None:
            return dr.gather(mi.Float, self.table, dr.reinterpret_array(mi.UInt32, si.shape), active)
        value = mi.Float(self.smallest)
        for shape, exception in self.exceptions:
            value = dr.select(is_shape(si, shape), exception, value)
        return value


class _Sphere:
    """A large sphere as the polynomial |p|^2 - 2 p.c + (|c|^2 - r^2), exact near the origin of the world.

    Squaring |p - c| instead would lose everything below r 2^-24. The constant is formed in
    double precision.
    """

    def __init__(self, shape):
        jit = dr.is_jit_v(mi.Float)
        double = dr.float64_array_t(mi.Float) if jit else float
        to_world = mi.traverse(shape)["to_world"]
        self.shape = identity(shape)
        self.center = to_world @ mi.Point3f(0)
        radius = to_world @ mi.Vector3f(1, 0, 0)
        self.constant = mi.Float(sum(double(c) ** 2 - double(r) ** 2 for c, r in zip(self.center, radius, strict=True)))

    def correction(self, p, d):
        """Distance along the unit vector `d` from `p`, close to the sphere, to the sphere."""
        f = dr.squared_norm(p) - 2 * dr.dot(p, self.center) + self.constant
        half_b = dr.dot(p - self.center, d)
        # The root of t^2 + 2 half_b t + f that is closer to 0.
        root = dr.sqrt(dr.maximum(dr.square(half_b) - f, 0))
        t = -f / (half_b + dr.mulsign(root, half_b))
        return dr.select(dr.isfinite(t), t, 0)


def shape_numbers(scene) -> list[int]:
    """In JIT variants the number of each shape of `scene`, by which kernels know it."""
    numbers = dr.reinterpret_array(mi.UInt32, scene.shapes_dr())
    # Without NumPy, which is slow to import; but while a function is recorded, no element can be read.
    return numbers.numpy().tolist() if dr.flag(dr.JitFlag.FreezingScope) else list(numbers)


def identity(shape):
    """What `is_shape` compares: in JIT variants the shape's number, as a value that is no part of the kernel."""
    if not dr.is_jit_v(mi.Float):
        return shape
    return dr.opaque(mi.UInt32, dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0])


def is_shape(si, shape):
    """Whether the shape of this `identity` was hit."""
    hit = si.shape
    return hit == shape if not dr.is_jit_v(mi.Float) else dr.reinterpret_array(mi.UInt32, hit) == shape


def _extent(box) -> float:
    """Largest coordinate or side of a bounding box: what float32 arithmetic on the shape works with."""
    low, high = box.min, box.max
    sides = zip((low.x, low.y, low.z), (high.x, high.y, high.z), strict=True)
    return max(max(-a, b, b - a) for a, b in sides)


def _curvature(cylinder) -> float:
    """1 / radius."""
    radius = dr.norm(mi.traverse(cylinder)["to_world"] @ mi.Vector3f(1, 0, 0))
    return 1 / (radius[0] if dr.is_jit_v(radius) else radius)


def _stretch(instance) -> float:
    """How many times further an instance stretches in one direction than in another, up to `MOST_STRETCH`."""
    lengths = axes(linear_part(instance))
    shortest = max(lengths[2], lengths[0] / MOST_STRETCH)
    return float(lengths[0] / shortest) if shortest > 0 else 1.0


def _is_large(box, nearest: float, cameras) -> bool:
    """Whether the sphere in the box is large beside what is nearest: the smallest shape, or a camera."""
    radius, center = 0.5 * (box.max.x - box.min.x), 0.5 * (box.max + box.min)
    return radius > LARGE * min([nearest, *(abs(dr.norm(camera - center) - radius) for camera in cameras)])
