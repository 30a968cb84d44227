"""OBJ models with MTL materials become scenes that show what the MTL specification says.

The model is a square that faces the camera which the converter makes. In the middle pixel the viewer is on the
normal, lights and background are those of the new scene, and the specification's sum is one line of NumPy.
"""

import re
import xml.etree.ElementTree as ET

import mitsuba as mi
import numpy as np
import pytest

import phong_bsdf  # noqa: F401
from helpers.models import BACK, KD, KS, MTL, NS, VIEW, converting, square, sums
from phong_bsdf.pictures import images


@pytest.fixture
def convert(tmp_path):
    """convert(obj, mtl) -> the conversion, the text of the new scene, a function that renders it."""
    return converting(tmp_path)


# The table of illum -----------------------------------------------------------------------------------------


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


# Transparency, emission, defaults ---------------------------------------------------------------------------


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


# Maps -------------------------------------------------------------------------------------------------------


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
