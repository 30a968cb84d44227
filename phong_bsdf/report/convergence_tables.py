"""The tables of a page of error against time, and the words for what they say."""

import math

from ..convergence import study, tradeoff
from ..convergence.conclusions import Conclusions
from ..pictures.metrics import EPSILON
from . import tables
from .study_page import Cell, Table, estimate, interval, number

NAMES = {"relmse": "relMSE", "mse": "MSE", "max_error": "largest error", "flip": "FLIP"}

# Of a method without a pass, or without a reference.
NOT_YET = "not measured yet"

ERRORS = (
    f"relMSE: mean of (x - r)² / (r² + {EPSILON:g}), r the reference. relMSE and MSE are without the reference's own "
    "noise. FLIP: HDR-FLIP at -2, 0 and +2 stops, 0 to 1; “-”: not installed. In brackets: 95 % confidence "
    "intervals, from independent passes."
)


def all_tables(found: Conclusions) -> list[Table]:
    """In the order of the page."""
    return [_methods(found), _equal_time(found), _equal_error(found), _levels(found), _references(found)]


def equal_time_text(found: Conclusions) -> str:
    """relMSE at equal time, one line for each method."""
    headings = ("method", *(f"{tables.number(t)} s" for t in found.equal_time.columns), "bias")
    verdicts = {result.name: verdict(result) for result in found.results}
    lines = [
        (name, *(tables.number(cell and cell.estimate.value) for cell in cells), verdicts[name])
        for name, cells in found.equal_time.rows.items()
    ]
    return tables.text_table(headings, lines)


def verdict(result: study.Result) -> str:
    """Whether, and where, the error levels off."""
    finest = finest_level(result)
    if result.verdict == "biased":
        level = result.bias.value
        return f"levels off at {tables.number(level)} ({100 * math.sqrt(max(level, 0)):.2g} %)"
    if result.verdict == "unbiased":
        return f"none found, at most {tables.number(max(result.bias.high or 0.0, 0.0))}"
    words = {"falling": "the error still falls", "reference": "the error is the reference's own"}
    if result.verdict in words:
        return words[result.verdict]
    return "-" if finest is None or finest.relmse is None else "too few passes"


def finest_level(result: study.Result) -> study.Level | None:
    """The level with the most samples."""
    return result.levels[-1] if result.levels else None


def _why(result: study.Result) -> Cell:
    """Why a method has no level, as a cell."""
    return Cell(result.failure, kind="words bad") if result.failure else Cell(NOT_YET, kind="words")


def _methods(found: Conclusions) -> Table:
    headings = ("method", "relMSE", "seconds", "spp", "bias", "slope", "slope over spp", "efficiency", "warm-up s",
                "reference", "integrator", "sampler", "lobes sampled by", "BSDFs")  # fmt: skip
    specs = {method.name: method.spec for method in found.run.methods}
    rows = []
    for result in found.results:
        spec, finest = specs[result.name], finest_level(result)
        parameters = "".join(f", {k} = {v}" for k, v in spec["parameters"].items())
        words = [result.reference, (spec["integrator"] or found.run.integrator) + parameters, spec["sampler"],
                 "-" if spec["bsdf"] else spec["sampling"], spec["bsdf"] or "the scene's"]  # fmt: skip
        if finest is None:
            numbers = [*[Cell("-")] * 3, _why(result), *[Cell("-")] * 4]
        else:
            numbers = [
                estimate(finest.relmse), number(finest.seconds.median), Cell(str(finest.spp), finest.spp),
                Cell(verdict(result), result.bias and result.bias.value), estimate(result.slope),
                estimate(result.slope_spp), estimate(result.efficiency),
                number(max(level.seconds_warmup for level in result.levels)),
            ]  # fmt: skip
        rows.append([Cell(result.name), *numbers, *map(Cell, words)])
    return Table(
        "methods", "Methods", headings, rows,
        "relMSE, seconds and efficiency at the most samples (spp). Bias: the part of relMSE that more samples would "
        "not remove, called so where it is sure to 99 %; its root in per cent. Slope: of log relMSE against log "
        "seconds (-1: Monte Carlo), over the levels that take at least twice as long as the cheapest, and against "
        "samples, over all. Efficiency: 1 / (variance × seconds). Warm-up: what the first rendering took longer, "
        "compiling mostly; it is in no other number.",
    )  # fmt: skip


def _equal_time(found: Conclusions) -> Table:
    headings = [f"{tables.number(t)} s" for t in found.equal_time.columns]
    return _cells("equal-time", "relMSE at equal time", headings, found.equal_time, found,
                  "Between two measured points on a straight line of logarithms; “-”: the method was not given as "
                  "much, or as little, time. In brackets: 95 % confidence of the error at the median times. Bold: the "
                  "least of those with the same reference.")  # fmt: skip


def _equal_error(found: Conclusions) -> Table:
    headings = [f"relMSE {tables.number(e)}" for e in found.equal_error.columns]
    return _cells("equal-error", "Seconds for equal error", headings, found.equal_error, found,
                  "“≤”: the fewest samples are enough. “-”: not reached with the most samples. Bold: the least of "
                  "those with the same reference.")  # fmt: skip


def _cells(identifier: str, title: str, headings, table: tradeoff.Table, found: Conclusions, note: str) -> Table:
    references = {result.name: result.reference for result in found.results}
    rows = []
    for name, cells in table.rows.items():
        row = [Cell(name), Cell(references[name])]
        for i, cell in enumerate(cells):
            if cell is None:
                row.append(Cell("-"))
                continue
            rivals = [r[i] for n, r in table.rows.items() if r[i] is not None and references[n] == references[name]]
            best = len(rivals) > 1 and cell.estimate.value == min(rival.estimate.value for rival in rivals)
            text = ("≤ " if cell.at_most else "") + interval(cell.estimate)
            row.append(Cell(text, cell.estimate.value, "best" if best else ""))
        rows.append(row)
    return Table(identifier, title, ("method", "reference", *headings), rows, note)


def _levels(found: Conclusions) -> Table:
    headings = ("method", "spp", "passes", "seconds", "quartiles", *NAMES.values(), "variance", "bias²", "bad pixels")
    rows = [
        [
            Cell(result.name), Cell(str(n.spp), n.spp), Cell(str(n.passes), n.passes), number(n.seconds.median),
            Cell(f"{tables.number(n.seconds.low)} – {tables.number(n.seconds.high)}", n.seconds.low),
            *(estimate(getattr(n, metric)) for metric in study.METRICS), estimate(n.variance), estimate(n.bias),
            Cell(str(n.nonfinite), n.nonfinite, "bad" if n.nonfinite else ""),
        ]
        for result in found.results for n in result.levels
    ]  # fmt: skip
    return Table("levels", "All numbers", headings, rows, ERRORS + " Variance and bias² add up to relMSE.")


def _references(found: Conclusions) -> Table:
    kinds = {"passes": "passes of other seeds", "grid": "regular grid", "file": "a file"}
    rows = [
        [Cell(r.name), Cell(kinds[r.kind]), Cell(str(r.passes), r.passes), Cell(str(r.spp or "-"), r.spp),
         number(r.relmse), number(r.mse), Cell(str(r.nonfinite), r.nonfinite)]
        for r in found.references
    ]  # fmt: skip
    headings = ("reference", "made of", "passes", "spp", "own relMSE", "own MSE", "bad pixels")
    note = (
        "Own errors: of passes, their mean's variance; of a grid, at most its distance to the grid with half as many "
        "samples across; of a file they are not known."
    )
    return Table("references", "References", headings, rows, note)
