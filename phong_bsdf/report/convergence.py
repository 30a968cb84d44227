"""Error against time of rendering methods: a table, CSV, JSON, picture files and one HTML page."""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from .. import conclusions, study
from ..conclusions import Conclusions
from ..images import write as write_image
from ..metrics import EPSILON, FLIP_EXPOSURES
from . import page, tables
from .study import Cell, Curve, Plot, Point, Table, drawn, estimate, interval, legend, number

PAGE = "index.html"
NAMES = {"relmse": "relMSE", "mse": "MSE", "max_error": "largest error", "flip": "FLIP"}

# Beside the first, brighter ones take the largest colour: single bright pixels would leave a map dark.
MAP_PERCENTILE = 99.0

ERRORS = (
    f"relMSE: mean of (x - r)² / (r² + {EPSILON:g}), r the reference. relMSE and MSE are without the reference's own noise. "
    "FLIP: HDR-FLIP at -2, 0 and +2 stops, 0 to 1; “-”: not installed. "
    "In brackets: 95 % confidence intervals, from independent passes."
)


def text_table(found: Conclusions) -> str:
    """One line for each method."""
    headings = ("method", "reference", "spp", "seconds", "relMSE", "slope", "efficiency", "bias")
    lines = []
    for result in found.results:
        finest = _finest(result)
        if finest is None:
            lines.append((result.name, result.reference, "-", "-", "-", "-", "-", _failure(result)))
            continue
        numbers = [finest.relmse and finest.relmse.value, result.slope and result.slope.value,
                   result.efficiency and result.efficiency.value]  # fmt: skip
        lines.append((result.name, result.reference, str(finest.spp), tables.number(finest.seconds.median),
                      *map(tables.number, numbers), verdict(result)))  # fmt: skip
    return tables.text_table(headings, lines)


def verdict(result: study.Result) -> str:
    """Whether, and where, the error levels off."""
    finest = _finest(result)
    if result.verdict == "biased":
        level = result.bias.value
        return f"levels off at {tables.number(level)} ({100 * math.sqrt(max(level, 0)):.2g} %)"
    if result.verdict == "unbiased":
        return f"none found, at most {tables.number(max(result.bias.high, 0))}"
    words = {"falling": "the error still falls", "reference": "the error is the reference's own"}
    if result.verdict in words:
        return words[result.verdict]
    return "-" if finest is None or finest.relmse is None else "too few passes"


def brief(found: Conclusions) -> list[str]:
    """What a reader wants first: the best method for each reference after the longest time in common, and who is biased."""
    sentences = []
    for reference in found.references:
        names = [r.name for r in found.results if r.reference == reference.name and r.levels]
        sentences += _best(found.equal_time, names, reference.name)
    for result in found.results:
        if result.verdict == "biased":
            sentences.append(f"{result.name}: its error {verdict(result)}; more time does not help.")
    return sentences or ["There is not enough to compare yet."]


def warnings(found: Conclusions) -> list[str]:
    """What went wrong or is missing."""
    said = [f"{r.name} failed: {_failure(r)}" for r in found.results if not r.levels]
    for result in found.results:
        bad = {level.spp: level.nonfinite for level in result.levels if level.nonfinite}
        if bad:
            where = ", ".join(f"{count} at {spp} spp" for spp, count in bad.items())
            said.append(f"{result.name}: pixels that are no numbers: {where}; no error is formed there.")
    for reference in found.references:
        if reference.nonfinite:
            said.append(f"reference {reference.name}: {reference.nonfinite} pixels are no numbers; no error is formed.")
    if found.missing:
        said.append(f"{found.missing} of {found.missing + len(found.rows)} passes are missing; "
                    "the same command again makes them.")  # fmt: skip
    return said


def write(folder: Path, found: Conclusions, pictures: Mapping[str, np.ndarray]) -> Path:
    """Write everything into `folder`, the page last; returns the page's path."""
    folder = Path(folder)
    (folder / "pictures").mkdir(parents=True, exist_ok=True)
    for name, image in pictures.items():
        write_image(folder / "pictures" / f"{name.replace(' ', '-')}.exr", image, metadata={"scene": found.run.scene})
    if found.rows:
        tables.write_csv(folder / "passes.csv", found.rows)
    tables.write_json(
        folder / "convergence.json", found.rows, run=found.run, results=found.results, references=found.references,
        equal_time=found.equal_time, equal_error=found.equal_error, pictures=found.shown,
        relmse_epsilon=EPSILON, flip_exposures=FLIP_EXPOSURES,
    )  # fmt: skip
    _write_page(folder / PAGE, found, pictures)
    return folder / PAGE


def _write_page(path: Path, found: Conclusions, pictures: Mapping[str, np.ndarray]) -> None:
    run, against = found.run, conclusions.against(found.run)
    scale = _map_scale(pictures, against)
    size = next((f"{image.shape[1]} × {image.shape[0]}, " for image in pictures.values()), "")
    plots = _plots(found)
    page.write(
        path,
        "study.html",
        title=f"{run.scene}: error against time",
        summary=f"{size}{run.variant}, {run.repeats} repeats, seed {run.seed}, scene {run.scene_hash}; "
        f"measured with {run.versions} on {run.machine}",
        context=tables.context(),
        brief=brief(found),
        warnings=warnings(found),
        chart={
            "title": "Error against time", "label": "Error", "plots": drawn(plots), "curves": legend(plots),
            "note": "Points: median seconds of the passes with as many samples, and their mean error; bars: quartiles of "
            "the seconds, 95 % confidence of the error. Dash-dotted: where a method levels off. Dotted: the reference's own error.",
        },
        viewer=page.viewer(pictures, scale, {k: v for k, v in against.items() if k in pictures}) if pictures else None,
        gallery=_gallery(found, pictures, against, scale) if pictures else None,
        tables=[_methods(found), _equal_time(found), _equal_error(found), _levels(found), _references(found)],
    )  # fmt: skip


def _plots(found: Conclusions) -> list[Plot]:
    metrics = [m for m in study.METRICS if any(getattr(n, m) for r in found.results for n in r.levels)] or ["relmse"]
    plots = []
    for metric in metrics:
        curves = [
            Curve(r.name, _points(r, metric), floor=r.bias.value if metric == "relmse" and r.verdict == "biased" else None)
            for r in found.results
        ]
        own = {r.name: getattr(r, metric, None) for r in found.references}
        floors = [(f"own error of reference {name}", e) for name, e in own.items() if e and e > 0]
        plots.append(Plot(metric, NAMES[metric], "seconds", curves, floors))
    return plots


def _points(result: study.Result, metric: str) -> list[Point]:
    return [
        Point(
            level.seconds.median, level.seconds.low, level.seconds.high, error,
            f"{result.name}, {level.spp} spp: {tables.number(level.seconds.median)} s, {NAMES[metric]} {interval(error)}, "
            f"{level.passes} passes",
        )
        for level in result.levels
        if (error := getattr(level, metric)) is not None
    ]  # fmt: skip


def _methods(found: Conclusions) -> Table:
    headings = ("method", "integrator", "sampler", "lobes sampled by", "BSDFs", "reference", "finest spp", "seconds",
                "relMSE", "bias", "slope", "slope over spp", "efficiency", "warm-up s")  # fmt: skip
    specs = {method.name: method.spec for method in found.run.methods}
    rows = []
    for result in found.results:
        spec, finest = specs[result.name], _finest(result)
        parameters = "".join(f", {k} = {v}" for k, v in spec["parameters"].items())
        words = [(spec["integrator"] or found.run.integrator) + parameters, spec["sampler"],
                 "-" if spec["bsdf"] else spec["sampling"], spec["bsdf"] or "the scene's", result.reference]  # fmt: skip
        cells = [Cell(result.name), *map(Cell, words)]
        if finest is None:
            rows.append([*cells, *[Cell("-")] * 3, Cell(_failure(result), kind="words bad"), *[Cell("-")] * 4])
            continue
        rows.append([
            *cells, Cell(str(finest.spp), finest.spp), number(finest.seconds.median), estimate(finest.relmse),
            Cell(verdict(result), result.bias and result.bias.value), estimate(result.slope), estimate(result.slope_spp),
            estimate(result.efficiency), number(max(level.seconds_warmup for level in result.levels)),
        ])  # fmt: skip
    return Table(
        "methods", "Methods", headings, rows,
        "Bias: the part of relMSE that more samples would not remove, called so where it is sure to 99 %; its root in per cent. "
        "Slope: of log relMSE against log seconds (-1: Monte Carlo; the fixed cost of a rendering makes it steeper), and against "
        "samples. Efficiency: 1 / (variance × seconds), at the finest level. Warm-up: what the first rendering took longer, "
        "compiling mostly; it is in no other number.",
    )  # fmt: skip


def _equal_time(found: Conclusions) -> Table:
    headings = [f"{tables.number(t)} s" for t in found.equal_time.columns]
    return _cells("equal-time", "relMSE at equal time", headings, found.equal_time, found,
                  "Between two measured points on a straight line of logarithms; “-”: the method was not given as much, or as "
                  "little, time. Bold: the least of those with the same reference.")  # fmt: skip


def _equal_error(found: Conclusions) -> Table:
    headings = [f"relMSE {tables.number(e)}" for e in found.equal_error.columns]
    return _cells("equal-error", "Seconds for equal error", headings, found.equal_error, found,
                  "“≤”: the fewest samples are enough. “-”: not reached with the most samples. Bold: the least of those with the "
                  "same reference.")  # fmt: skip


def _cells(identifier: str, title: str, headings, table: study.Table, found: Conclusions, note: str) -> Table:
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
    return Table("references", "References", ("reference", "made of", "passes", "spp", "own relMSE", "own MSE", "bad pixels"),
                 rows, "Own errors: of passes, their mean's variance; of a grid, at most its distance to the grid with half as "
                 "many samples across; of a file they are not known.")  # fmt: skip


def _gallery(found: Conclusions, pictures, against, scale: float) -> dict[str, object]:
    captions = {
        s.method: f"{s.spp} spp, {tables.number(s.seconds)} s, relMSE {tables.number(s.relmse)}" for s in found.shown
    }
    with np.errstate(invalid="ignore", over="ignore"):
        maps = {name: image - pictures[against[name]] for name, image in pictures.items() if name in against}
    return {
        "title": f"Pictures after about {tables.number(found.picture_seconds)} s",
        "pictures": [
            {
                "name": name, "image": page.picture(np.broadcast_to(image, (*image.shape[:2], 3))),
                "map": page.picture(page.false_colours(maps[name], scale), linear=True) if name in maps else None,
                "caption": captions.get(name, ""),
            }
            for name, image in pictures.items()
        ],
        "note": "Of each method, the first pass at the number of samples that takes the time closest to this. Below each picture: "
        f"|difference to its reference|, mean over the colours, from black (0) to bright ({tables.number(scale)} and more).",
    }  # fmt: skip


def _map_scale(pictures, against) -> float:
    """The difference that the brightest colour of every map stands for."""
    found = []
    with np.errstate(invalid="ignore", over="ignore"):
        for name, reference in against.items():
            if name in pictures and reference in pictures:
                difference = np.abs(pictures[name] - pictures[reference]).mean(axis=-1)
                found.append(difference[np.isfinite(difference)])
    return max((float(np.percentile(d, MAP_PERCENTILE)) for d in found if d.size), default=0.0) or 1.0


def _best(table: study.Table, names: list[str], reference: str) -> list[str]:
    """The three best after the longest time for which there are two or more."""
    for i in reversed(range(len(table.columns))):
        known = sorted((table.rows[n][i].estimate.value, n) for n in names if n in table.rows and table.rows[n][i])
        if len(known) > 1:
            others = ", ".join(f"{name} {tables.number(e)}" for e, name in known[1:3])
            return [f"After {tables.number(table.columns[i])} s, {known[0][1]} is closest to the reference {reference}: "
                    f"relMSE {tables.number(known[0][0])}; then {others}."]  # fmt: skip
    return []


def _finest(result: study.Result) -> study.Level | None:
    return result.levels[-1] if result.levels else None


def _failure(result: study.Result) -> str:
    return result.failure or "no pass"
