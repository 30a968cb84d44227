"""`python -m helpers.bound MODULE ...` is `python -m MODULE ...` that ends with the process that started it."""

import contextlib
import ctypes
import runpy
import signal
import sys

PR_SET_PDEATHSIG = 1

if __name__ == "__main__":
    # Linux only; elsewhere a killed pytest leaves processes behind.
    with contextlib.suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    del sys.argv[0]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
