"""What happens on a worker: an order comes in, its scene is unpacked, a function of this package carries it out."""

import gc
import platform
import re
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import __version__
from ..host import machine
from ..scene import bundle
from ..scene.bundle import Bundle

# What this process has loaded for the orders of one run.
_kept = {}

# Dask may run several tasks at once in a process, Dr.Jit uses all its threads for one.
_one_at_a_time = threading.Lock()


@dataclass(frozen=True)
class Order:
    """One piece of work. What it gives must depend on nothing but this."""

    name: str
    """Of the result; no other order of a run has it."""
    scene: Bundle
    call: Callable
    """A function of a module, called with the scene's path and the arguments."""
    arguments: tuple = ()
    work: float = 1.0
    """In any unit, for all orders of a run: what time limits and progress go by."""


@dataclass(frozen=True)
class Surroundings:
    """What all orders of a run need."""

    topic: str
    """Of the events that tell the client that an order has begun."""
    variant: str
    environment: Mapping[str, str]
    workers: Mapping[str, int]
    """How many share a machine, by its address."""


@dataclass(frozen=True)
class Result:
    """What became of an order: a value, or the error that its function raised."""

    name: str
    value: Any
    error: str | None
    seconds: float
    worker: str
    different: str = ""
    """Versions that the worker has instead of the client's: then nothing was done."""
    elsewhere: bool = False
    """Whether it was the worker's fault, so that another one may do better."""


def environment() -> dict[str, str]:
    """The versions that a picture depends on."""
    llvm = dr.detail.llvm_version()
    return {
        "phong_bsdf": __version__,
        "Mitsuba": str(mi.__version__),
        "Dr.Jit": metadata.version("drjit"),
        "NumPy": np.__version__,
        "Python": ".".join(platform.python_version_tuple()[:2]),
        "LLVM": str(llvm[0]) if llvm[0] > 0 else "none",
    }


def differences(here: Mapping[str, str], there: Mapping[str, str]) -> str:
    """What is not the same, in words; empty where nothing differs."""
    return ", ".join(
        f"{name} {there.get(name)} instead of {here[name]}" for name in here if here[name] != there.get(name)
    )


def carry_out(order: Order, around: Surroundings, files: Mapping[str, bytes], attempt: int) -> Result:
    """On a worker: do what is ordered. Errors of the function are results, for they would be the same elsewhere.

    `files` are those of the order's scene: they travel by themselves, once to each worker.
    """
    from distributed import get_worker

    worker = get_worker()
    with _one_at_a_time:
        # Tells the client from when on to count.
        worker.log_event(around.topic, {"attempt": attempt, "worker": worker.address})
        if different := differences(around.environment, environment()):
            return Result(order.name, None, None, 0.0, worker.address, different)
        start = time.perf_counter()
        folder = Path(worker.local_directory) / "phong_bsdf"
        value, error, elsewhere = None, None, False
        try:
            prepare(around, re.sub(r"^\w+://|:\d+$", "", worker.address))
            path = bundle.unpack(replace(order.scene, files=files), folder)
            with _undisturbed():
                value = order.call(path, *order.arguments)
        except Exception as caught:
            text = str(caught) if isinstance(caught, ValueError) else f"{type(caught).__name__}: {caught}"
            error = order.scene.named(re.sub(r"\s+", " ", text).strip(), folder)
            # A full disk, too little memory.
            elsewhere = isinstance(caught, OSError | MemoryError)
        return Result(order.name, value, error, time.perf_counter() - start, worker.address, elsewhere=elsewhere)


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Garbage waits: Dask's other thread would free objects of Mitsuba while this one makes kernels from them."""
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def prepare(around: Surroundings, host: str) -> None:
    """Set variant and threads, where they are not yet."""
    if mi.variant() != around.variant:
        # What was made in another variant is of no use.
        _kept.clear()
        gc.collect()
        mi.set_variant(around.variant)
        mi.set_log_level(mi.LogLevel.Error)
    # With a single thread Mitsuba's bitmap textures wait for ever.
    threads = max(2, machine.cores() // max(around.workers.get(host, 1), 1))
    if dr.thread_count() != threads:
        dr.set_thread_count(threads)


def kept(key: object, make: Callable[[], object]):
    """What `make` gives, made once for all orders in a row with this key. What was made for another key is let go
    before: Dr.Jit puts every BSDF that is alive into each kernel."""
    if key not in _kept:
        _kept.clear()
        gc.collect()
        _kept[key] = make()
    return _kept[key]
