"""The plugins' names, and their registration in every variant.

A Python plugin is a class of one variant: it has to be built again, and registered
again, for each variant that becomes active. The modules in `plugins/` therefore
have the shape of Mitsuba's own Python plugins (the class, then its registration as
the last line) and are reloaded here at each change of variant. From Mitsuba 3.10 on
the entry point in `pyproject.toml` has the same effect.
"""

import importlib
import sys

import drjit as dr
import mitsuba as mi

from . import llvm

# In the order of loading: a base class before the classes that derive from it.
MODULES = ("lobe_bsdf", "phong", "blinnphong", "mirrorblend", "whitted")

PLUGINS = {"phong": "bsdf", "blinnphong": "bsdf", "mirrorblend": "bsdf", "whitted": "integrator"}

# The variant that the classes in `plugins/` belong to now.
_loaded_for: str | None = None


def register() -> None:
    """Register the plugins for the active variant, if there is one, and for every later one."""
    # On one core Dr.Jit has one thread, and with one Mitsuba waits for ever where it reads an EXR file.
    if dr.thread_count() < 2:
        dr.set_thread_count(2)
    mi.detail.add_variant_callback(_on_variant_change)
    for name, kind in PLUGINS.items():
        # Mitsuba asks scalar_rgb alone what kind of object a plugin is.
        if mi.variant() != "scalar_rgb":
            getattr(mi.scalar_rgb, f"register_{kind}")(name, _only_a_name)
    _on_variant_change(None, mi.variant())


def check_variant(name: str) -> None:
    """ValueError where this Mitsuba does not have the variant."""
    if name not in mi.variants():
        raise ValueError(f"there is no variant '{name}'; this Mitsuba has {', '.join(mi.variants())}")


def _on_variant_change(old: str | None, new: str | None) -> None:
    try:
        llvm.check(new or "")
    except llvm.LLVMError:
        # Mitsuba has switched already: leave no variant active that would end the process.
        mi.set_variant(old or "scalar_rgb")
        raise
    _load(new)


def _load(variant: str | None) -> None:
    global _loaded_for
    if variant is None or variant == _loaded_for:
        return
    for module in MODULES:
        name = f"phong_bsdf.plugins.{module}"
        if name in sys.modules:
            importlib.reload(sys.modules[name])
        else:
            importlib.import_module(name)
    _loaded_for = variant


def _only_a_name(props):
    raise RuntimeError(f"{props.plugin_name()}: the variant scalar_rgb must be set before this plugin is made")
