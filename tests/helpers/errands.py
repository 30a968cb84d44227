"""Work for tests of clusters: functions that workers import, too."""

import errno
import os
import time
from pathlib import Path


def double(path, number):
    """At once."""
    return 2 * number


def told(path, folder, name, seconds=0.0):
    """Says by a file that it began, and where; ends when all or it alone may, or after some seconds."""
    (Path(folder) / f"{name}.{os.getpid()}").touch()
    allowed = [Path(folder) / "go", Path(folder) / f"go-{name}"]
    end = time.monotonic() + seconds
    while not any(path.exists() for path in allowed) and time.monotonic() < end:
        time.sleep(0.02)
    return name


def fail(path, number):
    """A mistake in what was asked."""
    if number == 1:
        raise ValueError(f"{path}, line 3: no such thing")
    return number


def die(path):
    """As a kernel does that LLVM cannot compile."""
    os._exit(1)


def full(path, folder, times):
    """Fails so many times as on a full disk; then says how many times it was called."""
    calls = len(list(Path(folder).glob("call*")))
    (Path(folder) / f"call{calls}").touch()
    if calls < times:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    return calls + 1
