"""A Dask scheduler and workers in processes of their own, as a user starts them, for tests that kill them."""

import contextlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import psutil

TESTS = Path(__file__).parent

# Processes start in some seconds; on a busy machine in many.
PATIENCE = 60

ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join([str(TESTS.parent), str(TESTS)])}


def until(condition, seconds=PATIENCE):
    """Its first true value."""
    end = time.monotonic() + seconds
    while not (value := condition()):
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.02)
    return value


def end(process: subprocess.Popen):
    """A process and its children."""
    with contextlib.suppress(psutil.NoSuchProcess):
        family = psutil.Process(process.pid)
        for member in [*family.children(recursive=True), family]:
            with contextlib.suppress(psutil.NoSuchProcess):
                member.kill()
    process.wait()
    if process.stdout:
        process.stdout.close()


class Processes:
    """The processes of one cluster."""

    def __init__(self, folder: Path, *options, inside=(), host="127.0.0.1"):
        """`options` for all of them; `inside`: a command that they run in."""
        self.folder, self.file, self.started = folder, folder / "scheduler.json", []
        self.options, self.inside, self.host = options, inside, host

    def start(self, *command, inside=None):
        words = [*(self.inside if inside is None else inside), sys.executable, "-m", "dask", *map(str, command)]
        with open(self.folder / f"{len(self.started)}.log", "wb") as log:
            self.started.append(subprocess.Popen(words, env=ENVIRONMENT, stdout=log, stderr=log))
        return self.started[-1]

    def scheduler(self, port=0):
        self.file.unlink(missing_ok=True)
        started = self.start("scheduler", "--host", self.host, "--port", port, "--no-dashboard",
                             "--scheduler-file", self.file, *self.options)  # fmt: skip
        until(self.file.is_file)
        return started

    def worker(self, host=None, inside=None):
        return self.start("worker", self.url, "--nthreads", 1, "--no-dashboard", "--host", host or self.host,
                          "--local-directory", self.folder, *self.options, inside=inside)  # fmt: skip

    @property
    def url(self):
        return json.loads(self.file.read_text())["address"]

    def end(self):
        for process in self.started:
            end(process)


@contextlib.contextmanager
def processes(folder, workers, *options):
    """A scheduler and some workers; ended in any case."""
    group = Processes(folder, *options)
    try:
        group.scheduler()
        for _ in range(workers):
            group.worker()
        yield group
    finally:
        group.end()
