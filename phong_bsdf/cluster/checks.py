"""The checks of many pictures on a cluster: a picture is an order, its grade and its page come back."""

import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..checking.grading import Assignment, Grade, Options
from ..report import check as report
from ..scene.bundle import Bundle
from . import work
from .connection import Cluster, ClusterError
from .orders import Order, Orders


@dataclass(frozen=True)
class Task:
    """What a scene's pictures are compared with."""

    scene: str
    """The name of its file."""
    camera: int
    spp: int
    size: tuple[int, int] | None
    seed: int
    options: Options


def task(assignment: Assignment) -> Task:
    """What workers need of an assignment."""
    return Task(assignment.name, options=assignment.options, **assignment.settings)


def check(
    path: Path, task: Task, name: str, content: bytes, label: str, page: str | None
) -> tuple[Grade, bytes | None]:
    """On a worker: the grade of a picture in a file `name`, and the page called `page`, if one is wanted."""
    assignment = work.kept(("check", path, task), lambda: _assignment(path, task))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / name
        file.write_bytes(content)
        checked = assignment.check(file, label)
        if page is None:
            return checked.grade, None
        report.write_page(Path(folder), assignment, checked, page)
        return checked.grade, (Path(folder) / f"{page}.html").read_bytes()


def _assignment(path: Path, task: Task) -> Assignment:
    made = Assignment(path, camera=task.camera, spp=task.spp, size=task.size, seed=task.seed, options=task.options)
    made.name = task.scene
    return made


def run(
    cluster: Cluster,
    scene: Bundle,
    task: Task,
    files: Sequence[Path],
    labels: Sequence[str],
    pages: Sequence[str | None],
    *,
    variant: str,
    seconds: float | None = None,
    on_wait: Callable[[str], None] = lambda what: None,
) -> Iterator[tuple[int, Grade, bytes | None]]:
    """The number of each file, its grade and its page, in the order in which they finish. Files must exist."""
    orders = [
        Order(str(number), scene, check, (task, file.name, file.read_bytes(), label, page))
        for number, (file, label, page) in enumerate(zip(files, labels, pages, strict=True))
    ]
    for result in Orders(cluster, orders, variant=variant, seconds=seconds, on_wait=on_wait).results():
        if result.error:
            raise ClusterError(f"{labels[int(result.name)]}: {result.error}")
        yield int(result.name), *result.value
