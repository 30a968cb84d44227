"""The hash of a scene: the same wherever the scene lies, another one as soon as its picture may be another."""

import shutil
from pathlib import Path

import mitsuba as mi
import pytest

from helpers import SCENES
from phong_bsdf.scene import fingerprint, rendering

COURSE = SCENES / "course"

SCENE = """<scene version="3.0.0">
    <default name="p" value="30"/>
    <default name="spp" value="4"/>
    <default name="width" value="40"/>
    <integrator type="whitted"/>
    <sensor type="perspective">
        <sampler type="independent"><integer name="sample_count" value="$spp"/></sampler>
        <film type="hdrfilm"><integer name="width" value="$width"/></film>
    </sensor>
    <include filename="light.xml"/>
    <shape type="obj">
        <string name="filename" value="models/torus.obj"/>
        <transform name="to_world"><rotate y="1" angle="30"/><scale value="2"/></transform>
        <bsdf type="phong" id="shiny">
            <texture type="bitmap" name="kd"><string name="filename" value="models/tiles.png"/></texture>
            <float name="ks" value="0.25"/>
            <float name="p" value="$p"/>
        </bsdf>
    </shape>
</scene>
"""
LIGHT = '<scene version="3.0.0"><emitter type="point"><point name="position" x="1" y="2" z="3"/></emitter></scene>'


@pytest.fixture
def scene(tmp_path):
    """A scene with a mesh, an image and an included file."""
    shutil.copytree(COURSE / "models", tmp_path / "a/models")
    (tmp_path / "a/light.xml").write_text(LIGHT)
    path = tmp_path / "a/scene.xml"
    path.write_text(SCENE)
    return path


def hashed(path, **defines):
    return fingerprint.scene_hash(path, rendering.parse(path, {k: str(v) for k, v in defines.items()}, merge=False))


def changed(path, *pairs):
    """The hash after texts in the scene file were replaced."""
    text = path.read_text()
    for old, new in pairs:
        assert text.count(old) == 1
        text = text.replace(old, new)
    path.write_text(text)
    return hashed(path)


def test_place_and_names_of_files_do_not_matter(scene, tmp_path, monkeypatch):
    """Parts are rendered from copies: in another folder, from another folder, with other names of files."""
    before = hashed(scene)
    assert len(before) == 16
    shutil.copytree(scene.parent, tmp_path / "b")
    assert hashed(tmp_path / "b/scene.xml") == before
    monkeypatch.chdir(tmp_path / "b")
    assert hashed(Path("scene.xml")) == before
    shutil.move("models/torus.obj", "0123456789abcdef.obj")
    image = Path("models/tiles.png").resolve()
    assert changed(
        Path("scene.xml"), ("models/torus.obj", "0123456789abcdef.obj"), ("models/tiles.png", str(image))
    ) == before  # fmt: skip


@pytest.mark.parametrize("name", ["models/torus.obj", "models/tiles.png"])
def test_files_matter(scene, name):
    """One byte of a mesh or an image makes another scene."""
    before = hashed(scene)
    with open(scene.parent / name, "ab") as file:
        file.write(b"\n")
    assert hashed(scene) != before


def test_included_files_matter(scene):
    """As if they stood in the scene."""
    before = hashed(scene)
    (scene.parent / "light.xml").write_text(LIGHT.replace('z="3"', 'z="3.0000001"'))
    assert hashed(scene) != before


@pytest.mark.parametrize(
    "pair",
    [
        ('value="0.25"', 'value="0.25000001"'),
        ('angle="30"', 'angle="30.000001"'),
        ('type="phong"', 'type="blinnphong"'),
        ('name="ks"', 'name="kd_"'),
        ('<integrator type="whitted"/>', '<integrator type="path"/>'),
        ('<film type="hdrfilm">', '<film type="hdrfilm"><rfilter type="box"/>'),
        ("</shape>", '</shape><shape type="sphere"/>'),
    ],
    ids=["number", "angle", "plugin", "parameter", "integrator", "filter", "shape"],
)  # fmt: skip
def test_what_the_scene_says_matters(scene, pair):
    """Every parameter to the last digit of its text, every plugin, every object."""
    assert hashed(scene) != changed(scene, pair)


def test_spectra_matter(scene):
    """By their values and their wavelengths."""
    kd = '<texture type="bitmap" name="kd"><string name="filename" value="models/tiles.png"/></texture>'
    found = {changed(scene, (kd, '<spectrum name="kd" value="400:0.1, 700:0.2"/>'))}
    found.add(changed(scene, ("700:0.2", "700:0.3")))
    found.add(changed(scene, ("400:", "410:")))
    assert len(found) == 3


def test_defines_matter_by_their_effect(scene):
    """A `-D` that says what the scene says is no other scene."""
    assert hashed(scene, p=30) == hashed(scene) != hashed(scene, p=31)


def test_samples_and_size_are_said_elsewhere(scene):
    """More samples of the same scene, or a larger picture of it."""
    assert hashed(scene, spp=64, width=80) == hashed(scene)


def test_writing_does_not_matter(scene):
    """Comments, spaces, the order of parameters, ids."""
    before = hashed(scene)
    ks, p = '<float name="ks" value="0.25"/>', '<float name="p" value="$p"/>'
    assert changed(
        scene, (f"{ks}\n            {p}", f"{p}<!-- shiny -->{ks}"), ('id="shiny"', 'id="dull"')
    ) == before  # fmt: skip


def test_variants_do_not_matter(scene):
    """They are told apart by their names."""
    found = set()
    for variant in ("llvm_ad_rgb", "scalar_rgb", "llvm_ad_spectral"):
        mi.set_variant(variant)
        found.add(hashed(scene))
    assert len(found) == 1


def test_named_files(scene):
    """All of them, also those that stand in the scene more than once."""
    state = rendering.parse(scene, merge=False)
    assert sorted(path.name for _, _, path in fingerprint.named_files(scene, state)) == ["tiles.png", "torus.obj"]


def test_versions():
    """Names and numbers of the three."""
    assert fingerprint.versions().startswith("phong_bsdf ") and ", Mitsuba 3." in fingerprint.versions()


def test_digest_is_of_the_content():
    """Not of the order of a dictionary."""
    first, same, other = {"a": 1, "b": 2}, {"b": 2, "a": 1}, {"a": 2, "b": 2}
    assert fingerprint.digest(first) == fingerprint.digest(same) != fingerprint.digest(other)
    assert len(fingerprint.digest("x", 8)) == 8
