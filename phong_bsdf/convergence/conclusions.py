"""The passes of a folder -> all there is to report: results, tables, rows, and the pictures at equal time."""

import contextlib
import json
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..pictures import images, metrics
from ..pictures.estimates import Estimate
from ..pictures.store import Pass, Store
from . import study, tradeoff
from .planning import MethodRun, ReferenceRun, Run, read_run
from .study import Level, PassErrors, Result, Spread
from .tradeoff import Cell, Table

__all__ = [
    "Cell", "Conclusions", "Estimate", "Level", "MethodRun", "PassErrors", "ReferenceFacts", "ReferenceRun", "Result",
    "Row", "Run", "Shown", "Spread", "Table", "read",
]  # fmt: skip

# HDR-FLIP of every pass, which takes longer than reading the passes: kept beside them.
FLIPS = "flip.json"


@dataclass(frozen=True)
class ReferenceFacts:
    """What the reports say about a reference."""

    name: str
    kind: str
    """`passes` of different seeds, a `grid`, or a `file`."""
    passes: int
    """Their number."""
    spp: int | None
    """Samples per pixel of all passes together; None for a file."""
    relmse: float | None
    """Its own expected error, of a grid an upper bound; None where that is not known."""
    mse: float | None
    """The same as mean squared error."""
    nonfinite: int
    """Pixels that are no numbers."""


@dataclass(frozen=True)
class Shown:
    """A picture at equal time."""

    method: str
    spp: int
    """Samples per pixel."""
    repeat: int
    seconds: float
    """Median of the passes with as many samples."""
    relmse: float | None
    """Of this pass."""


@dataclass(frozen=True)
class Row:
    """One pass, with all that it depends on: a line of `passes.csv`."""

    scene: str
    """Name of its file."""
    scene_hash: str
    method: str
    integrator: str
    sampler: str
    sampling: str
    bsdf: str
    reference: str
    variant: str
    """Of Mitsuba."""
    spp: int
    """Samples per pixel."""
    repeat: int
    seed: int
    seconds: float
    """Of a rendering whose kernels were compiled before."""
    seconds_warmup: float
    """What the rendering before that one took longer, if it was the scene's first or had to compile; else 0."""
    relmse: float | None
    """The errors are those of `metrics.Errors`; None where there are pixels that are no numbers."""
    relmse_low: float | None
    """Confidence interval of the mean over the passes with as many samples."""
    relmse_high: float | None
    mse: float | None
    mse_low: float | None
    mse_high: float | None
    max_error: float | None
    max_error_low: float | None
    max_error_high: float | None
    flip: float | None
    flip_low: float | None
    flip_high: float | None
    nonfinite: int
    """Pixels that are no numbers."""
    versions: str
    machine: str
    time: str
    """When it was finished, UTC."""


@dataclass(frozen=True)
class Conclusions:
    """All there is to report."""

    run: Run
    """What was to be measured."""
    results: tuple[Result, ...]
    """Of each method."""
    references: tuple[ReferenceFacts, ...]
    equal_time: Table
    """relMSE that each method reaches in the same seconds."""
    equal_error: Table
    """Seconds that each method needs for the same relMSE."""
    rows: tuple[Row, ...]
    """Of each pass."""
    picture_seconds: float | None
    """The time that the pictures were chosen for."""
    shown: tuple[Shown, ...]
    missing: int
    """Passes that were not made, those of failed methods aside."""


def read(folder: Path) -> tuple[Conclusions, dict[str, np.ndarray]]:
    """What is in a folder that `phong-bsdf converge` wrote, and its pictures; nothing is rendered.

    The pictures are linear, (height, width, 1 or 3), float32: those of `Conclusions.shown` by the name of their method,
    and what each is measured against as `reference ` with the name of that (`MethodRun.limit`). HDR-FLIP that is not
    known yet is computed, and kept in the folder. ValueError where the folder holds no such measurement; ImportError
    without scipy (`phong-bsdf[report]`).
    """
    store = Store(folder)
    return conclude(store, read_run(store))


def conclude(
    store: Store, run: Run, on_progress: Callable[[str, float], None] = lambda what, share: None
) -> tuple[Conclusions, dict[str, np.ndarray]]:
    """The conclusions, and the pictures: references by name, then one of each method."""
    references = {reference.name: _reference(store, reference) for reference in run.references}
    results, rows, seconds, missing = [], [], {}, 0
    for i, method in enumerate(run.methods):
        on_progress(f"errors of {method.name}", i / len(run.methods))
        result, made = _result(store, run, method, references.get(method.limit))
        results.append(result)
        rows += _rows(run, method, result, made)
        seconds[method.name] = {(p.spp, p.repeat): p.seconds for p in made}
        missing += 0 if result.failure else run.repeats * len(method.levels) - len(made)
    measured = [result for result in results if result.levels]
    time, shown = _at_equal_time(measured)
    keys = {method.name: (method.key, method.limit) for method in run.methods}
    used = {keys[s.method][1] for s in shown}
    pictures = {f"reference {name}": references[name].mean.astype(np.float32) for name in references if name in used}
    for s in shown:
        key = keys[s.method][0]
        record = next(p for p in store.list(key) if (p.spp, p.repeat) == (s.spp, s.repeat))
        pictures[s.method] = store.image(key, record)
    facts = tuple(_facts(reference, references.get(reference.name)) for reference in run.references)
    found = Conclusions(
        run, tuple(results), facts, tradeoff.equal_time(measured), tradeoff.equal_error(measured, seconds),
        tuple(rows), time, shown, missing,
    )  # fmt: skip
    return found, pictures


def against(run: Run) -> dict[str, str]:
    """Picture of a method -> picture of its reference."""
    return {method.name: f"reference {method.limit}" for method in run.methods}


def _reference(store: Store, reference: ReferenceRun) -> study.Reference | None:
    """None where nothing of it is there."""
    if reference.kind == "file":
        return study.Reference(reference.name, [metrics.colors(images.read_exr(Path(reference.file)))], kind="file")
    # Earlier runs may have made passes for other levels.
    made = [p for p in store.list(reference.key) if p.spp in reference.levels]
    if reference.kind == "grid":
        pictures = {p.spp: store.image(reference.key, p) for p in made}
        fine, coarse = (pictures.get(spp) for spp in reference.levels)
        return None if fine is None else study.Reference(reference.name, [fine], coarse, "grid")
    return study.Reference(reference.name, [store.image(reference.key, p) for p in made]) if made else None


def _result(store: Store, run: Run, method: MethodRun, reference) -> tuple[Result, list[Pass]]:
    made = [p for p in store.list(method.key) if p.spp in method.levels and p.repeat < run.repeats]
    failure = store.failure(method.key)
    if failure is not None or reference is None or not made:
        return study.unmeasured(method.name, method.limit, failure), []
    pairs = [(p, store.image(method.key, p)) for p in made]
    if pairs[0][1].shape != reference.mean.shape:
        (height, width), (h, w) = pairs[0][1].shape[:2], reference.mean.shape[:2]
        reason = f"its pictures are {width} x {height}, the reference is {w} x {h}"
        return study.unmeasured(method.name, method.limit, reason), []
    return study.analyse(method.name, pairs, reference, _flips(store, method, reference, pairs)), made


def _flips(store: Store, method: MethodRun, reference: study.Reference, pairs) -> dict[tuple[int, int], float]:
    """HDR-FLIP of each pass: kept in a file, as long as the reference is the same."""
    if not metrics.has_flip() or reference.nonfinite:
        return {}
    path = store.folder / FLIPS
    kept = {}
    # Broken or not there: all are computed again.
    with contextlib.suppress(FileNotFoundError, ValueError):
        kept = json.loads(path.read_text())
    # More passes of a reference are another picture.
    name = f"{method.key} against {reference.name}, {reference.passes}, {float(reference.mean.mean()):.9g}"
    known = kept.setdefault(name, {})
    missing = [(p, image) for p, image in pairs if f"{p.spp}/{p.repeat}" not in known and not metrics.nonfinite(image)]
    for p, image in missing:
        known[f"{p.spp}/{p.repeat}"] = metrics.flip(image.astype(np.float64), reference.mean)
    if missing:
        images.replace_file(path, json.dumps(kept, indent=0) + "\n")
    return {(p.spp, p.repeat): known[f"{p.spp}/{p.repeat}"] for p, _ in pairs if f"{p.spp}/{p.repeat}" in known}


def _at_equal_time(results: list[Result]) -> tuple[float | None, tuple[Shown, ...]]:
    """A picture of each method after about the longest time that all of them were given.

    Where the longest of one is shorter than the shortest of another, that shortest: each method at its best till then.
    """
    if not results:
        return None, ()
    times = [[level.seconds.median for level in result.levels] for result in results]
    time = max(min(map(max, times)), max(map(min, times)))
    shown = []
    for result in results:
        level = min(result.levels, key=lambda level: abs(math.log(level.seconds.median / time)))
        first = min((e for e in result.passes if e.spp == level.spp), key=lambda e: e.repeat)
        shown.append(Shown(result.name, level.spp, first.repeat, level.seconds.median, first.relmse))
    return time, tuple(shown)


def _rows(run: Run, method: MethodRun, result: Result, made: list[Pass]) -> Iterator[Row]:
    levels = {level.spp: level for level in result.levels}
    errors = {(e.spp, e.repeat): e for e in result.passes}
    spec = method.spec
    for p in made:
        level, error = levels[p.spp], errors[p.spp, p.repeat]
        numbers = []
        for metric in study.METRICS:
            of_level = getattr(level, metric)
            numbers += [getattr(error, metric), of_level and of_level.low, of_level and of_level.high]
        yield Row(
            run.scene, run.scene_hash, method.name, spec["integrator"] or run.integrator, spec["sampler"],
            spec["sampling"], spec["bsdf"], method.limit, p.variant, p.spp, p.repeat, p.seed, p.seconds,
            p.seconds_warmup, *numbers,
            nonfinite=error.nonfinite, versions=p.versions, machine=p.machine, time=p.time,
        )  # fmt: skip


def _facts(run: ReferenceRun, reference: study.Reference | None) -> ReferenceFacts:
    if reference is None:
        return ReferenceFacts(run.name, run.kind, 0, 0, None, None, 0)
    own, used = reference.own_error, run.levels[: reference.passes]
    spp = sum(used) if used else None
    return ReferenceFacts(run.name, run.kind, reference.passes, spp, own["relmse"], own["mse"], reference.nonfinite)
