"""The ray floor: the rays that `whitted` traces in a scene, on plain arrays, without film, sampler and shading.

No renderer built on the same ray tracer can be faster. One kernel makes the camera rays, traces
primary, shadow and mirror rays, and returns one float for each pixel.
"""

from unittest import mock

import drjit as dr
import mitsuba as mi
import numpy as np

from phong_bsdf.tracing.needs import is_delta

# Up to so many lights stand in the kernel one by one, as in `whitted`; more are a loop over arrays.
FEW_LIGHTS = 4

# Up to so many mirrors are compared one by one; more are looked up.
FEW_MIRRORS = 4


class Floor:
    """The ray floor of `scene` at `size` pixels square; `epsilon` is how far off a surface rays start."""

    def __init__(self, scene, size, max_depth, epsilon=1e-4):
        self.scene, self.size, self.epsilon = scene, size, epsilon
        self.most_rays = max_depth - 1
        emitters = [e for e in scene.emitters() if is_delta(e)]
        if any(e.class_name() != "PointLight" for e in emitters):
            raise ValueError("the ray floor knows point lights only")
        positions = np.array([np.ravel(mi.traverse(e)["position"]) for e in emitters], np.float32).reshape(-1, 3)
        self.count = len(positions)
        self.lights = (
            [mi.Point3f(*map(float, p)) for p in positions] if self.count <= FEW_LIGHTS else mi.Point3f(positions.T)
        )
        self.limit = dr.opaque(mi.UInt32, self.count)
        shapes = [s for s in scene.shapes() if mi.has_flag(s.bsdf().flags(), mi.BSDFFlags.Delta)]
        self.mirrors = [dr.opaque(mi.UInt32, self._number(shape)) for shape in shapes]
        self.table = None
        if len(self.mirrors) > FEW_MIRRORS:
            table = np.zeros(max(map(self._number, scene.shapes())) + 1, np.uint32)
            table[[self._number(shape) for shape in shapes]] = 1
            self.table = mi.UInt32(table)

    @staticmethod
    def _number(shape) -> int:
        return int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0])

    def __call__(self):
        """For each pixel, how many lights its path sees."""
        return self._trace(self._step, self.size)

    def signature(self, size):
        """For each pixel a number that tells paths apart: surfaces met, lights seen; NaN where light grazes a surface.

        Two neighbouring pixels of one number show the same surfaces in the same light.
        """
        return self._trace(self._sign, size)

    def _trace(self, step, size):
        o, d = self._camera(size)
        if self.mirrors and self.most_rays > 1:
            return self._follow(step, o, d)
        return step(o, d, mi.UInt32(0), mi.Bool(True))[0] + dr.zeros(mi.Float, size * size)

    def _camera(self, size):
        index = dr.arange(mi.UInt32, size * size)
        row = index // size
        sensor = self.scene.sensors()[0]
        ray, _ = sensor.sample_ray(0, 0, (mi.Point2f(index - row * size, row) + 0.5) / size, mi.Point2f(0.5))
        return mi.Point3f(ray.o), mi.Vector3f(ray.d)

    @dr.syntax
    def _follow(self, step, o, d):
        n, most_rays = dr.width(d), self.most_rays
        o = o + dr.zeros(mi.Point3f, n)
        value, depth, alive = dr.zeros(mi.Float, n), dr.zeros(mi.UInt32, n), dr.full(mi.UInt32, 1, n)
        while dr.hint(alive != 0, max_iterations=most_rays, label="mirrors"):
            seen, o, d, goes_on = step(o, d, depth, alive != 0)
            value += seen
            depth += 1
            alive = dr.select(goes_on & (depth < most_rays), mi.UInt32(1), mi.UInt32(0))
        return value

    def _step(self, o, d, depth, active):
        """One ray: (how many lights its hit sees, the mirrored ray, the lanes that have one)."""
        si = self.scene.ray_intersect(mi.Ray3f(o, d), mi.RayFlags.All, coherent=depth == 0, active=active)
        n = mi.Vector3f(si.sh_frame.n)
        # Black only where both normals face away.
        front = active & si.is_valid() & ((dr.dot(d, n) < 0) | (dr.dot(d, si.n) < 0))
        start = mi.Point3f(si.p + self.epsilon * si.n)
        lit = self._from_loop(start, n, front) if self.count > FEW_LIGHTS else mi.Float(0)
        if self.count <= FEW_LIGHTS:
            for light in self.lights:
                lit = lit + self._from(light, start, n, front)
        return lit, start, mi.Vector3f(d - 2 * dr.dot(d, n) * n), front & self._is_mirror(si)

    @dr.syntax
    def _from_loop(self, start, n, front):
        lit, i, limit = dr.zeros(mi.Float, dr.width(start)), mi.UInt32(0), self.limit
        while dr.hint(i < limit, max_iterations=-1, exclude=[limit]):
            lit += self._from(dr.gather(mi.Point3f, self.lights, i), start, n, front)
            i += 1
        return lit

    def _from(self, light, start, n, front):
        """1 where `light` is seen, else 0."""
        toward = light - start
        distance = dr.norm(toward)
        facing = front & (dr.dot(toward, n) > 0)
        shadow = mi.Ray3f(start, toward / distance, distance, 0, [])
        return dr.select(facing & ~self.scene.ray_test(shadow, False, facing), mi.Float(1), mi.Float(0))

    def _is_mirror(self, si):
        number = dr.reinterpret_array(mi.UInt32, si.shape)
        if self.table is not None:
            return dr.gather(mi.UInt32, self.table, number, si.is_valid()) != 0
        found = mi.Bool(False)
        for mirror in self.mirrors:
            found = found | (number == mirror)
        return found

    def _sign(self, o, d, depth, active):
        """As `_step`, but what tells one path from another instead of a count."""
        _, start, onward, goes_on = self._step(o, d, depth, active)
        si = self.scene.ray_intersect(mi.Ray3f(o, d), mi.RayFlags.All, coherent=depth == 0, active=active)
        n = mi.Vector3f(si.sh_frame.n)
        front = active & si.is_valid() & (dr.dot(d, n) < 0)
        value = dr.select(active, mi.Float(dr.reinterpret_array(mi.UInt32, si.shape)), 0)
        # A smooth normal that is turned away: others turn it back.
        value = dr.select(active & si.is_valid() & ~front, dr.nan, value)
        for i in range(self.count):
            light = self.lights[i] if self.count <= FEW_LIGHTS else dr.gather(mi.Point3f, self.lights, i)
            cos = dr.dot(dr.normalize(light - start), n)
            value += self._from(light, start, n, front) * (0.17 + 0.31 * i)
            # Tachyon's lights have a horizon of their own, 0.002 above the surface.
            value = dr.select(front & (cos > 0) & (cos < 0.004), dr.nan, value)
        return value * (1 + 0.37 * mi.Float(depth)), start, onward, goes_on


def counted(task) -> dict[str, int]:
    """How many rays `task()` traces, by Mitsuba's function for it, but for what it does the first time only."""
    dr.eval(task())
    names = ("ray_intersect", "ray_intersect_preliminary", "ray_test")
    counts = dr.zeros(mi.UInt32, len(names))

    def counting(index, real):
        def call(self, ray, *arguments, **options):
            active = options.get("active", True)
            # Positions of `active` among the arguments: it is the last one of each overload.
            if arguments and isinstance(arguments[-1], mi.Bool):
                active = arguments[-1]
            lanes = dr.select(mi.Bool(active), mi.UInt32(1), 0) + dr.zeros(mi.UInt32, dr.width(ray.o))
            dr.scatter_reduce(dr.ReduceOp.Add, counts, lanes, mi.UInt32(index))
            return real(self, ray, *arguments, **options)

        return call

    calls = {name: counting(i, getattr(mi.Scene, name)) for i, name in enumerate(names)}
    with mock.patch.multiple(mi.Scene, **calls):
        dr.eval(task())
        dr.eval(counts)
    return dict(zip(names, map(int, np.array(counts)), strict=True))
