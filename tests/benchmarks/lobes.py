"""What the stable lobes cost inside a render: interleaved with the naive ones, as ratios of medians.

python tests/benchmarks/lobes.py [REPEATS]
"""

import dataclasses
import sys
import time
from unittest import mock

import phong_bsdf  # noqa: F401

import drjit as dr  # isort: skip
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_rgb")

from phong_bsdf import lobes, stability  # noqa: E402

SIZE = 1024


def scene(kind):
    """A shiny ball that fills the picture, four lights."""
    lights = {
        f"light {i}": {"type": "point", "position": [i - 1.5, 2, -1], "intensity": 0.3}
        for i in range(4)
    }  # fmt: skip
    return {
        "type": "scene",
        "integrator": {"type": "whitted", "shadows": False},
        "sensor": {
            "type": "perspective",
            "fov": 20,
            "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}},
            "sampler": {"type": "independent", "sample_count": 1},
        },
        "ball": {"type": "sphere", "center": [0, 0, 5], "bsdf": {"type": kind, "ks": 0.5, "p": 1000}},
        **lights,
    }


def seconds(loaded):
    dr.sync_thread()
    start = time.perf_counter()
    dr.eval(mi.render(loaded))
    dr.sync_thread()
    return time.perf_counter() - start


def main(repeats=31):
    """Prints one line for each lobe."""
    for kind, stable in lobes.LOBES.items():
        formulas = {"stable": stable, "naive": dataclasses.replace(stable, value=stability.LOBES[kind]["value"][1])}
        loaded = mi.load_dict(scene(kind))
        times = {name: [] for name in formulas}
        for repeat in range(repeats + 2):
            for name, formula in formulas.items():
                with mock.patch.dict(lobes.LOBES, {kind: formula}):
                    elapsed = seconds(loaded)
                # The first two rounds compile and warm up.
                if repeat >= 2:
                    times[name].append(elapsed)
        medians = {name: float(np.median(t)) for name, t in times.items()}
        ratio = medians["stable"] / medians["naive"]
        print(
            f"{kind:11} {SIZE} x {SIZE}, 4 lights: stable {medians['stable'] * 1e3:.1f} ms, "
            f"naive {medians['naive'] * 1e3:.1f} ms, ratio {ratio:.2f}"
        )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
