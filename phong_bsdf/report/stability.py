"""The stability sweep as a table, CSV, JSON and plots."""

from collections.abc import Sequence
from pathlib import Path

from ..pictures.images import replace_file
from ..stability import BARS, Row
from . import page, tables


def table(rows: Sequence[Row]) -> str:
    """One line for each quantity, lobe and exponent."""
    headings = (
        "quantity", "lobe", "p", "error", "C", "bar", "naive err.", "naive C",
        "native err.", "native C", "ns", "naive ns", "",
    )  # fmt: skip
    lines = [
        (
            row.quantity, row.lobe, f"{row.p:g}", *map(tables.number, (
                row.error, row.c, BARS[row.quantity], row.naive_error, row.naive_c, row.native_error, row.native_c,
                row.nanoseconds, row.naive_nanoseconds,
            )), "" if row.passed else "MISSED",
        )
        for row in rows
    ]  # fmt: skip
    return tables.text_table(headings, lines)


def inputs(rows: Sequence[Row]) -> str:
    """The inputs of the largest errors, with the digits that float32 needs."""
    return tables.text_table(
        ("quantity", "lobe", "p", "error", "at"),
        [(row.quantity, row.lobe, f"{row.p:g}", tables.number(row.error), _inputs(row)) for row in rows],
    )


def _inputs(row: Row) -> str:
    names = ("wi", "wo") if len(row.error_inputs) == 6 else ("xi",) if row.quantity == "sample" else ("p",)
    size = len(row.error_inputs) // len(names)
    vectors = (row.error_inputs[i * size : (i + 1) * size] for i in range(len(names)))
    return "  ".join(f"{name} {' '.join(f'{x:.9g}' for x in v)}" for name, v in zip(names, vectors, strict=True))


def write(folder: Path, rows: Sequence[Row]) -> list[Path]:
    """Write stability.csv, .json, .txt, and, where matplotlib is installed, one .svg for each quantity."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    tables.write_csv(folder / "stability.csv", rows)
    tables.write_json(folder / "stability.json", rows)
    replace_file(folder / "stability.txt", f"{table(rows)}\n{inputs(rows)}")
    return [folder / f"stability.{kind}" for kind in ("csv", "json", "txt")] + _plots(folder, rows)


def _plots(folder: Path, rows: Sequence[Row]) -> list[Path]:
    quantities = dict.fromkeys(row.quantity for row in rows)
    try:
        return [plot(folder / f"{quantity}.svg", rows, quantity) for quantity in quantities]
    except ImportError:
        return []


def plot(path: Path, rows: Sequence[Row], quantity: str) -> Path:
    """Worst errors over the exponents, both lobes side by side; needs matplotlib."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 4), layout="constrained")
    for axes, lobe in zip(figure.subplots(1, 2, sharey=True), ("phong", "blinnphong"), strict=True):
        chosen = [row for row in rows if (row.quantity, row.lobe) == (quantity, lobe)]
        p = [max(row.p, 0.03) for row in chosen]
        curves = {"naive": "naive_error", "phong_bsdf": "error"}
        if any(row.native_error is not None for row in chosen):
            curves["Beckmann (native)"] = "native_error"
        for label, field in curves.items():
            errors = [min(max(getattr(row, field), 1e-9), 1e3) for row in chosen]
            axes.loglog(p, errors, marker="o", markersize=3, label=label)
        axes.axhline(2.0**-24, color="grey", linewidth=0.8, linestyle=":", label="one rounding")
        axes.set(title=f"{quantity}, {lobe}", xlabel="p (0 at the left)", ylim=(1e-8, 2e3))
    figure.axes[0].set_ylabel("worst relative error (cut at 1000)")
    figure.axes[1].legend()
    replace_file(path, page.svg_file(figure))
    return path
