"""The references of a study on a cluster. What is timed is not: times of machines that differ, or share work, do not
compare."""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import drjit as dr

from ..convergence import measuring, methods
from ..convergence.methods import Method
from ..convergence.planning import Plan, Run
from ..host import machine
from ..pictures import metrics
from ..pictures.store import Store
from ..scene import rendering
from ..scene.bundle import Bundle
from . import work
from .connection import Cluster
from .orders import Order, Orders


def render_pass(
    path: Path, method: Method, size: tuple[int, int] | None, run: Run, key: str, spp: int, number: int
) -> bytes:
    """On a worker: the file of one pass of a reference."""
    loaded = work.kept(("reference", path, key), lambda: _load(path, method, size, run.camera))
    seed = measuring.seed_of(run, key, spp, number, measuring.REFERENCE_SEED)
    result, seconds = measuring.timed_rendering(loaded, run.camera, spp, seed)
    made = measuring.record(run, spp, seed, number, seconds, where=machine.described(dr.thread_count()))
    with tempfile.TemporaryDirectory() as name:
        store = Store(Path(name))
        store.passes.mkdir()
        store.add(key, made, metrics.colors(result.image))
        return store.path(key, spp, number).read_bytes()


def _load(path: Path, method: Method, size: tuple[int, int] | None, camera: int):
    state = methods.applied(methods.read(path), method)
    loaded = rendering.load_parsed(path, rendering.merged(state))
    if size:
        rendering.resize(loaded, camera, *size)
    return loaded


def render(
    cluster: Cluster,
    scene: Bundle,
    planned: Plan,
    store: Store,
    *,
    time_budget: float = float("inf"),
    seconds: float | None = None,
    on_progress: Callable[[str, float], None] = lambda what, share: None,
    on_wait: Callable[[str], None] = lambda what: None,
) -> None:
    """Make the passes of references that are not on disk yet, as far as the time budget goes.

    What fails, or is not reached, is left to `measuring.measure`.
    """
    deadline = time.perf_counter() + time_budget
    orders: list[Order] = []
    jobs: dict[str, tuple[str, int, int]] = {}
    for reference in planned.run.references:
        for number, spp in enumerate(reference.levels):
            if reference.key in planned.limits and not store.has(reference.key, spp, number):
                name = f"{reference.key}/{spp}/{number}"
                jobs[name] = reference.key, spp, number
                arguments = planned.limits[reference.key], planned.size, planned.run, *jobs[name]
                orders.append(Order(name, scene, render_pass, arguments, work=spp))
    run = Orders(cluster, orders, variant=planned.run.variant, seconds=seconds, on_wait=on_wait)
    for done, result in enumerate(run.results(), 1):
        if result.error is None:
            store.keep(*jobs[result.name], result.value)
        on_progress("references", done / len(orders))
        if time.perf_counter() > deadline:
            return
