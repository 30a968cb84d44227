"""Error against time of the lobes' formulas: the sweep of `stability`, with other inputs in each repeat -> records.

The error of a formula at an exponent is the worst over many inputs, so repeats say how far that depends on the inputs.
"""

import dataclasses
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import stability
from ..host import machine
from ..pictures import estimates, images
from ..pictures import store as passes
from ..pictures.estimates import Estimate
from ..pictures.store import Store
from ..scene.fingerprint import digest, versions
from .study import Spread

EXPONENTS = (1.0, 1e2, 1e4, 1e6, 1e8)

# Formula -> where a row of `stability` holds its error and its time.
FORMULAS = {
    "stable": ("error", "nanoseconds"),
    "naive": ("naive_error", "naive_nanoseconds"),
    "native": ("native_error", "native_nanoseconds"),
}


@dataclass(frozen=True)
class LobeError:
    """One formula at one exponent."""

    quantity: str
    """As in `stability.Row`."""
    lobe: str
    formula: str
    """`stable` (this package), `naive` (the textbook's) or `native` (the Beckmann distribution of Mitsuba)."""
    p: float
    repeats: int
    error: Estimate
    """Worst relative error, geometric mean over the repeats; infinite where values overflow."""
    nanoseconds: Spread
    """Of one evaluation, on all threads."""


@dataclass(frozen=True)
class LobeRun:
    """What is measured, as `lobes.json` keeps it."""

    key: str
    cases: int
    repeats: int
    seed: int
    variant: str
    versions: str
    machine: str


@dataclass(frozen=True)
class LobeErrors:
    """All there is to report."""

    run: LobeRun
    made: int
    """Repeats on disk."""
    rows: tuple[LobeError, ...]


def measure(
    store: Store,
    *,
    repeats: int,
    seed: int = 0,
    cases: int = stability.QUICK_CASES,
    on_progress: Callable[[str, float], None] = lambda what, share: None,
) -> None:
    """Make the repeats that are not on disk yet, each a file of its own."""
    if not dr.is_jit_v(mi.Float):
        raise ValueError(f"converge: --lobes needs a JIT variant such as llvm_ad_rgb, got '{mi.variant()}'")
    store.claim(passes.LOBES)
    where = machine.described(dr.thread_count())
    key = "lobes-" + digest([mi.variant(), versions(), where, cases, seed, EXPONENTS])
    run = LobeRun(key, cases, repeats, seed, str(mi.variant()), versions(), where)
    (store.passes / key).mkdir(parents=True, exist_ok=True)
    # First: a run that is killed can be drawn.
    images.replace_file(store.folder / passes.LOBES, json.dumps(dataclasses.asdict(run), indent=1) + "\n")
    for repeat in range(repeats):
        path = _path(store, run, repeat)
        if not path.is_file():
            # Far apart: a sweep uses a seed of its own for each lobe and exponent.
            rows = stability.sweep(
                cases=cases, exponents=EXPONENTS, seed=seed + 1000 * repeat,
                on_progress=lambda share, r=repeat: on_progress("sweeping", (r + share) / repeats),
            )  # fmt: skip
            images.replace_file(path, json.dumps([dataclasses.asdict(row) for row in rows]) + "\n")


def is_measured(store: Store) -> bool:
    """Whether the folder holds formulas, not methods of rendering."""
    return (store.folder / passes.LOBES).is_file()


def read(store: Store) -> LobeErrors:
    """What is on disk."""
    run = LobeRun(**json.loads((store.folder / passes.LOBES).read_text(encoding="utf-8")))
    paths = [path for repeat in range(run.repeats) if (path := _path(store, run, repeat)).is_file()]
    sweeps = [[stability.Row(**row) for row in json.loads(path.read_text(encoding="utf-8"))] for path in paths]
    return LobeErrors(run, len(sweeps), tuple(summarise(sweeps)))


def summarise(sweeps: Sequence[Sequence[stability.Row]]) -> list[LobeError]:
    """Errors and times over the repeats of one sweep."""
    found = []
    for rows in zip(*sweeps, strict=True):
        for formula, (error, nanoseconds) in FORMULAS.items():
            errors = [getattr(row, error) for row in rows]
            times = [getattr(row, nanoseconds) for row in rows]
            if None in errors or None in times:
                continue
            spread = Spread.of(times)
            mean = estimates.geometric_mean(errors) if np.isfinite(errors).all() else Estimate(float("inf"))
            found.append(LobeError(rows[0].quantity, rows[0].lobe, formula, rows[0].p, len(rows), mean, spread))
    return found


def _path(store: Store, run: LobeRun, repeat: int):
    return store.passes / run.key / f"repeat-{repeat:03}.json"
