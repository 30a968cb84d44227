"""What meshes without gaps cost: the same picture through a scene with Embree's flag and, as it was made, without."""

import mitsuba as mi

from phong_bsdf.tracing.geometry import Tight

from . import scenes
from .measure import Plan, compared, interleaved

# Name, scene.
SCENES = (("mesh", scenes.mesh), ("box of mirrors", scenes.bouncing))


ROUNDS = 15


class AsMade(Tight):
    """Traces scenes as they were made."""

    def of(self, scene):
        """`scene`, whatever slips through it."""
        return scene


def records(plan: Plan):
    """Times of both for each scene, and their ratio."""
    found = []
    size = plan.of(1024, 64)
    for name, build in SCENES:
        made = {robust: build(size, robust=robust) for robust in (True, False)}
        made[False].integrator().memory.tight = AsMade()
        tasks = {"with gaps": lambda: mi.render(made[False]), "without gaps": lambda: mi.render(made[True])}  # noqa: B023
        found += compared("gaps", name, interleaved(tasks, plan.of(ROUNDS, 2)), "with gaps", size)
    return found
