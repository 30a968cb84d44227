"""`phong-bsdf check`: a verdict for one picture, a table for a class, results for Gradescope, pages."""

import json
import re

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from helpers import ROOT, mistaken
from helpers.browsing import opened
from phong_bsdf.checking import mistakes
from phong_bsdf.checking.hits import Material
from phong_bsdf.cli import main
from phong_bsdf.pictures import images
from phong_bsdf.report import check as report

WIDTH, HEIGHT = 60, 44
SCENE = mistaken.CLASS["a"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder, with scene.xml."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.xml").write_text(mistaken.xml(SCENE, WIDTH, HEIGHT))
    return tmp_path


def draw(path, *mistakes, srgb=False):
    """A student's picture."""
    pixels = mistaken.store(mistaken.render(SCENE, mistakes, WIDTH, HEIGHT), mistakes, srgb)
    path.parent.mkdir(exist_ok=True)
    Image.fromarray(np.ascontiguousarray(pixels)).save(path)


def check(*args):
    return CliRunner().invoke(main, ["check", *map(str, args)])


def test_a_right_picture(folder):
    """Exit 0, and one line says so; sRGB is the default, as for `render`."""
    draw(folder / "ada.png", srgb=True)
    result = check("ada.png", "scene.xml")
    assert (result.exit_code, result.stderr) == (0, "")
    assert result.stdout.startswith("ada.png: right, score 1.00\n")
    draw(folder / "ada.png")
    assert check("ada.png", "scene.xml", "--linear").exit_code == 0


@pytest.mark.slow
def test_a_wrong_picture(folder):
    """Exit 1; where it is off, what the mistake is, and what to do about it."""
    draw(folder / "bert.png", "falloff")
    result = check("bert.png", "scene.xml", "--linear")
    assert result.exit_code == 1
    assert re.search(r"^bert.png: wrong, score 0\.\d\d\n  \d+ of 2640 pixels are off \(", result.stdout)
    assert "Almost surely: the light falls off with 1/r² (confidence 100 %).\n    Use the intensity" in result.stdout
    plain = check("bert.png", "scene.xml", "--linear", "--no-diagnosis")
    assert plain.exit_code == 1 and "1/r²" not in plain.stdout and "usual mistakes" not in plain.stdout
    Image.fromarray(np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)).save("noise.png")
    assert "None of the usual mistakes explains the picture." in check("noise.png", "scene.xml").stdout


def test_what_render_writes_is_right(folder):
    """The package's own pictures pass: PNG, PNG --linear, EXR."""
    outputs = [arg for name in ("a.png", "a.exr") for arg in ("-o", name)]
    assert CliRunner().invoke(main, ["render", "scene.xml", *outputs]).exit_code == 0
    for name in ("a.png", "a.exr"):
        assert check(name, "scene.xml", "--tolerance", 0, "--edges", 0).exit_code == 0
    assert CliRunner().invoke(main, ["render", "scene.xml", "-o", "b.png", "--linear"]).exit_code == 0
    assert "sRGB curve is missing" in check("b.png", "scene.xml").stdout
    assert check("b.png", "scene.xml", "--linear").exit_code == 0


def test_an_exr_with_a_mistake_and_one_with_a_hole(folder):
    """Floating point is diagnosed like integers; NaN is told first."""
    image = mistaken.render(SCENE, ("mirror-added",), WIDTH, HEIGHT)
    images.write(folder / "a.exr", image)
    assert "(1 - k_m) is missing" in check("a.exr", "scene.xml").stdout
    image[3, 4] = np.nan
    images.write(folder / "a.exr", image)
    result = check("a.exr", "scene.xml", "--html", "out")
    assert result.stdout.endswith("\nThe page: out/index.html\n")
    assert result.exit_code == 1 and "1 pixel of the picture is not finite, first at row 3, column 4" in result.stdout
    assert "Note: not diagnosed: pixels that are not finite come first." in result.stdout
    assert "not finite" in (folder / "out/a.html").read_text()


def test_tolerance_and_edges(folder):
    """As much as the options say, and no more."""
    draw(folder / "a.png")
    pixels = np.array(Image.open("a.png"))
    Image.fromarray(np.where(pixels > 20, pixels - 5, pixels)).save("darker.png")
    options = ("scene.xml", "--linear", "--no-diagnosis")
    assert check("darker.png", *options).exit_code == 1
    assert check("darker.png", *options, "--tolerance", 5).exit_code == 0
    pixels[:, 1:] = pixels[:, :-1].copy()
    Image.fromarray(pixels).save("shifted.png")
    assert check("shifted.png", *options).exit_code == 1
    assert check("shifted.png", *options, "--edges", 100, "--tolerance", 20).exit_code == 0


def test_a_class(folder):
    """A folder, or files: a line for each, in which one bad file stops nothing; exit 1."""
    draw(folder / "class/ada.png")
    draw(folder / "class/bert.png", "no-shadows")
    (folder / "class/carl.png").write_bytes(b"nothing")
    (folder / "class/notes.txt").write_text("no picture")
    result = check("class", "scene.xml", "--linear")
    assert result.exit_code == 1
    lines = result.stdout.splitlines()
    assert lines[0].split() == ["picture", "verdict", "score", "off", "mistake"]
    assert lines[2].split() == ["ada.png", "right", "1.00", "0.00", "%"]
    assert lines[3].startswith("bert.png") and "there are no shadows (100 %)" in lines[3]
    assert lines[4].split()[:2] == ["carl.png", "unreadable"] and "this is no picture, or of another kind" in lines[4]
    assert lines[5] == "1 of 3 right" and len(lines) == 6
    # Whoever handed in something else must not be forgotten.
    assert result.stderr.splitlines() == ["Left out (not .png, .jpg, .jpeg, .exr, .ppm, .bmp, .npy): class/notes.txt"]
    files = check("class/ada.png", "class/bert.png", "class/carl.png", "scene.xml", "--linear")
    assert files.stdout == result.stdout


def test_nearly_right_is_not_right(folder):
    """A picture with one wrong pixel of many has neither full score nor no pixels off, in any form."""
    assert CliRunner().invoke(main, ["render", "scene.xml", "-o", "a.png", "--size", "300x220"]).exit_code == 0
    image = np.array(Image.open("a.png"))
    image[0, 0] = 255
    Image.fromarray(image).save("a.png")
    args = ("scene.xml", "--size", "300x220", "--edges", 0, "--html", "out", "--gradescope", "r.json", "--points", 10)
    assert "a.png: wrong, score 0.99\n" in check("a.png", *args).stdout
    document = json.loads((folder / "r.json").read_text())
    assert document["tests"][0]["score"] == document["score"] == 9.99
    assert "<td>0.99</td><td>&lt; 0.01 %</td>" in (folder / "out/index.html").read_text()


def test_pictures_that_cannot_be_read(folder):
    """Exit 2 with the reason where there is no other picture."""
    Image.fromarray(np.zeros((5, 7, 3), np.uint8)).save("small.png")
    result = check("small.png", "scene.xml")
    assert (result.exit_code, result.stdout) == (2, "")
    assert "small.png: unreadable: the picture is 7 x 5 pixels and should be 60 x 44" in result.stderr
    assert check("missing.png", "scene.xml").exit_code == 2


@pytest.mark.parametrize(
    ("args", "said"),
    (
        (("a.png", "missing.xml"), "missing.xml: there is no such file"),
        (("a.png", "scene.xml", "--camera", 7), "there is no camera 7"),
        (("empty", "scene.xml"), "there is no picture in this folder"),
        (("a.png", "scene.xml", "--tolerance", -1), "not in the range"),
        (("a.png", "scene.xml", "--html", "a.png"), "is no folder"),
        (("a.png", "scene.xml", "--gradescope", "empty"), "needs a file"),
        (("a.png", "scene.xml", "-D", "no=1"), "no <default> for no"),
        (("scene.xml",), "Missing argument"),
        (("scene.xml", "a.png"), "'a.png' is a picture; the scene comes last"),
    ),
)
def test_bad_usage(folder, args, said):
    """One sentence and exit code 2, before anything is rendered; nothing is left behind."""
    draw(folder / "a.png")
    (folder / "empty").mkdir()
    before = sorted(folder.rglob("*"))
    result = check(*args)
    assert result.exit_code == 2 and said in result.stderr
    assert sorted(folder.rglob("*")) == before


def test_json(folder):
    """All of it for programs: status, score, mistake with its name, options, versions."""
    draw(folder / "a.png", "falloff")
    (folder / "b.png").write_bytes(b"")
    result = check("a.png", "b.png", "scene.xml", "--linear", "--json")
    document = json.loads(result.stdout)
    a, b = document["grades"]
    assert (a["status"], a["mistake"]["name"], b["status"], b["mistake"]) == ("wrong", "falloff", "unreadable", None)
    assert a["mistake"]["confidence"] > 0.95 and 0 <= a["score"] < 1 and a["candidates"][0] == a["mistake"]
    assert document["options"]["linear"] is True and document["scene"] == "scene.xml"
    assert document["context"]["phong_bsdf"]


def test_gradescope(folder):
    """Results in the form that its autograders write: a score, and a test for each picture."""
    draw(folder / "a.png")
    draw(folder / "b.png", "falloff")
    (folder / "c.png").write_bytes(b"")
    result = check(
        "a.png", "b.png", "c.png", "scene.xml", "--linear", "--gradescope", "out/results.json", "--points", 30
    )
    assert result.exit_code == 1
    document = json.loads((folder / "out/results.json").read_text())
    tests = document["tests"]
    assert [t["status"] for t in tests] == ["passed", "failed", "failed"]
    assert [t["max_score"] for t in tests] == [10, 10, 10] and tests[0]["score"] == 10 and tests[2]["score"] == 0
    assert document["score"] == pytest.approx(sum(t["score"] for t in tests), abs=0.02)
    assert "falls off" in tests[1]["output"] and "the file is empty" in tests[2]["output"]
    known = {"name", "number", "score", "max_score", "status", "output", "output_format", "visibility"}
    assert all(set(t) == known for t in tests)


def test_page_names():
    """Every picture has a page of its own, whatever folder it is in, and none is the page of all."""
    files = ["x/a.png", "y/a.png", "y/A.jpg", "index.png", "b.exr"]
    assert report.page_names(files) == ["a", "a-2", "A-3", "picture-index", "b"]
    assert report.labels(files) == files and report.labels(["x/a.png", "y/b.png"]) == ["a.png", "b.png"]


@pytest.mark.slow
def test_pages(folder, browser):
    """An index, and a page for each picture, which no file name can break, and which ask for nothing from outside."""
    draw(folder / "class/a<b>&c.png", "mirror-added")
    draw(folder / "class/right.png")
    (folder / "class/bad.png").write_bytes(b"")
    assert check("class", "scene.xml", "--linear", "--html", "out").exit_code == 1
    index = (folder / "out/index.html").read_text()
    assert "1 of 3 right" in index and 'href="a%3Cb%3E%26c.html"' in index
    text = (folder / "out/a<b>&c.html").read_text()
    assert "(1 - k_m) is missing" in text and "<b>" not in text
    assert text.count('src="data:image/png') >= 4
    start = folder / "out/index.html"
    visits = [f"{start.parent.as_uri()}/a%3Cb%3E%26c.html"]
    with opened(browser, start, "a", width=390, height=800, visits=visits) as page:
        page.get_by_role("link", name="a<b>&c.png").click()
        page.wait_for_selector("#viewer[data-ready]")
        assert page.locator("[data-picture]").all_inner_texts() == ["1 expected", "2 handed in", "3 with the mistake"]
        assert page.evaluate("document.documentElement.scrollWidth") <= 390


def test_every_mistake_is_documented():
    """docs/lecturers.md lists them all, and no other."""
    text = (ROOT / "docs/lecturers.md").read_text()
    listed = set(re.findall(r"`([\w-]+)`", " ".join(re.findall(r"^\| (`.*?) \|", text, re.M))))
    materials = [Material("a", "phong", (0.1,), 3.0), Material("b", "blinnphong", (0.2,), 4.0)]
    known = {"square": True, "lights": 2, "shadows": True, "mirror_bounces": 2, "plane": 1.0}
    known["bounces_asked"] = 8
    files = ((True, True), (False, True), (False, False))
    made = {
        m.name for srgb, integers in files for m in mistakes.usual(materials, srgb=srgb, integers=integers, **known)
    }
    assert listed == made
