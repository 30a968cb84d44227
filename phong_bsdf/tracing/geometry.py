"""The shapes of a scene as rays meet them, with no gaps between the triangles of a mesh.

Mitsuba traces through Embree, which lets some rays slip between two triangles that share an edge, and
rays through pixel centres meet edges exactly. A scene made with `embree_use_robust_intersections` has
no such gaps between two triangles. A scene cannot be asked for that flag, nor be given it later. So rays are
tried (`gaps.py`), and if one slips through, the shapes are put into another scene that has the flag.

Of rays that are aimed at a vertex, where many triangles meet, one in some 250 000 passes all the same. So
what meets nothing is traced again, at an angle too small to see, and shadow rays are turned by that angle.

The groups of `instance` shapes are never traced so. Where they may hold meshes, each ray is
traced three times, at angles too small to see: no edge lets all of them through.
"""

import drjit as dr
import mitsuba as mi

from ..reflection.parameters import is_recorded
from .needs import ROBUST, has_instances

# The angle between rays that are traced side by side; seen from where a ray starts, a gap is some 2^-23 wide.
ASIDE = 2**-19

# What a ray beside is to be nearer to count: the surface behind a gap is further off.
NEARER = 1 - 2**-10


class Geometry:
    """The shapes of `scene`; `tight` is what is known from the last rendering."""

    def __init__(self, scene, tight=None):
        self.in_groups = has_instances(scene) and _is_embree()
        triangles = _is_embree() and any(map(has_triangles, scene.shapes()))
        self.triangles = triangles and not self.in_groups
        self.scene = (tight or Tight()).of(scene) if triangles else scene

    def hit(self, ray, coherent, active):
        """The first surface on `ray`, a `mitsuba.SurfaceInteraction3f`; invalid where there is none."""
        if self.triangles:
            return self._hit_of_triangles(ray, coherent, active)
        first = self.scene.ray_intersect(ray, mi.RayFlags.All, coherent=coherent, active=active)
        for other in self._beside(ray) if self.in_groups else []:
            si = self.scene.ray_intersect(other, mi.RayFlags.All, coherent=coherent, active=active)
            # What is missed is at infinity.
            first = dr.select(si.t < NEARER * first.t, si, first)
        return first

    def _hit_of_triangles(self, ray, coherent, active):
        """As `hit`: what a ray misses because it passes a vertex, one beside it meets."""
        found = self.scene.ray_intersect_preliminary(ray, coherent=coherent, active=active)
        missed = active & (found.is_valid() == False)  # noqa: E712
        beside = next(self._beside(ray))
        if dr.is_jit_v(mi.Float):
            found = dr.select(
                missed, self.scene.ray_intersect_preliminary(beside, coherent=False, active=missed), found
            )
        elif missed:
            found = self.scene.ray_intersect_preliminary(beside)
        return found.compute_surface_interaction(ray, mi.RayFlags.All, active)

    def blocked(self, ray, active):
        """Whether anything is on `ray`."""
        if self.triangles:
            return self.scene.ray_test(next(self._beside(ray)), coherent=False, active=active)
        found = self.scene.ray_test(ray, coherent=False, active=active)
        for other in self._beside(ray) if self.in_groups else []:
            found = found | self.scene.ray_test(other, coherent=False, active=active)
        return found

    @staticmethod
    def _beside(ray):
        """Rays close to `ray`, to two sides of it, of which one at least leaves an edge that `ray` meets."""
        # Its direction is that of no edge in particular.
        across = dr.normalize(dr.cross(ray.d, mi.Vector3f(0.5377, 0.8339, -0.1258)))
        for aside in (across, dr.cross(ray.d, across)):
            yield mi.Ray3f(ray.o, ray.d + ASIDE * aside, ray.maxt, ray.time, ray.wavelengths)


class Tight:
    """What is known of the gaps of the scene that was rendered last."""

    def __init__(self):
        self.key, self.kept, self.made, self.state = None, None, None, None

    def of(self, scene):
        """`scene`, which has triangles, or one of the same shapes if rays slip between them."""
        shapes = scene.shapes()
        # While the array of pointers is kept, no other has its number.
        pointers = scene.shapes_dr() if dr.is_jit_v(mi.Float) else shapes
        key = pointers.index if dr.is_jit_v(mi.Float) else [shape.ptr for shape in shapes]
        if is_recorded():
            # A recording takes its scene from its arguments, and nothing can be tried while it is made.
            if key != self.key or self.made:
                _warn_of_recording()
            return scene
        if key != self.key:
            self.key, self.kept, self.made = key, pointers, None
            # Needs NumPy, which is slow to import.
            from .gaps import has_gaps

            if has_gaps(scene, [shape for shape in shapes if has_triangles(shape)]):
                self.state, self.made = _State(shapes), _tight(shapes)
        elif self.made and self.state.changed():
            self.state, self.made = _State(shapes), _tight(shapes)
        return self.made or scene


class _State:
    """Where the shapes are: notices when that has changed."""

    def __init__(self, shapes):
        self._params = [mi.traverse(shape) for shape in shapes]
        self._seen = self._values()
        # While arrays are kept, no others have their numbers.
        self._kept = [dr.detach(array) for array in self._arrays()]

    def changed(self) -> bool:
        return self._values() != self._seen

    def _arrays(self):
        for params in self._params:
            for name, value in params:
                # A dot is in the names of BSDFs and other parts.
                if "." not in name and not isinstance(value, float | int):
                    yield getattr(value, "matrix", value)

    def _values(self):
        if dr.is_jit_v(mi.Float):
            return [dr.detail.collect_indices(array) for array in self._arrays()]
        import numpy as np

        return [np.array(array).tobytes() for array in self._arrays()]


def _is_embree() -> bool:
    return mi.variant().startswith(("llvm", "scalar"))


def has_triangles(shape) -> bool:
    """Whether Embree traces the shape as triangles."""
    return shape.is_mesh() and shape.class_name() != "Rectangle"


def _tight(shapes):
    """A scene of these shapes, without cameras and lights, that has no gaps."""
    ids = [shape.id() for shape in shapes]
    made = mi.load_dict({"type": "scene", ROBUST: True, **{f"shape {i}": shape for i, shape in enumerate(shapes)}})
    # Loading names them after their keys.
    for shape, name in zip(shapes, ids, strict=True):
        shape.set_id(name)
    return made


_warned = False


def _warn_of_recording() -> None:
    """Say once what a recorded function cannot be helped with."""
    global _warned
    if not _warned:
        _warned = True
        mi.Log(
            mi.LogLevel.Warn,
            "whitted: while a function or loop is recorded, single rays may slip between the triangles of a mesh; load "
            f"the scene with '{ROBUST}' = true, and render it once before",
        )
