"""Geometry of OBJ models, and what of it is an error."""

import re
import sys

import mitsuba as mi
import numpy as np
import pytest

import phong_bsdf  # noqa: F401
from helpers.models import MTL, converting, square
from phong_bsdf.importers import ConversionError, convert_model, meshes, objfile
from phong_bsdf.importers.records import Journal

# Geometry ---------------------------------------------------------------------------------------------------


@pytest.fixture
def convert(tmp_path):
    """convert(obj, mtl) -> the conversion, the text of the new scene, a function that renders it."""
    return converting(tmp_path)


def read(folder, text):
    path = folder / "g.obj"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    journal = Journal()
    return objfile.read(path, journal), journal


BOX = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 -1\nv 0 1 -1\n"


@pytest.mark.parametrize(
    "text",
    [
        BOX + "f 1 2 3 4\n",
        BOX + "f -6 -5 -4 -3\n",
        BOX.replace("\n", "\r\n") + "f 1 2 3 4\r\n",
        BOX.replace("\n", "\r") + "f 1 2 3 4\r",
        BOX + "f 1 2 \\\n 3 \\\n 4\n",
        BOX + "\tf\t1 2 3 4   # a square\n",
        "# f 1 2 3\n" + BOX + "g a b\no c\nf 1 2 3 4",
        BOX.encode() + b"# \xff\xfe\nf 1 2 3 4\n",
    ],
    ids=["plain", "negative", "crlf", "cr", "continued", "comment", "groups", "bytes"],
)
def test_ways_to_write_a_square(tmp_path, text):
    """All of them are the same two triangles, in the order of the corners."""
    triangles, _ = read(tmp_path, text)
    assert sorted(map(sorted, triangles.v.tolist())) in ([[0, 1, 2], [0, 2, 3]], [[0, 1, 3], [1, 2, 3]])
    a, b, c = triangles.positions[triangles.v].transpose(1, 0, 2)
    assert np.cross(b - a, c - a) == pytest.approx(np.array([[0, 0, 1]] * 2))


def test_polygons(tmp_path):
    """A star of ten corners, not convex: triangles of the same area."""
    angle, radius = np.arange(10) * np.pi / 5, np.tile([1, 0.4], 5)
    corners = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    x, y = corners.T
    area = 0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))
    text = "".join(f"v {a} {b} 0\n" for a, b in corners) + "f " + " ".join(map(str, range(1, 11)))
    triangles, _ = read(tmp_path, text)
    a, b, c = triangles.positions[triangles.v].transpose(1, 0, 2)
    each = np.cross(b - a, c - a)[:, 2] / 2
    assert len(each) == 8 and each.min() > 0 and each.sum() == pytest.approx(area, rel=1e-5)


def test_materials_and_smoothing(tmp_path):
    """One mesh for each material, whatever the groups; names keep their spaces."""
    text = BOX + "usemtl red paint\nf 1 2 3\nusemtl b#1\ns 3\nf 1 3 4\ng x\ns off\nusemtl red paint\nf 1 4 6 5\n"
    triangles, journal = read(tmp_path, text)
    assert triangles.materials == [("red paint", 7), ("b#1", 9)]
    assert triangles.material.tolist() == [0, 1, 0, 0] and triangles.smoothing.tolist() == [0, 3, 0, 0]
    assert [(index, len(mesh.faces)) for index, mesh in meshes.split(triangles)] == [(0, 3), (1, 1)]
    assert journal.records() == ()


def test_lines_and_points_are_told(tmp_path):
    """Once for each kind, with the first line."""
    _, journal = read(tmp_path, BOX + "f 1 2 3\nl 1 2\nl 2 3\np 1\nhello world\n")
    assert [(r.line, r.what.split()[0]) for r in journal.records()] == [(8, "'l'"), (10, "'p'"), (11, "'hello'")]


def normals_of(text, folder):
    """Normals at each corner of each triangle."""
    ((_, mesh),) = meshes.split(read(folder, text)[0])
    if mesh.normals is None:
        a, b, c = mesh.positions[mesh.faces].transpose(1, 0, 2)
        n = np.cross(b - a, c - a)
        return np.repeat((n / np.linalg.norm(n, axis=1, keepdims=True))[:, None], 3, 1), mesh
    return mesh.normals[mesh.faces], mesh


ROOF = BOX + "{}f 1 2 3 4\nf 5 1 4 6\n"


def test_flat_without_smoothing(tmp_path):
    """No normals and no smoothing group: each face its own normal, and the mesh says so without storing them."""
    normals, mesh = normals_of(ROOF.format(""), tmp_path)
    assert mesh.normals is None and len(mesh.positions) == 6
    assert sorted({tuple(np.round(n, 6)) for n in normals.reshape(-1, 3)}) == [(-1, 0, 0), (0, 0, 1)]


def test_smooth_in_a_group(tmp_path):
    """In a smoothing group corners that share a vertex share a normal: between those of the two faces."""
    _, mesh = normals_of(ROOF.format("s 1\n"), tmp_path)
    edge = mesh.normals[np.abs(mesh.positions[:, [0, 2]]).max(axis=1) == 0]
    assert edge == pytest.approx(np.array([[-1, 0, 1]] * 2) / np.sqrt(2), abs=1e-6)
    assert len(mesh.positions) == 6


def test_groups_do_not_smooth_into_each_other(tmp_path):
    """Two groups: a sharp edge."""
    text = ROOF.format("s 1\n").replace("f 5", "s 2\nf 5")
    normals, mesh = normals_of(text, tmp_path)
    assert len(mesh.positions) == 8
    assert sorted({tuple(np.round(n, 6)) for n in normals.reshape(-1, 3)}) == [(-1, 0, 0), (0, 0, 1)]


def test_given_normals_stay(tmp_path):
    """A corner with a normal keeps it, also in a smoothing group; one without gets its face's."""
    text = BOX + "vn 0 0.6 0.8\ns 1\nf 1//1 2//1 3\n"
    normals, _ = normals_of(text, tmp_path)
    assert normals.tolist() == [[pytest.approx([0, 0.6, 0.8]), pytest.approx([0, 0.6, 0.8]), pytest.approx([0, 0, 1])]]


def test_several_libraries(tmp_path):
    """Several lines, several names on a line, and a name with spaces; the first definition counts."""
    (tmp_path / "one.mtl").write_text("newmtl a\nKd 1 0 0\n")
    (tmp_path / "two words.mtl").write_text("newmtl a\nKd 0 1 0\nnewmtl b\nKd 0 0 1\n")
    (tmp_path / "three.mtl").write_text("newmtl c\nKd 1 1 0\n")
    obj = "mtllib one.mtl three.mtl\nmtllib two words.mtl\nmtllib no.mtl\n" + "".join(square(m) for m in "abcd")
    (tmp_path / "a.obj").write_text(obj)
    result = convert_model(tmp_path / "a.obj", tmp_path / "new.xml")
    found = re.findall(r'name="kd" value="([^"]*)"', result.output.read_text())
    assert found == ["1, 0, 0", "0, 0, 1", "1, 1, 0", "0.8, 0.8, 0.8"]
    assert [r.what for r in result.losses] == ["material library 'no.mtl'", "material 'd'"]


def test_names_that_files_and_paths_cannot_have(convert):
    """Materials whose names differ in case, or hold slashes and dollars, have files of their own and load."""
    names = ["Wall", "wall", "a/b", "../x", "$y", "", "ä ö"]
    result, _, render = convert("".join(square(n) for n in names), "".join(f"newmtl {n}\nKd 1 1 1\n" for n in names))
    assert len({str(path).lower() for path in result.files}) == len(names) + 1
    assert {path.parent.name for path in result.files[1:]} == {"new_files"}
    assert np.isfinite(render()).all()


@pytest.mark.parametrize("stretch", [(1, 1, 1), (100, 1, 1), (1, 100, 1), (1, 1, 100), (1e-3, 0, 1e-3), (0, 0, 0)])
@pytest.mark.parametrize("size", [(64, 48), (64, 36), (36, 64)])
def test_the_camera_sees_it_all(tmp_path, stretch, size):
    """Every vertex is in the picture and beyond the near clip, whatever the shape of either, up to 16:9."""
    points = np.random.default_rng(5).normal(size=(60, 3)) * stretch + [3, -2, 7]
    faces = "".join(f"f {i} {i + 1} {i + 2}\n" for i in range(1, 58))
    (tmp_path / "a.obj").write_text("".join("v {} {} {}\n".format(*p) for p in points) + faces)
    result = convert_model(tmp_path / "a.obj", tmp_path / "new.xml")
    scene = mi.load_file(str(result.output), width=str(size[0]), height=str(size[1]))
    params = mi.traverse(scene.sensors()[0])
    local = np.linalg.inv(np.array(params["to_world"].matrix).reshape(4, 4)) @ np.c_[points[:59], np.ones(59)].T
    slope = np.tan(np.radians(float(params["x_fov"][0]) / 2))
    assert np.all(local[2] > params["near_clip"]) and np.all(local[2] < params["far_clip"])
    assert np.all(np.abs(local[0] / local[2]) < slope) and np.all(
        np.abs(local[1] / local[2]) < slope * size[1] / size[0]
    )


def test_no_camera(convert):
    """`camera="none"`: the scene has none."""
    assert "<sensor" not in convert(square(), MTL, camera="none")[1]


def test_progress(tmp_path):
    """It is reported from 0 to 1, and never goes back."""
    (tmp_path / "a.obj").write_text("".join(square(f"m{i}") for i in range(3)))
    heard = []
    convert_model(tmp_path / "a.obj", tmp_path / "new.xml", on_progress=lambda what, share: heard.append(share))
    assert heard[0] == 0 and heard[-1] == 1 and heard == sorted(heard) and len(heard) >= 5


# Errors -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (BOX + "f 1 2 9\n", "line 7: a face names a vertex, normal or texture coordinate that does not exist"),
        (BOX + "f 1/1 2/1 3/1\n", "line 7: a face names"),
        (BOX + "f 0 1 2\n", "line 7: this face cannot be read"),
        (BOX + "f -7 1 2\n", "line 7: this face cannot be read"),
        (BOX + "\nf 1 2 x\n", "line 8: 'f 1 2 x' should be numbers"),
        ("v 1 2 nan\nf 1 1 1\n", "line 1: 'v 1 2 nan' should be numbers"),
        ("v 1 2 1e999\nf 1 1 1\n", "not finite, or beyond 1e18"),
        (BOX + "f 1 2 4294967299\n", "line 7: 'f 1 2 4294967299' should be numbers"),
        (BOX, "there are no faces"),
        ("", "there are no faces"),
    ],
)  # fmt: skip
def test_broken_models(tmp_path, text, message):
    """One sentence with the line, and nothing is written."""
    (tmp_path / "a.obj").write_text(text)
    with pytest.raises(ConversionError, match=re.escape(message)):
        convert_model(tmp_path / "a.obj", tmp_path / "new.xml")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.obj"]


def test_nothing_is_left_of_a_conversion_that_fails(tmp_path, monkeypatch):
    """The second mesh cannot be written: that of the first is taken back."""
    write, written = meshes.write_ply, []

    def fail_second(path, mesh):
        if written:
            raise OSError("full")
        written.append(path)
        write(path, mesh)

    monkeypatch.setattr(meshes, "write_ply", fail_second)
    (tmp_path / "m.mtl").write_text("newmtl a\nnewmtl b\n")
    (tmp_path / "a.obj").write_text("mtllib m.mtl\n" + square("a") + square("b"))
    with pytest.raises(OSError, match="full"):
        convert_model(tmp_path / "a.obj", tmp_path / "new.xml")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.obj", "m.mtl"]


@pytest.mark.parametrize("file", ["C:\\Users\\me\\a b.png", "/home/me/a b.png", "..\\maps\\a b.png"])
def test_paths_of_another_machine(convert, tmp_path, file):
    """An image of that name beside the materials is meant."""
    mi.Bitmap(np.zeros((2, 2, 3), np.uint8)).write(str(tmp_path / "a b.png"))
    result, text, _ = convert(square(), f"newmtl m\nmap_Kd {file}\n")
    assert result.losses == ()
    assert '<string name="filename" value="a b.png"/>' in text


def test_triangles_without_area_do_not_bend_normals(convert):
    """Exporters close spheres by quads, two corners of which are the pole."""
    result, _, _ = convert("v 0 0 0\nv 0 0 0\nv 0 0 1\nv 1 0 0\ns 1\nf 1 2 3 4\n")
    mesh = mi.load_dict({"type": "ply", "filename": str(result.files[1])})
    normals = np.array(mi.traverse(mesh)["vertex_normals"]).reshape(-1, 3)
    # The corner that only the triangle without area has keeps a normal, which no pixel shows.
    assert (np.abs(normals - [0, 1, 0]).max(axis=1) < 1e-6).sum() >= 3


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_byte_order_marks(tmp_path, encoding):
    """Some editors put one before the first vertex, and before the first `newmtl`."""
    (tmp_path / "a.obj").write_text(square("red") + "mtllib a.mtl\n", encoding=encoding)
    (tmp_path / "a.mtl").write_text("newmtl red\nKd 1 0 0\n", encoding=encoding)
    result = convert_model(tmp_path / "a.obj", tmp_path / "new.xml")
    assert result.losses == ()
    assert '<rgb name="kd" value="1, 0, 0"/>' in result.output.read_text()


def test_tabs_before_names_with_spaces(convert):
    """A keyword ends at any blank."""
    obj = "mtllib\tb c.mtl\n" + square().replace("usemtl ", "usemtl\t a ")
    result, text, _ = convert(obj, "newmtl a m\nKd 1 0 0\n")
    assert [loss.what for loss in result.losses] == ["material library 'b'", "material library 'c.mtl'"]
    assert '<rgb name="kd" value="1, 0, 0"/>' in text


def test_corners_without_the_rest(convert):
    """Slashes with nothing behind them."""
    for face in ("f 1/ 2/ 3/ 4/", "f 1// 2// 3// 4//"):
        result, _, _ = convert(re.sub("f .*", face, square(uv=False)))
        assert len(mi.load_dict({"type": "ply", "filename": str(result.files[1])}).faces_buffer()) == 6


@pytest.mark.parametrize(("option", "message"), [({"vocabulary": "x"}, "vocabulary"), ({"camera": "x"}, "camera")])
def test_bad_options(tmp_path, option, message):
    """Unknown choices are errors that list the known ones."""
    (tmp_path / "a.obj").write_text(square())
    with pytest.raises(ConversionError, match=f"{message} must be one of"):
        convert_model(tmp_path / "a.obj", tmp_path / "new.xml", **option)


def test_without_tinyobjloader(tmp_path, monkeypatch):
    """Where the extra is not installed, the error says how to install it."""
    monkeypatch.setitem(sys.modules, "tinyobjloader", None)
    (tmp_path / "a.obj").write_text(square())
    with pytest.raises(ConversionError, match=r"pip install 'phong-bsdf\[import\]'"):
        convert_model(tmp_path / "a.obj", tmp_path / "new.xml")


def test_a_failed_conversion_keeps_the_earlier_one(tmp_path, monkeypatch):
    """Files of an earlier conversion to the same name are replaced together, or not at all."""
    model = "v 0 0 0\nv 1 0 0\nv 0 1 {}\nusemtl a\nf 1 2 3\nusemtl b\nf 3 2 1\n"
    (tmp_path / "a.obj").write_text(model.format(0))
    convert_model(tmp_path / "a.obj", tmp_path / "new.xml")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert len(before) == 4
    (tmp_path / "a.obj").write_text(model.format(7))
    write, written = meshes.write_ply, []

    def failing(path, mesh):
        written.append(path)
        write(path, mesh) if len(written) == 1 else (_ for _ in ()).throw(OSError("the disk is full"))

    monkeypatch.setattr(meshes, "write_ply", failing)
    with pytest.raises(OSError, match="the disk is full"):
        convert_model(tmp_path / "a.obj", tmp_path / "new.xml")
    del before[tmp_path / "a.obj"]
    assert before == {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file() and p.name != "a.obj"}
