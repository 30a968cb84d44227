"""`phong` and `blinnphong` beside Mitsuba's own BSDFs, and `whitted` beside `direct`: same process, scene and rays."""

import gc

import mitsuba as mi

from . import scenes
from .measure import Plan, compared, fresh_process, record, seconds

# Under `direct` without BSDF samples: a camera ray and a shadow ray a pixel, whatever the BSDF.
LIGHT_ONLY = {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0}
PHYSICAL = {"type": "whitted", "convention": "physical", "max_depth": 2}

TASKS = {
    "direct, diffuse": ({"type": "diffuse"}, LIGHT_ONLY),
    "direct, roughplastic": ({"type": "roughplastic"}, LIGHT_ONLY),
    "direct, phong": ({"type": "phong"}, LIGHT_ONLY),
    "direct, blinnphong": ({"type": "blinnphong"}, LIGHT_ONLY),
    "whitted, diffuse": ({"type": "diffuse"}, PHYSICAL),
    "whitted, phong": ({"type": "phong"}, PHYSICAL),
    "whitted, blinnphong": ({"type": "blinnphong"}, PHYSICAL),
}


def records(plan: Plan):
    """Times, and their ratios to those of `direct` with `roughplastic`."""
    size = plan.of(1024, 64)
    with fresh_process(plan.variant) as run:
        times = run(_measure, size, plan.of(11, 2))
    found = compared("native", "balls", times, "direct, roughplastic", size)
    for bsdf in ("diffuse", "phong", "blinnphong"):
        pairs = zip(times[f"whitted, {bsdf}"], times[f"direct, {bsdf}"], strict=True)
        ratios = [ours / direct for ours, direct in pairs]
        found.append(record("native", "balls", f"whitted, {bsdf}", "time / direct, same BSDF", ratios, "x", size))
    return found


def _measure(size, rounds):
    """Only one scene is alive at a time: a kernel would hold the BSDFs of the others, too."""
    times = {name: [] for name in TASKS}
    for _ in range(rounds):
        for name, (bsdf, integrator) in TASKS.items():
            scene = scenes.under(size, bsdf, integrator)
            # The first two compile or find their kernels.
            elapsed = [seconds(lambda scene=scene: mi.render(scene)) for _ in range(5)]
            times[name].append(min(elapsed[2:]))
            del scene
            gc.collect()
    return times
