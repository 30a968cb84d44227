"""`phong-bsdf sweep`."""

import sys
import time
from contextlib import nullcontext
from pathlib import Path

import click

from .clusters import cluster_options
from .options import scene_options
from .session import errors, progress, start

# The table is written so often at most, in seconds, while pictures come.
TABLE_SECONDS = 5


@click.command()
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("-o", "--output", "folder", required=True, type=click.Path(path_type=Path),
              help="Folder for the pictures (.exr) and the table sweep.csv. Made if need be; pictures that it holds "
                   "already are not rendered again.")  # fmt: skip
@click.option("--parquet", is_flag=True, help="Also write sweep.parquet.")
@scene_options
@cluster_options
def sweep(scene, folder, parquet, variant, defines, spp, size, camera, seed, threads, cluster, verbose):
    """Render a SCENE with every combination of values, into a table and pictures.

    For example -D p=1:1000:log20 -D km=0,.5,1: values are numbers or words with commas between them, and ranges:
    from:to:linN or from:to:logN. Exit 1: some combinations failed; the table says why.
    """
    with errors():
        from ..pictures import images

        if not defines:
            raise ValueError("sweep: say what to vary: -D name=values")
        images.check_folder(folder)
        start(variant, threads, verbose)
        from .. import sweep as sweeps
        from ..report import sweep as report

        if parquet:
            report.check_parquet()
        with progress() as show:
            show("reading", 0)
            planned = sweeps.plan(scene, defines, sweeps.Settings(camera, size, spp or 0, seed))
            folder.mkdir(parents=True, exist_ok=True)
            with cluster.connected(verbose) if cluster else nullcontext() as connection:
                table = _Table(planned, folder, parquet, show)
                for row in table.rendered(connection, cluster):
                    table.add(row)
        click.echo(table.summary())
    sys.exit(1 if table.failed else 0)


class _Table:
    """The rows of a sweep, as far as they are known, and on disk."""

    def __init__(self, planned, folder, parquet, show):
        from .. import sweep as sweeps

        self.planned, self.folder, self.parquet, self.show = planned, folder, parquet, show
        self.rows = {row.file: row if row.error else sweeps.told(row, folder) or row for row in planned.rows}
        self.todo = [row for row in self.rows.values() if not row.error and row.seconds is None]
        self.there = sum(row.seconds is not None for row in self.rows.values())
        self.written = 0.0

    def rendered(self, connection, choice):
        """Rows of what is not there yet."""
        import mitsuba as mi

        from .. import sweep as sweeps

        try:
            if connection is None:
                yield from sweeps.run(self.planned, self.todo, self.folder)
            else:
                from ..cluster import sweeps as elsewhere

                yield from elsewhere.run(
                    connection, self.planned, self.todo, self.folder, variant=str(mi.variant()), root=choice.root,
                    seconds=choice.seconds, on_wait=choice.waiting(self.show),
                )  # fmt: skip
        finally:
            self.path = self._write()

    def add(self, row) -> None:
        self.rows[row.file] = row
        done = sum(bool(row.error) or row.seconds is not None for row in self.rows.values())
        self.show(f"{done} of {len(self.rows)}", done / len(self.rows))
        if time.perf_counter() - self.written > TABLE_SECONDS:
            self._write()

    def _write(self) -> Path:
        from ..report import sweep as report

        self.written = time.perf_counter()
        return report.write(self.folder, self.planned, list(self.rows.values()), self.parquet)

    @property
    def failed(self) -> list:
        return [row for row in self.rows.values() if row.error]

    def summary(self) -> str:
        """A line, and one for the first of the combinations that failed."""
        made = sum(row.seconds is not None for row in self.rows.values())
        there = f", {self.there} of them from before" if self.there else ""
        said = f"{self.path}: {made} picture{'' if made == 1 else 's'}{there}"
        if self.failed:
            first = self.failed[0]
            values = ", ".join(f"{name}={value}" for name, value in first.defines)
            said += f"; {len(self.failed)} failed, the first with {values}: {first.error}"
        return said
