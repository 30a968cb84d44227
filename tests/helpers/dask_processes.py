"""A Dask scheduler and workers in processes of their own, as a user starts them, for tests that kill them."""

import contextlib
import json
import os
import random
import socket
import subprocess
import sys
import time
from pathlib import Path

import psutil

from helpers import ROOT

# Processes start in some seconds; on a busy machine in many.
PATIENCE = 120

ENVIRONMENT = {
    **os.environ,
    "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests")]),
    # A task over which workers die is given up after two, not four.
    "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1",
}


def until(condition, seconds=PATIENCE):
    """Its first true value."""
    end = time.monotonic() + seconds
    while not (value := condition()):
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.02)
    return value


def python(module, *arguments, inside=(), **options):
    """A process that runs a module; `inside`: a command that it runs in."""
    words = [*inside, sys.executable, "-m", "helpers.bound", module, *arguments]
    return subprocess.Popen([*map(str, words)], env=ENVIRONMENT, **options)


def end(process: subprocess.Popen):
    """A process and its children."""
    # The number of one that has ended may be that of another by now.
    if process.poll() is None:
        for member in [*psutil.Process(process.pid).children(recursive=True), process]:
            with contextlib.suppress(psutil.NoSuchProcess):
                member.kill()
    process.wait()
    if process.stdout:
        process.stdout.close()


def free_port():
    """One that no connection gets by chance, now or later."""
    for port in random.sample(range(20000, 32000), 100):
        with contextlib.suppress(OSError), socket.socket() as tried:
            tried.bind(("127.0.0.1", port))
            return port
    raise AssertionError("no free port")


class Processes:
    """The processes of one cluster."""

    def __init__(self, folder: Path, *options, host="127.0.0.1"):
        """`options` for all of them."""
        self.folder, self.file, self.started = folder, folder / "scheduler.json", []
        self.options, self.host = options, host

    def start(self, *command, inside=()):
        with open(self.folder / f"{len(self.started)}.log", "wb") as log:
            self.started.append(python("dask", *command, inside=inside, stdout=log, stderr=log))
        return self.started[-1]

    def scheduler(self, port=0):
        self.file.unlink(missing_ok=True)
        started = self.start("scheduler", "--host", self.host, "--port", port, "--no-dashboard",
                             "--scheduler-file", self.file, *self.options)  # fmt: skip
        # Dask writes it in place.
        until(lambda: self.file.is_file() and self.file.read_text().rstrip().endswith("}"))
        return started

    def worker(self, host=None, inside=()):
        return self.start("worker", self.url, "--nthreads", 1, "--no-dashboard", "--host", host or self.host,
                          "--local-directory", self.folder, *self.options, inside=inside)  # fmt: skip

    @property
    def url(self):
        return json.loads(self.file.read_text())["address"]

    def end(self):
        for process in self.started:
            end(process)


@contextlib.contextmanager
def processes(folder, workers, *options, port=0):
    """A scheduler and some workers; ended in any case."""
    group = Processes(folder, *options)
    try:
        group.scheduler(port)
        for _ in range(workers):
            group.worker()
        yield group
    finally:
        group.end()
