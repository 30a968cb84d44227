"""Error against time of rendering methods: a table, CSV, JSON, picture files and one HTML page."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..convergence import conclusions, study, tradeoff
from ..convergence.conclusions import Conclusions
from ..pictures.images import write as write_image
from ..pictures.metrics import EPSILON, FLIP_EXPOSURES
from . import page, tables
from .convergence_tables import NAMES, NOT_YET, all_tables, finest_level, verdict
from .study_page import Curve, Plot, Point, drawn, interval, legend, write_svg

PAGE = "index.html"


def text_table(found: Conclusions) -> str:
    """One line for each method."""
    headings = ("method", "reference", "spp", "seconds", "relMSE", "slope", "efficiency", "bias")
    lines = []
    for result in found.results:
        finest = finest_level(result)
        if finest is None:
            lines.append(
                (result.name, result.reference, "-", "-", "-", "-", "-", "failed" if result.failure else NOT_YET)
            )
            continue
        numbers = [finest.relmse and finest.relmse.value, result.slope and result.slope.value,
                   result.efficiency and result.efficiency.value]  # fmt: skip
        lines.append((result.name, result.reference, str(finest.spp), tables.number(finest.seconds.median),
                      *map(tables.number, numbers), verdict(result)))  # fmt: skip
    return tables.text_table(headings, lines)


def brief(found: Conclusions) -> list[str]:
    """What a reader wants first: which methods are best after the longest time in common, and which are biased."""
    sentences = []
    for reference in found.references:
        names = [r.name for r in found.results if r.reference == reference.name and r.levels]
        sentences += _best(found.equal_time, names, reference.name)
    for result in found.results:
        if result.verdict == "biased":
            sentences.append(f"{result.name}: its error {verdict(result)}; more time does not bring it below. This is "
                             f"sure to {100 * study.SURE:g} %.")  # fmt: skip
    return sentences or ["There is not enough to compare yet."]


def warnings(found: Conclusions) -> list[str]:
    """What went wrong or is missing."""
    said = [f"{r.name} failed: {r.failure}" for r in found.results if r.failure]
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
    plots = _plots(found)
    write_svg(folder / f"{plots[0].id}.svg", plots[0])
    _write_page(folder / PAGE, found, pictures, plots)
    return folder / PAGE


def _write_page(path: Path, found: Conclusions, pictures: Mapping[str, np.ndarray], plots: list[Plot]) -> None:
    run, against = found.run, conclusions.against(found.run)
    maps = _maps(pictures, against)
    scale = _map_scale(maps)
    # Methods first: theirs are the keys from 1 on.
    ordered = {name: pictures[name] for name in (*maps, *(name for name in pictures if name not in maps))}
    size = next((f"{image.shape[1]} × {image.shape[0]}, " for image in pictures.values()), "")
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
            "note": "Points: median seconds of the passes with as many samples, and their mean error; bars: quartiles "
            "of the seconds, 95 % confidence of the error. Dash-dotted: where a method levels off. Dotted: the "
            "reference's own error.",
        },
        viewer=page.viewer(ordered, scale, {name: against[name] for name in maps}) if pictures else None,
        gallery=_gallery(found, pictures, maps, scale) if pictures else None,
        tables=all_tables(found),
    )  # fmt: skip


def _plots(found: Conclusions) -> list[Plot]:
    metrics = [m for m in study.METRICS if any(getattr(n, m) for r in found.results for n in r.levels)] or ["relmse"]
    plots = []
    for metric in metrics:
        curves = [Curve(r.name, _points(r, metric), floor=_floor(r, metric)) for r in found.results]
        own = {r.name: getattr(r, metric, None) for r in found.references}
        floors = [(f"own error of reference {name}", e) for name, e in own.items() if e and e > 0]
        plots.append(Plot(metric, NAMES[metric], "seconds", curves, floors))
    return plots


def _floor(result: study.Result, metric: str) -> float | None:
    return result.bias.value if metric == "relmse" and result.verdict == "biased" else None


def _points(result: study.Result, metric: str) -> list[Point]:
    return [
        Point(
            level.seconds.median, level.seconds.low, level.seconds.high, error,
            f"{result.name}, {level.spp} spp: {tables.number(level.seconds.median)} s, "
            f"{NAMES[metric]} {interval(error)}, {level.passes} passes",
        )
        for level in result.levels
        if (error := getattr(level, metric)) is not None
    ]  # fmt: skip


def _gallery(found: Conclusions, pictures, maps, scale: float) -> dict[str, object]:
    captions = {
        s.method: f"{s.spp} spp, {tables.number(s.seconds)} s, relMSE {tables.number(s.relmse)}" for s in found.shown
    }
    return {
        "title": f"Pictures after about {tables.number(found.picture_seconds)} s",
        "pictures": [
            {
                "name": name, "image": page.picture(image),
                "map": page.picture(page.false_colours(maps[name], scale), linear=True) if name in maps else None,
                "caption": captions.get(name, ""),
            }
            for name, image in pictures.items()
        ],
        "note": "Of each method, the first pass at the number of samples that takes the time closest to this. Below "
        "each picture: |difference to its reference|, mean over the colours, from black (0) to bright "
        f"({tables.number(scale)} and more).",
    }  # fmt: skip


def _maps(pictures: Mapping[str, np.ndarray], against: Mapping[str, str]) -> dict[str, np.ndarray]:
    """Picture of a method -> its difference to its reference."""
    with np.errstate(invalid="ignore", over="ignore"):
        return {name: image - pictures[against[name]] for name, image in pictures.items() if name in against}


def _map_scale(maps: Mapping[str, np.ndarray]) -> float:
    """The difference that the brightest colour stands for: that of the middle method, or the worst leaves all dark."""
    with np.errstate(invalid="ignore", over="ignore"):
        return float(np.median([page.difference_scale([one]) for one in maps.values()] or [1.0]))


def _best(table: tradeoff.Table, names: list[str], reference: str) -> list[str]:
    """The three best after the longest time for which there are two or more."""
    for i in reversed(range(len(table.columns))):
        known = [(n, table.rows[n][i].estimate) for n in names if n in table.rows and table.rows[n][i]]
        if len(known) > 1:
            (first, least), *others = sorted(known, key=lambda pair: pair[1].value)[:3]
            return [
                f"After {tables.number(table.columns[i])} s, {first} is closest to the reference {reference}: "
                f"relMSE {interval(least)}; then {', '.join(f'{name} {interval(e)}' for name, e in others)}."
            ]
    return []
