"""The table of a sweep, as CSV and Parquet."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path

from ..pictures.images import replace_file
from ..sweep import COLUMNS, Row, Sweep


def check_parquet() -> None:
    """ValueError where a Parquet table could not be written."""
    try:
        import pyarrow  # noqa: F401
    except ImportError:
        raise ValueError(
            "--parquet needs pyarrow: `pip install 'phong-bsdf[parquet]'`; the CSV table needs nothing"
        ) from None


def write(folder: Path, planned: Sweep, rows: Sequence[Row], parquet: bool = False) -> Path:
    """`sweep.csv`, and `sweep.parquet` if asked for: a line for each row. The path of the first."""
    records = [_record(planned, row) for row in rows]
    text = io.StringIO()
    writer = csv.DictWriter(text, [*planned.names, *COLUMNS], lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    replace_file(folder / "sweep.csv", text.getvalue())
    if parquet:
        replace_file(folder / "sweep.parquet", _parquet(planned, records))
    return folder / "sweep.csv"


def _record(planned: Sweep, row: Row) -> dict:
    file = None if row.error or row.seconds is None else row.file
    return {**dict(row.defines), "file": file, "seconds": row.seconds, "mean": row.mean, "error": row.error or None}


def _parquet(planned: Sweep, records: Sequence[dict]) -> bytes:
    """Parameters are numbers where all their values are."""
    import pyarrow
    from pyarrow import parquet

    columns = {name: _numbers([record[name] for record in records]) for name in planned.names}
    columns |= {name: [record[name] for record in records] for name in ("file", "error")}
    types = {"file": pyarrow.string(), "error": pyarrow.string()}
    arrays = {name: pyarrow.array(values, types.get(name)) for name, values in columns.items()}
    for name in ("seconds", "mean"):
        arrays[name] = pyarrow.array([record[name] for record in records], pyarrow.float64())
    names = [*planned.names, *COLUMNS]
    sink = io.BytesIO()
    parquet.write_table(pyarrow.table({name: arrays[name] for name in names}), sink)
    return sink.getvalue()


def _numbers(values: Sequence[str]) -> list:
    try:
        return [float(value) for value in values]
    except ValueError:
        return list(values)
