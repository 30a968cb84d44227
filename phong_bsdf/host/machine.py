"""The machine and the moment of a measurement, in words."""

import contextlib
import os
import platform
from datetime import datetime, timezone
from pathlib import Path


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def processor() -> str:
    """The model of the processor, or its kind where the system does not say more."""
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        models = [line.split(":")[1].strip() for line in lines if line.startswith("model name")]
        return models[0] if models else platform.processor()
    return platform.processor()


def described(threads: int) -> str:
    """What times depend on: processor, cores, Dr.Jit's threads."""
    return ", ".join(filter(None, (platform.machine(), processor(), f"{cores()} cores", f"{threads} threads")))


def now() -> str:
    """The time, UTC, to the second."""
    return datetime.now(timezone.utc).isoformat(timespec="seconds")
