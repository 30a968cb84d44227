"""`dr.syntax` that transforms the same source once.

At each change of variants, of which the tests have hundreds, Mitsuba loads its integrators anew, and would parse,
transform and compile them all.
"""

import functools
import types

import drjit as dr


def remember():
    """From now on."""
    transform, kept = dr.syntax, {}

    @functools.wraps(transform)
    def syntax(f=None, **options):
        if f is None or options:
            return transform(f, **options)
        source = f.__code__.co_filename, f.__code__
        if source not in kept:
            kept[source] = transform(f).__code__
        return types.FunctionType(kept[source], f.__globals__, argdefs=f.__defaults__)

    dr.syntax = syntax
