"""Bundles: the same scene elsewhere, and nothing that was not meant to go there."""

import os
import re
from dataclasses import replace

import numpy as np
import pytest

from helpers import SCENES
from phong_bsdf.pictures import images
from phong_bsdf.scene import bundle, rendering
from phong_bsdf.scene.bundle import BundleError

# Nested includes, a search path, a define in a file name, a texture beside the scene, an absolute mesh, dollars.
MAIN = """\
<!-- a comment -- with dashes -->
<scene version="3.0.0">
    <default name="tile" value="tiles"/>
    <default name="tile_scale" value="3"/>
    <path value="parts"/>
    <integrator type="whitted"/>
    <include filename="floor.xml"/>
    <sensor type="perspective">
        <film type="hdrfilm"><integer name="width" value="16"/><integer name="height" value="12"/>
            <rfilter type="box"/></film>
        <transform name="to_world"><lookat origin="0, 2, 5" target="0, 0, 0" up="0, 1, 0"/></transform></sensor>
    <emitter type="point"><point name="position" x="1" y="4" z="3"/></emitter>
    <shape type="obj" id="the \\$1"><string name="filename" value="{mesh}"/><bsdf type="phong"/></shape>
</scene>
"""
FLOOR = """\
<scene version="3.0.0">
    <default name="tile" value="never used"/>
    <include filename="deeper/paint.xml"/>
    <shape type="rectangle">
        <transform name="to_world"><rotate x="1" angle="-90"/><scale value="$tile_scale"/></transform>
        <ref id="paint"/></shape>
</scene>
"""
PAINT = """\
<scene version="3.0.0">
    <bsdf type="phong" id="paint"><texture type="bitmap" name="kd"><string name="filename" value="images/$tile.png"/>
        </texture></bsdf>
</scene>
"""


@pytest.fixture
def scene(tmp_path):
    """The scene above, in a folder with a space."""
    folder = tmp_path / "a scene"
    for name, text in {"parts/floor.xml": FLOOR, "parts/deeper/paint.xml": PAINT}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    mesh = folder / "meshes/torus.obj"
    mesh.parent.mkdir()
    mesh.write_bytes((SCENES / "course/models/torus.obj").read_bytes())
    (folder / "images").mkdir()
    for name, value in (("tiles", 0.2), ("other", 0.7)):
        images.write(folder / f"images/{name}.png", np.full((4, 4, 3), value, np.float32))
    (folder / "main.xml").write_text(MAIN.format(mesh=mesh))
    return folder / "main.xml"


def picture(path, **defines):
    return rendering.render(rendering.load(path, defines), spp=1).image


def test_same_picture(scene, tmp_path):
    """What is unpacked elsewhere renders to the last bit, with nothing left of where it came from."""
    expected = picture(scene)
    packed = bundle.pack(scene)
    assert len(packed.texts) == 3 and len(packed.files) == 2
    scene.parent.rename(tmp_path / "gone")
    assert np.array_equal(picture(bundle.unpack(packed, tmp_path / "cache")), expected)
    assert not any(str(tmp_path).encode() in text for text in packed.texts.values())


@pytest.mark.parametrize("name", ["textured", "scene-6", "scene-3"])
def test_course_scenes(name, tmp_path):
    """Scenes with meshes, textures and defines of numbers."""
    path = SCENES / f"course/{name}.xml"
    small = {"width": "16", "height": "12"}
    unpacked = bundle.unpack(bundle.pack(path, small), tmp_path)
    assert np.array_equal(picture(unpacked), picture(path, **small))


def test_defines_are_put_in(scene, tmp_path):
    """In file names and numbers; long names before short ones that they begin with."""
    defines = {"tile": "other", "tile_scale": "1"}
    packed = bundle.pack(scene, defines)
    assert packed.main != bundle.pack(scene).main
    assert np.array_equal(picture(bundle.unpack(packed, tmp_path / "cache")), picture(scene, **defines))


def test_hash_is_of_the_content(scene):
    """The same scene has the same name, wherever it lies and whatever its comments say; another mesh gives another."""
    before = bundle.pack(scene)
    moved = scene.parent.rename(scene.parent.with_name("moved")) / "main.xml"
    text = moved.read_text().replace("a scene/meshes", "moved/meshes")
    moved.write_text(text.replace("a comment", "another comment"))
    assert bundle.pack(moved) == replace(before, sources=bundle.pack(moved).sources)
    with open(moved.parent / "meshes/torus.obj", "a") as file:
        file.write("# more\n")
    after = bundle.pack(moved)
    assert after.main != before.main and len(set(after.files) & set(before.files)) == 1


def test_messages_name_the_users_files(scene, tmp_path):
    """A mistake in an include is told with its own name and line, wherever it is found."""
    paint = scene.parent / "parts/deeper/paint.xml"
    paint.write_text(PAINT.replace("<texture", '<float name="p" value="-1"/>\n<texture'))
    packed = bundle.pack(scene)
    with pytest.raises(rendering.SceneError) as here:
        rendering.load(scene)
    with pytest.raises(rendering.SceneError) as there:
        rendering.load(bundle.unpack(packed, tmp_path / "cache"))
    assert packed.named(str(there.value), tmp_path / "cache") == str(here.value)
    assert "paint.xml, line 2" in str(here.value)


# What is refused ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["../secret.png", "{root}/secret.png", "link.png", "folder/secret.png"])
def test_files_outside_stay(scene, name):
    """By dots, by an absolute path, by a link, by a folder that is one; the remedy is told, and works."""
    root = scene.parent
    secret = root.parent / "secret.png"
    secret.write_bytes((root / "images/tiles.png").read_bytes())
    (root / "link.png").symlink_to(secret)
    (root / "folder").symlink_to(root.parent)
    paint = root / "parts/deeper/paint.xml"
    paint.write_text(PAINT.replace("images/$tile.png", name.format(root=root.parent)))
    with pytest.raises(
        BundleError, match=rf"paint\.xml, line 2: .* lies outside .*--root {re.escape(str(root.parent))}"
    ):
        bundle.pack(scene)
    assert bundle.pack(scene, root=root.parent).main


def test_links_inside_are_followed(scene):
    """They are packed as what they lead to."""
    before = bundle.pack(scene)
    tiles = scene.parent / "images/tiles.png"
    tiles.rename(scene.parent / "real.png")
    tiles.symlink_to(scene.parent / "real.png")
    assert bundle.pack(scene) == before


@pytest.mark.parametrize(
    ("name", "words"),
    [("nothing.png", "there is no file 'nothing.png'"), ("images", "'images' is no file"), ("", "there is no file ''")],
)
def test_missing_files(scene, name, words):
    """Told with file and line before anything travels."""
    (scene.parent / "parts/deeper/paint.xml").write_text(PAINT.replace("images/$tile.png", name))
    with pytest.raises(BundleError, match=rf"paint\.xml, line 2: {words}"):
        bundle.pack(scene)


def test_pipes_are_not_read(scene):
    """A pipe would wait for ever."""
    (scene.parent / "images/tiles.png").unlink()
    os.mkfifo(scene.parent / "images/tiles.png")
    with pytest.raises(BundleError, match="is no file"):
        bundle.pack(scene)


def test_includes_in_a_circle(scene):
    """Refused as by Mitsuba."""
    (scene.parent / "parts/deeper/paint.xml").write_text(
        '<scene version="3.0.0"><include filename="paint.xml"/></scene>'
    )
    with pytest.raises(BundleError, match="more than 15 deep"):
        bundle.pack(scene)


@pytest.mark.parametrize(
    "name",
    ["../../evil", "/tmp/evil", "evil.png", "a" * 64 + ".x/../y", "", "A" * 64, "a" * 64 + "\n", "a" * 64 + ".."],
)
def test_hostile_names(scene, tmp_path, name):
    """No name but a hash is written, and nothing of a bundle that has one."""
    packed = bundle.pack(scene)
    bad = replace(packed, files={**packed.files, name: b"evil"})
    with pytest.raises(BundleError, match="names must be hashes"):
        bundle.unpack(bad, tmp_path / "cache")
    assert not (tmp_path / "cache").exists() and not (tmp_path.parent / "evil").exists()


def test_damaged_content(scene, tmp_path):
    """A byte that changed on the way is noticed; so is a bundle without its scene."""
    packed = bundle.pack(scene)
    name = next(iter(packed.files))
    with pytest.raises(BundleError, match="another hash"):
        bundle.unpack(replace(packed, files={name: b"x" + packed.files[name][1:]}), tmp_path / "cache")
    with pytest.raises(BundleError, match="its own scene"):
        bundle.unpack(replace(packed, texts={}), tmp_path / "cache")


def test_cache_heals(scene, tmp_path):
    """Files of the cache that were cut off, or are links, are written anew; what links led to is not touched."""
    packed, cache = bundle.pack(scene), tmp_path / "cache"
    bundle.unpack(packed, cache)
    cut, linked = (cache / name for name in packed.files)
    cut.write_bytes(b"")
    linked.unlink()
    (tmp_path / "precious").write_bytes(b"mine")
    linked.symlink_to(tmp_path / "precious")
    bundle.unpack(packed, cache)
    assert all((cache / name).read_bytes() == content for name, content in packed.files.items())
    assert (tmp_path / "precious").read_bytes() == b"mine"
