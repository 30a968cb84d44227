"""How time, operations, compile time and memory grow with pixels, lights, materials, triangles and mirror bounces.

Each point is a process of its own with an empty kernel cache, all of them loaded at once and
rendering in turns.
"""

import math
import resource
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from phong_bsdf.tracing.lights import FEW

from . import scenes
from .measure import Kernels, Plan, fresh_process, kernels, record, seconds, slope
from .rays import Floor

# What the lights beyond the second largest number cost, each, in units of their rays on the floor.
COST = "time / ray floor, per light"

# Operations of the kernel with most lights, in units of those with the fewest that stand in a loop.
SAME_KERNEL = "operations, most / fewest in a loop"


@dataclass(frozen=True)
class Axis:
    """One quantity that grows: `build(x, plan)` is a scene, `tiny` the values of a quick run."""

    build: Callable
    values: tuple
    tiny: tuple
    with_floor: bool = False


AXES = {
    "pixels": Axis(
        lambda x, plan: scenes.lecture(math.isqrt(x)),
        tuple(side**2 for side in (64, 128, 256, 512, 1024, 2048, 4096)),
        (32**2, 64**2),
    ),
    "lights": Axis(
        lambda x, plan: scenes.lit(plan.of(256, 32), x), (1, 3, 10, 30, 100, 300, 1000), (1, 10), with_floor=True
    ),
    "materials": Axis(
        lambda x, plan: scenes.spheres(plan.of(512, 32), plan.of(1000, 10), x), (1, 10, 100, 1000), (1, 10)
    ),
    "triangles": Axis(
        lambda x, plan: scenes.mesh(plan.of(512, 32), x), (1_000, 10_000, 100_000, 1_000_000), (1_000, 2_000)
    ),
    "mirror bounces": Axis(lambda x, plan: scenes.bouncing(plan.of(512, 32), x), (0, 1, 2, 4, 8, 16), (1, 2)),
}


def records(plan: Plan):
    """For each value time, operations, compile time, memory; the fitted exponents; the cost of a light."""
    found = []
    for name, axis in AXES.items():
        found += _along(plan, name, axis)
    return found


def _along(plan, name, axis):
    values = plan.of(axis.values, axis.tiny)
    tasks = ["whitted", *["ray floor"] * axis.with_floor]
    with ExitStack() as stack:
        runs = {x: stack.enter_context(fresh_process(plan.variant)) for x in values}
        first = {x: run(_load, plan, name, x) for x, run in runs.items()}
        times = {x: {task: [] for task in tasks} for x in values}
        for i in range(plan.of(9, 2) + 1):
            for x, run in list(runs.items())[:: 1 if i % 2 else -1]:
                for task in tasks:
                    elapsed = run(_render, task)
                    # The first round compiles the floor.
                    if i > 0:
                        times[x][task].append(elapsed)
        memory = {x: run(_memory) for x, run in runs.items()}
    found = []
    for x in values:
        found += [record("growth", name, task, "time", times[x][task], "s", x) for task in tasks]
        found.append(record("growth", name, "whitted", "operations", first[x].operations, "operations", x))
        found.append(record("growth", name, "whitted", "kernels of the first picture", first[x].launches, "kernels", x))
        found.append(record("growth", name, "whitted", "compile time", first[x].compile_seconds, "s", x))
        arrays, process = memory[x]
        found.append(record("growth", name, "whitted", "memory of arrays", arrays, "bytes", x))
        found.append(record("growth", name, "whitted", "memory of the process", process, "bytes", x))
    return found + _derived(name, values, found, times, first)


def _derived(name, values, found, times, first):
    """Exponents of time, operations and memory; the largest value's time over the smallest's; the cost of a light."""
    derived = []
    for quantity in ("time", "operations", "memory of arrays"):
        points = [(r.x, r.median) for r in found if r.task == "whitted" and r.quantity == quantity and r.x > 0]
        derived.append(
            record("growth", name, "whitted", f"exponent of {quantity}", slope(*zip(*points, strict=True)), "1")
        )
    least, most = values[0], values[-1]
    pairs = zip(times[most]["whitted"], times[least]["whitted"], strict=True)
    derived.append(record("growth", name, "whitted", "time, most / least", [a / b for a, b in pairs], "x"))
    if "ray floor" in times[least]:
        # What the last lights cost, each: the difference of the two largest numbers.
        more = {
            task: [b - a for a, b in zip(times[values[-2]][task], times[most][task], strict=True)]
            for task in ("whitted", "ray floor")
        }
        ratios = [w / f for w, f in zip(more["whitted"], more["ray floor"], strict=True)]
        derived.append(record("growth", name, "whitted", COST, ratios, "x"))
        looped = [first[x].operations for x in values if x > FEW]
        derived.append(record("growth", name, "whitted", SAME_KERNEL, looped[-1] / looped[0], "x"))
    return derived


# In the process of one point -------------------------------------------------------------------------

_tasks = {}


def _load(plan, name, x) -> Kernels:
    """Loads the scene of one point; the kernels of its first picture."""
    axis = AXES[name]
    scene = axis.build(x, plan)
    _tasks["whitted"] = lambda: mi.render(scene)
    if axis.with_floor:
        size = int(scene.sensors()[0].film().size()[0])
        _tasks["ray floor"] = Floor(scene, size, scenes.DEPTH)
    first = kernels(_tasks["whitted"])
    # Arrays of loading are not counted, the picture is.
    dr.flush_malloc_cache()
    dr.detail.malloc_clear_statistics()
    return first


def _render(task) -> float:
    return seconds(_tasks[task])


def _memory() -> tuple[int, int]:
    """Most bytes that arrays held while rendering, and that the process held at any time."""
    backend = dr.JitBackend.CUDA if "cuda" in mi.variant() else dr.JitBackend.LLVM
    return dr.detail.malloc_watermark(backend), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
