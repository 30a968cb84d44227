"""Renders what a plan lacks -> passes on disk.

Each limit's reference comes first. Then come the passes, interleaved: each method in turn makes one pass at each
number of samples, then all of them the next. Scenes are loaded in turn, too: Dr.Jit puts every BSDF that is alive into
each kernel.
"""

import gc
import math
import re
import time
from collections.abc import Callable, Sequence

import drjit as dr
import mitsuba as mi

from ..host import machine
from ..pictures import metrics
from ..pictures.store import Pass, Store
from ..scene import fingerprint, rendering
from .planning import MethodRun, Plan, ReferenceRun, Run

# Fewer give a reference no error bar worth the name, however short of time.
LEAST_REFERENCE_PASSES = 4

# Seeds of references, and of nothing else, have this bit.
REFERENCE_SEED = 2**31


def measure(
    planned: Plan,
    store: Store,
    *,
    time_budget: float = math.inf,
    on_progress: Callable[[str, float], None] = lambda what, share: None,
) -> None:
    """Make the passes that are not on disk yet, as far as the time budget goes.

    Half of the budget, in seconds, is for the references, the rest for the passes. A method that
    fails is left out, its reason kept in the store.
    """
    session = _Session(planned, store, on_progress)
    session.deadline = time.perf_counter() + time_budget / 2
    for reference in planned.run.references:
        session.make_reference(reference)
    session.deadline = time.perf_counter() + time_budget / 2
    for method in planned.run.methods:
        store.set_failure(method.key, session.failed_references.get(method.limit))
    for repeat in range(planned.run.repeats):
        for method in planned.run.methods:
            session.make_passes(method, repeat)


def seed_of(run: Run, key: str, spp: int, number: int, seed_bit: int = 0) -> int:
    """The seed of a pass."""
    text = fingerprint.digest(f"{run.seed}/{key}/{spp}/{number}", 8)
    # A large rendering goes in passes of consecutive seeds: leave them room.
    return int(text, 16) % 2**30 | seed_bit


def record(run: Run, spp: int, seed: int, number: int, seconds: float, *, warmup: float = 0.0, where: str = "") -> Pass:
    """The record of a pass that was made just now, on the machine `where`, or that of the run."""
    return Pass(spp, seed, number, seconds, warmup, run.variant, run.versions, where or run.machine, machine.now())


class _Session:
    """One run of `measure`."""

    def __init__(self, planned: Plan, store: Store, on_progress):
        self.plan, self.store, self.on_progress = planned, store, on_progress
        self.deadline = math.inf
        self.failed_references: dict[str, str] = {}
        # (key, spp) -> seconds of its last pass.
        self.known: dict[tuple[str, int], float] = {}
        run = planned.run
        self.done, self.work = 0, run.repeats * sum(sum(method.levels) for method in run.methods)
        self.work += sum(sum(reference.levels) for reference in run.references)

    def make_reference(self, reference: ReferenceRun) -> None:
        """Make the passes of a reference; why that fails is kept for the methods that need it."""
        if reference.kind == "file":
            return
        try:
            self._block(reference.key, f"reference {reference.name}", reference.levels, seed_bit=REFERENCE_SEED)
        except OSError:
            # The disk's fault, not the method's.
            raise
        except Exception as error:
            self.failed_references[reference.name] = f"its reference failed: {_reason(error)}"

    def make_passes(self, method: MethodRun, repeat: int) -> None:
        """Make one pass of a method at each level."""
        if self.store.failure(method.key) is None:
            try:
                self._block(method.key, method.name, method.levels, repeat=repeat)
            except OSError:
                raise
            except Exception as error:
                self.store.set_failure(method.key, _reason(error))

    def _block(self, key: str, what: str, levels: Sequence[int], *, repeat: int | None = None, seed_bit: int = 0):
        """The passes of one method that are not there yet. Without `repeat`, as of a reference, each level is one."""
        jobs = [(spp, i if repeat is None else repeat) for i, spp in enumerate(levels)]
        todo = [job for job in jobs if not self.store.has(key, *job)]
        self._progress(what, sum(levels) - sum(spp for spp, _ in todo))
        if not todo:
            return
        least = LEAST_REFERENCE_PASSES if repeat is None else 0
        gc.collect()
        loaded = rendering.load_parsed(self.plan.path, rendering.merged(self.plan.states[key]))
        if self.plan.size:
            rendering.resize(loaded, self.plan.run.camera, *self.plan.size)
        for i, (spp, number) in enumerate(todo):
            if number < least or time.perf_counter() + self._expected(key, spp) <= self.deadline:
                self._pass(loaded, key, spp, number, seed_bit, timed=repeat is not None, first=i == 0)
            self._progress(what, spp)

    def _pass(self, loaded, key: str, spp: int, repeat: int, seed_bit: int, *, timed: bool, first: bool) -> None:
        run = self.plan.run
        seed = seed_of(run, key, spp, repeat, seed_bit)
        result, seconds = timed_rendering(loaded, run.camera, spp, seed)
        warmup = 0.0
        # The first rendering of a scene, and one that compiles, says what that costs; the next one its own time.
        if timed and dr.is_jit_v(mi.Float) and (first or result.compiled):
            before = seconds
            result, seconds = timed_rendering(loaded, run.camera, spp, seed)
            warmup = max(before - seconds, 0.0)
        self.known[key, spp] = seconds
        made = record(run, spp, seed, repeat, seconds, warmup=warmup)
        self.store.add(key, made, metrics.colors(result.image))

    def _expected(self, key: str, spp: int) -> float:
        """Seconds of a pass, from the last one like it, or in proportion from a smaller one."""
        smaller = [n for k, n in self.known if k == key and n <= spp]
        return self.known[key, max(smaller)] * spp / max(smaller) if smaller else 0.0

    def _progress(self, what: str, done: int) -> None:
        self.done += done
        self.on_progress(what, min(self.done / self.work, 1.0))


def timed_rendering(loaded, camera: int, spp: int, seed: int):
    """A rendering, and the seconds from nothing being under way to all of it being done."""
    dr.sync_thread()
    start = time.perf_counter()
    result = rendering.render(loaded, camera=camera, spp=spp, seed=seed, color=True)
    dr.sync_thread()
    return result, time.perf_counter() - start


def _reason(error: BaseException) -> str:
    text = re.sub(r"\s+", " ", str(error)).strip()
    return text if isinstance(error, rendering.SceneError) else f"{type(error).__name__}: {text}"
