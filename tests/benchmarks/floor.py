"""How close `whitted` is to the ray floor, on five scenes.

Interleaved with the general kernel (`specialize = false`). The rays of floor and `whitted` are
counted: they differ only where rounding decides.
"""

from unittest import mock

import mitsuba as mi

from phong_bsdf.tracing.geometry import Geometry
from phong_bsdf.tracing.needs import FEATURES

from . import scenes
from .measure import Plan, compared, fresh_process, interleaved, record
from .rays import Floor, counted

# Name, scene, pixels of a side, how far off a surface the floor's rays start.
SCENES = (
    ("lecture", scenes.lecture, 2048, 1e-4),
    ("course 6", scenes.course, 2048, 2e-3),
    ("mesh", scenes.mesh, 1024, 1e-4),
    ("100 spheres", scenes.spheres, 2048, 1e-5),
    ("textured", scenes.textured, 2048, 1e-4),
)


def records(plan: Plan):
    """Times of floor, `whitted` and its general kernel, their ratios, and how many rays each traces."""
    found = []
    for name, _, size, _ in SCENES:
        with fresh_process(plan.variant) as run:
            found += run(_measure, name, plan.of(size, 64), plan.of(15, 2))
    return found


def _measure(name, size, rounds):
    build, epsilon = next((build, epsilon) for known, build, _, epsilon in SCENES if known == name)
    scene = build(size)
    integrator = scene.integrator()

    def render(specialize):
        integrator.keep = frozenset() if specialize else frozenset(FEATURES)
        return mi.render(scene)

    floor = Floor(scene, size, scenes.DEPTH, epsilon)
    tasks = {"ray floor": floor, "whitted": lambda: render(True), "whitted, general": lambda: render(False)}
    found = compared("floor", name, interleaved(tasks, rounds), "ray floor", size)

    return found + _rays(name, build, epsilon, min(size, 256))


def _once(geometry, ray, coherent, active):
    return geometry.scene.ray_intersect(ray, mi.RayFlags.All, coherent=coherent, active=active)


def _rays(name, build, epsilon, size):
    """How many rays each traces, and the share by which `whitted` differs from the floor."""
    scene = build(size)
    tasks = {"ray floor": Floor(scene, size, scenes.DEPTH, epsilon), "whitted": lambda: mi.render(scene)}
    found, kinds = [], {}
    for task, run in tasks.items():
        # What meets no mesh is traced again, in case that it passed a vertex: those rays are left out.
        with mock.patch.object(Geometry, "_hit_of_triangles", _once):
            rays = counted(run)
        followed = rays["ray_intersect"] + rays["ray_intersect_preliminary"]
        kinds[task] = {"shadow rays": rays["ray_test"], "camera and mirror rays": followed}
        found += [record("floor", name, task, kind, count, "rays", size) for kind, count in kinds[task].items()]
    differ = sum(abs(kinds["whitted"][kind] - count) for kind, count in kinds["ray floor"].items())
    share = differ / sum(kinds["ray floor"].values())
    return [*found, record("floor", name, "whitted", "share of rays that differ", share, "1", size)]
