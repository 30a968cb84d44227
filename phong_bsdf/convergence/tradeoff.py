"""What a given time buys, and what a given error costs: tables of methods, over times and over errors."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..pictures import estimates
from ..pictures.estimates import Estimate
from .study import Result, complete_repeats, errors_of

# Columns of a table, at most.
COLUMNS = 6


@dataclass(frozen=True)
class Cell:
    """A number in a table of methods."""

    estimate: Estimate
    """relMSE, or seconds."""
    at_most: bool = False
    """The cheapest level is better already."""


@dataclass(frozen=True)
class Table:
    """One row for each method, one column for each of `columns`."""

    columns: tuple[float, ...]
    """Seconds, or relMSE."""
    rows: Mapping[str, tuple[Cell | None, ...]]
    """Name of a method -> a cell for each column; None where it was not measured there."""


def equal_time(results: Sequence[Result]) -> Table:
    """relMSE that each method reaches in the same seconds."""
    medians = [level.seconds.median for r in results for level in r.levels if level.relmse]

    def cell(result: Result, time: float) -> Cell | None:
        at = {level.spp: level.seconds.median for level in result.levels}
        curves = complete_repeats(result.passes)
        found = [estimates.error_at([at[e.spp] for e in c], errors_of(c), time) for c in curves]
        return _cell(found)

    return _table(results, medians, cell)


def equal_error(results: Sequence[Result], seconds: Mapping[str, Mapping[tuple[int, int], float]]) -> Table:
    """Seconds that each method needs for the same relMSE. `seconds`: method -> (spp, repeat) -> seconds."""
    found = [level.relmse.value for r in results for level in r.levels if level.relmse and level.relmse.value > 0]

    def cell(result: Result, error: float) -> Cell | None:
        at, curves = seconds[result.name], complete_repeats(result.passes)
        times = [estimates.time_to([at[e.spp, e.repeat] for e in c], errors_of(c), error) for c in curves]
        first = next((level.relmse.value for level in result.levels if level.relmse), math.inf)
        return _cell(times, at_most=first <= error)

    return _table(results, found, cell, descending=True)


def _cell(found: Sequence[float | None], at_most: bool = False) -> Cell | None:
    """The mean of logarithms, where every repeat has a value."""
    known = [value for value in found if value is not None]
    if not known or len(known) < len(found):
        return None
    return Cell(estimates.geometric_mean(known), at_most)


def _table(results: Sequence[Result], values: Sequence[float], cell, descending: bool = False) -> Table:
    """A table with columns at round numbers between the `values`; at less round ones where those tell nothing.

    Without columns that fewer than two methods, or the only one, fill, and those in which all are good at once.
    """
    kept = {}
    for digits in ((1, 2, 5), [i / 10 for i in range(10, 100)]):
        columns = {value: [cell(r, value) for r in results if r.levels] for value in _series(values, digits)}
        for value, cells in columns.items():
            filled = [one for one in cells if one is not None]
            if len(filled) >= min(2, len(cells)) and not all(one.at_most for one in filled):
                kept[value] = cells
        if kept:
            break
    chosen = sorted(kept, reverse=descending)
    if len(chosen) > COLUMNS:
        chosen = [chosen[i] for i in np.linspace(0, len(chosen) - 1, COLUMNS).round().astype(int)]
    names = [r.name for r in results if r.levels]
    return Table(tuple(chosen), {name: tuple(kept[value][i] for value in chosen) for i, name in enumerate(names)})


def _series(values: Sequence[float], digits: Sequence[float]) -> tuple[float, ...]:
    """These digits times the powers of ten, between the smallest and the largest value."""
    if not values:
        return ()
    low, high = math.floor(math.log10(min(values))), math.ceil(math.log10(max(values)))
    steps = (float(f"{digit}e{power}") for power in range(low, high + 1) for digit in digits)
    return tuple(step for step in steps if min(values) <= step <= max(values))
