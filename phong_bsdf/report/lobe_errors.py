"""Error against time of the lobes' formulas, on the same page as that of rendering methods."""

from collections.abc import Sequence
from pathlib import Path

from ..convergence.lobe_errors import LobeError, LobeErrors
from . import page, tables
from .study_page import Cell, Curve, Plot, Point, Table, drawn, estimate, interval, legend, number

PAGE = "index.html"

# Larger errors, and infinite ones, are drawn here: there is no digit left.
WORST_DRAWN = 1e3

QUANTITIES = {"value": "value", "pdf": "density", "sample": "sampled sine", "normalization": "normalisation"}


def text_table(found: LobeErrors) -> str:
    """One line for each formula."""
    lines = [
        (f"{r.quantity}, {r.lobe}, {r.formula}", f"{r.p:g}", tables.number(r.error.value),
         tables.number(r.nanoseconds.median))
        for r in found.rows
    ]  # fmt: skip
    return tables.text_table(("quantity, lobe, formula", "p", "worst error", "ns"), lines)


def write(folder: Path, found: LobeErrors) -> Path:
    """Write everything into `folder`, the page last; returns the page's path."""
    folder, run = Path(folder), found.run
    tables.write_json(folder / "lobe-errors.json", found.rows, run=run)
    plots = _plots(found.rows)
    page.write(
        folder / PAGE,
        "study.html",
        title="Formulas of the lobes: error against time",
        summary=f"{run.variant}, {run.cases} inputs, {found.made} repeats, seed {run.seed}; "
        f"measured with {run.versions} on {run.machine}",
        context=tables.context(),
        brief=brief(found.rows) or ["Nothing has been measured yet."],
        warnings=[f"{run.repeats - found.made} repeats are missing."] if found.made < run.repeats else [],
        chart={
            "title": "Error against time", "label": "Quantity", "plots": drawn(plots), "curves": legend(plots),
            "note": "A point for each exponent. Bars: quartiles of the time; 95 % confidence of the worst error, "
            f"from repeats with other inputs. Errors above {WORST_DRAWN:g} are drawn there.",
        },
        viewer=None,
        gallery=None,
        tables=[_table(found.rows)],
    )  # fmt: skip
    return folder / PAGE


def brief(rows: Sequence[LobeError]) -> list[str]:
    """For each lobe: what the stable value costs, and what it buys, at the largest exponent."""
    largest, said = max((row.p for row in rows), default=0.0), []
    for lobe in dict.fromkeys(row.lobe for row in rows):
        values = {r.formula: r for r in rows if (r.lobe, r.quantity, r.p) == (lobe, "value", largest)}
        stable = values.pop("stable")
        for formula, other in values.items():
            errors = [tables.number(row.error.value) for row in (stable, other)]
            ratio = stable.nanoseconds.median / other.nanoseconds.median
            said.append(
                f"{lobe}, p = {largest:g}: the stable value is off by {errors[0]} at worst, the {formula} one by "
                f"{errors[1]}; the stable one takes {ratio:.2f} times as long."
            )
    return said


def _plots(rows: Sequence[LobeError]) -> list[Plot]:
    # The same curves in each plot, so that a colour means one thing.
    names = list(dict.fromkeys((row.lobe, row.formula) for row in rows))
    plots = []
    for quantity, words in QUANTITIES.items():
        curves = [
            Curve(f"{lobe}, {formula}", _points(rows, quantity, lobe, formula), joined=False) for lobe, formula in names
        ]
        plots.append(Plot(quantity, f"worst relative error of the {words}", "nanoseconds per evaluation", curves))
    return plots


def _points(rows: Sequence[LobeError], quantity: str, lobe: str, formula: str) -> list[Point]:
    chosen = [row for row in rows if (row.quantity, row.lobe, row.formula) == (quantity, lobe, formula)]
    return [
        Point(
            row.nanoseconds.median, row.nanoseconds.low, row.nanoseconds.high,
            row.error.map(lambda e: min(max(e, 1e-9), WORST_DRAWN)),
            f"{lobe}, {formula}, p = {row.p:g}: {tables.number(row.nanoseconds.median)} ns, "
            f"error {interval(row.error)}",
        )
        for row in chosen
    ]  # fmt: skip


def _table(rows: Sequence[LobeError]) -> Table:
    headings = ("lobe", "quantity", "formula", "p", "worst error", "ns", "quartiles")
    cells = [
        [
            Cell(row.lobe), Cell(QUANTITIES[row.quantity]), Cell(row.formula), Cell(f"{row.p:g}", row.p),
            estimate(row.error), number(row.nanoseconds.median),
            Cell(f"{tables.number(row.nanoseconds.low)} – {tables.number(row.nanoseconds.high)}", row.nanoseconds.low),
        ]
        for row in rows
    ]  # fmt: skip
    note = "Worst relative error over all inputs; in brackets, where there are repeats, its 95 % confidence interval."
    return Table("lobes", "All numbers", headings, cells, note)
