"""Clusters of real processes on loopback, killed and stopped at chosen moments: each order has one result."""

import gc
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import mitsuba as mi
import psutil
import pytest

import phong_bsdf
from helpers import SCENES, errands
from helpers.dask_processes import ENVIRONMENT, PATIENCE, free_port, processes, until
from phong_bsdf.cluster import connection, orders, work
from phong_bsdf.cluster.connection import ClusterError, address, connected
from phong_bsdf.cluster.orders import Order, Orders
from phong_bsdf.scene import bundle

pytestmark = pytest.mark.usefixtures("limited")

SCENE = SCENES / "course/textured.xml"


@pytest.fixture(scope="module")
def scene():
    return bundle.pack(SCENE)


class Running:
    """Orders under way in a thread, and what has come of them."""

    def __init__(self, cluster, orders_, **options):
        self.results, self.waits, self.error = [], [], None
        self.run = Orders(cluster, orders_, variant=mi.variant(), on_wait=self.waits.append, **options)
        self.thread = threading.Thread(target=self._collect, daemon=True)
        self.thread.start()

    def _collect(self):
        try:
            for result in self.run.results():
                self.results.append(result)
        except Exception as error:
            self.error = error

    def values(self):
        """Of all orders, sorted, when all is done."""
        self.thread.join(PATIENCE)
        assert not self.thread.is_alive() and self.error is None, self.error
        return sorted(result.value for result in self.results)


def told(scene, folder, count, seconds=PATIENCE):
    return [Order(f"n{i}", scene, errands.told, (str(folder), f"n{i}", seconds)) for i in range(count)]


def begun(folder):
    """Process ids by order, of orders that have begun."""
    return {path.stem: int(path.suffix[1:]) for path in Path(folder).glob("n*.*")}


# Where, and who ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("local:0", "at least one process"),
        ("local:x", "at least one process"),
        ("somewhere", "neither local"),
        ("tls://a:1", "belong together"),
        ("tcp://127.0.0.1", "tcp://host:port"),
        ("tcp://a:b", "tcp://host:port"),
        ("tcp://a:70000", "tcp://host:port"),
        ("http://a:1", "tcp://host:port"),
        (__file__, "no scheduler file"),
    ],
)
def test_addresses_that_are_none(text, words):
    """Told before anything is started."""
    with pytest.raises(ClusterError, match=words):
        address(text)


def test_tls_options_belong_together(tmp_path):
    """All three or none, files that exist, and a scheme that says so."""
    files = [tmp_path / name for name in ("ca.pem", "cert.pem", "key.pem")]
    with pytest.raises(ClusterError, match="give all three"):
        address("tls://a:1", (files[0], None, None))
    with pytest.raises(ClusterError, match="no such file"):
        address("tls://a:1", tuple(files))
    for file in files:
        file.touch()
    assert address("tls://a:1", tuple(files)).tls == tuple(files)
    with pytest.raises(ClusterError, match="belong together"):
        address("tcp://a:1", tuple(files))
    with pytest.raises(ClusterError, match="stays on this machine"):
        address("local:2", tuple(files))


def test_nobody_there(monkeypatch):
    """A scheduler that does not answer is an error with its address, after some seconds."""
    monkeypatch.setattr(connection, "SECONDS", 0.5)
    with (
        pytest.raises(ClusterError, match=r"tcp://127\.0\.0\.1:9 does not answer"),
        connected(address("tcp://127.0.0.1:9")),
    ):
        pass


def test_dask_is_not_installed(monkeypatch):
    """Told with what to install."""
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ClusterError, match=r"phong-bsdf\[cluster\]"), connected(address("local:1")):
        pass


def test_versions_in_words():
    """What differs, theirs first."""
    here = work.environment()
    assert work.differences(here, dict(here)) == ""
    assert work.differences(here, {**here, "NumPy": "1.0"}) == f"NumPy 1.0 instead of {here['NumPy']}"


@pytest.mark.slow
def test_versions_are_compared(two, scene, monkeypatch):
    """At connect, with the name of who differs; a worker that comes later is asked by its first order."""
    with connected(address(two.url)) as cluster:
        monkeypatch.setattr(work, "__version__", "9.9")
        words = rf"has phong_bsdf {phong_bsdf.__version__} instead of 9\.9: pictures could differ"
        with pytest.raises(ClusterError, match=rf"worker tcp://127.* {words}"):
            list(Orders(cluster, [Order("d", scene, errands.double, (1,))], variant=mi.variant()).results())
    with pytest.raises(ClusterError, match=rf"the scheduler {words}"), connected(address(two.url)):
        pass


@pytest.mark.slow
def test_each_order_has_one_result(two, scene):
    """By the scheduler's address or its file; more orders than workers; errors are results, with the user's names."""
    for where in (two.url, str(two.file)):
        with connected(address(where)) as cluster:
            doubles = [Order(f"d{i}", scene, errands.double, (i,)) for i in range(20)]
            assert Running(cluster, doubles).values() == [2 * i for i in range(20)]
    with connected(address(two.url)) as cluster:
        fails = [Order(f"f{i}", scene, errands.fail, (i,)) for i in range(3)]
        found = {r.name: (r.value, r.error) for r in Orders(cluster, fails, variant=mi.variant()).results()}
    assert found == {"f0": (0, None), "f1": (None, f"{SCENE}, line 3: no such thing"), "f2": (2, None)}


# What happens to processes ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_ctrl_c_is_not_lost(two, scene, monkeypatch):
    """Python drops its exception in callbacks of the garbage collector, and prints it unless it is kept from that: the
    next look at the cluster has it again."""

    def interrupt(phase, info):
        signal.raise_signal(signal.SIGINT)

    lost = []
    monkeypatch.setattr(sys, "unraisablehook", lost.append)
    with connected(address(two.url)) as cluster:
        gc.callbacks.append(interrupt)
        gc.collect()
        gc.callbacks.remove(interrupt)
        assert not lost
        with pytest.raises(KeyboardInterrupt):
            list(Orders(cluster, [Order("a", scene, errands.double, (1,))], variant=mi.variant()).results())
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler and sys.unraisablehook == lost.append


@pytest.mark.slow
def test_worker_is_killed(two, scene, tmp_path):
    """In the middle of an order: that is done again elsewhere, and nothing is there twice."""
    with connected(address(two.url)) as cluster:
        running = Running(cluster, told(scene, tmp_path, 6))
        until(lambda: len(begun(tmp_path)) == 2)
        name, victim = next(iter(begun(tmp_path).items()))
        os.kill(victim, signal.SIGKILL)
        until(lambda: not psutil.pid_exists(victim))
        (tmp_path / "go").touch()
        assert running.values() == [f"n{i}" for i in range(6)]
        assert len(list(tmp_path.glob(f"{name}.*"))) == 2


@pytest.mark.slow
def test_worker_hangs(two, scene, tmp_path):
    """A process that is stopped is given up after some seconds: another takes its place, its order is done."""
    with connected(address(two.url)) as cluster:
        running = Running(cluster, told(scene, tmp_path, 4), seconds=3.0)
        # The client must know that it has begun.
        name = until(lambda: [a.order.name for a in list(running.run.running.values()) if a.started])[0]
        hung = begun(tmp_path)[name]
        os.kill(hung, signal.SIGSTOP)
        (tmp_path / "go").touch()
        assert running.values() == [f"n{i}" for i in range(4)]
        until(lambda: not psutil.pid_exists(hung))


@pytest.mark.slow
def test_order_that_kills(two, scene, monkeypatch):
    """An order over which every worker dies is an error with its name, and the cluster is of use afterwards."""
    monkeypatch.setattr(orders, "MOST_LOSSES", 1)
    with connected(address(two.url)) as cluster:
        with pytest.raises(ClusterError, match="bad: workers failed, died or hung"):
            list(Orders(cluster, [Order("bad", scene, errands.die)], variant=mi.variant()).results())
        assert Running(cluster, [Order("good", scene, errands.double, (3,))]).values() == [6]


@pytest.mark.slow
def test_worker_with_a_full_disk(two, scene, tmp_path, monkeypatch):
    """What fails for want of disk or memory is tried again, elsewhere if somebody else is free; not for ever."""
    with connected(address(two.url)) as cluster:
        assert Running(cluster, [Order("f", scene, errands.full, (str(tmp_path), 2))]).values() == [3]
        monkeypatch.setattr(orders, "MOST_LOSSES", 2)
        with pytest.raises(ClusterError, match=r"g: workers failed.*No space left on device.* \(tcp://127"):
            list(
                Orders(cluster, [Order("g", scene, errands.full, (str(tmp_path), 99))], variant=mi.variant()).results()
            )


@pytest.mark.slow
def test_worker_joins_late(scene, tmp_path):
    """No worker at first: that is told. Who comes gets work, and the scene, at once."""
    with processes(tmp_path, 0) as group, connected(address(group.url)) as cluster:
        running = Running(cluster, told(scene, tmp_path, 5))
        until(lambda: "waiting for workers" in running.waits)
        group.worker()
        until(lambda: begun(tmp_path))
        group.worker()
        until(lambda: len(set(begun(tmp_path).values())) == 2)
        (tmp_path / "go").touch()
        assert running.values() == [f"n{i}" for i in range(5)]


@pytest.mark.slow
def test_scheduler_is_restarted(scene, tmp_path):
    """What was finished stays; the rest is done when scheduler and workers are there again."""
    port = free_port()
    with processes(tmp_path, 1, port=port) as group, connected(address(group.url)) as cluster:
        running = Running(cluster, told(scene, tmp_path, 4))
        (first,) = until(lambda: begun(tmp_path))
        (tmp_path / f"go-{first}").touch()
        until(lambda: len(running.results) == 1 and len(begun(tmp_path)) == 2)
        group.end()
        until(lambda: any("waiting for tcp" in wait for wait in running.waits))
        group.scheduler(port)
        group.worker()
        until(lambda: len(list(tmp_path.glob("n*.*"))) == 3)
        (tmp_path / "go").touch()
        assert running.values() == [f"n{i}" for i in range(4)]
        assert len(list(tmp_path.glob(f"{first}.*"))) == 1


@pytest.mark.slow
def test_local_cluster_leaves_nothing():
    """Processes on loopback that end with it."""
    before = set(psutil.Process().children(recursive=True))
    with connected(address("local:1")) as cluster:
        assert cluster.workers() == {"127.0.0.1": 1}
        # Python's own helper, which minds semaphores, stays.
        family = set(psutil.Process().children(recursive=True)) - before
        family = [member for member in family if "resource_tracker" not in " ".join(member.cmdline())]
        assert family
    until(lambda: not any(member.is_running() for member in family))


@pytest.mark.slow
def test_local_cluster_that_does_not_end(monkeypatch):
    """What takes too long to end is killed, and is no error: the pictures are there."""
    with connected(address("local:1")) as cluster:
        ids = [nanny.pid for nanny in cluster.local.workers.values()]
        close = cluster.local.close
        monkeypatch.setattr(cluster.local, "close", lambda timeout: close(timeout=1e-3))
    until(lambda: not any(psutil.pid_exists(number) for number in ids))


@pytest.mark.slow
def test_script_that_is_imported_by_its_own_processes(tmp_path):
    """Without `if __name__ == '__main__'` a local cluster cannot start: an error says so."""
    script = tmp_path / "script.py"
    script.write_text("from phong_bsdf.cluster.connection import address, connected\n"
                      "with connected(address('local:1')): pass\n")  # fmt: skip
    ran = subprocess.run([sys.executable, script], env=ENVIRONMENT, capture_output=True, text=True, timeout=PATIENCE)
    assert "ClusterError: --cluster local: its processes did not start. If a script" in ran.stderr
