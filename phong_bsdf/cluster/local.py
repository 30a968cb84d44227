"""Loaded by the processes of a local cluster when they start."""

import signal


def dask_setup(worker) -> None:
    """Ctrl-C in a terminal reaches all processes; these are ended by the command, in order."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
