"""Every scene in `scenes/`, and the snippets in the plugins' manuals."""

import inspect
import re

import mitsuba as mi
import numpy as np
import pytest

import phong_bsdf  # noqa: F401
from helpers import ROOT

SCENES = sorted(p for p in (ROOT / "scenes").rglob("*.xml") if p.name != "cameras.xml")


def load(name, **defines):
    return mi.load_file(str(ROOT / "scenes" / name), **{k: str(v) for k, v in defines.items()})


def render(name, **defines):
    return np.array(mi.render(load(name, **defines)))


@pytest.mark.parametrize("path", SCENES, ids=lambda p: str(p.relative_to(ROOT / "scenes")))
def test_scenes_render(path):
    """With its defaults overridden; every picture shows something, and only numbers."""
    assert path.read_text().startswith("<!--\n    ")
    image = render(path, width=32, height=24, spp=4, max_depth=4)
    assert image.shape == (24, 32, 3)
    assert np.all(np.isfinite(image)) and image.max() > 0.1
    assert image.std() > 0.01 or path.parent.name == "stress"
    assert f"`{path.relative_to(ROOT / 'scenes')}`" in (ROOT / "scenes/README.md").read_text() or "scene-" in path.name


def test_exponents_keep_the_height_of_the_highlight():
    """The lecture's highlight shrinks with p; its height stays ks."""
    image = render("lecture/exponents.xml", spp=9)
    quarters = np.split(image[..., 0], 4, axis=1)
    bright = [np.mean(q > 0.4) for q in quarters]
    assert bright[0] > bright[1] > bright[2] > bright[3] > 0
    assert [q.max() for q in quarters[1:3]] == pytest.approx([0.78, 0.78], abs=0.03)


def test_lights_make_white():
    """Where three coloured lights arrive, the white surface is grey; each shadow lacks one colour."""
    image = render("lecture/lights.xml").reshape(-1, 3)
    for missing in range(3):
        others = [i for i in range(3) if i != missing]
        assert np.any((image[:, missing] == 0) & (image[:, others] > 0.1).all(axis=1))


def test_falloff():
    """Without falloff the far ball is as bright as the near one up to its angle; with it, it is darker."""

    def ratio(**defines):
        image = render("lecture/falloff.xml", **defines)[..., 0]
        return image[:200, -225:].max() / image[:200, :225].max()

    assert ratio() > 0.85
    assert ratio(convention="physical", intensity=91.6) < 0.6


def test_mirror_floor_blends():
    """km = 1 and km = 0 are the two ends of every km between: L = km L_r + (1 - km) L_local, at one bounce."""
    ends = [render("lecture/mirror-floor.xml", km=km, max_depth=10, width=90, height=60) for km in (0, 1)]
    half = render("lecture/mirror-floor.xml", km=0.5, max_depth=10, width=90, height=60)
    floor = slice(54, 60)
    # The balls mirrored in the floor mirror it in turn (the right one, km = .15), so only almost.
    assert half[floor] == pytest.approx((ends[0][floor] + ends[1][floor]) / 2, abs=0.02)


@pytest.mark.parametrize("name", ("phong", "blinnphong", "mirrorblend", "whitted"))
def test_snippets_of_the_manual_load(name):
    """The XML and the Python in each plugin's docstring make the plugin."""
    module = __import__(f"phong_bsdf.plugins.{name}", fromlist=[name])
    classes = (c for c in vars(module).values() if isinstance(c, type) and c.__module__ == module.__name__)
    manual = inspect.getdoc(next(classes))
    xml, python = re.search(r"XML::\n\n(.*?)\n\nPython::\n\n(.*)", manual, re.S).groups()
    made = [mi.load_string(re.sub(r">", ' version="3.0.0">', xml, count=1)), mi.load_dict(eval(python.strip()))]
    assert all(type(x).__name__.lower() == name for x in made)
