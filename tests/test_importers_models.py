"""OBJ models with MTL materials become scenes that show what the MTL specification says.

The model is a square that faces the camera which the converter makes. In the middle pixel the viewer is on the
normal, lights and background are those of the new scene, and the specification's sum is one line of NumPy.
"""

import re
import sys
import xml.etree.ElementTree as ET

import mitsuba as mi
import numpy as np
import pytest

import phong_bsdf  # noqa: F401
from phong_bsdf import images
from phong_bsdf.importers import ConversionError, convert_model, meshes, model, objfile
from phong_bsdf.importers.records import Journal

VIEW = np.array(model.VIEW) / np.linalg.norm(model.VIEW)
RIGHT = np.cross([0.0, 1.0, 0.0], VIEW) / np.linalg.norm(np.cross([0.0, 1.0, 0.0], VIEW))
UP = np.cross(VIEW, RIGHT)


def square(material="m", *, shift=0.0, turn=1, uv=True):
    """A square that faces the camera, `shift` nearer to it, with the corners of its texture at its corners."""
    corners = [x * RIGHT + y * UP + shift * VIEW for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    lines = ["v {:.9f} {:.9f} {:.9f}".format(*c) for c in corners]
    order = [-4, -3, -2, -1][::turn]
    lines += ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1"] * uv
    face = " ".join(f"{i}/{i}" if uv else f"{i}" for i in order)
    return "\n".join([*lines, f"usemtl {material}", f"f {face}", ""])


@pytest.fixture
def convert(tmp_path):
    """convert(obj, mtl) -> the conversion, the text of the new scene, a function that renders it."""

    def run(obj, mtl="", **options):
        (tmp_path / "a.obj").write_text(f"mtllib a.mtl\n{obj}")
        (tmp_path / "a.mtl").write_text(mtl)
        result = convert_model(tmp_path / "a.obj", tmp_path / "new.xml", **options)
        text = re.sub(r">\s+<", "><", re.sub(r"<!--.*?-->", "", result.output.read_text(), flags=re.S))

        def render(size=15, spp=1):
            scene = mi.load_file(str(result.output), width=str(size), height=str(size), spp=str(spp))
            return np.array(mi.render(scene))

        return result, text, render

    return run


def sums(scene_text, p):
    """Of the lights of a scene, seen along the square's normal: sum of I n.l, and of I (n.h)^p."""
    root = ET.fromstring(scene_text)
    diffuse = specular = 0.0
    for light in root.iter("emitter"):
        if light.get("type") == "directional":
            direction = light.find("vector")
            toward = -np.array([float(direction.get(axis)) for axis in "xyz"])
            toward /= np.linalg.norm(toward)
            h = (toward + VIEW) / np.linalg.norm(toward + VIEW)
            intensity = float(light.find("rgb").get("value"))
            diffuse += intensity * (toward @ VIEW)
            specular += intensity * (h @ VIEW) ** p * (toward @ VIEW > 0)
    return diffuse, specular


KD, KS, NS, BACK = np.array([0.6, 0.3, 0.1]), np.array([0.2, 0.3, 0.4]), 20, model.BACKGROUND
MTL = "newmtl m\nKd 0.6 0.3 0.1\nKs 0.2 0.3 0.4\nNs 20\n"


# The table of illum --------------------------------------------------------------------------------------


@pytest.mark.parametrize("illum", [0, 1, 2, 3, 8, None])
def test_illum(convert, illum):
    """0: Kd, whatever the light. 1: Lambert. 2: and the highlight. 3, 8: and the mirror, nothing diminished."""
    _, text, render = convert(square(), MTL + (f"illum {illum}\n" if illum is not None else ""))
    diffuse, specular = sums(text, NS)
    expected = {
        0: KD,
        1: KD * diffuse,
        2: KD * diffuse + KS * specular,
        3: KD * diffuse + KS * (specular + BACK),
    }[{8: 3, None: 2}.get(illum, illum)]
    # The constant colour adds 1e-6 of a diffuse reflectance.
    assert render()[7, 7] == pytest.approx(expected, rel=1e-4)


def test_illum_5_without_a_diffuse_colour(convert):
    """A mirror with Fresnel's equations: Ks at normal incidence."""
    result, text, render = convert(square(), MTL.replace("Kd 0.6 0.3 0.1", "Kd 0 0 0") + "illum 5\n")
    assert '<bsdf type="conductor">' in text
    assert render()[7, 7] == pytest.approx(KS * BACK, rel=1e-4)
    assert "highlights" in result.losses[0].why


def test_illum_5_with_one(convert):
    """`plastic`: a diffuse base under a reflection of its own index."""
    _, text, render = convert(square(), MTL + "illum 5\nNi 1.5\n")
    assert (
        '<bsdf type="plastic"><rgb name="diffuse_reflectance" value="0.6, 0.3, 0.1"/>'
        '<float name="int_ior" value="1.5"/>' in text
    )
    # Its reflection is the same in all channels: 4 % of the background.
    assert render()[7, 7].min() > 0.04 * BACK


@pytest.mark.parametrize("illum", [4, 6, 7, 9])
def test_glass(convert, illum):
    """A pane of glass before an even background shows the background."""
    pane = square() + square(shift=-0.1, turn=-1)
    result, text, render = convert(pane, f"newmtl m\nillum {illum}\nNi 1.4\nKd 1 1 1\nTf 1 1 1\n")
    assert '<bsdf type="dielectric" id="m"><float name="int_ior" value="1.4"/>' in text
    # Ten bounces leave less than 1e-6 in the pane.
    assert render()[7, 7] == pytest.approx(BACK, rel=1e-4)
    assert any("'dielectric'" in r.what for r in result.losses)


def test_filtered_glass(convert):
    """Tf colours what passes, Ks what is reflected."""
    _, text, _ = convert(square(), "newmtl m\nillum 7\nNi 1.4\nTf 1 0.5 0.25\nKs 0.9 0.9 0.9\n")
    assert (
        '<rgb name="specular_transmittance" value="1, 0.5, 0.25"/>'
        '<rgb name="specular_reflectance" value="0.9, 0.9, 0.9"/>' in text
    )


@pytest.mark.parametrize("illum", [10, 11, -1])
def test_other_models(convert, illum):
    """What the table does not have, or casts shadows only, is taken as a surface, and told."""
    result, text, _ = convert(square(), MTL + f"illum {illum}\n")
    assert '<bsdf type="blinnphong">' in text and f"illum {illum}" in result.losses[0].what


def test_reflectances(convert):
    """In the physical vocabulary the highlight is normalised: rho_d + pi rho_s c(p) (n.h)^p n.l, per unit of light."""
    _, text, render = convert(square(), MTL, vocabulary="reflectances")
    assert '<string name="convention" value="physical"/>' in text and '<float name="exponent" value="20"/>' in text
    c = (NS + 2) * (NS + 4) / (8 * np.pi * (2 ** (-NS / 2) + NS))
    expected = 0.0
    for light in ET.fromstring(text).iter("emitter"):
        if light.get("type") == "directional":
            toward = -np.array([float(light.find("vector").get(axis)) for axis in "xyz"])
            toward /= np.linalg.norm(toward)
            h = (toward + VIEW) / np.linalg.norm(toward + VIEW)
            expected = expected + float(light.find("rgb").get("value")) * (toward @ VIEW) * (
                KD / np.pi + KS * c * (h @ VIEW) ** NS
            )
    assert render()[7, 7] == pytest.approx(expected, rel=1e-4)


# Transparency, emission, defaults ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("lines", "opacity"),
    [("d 0.25", 0.25), ("Tr 0.75", 0.25), ("d 0.25\nTr 0.25", 0.25), ("d -halo 0.25", 0.25), ("d 1", 1)],
)
def test_opacity(convert, lines, opacity):
    """d, or 1 - Tr, of the surface before the background; where they disagree d counts, and that is told."""
    result, text, render = convert(square(), MTL + lines)
    diffuse, specular = sums(text, NS)
    assert render()[7, 7] == pytest.approx(opacity * (KD * diffuse + KS * specular) + (1 - opacity) * BACK, rel=1e-4)
    assert bool(result.losses) == ("halo" in lines or "Tr 0.25" in lines)


def test_emission(convert):
    """Ke is added to what the lights give."""
    result, text, render = convert(square(), MTL + "Ke 0.1 0.2 0.4\n")
    diffuse, specular = sums(text, NS)
    assert render()[7, 7] == pytest.approx(KD * diffuse + KS * specular + [0.1, 0.2, 0.4], rel=1e-4)
    assert result.losses == ()
    result, _, _ = convert(square(), MTL + "Ke 0.1 0.2 0.4\n", vocabulary="reflectances")
    assert "--vocabulary coefficients" in result.losses[0].why


def test_ambient_is_told(convert):
    """Ka needs ambient light, which no model has: a loss."""
    result, _, _ = convert(square(), MTL + "Ka 1 1 1\nmap_Ka x.png\n")
    assert ["Ka" in r.what for r in result.losses] == [True, True]


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("Kd 0.5", [0.5] * 3),
        ("Kd xyz 0.4124 0.2126 0.0193", [1, 0, 0]),
        ("Kd spectral a.rfl 1", [0.8] * 3),
        ("Kd no", [0.8] * 3),
    ],
)
def test_colours(convert, line, expected):
    """One number is grey; CIE XYZ is converted; what is no colour is told, and the default stays."""
    result, text, _ = convert(square(), f"newmtl m\n{line}\n")
    found = re.search(r'name="kd" value="([^"]*)"', text)[1]
    assert [float(x) for x in found.split(",")] == pytest.approx(expected, abs=1e-3)
    assert bool(result.losses) == (expected == [0.8] * 3)


def test_physical_extensions_are_told(convert):
    """Each statement that is not read is a loss with its line."""
    result, _, _ = convert(square(), MTL + "Pr 0.3\nmap_Pm x.png\nrefl -type sphere sky.png\nfoo 1\n")
    assert [r.line for r in result.losses] == [5, 6, 7, 8]


# Maps ----------------------------------------------------------------------------------------------------


def image_of(path, pixels):
    mi.Bitmap(np.array(pixels, np.uint8)).write(str(path))


def quarters(image):
    """The colours around the middle of the four quarters, in reading order.

    Medians: a ray that meets the edge between two triangles exactly can miss both.
    """
    height, width = image.shape[:2]
    rows, columns = ([slice(n // 8, 3 * n // 8), slice(5 * n // 8, 7 * n // 8)] for n in (height, width))
    return [np.median(image[i, j].reshape(-1, 3), axis=0) for i in rows for j in columns]


FOUR = [[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]]
UNLIT = "newmtl m\nillum 0\n"


def four(folder):
    """Red and green above blue and white, each 8 x 8 texels, so that the middles are not blurred."""
    image_of(folder / "my colours.png", np.repeat(np.repeat(FOUR, 8, 0), 8, 1))


def test_a_texture_is_the_right_way_up(convert, tmp_path):
    """The image's first row is at the square's upper edge. The name holds a space."""
    four(tmp_path)
    _, _, render = convert(square(), UNLIT + "map_Kd my colours.png\n")
    image = render(64)
    lit = np.argwhere(np.abs(image - BACK).max(axis=2) > 0.01)
    (top, left), (bottom, right) = lit.min(axis=0), lit.max(axis=0) + 1
    seen = quarters(image[top:bottom, left:right])
    assert np.array(seen) == pytest.approx(np.array(FOUR).reshape(4, 3) / 255, abs=1e-3)


@pytest.mark.parametrize(
    ("options", "first"),
    [
        ("-s 2 2", [1, 0, 0]),
        ("-s 1 0.5", [0, 0, 1]),
        ("-o 0.5 0", [0, 1, 0]),
        ("-o 0 0.5", [0, 0, 1]),
        ("-o 1 0 -clamp on", [0, 1, 0]),
    ],
)
def test_scale_and_offset(convert, tmp_path, options, first):
    """What the upper left quarter shows: u' = s u + o, v' = s v + o, counted from the lower edge."""
    four(tmp_path)
    _, text, render = convert(square(), UNLIT + f"map_Kd {options} my colours.png\n")
    image = render(64)
    lit = np.argwhere(np.abs(image - BACK).max(axis=2) > 0.01)
    low, size = lit.min(axis=0), np.ptp(lit, axis=0) + 1
    share = 0.125 if "-s 2" in options else 0.25
    row, column = (low + share * size).astype(int)
    assert image[row, column] == pytest.approx(first, abs=1e-3)
    assert ("clamp" in options) == ('<string name="wrap_mode" value="clamp"/>' in text)


def test_a_map_times_its_colour(convert, tmp_path):
    """Kd and map_Kd are multiplied, in linear light, in a copy; the file itself stays as it is."""
    image_of(tmp_path / "grey.png", np.full((4, 4, 3), 188))
    before = (tmp_path / "grey.png").read_bytes()
    result, _, _ = convert(square(), "newmtl m\nKd 0.5 1 0.25\nmap_Kd grey.png\n")
    copy = tmp_path / "new_files/grey-kd-0.5-1-0.25.exr"
    value = ((188 / 255 + 0.055) / 1.055) ** 2.4
    assert images.read_exr(copy)[0, 0] == pytest.approx(np.array([0.5, 1, 0.25]) * value, rel=1e-5)
    assert copy in result.files and (tmp_path / "grey.png").read_bytes() == before


def test_a_map_with_a_black_colour(convert, tmp_path):
    """Programs write Kd 0 0 0 with a map and mean the map."""
    image_of(tmp_path / "$grey.png", np.full((4, 4, 3), 188))
    result, text, render = convert(square(), "newmtl m\nKd 0 0 0\nmap_Kd $grey.png\n")
    assert render()[7, 7].min() > 0.3
    assert 'value="\\$grey.png"' in text and any("the map counts" in r.why for r in result.changes)


def test_maps_of_numbers(convert, tmp_path):
    """map_Ns times Ns, map_d with -mm and a channel, raw numbers both."""
    image_of(tmp_path / "n.png", np.full((4, 4), 51))
    image_of(tmp_path / "d.png", np.full((4, 4, 3), [0, 102, 0]))
    _, text, _ = convert(square(), MTL + "map_Ns n.png\nmap_d -imfchan g -mm 0.1 0.5 d.png\n")
    assert images.read_exr(tmp_path / "new_files/n-ns-20.exr")[0, 0] == pytest.approx([4.0])
    assert images.read_exr(tmp_path / "new_files/d-d-1.exr")[0, 0] == pytest.approx([0.1 + 0.5 * 0.4])
    assert re.search(
        r'<texture type="bitmap" name="p"><string [^>]*n-ns-20.exr"/><boolean name="raw" value="true"/>', text
    )
    assert re.search(r'<bsdf type="mask" id="m"><texture type="bitmap" name="opacity">', text)


def test_the_alpha_of_map_d(convert, tmp_path):
    """Of an image with alpha the alpha is the opacity."""
    image_of(tmp_path / "d.png", np.full((4, 4, 4), [255, 255, 255, 51]))
    convert(square(), MTL + "map_d d.png\n")
    assert images.read_exr(tmp_path / "new_files/d-d-1.exr")[0, 0] == pytest.approx([0.2])


def test_bumps(convert, tmp_path):
    """map_Bump with -bm, and norm: raw images; the pictures are not flat."""
    x = np.broadcast_to(np.arange(32), (32, 32))
    image_of(tmp_path / "b.png", 127 + 100 * np.sin(x / 2))
    image_of(tmp_path / "n.png", np.stack([127 + 60 * np.sin(x / 4), 127 + 0 * x, 255 + 0 * x], axis=-1))
    plain = convert(square(), MTL)[2](32)
    for line, plugin in (("map_Bump -bm 0.3 b.png", "bumpmap"), ("bump b.png", "bumpmap"), ("norm n.png", "normalmap")):
        _, text, render = convert(square(), MTL + line)
        assert f'<bsdf type="{plugin}"><texture type="bitmap"' in text and 'name="raw" value="true"' in text
        assert ('<float name="scale" value="0.3"/>' in text) == ("-bm" in line)
        assert np.abs(render(32) - plain)[8:-8, 8:-8].max() > 0.02


def test_maps_of_mirrors_and_constants(convert, tmp_path):
    """A mirror of strength 0.5 shows a map undiminished; a constant colour shows it as it is."""
    image_of(tmp_path / "grey.png", np.full((8, 8, 3), 188))
    value = ((188 / 255 + 0.055) / 1.055) ** 2.4
    _, text, render = convert(square(), "newmtl m\nillum 3\nKs 0.5 0.5 0.5\nNs 20\nmap_Kd grey.png\n")
    diffuse, specular = sums(text, NS)
    assert render()[7, 7] == pytest.approx(value * diffuse + 0.5 * (specular + BACK), rel=1e-4)
    assert convert(square(), UNLIT + "map_Kd grey.png\n")[2]()[7, 7] == pytest.approx([value] * 3, rel=1e-4)


@pytest.mark.parametrize("content", [None, b"no image"])
def test_missing_and_broken_textures(convert, tmp_path, content):
    """They are told, and their constant stands in: of the highlight, what Ks says."""
    if content:
        (tmp_path / "x.png").write_bytes(content)
    maps = "map_Kd x.png\nmap_Ks x.png\nmap_Ns x.png\nmap_d x.png\nmap_Bump x.png\n"
    result, text, render = convert(square(), MTL + maps)
    assert len([r for r in result.losses if r.what == "texture 'x.png'"]) == 5
    assert "bitmap" not in text
    diffuse, specular = sums(text, NS)
    assert render()[7, 7] == pytest.approx(KD * diffuse + KS * specular, rel=1e-4)


# Geometry ------------------------------------------------------------------------------------------------


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


# Errors --------------------------------------------------------------------------------------------------


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
