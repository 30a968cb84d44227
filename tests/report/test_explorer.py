"""The explorer in a real browser: its pixels, its formula and its copied XML mean what the package renders."""

import base64
import io
import math
import re

import mitsuba as mi
import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from helpers.browsing import opened
from phong_bsdf.cli import main
from phong_bsdf.pictures import images
from phong_bsdf.reflection import lobes

READY = "#picture[data-ready]"
pytestmark = pytest.mark.slow

# Between eye and light, so that the center of the highlight is where a sample of the picture is.
SHARP = "p=1000000&ks=0.9&kd=0.1&azimuth=0&elevation=0&floor=none&light1=0.162,0.162,5,1,ffffff"

SETTINGS = {
    "as it starts": "",
    "phong": "lobe=phong",
    "phong, p = 0": "lobe=phong&p=0&ks=0.4&floor=glossy",
    "p = 1e6": SHARP,
    "phong, p = 1e6": f"lobe=phong&{SHARP}",
    "grazing": "floor=glossy&p=150&ks=0.8&elevation=3&light1=180,9,6,1,ffffff",
    "grazing, phong": "lobe=phong&floor=glossy&p=150&ks=0.8&elevation=3&light1=180,9,6,1,ffffff",
    "from above": "elevation=85&azimuth=140&lobe=phong&p=8",
    "physical, phong": "lobe=phong&terms=physical&kd=0.3&ks=0.4&p=80&floor=glossy",
    "physical, energy rule": "terms=physical&kd=0.9&ks=0.9&p=5&floor=glossy&colour=ffd0a0",
    "four lights": "count=4&light1=-60,40,3,1,ff0000&light2=60,40,4,1,00ff00&light3=180,60,7,1,8080ff&light4=0,-20",
    "light below the board": "light1=20,-30,6,2,ffffff&count=1",
    "falloff, physical": "falloff=1&terms=physical&lobe=phong&light1=-70,25,2.6,3,ffffff&floor=glossy",
    "nothing but mirrors": "km=1&floor=glossy&elevation=10",
    "falloff and mirrors": "falloff=1&km=0.9&floor=glossy&elevation=10",
    "no board, mirror": "floor=none&km=0.5&count=3",
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
    session.locator('[name="move"][value="point"]').check()
    choose(session, "")
    return session


def choose(page, settings):
    """Settings by the address; returns when all but the finest picture is drawn."""
    page.evaluate(
        "hash => { history.replaceState(null, '', '#' + hash); dispatchEvent(new HashChangeEvent('hashchange')); }",
        settings,
    )
    drawn(page)


def drawn(page):
    """Waits for the next picture."""
    page.evaluate("new Promise(resolve => requestAnimationFrame(() => requestAnimationFrame(resolve)))")


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


@pytest.mark.parametrize("settings", SETTINGS.values(), ids=SETTINGS.keys())
def test_picture_is_that_of_the_package(page, settings):
    """The copied XML, rendered, agrees with the canvas to 2/255."""
    choose(page, settings)
    found, wanted = pixels(page), rendered(clipboard(page, "#copy"), encode="srgb" in settings)
    off = np.abs(found.astype(int) - wanted).max(axis=-1) > 2
    # A sample on an edge of a shadow or a square can fall on its other side in float32; two pixels at most did.
    assert off.sum() <= 10
    assert found.std() > 10


def test_narrowest_highlight_is_in_the_picture(page):
    """At p = 1e6 one sample of a pixel meets it: what the picture is compared with is not empty."""
    for lobe in ("phong", "blinnphong"):
        choose(page, f"lobe={lobe}&{SHARP}")
        middle = pixels(page)[232:248, 232:248, 1].astype(int)
        assert middle.max() - np.median(middle) > 50


def test_command_renders_the_same(page, tmp_path):
    """The command in the head of the XML, as it stands."""
    choose(page, "lobe=phong&km=0.3")
    xml = clipboard(page, "#copy")
    (tmp_path / "explorer.xml").write_text(xml)
    command = re.search(r"phong-bsdf (render .*)", xml)[1].split()
    command = [str(tmp_path / word) if word.startswith("explorer.") else word for word in command]
    assert CliRunner().invoke(main, command).exit_code == 0
    written = np.array(Image.open(tmp_path / "explorer.png")).astype(int)
    assert (np.abs(written - pixels(page)).max(axis=-1) > 2).sum() <= 10


def looked_at():
    """n, l and v at the point (10, 30) of the ball, for a light at (-45, 40) and a view at (0, 15), by NumPy."""

    def placed(azimuth, elevation, distance):
        a, e = np.radians([azimuth, elevation])
        return distance * np.array([np.cos(e) * np.sin(a), np.sin(e), np.cos(e) * np.cos(a)])

    n = placed(10, 30, 1)
    to_light, v = placed(-45, 40, 5) - n, placed(0, 15, 7) - n
    return n, to_light / np.linalg.norm(to_light), v / np.linalg.norm(v), np.linalg.norm(to_light)


def shown_results(page):
    """The four results of the formula: each a number or three."""
    texts = page.locator("#formula .result").all_inner_texts()
    return [[plain(x) for x in re.sub(r"[=()]", "", text).split(",")] for text in texts]


def plain(text):
    """`1.2·10−7`, as the page shows it, as a number."""
    mantissa, _, exponent = text.strip().replace("−", "-").partition("·10")
    return float(mantissa) * 10.0 ** int(exponent or 0)


@pytest.mark.parametrize("p", (0, 60, 1e6))
@pytest.mark.parametrize("terms", ("lecture", "physical"))
@pytest.mark.parametrize("lobe", ("phong", "blinnphong"))
def test_formula_has_the_right_numbers(page, lobe, terms, p):
    """Every result, to the three digits shown; c(p) is that of lobes.py."""
    choose(page, f"lobe={lobe}&terms={terms}&p={p}&kd=0.4&ks=0.3&colour=ff8000&falloff=1&point=ball,10,30")
    n, to_light, v, distance = looked_at()
    h = (to_light + v) / np.linalg.norm(to_light + v)
    cosine = n @ h if lobe == "blinnphong" else (2 * (n @ to_light) * n - to_light) @ v
    arriving = (5 / distance) ** 2
    diffuse = arriving * 0.4 * np.array([1, 128 / 255, 0]) * (n @ to_light)
    height = math.pi * lobes.LOBES[lobe].normalization(p) * (n @ to_light) if terms == "physical" else 1
    highlight = arriving * 0.3 * height * cosine**p
    found = shown_results(page)
    wanted = [diffuse, [highlight], diffuse + highlight, diffuse + highlight]
    for shown, value in zip(found, wanted, strict=True):
        value = value if len(shown) > 1 or len(value) == 1 else value[:1]
        # Three digits, or three decimals of a colour.
        assert shown == pytest.approx(list(value), rel=6e-3, abs=6e-4 if len(shown) > 1 else 1e-30)


def test_sum_over_lights_and_mirror(page):
    """L = km L_r + (1 - km) of the sum over all lights, each of which can be looked at."""
    choose(page, "count=3&km=0.25&floor=none&point=ball,10,30&colour=ffffff")
    total = 0
    for i in range(3):
        page.locator(f'[name="light"][value="{i}"]').check()
        drawn(page)
        diffuse, highlight, local, result = (np.array(x) for x in shown_results(page))
        total = total + diffuse + highlight
    assert local == pytest.approx(total, rel=0.01)
    # Without a board the mirror sees the sky.
    assert result == pytest.approx(0.25 * np.array([0.36, 0.45, 0.57]) + 0.75 * local, rel=0.01)


def farthest(page, lobe):
    """Angle from the vertical and length of the longest ray of an outline in the plot."""
    numbers = [
        float(x) for x in re.findall(r"-?[\d.]+", page.locator(f'#plot [data-lobe="{lobe}"]').get_attribute("d"))
    ]
    x, y = np.array(numbers).reshape(-1, 2).T
    x, y = x - x[0], y[0] - y
    i = np.argmax(np.hypot(x, y))
    return math.degrees(math.atan2(x[i], y[i])), math.hypot(x[i], y[i])


def test_plot_points_along_r(page):
    """Both lobes are longest about r, as long as their values; with p = 4 p' Blinn-Phong is as wide as Phong."""
    # Radius of the plot, and where it has the largest value.
    arm, limit = 150, 1
    choose(page, "kd=0&ks=0.9&p=2000&point=ball,-20,20&light1=-60,20,5,1,ffffff&elevation=20")
    angles = page.locator("#plot-angles").inner_text()
    to_light = float(re.search(r"n, l\) ([\d.]+)", angles)[1])
    for lobe in ("phong", "blinnphong"):
        angle, length = farthest(page, lobe)
        # The light is on the left.
        assert angle == pytest.approx(to_light, abs=0.5)
        assert length == pytest.approx(0.9 * arm / limit, rel=1e-3)


def test_keys_move_point_light_and_view(page):
    """Arrows move what Q, W, E choose; B swaps the lobes, H goes to the highlight."""
    marker = page.locator("#arrows .point")
    page.locator("#picture").focus()
    before = float(marker.get_attribute("cx"))
    page.keyboard.press("ArrowRight")
    drawn(page)
    assert float(marker.get_attribute("cx")) == pytest.approx(before + 4, abs=0.5)
    page.keyboard.press("Shift+ArrowLeft")
    drawn(page)
    assert float(marker.get_attribute("cx")) == pytest.approx(before - 20, abs=1)
    page.keyboard.press("w")
    page.keyboard.press("ArrowRight")
    assert value(page, "light.azimuth") == -43
    page.keyboard.press("e")
    page.keyboard.press("Shift+ArrowUp")
    assert (value(page, "elevation"), value(page, "light.azimuth")) == (25, -43)
    page.keyboard.press("b")
    assert page.locator('[name="lobe"][value="phong"]').is_checked()
    page.keyboard.press("h")
    drawn(page)
    assert re.search(r"n, h\) 0.0°", page.locator("#plot-angles").inner_text())
    page.wait_for_selector("#spoken:not(:empty)", state="attached")


def value(page, name):
    return float(page.locator(f'[data-number="{name}"]').input_value())


def test_sliders_and_numbers_agree(page):
    """p runs from 0 to 1e6 on one slider; a number beyond its range becomes the nearest inside."""
    slider, number = page.locator('[data-range="p"]'), page.locator('[data-number="p"]')
    shown = []
    for position in (0, 200, 400, 700):
        slider.fill(str(position))
        shown.append(value(page, "p"))
    assert shown == [0, 10, 1000, 1e6]
    number.fill("12345.5")
    assert 'name="p" value="12345.5"' in page.locator("#xml").text_content()
    assert slider.get_attribute("aria-valuetext") == "12345.5"
    number.fill("1e9")
    number.press("Enter")
    assert value(page, "p") == 1e6
    number.press("ArrowDown")
    page.locator('[data-number="kd"]').press("ArrowUp")
    assert (value(page, "p"), value(page, "kd")) == (980000, 0.81)
    slider.fill("700")
    number.fill("")
    number.blur()
    assert value(page, "p") == 1e6


def test_dragging_puts_the_highlight_under_the_pointer(page):
    """By mouse and by finger; in the mode for the view a drag turns that."""
    box = page.locator("#picture").bounding_box()

    def at(x, y):
        return {"x": box["x"] + box["width"] * x, "y": box["y"] + box["height"] * y}

    def brightest():
        return np.argwhere(pixels(page)[..., 1] > 200).mean(axis=0)[::-1] / 480

    choose(page, "p=1000&kd=0.1&ks=0.9&floor=none&point=ball,60,-30")
    page.locator('[name="move"][value="light"]').check()
    page.mouse.move(*at(0.4, 0.4).values())
    page.mouse.down()
    page.mouse.move(*at(0.6, 0.42).values(), steps=3)
    page.mouse.up()
    page.mouse.move(0, 0)
    assert brightest() == pytest.approx([0.6, 0.42], abs=0.01)
    session = page.context.new_cdp_session(page)
    for kind, points in (("touchStart", [at(0.5, 0.5)]), ("touchMove", [at(0.4, 0.36)]), ("touchEnd", [])):
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
    page.wait_for_timeout(100)
    assert brightest() == pytest.approx([0.4, 0.36], abs=0.01)
    page.locator('[name="move"][value="view"]').check()
    page.mouse.move(*at(0.5, 0.5).values())
    page.mouse.down()
    page.mouse.move(*at(0.6, 0.6).values())
    page.mouse.up()
    assert value(page, "azimuth") < -5 and value(page, "elevation") > 20


def test_point_under_the_mouse_and_the_one_kept(page):
    """Moving shows a point, leaving goes back, a click keeps it; buttons move it."""
    box, angles = page.locator("#picture").bounding_box(), page.locator("#plot-angles")
    kept = angles.inner_text()
    place = round(box["x"] + 0.6 * box["width"]), round(box["y"] + 0.6 * box["height"])
    page.mouse.move(*place)
    shown = angles.inner_text()
    assert shown != kept
    page.mouse.move(0, 0)
    assert angles.inner_text() == kept
    page.mouse.click(*place)
    page.mouse.move(0, 0)
    page.wait_for_selector(READY)
    assert angles.inner_text() == shown and "point=ball" in page.url
    page.locator("#to-highlight").click()
    drawn(page)
    assert "∠(n, h) 0.0°" in angles.inner_text()
    choose(page, "floor=none&point=floor,1,1")
    assert "point=" not in clipboard(page, "#copy-link")
    choose(page, "point=ball,40,0")
    assert "out of this plane" in page.locator("#plot-note").inner_text()
    page.locator("#to-plane").click()
    page.wait_for_selector(READY)
    assert "n, l and v lie in this plane" in page.locator("#plot-note").inner_text()


def test_address_keeps_the_settings(page, browser, path):
    """All that is set, also where it was copied; what makes no sense there is left at its default."""
    page.locator('[data-number="kd"]').fill("0.35")
    page.locator('[name="count"][value="2"]').check()
    page.locator('[name="light"][value="1"]').check()
    page.locator('[data-number="light.azimuth"]').fill("77")
    page.locator("#falloff").check()
    page.locator("#light-colour").fill("#40ff80")
    address, xml, shown = clipboard(page, "#copy-link"), page.locator("#xml").text_content(), pixels(page)
    choose(page, "")
    assert page.locator("#xml").text_content() != xml
    choose(page, address.split("#")[1])
    assert page.locator("#xml").text_content() == xml
    assert np.array_equal(pixels(page), shown)
    choose(page, "")
    start = page.locator("#xml").text_content()
    choose(
        page,
        "lobe=ward&p=NaN&kd=&ks=abc&count=x&light1=,,,&light2=a,b&colour=red&point=moon,1,2&terms=%3Cb%3E&km=Infinity",
    )
    assert page.locator("#xml").text_content() == start
    choose(page, "count=9&p=-5&kd=7&light1=999,999,0,99,00ff00")
    assert (value(page, "p"), value(page, "kd"), value(page, "light.distance")) == (0, 1, 2)


def test_examples_of_the_lecture(page):
    """Each has a sentence and a scene of its own; at grazing light Phong is round where Blinn-Phong is long."""
    scenes = set()
    for button in page.locator(".presets button").all():
        before = page.locator("#words").inner_text()
        button.click()
        assert page.locator("#words").inner_text() != before
        scenes.add(page.locator("#xml").text_content())
        drawn(page)
        # The point is in the picture, its lobe whole in the plot.
        assert "does not see" not in page.locator("#formula-note").inner_text()
        assert "beyond" not in page.locator("#plot-note").inner_text()
    assert len(scenes) == page.locator(".presets button").count()
    page.locator(".presets button", has_text="Grazing").click()
    shapes = []
    for lobe in ("blinnphong", "phong"):
        page.locator(f'[name="lobe"][value="{lobe}"]').check()
        bright = np.argwhere(pixels(page)[300:, 350:, 1] > 200)
        shapes.append(np.ptp(bright, axis=0) + 1)
    assert shapes[0][0] / shapes[0][1] > 2 * shapes[1][0] / shapes[1][1]


def test_every_control_has_a_name_and_a_ring(page):
    """For those who hear the page, and those who use its keys only."""
    controls = page.locator("input:enabled, button, canvas, summary")
    for control in controls.all():
        named = "e => e.ariaLabel || [e, ...(e.labels ?? [])].map(x => x.textContent.trim()).join('')"
        assert control.evaluate(named), control.evaluate("e => e.outerHTML")
    assert len({control.get_attribute("aria-label") for control in page.locator("input[type=color]").all()}) == 2
    assert page.get_by_role("group", name="chosen light").get_by_role("radio").count() == 4
    page.locator("#picture").focus()
    reached = set()
    for _ in range(60):
        page.keyboard.press("Tab")
        reached.add(page.evaluate("(document.activeElement.id || document.activeElement.name || 'button')"))
        ring = page.evaluate(
            "() => { const e = document.activeElement, shown = e.matches('.segments input') ? e.nextElementSibling : e;"
            " return e === document.body || getComputedStyle(shown).outlineStyle; }"
        )
        assert ring != "none", page.evaluate("document.activeElement.outerHTML")
    assert {
        "move",
        "to-plane",
        "kd",
        "p",
        "km",
        "light.azimuth",
        "falloff",
        "azimuth",
        "copy",
        "lobe",
        "floor",
    } <= reached


@pytest.mark.parametrize(("width", "scheme"), ((390, "dark"), (820, "light"), (1300, "dark")))
def test_page_fits_any_screen_and_stays_put(page, width, scheme):
    """Nothing scrolls sideways, nothing moves when numbers change, and nothing is animated."""
    page.set_viewport_size({"width": width, "height": 800})
    page.emulate_media(color_scheme=scheme)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    ground = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (ground == "rgb(255, 255, 255)") == (scheme == "light")
    choose(page, "terms=physical&p=200&kd=0.9&ks=0.9")
    watched = ("#picture", "#plot", "#formula", "#controls", "#copy")
    before = [page.locator(x).bounding_box() for x in watched]
    page.locator("#picture").focus()
    # To the dark side of the ball, then out of sight.
    for key in ("h", "b", "e", *("Shift+ArrowRight",) * 14):
        page.keyboard.press(key)
        drawn(page)
        assert [page.locator(x).bounding_box() for x in watched] == before
    assert "does not see" in page.locator("#formula-note").inner_text()
    assert page.evaluate("document.getAnimations().length") == 0


# The longest lines of the formula, and the longest number.
LONG = "terms=physical&lobe=phong&count=4&falloff=1&km=0.55&floor=glossy&p=1000000&light1=-45,40,5.3,1,ffc080"


@pytest.mark.parametrize("width", (320, 390, 820, 1024, 1300))
def test_nothing_is_cut(page, width):
    """Every formula and every number is there in full, on any screen."""
    page.set_viewport_size({"width": width, "height": 800})
    choose(page, LONG)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    cut = page.evaluate(
        "[...document.querySelectorAll('#formula *, input[type=number]')].filter(e => "
        "e.scrollWidth > e.clientWidth && getComputedStyle(e).display !== 'inline').map(e => e.outerHTML)"
    )
    assert cut == []


@pytest.mark.parametrize(("width", "height"), ((390, 844), (844, 390), (820, 1100), (1024, 768), (1280, 600)))
def test_picture_is_in_sight_of_every_control(page, width, height):
    """Whoever moves a slider sees what it does."""
    page.set_viewport_size({"width": width, "height": height})
    page.evaluate("scrollTo(0, 0)")
    for control in page.locator("#controls input[type=range], #controls input[type=checkbox]").all():
        control.focus()
        box = page.locator("#picture").bounding_box()
        assert box["y"] >= -1 and box["y"] + box["height"] <= height + 1


def test_changes_are_told(page):
    """A slider and a button are followed by the light at the point, for those who hear the page."""
    said = page.locator("#spoken")
    page.locator("#to-highlight").click()
    said.filter(has_text="n dot h 1,").wait_for(state="attached")
    page.locator('[data-range="kd"]').fill("0")
    page.locator('[data-range="ks"]').fill("0")
    said.filter(has_text="L 0, 0, 0").wait_for(state="attached")
    choose(page, "point=ball,180,0")
    said.filter(has_text="the light is behind the surface").wait_for(state="attached")


def test_forbidden_clipboard(page):
    """What was not copied is not said to be."""
    page.evaluate("navigator.clipboard.writeText = () => Promise.reject(); document.execCommand = () => false;")
    page.locator("#copy").click()
    page.locator("#copied", has_text="forbids").wait_for()
    page.evaluate("delete navigator.clipboard.writeText; delete document.execCommand;")
