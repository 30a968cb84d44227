"""Draws the figures that take no measuring: `make figures`, or with names of files in docs/images only those."""

import itertools
import sys
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from unittest import mock

import phong_bsdf  # noqa: F401

import mitsuba as mi  # isort: skip
import numpy as np
from matplotlib.figure import Figure

mi.set_variant("llvm_ad_rgb")

from pages import IMAGES, below, beside, error_map  # noqa: E402

from phong_bsdf import comparison  # noqa: E402
from phong_bsdf.pictures import images  # noqa: E402
from phong_bsdf.reflection import albedo, lobes  # noqa: E402
from phong_bsdf.report import page  # noqa: E402
from phong_bsdf.scene import rendering  # noqa: E402
from phong_bsdf.stability import naive  # noqa: E402

SCENES = Path(__file__).parent.parent / "scenes"
FILM = {"type": "hdrfilm", "width": 240, "height": 240, "rfilter": {"type": "box"}, "pixel_format": "rgb"}

RED = {"type": "rgb", "value": [0.75, 0.2, 0.12]}


def main(names):
    """Write what is asked for, or everything."""
    for name in names or FIGURES:
        figure = FIGURES[name]()
        if name.endswith(".svg"):
            images.replace_file(IMAGES / name, figure)
        else:
            images.write(IMAGES / name, figure)


# The model ----------------------------------------------------------------------------------------------------


def ball(bsdf, **others):
    """A picture of a ball under one light, 16 samples per pixel."""
    scene = {
        "type": "scene",
        "integrator": {"type": "whitted"},
        "sensor": {
            "type": "perspective", "fov": 26,
            "to_world": mi.ScalarTransform4f().look_at([0, 0.7, 5.2], [0, 0, 0], [0, 1, 0]),
            "film": FILM, "sampler": {"type": "independent", "sample_count": 16},
        },
        "light": {"type": "point", "position": [-3, 4, 5]},
        "background": {"type": "constant", "radiance": {"type": "rgb", "value": [0.28, 0.36, 0.5]}},
        "ball": {"type": "sphere", "bsdf": bsdf},
        **others,
    }  # fmt: skip
    return np.array(mi.render(mi.load_dict(scene)))


def terms():
    """Diffuse, specular, both, and both under a mirror, which sees the tiles and a second ball."""
    tiles = {"type": "checkerboard", "color0": 0.2, "color1": 0.6,
             "to_uv": mi.ScalarTransform4f().scale([40, 40, 1])}  # fmt: skip
    others = {
        "floor": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(20),
            "bsdf": {"type": "diffuse", "reflectance": tiles},
        },
        "other": {
            "type": "sphere", "center": [1.6, -0.6, 0.9], "radius": 0.4,
            "bsdf": {"type": "phong", "kd": {"type": "rgb", "value": [0.85, 0.65, 0.1]}},
        },
    }  # fmt: skip
    both = {"type": "phong", "kd": RED, "ks": 0.5, "p": 40}
    shown = [{**both, "ks": 0}, {**both, "kd": 0}, both, {"type": "mirrorblend", "km": 0.4, "nested": both}]
    return beside(ball(bsdf, **others) for bsdf in shown)


def exponents():
    """Phong above, Blinn-Phong below; the exponent grows to the right."""
    return below(
        beside(ball({"type": lobe, "kd": RED, "ks": 0.6, "p": p}) for p in (1, 10, 100, 1000))
        for lobe in ("phong", "blinnphong")
    )


def vocabularies():
    """Coefficients above, reflectances below; the exponent grows to the right."""
    exponents = (3, 10, 30, 100)
    return below(
        [
            beside(ball({"type": "blinnphong", "kd": RED, "ks": 0.2, "p": p}) for p in exponents),
            beside(
                ball({"type": "blinnphong", "diffuse_reflectance": RED, "specular_reflectance": 0.08, "exponent": p})
                for p in exponents
            ),
        ]
    )


def mirror_floor():
    """The lecture's scene, 16 samples per pixel."""
    return rendering.render(rendering.load(SCENES / "lecture/mirror-floor.xml"), spp=16).image


# Highlights in float32 ------------------------------------------------------------------------------------------


def highlight(p):
    """A plane seen straight from above, a light above its centre; the field of view follows the highlight."""
    half = 6 * np.sqrt(2 / p)
    scene = {
        "type": "scene",
        "integrator": {"type": "whitted"},
        "sensor": {
            "type": "orthographic",
            "to_world": mi.ScalarTransform4f().look_at([0, 0, 2], [0, 0, 0], [0, 1, 0]).scale([half, half, 1]),
            "film": FILM, "sampler": {"type": "independent", "sample_count": 1},
        },
        "plane": {"type": "rectangle", "bsdf": {"type": "blinnphong", "kd": 0.05, "ks": 0.8, "p": p}},
        "light": {"type": "point", "position": [0, 0, 1]},
    }  # fmt: skip
    return np.array(mi.render(mi.load_dict(scene)))


@contextmanager
def naive_formula():
    """Inside, `blinnphong` has the formula of textbooks."""
    textbook = replace(lobes.LOBES["blinnphong"], value=naive.blinnphong)
    with mock.patch.dict(lobes.LOBES, blinnphong=textbook):
        yield


def highlights():
    """The naive formula above, the stable one below; the exponent grows to the right."""
    exponents = (1e5, 1e6, 1e7)
    with naive_formula():
        without = beside(highlight(p) for p in exponents)
    return below([without, beside(highlight(p) for p in exponents)])


# Others -----------------------------------------------------------------------------------------------------------


def albedo_curves():
    """The directional albedo of both lobes in both vocabularies, over the angle of incidence."""
    figure = Figure(figsize=(9, 6.5), layout="constrained")
    degrees = np.linspace(0, 90, 181)
    cos = np.cos(np.radians(degrees)).clip(0)
    for axes, (reflectance, lobe) in zip(
        figure.subplots(2, 2, sharex=True).flat, itertools.product((False, True), albedo.LOBES), strict=True
    ):
        for p in (0, 1, 10, 100, 1000):
            values = albedo.directional_albedo(lobe, cos, p, reflectance=reflectance)
            axes.plot(degrees, values, label=f"p = {p}")
        axes.set(title=f"{lobe}, {'specular_reflectance' if reflectance else 'ks'} = 1", ylim=(0, None))
    figure.axes[0].legend()
    for axes in figure.axes[2:]:
        axes.set_xlabel("angle of incidence in degrees")
    return page.svg_file(figure)


def compared():
    """The pictures of a comparison, and below each its difference to the first."""
    plan = comparison.plan(SCENES / "compare/balls.xml", against=["roughplastic", "principled"])
    pictures = list(comparison.run(plan, size=(300, 225)).images.values())
    return below([beside(pictures), beside(error_map(picture - pictures[0]) for picture in pictures)])


# File in docs/images -> what draws it: linear pixels, or the text of an SVG.
FIGURES = {
    "mirror-floor.png": mirror_floor,
    "model-terms.png": terms,
    "model-exponents.png": exponents,
    "model-vocabularies.png": vocabularies,
    "highlights.png": highlights,
    "albedo.svg": albedo_curves,
    "compare.png": compared,
}

if __name__ == "__main__":
    main(sys.argv[1:])
