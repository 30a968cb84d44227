"""A comparison as a table, CSV, JSON, image files and one HTML page."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..comparison import ORIGINAL, Comparison
from ..pictures.images import write as write_image
from ..pictures.metrics import EPSILON, FLIP_EXPOSURES
from ..reflection.curves import ALBEDO_ANGLES, LOBE_ANGLES
from . import page, tables
from .comparison_plots import colours, plots


@dataclass(frozen=True)
class Point:
    """A point of a curve."""

    surface: str
    picture: str
    plugin: str
    incidence: float
    outgoing: float | None
    """Degrees; None: the value is the albedo."""
    value: float
    """f cos(theta_o), or the albedo."""


def table(comparison: Comparison) -> str:
    """One line for each picture."""
    headings = ("picture", "MSE", "relMSE", "max", "FLIP", "mean", "compiling", "rendering", "")
    lines = [
        (
            row.picture, *map(tables.number, (row.mse, row.relmse, row.max_error, row.flip, row.mean)),
            f"{row.seconds_compiling:.2f} s", f"{row.seconds_rendering:.2f} s",
            f"{row.nonfinite} PIXELS ARE NO NUMBERS" if row.nonfinite else "",
        )
        for row in comparison.rows
    ]  # fmt: skip
    return "\n".join(line.rstrip() for line in tables.text_table(headings, lines).split("\n"))


def notes(comparison: Comparison) -> list[str]:
    """What could not be matched, the same words once: `picture: surface, surface: note`."""
    surfaces: dict[tuple[str, str], list[str]] = {}
    for replacement in comparison.replacements:
        for note in replacement.notes:
            surfaces.setdefault((replacement.picture, note), []).append(replacement.surface)
    return [f"{picture}: {', '.join(names)}: {note}" for (picture, note), names in surfaces.items()]


def write(folder: Path, comparison: Comparison) -> Path:
    """Write everything into `folder`, the page last; returns the page's path."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    context = tables.context()
    for row in comparison.rows:
        image = comparison.images[row.picture]
        metadata = {"phong_bsdf": context["phong_bsdf"], "scene": comparison.scene, "variant": context["variant"],
                    "spp": str(row.spp), "seed": str(row.seed), "picture": row.picture}  # fmt: skip
        write_image(folder / f"{row.picture}.exr", image, metadata=metadata)
        write_image(folder / f"{row.picture}.png", image)
        if row.picture != ORIGINAL:
            difference = _differences(comparison)[row.picture]
            write_image(folder / f"{row.picture}-difference.exr", difference, metadata=metadata)
    tables.write_csv(folder / "comparison.csv", comparison.rows)
    tables.write_csv(folder / "curves.csv", list(_points(comparison)))
    tables.write_json(
        folder / "comparison.json", comparison.rows,
        scene=comparison.scene, integrator=comparison.integrator, relmse_epsilon=EPSILON,
        flip_exposures=FLIP_EXPOSURES, albedo_angles=ALBEDO_ANGLES,
        replacements=comparison.replacements,
        albedos=[{"surface": c.surface, "picture": c.picture, "values": c.albedos} for c in comparison.curves],
    )  # fmt: skip
    _write_page(folder / "index.html", comparison, context)
    return folder / "index.html"


def _points(comparison: Comparison) -> Iterator[Point]:
    for curves in comparison.curves:
        where = (curves.surface, curves.picture, curves.plugin)
        for incidence, lobe in zip(LOBE_ANGLES, curves.lobes, strict=True):
            yield from (Point(*where, incidence, outgoing, value) for outgoing, value in lobe)
        for incidence, albedo in zip(ALBEDO_ANGLES, curves.albedos, strict=True):
            yield Point(*where, incidence, None, albedo)


def _write_page(path: Path, comparison: Comparison, context: dict[str, str]) -> None:
    differences = _differences(comparison)
    scale = page.difference_scale(differences.values())
    first = comparison.rows[0]
    page.write(
        path,
        "comparison.html",
        title=f"{comparison.scene}: Phong beside physical BSDFs",
        summary=f"{first.width} × {first.height}, {first.spp} spp, seed {first.seed}, integrator "
        f"{comparison.integrator}, {context['variant']}",
        context=context,
        rows=[(row, _cells(row)) for row in comparison.rows],
        notes=notes(comparison),
        surfaces=_by_surface(comparison),
        colours=colours(comparison),
        plots=plots(comparison),
        pictures={name: page.picture(image) for name, image in comparison.images.items()},
        maps={
            name: page.picture(page.false_colours(difference, scale), linear=True)
            for name, difference in differences.items()
        },
        number=tables.number,
        epsilon=tables.number(EPSILON),
        map_scale=tables.number(scale),
        viewer=page.viewer(comparison.images, scale),
    )


def _differences(comparison: Comparison) -> dict[str, np.ndarray]:
    """Picture -> itself minus the original."""
    others = {name: image for name, image in comparison.images.items() if name != ORIGINAL}
    # Infinity minus infinity is no number, and is shown as such.
    with np.errstate(invalid="ignore", over="ignore"):
        return {name: image - comparison.images[ORIGINAL] for name, image in others.items()}


def _by_surface(comparison: Comparison) -> dict[str, list]:
    surfaces: dict[str, list] = {}
    for replacement in comparison.replacements:
        surfaces.setdefault(replacement.surface, []).append(replacement)
    return surfaces


def _cells(row) -> list[str]:
    errors: Sequence = (row.mse, row.relmse, row.max_error, row.flip, row.mean)
    seconds = (row.seconds_loading, row.seconds_compiling, row.seconds_rendering)
    return [*map(tables.number, errors), str(row.nonfinite), *(f"{s:.2f}" for s in seconds)]
