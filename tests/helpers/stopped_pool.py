"""A program: makes every plugin of the package while all threads of Dr.Jit's pool stand still.

Whoever waits for the pool helps it, so whoever waits falls asleep too, and a watchdog ends the process. No timing
decides: `python stopped_pool.py VARIANT` ends with 0 if no constructor waits, and `... VARIANT read` never does.
"""

import ctypes
import faulthandler
import os
import sys
import tempfile
import time
from pathlib import Path

import phong_bsdf  # noqa: F401  (before mitsuba: it chooses the LLVM)

import drjit as dr  # isort: skip
import mitsuba as mi  # isort: skip
import numpy as np

from phong_bsdf.pictures import images

# Seconds after which who has not come back waits. Making one plugin takes milliseconds.
PATIENCE = 10


def textures(folder):
    """One object of each kind, made while the pool still runs."""
    images.write(folder / "t.exr", np.full((4, 4, 3), 0.8, np.float32), linear=True)
    images.write(folder / "t.png", np.full((4, 4, 3), 0.8, np.float32), linear=True)
    colour = {"type": "rgb", "value": [0.2, 0.7, 0.9]}
    found = {
        "uniform": {"type": "uniform", "value": 0.7},
        "raw constant": {"type": "rawconstant", "value": 0.7},
        "colour": colour,
        "regular": {"type": "regular", "wavelength_min": 400.0, "wavelength_max": 700.0, "values": "0.1, 0.9"},
        "irregular": {"type": "irregular", "wavelengths": "400, 500, 700", "values": "0.1, 0.5, 0.9"},
        "blackbody": {"type": "blackbody", "temperature": 3000.0},
        "EXR": {"type": "bitmap", "filename": str(folder / "t.exr")},
        "raw EXR": {"type": "bitmap", "filename": str(folder / "t.exr"), "raw": True},
        "PNG": {"type": "bitmap", "filename": str(folder / "t.png")},
        "checkerboard": {"type": "checkerboard", "color0": 0.2, "color1": colour},
        "mesh attribute": {"type": "mesh_attribute", "name": "vertex_color"},
    }
    return {name: mi.load_dict(description) for name, description in found.items()}


def stop_the_pool() -> None:
    """Each thread of the pool begins to sleep, and something waits behind them."""
    path = next(Path(dr.__file__).parent.glob("*nanothread*"))
    pool, sleep = ctypes.CDLL(str(path)), ctypes.cast(ctypes.CDLL(None).pause, ctypes.c_void_p)
    number, nothing = ctypes.c_uint32, ctypes.c_void_p(None)
    # pool, parents and their number; tasks, function, its argument and that one's size and end; at once, profiled.
    pool.task_submit_dep(
        nothing, nothing, number(0), number(64), sleep, nothing, number(0), nothing, ctypes.c_int(1), ctypes.c_int(0)
    )
    time.sleep(0.1)
    if dr.is_jit_v(mi.Float):
        dr.eval(dr.arange(mi.Float, 100) + 1)


def make(description: dict) -> None:
    """Make what is described, with its children, on this thread."""
    faulthandler.dump_traceback_later(PATIENCE, exit=True)
    kept.append(mi.load_dict(description, parallel=False))


def main(variant: str) -> None:
    """Every plugin with every kind of value in each place."""
    lobes = ("phong", "blinnphong")
    numbers = (
        0.7, 0, {"type": "rgb", "value": [0.2, 0.7, 0.9]},
        {"type": "spectrum", "value": 0.7}, {"type": "spectrum", "value": [(400.0, 0.1), (700.0, 0.9)]},
    )  # fmt: skip
    for value in (*objects.values(), *numbers):
        for lobe in lobes:
            for names in (("kd", "ks", "p"), ("diffuse_reflectance", "specular_reflectance", "exponent")):
                make({"type": lobe, **dict.fromkeys(names, value)})
                bsdf = {"type": lobe, names[0]: value}
                make({"type": "mask", "b": {"type": "twosided", "b": bsdf}, "opacity": 0.5})
                make({"type": "mirrorblend", "km": value, "b": {"type": "twosided", "b": bsdf}})
        make({"type": "whitted", "ambient": value})
    for lobe in lobes:
        make({"type": lobe})
        # More light than arrives: a scale, and a warning.
        make({"type": lobe, "diffuse_reflectance": 0.9, "specular_reflectance": 0.9})
    print(len(kept), "made in", variant)


if __name__ == "__main__":
    mi.set_variant(sys.argv[1])
    mi.set_log_level(mi.LogLevel.Error)
    kept: list = []
    with tempfile.TemporaryDirectory() as folder:
        objects = textures(Path(folder))
    dr.sync_thread()
    stop_the_pool()
    if sys.argv[2:] == ["read"]:
        faulthandler.dump_traceback_later(PATIENCE / 5, exit=True)
        objects["uniform"].max()
    main(sys.argv[1])
    sys.stdout.flush()
    # The pool does not come back.
    os._exit(0)
