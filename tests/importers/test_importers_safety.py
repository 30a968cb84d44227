"""Input from elsewhere: nothing is read that should not be, nothing hangs, every refusal is one sentence."""

import os
import re
import time

import mitsuba as mi
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import phong_bsdf
from phong_bsdf.importers import ConversionError, convert_model, convert_scene, mtl, objfile
from phong_bsdf.importers.records import Journal
from phong_bsdf.importers.xmlfile import DEEPEST

# The folder of a test is used by all its examples; each overwrites what the last one wrote.
FUZZ = settings(
    max_examples=150,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


def refused(folder, text, match, **options):
    """The scene is refused in one line, and nothing is written."""
    old = folder / "old.xml"
    old.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ConversionError, match=match) as error:
        convert_scene(old, folder / "new.xml", **options)
    assert "\n" not in str(error.value)
    assert not (folder / "new.xml").exists()


# XML -----------------------------------------------------------------------------------------------------

BOMB = '<!DOCTYPE s [<!ENTITY a "aaaaaaaaaa">' + "".join(
    f'<!ENTITY {chr(98 + i)} "{f"&{chr(97 + i)};" * 10}">' for i in range(12)
)


@pytest.mark.parametrize(
    "text",
    [
        BOMB + ']><scene version="0.6.0"><string name="x" value="&m;"/></scene>',
        '<!DOCTYPE s [<!ENTITY x SYSTEM "file:///etc/passwd">]><scene version="0.6.0"><a>&x;</a></scene>',
        '<!DOCTYPE s [<!ENTITY % x SYSTEM "http://localhost/x.dtd"> %x;]><scene version="0.6.0"/>',
        '<!DOCTYPE s SYSTEM "s.dtd"><scene version="0.6.0"/>',
    ],
    ids=["bomb", "file", "parameter", "dtd"],
)
def test_document_types_are_refused(tmp_path, text):
    """Entity bombs, external entities and outside definitions all need one."""
    start = time.perf_counter()
    refused(tmp_path, text, "a document type .* is refused")
    assert time.perf_counter() - start < 5


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("", "line 1: no XML: no element found"),
        ("<scene", "line 1: no XML"),
        ('<scene version="0.6.0">\n<a></b></scene>', "line 2: no XML: mismatched tag"),
        ('<scene version="0.6.0"><a>&x;</a></scene>', "undefined entity"),
        ('<?xml version="1.0" encoding="no-such"?><scene/>', "no XML"),
        (b"\x00\xff\xfe\x01", "no XML"),
        ('<other version="0.6.0"/>', "root element should be <scene>, not <other>"),
        ('<scene version="six"/>', "'six' is no version"),
        ('<scene version="3.0.0"/>', "a scene of Mitsuba 3 already"),
        ('<scene version="0.6.0">' + "<shape>" * DEEPEST + "</shape>" * DEEPEST + "</scene>", "nested more than"),
        ('<scene version="0.6.0"><ref id="x" name="a"/><bsdf type="coating"><ref id="x"/></bsdf>'
         '</scene>', "no object with the id 'x'"),
        ('<scene version="0.6.0"><bsdf type="coating"/></scene>', "needs one BSDF inside, has 0"),
        ('<scene version="0.6.0"><bsdf type="mixturebsdf"><string name="weights" value="1"/></bsdf>'
         '</scene>', "one weight"),
        ('<scene version="0.6.0"><bsdf type="blinn_microfacet"><float name="exponent" value="x"/></bsdf>'
         '</scene>', "'x' should be numbers"),
        ('<scene version="0.6.0"><shape type="sphere"><srgb name="a" value="#12"/></shape></scene>', "six hexadecimal"),
    ],
)  # fmt: skip
def test_broken_scenes(tmp_path, text, match):
    """One sentence that names the file, the line and what is wrong."""
    refused(tmp_path, text, match)


# Paths ---------------------------------------------------------------------------------------------------


def naming(file):
    return f'<scene version="0.6.0"><shape type="obj"><string name="filename" value="{file}"/></shape></scene>'


@pytest.mark.parametrize(
    "file", ["/etc/passwd", "C:/x.obj", "C:\\x.obj", "\\\\host\\share\\x", "file:///etc/passwd", "http://localhost/x"]
)
def test_absolute_paths_are_refused(tmp_path, file):
    """And addresses."""
    refused(tmp_path, naming(file), "absolute path or an address")


@pytest.mark.parametrize("file", ["../x.obj", "a/../../x.obj", "..\\x.obj", "link/x.obj"])
def test_ways_out_are_refused(tmp_path, file):
    """Neither with dots nor through a link. The error says which option would allow it."""
    (tmp_path / "in").mkdir(), (tmp_path / "outside").mkdir()
    os.symlink(tmp_path / "outside", tmp_path / "in/link")
    refused(tmp_path / "in", naming(file), f"leads out of .* --root {tmp_path}")
    convert_scene(tmp_path / "in/old.xml", tmp_path / "in/new.xml", root=tmp_path)


def test_includes_do_not_leave_nor_loop(tmp_path):
    """An include of itself, directly or not, of a file elsewhere, or of none."""
    for file, match in (
        ("old.xml", "includes itself"),
        ("b.xml", "includes itself"),
        ("../b.xml", "leads out"),
        ("c.xml", "there is no file"),
    ):
        (tmp_path / "b.xml").write_text('<scene version="0.6.0"><include filename="b.xml"/></scene>')
        refused(tmp_path, f'<scene version="0.6.0"><include filename="{file}"/></scene>', match)


def test_includes_that_double_each_other(tmp_path):
    """Ten files, each of which includes the next one ten times, are refused before they fill the memory."""
    for i in range(10):
        inside = f'<include filename="{i + 1}.xml"/>' * 10 if i < 9 else ""
        (tmp_path / f"{i}.xml").write_text(f'<scene version="0.6.0">{inside}</scene>')
    start = time.perf_counter()
    refused(tmp_path, '<scene version="0.6.0"><include filename="0.xml"/></scene>', "more than 1000 files")
    assert time.perf_counter() - start < 60


@pytest.mark.parametrize("text", ["mtllib ../x.mtl\n", "mtllib /etc/passwd\n", "mtllib a.mtl\nusemtl m\n"])
def test_models_do_not_leave_their_folder(tmp_path, text):
    """Neither for materials nor for textures: those count as missing, since exporters write absolute paths."""
    folder = tmp_path / "in"
    folder.mkdir()
    mi.Bitmap(np.zeros((2, 2, 3), np.uint8)).write(str(tmp_path / "x.png"))
    (tmp_path / "x.mtl").write_text("newmtl m\nKd 1 0 0\n")
    (folder / "a.mtl").write_text("newmtl m\nmap_Kd ../x.png\nmap_Ks C:\\x.png\n")
    (folder / "a.obj").write_text(text + "v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n")
    result = convert_model(folder / "a.obj", folder / "new.xml")
    assert re.search(r"leads out of|absolute path", result.losses[0].why)
    assert not re.search(r"x\.png</|bitmap|1, 0, 0", re.sub("<!--.*?-->", "", result.output.read_text(), flags=re.S))


def test_files_that_the_input_names_are_not_overwritten(tmp_path):
    """An included scene is input, too."""
    (tmp_path / "old.xml").write_text('<scene version="0.6.0"><include filename="new.xml"/></scene>')
    (tmp_path / "new.xml").write_text('<scene version="0.6.0"><bsdf type="diffuse"/></scene>')
    before = (tmp_path / "new.xml").read_bytes()
    with pytest.raises(ConversionError, match="choose another name"):
        convert_scene(tmp_path / "old.xml", tmp_path / "new.xml")
    assert (tmp_path / "new.xml").read_bytes() == before


def test_references_that_double_each_other(tmp_path):
    """Each material holds two copies of the one before: refused before they fill the memory."""
    double = '<bsdf type="mixturebsdf" id="b{}"><string name="weights" value="0.5 0.5"/>{}</bsdf>'
    inside = '<bsdf type="roughcoating"><ref id="b{}"/></bsdf>' * 2
    text = "".join(double.format(i + 1, inside.format(i, i)) for i in range(40))
    refused(tmp_path, f'<scene version="0.6.0"><bsdf type="plastic" id="b0"/>{text}</scene>', "grow without bound")


@pytest.mark.parametrize("output", ["old.xml", "./old.xml", "link.xml", "new.txt", "no/new.xml", "."])
def test_outputs_that_are_refused(tmp_path, monkeypatch, output):
    """The input under any name, no XML file, no folder for it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "old.xml").write_text('<scene version="0.6.0"/>')
    os.symlink("old.xml", "link.xml")
    with pytest.raises(ConversionError):
        convert_scene("old.xml", tmp_path / output)
    assert (tmp_path / "old.xml").read_text() == '<scene version="0.6.0"/>'


def test_no_file_of_the_input_is_overwritten(tmp_path):
    """Also where the folder for new files is the folder of old ones, and a new name would be that of an old file."""
    folder = tmp_path / "new_files"
    folder.mkdir()
    (folder / "m.mtl").write_text("newmtl a\nKd 0.5 0.5 0.5\nmap_Kd b.exr\nnewmtl z\nmap_Ks b-kd-0.5.exr\n")
    for name in ("b", "b-kd-0.5"):
        phong_bsdf.pictures.images.write(folder / f"{name}.exr", np.ones((2, 2, 3), np.float32))
    before = {path: path.read_bytes() for path in folder.iterdir()}
    faces = "".join(f"usemtl {name}\nf 1/1 2/1 3/1\n" for name in "az")
    (tmp_path / "a.obj").write_text(f"mtllib new_files/m.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nvt 0 0\n{faces}")
    for _ in range(2):
        result = convert_model(tmp_path / "a.obj", tmp_path / "new.xml")
        assert folder / "b-kd-0.5-2.exr" in result.files
        assert all(path.read_bytes() == content for path, content in before.items())


def test_no_file_of_a_scene_is_overwritten(tmp_path):
    """The same for the images of a scene, of which the first is copied under the name of the second."""
    folder = tmp_path / "new_files"
    folder.mkdir()
    phong_bsdf.pictures.images.write(folder / "b.exr", np.ones((2, 2, 3), np.float32))
    phong_bsdf.pictures.images.write(folder / "b-scaled.exr", np.ones((2, 2, 3), np.float32))
    before = (folder / "b-scaled.exr").read_bytes()
    bitmap = '<texture type="bitmap" name="reflectance"><string name="filename" value="new_files/{}.exr"/></texture>'
    shape = '<shape type="sphere"><bsdf type="diffuse">{}</bsdf></shape>'
    scaled = f'<texture type="scale" name="reflectance"><float name="scale" value="0.5"/>{bitmap.format("b")}</texture>'
    # Inner and later elements are rewritten first.
    shapes = shape.format(bitmap.format("b-scaled")) + shape.format(scaled)
    (tmp_path / "old.xml").write_text(f'<scene version="0.6.0">{shapes}</scene>')
    convert_scene(tmp_path / "old.xml", tmp_path / "new.xml")
    assert (folder / "b-scaled.exr").read_bytes() == before and (folder / "b-scaled-2.exr").exists()


# Fuzzing -------------------------------------------------------------------------------------------------

WORDS = st.sampled_from(
    ["v", "vt", "vn", "f", "usemtl", "mtllib", "s", "g", "o", "l", "#", "\\", "1", "2", "3", "-1", "0", "1/1", "2//1",
     "3/1/1", "1/", "/", "//", "off", "nan", "inf", "1e999", "-0.5", "99999999999", "a b",
     "\t", "\u00e4", "\0", "\"", "$x", "&lt;"]
)  # fmt: skip
LINES = st.lists(st.lists(WORDS, max_size=7).map(" ".join), max_size=25).map("\n".join)
START = st.sampled_from(["", "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 1\nvt 0 0\nvn 0 0 1\n"])


def only_conversion_errors(run):
    """Any other exception fails the test."""
    try:
        return run()
    except ConversionError as error:
        assert str(error) and "\n" not in str(error)
        return None


@FUZZ
@given(START, LINES, st.sampled_from(["\n", "\r\n", "\r"]))
def test_any_obj_file(tmp_path, start, lines, newline):
    """It is read or refused; what is read has indices of vertices that exist."""
    path = tmp_path / "a.obj"
    path.write_bytes((start + lines).replace("\n", newline).encode())
    triangles = only_conversion_errors(lambda: objfile.read(path, Journal()))
    if triangles is not None:
        for index, array in (
            (triangles.v, triangles.positions),
            (triangles.vn, triangles.normals),
            (triangles.vt, triangles.texcoords),
        ):
            assert (
                index.shape == triangles.v.shape and index.max(initial=-1) < len(array) and index.min(initial=0) >= -1
            )
        assert triangles.v.min(initial=0) >= 0


@FUZZ
@given(st.binary(max_size=400))
def test_any_bytes(tmp_path, data):
    """Of any file: read or refused, as a model, as materials, as a scene."""
    for name, run in (
        ("a.obj", lambda path: objfile.read(path, Journal())),
        ("a.mtl", lambda path: mtl.read(path, Journal())),
        ("a.xml", lambda path: convert_scene(path, tmp_path / "new.xml")),
    ):
        path = tmp_path / name
        path.write_bytes(data)
        only_conversion_errors(lambda path=path, run=run: run(path))


NUMBER = st.floats(-2, 300).map(lambda x: f"{x:.3g}") | st.sampled_from(["nan", "inf", "-1", "0", "1", "x", "1e40", ""])
COLOR = st.lists(NUMBER, max_size=4).map(" ".join)
NAME = st.sampled_from(["a.png", "no.png", "a b.png", "../x.png", "/x.png", "a.mtl", ""])
OPTION = st.sampled_from(["-s", "-o", "-t", "-mm", "-bm", "-clamp", "-imfchan", "-blendu", "-cc"])
OPTIONS = st.lists(st.tuples(OPTION, NUMBER).map(" ".join), max_size=3).map(" ".join)
STATEMENT = st.one_of(
    st.tuples(st.sampled_from(["Kd", "Ks", "Ka", "Ke", "Tf"]), COLOR),
    st.tuples(st.sampled_from(["Ns", "Ni", "d", "Tr", "illum", "Pr"]), NUMBER),
    st.tuples(st.just("illum"), st.integers(-1, 11).map(str)),
    st.tuples(st.sampled_from(["map_Kd", "map_Ks", "map_Ns", "map_d", "bump", "norm", "refl"]),
              st.tuples(OPTIONS, NAME).map(" ".join)),
    st.tuples(st.sampled_from(["newmtl", "#", "foo", "d -halo"]), NUMBER),
).map(" ".join)  # fmt: skip


@pytest.mark.slow
@FUZZ
@given(st.lists(STATEMENT, max_size=12).map("\n".join), st.sampled_from(["coefficients", "reflectances"]))
def test_any_mtl_file(tmp_path, statements, vocabulary):
    """Any material becomes a BSDF that Mitsuba loads."""
    phong_bsdf.pictures.images.write(tmp_path / "a.png", np.full((2, 2, 3), 0.5, "float32"))
    (tmp_path / "m.mtl").write_text(f"newmtl m\n{statements}\n")
    (tmp_path / "a.obj").write_text("mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nusemtl m\nf 1 2 3\n")
    result = only_conversion_errors(
        lambda: convert_model(tmp_path / "a.obj", tmp_path / "new.xml", vocabulary=vocabulary)
    )
    if result is not None:
        assert all(record.line > 0 for record in result.records)
        mi.load_file(str(result.output))


TAGS = st.sampled_from(
    [
        "bsdf",
        "shape",
        "texture",
        "emitter",
        "sensor",
        "film",
        "integrator",
        "medium",
        "sampler",
        "luminaire",
        "camera",
        "ref",
    ]
)
TYPES = st.sampled_from(
    [
        "phong",
        "coating",
        "mixturebsdf",
        "blendbsdf",
        "scale",
        "bitmap",
        "sphere",
        "sky",
        "ldrfilm",
        "adaptive",
        "ward",
        "homogeneous",
        "blinn",
        "bump",
        "microfacet",
        "roughplastic",
        "normalmap",
        "field",
        "mask",
        "gridtexture",
    ]
)
NAMES = st.sampled_from(
    [
        "reflectance",
        "weights",
        "scale",
        "sigmaS",
        "sigmaA",
        "exponent",
        "alpha",
        "gamma",
        "distribution",
        "intensity",
        "filename",
        "uscale",
        "toWorld",
        "diffuseAmount",
        "opacity",
        "a",
    ]
)
VALUE = st.sampled_from(
    ["0.5", "1, 2, 3", "#ff0000", "400:1, 500:2", "phong", "x", "", "nan", "1e999", "$p", "a.png", "-1", "2"]
)
VALUES = st.sampled_from(["float", "rgb", "srgb", "spectrum", "string", "integer", "boolean", "blackbody", "transform"])
PROPERTY = st.tuples(VALUES, NAMES, VALUE).map(
    lambda p: f'<{p[0]} name="{p[1]}" {"temperature" if p[0] == "blackbody" else "value"}="{p[2]}"/>'
)
ATTRIBUTE = st.sampled_from(["", 'id="i"', 'name="reflectance"'])
ELEMENT = st.recursive(
    PROPERTY,
    lambda inner: st.tuples(
        TAGS, TYPES, st.lists(inner, max_size=4), st.sampled_from(["", 'id="i"', 'name="reflectance"'])
    ).map(lambda e: f'<{e[0]} type="{e[1]}" {e[3]}>{"".join(e[2])}</{e[0]}>' if e[0] != "ref" else '<ref id="i"/>'),
    max_leaves=12,
)


@pytest.mark.slow
@FUZZ
@given(st.lists(ELEMENT, max_size=4).map("".join), st.sampled_from(["0.2.0", "0.3.0", "0.4.1", "0.5.0", "0.6.0"]))
def test_any_scene(tmp_path, elements, version):
    """It is converted or refused; what is converted is XML of Mitsuba 3 with a record for whatever is left out."""
    (tmp_path / "old.xml").write_text(f'<scene version="{version}">{elements}</scene>')
    result = only_conversion_errors(lambda: convert_scene(tmp_path / "old.xml", tmp_path / "new.xml"))
    if result is not None:
        text = result.output.read_text()
        assert 'version="3.0.0"' in text and "<srgb" not in text and 'type="coating"' not in text
