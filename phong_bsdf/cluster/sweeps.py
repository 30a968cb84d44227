"""A sweep on a cluster: a picture is an order, its file comes back whole."""

import gc
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from .. import sweep
from ..pictures import images
from ..scene import bundle
from ..sweep import Row, Settings, Sweep
from . import work
from .connection import Cluster
from .orders import Order, Orders


def render(path: Path, row: Row, settings: Settings, scene: str) -> tuple[float, float, bytes]:
    """On a worker: seconds, mean and file of one combination, whose defines the scene has inside."""
    # The last one is let go.
    work.kept(None, object)
    gc.collect()
    with tempfile.TemporaryDirectory() as name:
        file = Path(name) / "picture.exr"
        seconds, mean = sweep.render(path, row, settings, file, packed=scene)
        return seconds, mean, file.read_bytes()


def run(
    cluster: Cluster,
    planned: Sweep,
    rows: Sequence[Row],
    folder: Path,
    *,
    variant: str,
    root: Path | None = None,
    seconds: float | None = None,
    on_wait: Callable[[str], None] = lambda what: None,
) -> Iterator[Row]:
    """Render these rows on a cluster: `sweep.run`, but in the order in which they finish."""
    contents, orders, waiting = {}, [], {}
    for number, row in enumerate(rows):
        try:
            scene = bundle.pack(planned.path, dict(row.defines), root, contents)
        except ValueError as error:
            yield replace(row, error=str(error))
            continue
        waiting[str(number)] = row
        orders.append(Order(str(number), scene, render, (row, planned.settings, planned.path.name)))
    for result in Orders(cluster, orders, variant=variant, seconds=seconds, on_wait=on_wait).results():
        row = waiting[result.name]
        if result.error:
            yield replace(row, error=result.error)
            continue
        took, mean, content = result.value
        images.replace_file(folder / row.file, content)
        yield replace(row, seconds=took, mean=mean)
