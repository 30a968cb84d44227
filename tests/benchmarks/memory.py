"""Memory of a rendering, whether many renderings hold more than one, and a recorded frame."""

import gc
import resource
from pathlib import Path

import drjit as dr
import mitsuba as mi

from . import scenes
from .measure import Plan, compared, fresh_process, interleaved, record

# Sides for which a picture of three float32 a pixel fills a power of two, to which Dr.Jit rounds what it allocates.
SIDES = (591, 1182, 2364)


def records(plan: Plan):
    """Bytes of arrays per pixel; what 500 renderings leave behind; a frame of 64 x 64, recorded and not."""
    found = []
    for side in plan.of(SIDES, SIDES[:1]):
        with fresh_process(plan.variant) as run:
            arrays = run(_most_bytes, side) / side**2
        found.append(record("memory", "lecture", "whitted", "arrays at most, a pixel", arrays, "bytes", side))
        # The picture itself: three float32.
        more = record("memory", "lecture", "whitted", "arrays beside the picture, a pixel", arrays - 12, "bytes", side)
        found.append(more)
    renderings = plan.of(500, 20)
    with fresh_process(plan.variant) as run:
        for quantity, growth in run(_many, renderings).items():
            found.append(record("memory", "lecture", "whitted", quantity, growth, "bytes", renderings))
    with fresh_process(plan.variant) as run:
        times = run(_frames, plan.of(31, 2))
    return found + compared("memory", "lecture", times, "plain frame", 64)


def _watermark():
    return dr.detail.malloc_watermark(dr.JitBackend.CUDA if "cuda" in mi.variant() else dr.JitBackend.LLVM)


def _most_bytes(side):
    scene = scenes.lecture(side)
    # The first rendering compiles; loading is not counted.
    dr.eval(mi.render(scene))
    dr.sync_thread()
    gc.collect()
    dr.flush_malloc_cache()
    dr.detail.malloc_clear_statistics()
    dr.eval(mi.render(scene))
    dr.sync_thread()
    return _watermark()


def _many(renderings):
    """How much more arrays and process hold after all renderings than after a tenth of them."""
    scene = scenes.lecture(256)
    for i in range(renderings):
        dr.eval(mi.render(scene))
        dr.sync_thread()
        if i == renderings // 10:
            arrays, process = _watermark(), _resident()
    return {"growth of arrays": _watermark() - arrays, "growth of the process": _resident() - process}


def _resident():
    """Bytes of the process in memory, now where the system tells, else at most."""
    statm = Path("/proc/self/statm")
    if statm.is_file():
        return int(statm.read_text().split()[1]) * resource.getpagesize()
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _frames(rounds):
    scene = scenes.lecture(64)
    frozen = dr.freeze(lambda scene, seed: mi.render(scene, seed=seed))
    tasks = {"plain frame": lambda: mi.render(scene), "recorded frame": lambda: frozen(scene, mi.UInt32(0))}
    return interleaved(tasks, rounds, warmup=4)
