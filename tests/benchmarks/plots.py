"""Plots of records, from nothing but the records. Needs matplotlib."""

from collections.abc import Sequence
from pathlib import Path

from phong_bsdf.pictures.images import replace_file
from phong_bsdf.report import page

from .measure import Record


def floor(figure, records):
    """Time over the ray floor, for each scene."""
    scenes = list(dict.fromkeys(row.scene for row in records))
    axes = figure.subplots()
    for i, task in enumerate(("whitted", "whitted, general")):
        rows = [_one(records, scene=scene, task=task, quantity="time / ray floor") for scene in scenes]
        places = [x + 0.4 * (i - 0.5) for x in range(len(scenes))]
        heights = [row.median for row in rows]
        spread = [[row.median - row.low for row in rows], [row.high - row.median for row in rows]]
        axes.bar(places, heights, 0.38, yerr=spread, label=task, capsize=3)
    axes.axhline(1, color="black", linewidth=0.8)
    axes.set_xticks(range(len(scenes)), scenes)
    axes.set_ylabel("time / ray floor")
    axes.legend()


def peers(figure, records):
    """Warm and cold times over the size of the picture, for each scene."""
    scenes = list(dict.fromkeys(row.scene for row in records))
    for axes, scene in zip(figure.subplots(1, len(scenes), sharey=True, squeeze=False)[0], scenes, strict=True):
        for i, program in enumerate(("phong_bsdf", "povray", "tachyon")):
            for kind, line in (("warm", "-"), ("cold", "--")):
                rows = _all(records, scene=scene, task=program, quantity=f"{kind} time")
                label = f"{program}, {kind}"
                axes.loglog(*_points(rows), line, color=f"C{i}", marker="o", markersize=3, label=label)
        axes.set(title=scene, xlabel="pixels of a side")
        _ticks(axes, records)
    figure.axes[0].set_ylabel("seconds")
    figure.legend(*figure.axes[-1].get_legend_handles_labels(), loc="outside lower center", ncols=6, fontsize="small")


def growth(figure, records):
    """Time, operations, compile time and memory over what grows."""
    lines = (("time", "seconds", 1), ("operations", "operations", 1), ("compile time", "compile seconds", 1),
             ("memory of the process", "process, MB", 2**-20))  # fmt: skip
    names = list(dict.fromkeys(row.scene for row in records))
    grid = figure.subplots(len(lines), len(names), sharex="col")
    for line, (quantity, label, scale) in zip(grid, lines, strict=True):
        for axes, name in zip(line, names, strict=True):
            _grown(axes, _all(records, scene=name, quantity=quantity), scale)
            if quantity == "time":
                axes.set_yscale("log")
                axes.autoscale(axis="y")
        line[0].set_ylabel(label)
    for axes, name in zip(grid[-1], names, strict=True):
        axes.set_xlabel(name)
        axes.set_xscale("linear" if name == "mirror bounces" else "log")
    grid[0][names.index("lights")].legend(fontsize="small")


def _grown(axes, rows, scale):
    """One panel: a line for each task."""
    most = 0.0
    for task in dict.fromkeys(row.task for row in rows):
        x, y = _points(_all(rows, task=task))
        y = [scale * value for value in y]
        axes.plot(x, y, marker="o", markersize=3, label=task)
        most = max(most, *y)
    axes.set_ylim(0, 1.15 * most)
    axes.tick_params(labelsize="small")


def cold(figure, records):
    """The stages of a cold start, one after the other."""
    axes = figure.subplots()
    stages = [r.quantity for r in _all(records, task="empty cache", unit="s") if r.quantity != "first picture"]
    tasks = ("plain Mitsuba", "filled cache", "empty cache")
    left = [0.0] * len(tasks)
    for stage in stages:
        widths = [sum(r.median for r in _all(records, task=task, quantity=stage)) for task in tasks]
        axes.barh(tasks, widths, left=left, label=stage)
        left = [a + b for a, b in zip(left, widths, strict=True)]
    axes.set_xlabel("seconds")
    axes.legend(ncols=len(stages), fontsize="small", loc="lower center", bbox_to_anchor=(0.5, 1))


def cluster(figure, records):
    """The predicted speed-up over the number of workers, and what was measured here."""
    axes = figure.subplots()
    workers, speedup = _points(_all(records, task="predicted", quantity="speedup"))
    axes.loglog(workers, workers, color="grey", linewidth=0.8, label="all workers at work all the time")
    axes.loglog(workers, speedup, marker="o", markersize=3, label="predicted: an hour of one process")
    once = _one(records, task="no cluster", quantity="time of the picture").median
    measured = [_one(records, task=name, quantity="time of the picture") for name in ("1 process", "2 processes")]
    axes.loglog((1, 2), [once / row.median for row in measured], "x", color="C1", label="measured on two cores")
    axes.set(xlabel="workers", ylabel="speed-up")
    axes.legend(fontsize="small")


PLOTS = {
    "floor": (floor, (8, 3.5)),
    "peers": (peers, (10, 4)),
    "growth": (growth, (12, 9)),
    "cold": (cold, (8, 2.5)),
    "cluster": (cluster, (7, 4)),
}


def draw(path: Path, name: str, records: Sequence[Record]) -> None:
    """The plot of one benchmark as SVG; a file that does not change when its numbers do not."""
    from matplotlib.figure import Figure

    plot, size = PLOTS[name]
    figure = Figure(figsize=size, layout="constrained")
    plot(figure, records)
    replace_file(path, page.svg_file(figure))


def _all(records, **where):
    return [row for row in records if all(getattr(row, name) == value for name, value in where.items())]


def _one(records, **where):
    return _all(records, **where)[0]


def _points(rows):
    return [row.x for row in rows], [row.median for row in rows]


def _ticks(axes, records):
    sides = sorted({row.x for row in records})
    axes.set_xticks(sides, [f"{side:g}" for side in sides], fontsize="small")
    axes.set_xticks([], minor=True)
