"""The explorer in a real browser: its pixels, its formula and its copied XML mean what the package renders."""

import base64
import io
import json
import math
import re
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from browsing import opened
from click.testing import CliRunner
from PIL import Image

from phong_bsdf import images
from phong_bsdf.cli import main

ROOT = Path(__file__).parent.parent
READY = "#picture[data-ready]"

SETTINGS = {
    "as it starts": "",
    "phong": "lobe=phong",
    "p = 0": "p=0&ks=0.4",
    "phong, p = 0": "lobe=phong&p=0&ks=0.4&floor=glossy",
    # From between eye and light the highlight is in the middle, where four samples are within its milliradians.
    "p = 1e6": "p=1000000&ks=0.9&kd=0.1&azimuth=0&elevation=0&light1=0,0,5,1,ffffff",
    "phong, p = 1e6": "lobe=phong&p=1000000&ks=0.9&kd=0.1&azimuth=0&elevation=0&light1=0,0,5,1,ffffff",
    "grazing": "floor=glossy&p=150&ks=0.8&elevation=3&light1=180,9,6,1,ffffff",
    "grazing, phong": "lobe=phong&floor=glossy&p=150&ks=0.8&elevation=3&light1=180,9,6,1,ffffff",
    "from above": "elevation=85&azimuth=140&lobe=phong&p=8",
    "physical": "terms=physical&kd=0.3&ks=0.4&p=80&floor=glossy",
    "physical, phong": "lobe=phong&terms=physical&kd=0.3&ks=0.4&p=80&floor=glossy",
    "physical, energy rule": "terms=physical&kd=0.9&ks=0.9&p=5&floor=glossy&colour=ffd0a0",
    "physical, p = 1e6": "terms=physical&p=1000000&ks=0.001&azimuth=0&elevation=0&light1=0,0,5,1,ffffff",
    "four lights": "count=4&light1=-60,40,3,0.8,ff0000&light2=60,40,4,0.7,00ff00&light3=180,60,7,0.6,8080ff&light4=0,-20,5,1,ffff80",
    "light below the board": "light1=20,-30,6,2,ffffff&count=1",
    "falloff": "falloff=1&light1=-70,25,2.6,1,ffffff&count=2",
    "falloff, physical": "falloff=1&terms=physical&lobe=phong&light1=-70,25,2.6,3,ffffff&floor=glossy",
    "mirror": "km=0.5",
    "mirrors of mirrors": "km=0.5&floor=glossy&lobe=phong",
    "nothing but mirrors": "km=1&floor=glossy&elevation=10",
    "falloff and mirrors": "falloff=1&km=0.9&floor=glossy&elevation=10",
    "no board": "floor=none&km=0.3&count=3",
    "sRGB": "display=srgb&km=0.2",
}  # fmt: skip


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """The page, written by the command."""
    path = tmp_path_factory.mktemp("explorer") / "explorer.html"
    result = CliRunner().invoke(main, ["explore", "-o", str(path)])
    assert result.exit_code == 0, result.stderr or result.exception
    assert result.output == f"The page: {path}\n"
    return path


@pytest.fixture(scope="module")
def session(browser, path):
    """One page for all tests: opening it takes longer than using it."""
    with opened(browser, path, READY, width=1300, height=900) as page:
        page.context.grant_permissions(["clipboard-read", "clipboard-write"])
        yield page


@pytest.fixture
def page(session):
    """The page as it starts."""
    session.set_viewport_size({"width": 1300, "height": 900})
    choose(session, "")
    return session


def choose(page, settings):
    """Settings by the address, and the picture at rest."""
    page.evaluate("hash => { location.hash = hash; dispatchEvent(new HashChangeEvent('hashchange')); }", settings)
    page.wait_for_selector(READY)


def pixels(page):
    """The canvas, (480, 480, 3), 8 bits."""
    page.wait_for_selector(READY)
    address = page.evaluate("document.querySelector('#picture').toDataURL()")
    return np.array(Image.open(io.BytesIO(base64.b64decode(address.split(",")[1]))))[..., :3]


def clipboard(page, button):
    """What a button copies."""
    page.locator(button).click()
    page.locator("#copied", has_text="copied").wait_for()
    return page.evaluate("navigator.clipboard.readText()")


def rendered(xml, encode=False):
    """The picture of a scene in 8 bits."""
    image = np.array(mi.render(mi.load_string(xml)))
    return images.to_8bit(images.srgb(image) if encode else image)


@pytest.mark.slow
@pytest.mark.parametrize("settings", SETTINGS.values(), ids=SETTINGS.keys())
def test_picture_is_the_package_s(page, settings):
    """The copied XML, rendered, agrees with the canvas to 2/255."""
    choose(page, settings)
    xml = clipboard(page, "#copy")
    found, wanted = pixels(page), rendered(xml, encode="srgb" in settings)
    off = np.abs(found.astype(int) - wanted).max(axis=-1)
    print(settings, "off", (off > 2).sum(), off.max(), found.mean(), wanted.mean())
    assert (off > 2).mean() <= 0.001
