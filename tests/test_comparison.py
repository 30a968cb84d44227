"""`phong-bsdf compare`: what is matched, what is swapped, what is written, and what is refused."""

import csv
import json
import math
import os
import re
import sys
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from click.testing import CliRunner

from helpers import SCENES
from phong_bsdf import comparison
from phong_bsdf.cli import main
from phong_bsdf.pictures import images, metrics
from phong_bsdf.reflection import curves, matching
from phong_bsdf.scene import rendering, surfaces

# Each of them is quick, all of them are not.
pytestmark = pytest.mark.slow


# Two balls; the BSDFs of the left one, line 12, and of the right one, line 16, are filled in.
SCENE = """\
<scene version="3.0.0">
    <integrator type="direct"/>
    <sensor type="perspective">
        <sampler type="independent"><integer name="sample_count" value="4"/></sampler>
        <film type="hdrfilm"><rfilter type="box"/>
            <integer name="width" value="16"/> <integer name="height" value="8"/>
        </film>
    </sensor>
    <emitter type="point"><point name="position" x="0" y="2" z="0"/></emitter>
    <shape type="sphere">
        <point name="center" x="-1" y="0" z="4"/>
        {}
    </shape>
    <shape type="sphere" id="right">
        <point name="center" x="1" y="0" z="4"/>
        <bsdf type="twosided">{}</bsdf>
    </shape>
</scene>
"""
BALL = '<bsdf type="phong" id="ball"><rgb name="kd" value="0.6, 0.3, 0.1"/><float name="ks" value="0.5"/></bsdf>'
CHECKS = """<texture type="checkerboard" name="{}">
            <float name="color0" value="{}"/> <float name="color1" value="{}"/></texture>"""
TEXTURED = f"""<bsdf type="blinnphong">{CHECKS.format("kd", 0.2, 0.4)}
            <float name="ks" value="0.3"/> <float name="p" value="50"/></bsdf>"""


@pytest.fixture
def scene(tmp_path, monkeypatch):
    """The current folder; a function that writes the scene above, with another first BSDF."""
    monkeypatch.chdir(tmp_path)

    def write(bsdf=BALL):
        Path("a.xml").write_text(SCENE.format(bsdf, TEXTURED))
        return Path("a.xml")

    write()
    return write


def command(*args):
    return CliRunner().invoke(main, ["compare", *map(str, args)])


def compare(*args):
    """Run a comparison that must succeed; its JSON."""
    result = command(*args, "-o", "out")
    assert (result.exit_code, result.stderr) == (0, ""), result.stderr or result.exception
    return json.loads(Path("out/comparison.json").read_text())


def found(path):
    state = rendering.parse(path)
    return {s.name: s for s in surfaces.find(state, lambda root: rendering.make(path, root))}


def blinn(lobe, p, **more):
    """A lobe with scales that differ in every number."""
    return matching.Lobe(lobe, (0.6, 0.3, 0.1), (0.2, 0.3, 0.4), p, **more)


# Finding and swapping ---------------------------------------------------------------------------------------


def test_surfaces_are_found_and_named(scene):
    """By id; without one, after what holds them; without that, by plugin and number."""
    assert list(found(scene())) == ["ball", "right.blinnphong"]
    assert list(found(scene('<bsdf type="phong"/>'))) == ["phong-1", "right.blinnphong"]
    other = '<bsdf type="phong"><float name="p" value="3"/></bsdf>'
    both = f'<bsdf type="blendbsdf" id="b"><float name="weight" value="0.5"/><bsdf type="phong"/>{other}</bsdf>'
    assert list(found(scene(both))) == ["b.phong", "b.phong-2", "right.blinnphong"]


def test_parameters_in_the_lectures_vocabulary(scene):
    """Colours, defaults, and textures as their means."""
    ball, right = found(scene()).values()
    assert ball.lobe == matching.Lobe("phong", (0.6, 0.3, 0.1), (0.5,) * 3, 30.0)
    assert right.lobe.diffuse == pytest.approx([0.3] * 3) and right.textured == ("kd",)
    assert (ball.where, right.where) == ("a.xml, line 12", "a.xml, line 16")


def test_parameters_in_the_physical_vocabulary(scene):
    """Where energy is not conserved both scales shrink, as in the BSDF itself."""
    bsdf = '<bsdf type="blinnphong">{}<float name="specular_reflectance" value="0.4"/></bsdf>'
    lobe = next(iter(found(scene(bsdf.format(""))).values())).lobe
    assert lobe == matching.Lobe("blinnphong", (0.5,) * 3, (0.4,) * 3, 30.0, reflectances=True)
    assert lobe.unit_albedo == 1
    white = '<float name="diffuse_reflectance" value="0.7"/>'
    lobe = next(iter(found(scene(bsdf.format(white))).values())).lobe
    assert lobe.diffuse + lobe.specular == pytest.approx([0.7 * 0.9] * 3 + [0.4 * 0.9] * 3)
    kept = white + '<boolean name="ensure_energy_conservation" value="false"/>'
    assert next(iter(found(scene(bsdf.format(kept))).values())).lobe.diffuse == (0.7,) * 3


def test_textured_exponent_is_matched_by_its_mean(scene):
    """And a note says so."""
    ball = next(iter(found(scene(f'<bsdf type="phong">{CHECKS.format("p", 10, 90)}</bsdf>')).values()))
    assert ball.lobe.exponent == pytest.approx(50) and "mean 50 is matched" in ball.notes[0]


def by_hand(left, right):
    """The scene's picture with these BSDFs written into it."""
    return np.array(mi.render(mi.load_string(SCENE.format(left, right))))


def test_a_swapped_scene_is_the_scene_written_by_hand(scene):
    """Every lobe is replaced, nested ones too; textures and everything else stay."""
    result = comparison.run(comparison.plan(scene(), against=["diffuse"]))
    left = '<bsdf type="diffuse"><rgb name="reflectance" value="0.6, 0.3, 0.1"/></bsdf>'
    right = f'<bsdf type="diffuse">{CHECKS.format("reflectance", 0.2, 0.4)}</bsdf>'
    assert np.array_equal(result.images["diffuse"], by_hand(left, right))
    assert result.images["diffuse"].max() > 0.01
    assert not np.array_equal(result.images["diffuse"], result.images["original"])


def test_swap_by_id(scene):
    """Only the BSDF named is replaced, by exactly what is given."""
    choice = comparison.Choice("ball", "roughconductor", {"material": "Au", "alpha": 0.3, "specular_reflectance": 1.0})
    result = comparison.run(comparison.plan(scene(), given=[choice]))
    assert list(result.images) == ["original", "given"]
    assert np.array_equal(result.images["original"], by_hand(BALL, TEXTURED))
    gold = """<bsdf type="roughconductor"><string name="material" value="Au"/><float name="alpha" value="0.3"/>
        <string name="distribution" value="beckmann"/></bsdf>"""
    assert np.array_equal(result.images["given"], by_hand(gold, TEXTURED))


def is_registered(index):
    """Whether Dr.Jit knows a BSDF of this number."""
    try:
        return dr.reinterpret_array(mi.BSDFPtr, mi.UInt32(index))[0] is not None
    except RuntimeError:
        return False


def test_scenes_do_not_pile_up(scene):
    """A scene is gone before the next one is rendered: all live BSDFs are in every kernel."""
    alive = []

    def count(picture, share):
        if share == 1:
            alive.append(sum(is_registered(i) for i in range(1, 64)))

    comparison.run(comparison.plan(scene(), against=["diffuse", "roughconductor"]), on_progress=count)
    assert alive == [3, 3, 3]


# The command ------------------------------------------------------------------------------------------------


def test_files(scene):
    """Pictures and differences as EXR, pictures as PNG, records as CSV and JSON, one page; nothing else."""
    scene()
    compare("a.xml", "--against", "roughplastic", "--against", "principled")
    names = [f"{p}.{e}" for p in ("original", "roughplastic", "principled") for e in ("exr", "png")]
    names += ["roughplastic-difference.exr", "principled-difference.exr"]
    assert sorted(os.listdir("out")) == sorted(
        [*names, "comparison.csv", "comparison.json", "curves.csv", "index.html"]
    )
    difference = images.read_exr("out/principled.exr") - images.read_exr("out/original.exr")
    assert np.array_equal(images.read_exr("out/principled-difference.exr"), difference)
    assert np.abs(difference).max() > 0


def test_records_agree(scene):
    """CSV, JSON and the page tell the same numbers, and they are those of the pictures."""
    kept = compare("a.xml", "--against", "roughplastic", "--against", "diffuse")
    rows = list(csv.DictReader(Path("out/comparison.csv").read_text().splitlines()))
    original = images.read_exr("out/original.exr")
    page = Path("out/index.html").read_text()
    table = re.findall(r"<tr><th scope=\"row\">(.*?)</th>(.*?)</tr>", page[page.index('id="errors"') :])
    for row, line, (name, cells) in zip(kept["rows"], rows, table, strict=False):
        assert {k: "" if v is None else str(v) for k, v in row.items()} == line
        assert name == row["picture"]
        picture = images.read_exr(f"out/{name}.exr")
        assert row["mean"] == pytest.approx(metrics.energy(picture))
        if name != "original":
            found = metrics.errors(picture, original)
            assert (row["mse"], row["relmse"], row["flip"]) == (found.mse, found.relmse, found.flip)
            shown = [float(x) for x in re.findall(r"<td>(.*?)</td>", cells)[:5]]
            assert shown == pytest.approx([row[k] for k in ("mse", "relmse", "max_error", "flip", "mean")], rel=0.05)
    assert [row["picture"] for row in kept["rows"]] == ["original", "roughplastic", "diffuse"]
    assert kept["context"]["variant"] == "llvm_ad_rgb" and kept["integrator"] == "direct"


def test_curves_are_written(scene):
    """curves.csv has every point; the albedo of a Lambertian surface is its reflectance."""
    kept = compare("a.xml", "--against", "diffuse")
    points = list(csv.DictReader(Path("out/curves.csv").read_text().splitlines()))
    grey = (0.6 + 0.3 + 0.1) / 3
    albedos = [
        float(p["value"]) for p in points if (p["surface"], p["picture"], p["outgoing"]) == ("ball", "diffuse", "")
    ]
    assert albedos == pytest.approx([grey] * len(curves.ALBEDO_ANGLES), rel=2e-3)
    assert [a["values"] for a in kept["albedos"] if (a["surface"], a["picture"]) == ("ball", "diffuse")] == [albedos]
    upright = [
        p
        for p in points
        if (p["surface"], p["picture"], p["incidence"], p["outgoing"]) == ("ball", "diffuse", "30", "-1.0")
    ]
    assert float(upright[0]["value"]) == pytest.approx(grey * math.cos(math.radians(1)) / math.pi, rel=1e-5)


def test_terminal(scene):
    """A table with a line for each picture, the notes, and where the page is."""
    out = command("a.xml", "-o", "out", "--against", "roughconductor").stdout.splitlines()
    assert out[0].split()[:3] == ["picture", "MSE", "relMSE"]
    assert [line.split()[0] for line in out[2:4]] == ["original", "roughconductor"]
    assert "Note: roughconductor: ball, right.blinnphong: has no diffuse part: the lobe's is lost" in out
    assert out[-1] == "The page: out/index.html"


def test_render_options(scene):
    """Size, samples, seed and defaults are those of `render`."""
    text = SCENE.format(BALL, TEXTURED).replace('value="0.5"', 'value="$ks"')
    Path("a.xml").write_text(text.replace("<integrator", '<default name="ks" value="1"/><integrator'))
    kept = compare("a.xml", "--size", "6x5", "--spp", 9, "-s", 3, "-D", "ks=0.25")
    assert [kept["rows"][0][k] for k in ("width", "height", "spp", "seed")] == [6, 5, 9, 3]
    assert dict(kept["replacements"][0]["parameters"])["ks"] == "0.25"
    render = CliRunner().invoke(
        main, ["render", "a.xml", "-o", "a.exr", "--size", "6x5", "--spp", "9", "-s", "3", "-D", "ks=0.25"]
    )
    assert render.exit_code == 0
    assert np.array_equal(images.read_exr("a.exr"), images.read_exr("out/original.exr"))


@pytest.mark.slow
@pytest.mark.parametrize("variant", ("scalar_rgb", "llvm_ad_mono", "llvm_ad_spectral", "llvm_ad_spectral_polarized"))
def test_modes(scene, variant):
    """Colours, grey and spectra; a match in another variant is the same match, to the points of a scalar one."""
    kept = compare("a.xml", "-m", variant, "--size", "4x2")
    parameters = dict(kept["replacements"][2]["parameters"])
    assert float(parameters["alpha"]) == pytest.approx(blinn("phong", 30).alpha, rel=1e-3)
    assert float(parameters["specular_reflectance"]) == pytest.approx(0.827, rel=0.01)


@pytest.mark.slow
def test_physical_vocabulary_end_to_end(scene):
    """A scene in reflectances renders, and its highlight keeps the reflectance that it names."""
    try:
        mi.load_dict({"type": "phong", "exponent": 30.0})
    except RuntimeError:
        pytest.skip("phong does not know 'exponent' yet")
    scene('<bsdf type="phong" id="ball"><float name="specular_reflectance" value="0.03"/></bsdf>')
    kept = compare("a.xml")
    albedos = {a["picture"]: a["values"][0] for a in kept["albedos"] if a["surface"] == "ball"}
    assert albedos["original"] == pytest.approx(0.53, rel=2e-3)
    assert dict(kept["replacements"][2]["parameters"])["diffuse_reflectance"] == "0.5"


@pytest.mark.slow
def test_pictures_that_are_no_numbers_are_flagged(scene):
    """A scene with infinite texels has no errors, but a count, in the table and in the records."""
    mi.Bitmap(np.full((2, 2, 3), np.inf, np.float32)).write("infinite.exr")
    text = Path("a.xml").read_text()
    Path("a.xml").write_text(text.replace("</scene>", """
        <shape type="sphere"><float name="radius" value="50"/><boolean name="flip_normals" value="true"/>
            <bsdf type="diffuse"><texture type="bitmap" name="reflectance"><boolean name="raw" value="true"/>
                <string name="filename" value="infinite.exr"/></texture></bsdf></shape></scene>"""))  # fmt: skip
    result = command("a.xml", "-o", "out", "--against", "diffuse")
    assert result.exit_code == 0, result.stderr
    rows = json.loads(Path("out/comparison.json").read_text())["rows"]
    assert rows[1]["nonfinite"] > 0 and rows[1]["mse"] == "nan"
    assert f"{rows[1]['nonfinite']} PIXELS ARE NO NUMBERS" in result.stdout
    assert 'class="bad"' in Path("out/index.html").read_text()


@pytest.mark.slow
def test_without_flip(scene, monkeypatch):
    """Where `flip-evaluator` is not installed its column is empty."""
    monkeypatch.setitem(sys.modules, "flip_evaluator", None)
    row = compare("a.xml", "--against", "diffuse")["rows"][1]
    assert row["flip"] is None and row["mse"] > 0


@pytest.mark.slow
@pytest.mark.parametrize(("name", "spp", "relmse"), (("balls", 256, 5e-3), ("floor", 4, 5e-3)))
def test_scenes_to_compare(scene, name, spp, relmse):
    """With `path` and with `whitted`: physical BSDFs come close to the lobes, highlights do not vanish."""
    kept = compare(SCENES / f"compare/{name}.xml", "--size", "60x45", "--spp", spp,
                   "--against", "principled", "--against", "roughplastic", "--against", "diffuse")  # fmt: skip
    assert kept["rows"][1]["relmse"] < relmse
    original, principled, diffuse = (images.read_exr(f"out/{p}.exr") for p in ("original", "principled", "diffuse"))
    highlight = (original - diffuse).max(axis=2) > 0.05
    assert highlight.sum() >= 10
    assert np.mean(principled[highlight] - diffuse[highlight]) == pytest.approx(
        np.mean(original[highlight] - diffuse[highlight]), rel=0.3
    )
    if name == "floor":
        # The picture without highlights is nowhere brighter: it is the same but for them.
        assert (diffuse - original).max() < 1e-6


# Mistakes ---------------------------------------------------------------------------------------------------


MISTAKES = {
    "target": (["--against", "plastic"], "'plastic' cannot be matched, only roughplastic, .*--bsdf id=plastic"),
    "no such surface": (
        ["--bsdf", "nix=diffuse"],
        r"no phong or blinnphong BSDF 'nix', only ball \(a.xml, line 12\), right",
    ),
    "no such plugin": (["--bsdf", "ball=nix"], "a.xml, line 12: there is no bsdf 'nix'"),
    "no BSDF": (["--bsdf", "ball=sphere"], "a.xml, line 12: .*does not match the expected type"),
    "no such parameter": (
        ["--bsdf", "ball=roughplastic,alhpa=1"],
        "a.xml, line 12: 'roughplastic' has no parameter 'alhpa'",
    ),
    "wrong type": (["--bsdf", "ball=roughplastic,alpha=x"], 'a.xml, line 12: .*"alpha" has the wrong type'),
    "twice": (["--bsdf", "ball=diffuse", "--bsdf", "ball=plastic"], "--bsdf ball= is given twice"),
    "no such camera": (["--camera", "2"], "there is no camera 2"),
    "no such default": (["-D", "x=1"], "no <default> for x"),
    "no such mode": (["-m", "nix"], "there is no variant 'nix'"),
}


def fails(*args):
    """The one sentence said; no file comes of it."""
    before = sorted(Path().rglob("*"))
    result = command(*args)
    assert isinstance(result.exception, SystemExit), repr(result.exception)
    assert (result.exit_code, result.stdout) == (2, "")
    assert sorted(Path().rglob("*")) == before
    assert re.fullmatch(r"Error: [^\n]+\n", result.stderr), result.stderr
    return result.stderr[len("Error: ") :]


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes(scene, mistake):
    """One sentence, exit code 2, before anything is rendered; no folder is left."""
    options, message = MISTAKES[mistake]
    assert re.search(message, fails("a.xml", "-o", "out", *options))


@pytest.mark.parametrize("folder", ("a.xml", "a.xml/out", "/proc/out"))
def test_folder_that_cannot_be_written(scene, folder, monkeypatch):
    """It is refused before anything is rendered."""
    monkeypatch.setattr(comparison, "run", None)
    assert re.match(f"'{folder}' cannot be written", fails("a.xml", "-o", folder))


@pytest.mark.parametrize("bsdf", ("ball", "=diffuse", "ball=", "ball=diffuse,x", "ball=diffuse,=1"))
def test_malformed_bsdf(scene, bsdf):
    """It is explained in click's words."""
    result = command("a.xml", "-o", "out", "--bsdf", bsdf)
    assert result.exit_code == 2 and "should be id=plugin or id=plugin,name=value" in result.stderr


def test_nothing_to_compare(scene):
    """A scene without lobes."""
    Path("a.xml").write_text(SCENE.format('<bsdf type="diffuse"/>', '<bsdf type="diffuse"/>'))
    assert fails("a.xml", "-o", "out") == "a.xml: the scene has no phong or blinnphong BSDF to compare\n"


def test_mistake_in_the_scene_itself(scene):
    """It is named with its line, as `render` does."""
    scene('<bsdf type="phong"><float name="kd" value="-1"/></bsdf>')
    assert fails("a.xml", "-o", "out") == "a.xml, line 12: phong: 'kd' must be finite and >= 0, got -1.0\n"


def test_texture_without_a_mean(scene):
    """Vertex colours depend on the mesh: refused, with what is known instead."""
    texture = '<texture type="mesh_attribute" name="kd"><string name="name" value="vertex_c"/></texture>'
    scene(f'<bsdf type="phong">{texture}</bsdf>')
    assert "phong: 'kd' is a 'mesh_attribute', whose mean depends on the shape" in fails("a.xml", "-o", "out")


def test_missing_package(scene, monkeypatch):
    """The remedy is named before anything is rendered."""
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert "needs the package matplotlib, which is not installed: pip install 'phong-bsdf[report]'" in fails(
        "a.xml", "-o", "out"
    )


def test_interrupted_writing_leaves_no_page(scene, monkeypatch):
    """The page is written last and whole: where something fails before, there is none."""

    def fail(*args, **kwargs):
        raise OSError("no space left")

    monkeypatch.setattr("phong_bsdf.report.tables.write_json", fail)
    result = command("a.xml", "-o", "out")
    assert result.exit_code == 2 and "no space left" in result.stderr
    assert not Path("out/index.html").exists() and not list(Path("out").glob(".*"))


def test_equal_surfaces_keep_their_ids(scene):
    """Mitsuba would make one of them; each can be swapped alone."""
    twin = '<bsdf type="phong" id="{}"><float name="p" value="7"/></bsdf>'
    path = scene(
        f'<bsdf type="blendbsdf"><float name="weight" value="0.5"/>{twin.format("a")}{twin.format("b")}</bsdf>'
    )
    kept = compare(path, "--size", "4x3", "--bsdf", "b=diffuse")
    assert [s["swapped"] for s in kept["rows"]] == [0, 1]
