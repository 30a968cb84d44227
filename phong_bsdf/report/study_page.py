"""What pages of error against time are made of, whatever was measured: plots of curves, tables that sort."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from ..pictures.estimates import Estimate
from ..pictures.images import replace_file
from . import page, tables

MARKERS = "osD^vPX*"

# Inches; the height of two lines of text is about that of the page's text on a wide screen.
SIZE = (9.0, 4.6)
# Left, bottom, width and height of the axes, in shares of that.
AREA = (0.08, 0.1, 0.91, 0.87)

# What is drawn of an interval that reaches down to 0 or below.
LOWEST_SHARE = 0.03


@dataclass(frozen=True)
class Cell:
    """A cell of a table: what is read, and what is sorted by (None: the text)."""

    text: str
    value: float | None = None
    kind: str = ""
    """`best`, `words` or `bad`."""


@dataclass(frozen=True)
class Table:
    """A table that sorts."""

    id: str
    title: str
    headings: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    note: str


@dataclass(frozen=True)
class Point:
    """A point of a curve: where it is, how sure that is, and what is said about it."""

    x: float
    x_low: float
    x_high: float
    y: Estimate
    words: str


@dataclass(frozen=True)
class Curve:
    """One method in one plot."""

    name: str
    points: Sequence[Point]
    joined: bool = True
    floor: float | None = None
    """Where it levels off."""


@dataclass(frozen=True)
class Plot:
    """One drawing of several to choose from; the same curves in each."""

    id: str
    name: str
    x_label: str
    curves: Sequence[Curve]
    floors: Sequence[tuple[str, float]] = ()
    """What no curve can be told from: name and error."""


def number(x: float | None, kind: str = "") -> Cell:
    """A cell with a number."""
    return Cell(tables.number(x), x, kind)


def estimate(x: Estimate | None, kind: str = "") -> Cell:
    """A cell with a number and its interval."""
    return Cell("-", None, kind) if x is None else Cell(interval(x), x.value, kind)


def interval(x: Estimate) -> str:
    """`value (low–high)`."""
    if x.low is None or x.high is None:
        return tables.number(x.value)
    return f"{tables.number(x.value)} ({tables.number(x.low)} – {tables.number(x.high)})"


def legend(plots: Sequence[Plot]) -> list[dict[str, object]]:
    """Name and look of each curve."""
    names = [curve.name for curve in plots[0].curves] if plots else []
    return [{"name": name, "colour": _colour(i), "dashed": _dashed(i)} for i, name in enumerate(names)]


def drawn(plots: Sequence[Plot]) -> list[dict[str, object]]:
    """The plots as inline SVG; each point has a title."""
    import matplotlib

    with matplotlib.rc_context(page.ink_style()):
        return [{"id": plot.id, "name": plot.name, "svg": _inline(plot)} for plot in plots]


def write_svg(path: Path, plot: Plot) -> None:
    """The plot as a file, with its legend."""
    import matplotlib

    with matplotlib.rc_context({"font.size": 8}):
        figure, _ = _figure(plot, ink="black")
        if any(curve.points for curve in plot.curves):
            figure.axes[0].legend(loc="center left", bbox_to_anchor=(1, 0.5), frameon=False)
        figure.axes[0].set_position((AREA[0], AREA[1], 0.74, AREA[3]))
        replace_file(path, page.svg_file(figure))


def _inline(plot: Plot):
    from markupsafe import Markup

    figure, titles = _figure(plot, ink=page.INK)
    svg = page.svg(figure, f"{plot.name} against {plot.x_label}, double logarithmic; the tables hold the numbers")
    for identifier, words in titles.items():
        svg = re.sub(rf'(<g id="{identifier}">)', lambda m, w=words: f"{m[1]}<title>{escape(w)}</title>", svg, count=1)
    # matplotlib's other names are the same in every drawing of a page.
    return Markup(re.sub(r'<g id="(?!point-|line-|bars-|floor-)[^"]*">', "<g>", svg))


def _figure(plot: Plot, ink: str):
    """The drawing, and what is said about its points: identifier -> words."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, NullFormatter

    figure = Figure(figsize=SIZE)
    # Laying the figure out by its text would take longer than all the rest.
    axes = figure.add_axes(AREA, xscale="log", yscale="log")
    titles = {}
    for i, curve in enumerate(plot.curves):
        _curve(axes, plot, i, curve, titles)
    for i, (name, error) in enumerate(plot.floors):
        axes.axhline(error, color=ink, linewidth=0.7, linestyle=":")
        # Side by side: several can be at the same height.
        axes.annotate(name, (0.005 + 0.3 * i, error), xycoords=("axes fraction", "data"), fontsize=7, va="bottom")
    axes.set(xlabel=plot.x_label, ylabel=plot.name)
    axes.grid(which="major", alpha=0.35)
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(NullFormatter())
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    return figure, titles


def _curve(axes, plot: Plot, i: int, curve: Curve, titles: dict[str, str]) -> None:
    colour = _colour(i)
    shown = [point for point in curve.points if point.y.value > 0 and point.x > 0]
    if curve.joined and shown:
        xs, ys = [p.x for p in shown], [p.y.value for p in shown]
        style = {"linewidth": 1.4, "linestyle": "--" if _dashed(i) else "-", "marker": _marker(i), "markersize": 5}
        axes.plot(xs, ys, color=colour, label=curve.name, gid=f"line-{plot.id}-curve{i}", **style)
    for j, p in enumerate(shown):
        low = max(p.y.low if p.y.low is not None else p.y.value, LOWEST_SHARE * p.y.value)
        high = p.y.high if p.y.high is not None else p.y.value
        axes.plot([p.x, p.x], [low, high], color=colour, linewidth=1, gid=f"bars-{plot.id}-{j}-y-curve{i}")
        axes.plot([p.x_low, p.x_high], [p.y.value] * 2, color=colour, linewidth=1, gid=f"bars-{plot.id}-{j}-x-curve{i}")
        identifier = f"point-{plot.id}-{j}-curve{i}"
        titles[identifier] = p.words
        axes.plot([p.x], [p.y.value], color=colour, marker=_marker(i), markersize=5, gid=identifier)
    if curve.floor is not None and curve.floor > 0:
        axes.axhline(curve.floor, color=colour, linewidth=0.8, linestyle="-.", gid=f"floor-{plot.id}-curve{i}")


def _marker(i: int) -> str:
    return MARKERS[i % len(MARKERS)]


def _colour(i: int) -> str:
    return page.PALETTE[i % len(page.PALETTE)]


def _dashed(i: int) -> bool:
    # Where the colours begin again.
    return i // len(page.PALETTE) % 2 == 1
