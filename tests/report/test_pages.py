"""The HTML page in a real browser: complete in itself, and its viewer shows the rendering's own numbers."""

import json
import re

import numpy as np
import pytest
from click.testing import CliRunner

from helpers.browsing import opened
from phong_bsdf.cli import main
from phong_bsdf.pictures import images
from phong_bsdf.report import page as pages

pytestmark = pytest.mark.slow

SCENE = """\
<scene version="3.0.0">
    <integrator type="whitted"/>
    <sensor type="perspective">
        <sampler type="independent"><integer name="sample_count" value="1"/></sampler>
        <film type="hdrfilm"><rfilter type="box"/>
            <integer name="width" value="24"/> <integer name="height" value="16"/>
        </film>
    </sensor>
    <emitter type="point"><point name="position" x="1" y="2" z="0"/><float name="intensity" value="3"/></emitter>
    <shape type="sphere">
        <point name="center" x="0" y="0" z="4"/>
        <bsdf type="phong" id="a&lt;b&gt;&amp;c">
            <rgb name="kd" value="0.6, 0.3, 0.01"/> <float name="ks" value="0.5"/>
        </bsdf>
    </shape>
</scene>
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A comparison with three pictures."""
    folder = tmp_path_factory.mktemp("comparison")
    (folder / "scene.xml").write_text(SCENE)
    args = [folder / "scene.xml", "-o", folder / "out", "--against", "roughplastic", "--against", "diffuse"]
    result = CliRunner().invoke(main, ["compare", *map(str, args)])
    assert result.exit_code == 0, result.stderr
    return folder / "out"


@pytest.fixture
def page(browser, folder):
    """The page, in a browser without a network; in the end nothing was asked for and nothing went wrong."""
    with opened(browser, folder / "index.html", "#viewer[data-ready]") as page:
        yield page


def picture(page):
    """What the viewer shows, 8 bits."""
    size, pixels = page.evaluate(
        "() => { const c = document.querySelector('canvas');"
        " return [[c.height, c.width], Array.from(c.getContext('2d').getImageData(0, 0, c.width, c.height).data)]; }"
    )
    return np.array(pixels, np.uint8).reshape(*size, 4)[..., :3]


def eight_bits(image):
    return images.to_8bit(images.srgb(image))


def close(shown, wanted):
    """Equal but for the roundings of half floats."""
    return np.abs(shown.astype(int) - wanted).max() <= 1


def test_keys_change_the_picture(page, folder):
    """1 to 9 show the pictures, as the PNG files have them; a number without a picture changes nothing."""
    for key, name in (("2", "roughplastic"), ("3", "diffuse"), ("1", "original"), ("7", "original")):
        page.keyboard.press(key)
        assert close(picture(page), eight_bits(images.read_exr(folder / f"{name}.exr"))), name
        assert page.locator('button[aria-pressed="true"]').inner_text().endswith(name)
    originals = [eight_bits(images.read_exr(folder / f"{name}.exr")) for name in ("original", "roughplastic")]
    assert not close(*originals)


def test_buttons_can_be_reached_and_pressed_by_keyboard(page, folder):
    """Tab and Enter do what the mouse does."""
    page.keyboard.press("Tab")
    page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    assert close(picture(page), eight_bits(images.read_exr(folder / "roughplastic.exr")))


def test_exposure(page, folder):
    """One key press is half a stop: the values times sqrt(2), not the 8-bit picture."""
    for _ in range(4):
        page.keyboard.press("E")
    assert close(picture(page), eight_bits(images.read_exr(folder / "original.exr") / 4))
    page.keyboard.press("0")
    page.keyboard.press("e")
    assert close(picture(page), eight_bits(images.read_exr(folder / "original.exr") * 2**0.5))
    assert page.locator('[data-control="stops"]').inner_text() == "+0.5"


def test_wipe(page, folder):
    """The original on the left of the line, the picture on its right."""
    page.keyboard.press("3")
    page.keyboard.press("w")
    shown = picture(page)
    original, other = (eight_bits(images.read_exr(folder / f"{name}.exr")) for name in ("original", "diffuse"))
    assert close(shown[:, :12], original[:, :12]) and close(shown[:, 13:], other[:, 13:])
    page.locator('[data-control="wipe"]').fill("75")
    assert close(picture(page)[:, :18], original[:, :18])
    # The slider has the focus now; keys that it does not use go on working.
    page.keyboard.press("w")
    assert close(picture(page), other)


def test_difference_map(page, folder):
    """The same false colours as the map beside the picture; the original has no difference to itself."""
    page.keyboard.press("d")
    assert picture(page).max() <= pages.colour_map()[0].max()
    page.keyboard.press("2")
    difference = images.read_exr(folder / "roughplastic-difference.exr")
    scale = json.loads(page.locator("#viewer-data").text_content())["difference"]
    wanted = 255 * pages.false_colours(difference, scale)
    # A step of the colour map, where half floats round to the other side.
    assert np.abs(picture(page) - wanted).max() <= 12
    assert np.mean(np.abs(picture(page) - wanted)) < 1
    assert picture(page).max() > 100


def values(page):
    """The values shown for a pixel: name -> three numbers."""
    lines = page.locator('[data-control="pixel"]').inner_text().splitlines()[1:]
    return {line.split()[0]: [float(x) for x in line.split()[1:]] for line in lines}


def test_values_at_the_mouse_are_the_renderings(page, folder):
    """To a thousandth, for every picture at once."""
    box = page.locator("canvas").bounding_box()
    for x, y in ((11, 7), (13, 5), (0, 0), (23, 15)):
        page.mouse.move(box["x"] + (x + 0.5) * box["width"] / 24, box["y"] + (y + 0.5) * box["height"] / 16)
        assert page.locator('[data-control="pixel"]').inner_text().startswith(f"x {x}, y {y}")
        shown = values(page)
        assert list(shown) == ["original", "roughplastic", "diffuse"]
        for name, numbers in shown.items():
            assert numbers == pytest.approx(images.read_exr(folder / f"{name}.exr")[y, x, :3], rel=1e-3, abs=1e-6)
    assert max(images.read_exr(folder / "original.exr")[7, 11]) > 0.1


def test_values_by_keyboard(page, folder):
    """Arrow keys start in the middle and move by a pixel, and stop at the edge."""
    page.locator(".stage").focus()
    for key in ("ArrowLeft", "ArrowLeft", "ArrowUp"):
        page.keyboard.press(key)
    assert page.locator('[data-control="pixel"]').inner_text().startswith("x 11, y 7")
    for _ in range(12):
        page.keyboard.press("ArrowUp")
    assert page.locator('[data-control="pixel"]').inner_text().startswith("x 11, y 0")
    assert values(page)["original"] == pytest.approx(images.read_exr(folder / "original.exr")[0, 11, :3], rel=1e-3)


def test_zoom_to_pixels(page):
    """A pixel of the picture becomes a square of screen pixels; the stage scrolls, the page does not."""
    page.locator('[data-control="zoom"]').select_option("16")
    assert page.locator("canvas").bounding_box()["width"] == 16 * 24
    page.locator("h1").click()
    page.keyboard.press("-")
    assert page.locator("canvas").bounding_box()["width"] == 8 * 24


def test_table_shows_the_numbers_of_the_json(page, folder):
    """As a reader sees it."""
    rows = json.loads((folder / "comparison.json").read_text())["rows"]
    for i, row in enumerate(rows):
        cells = page.locator("#errors tbody tr").nth(i).locator("th, td").all_inner_texts()
        assert cells[0] == row["picture"]
        for cell, field in zip(cells[1:6], ("mse", "relmse", "max_error", "flip", "mean"), strict=True):
            assert cell == "-" if row[field] is None else float(cell) == pytest.approx(row[field], rel=0.05)


def test_names_are_text(page):
    """An id with markup in it is shown, not obeyed."""
    assert page.locator("h3 >> nth=-1").inner_text().startswith("a<b>&c")
    assert page.locator("article b").count() == 0


@pytest.mark.parametrize("width", (360, 1000, 1600))
def test_page_fits_any_screen(page, width):
    """Nothing but tables scrolls sideways, on a phone neither."""
    page.set_viewport_size({"width": width, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_dark_and_light(page):
    """Text and ground change places with the system's colours; plots follow."""

    def colours():
        return page.evaluate(
            "() => [document.body, document.querySelector('.plots svg text')]"
            ".flatMap(e => [getComputedStyle(e).color, getComputedStyle(e).fill, getComputedStyle(e).backgroundColor])"
        )

    page.emulate_media(color_scheme="light")
    light = colours()
    page.emulate_media(color_scheme="dark")
    dark = colours()
    brightness = [sum(map(int, re.findall(r"\d+", c)[:3])) for c in (light[0], light[2], dark[0], dark[2])]
    assert brightness[0] < brightness[1] and brightness[2] > brightness[3]
    # The text of a plot has the page's colour.
    assert (light[4], dark[4]) == (light[0], dark[0])


def test_pictures_are_there_without_scripts(browser, folder):
    """The pictures side by side, and the plots, need no JavaScript."""
    context = browser.new_context(java_script_enabled=False, offline=True)
    page = context.new_page()
    page.goto((folder / "index.html").as_uri())
    assert page.locator(".gallery img").count() == 5 and page.locator(".plots svg").count() == 5
    assert page.locator(".gallery img").first.bounding_box()["height"] > 20
    context.close()


def test_values_beyond_half_floats(tmp_path):
    """Brighter than 65504, they are scaled: the viewer's numbers stay right."""
    data = pages.viewer({"a": np.full((1, 1, 3), 1e9, np.float32)}, 1.0)
    assert data["scale"] * pages.LARGEST_HALF == pytest.approx(1e9)
