"""Runs the benchmarks: `make bench`, or PYTHONPATH=tests python -m benchmarks [NAME ...] [--quick] [--docs].

Each writes its records as CSV and JSON, a table and a plot; the table of targets is made from
all records in the folder.
"""

import importlib
import json
import time
from pathlib import Path

import click

import phong_bsdf  # noqa: F401  # isort: skip  (before mitsuba: it chooses the LLVM)
import mitsuba as mi

from helpers import ROOT
from phong_bsdf.pictures.images import replace_file
from phong_bsdf.report.tables import write_csv, write_json

from . import plots, tables, targets
from .measure import Plan, Record

# Where the others are not in speed.md.
PAGES = {"cluster": "clusters.md"}

DOCS = ROOT / "docs"


@click.command()
@click.argument("names", nargs=-1, type=click.Choice(tuple(tables.TABLES)))
@click.option("--quick", is_flag=True, help="Tiny sizes, to see that everything runs: the numbers mean nothing.")
@click.option("--variant", default="llvm_ad_rgb", show_default=True, type=click.Choice(("llvm_ad_rgb", "cuda_ad_rgb")))
@click.option("--out", "folder", default="out/bench", show_default=True, type=click.Path(path_type=Path))
@click.option("--docs", is_flag=True, help="Measure nothing: put the records of the folder into docs/.")
def main(names, quick, variant, folder, docs):
    """Run the benchmarks NAMES, or all."""
    if docs:
        document(folder, DOCS)
        return
    mi.set_variant(variant)
    folder.mkdir(parents=True, exist_ok=True)
    for name in names or tables.TABLES:
        start = time.perf_counter()
        records = importlib.import_module(f".{name}", __package__).records(Plan(quick, variant))
        write(folder, name, records)
        click.echo(f"{name}, {time.perf_counter() - start:.0f} s\n\n{tables.text(name, records)}")
    found = targets.outcomes([row for records in read(folder).values() for row in records])
    write_csv(folder / "targets.csv", found)
    write_json(folder / "targets.json", found)
    replace_file(folder / "targets.txt", targets.table(found))
    click.echo(targets.table(found))


def write(folder: Path, name: str, records: list[Record]) -> None:
    """NAME.csv, NAME.json, NAME.txt and, where there is a plot, NAME.svg."""
    write_csv(folder / f"{name}.csv", records)
    write_json(folder / f"{name}.json", records)
    replace_file(folder / f"{name}.txt", f"{tables.where(records)}\n\n{tables.text(name, records)}")
    if name in plots.PLOTS:
        plots.draw(folder / f"{name}.svg", name, records)


def read(folder: Path) -> dict[str, list[Record]]:
    """The records of all benchmarks in `folder`."""
    files = {name: folder / f"{name}.json" for name in tables.TABLES}
    return {
        name: [Record(**row) for row in json.loads(file.read_text())["rows"]]
        for name, file in files.items()
        if file.is_file()
    }


def document(folder: Path, docs: Path) -> None:
    """The tables between the marks of docs/speed.md and docs/clusters.md, and their plots."""
    found = read(folder)
    blocks = {name: f"{tables.where(rows)}\n\n{tables.text(name, rows)}" for name, rows in found.items()}
    blocks["targets"] = targets.table(targets.outcomes([row for rows in found.values() for row in rows]))
    if (folder / "explain.txt").is_file():
        blocks["explain"] = (folder / "explain.txt").read_text()
    for name, text in blocks.items():
        path = docs / PAGES.get(name, "speed.md")
        before, start, rest = path.read_text().partition(f"<!-- {name} -->\n")
        _, end, after = rest.partition(f"<!-- end of {name} -->\n")
        if not (start and end):
            raise ValueError(f"docs/{path.name} has no place for '{name}'")
        replace_file(path, f"{before}{start}```text\n{text}```\n{end}{after}")
    for name in plots.PLOTS:
        if name in found:
            plots.draw(docs / f"images/speed-{name}.svg", name, found[name])


if __name__ == "__main__":
    main()
