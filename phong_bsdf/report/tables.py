"""Records (frozen dataclasses) as CSV, JSON and text, with where and when they were measured."""

import csv
import dataclasses
import io
import json
import math
import platform
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path

from ..host import machine
from ..pictures.images import replace_file


def context() -> dict[str, str]:
    """Versions and machine, for every record that is kept."""
    import drjit
    import mitsuba as mi

    from .. import __version__

    return {
        "phong_bsdf": __version__,
        "mitsuba": str(mi.__version__),
        "drjit": metadata.version("drjit"),
        "llvm": ".".join(map(str, drjit.detail.llvm_version())),
        "variant": str(mi.variant()),
        "python": platform.python_version(),
        "machine": f"{platform.machine()}, {machine.cores()} cores",
        "time": machine.now(),
    }


def write_csv(path: Path, rows: Sequence) -> None:
    """One line a record; tuples are written with spaces."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    names = [f.name for f in dataclasses.fields(rows[0])]
    writer.writerow(names)
    for row in rows:
        values = (getattr(row, name) for name in names)
        writer.writerow([" ".join(map(repr, v)) if isinstance(v, tuple) else "" if v is None else v for v in values])
    replace_file(path, text.getvalue())


def write_json(path: Path, rows: Sequence, **more) -> None:
    """The records under `rows`, the machine under `context`; infinities as strings, which JSON lacks."""
    replace_file(path, json_text({"context": context(), **more, "rows": list(rows)}))


def json_text(document) -> str:
    """Records, and whatever they are in, as JSON."""
    return json.dumps(_plain(document), indent=1, allow_nan=False) + "\n"


def number(x: float | None) -> str:
    """A number in at most seven characters."""
    if x is None:
        return "-"
    if not math.isfinite(x):
        return "inf" if x > 0 else str(x)
    return f"{x:.3g}" if x == 0 or 0.01 <= abs(x) < 1e4 else f"{x:.1e}".replace("e-0", "e-").replace("e+0", "e")


def text_table(headings: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1) -> str:
    """Columns aligned: the first `left` to the left, the others to the right."""
    table = [list(headings), *map(list, rows)]
    widths = [max(len(row[i]) for row in table) for i in range(len(headings))]
    lines = [
        "  ".join(c.ljust(w) if i < left else c.rjust(w) for i, (c, w) in enumerate(zip(row, widths, strict=True)))
        for row in table
    ]
    return "\n".join([lines[0], "-" * len(lines[0]), *lines[1:]]) + "\n"


def _plain(value):
    if dataclasses.is_dataclass(value):
        value = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value
