"""Times in interleaved rounds, fresh processes, and the record that every benchmark keeps."""

import functools
import os
import platform
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from unittest import mock

import phong_bsdf  # before mitsuba: it chooses the LLVM

import drjit as dr  # isort: skip
import mitsuba as mi
import numpy as np

from phong_bsdf.host import machine


@dataclass(frozen=True)
class Plan:
    """How much to measure."""

    quick: bool = False
    """Tiny sizes, to see that everything runs: the numbers mean nothing."""
    variant: str = "llvm_ad_rgb"

    def of(self, full, quick):
        """The full value, or the quick one."""
        return quick if self.quick else full


@dataclass(frozen=True)
class Record:
    """One measured quantity: the median over the repeats, and where half of them lie."""

    benchmark: str
    scene: str
    task: str
    quantity: str
    x: float | None
    """What grows, where something does: pixels of a side, lights, ..."""
    median: float
    low: float
    high: float
    """The first and the third quartile."""
    unit: str
    repeats: int
    variant: str
    threads: int
    load: float
    """Load average of the last minute, over all cores: near `threads` or below where nothing else ran."""
    machine: str
    versions: str


def record(benchmark, scene, task, quantity, samples, unit, x=None) -> Record:
    """A record of `samples`, one number or several."""
    samples = np.atleast_1d(np.asarray(samples, float))
    low, median, high = (float(q) for q in np.quantile(samples, (0.25, 0.5, 0.75)))
    return Record(
        benchmark, scene, task, quantity, None if x is None else float(x), median, low, high, unit, len(samples),
        mi.variant(), dr.thread_count(), round(os.getloadavg()[0], 2), _machine(), _versions(),
    )  # fmt: skip


def compared(benchmark, scene, times: Mapping[str, Sequence[float]], reference: str, x=None) -> list[Record]:
    """Records of interleaved times, and of their ratios to those of `reference`, round by round."""
    records = [record(benchmark, scene, task, "time", seconds, "s", x) for task, seconds in times.items()]
    for task, seconds in times.items():
        if task != reference:
            ratios = np.array(seconds) / np.array(times[reference])
            records.append(record(benchmark, scene, task, f"time / {reference}", ratios, "x", x))
    return records


def seconds(task: Callable) -> float:
    """How long `task` takes, including the kernels that it launches."""
    dr.sync_thread()
    start = time.perf_counter()
    result = task()
    dr.eval(result)
    dr.sync_thread()
    return time.perf_counter() - start


def interleaved(tasks: Mapping[str, Callable], rounds: int, clock=seconds, warmup: int = 2) -> dict[str, list[float]]:
    """Seconds of each task in each round, after `warmup` rounds that compile; every other round runs backwards."""
    times = {name: [] for name in tasks}
    for i in range(rounds + warmup):
        for name in list(tasks)[:: 1 if i % 2 else -1]:
            elapsed = clock(tasks[name])
            if i >= warmup:
                times[name].append(elapsed)
    return times


@contextmanager
def fresh_environment():
    """Inside, new processes find no kernels of others: Dr.Jit keeps them in the home folder."""
    with tempfile.TemporaryDirectory() as home, mock.patch.dict(os.environ, HOME=home):
        yield


@contextmanager
def fresh_process(variant: str) -> Iterator[Callable]:
    """A new Python process with an empty kernel cache; yields run(function, *arguments), which runs functions there.

    What a kernel holds depends on everything that is alive in a process, and its compile time on
    what has been compiled before: scenes that are compared live in processes of their own.
    """
    pool = ProcessPoolExecutor(1, get_context("spawn"), initializer=_start, initargs=(variant, dr.thread_count()))
    with fresh_environment(), pool:
        # The process starts now, with the environment as it is now.
        pool.submit(int).result()
        yield lambda function, *arguments: pool.submit(function, *arguments).result()


def _start(variant, threads):
    mi.set_variant(variant)
    mi.set_log_level(mi.LogLevel.Error)
    dr.set_thread_count(threads)


@dataclass(frozen=True)
class Kernels:
    """The kernels that one task launched."""

    operations: int
    """Of the largest: that of the picture. Others read constants."""
    launches: int
    compile_seconds: float
    """Code generation and the backend, LLVM or OptiX."""
    compiled: int
    """Kernels that were found neither in memory nor on disk."""


def kernels(task: Callable) -> Kernels:
    """Runs `task` and counts."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        seconds(task)
        found = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
    return Kernels(
        max(k["operation_count"] for k in found),
        len(found),
        sum(k.get(name, 0) for k in found for name in ("codegen_time", "backend_time")) / 1000,
        sum(not k["cache_hit"] and not k["cache_disk"] for k in found),
    )


def slope(x: Sequence[float], y: Sequence[float]) -> float:
    """The exponent n of y ~ x^n, fitted through the larger half of the points, where constants no longer count."""
    keep = max(2, (len(x) + 1) // 2)
    pairs = sorted(zip(x, y, strict=True))[-keep:]
    return float(np.polyfit(*np.log(np.array(pairs, float)).T, 1)[0])


@functools.cache
def _machine() -> str:
    return f"{machine.processor() or platform.machine()}, {machine.cores()} cores"


@functools.cache
def _versions() -> str:
    llvm = ".".join(map(str, dr.detail.llvm_version()))
    return (
        f"phong_bsdf {phong_bsdf.__version__}, mitsuba {mi.__version__}, drjit {dr.__version__}, llvm {llvm}, "
        f"python {platform.python_version()}"
    )
