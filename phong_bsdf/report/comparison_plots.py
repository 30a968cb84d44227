"""Plots of a comparison, as inline SVG: the lobes of each surface in polar coordinates, and its albedo."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..comparison import ORIGINAL, Comparison
from ..reflection.curves import ALBEDO_ANGLES, LOBE_ANGLES, Curves
from . import page

# Inches; about the size on a wide page.
SIZE = (2.7, 1.75)

# The radius of a polar plot over the original's peak.
HEADROOM = 1.3


@dataclass(frozen=True)
class Plot:
    """One drawing."""

    svg: str
    peaks: dict[str, float]
    """Picture -> largest value, where that can be outside of the plot."""


def colours(comparison: Comparison) -> dict[str, str]:
    """Each picture's colour in the plots, as CSS."""
    others = [row.picture for row in comparison.rows if row.picture != ORIGINAL]
    return {ORIGINAL: "currentColor", **{name: page.PALETTE[i % len(page.PALETTE)] for i, name in enumerate(others)}}


def plots(comparison: Comparison) -> dict[str, list[Plot]]:
    """For each surface: a polar plot for each angle of incidence, and the albedo."""
    import matplotlib

    inks = {name: colour.replace("currentColor", page.INK) for name, colour in colours(comparison).items()}
    surfaces = dict.fromkeys(curves.surface for curves in comparison.curves)
    with matplotlib.rc_context(page.ink_style()):
        return {
            surface: [
                *(_polar(chosen, inks, i) for i in range(len(LOBE_ANGLES))),
                _albedo(chosen, inks),
            ]
            for surface in surfaces
            if (chosen := [curves for curves in comparison.curves if curves.surface == surface])
        }


def _polar(chosen: list[Curves], inks: dict[str, str], which: int):
    """f cos(theta_o) over the outgoing angle; light or viewer comes from the left."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    figure = Figure(figsize=SIZE)
    # A square, of which matplotlib fills the middle half: it may reach out of the drawing.
    side = 0.82 * SIZE[0] / SIZE[1]
    axes: Any = figure.add_axes((0.09, 0.46 - side / 2, 0.82, side), projection="polar")
    peaks = {curves.picture: max(value for _, value in curves.lobes[which]) for curves in chosen}
    for curves in chosen:
        angles, values = np.transpose(curves.lobes[which])
        axes.plot(np.radians(angles), values, color=inks[curves.picture], linewidth=_width(curves))
    incidence = np.radians(-LOBE_ANGLES[which])
    # The scale is the original's: at grazing angles a physical highlight can be a hundred times higher.
    axes.set(theta_offset=np.pi / 2, theta_direction=-1, thetamin=-90, thetamax=90)
    rim = HEADROOM * peaks[ORIGINAL] or 1.0
    axes.set_rticks([tick for tick in MaxNLocator(3).tick_values(0, rim) if 0 < tick < 0.97 * rim])
    axes.set_rlim(0, rim)
    axes.annotate("", (incidence, 0), (incidence, rim), arrowprops={
        "arrowstyle": "->", "color": page.INK, "linewidth": 0.8, "linestyle": ":", "shrinkA": 0, "shrinkB": 0,
    })  # fmt: skip
    axes.set_xticks(np.radians([-90, -60, -30, 0, 30, 60, 90]))
    axes.set_xticklabels(["90°", "60°", "30°", "0°", "30°", "60°", "90°"])
    axes.tick_params(pad=0)
    figure.text(0.5, 0.98, f"incidence {LOBE_ANGLES[which]}°", fontsize=9, ha="center", va="top")
    drawing = page.svg(figure, f"f cos of {chosen[0].surface} at {LOBE_ANGLES[which]} degrees of incidence")
    return Plot(drawing, peaks)


def _albedo(chosen: list[Curves], inks: dict[str, str]):
    from matplotlib.figure import Figure

    figure = Figure(figsize=SIZE, layout="constrained")
    axes = figure.add_subplot()
    for curves in chosen:
        axes.plot(ALBEDO_ANGLES, curves.albedos, color=inks[curves.picture], linewidth=_width(curves))
    axes.set(xlim=(0, 90), xticks=range(0, 91, 30), ylim=(0, None))
    axes.set_title("albedo over incidence", fontsize=9)
    axes.xaxis.set_major_formatter("{x:.0f}°")
    axes.grid()
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    return Plot(page.svg(figure, f"albedo of {chosen[0].surface} over the angle of incidence"), {})


def _width(curves: Curves) -> float:
    return 2.2 if curves.picture == ORIGINAL else 1.3
