"""The page of error against time in a real browser: complete in itself, its numbers those of the JSON."""

import json
import math

import numpy as np
import pytest
from click.testing import CliRunner

from helpers.browsing import opened
from phong_bsdf import stability
from phong_bsdf.cli import main
from phong_bsdf.convergence import lobe_errors
from phong_bsdf.pictures import images
from phong_bsdf.report import lobe_errors as lobe_report

pytestmark = pytest.mark.slow

SCENE = """\
<scene version="3.0.0">
    <integrator type="path"><integer name="max_depth" value="3"/></integrator>
    <sensor type="perspective">
        <film type="hdrfilm"><rfilter type="box"/>
            <integer name="width" value="24"/> <integer name="height" value="16"/>
        </film>
    </sensor>
    <emitter type="constant"/>
    <shape type="sphere"><point name="center" x="0" y="0" z="4"/>
        <bsdf type="phong"><rgb name="kd" value="0.6, 0.3, 0.1"/><float name="ks" value="0.4"/></bsdf>
    </shape>
</scene>
"""
METHODS = ("path", "direct", "path-multijitter", "path-roughplastic")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A study of four methods and two references, and one that fails."""
    folder = tmp_path_factory.mktemp("study")
    # Far away: `path` sees no change, and `whitted` refuses the scene.
    lamp = '<shape type="sphere"><point name="center" x="9" y="9" z="0"/><emitter type="area"/></shape>'
    (folder / "scene.xml").write_text(SCENE.replace("</scene>", f"{lamp}</scene>"))
    given = [argument for name in METHODS for argument in ("--method", name)]
    args = [folder / "scene.xml", "-o", folder / "out", "--spp", "1,16,256", "--repeats", "3", *given,
            "--method", "bad=integrator=whitted"]  # fmt: skip
    result = CliRunner().invoke(main, ["converge", *map(str, args)])
    assert result.exit_code == 1, result.stderr or result.exception
    return folder / "out"


@pytest.fixture
def page(browser, folder):
    """The page, in a browser without a network; in the end nothing was asked for and nothing went wrong."""
    with opened(browser, folder / "index.html", "#viewer[data-ready]") as page:
        yield page


@pytest.fixture(scope="module")
def found(folder):
    return json.loads((folder / "convergence.json").read_text())


def column(page, table, heading):
    """The cells' texts under a heading."""
    headings = page.locator(f"#{table} thead th").all_inner_texts()
    return page.locator(f"#{table} tbody tr > :nth-child({headings.index(heading) + 1})").all_inner_texts()


def numbers(text):
    """`value (low – high)` -> three numbers."""
    value, _, rest = text.partition(" (")
    return [float(x) for x in (value, *rest.rstrip(")").split(" – ")) if x]


def test_all_numbers_are_those_of_the_json(page, found):
    """Value and interval of every error of every level."""
    levels = [(r["name"], level) for r in found["results"] for level in r["levels"]]
    assert column(page, "levels", "method") == [name for name, _ in levels] and len(levels) == 12
    for heading, field in (("relMSE", "relmse"), ("MSE", "mse"), ("variance", "variance"), ("bias²", "bias")):
        for text, (_, level) in zip(column(page, "levels", heading), levels, strict=True):
            wanted = level[field]
            assert numbers(text) == pytest.approx([wanted["value"], wanted["low"], wanted["high"]], rel=0.06)
    seconds = [float(text) for text in column(page, "levels", "seconds")]
    assert seconds == pytest.approx([level["seconds"]["median"] for _, level in levels], rel=0.06)


def test_tables_of_equal_time_and_error(page, found):
    """Cell by cell; of those with the same reference the least is bold."""
    for identifier, field in (("equal-time", "equal_time"), ("equal-error", "equal_error")):
        table = found[field]
        rows = page.locator(f"#{identifier} tbody tr")
        for i, (name, cells) in enumerate(table["rows"].items()):
            shown = rows.nth(i).locator("th, td").all_inner_texts()
            assert shown[0] == name
            for text, cell in zip(shown[2:], cells, strict=True):
                assert (
                    text == "-"
                    if cell is None
                    else (numbers(text.removeprefix("≤ "))[0] == pytest.approx(cell["estimate"]["value"], rel=0.06))
                )
        # Of `roughplastic` there is nothing to be best of: its reference is its own.
        rivals = {name: table["rows"][name] for name in METHODS[:3]}
        assert table["columns"]
        for i in range(len(table["columns"])):
            values = {name: row[i]["estimate"]["value"] for name, row in rivals.items() if row[i]}
            bold = rows.filter(has=page.locator(f":nth-child({i + 3}).best")).locator("th").all_inner_texts()
            assert bold == ([min(values, key=values.get)] if len(values) > 1 else [])


def test_failed_method_is_told(page):
    """In words, in the summary and in the table."""
    assert "bad failed: " in page.locator(".warnings").inner_text()
    row = page.locator("#methods tbody tr", has=page.locator("th", has_text="bad"))
    assert "area" in row.inner_text()


def test_tables_sort(page, found):
    """A click sorts by numbers, the next one the other way; empty cells stay last. The keyboard can do it, too."""
    finest = {r["name"]: r["levels"][-1]["relmse"]["value"] for r in found["results"] if r["levels"]}
    ascending = sorted(finest, key=finest.get)
    heading = page.locator("#methods thead th", has_text="relMSE")
    heading.locator("button").click()
    assert column(page, "methods", "method") == [*ascending, "bad"]
    assert heading.get_attribute("aria-sort") == "ascending"
    heading.locator("button").focus()
    page.keyboard.press("Enter")
    assert column(page, "methods", "method") == [*reversed(ascending), "bad"]
    assert heading.get_attribute("aria-sort") == "descending"
    page.locator("#methods thead th button").first.click()
    assert column(page, "methods", "method") == sorted([*METHODS, "bad"])
    assert heading.get_attribute("aria-sort") is None


def test_plot_says_its_values(page, found):
    """The point nearest to the mouse; by keyboard from point to point; each has a title for those without a script."""
    titles = page.locator('[data-plot="relmse"] [id^="point-"] title').all_text_contents()
    assert len(titles) == 12 and titles[0].startswith("path, 1 spp: ")
    level = found["results"][0]["levels"][2]
    assert float(titles[2].split("relMSE ")[1].split()[0]) == pytest.approx(level["relmse"]["value"], rel=0.06)
    box = page.locator('[data-plot="relmse"] [id="point-relmse-2-curve0"]').bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2 + 1, box["y"] + box["height"] / 2)
    assert page.locator(".readout").inner_text() == titles[2]
    page.locator('[data-plot="relmse"]').focus()
    page.keyboard.press("ArrowRight")
    assert page.locator(".readout").inner_text() == titles[3]


def test_points_are_where_their_values_are(page, found):
    """Twice the logarithm is twice as far, on both axes, for every point."""
    points, values = [], []
    for i, result in enumerate(found["results"]):
        for j, level in enumerate(result["levels"]):
            box = page.locator(f'[id="point-relmse-{j}-curve{i}"]').bounding_box()
            points.append((box["x"] + box["width"] / 2, box["y"] + box["height"] / 2))
            values.append((level["seconds"]["median"], level["relmse"]["value"]))
    points, logs = np.array(points), np.log(values)
    for axis, sign in ((0, 1), (1, -1)):
        scale, offset = np.polyfit(logs[:, axis], points[:, axis], 1)
        assert np.sign(scale) == sign
        # Half a pixel of the screen.
        assert np.abs(scale * logs[:, axis] + offset - points[:, axis]).max() < 0.6


def test_curves_can_be_hidden_and_errors_chosen(page):
    """A switch takes a curve out of all plots; the list shows one plot at a time."""
    assert page.locator('[data-plot="relmse"]').is_visible() and not page.locator('[data-plot="mse"]').is_visible()
    page.locator('[data-curve="1"]').click()
    assert not page.locator('[id="point-relmse-0-curve1"]').is_visible()
    assert page.locator('[id="point-relmse-0-curve0"]').is_visible()
    page.locator('[data-control="plot"]').select_option("mse")
    assert page.locator('[data-plot="mse"]').is_visible() and not page.locator('[data-plot="relmse"]').is_visible()
    assert not page.locator('[id="point-mse-0-curve1"]').is_visible()
    page.locator('[data-curve="1"]').click()
    assert page.locator('[id="point-mse-0-curve1"]').is_visible()


def canvas(page):
    size, pixels = page.evaluate(
        "() => { const c = document.querySelector('canvas');"
        " return [[c.height, c.width], Array.from(c.getContext('2d').getImageData(0, 0, c.width, c.height).data)]; }"
    )
    return np.array(pixels, np.uint8).reshape(*size, 4)[..., :3]


def test_viewer_compares_each_picture_with_its_own_reference(page, folder):
    """Keys show pictures; the difference of `roughplastic` is to its own reference, not to the first picture."""
    names = [button.split(maxsplit=1)[-1] for button in page.locator("[data-picture]").all_inner_texts()]
    assert names == [*METHODS, "reference path", "reference path-roughplastic"]
    shown = {}
    for key in range(1, 7):
        page.keyboard.press(str(key))
        shown[names[key - 1]] = canvas(page)
        wanted = images.read_exr(folder / "pictures" / f"{names[key - 1].replace(' ', '-')}.exr")
        assert np.abs(shown[names[key - 1]].astype(int) - images.to_8bit(images.srgb(wanted))).max() <= 1
    page.keyboard.press("4")
    page.keyboard.press("r")
    reference = shown["reference path-roughplastic"]
    assert np.array_equal(canvas(page), reference)
    page.keyboard.press("4")
    page.keyboard.press("w")
    page.locator('[data-control="wipe"]').fill("50")
    half = canvas(page)
    assert np.abs(half[:, :12].astype(int) - reference[:, :12]).max() <= 1
    assert np.abs(half[:, :12].astype(int) - shown["reference path"][:, :12]).max() > 5


def test_names_stay_beside_their_numbers(page):
    """On a phone: however far a table is scrolled."""
    page.set_viewport_size({"width": 390, "height": 800})
    name, last = (page.locator(f"#levels tbody tr:first-child > :{which}-child") for which in ("first", "last"))
    last.scroll_into_view_if_needed()
    assert page.locator(".scroll", has=page.locator("#levels")).evaluate("e => e.scrollLeft") > 300
    assert 0 <= name.bounding_box()["x"] < 40


@pytest.mark.parametrize("width", (390, 1000))
@pytest.mark.parametrize("scheme", ("light", "dark"))
def test_page_fits_any_screen(page, width, scheme):
    """Only tables and plots scroll sideways; text is told from its ground."""
    page.set_viewport_size({"width": width, "height": 800})
    page.emulate_media(color_scheme=scheme)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    ink, ground = page.evaluate(
        "() => { const s = getComputedStyle(document.body); return [s.color, s.backgroundColor]; }"
    )
    brightness = [sum(map(int, colour[4:-1].split(","))) for colour in (ink, ground)]
    assert (brightness[0] < brightness[1] - 300) == (scheme == "light")


def test_lobes_on_the_same_page(browser, tmp_path):
    """Formulas have the same plot, readout and tables, in which overflow sorts above all numbers."""
    inputs = ((0.0,) * 6, 1.0, (0.0,) * 6)
    sweeps = [
        [
            stability.Row(
                "value", "phong", p, 10, e, *inputs, 100 * e if p == 1 else math.inf, 1.0, None, None, 4.0, 3.0
            )
            for p in (1.0, 1e6)
        ]
        for e in (1e-6, 2e-6)
    ]
    run = lobe_errors.LobeRun("key", 10, 2, 0, "llvm_ad_rgb", "versions", "machine")
    found = lobe_errors.LobeErrors(run, 2, tuple(lobe_errors.summarise(sweeps)))
    path = lobe_report.write(tmp_path, found)
    with opened(browser, path, "#lobes") as page:
        assert page.locator('[data-plot="value"] [id^="point-"]').count() == 4
        assert column(page, "lobes", "ns") == ["4", "3", "4", "3"]
        errors = [numbers(text)[0] for text in column(page, "lobes", "worst error")]
        assert errors == pytest.approx([r.error.value for r in found.rows], rel=0.06)
        page.locator('[data-plot="value"]').focus()
        page.keyboard.press("ArrowRight")
        assert page.locator(".readout").inner_text().startswith("phong, stable, p = 1: 4 ns, error 1.4e-6")
        heading = page.locator("#lobes thead th button", has_text="worst error")
        heading.click()
        heading.click()
        assert column(page, "lobes", "formula") == ["naive", "naive", "stable", "stable"]
        assert column(page, "lobes", "worst error")[0] == "inf"
