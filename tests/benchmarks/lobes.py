"""What the stable lobes cost inside a render: interleaved with the naive formulas."""

import dataclasses
from unittest import mock

import mitsuba as mi

from phong_bsdf.reflection import lobes
from phong_bsdf.stability import naive

from .measure import Plan, compared, interleaved

# Many rounds: the difference is small.
ROUNDS = 31


def scene(kind, size):
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
            "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
            "sampler": {"type": "independent", "sample_count": 1},
        },
        "ball": {"type": "sphere", "center": [0, 0, 5], "bsdf": {"type": kind, "ks": 0.5, "p": 1000}},
        **lights,
    }


def records(plan: Plan):
    """Times of both formulas for each lobe, and their ratio."""
    found = []
    size = plan.of(1024, 64)
    for kind, stable in lobes.LOBES.items():
        textbook = dataclasses.replace(stable, value=getattr(naive, kind))
        loaded = mi.load_dict(scene(kind, size))

        def render(formula, kind=kind, loaded=loaded):
            with mock.patch.dict(lobes.LOBES, {kind: formula}):
                return mi.render(loaded)

        tasks = {"naive": lambda: render(textbook), "stable": lambda: render(stable)}  # noqa: B023
        found += compared("lobes", kind, interleaved(tasks, plan.of(ROUNDS, 2)), "naive", size)
    return found
