"""A failed render check as an HTML page, and the list of all failures."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..checking.references import Outcome
from ..checking.verdict import TILE
from ..pictures import metrics
from . import page, tables
from .check import HEAT


def write(path: Path, test: str, name: str, outcome: Outcome) -> None:
    """The page of one failure."""
    actual, expected = (np.broadcast_to(image, (*image.shape[:2], 3)) for image in _colors(outcome))
    with np.errstate(invalid="ignore"):
        difference = actual - expected
    scale = page.difference_scale([difference])
    excess = np.nan_to_num(outcome.verdict.excess, posinf=1e6)
    errors = metrics.errors(actual, expected)
    page.write(
        Path(path), "render_check.html", title=f"{name}: differs from its reference", summary=test,
        context=tables.context(), verdict=outcome.verdict, noisy=outcome.noisy, tile=TILE, number=tables.number,
        errors=errors, expected=page.picture(expected), actual=page.picture(actual), scale=tables.number(scale),
        difference=page.picture(page.false_colours(difference, scale), linear=True),
        heat=page.picture(page.false_colours(excess[..., None], HEAT), linear=True), heat_scale=tables.number(HEAT),
        viewer=page.viewer({"expected": expected, "actual": actual}, scale),
    )  # fmt: skip


def write_index(path: Path, failures: Sequence[tuple[str, str, str]], tests: int) -> None:
    """The list of failures: (test, words, name of the page or nothing)."""
    title = f"{len(failures) or 'No'} render check{'' if len(failures) < 2 else 's'} failed"
    page.write(
        Path(path), "render_check_index.html", title=title, summary=f"Of {tests} tests that ran.",
        context=tables.context(), failures=failures,
    )  # fmt: skip


def _colors(outcome: Outcome):
    return metrics.colors(outcome.actual), metrics.colors(outcome.expected)
