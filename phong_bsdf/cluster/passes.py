"""The passes of a picture on a cluster: rendered anywhere, written and folded here, in their order."""

import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from ..pictures.estimates import WeightedMean
from ..pictures.parts import Subject
from ..pictures.store import Store
from ..progressive import planning, running
from ..progressive.folder import Folder
from ..progressive.planning import Plan
from ..scene import rendering
from ..scene.bundle import Bundle
from . import scaling, work
from .connection import Cluster, ClusterError
from .orders import Order, Orders

# Samples of the rendering that tells how long others take.
TRIAL_SAMPLES = 2**20


def loaded(path: Path, camera: int, size: tuple[int, int] | None):
    """On a worker: a scene and its subject."""
    return work.kept(("passes", path, camera, size), lambda: planning.load(path, camera=camera, size=size))


def render_pass(path: Path, size: tuple[int, int] | None, plan: Plan, index: int) -> bytes:
    """On a worker: the file of one pass. `size` is what the user asked for, None: as the scene says."""
    scene, subject = loaded(path, plan.subject.camera, size)
    running.check_subject(plan, subject)
    start = time.perf_counter()
    made = running.render_pass(scene, plan, index)
    with tempfile.TemporaryDirectory() as name:
        folder = Folder(Store(Path(name)), plan)
        folder.store.passes.mkdir()
        folder.write(index, made.image, time.perf_counter() - start, made.channels)
        return folder.path(index).read_bytes()


def time_sample(path: Path, size: tuple[int, int] | None, camera: int, spp: int) -> float:
    """On a worker: seconds of one sample for each pixel, once kernels are compiled."""
    scene, _ = loaded(path, camera, size)
    # Each number of samples may have a kernel of its own.
    rendering.render(scene, camera=camera, spp=spp)
    start = time.perf_counter()
    rendering.render(scene, camera=camera, spp=spp)
    return (time.perf_counter() - start) / spp


def suitable_spp(
    cluster: Cluster, scene: Bundle, subject: Subject, size: tuple[int, int] | None, spp: int, *,
    seconds: float | None = None, on_wait: Callable[[str], None] = lambda what: None,
) -> int:  # fmt: skip
    """Samples per pixel of a pass, by the time that a worker takes and by how many workers there are."""
    pixels = subject.size[0] * subject.size[1]
    trial = max(1, min(TRIAL_SAMPLES // pixels, spp))
    order = Order("trial", scene, time_sample, (size, subject.camera, trial))
    (result,) = Orders(cluster, [order], variant=subject.variant, seconds=seconds, on_wait=on_wait).results()
    if result.error:
        raise ClusterError(result.error)
    most = max(planning.MOST_SAMPLES // pixels, 1)
    workers = max(sum(cluster.workers().values()), 1)
    return scaling.pass_spp(spp, result.value, workers, scaling.pass_bytes(pixels), most)


def render(
    cluster: Cluster,
    scene: Bundle,
    folder: Folder,
    *,
    size: tuple[int, int] | None = None,
    seconds: float | None = None,
    on_broken: Callable[[str], None] = lambda text: None,
    on_progress: Callable[[float], None] = lambda share: None,
    on_wait: Callable[[str], None] = lambda what: None,
) -> Iterator[WeightedMean]:
    """`progressive.running.render` on a cluster: the picture so far, pass by pass in the order of their numbers."""
    plan, mean = folder.plan, WeightedMean()

    def order(index: int) -> Order:
        return Order(str(index), scene, render_pass, (size, plan, index))

    missing = [index for index in range(plan.count) if not folder.has(index)]
    orders = Orders(cluster, list(map(order, missing)), variant=plan.subject.variant, seconds=seconds, on_wait=on_wait)
    finished, results = plan.count - len(missing), orders.results()
    while mean.count < plan.count:
        # What is on disk, as far as there is no gap. A broken file is a gap again.
        while mean.count < plan.count and folder.has(mean.count):
            image = running.on_disk(folder, mean.count, on_broken)
            if image is None:
                folder.path(mean.count).unlink()
                orders.add(order(mean.count))
                finished -= 1
                break
            mean.judged = folder.judged(mean.count)
            mean.add(image, plan.spp)
            yield mean
        if mean.count == plan.count:
            return
        result = next(results, None)
        if result is None:
            # All that was ordered has come, and a file has gone or was broken since.
            if not folder.has(mean.count) and not orders.waiting:
                orders.add(order(mean.count))
            results = orders.results()
            continue
        if result.error:
            raise ClusterError(result.error)
        folder.keep(int(result.name), result.value)
        finished += 1
        on_progress(finished / plan.count)
