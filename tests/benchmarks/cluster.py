"""What a cluster costs beside rendering, how well two processes share a picture, and what that means for a thousand.

All on one machine, so the network is that of loopback.
"""

import tempfile
import time
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

import mitsuba as mi
import numpy as np

from helpers import SCENES
from phong_bsdf.cluster import passes, scaling
from phong_bsdf.cluster.connection import address, connected
from phong_bsdf.cluster.orders import Order, Orders
from phong_bsdf.pictures import images
from phong_bsdf.pictures.estimates import WeightedMean
from phong_bsdf.pictures.store import Store
from phong_bsdf.progressive import folder as folders
from phong_bsdf.progressive import planning, running
from phong_bsdf.scene import bundle

from .measure import Plan, record

SCENE = SCENES / "compare/balls.xml"

WORKERS = (1, 2, 4, 8, 16, 32, 64, 125, 250, 500, 1000)


def records(plan: Plan):
    """Costs of an order, a byte, a pass and a start; efficiency with one and two processes; the predicted curve."""
    found, costs = [], {}

    def add(task, quantity, samples, unit, x=None):
        found.append(record("cluster", "balls", task, quantity, samples, unit, x))
        return found[-1].median

    size, spp = plan.of((256, 192), (32, 24)), plan.of(512, 16)
    loaded, subject = planning.load(SCENE, size=size)
    scene = bundle.pack(SCENE)
    # Numbers are kept as they will be shown: seconds, and nanoseconds for each byte.
    encoding = 1e9 * np.polyfit(*_encoding(plan), 1)[0]
    costs["worker_byte"] = add("a byte of a pass, encoded by the worker", "cost", max(encoding, 0.0), "ns") / 1e9
    costs["start"] = add("start of a local process", "cost", _start(scene, plan), "s")
    with connected(address("local:2")) as cluster:
        _orders(cluster, scene, 20, 0)
        costs["order"] = add("a pass, handed out and taken in", "cost",
                             [_orders(cluster, scene, plan.of(300, 20), 0) for _ in range(3)], "s")  # fmt: skip
        # Which part of it is the worker's is not told: it counts for both.
        costs["worker"] = costs["order"]
        large = 2**22
        sent = [(_orders(cluster, scene, plan.of(30, 4), large) - costs["order"]) / large for _ in range(3)]
        taken = [1e9 * (max(seconds, 0.0) + _folding(large)) for seconds in sent]
        costs["byte"] = add("a byte of a pass, taken in", "cost", taken, "ns") / 1e9
        costs["bundle_byte"] = (
            add("a byte of the scene, sent to a worker", "cost", 1e9 * np.array(_sent(cluster, scene, plan)), "ns")
            / 1e9
        )
        chosen = passes.suitable_spp(cluster, scene, subject, size, spp)
    planned = planning.plan(loaded, subject, spp=spp, pass_spp=chosen)
    add("a pass", "samples per pixel chosen", planned.spp, "")
    size_bytes = scaling.pass_bytes(size[0] * size[1])
    pass_seconds = _shared(plan, scene, loaded, planned, size, add)
    add("a pass", "bytes", size_bytes, "bytes")
    add("a pass", "time", pass_seconds, "s")
    measured = scaling.Costs(**costs)
    # An hour of one process, in the passes that the command would choose for so many workers.
    for workers in WORKERS:
        wanted = scaling.pass_seconds(3600, workers, size_bytes, measured)
        job = scaling.Job(max(round(3600 / wanted), 1), wanted, size_bytes, scene.size)
        for name, value in asdict(scaling.predicted(job, workers, measured)).items():
            if name in ("seconds", "speedup"):
                add("predicted", name, value, "s" if name == "seconds" else "x", workers)
        add("predicted", "time of a pass", wanted, "s", workers)
    return found


def _encoding(plan):
    """Bytes of passes, and the seconds that a worker takes to make files of them."""
    noise, sizes, seconds = np.random.default_rng(0), plan.of((64, 512, 1024), (16, 32)), []
    with tempfile.TemporaryDirectory() as name:
        for side in sizes:
            image = noise.random((side, side, 3), np.float32)
            took = []
            for _ in range(5):
                start = time.perf_counter()
                images.write(Path(name) / "a.exr", image)
                (Path(name) / "a.exr").read_bytes()
                took.append(time.perf_counter() - start)
            seconds.append(np.median(took))
    return [scaling.pass_bytes(side * side) for side in sizes], seconds


def _folding(size):
    """Seconds for each byte of a pass that is written, read and added up."""
    side = int((size / 12) ** 0.5)
    image, mean = np.random.default_rng(0).random((side, side, 3), np.float32), WeightedMean()
    with tempfile.TemporaryDirectory() as name:
        images.write(Path(name) / "a.exr", image)
        content = (Path(name) / "a.exr").read_bytes()
        mean.add(image, 1)
        start = time.perf_counter()
        images.replace_file(Path(name) / "b.exr", content)
        mean.add(images.read_exr(Path(name) / "b.exr"), 1)
        return (time.perf_counter() - start) / size


def nothing(path, size):
    """On a worker: so many bytes."""
    return bytes(size)


def _orders(cluster, scene, count, size):
    """Seconds of an order that gives so many bytes and costs no work."""
    start = time.perf_counter()
    orders = [Order(str(i), scene, nothing, (size,)) for i in range(count)]
    for _ in Orders(cluster, orders, variant=mi.variant()).results():
        pass
    return (time.perf_counter() - start) / count


def _start(scene, plan):
    """Seconds until a new local process has done its first order."""
    took = []
    for _ in range(plan.of(3, 1)):
        start = time.perf_counter()
        with connected(address("local:1")) as cluster:
            _orders(cluster, scene, 1, 0)
            took.append(time.perf_counter() - start)
    return took


def _sent(cluster, scene, plan):
    """Seconds for each byte of a scene that comes to a worker and is written there."""
    size, took = plan.of(2**25, 2**20), []
    for i in range(3):
        content = np.random.default_rng(i).bytes(size)
        with tempfile.TemporaryDirectory() as name:
            (Path(name) / "a.bin").write_bytes(content)
            text = '<scene version="3.0.0"><shape type="ply"><string name="filename" value="a.bin"/></shape></scene>'
            (Path(name) / "a.xml").write_text(text)
            packed = bundle.pack(Path(name) / "a.xml")
        took.append(_orders(cluster, packed, 1, 0) / size)
    return took


def _shared(plan, scene, loaded, planned, size, add) -> float:
    """Times of the picture in one process without a cluster, and on clusters of one and two, in turns; seconds of a
    pass without a cluster."""
    times = {"no cluster": [], "1 process": [], "2 processes": []}
    with connected(address("local:1")) as one, connected(address("local:2")) as two:
        for i in range(plan.of(6, 1)):
            for name, cluster in zip(times, (None, one, two), strict=True):
                with _new(planned) as folder:
                    start = time.perf_counter()
                    rendered = running.render(loaded, folder) if cluster is None else \
                        passes.render(cluster, scene, folder, size=size)  # fmt: skip
                    for _ in rendered:
                        pass
                    # The first time compiles.
                    if i or plan.quick:
                        times[name].append(time.perf_counter() - start)
    for name, took in times.items():
        add(name, "time of the picture", took, "s")
        if name != "no cluster":
            add(name, "time / no cluster", np.array(took) / np.array(times["no cluster"]), "x")
    return float(np.median(times["no cluster"])) / planned.count


@contextmanager
def _new(planned):
    with tempfile.TemporaryDirectory() as name, Store(Path(name)).opened() as store:
        yield folders.claim(store, planned)
