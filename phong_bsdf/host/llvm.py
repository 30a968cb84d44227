"""Finds a libLLVM that Dr.Jit can use, before Dr.Jit looks for one.

Dr.Jit reads ``DRJIT_LIBLLVM_PATH`` once, when it is imported. Left alone it takes
whatever the system has, and LLVM 15 and 16 abort the process at the first kernel.
``prepare`` therefore runs first thing in ``import phong_bsdf``; ``check`` runs
whenever an ``llvm_*`` variant becomes active, and raises instead of letting the
process die.
"""

import ctypes
import os
import platform
import re
import sys
import warnings
from collections.abc import Iterable
from importlib import metadata
from pathlib import Path

VARIABLE = "DRJIT_LIBLLVM_PATH"
WHEEL = "karellen-llvm-core"

# 13 and 14 are refused by Dr.Jit 1.5, 15 and 16 abort in code generation.
OLDEST = 17

# What the wheel's libLLVM links to, in loading order. The wheel makes the
# links `lib*.so.1` only at the first start of Python, which fails in a folder
# the user may not write to: so they are loaded here by their real names.
RUNTIME = ("libunwind.so.1.0", "libc++abi.so.1.0", "libc++.so.1.0")

SYSTEM_FOLDERS = (
    "/usr/lib/x86_64-linux-gnu",
    "/usr/lib/aarch64-linux-gnu",
    "/usr/lib64",
    "/usr/lib/llvm-*/lib",
)

REMEDY = (
    f"Install one with `pip install {WHEEL}` (Linux x86-64) or `apt install libllvm19`, "
    f"or set {VARIABLE} to the file of a libLLVM {OLDEST} or newer before Python starts. "
    "The scalar_* variants need no LLVM."
)


class LLVMError(ImportError):
    """Dr.Jit has no LLVM it can compile with."""


def prepare() -> None:
    """Point Dr.Jit to a usable libLLVM, unless the user has chosen one or Dr.Jit is already loaded."""
    if "drjit" in sys.modules or not sys.platform.startswith("linux"):
        return
    files = _wheel_files()
    path = os.environ.get(VARIABLE) or _newest(files.values()) or _newest(_system_files())
    if path:
        os.environ[VARIABLE] = path
        # A parent process may have chosen the wheel's already: load what it links to here too.
        if Path(path) in files.values():
            _preload(files)
    else:
        warnings.warn(
            f"phong_bsdf: found no libLLVM of version {OLDEST} or newer; llvm_* variants will not work. {REMEDY}",
            RuntimeWarning,
            stacklevel=3,
        )


def check(variant: str) -> None:
    """Raise `LLVMError` if `variant` would compile with an LLVM that kills the process."""
    if not variant.startswith("llvm"):
        return
    import drjit

    major = drjit.detail.llvm_version()[0]
    if 0 < major < OLDEST:
        chosen = os.environ.get(VARIABLE)
        where = f"{VARIABLE}={chosen}" if chosen else "the system's, since drjit was imported before phong_bsdf"
        raise LLVMError(
            f"phong_bsdf: Dr.Jit has loaded LLVM {major} ({where}), which aborts the process at the first kernel. "
            f"Write `import phong_bsdf` before `import mitsuba` and `import drjit`. {REMEDY}"
        )


def describe() -> dict[str, str]:
    """What was found, as name -> value, for `phong-bsdf doctor`."""
    import drjit

    version = drjit.detail.llvm_version()
    return {
        "python": f"{platform.python_version()} ({sys.platform}, {platform.machine()})",
        "drjit": metadata.version("drjit"),
        VARIABLE: os.environ.get(VARIABLE, "not set"),
        "LLVM loaded by Dr.Jit": ".".join(map(str, version)) if version[0] > 0 else "none",
    }


def _wheel_files() -> dict[str, Path]:
    """Name -> path of the shared libraries in the LLVM wheel, if that is installed."""
    try:
        files = metadata.files(WHEEL) or []
    except metadata.PackageNotFoundError:
        return {}
    return {f.name: Path(f.locate()).resolve() for f in files if re.search(r"\.so(\.\d+)*$", f.name)}


def _system_files() -> list[Path]:
    return [path for folder in SYSTEM_FOLDERS for path in Path("/").glob(f"{folder[1:]}/libLLVM*.so*")]


def _newest(paths: Iterable[Path]) -> str | None:
    usable = [path for path in paths if _version(path.name) >= (OLDEST,) and path.is_file()]
    return str(max(usable, key=lambda path: _version(path.name))) if usable else None


def _preload(files: dict[str, Path]) -> None:
    for name in RUNTIME:
        if name in files and files[name].is_file():
            # Not RTLD_GLOBAL: then C++ exceptions of Dr.Jit, which belong to another
            # runtime, would be freed by this one, and each would end the process.
            ctypes.CDLL(str(files[name]), mode=ctypes.RTLD_LOCAL)


def _version(name: str) -> tuple[int, ...]:
    """(23, 1) of `libLLVM.so.23.1`, (17,) of `libLLVM-17.so`, (0,) of a name without a version."""
    match = re.fullmatch(r"libLLVM(?:-([\d.]+))?\.so(?:\.([\d.]+))?", name)
    digits = match and (match[1] or match[2])
    return tuple(map(int, digits.split("."))) if digits else (0,)
