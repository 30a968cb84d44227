"""Runs something in a variant of Mitsuba, and leaves variant and Dr.Jit afterwards as they were."""

import contextlib
import gc
import warnings
from collections.abc import Iterator

import drjit as dr
import mitsuba as mi

from ..host.registry import check_variant


@contextlib.contextmanager
def isolated(variant: str) -> Iterator[None]:
    """Inside, `variant` is set; ValueError where this Mitsuba does not have it.

    Afterwards variant, log level, threads and Dr.Jit's flags are restored, and what nobody holds any longer
    is freed: a BSDF that lives on would be compiled into every later kernel.
    """
    check_variant(variant)
    before, threads, resolver = mi.variant(), dr.thread_count(), mi.file_resolver()  # pyright: ignore[reportCallIssue]  (not in Mitsuba's stubs)
    flags = {flag: dr.flag(flag) for flag in _single_flags()}
    _set_variant(variant)
    level = mi.logger().log_level()  # pyright: ignore[reportCallIssue]  (not in Mitsuba's stubs)
    mi.set_log_level(mi.LogLevel.Warn)
    try:
        yield
    finally:
        dr.sync_thread()
        gc.collect()
        dr.kernel_history_clear()
        for flag, value in flags.items():
            if dr.flag(flag) != value:
                dr.set_flag(flag, value)
        if dr.thread_count() != threads:
            dr.set_thread_count(threads)
        mi.set_log_level(level)
        mi.set_file_resolver(resolver)  # pyright: ignore[reportCallIssue]  (not in Mitsuba's stubs)
        if before is not None:
            _set_variant(before)


def _set_variant(variant: str) -> None:
    """Mitsuba transforms its integrators anew each time; after a hundred times Dr.Jit warns of that.

    As an error, which it is where tests turn warnings into errors, it would leave them half made.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "The AST-transforming decorator", RuntimeWarning)
        mi.set_variant(variant)


def _single_flags() -> list:
    return [flag for flag in dr.JitFlag if int(flag.value).bit_count() == 1]
