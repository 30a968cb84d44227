"""What a kernel holds and leaves out, as text, CSV and JSON."""

from pathlib import Path

from ..explanation import Explanation
from ..pictures.images import replace_file
from . import tables


def text(explanation: Explanation) -> str:
    """A line for each feature, and the whole."""
    e = explanation
    rows = [(row.feature, row.scene, "-" if row.held else row.left_out, *_saved(row)) for row in e.rows]
    return (
        tables.text_table(("feature", "this scene", "left out", "operations", "ms"), rows, left=3)
        + f"\nA frame of {e.width} x {e.height}, {e.spp} spp: {e.operations} operations, {e.milliseconds:.1f} ms."
        + f"\nHolding every feature: {e.general_operations} operations, {e.general_milliseconds:.1f} ms."
        + "\nThe columns to the right: what leaving out that feature alone saves; - where nothing is left out,"
        + "\nor where there would be nothing to hold.\n"
    )


def write(folder: Path, explanation: Explanation) -> list[Path]:
    """Writes explain.csv, .json and .txt into `folder`, which is made if need be."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    csv, json, txt = (folder / f"explain.{suffix}" for suffix in ("csv", "json", "txt"))
    tables.write_csv(csv, explanation.rows)
    totals = {name: value for name, value in vars(explanation).items() if name != "rows"}
    tables.write_json(json, explanation.rows, **totals)
    replace_file(txt, text(explanation))
    return [csv, json, txt]


def _saved(row) -> tuple[str, str]:
    if row.operations is None:
        return "-", "-"
    # Less than the clock can tell is not reported as a loss.
    return str(row.operations), f"{row.milliseconds:.1f}".replace("-0.0", "0.0")
