"""Finds a Dask cluster by what `--cluster` says, starts one where it says `local`, and compares versions."""

import asyncio
import contextlib
import json
import logging
import os
import re
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..host import machine
from . import work

# Of a connection, and of the answers of workers to the first question; who is later is asked again by each order.
SECONDS = 20

# Until Python 3.10 asyncio has one of its own.
TIMEOUTS = (TimeoutError, asyncio.TimeoutError)

INSTALL = "`pip install 'phong-bsdf[cluster]'` installs what --cluster needs"


class ClusterError(ValueError):
    """A cluster that is not there, or not fit for the work."""


@dataclass(frozen=True)
class Address:
    """Where the cluster is: one of the three."""

    local: int | None = None
    """So many processes on this machine, 0: as fit."""
    url: str | None = None
    file: Path | None = None
    """The scheduler file that Dask writes."""
    tls: tuple[Path, Path, Path] | None = None
    """Files of the authority, the certificate and its key."""

    def __str__(self):
        return "local" if self.local is not None else self.url or f"the scheduler of '{self.file}'"


def address(text: str, tls: tuple[Path | None, Path | None, Path | None] = (None, None, None)) -> Address:
    """Read `local`, `local:N`, `tcp://host:port`, `tls://host:port` or the name of a scheduler file."""
    if any(tls) and not all(tls):
        raise ClusterError("--tls-ca, --tls-cert and --tls-key belong together: give all three")
    for file in filter(None, tls):
        if not file.is_file():
            raise ClusterError(f"'{file}': there is no such file")
    authority, certificate, key = tls
    secure = (authority, certificate, key) if authority and certificate and key else None
    kind, _, count = text.partition(":")
    if kind == "local":
        if not (text == "local" or (count.isdigit() and int(count) > 0)):
            raise ClusterError(f"--cluster: '{text}' should be local or local:N, with at least one process")
        if secure:
            raise ClusterError("--cluster local stays on this machine; it takes no --tls options")
        return Address(local=int(count or 0))
    if "://" in text:
        _check_url(text, "--cluster")
        if text.startswith("tls://") != bool(secure):
            raise ClusterError("--cluster: tls://host:port and the three --tls options belong together")
        return Address(url=text, tls=secure)
    if Path(text).is_file():
        try:
            url = str(json.loads(Path(text).read_text(encoding="utf-8"))["address"])
        except (ValueError, KeyError, TypeError):
            raise ClusterError(
                f"'{text}' is no scheduler file, as `dask scheduler --scheduler-file` writes it"
            ) from None
        _check_url(url, f"the scheduler file '{text}'")
        return Address(file=Path(text), tls=secure)
    raise ClusterError(
        f"--cluster: '{text}' is neither local, local:N, tcp://host:port, tls://host:port nor a scheduler file"
    )


def _check_url(url: str, who: str) -> None:
    # Dask would wait for long, and then tell it in its own words.
    port = re.fullmatch(r"(?:tcp|tls)://[^/\s]+:(\d{1,5})/?", url)
    if not port or not 0 < int(port[1]) < 2**16:
        raise ClusterError(f"{who}: '{url}' should be tcp://host:port or tls://host:port")


def mismatch(who: str, different: str) -> ClusterError:
    """The error for versions that are not the same."""
    return ClusterError(f"{who} has {different}: pictures could differ. Install the same versions there")


class Cluster:
    """A connection to a scheduler, renewed where it was lost."""

    def __init__(self, where: Address, local=None):
        self.where, self.local = where, local
        self.interrupted = threading.Event()
        self.client = self._connected(SECONDS)

    def ensure(self, on_wait: Callable[[str], None]) -> bool:
        """Whether the connection was lost since the last call; if so, waits until there is one again."""
        if self.interrupted.is_set():
            raise KeyboardInterrupt
        if self.client.status == "running":
            return False
        while self.client.status != "running":
            on_wait(f"waiting for {self.where}")
            if self.client.status != "connecting":
                with contextlib.suppress(ClusterError):
                    self.client = self._connected(2)
            time.sleep(0.2)
        return True

    def check(self) -> None:
        """ClusterError where the scheduler or a worker has other versions than this process."""
        here = work.environment()
        found = self._asked(lambda: {"the scheduler": self.client.run_on_scheduler(work.environment)})
        found |= self._asked(lambda: {f"worker {k}": v for k, v in
                                      self.client.run(work.environment, on_error="return").items()})  # fmt: skip
        for who, there in found.items():
            if isinstance(there, Exception):
                raise ClusterError(f"{who} cannot load this package: {there}. Install the same versions there")
            if different := work.differences(here, there):
                raise mismatch(who, different)

    def workers(self) -> dict[str, int]:
        """How many workers there are on each machine."""
        counts = {}
        for worker in self.client.nthreads():
            host = worker.split("://")[-1].rsplit(":", 1)[0]
            counts[host] = counts.get(host, 0) + 1
        return counts

    def close(self) -> None:
        """Leave the cluster; a local one ends."""
        with contextlib.suppress(*TIMEOUTS, OSError):
            self.client.close(timeout=2)
        if self.local is not None:
            _end(self.local)

    def _asked(self, question: Callable[[], dict]) -> dict:
        """The answer, or nothing after some seconds: a worker that hangs must not keep the others."""
        answers = {}

        def ask():
            try:
                answers.update(question())
            except Exception as error:
                answers["the scheduler"] = error

        thread = threading.Thread(target=ask, daemon=True)
        thread.start()
        thread.join(SECONDS)
        return dict(answers)

    def _connected(self, seconds: float) -> Any:
        from distributed import Client, Security

        security = None
        if self.where.tls:
            ca, certificate, key = map(str, self.where.tls)
            security = Security(tls_ca_file=ca, tls_client_cert=certificate, tls_client_key=key,
                                require_encryption=True)  # fmt: skip
        place: dict[str, Any] = {"address": self.local or self.where.url}
        if self.where.file:
            place = {"scheduler_file": str(self.where.file)}
        try:
            return Client(**place, security=security, timeout=seconds, set_as_default=False, name="phong-bsdf")
        except (*TIMEOUTS, OSError, ValueError) as error:
            reason = str(error) or type(error).__name__
            raise ClusterError(f"--cluster: {self.where} does not answer: {reason}") from None


def check_installed() -> None:
    """ClusterError where Dask is missing."""
    try:
        import distributed  # noqa: F401
    except ImportError:
        raise ClusterError(f"--cluster needs dask.distributed; {INSTALL}") from None


@contextlib.contextmanager
def connected(where: Address, verbose: bool = False) -> Iterator[Cluster]:
    """A cluster whose versions are those of this process. A local one is started, and ended."""
    check_installed()
    if not verbose:
        # Lost workers and schedulers are told by this package, in a line.
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
    local = None if where.local is None else _started(where.local or max(machine.cores() // 2, 1), verbose)
    cluster = None
    try:
        cluster = Cluster(where, local)
        cluster.check()
        with _noticed(cluster.interrupted):
            yield cluster
    finally:
        with _uninterrupted():
            if cluster is not None:
                cluster.close()
            elif local is not None:
                _end(local)


@contextlib.contextmanager
def _noticed(interrupted: threading.Event) -> Iterator[None]:
    """Set at Ctrl-C. Its exception alone is lost amid a callback of the garbage collector, and Dask has one.

    Python would print what is lost, with its traceback.
    """
    before, told = signal.getsignal(signal.SIGINT), sys.unraisablehook
    if before is not signal.default_int_handler or threading.current_thread() is not threading.main_thread():
        yield
        return

    def notice(*_):
        interrupted.set()
        raise KeyboardInterrupt

    def tell(lost):
        if not issubclass(lost.exc_type, KeyboardInterrupt):
            told(lost)

    signal.signal(signal.SIGINT, notice)
    sys.unraisablehook = tell
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        sys.unraisablehook = told


def _started(count: int, verbose: bool):
    """A local cluster of so many processes."""
    from distributed import LocalCluster

    try:
        return LocalCluster(
            n_workers=count, threads_per_worker=1, processes=True, host="127.0.0.1",
            dashboard_address="127.0.0.1:0", memory_limit=0, preload=f"{__package__}.local",
            silence_logs=logging.WARNING if verbose else logging.CRITICAL,
        )  # fmt: skip
    except RuntimeError:
        raise ClusterError("--cluster local: its processes did not start. If a script starts them, it must do so under "
                           "`if __name__ == '__main__':`, since they import it, too") from None  # fmt: skip


def _end(local) -> None:
    """End a local cluster; processes that take too long over it are killed."""
    ids = [nanny.pid for nanny in local.workers.values() if nanny.pid]
    with contextlib.suppress(*TIMEOUTS):
        local.close(timeout=5)
        return
    for number in ids:
        with contextlib.suppress(ProcessLookupError):
            os.kill(number, getattr(signal, "SIGKILL", signal.SIGTERM))


@contextlib.contextmanager
def _uninterrupted() -> Iterator[None]:
    """Inside, which are some seconds, another Ctrl-C does nothing: processes would stay behind."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before or signal.SIG_DFL)
