"""What every command does first and last: variant and threads, a progress bar, errors and advice as sentences."""

import shlex
import shutil
import sys
from contextlib import contextmanager
from pathlib import Path

import click

from ..host import llvm, machine, registry


def start(variant: str | None, threads: int | None, verbose: bool) -> None:
    """Set variant, threads and log level."""
    import drjit as dr
    import mitsuba as mi

    if variant is None:
        variant = "llvm_ad_rgb" if drjit_has_llvm() else "scalar_rgb"
        if variant == "scalar_rgb":
            click.echo(f"Warning: no usable LLVM, so scalar_rgb is used, which is very slow. {llvm.REMEDY}", err=True)
    registry.check_variant(variant)
    try:
        mi.set_variant(variant)
    except llvm.LLVMError:
        raise
    except ImportError as error:
        remedy = llvm.REMEDY if variant.startswith("llvm") else "Its backend was not found on this machine."
        raise ValueError(f"the variant '{variant}' does not work here: {str(error).split('! ')[0]}. {remedy}") from None
    mi.set_log_level(mi.LogLevel.Info if verbose else mi.LogLevel.Warn)
    # With a single thread Mitsuba's bitmap textures wait for ever.
    dr.set_thread_count(max(2, threads or machine.cores()))


def drjit_has_llvm() -> bool:
    """Whether Dr.Jit has found an LLVM that does not end the process."""
    import drjit

    return drjit.detail.llvm_version()[0] >= llvm.OLDEST


def to_copy(*words) -> str:
    """A command for the user's shell: `phong-bsdf` as this one was called, where it is not on the PATH."""
    name, called = "phong-bsdf", sys.argv[0]
    if Path(called).name == name and shutil.which(name) is None:
        name = called
    return shlex.join([name, *map(str, words)])


@contextmanager
def errors():
    """Turn an expected error into one sentence and exit code 2."""
    try:
        yield
    except (ValueError, OSError, ImportError) as error:
        click.echo(f"Error: {error}", err=True)
        sys.exit(2)
    except MemoryError:
        click.echo("Error: the picture does not fit into memory", err=True)
        sys.exit(2)


@contextmanager
def progress():
    """A progress bar on a terminal, nothing elsewhere. Yields show(what, share done); None: the share as it was."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("loading", total=1)
        yield lambda what, share: bar.update(task, description=what, completed=share)
