"""`phong-bsdf convert`: what it prints and writes, what it refuses, and that the result renders."""

import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from phong_bsdf.cli import main
from phong_bsdf.pictures import images

OLD = """\
<scene version="0.6.0">
    <integrator type="bdpt"/>
    <sensor type="perspective">
        <transform name="toWorld"><lookAt origin="0, 1, 5" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="ldrfilm"><integer name="width" value="40"/><integer name="height" value="30"/></film>
        <sampler type="sobol"><integer name="sampleCount" value="4"/></sampler>
    </sensor>
    <emitter type="point"><point name="position" x="2" y="4" z="4"/><spectrum name="intensity" value="60"/></emitter>
    <shape type="sphere">
        <bsdf type="phong"><srgb name="diffuseReflectance" value="#c04020"/><float name="exponent" value="40"/></bsdf>
    </shape>
    <shape type="sphere"><point name="center" x="0" y="-21" z="0"/><float name="radius" value="20"/>
        <bsdf type="roughdiffuse"/></shape>
</scene>
"""
OBJ = """\
mtllib a.mtl
v -1 0 1
v 1 0 1
v 1 0 -1
v -1 0 -1
v 0 1 0
usemtl stone
f 1 2 5
f 2 3 5
f 3 4 5
f 4 1 5
f 4 3 2 1
"""
MTL = "newmtl stone\nKd 0.7 0.6 0.4\nKs 0.3 0.3 0.3\nNs 30\nillum 2\n"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("old.xml").write_text(OLD)
    Path("a.obj").write_text(OBJ)
    Path("a.mtl").write_text(MTL)
    return tmp_path


def phong_bsdf(*args):
    return CliRunner().invoke(main, list(map(str, args)))


def test_rendering_an_old_scene_names_the_remedy(folder):
    """Whoever renders an old scene as it is hears what Mitsuba stumbles over, and of this command."""
    result = phong_bsdf("render", "old.xml", "-o", "old.png")
    assert (result.exit_code, result.stdout) == (2, "")
    assert re.fullmatch(r"Error: old.xml, line \d+: .*: phong-bsdf convert old.xml -o new.xml\n", result.stderr)


def test_a_scene(folder):
    """Changes, losses, the count of both, and how to render it; then it renders."""
    result = phong_bsdf("convert", "old.xml", "-o", "new.xml")
    assert result.exit_code == 0, result.output
    assert re.search(r"^Said in other words:\n(  old.xml.*\n)+\nNot carried over, or only nearly:\n", result.stdout)
    assert "  old.xml, line 13: 'roughdiffuse': now 'diffuse'" in result.stdout
    assert re.search(r"^new.xml: \d+ changes, 1 loss$", result.stdout, re.M)
    assert result.stdout.endswith("Render it with: phong-bsdf render new.xml -o new.png\n")
    assert phong_bsdf("render", "new.xml", "-o", "new.exr", "-D", "spp=1").exit_code == 0
    image = images.read_exr(Path("new.exr"))
    assert image.shape[:2] == (30, 40) and np.isfinite(image).all() and image.max() > 0.3


@pytest.mark.parametrize("vocabulary", [None, "coefficients", "reflectances"])
def test_a_model(folder, vocabulary):
    """It renders at once: the pyramid fills a good part of the picture, in front of the grey background."""
    options = ["--vocabulary", vocabulary] if vocabulary else []
    result = phong_bsdf("convert", "a.obj", "-o", "a.xml", *options)
    assert result.exit_code == 0, result.output
    assert "a.xml: 0 changes, 0 losses, 1 file in a_files" in result.stdout
    assert ("exponent" if vocabulary == "reflectances" else '"ks"') in Path("a.xml").read_text()
    assert phong_bsdf("render", "a.xml", "-o", "a.exr", "--size", "64x48").exit_code == 0
    image = images.read_exr(Path("a.exr"))
    covered = np.abs(image - 0.2).max(axis=2) > 0.01
    assert 0.1 < covered.mean() < 0.8 and image.max() > 0.4


def test_no_camera(folder):
    """The scene has none, and loads."""
    assert phong_bsdf("convert", "a.obj", "-o", "a.xml", "--camera", "none").exit_code == 0
    assert "<sensor" not in Path("a.xml").read_text()


def test_what_mitsuba_refuses(folder):
    """A mesh that is missing: the scene is written, the reason is told, and the exit code is 1; without a check 0."""
    Path("old.xml").write_text(
        OLD.replace("</scene>", '<shape type="obj"><string name="filename" value="no.obj"/></shape></scene>')
    )
    result = phong_bsdf("convert", "old.xml", "-o", "new.xml")
    assert result.exit_code == 1 and Path("new.xml").exists()
    assert "Mitsuba does not load it yet" in result.stderr and "no.obj" in result.stderr
    assert phong_bsdf("convert", "old.xml", "-o", "new.xml", "--no-check").exit_code == 0


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["no.xml", "-o", "new.xml"], "no.xml: there is no such file"),
        (["old.xml", "-o", "old.xml"], "is the input, which is never overwritten"),
        (["a.mtl", "-o", "new.xml"], "must be a Mitsuba 0.x scene (.xml) or a model (.obj)"),
        (["old.xml", "-o", "new.exr"], "must end in .xml"),
        (["old.xml", "-o", "no/new.xml"], "there is no folder 'no'"),
        (["old.xml", "-o", "new.xml", "--vocabulary", "reflectances"], "are for models"),
        (["a.obj", "-o", "a.xml", "--root", "no"], "the root must be a folder"),
        (["a.obj", "-o", "a.xml", "--vocabulary", "x"], "'x' is not one of"),
    ],
)  # fmt: skip
def test_mistakes(folder, args, message):
    """One sentence, exit code 2, and nothing is written."""
    before = sorted(p.name for p in folder.iterdir())
    result = phong_bsdf("convert", *args)
    assert result.exit_code == 2
    assert message in result.stderr and "Traceback" not in result.output
    assert sorted(p.name for p in folder.iterdir()) == before and Path("old.xml").read_text() == OLD
