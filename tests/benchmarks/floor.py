"""How close `whitted` is to the ray floor, on five scenes.

Interleaved with the general kernel (`specialize = false`). The rays of floor and `whitted` are
counted: they differ only where rounding decides.
"""

import mitsuba as mi

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
        integrator.specialize = specialize
        return mi.render(scene)

    floor = Floor(scene, size, scenes.DEPTH, epsilon)
    tasks = {"ray floor": floor, "whitted": lambda: render(True), "whitted, general": lambda: render(False)}
    found = compared("floor", name, interleaved(tasks, rounds), "ray floor", size)

    small = min(size, 256)
    scene = build(small)
    tasks = {"ray floor": Floor(scene, small, scenes.DEPTH, epsilon), "whitted": lambda: mi.render(scene)}
    for task, run in tasks.items():
        rays = counted(run)
        found.append(record("floor", name, task, "shadow rays", rays["ray_test"], "rays", small))
        followed = rays["ray_intersect"] + rays["ray_intersect_preliminary"]
        found.append(record("floor", name, task, "camera and mirror rays", followed, "rays", small))
    return found
