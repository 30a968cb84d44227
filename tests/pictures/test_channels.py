"""Files say what they hold: names of channels in EXR as Mitsuba has them, colours in PNG, and nothing is taken for what
it is not."""

import re
from pathlib import Path

import mitsuba as mi
import numpy as np
import OpenEXR
import pytest
from click.testing import CliRunner
from mitsuba.mitsuba_ext import Bitmap

from phong_bsdf.checking import references
from phong_bsdf.cli import main
from phong_bsdf.pictures import images, parts
from phong_bsdf.scene import rendering

PATH, WHITTED = '<integrator type="path"/>', '<integrator type="whitted"/>'
AOV = """<integrator type="aov"><string name="aovs" value="dd.y:depth,nn:sh_normal,kd:albedo"/>
<integrator type="path" name="img"/></integrator>"""
BARE_AOV = '<integrator type="aov"><string name="aovs" value="dd.y:depth"/></integrator>'

# A square of kd (.8, .4, .2) that covers the left half of the view; the edge cuts the middle pixels of a row of five.
SCENE = """\
<scene version="3.0.0">
    {integrator}
    <sensor type="perspective">
        <float name="fov" value="90"/>
        <sampler type="independent"><integer name="sample_count" value="4"/></sampler>
        {film}
    </sensor>
    <emitter type="directional"><vector name="direction" value="0, 0, 1"/> {light}</emitter>
    <shape type="rectangle">
        <transform name="to_world"><rotate y="1" angle="180"/><scale value="100"/><translate x="100" z="1"/></transform>
        <bsdf type="diffuse"><rgb name="reflectance" value="0.8, 0.4, 0.2"/></bsdf>
    </shape>
</scene>
"""
RGB_LIGHT = '<rgb name="irradiance" value="1"/>'

NAMES = {"luminance": "Y", "luminance_alpha": "YA", "rgb": "RGB", "rgba": "RGBA", "xyz": "XYZ", "xyza": "XYZA"}
FULL, HALF = (0.8, 0.4, 0.2), (0.4, 0.2, 0.1)


def hdrfilm(format, size=(5, 1)):
    return (f'<film type="hdrfilm"><integer name="width" value="{size[0]}"/><integer name="height" value="{size[1]}"/>'
            f'<string name="pixel_format" value="{format}"/><rfilter type="box"/></film>')  # fmt: skip


def specfilm(*names):
    for i in range(len(names)):
        Path(f"{i}.spd").write_text(f"{400 + 50 * i} 1\n{450 + 50 * i} 1\n")
    bands = "".join(f'<spectrum name="{name}" filename="{i}.spd"/>' for i, name in enumerate(names))
    return f'<film type="specfilm"><integer name="width" value="5"/><integer name="height" value="1"/>{bands}</film>'


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def scene(film, integrator=WHITTED, light=RGB_LIGHT):
    Path("a.xml").write_text(SCENE.format(film=film, integrator=integrator, light=light))


def command(*args):
    result = CliRunner().invoke(main, [*map(str, args)])
    assert (result.exit_code, result.stderr) == (0, ""), result.output
    return result.stdout


def refused(*args):
    """The one sentence; nothing is written."""
    before = sorted(Path().rglob("*"))
    result = CliRunner().invoke(main, [*map(str, args)])
    assert (result.exit_code, result.stdout) == (2, ""), result.output
    assert re.fullmatch(r"Error: [^\n]+\n", result.stderr), result.stderr
    assert sorted(Path().rglob("*")) == before
    return result.stderr


def in_file(path):
    """Channel -> values, as the library has them."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: np.array(channel.pixels) for name, channel in file.channels().items()}


def png(path):
    return np.array(Bitmap(str(path)))


def by_mitsuba(variant="llvm_ad_rgb"):
    """Names and values of a picture, as Mitsuba's film has them."""
    mi.set_variant(variant)
    scene = mi.load_file("a.xml")
    image = np.array(mi.render(scene, spp=4, seed=0))
    return [field.name for field in scene.sensors()[0].film().bitmap().struct_()], image


def test_half_covered_pixels(folder):
    """The scene is what these tests take it for: two and a half pixels of a row show the square."""
    scene(hdrfilm("rgba"))
    command("render", "a.xml", "-o", "a.exr")
    row = images.read_exr(Path("a.exr"))[0]
    wanted = [(*FULL, 1)] * 2 + [(*HALF, 0.5)] + [(0, 0, 0, 0)] * 2
    assert np.abs(row - wanted).max() < 1e-6 or np.abs(row[::-1] - wanted).max() < 1e-6


@pytest.mark.parametrize("format", NAMES)
@pytest.mark.parametrize("variant", ["llvm_ad_rgb", "llvm_ad_mono", "scalar_rgb"])
def test_names_of_a_film(folder, format, variant):
    """Each format of a film, as Mitsuba names its channels, and all of its values."""
    scene(hdrfilm(format))
    command("render", "a.xml", "-o", "a.exr", "-m", variant)
    names, image = by_mitsuba(variant)
    found = in_file("a.exr")
    assert sorted(found) == sorted(names) and (variant == "llvm_ad_mono" or "".join(names) == NAMES[format])
    for i, name in enumerate(names):
        assert np.array_equal(found[name], image[..., i])
    values, order = images.read_all(Path("a.exr"))
    assert order == tuple(names) and np.array_equal(values, image)
    assert np.array_equal(images.read_checked(Path("a.exr")), image)
    assert images.read_channels(Path("a.exr")) == order


@pytest.mark.parametrize("format", NAMES)
@pytest.mark.parametrize("linear", [False, True])
def test_png_of_a_film(folder, format, linear):
    """Colours and their alpha: where a pixel is half covered, the colour of what covers it; XYZ are no RGB."""
    scene(hdrfilm(format))
    command("render", "a.xml", "-o", "a.png", *["--linear"] * linear)
    row = png("a.png")[0].reshape(5, -1).astype(int)
    row = row if row[0, 0] else row[::-1]
    full = [204, 102, 51] if linear else [231, 170, 124]
    # (.8, .4, .2): luminance 0.2126 .8 + 0.7152 .4 + 0.0722 .2 = 0.4706
    grey = [120] if linear else [182]
    colour = grey * 3 if format == "luminance_alpha" else grey if format == "luminance" else full
    has_alpha = format.endswith("a") and format != "rgb"
    assert np.abs(row[0] - (colour + [255] * has_alpha)).max() <= 1
    if has_alpha:
        assert np.abs(row[2] - [*colour, 128]).max() <= 1 and row[4, -1] == 0
    if format == "rgba":
        assert list(row[2]) == [*full, 128]


@pytest.mark.parametrize("bands", [["red"], ["blue 1", "a"], ["z", "y", "x"], ["R2", "G2", "B2", "A2"]])
def test_bands(folder, bands):
    """Bands of a film have their names, and are no picture for a PNG, which says so before anything is rendered."""
    scene(specfilm(*bands), PATH, "")
    command("render", "a.xml", "-o", "a.exr", "-m", "llvm_ad_spectral")
    found = in_file("a.exr")
    names, image = by_mitsuba("llvm_ad_spectral")
    assert sorted(found) == sorted(bands) == sorted(names)
    assert images.read_channels(Path("a.exr")) == tuple(names)
    for i, name in enumerate(names):
        assert np.allclose(found[name], image[..., i], rtol=1e-5)
    said = refused("render", "a.xml", "-o", "a.png", "-m", "llvm_ad_spectral")
    assert "a PNG shows colours" in said and all(name in said for name in bands) and "write an .exr" in said
    with pytest.raises(ValueError, match="no colours, only the channels"):
        images.read_exr(Path("a.exr"))


@pytest.mark.parametrize("format", ["rgb", "rgba", "xyza", "luminance"])
def test_added_channels(folder, format):
    """What `aov` adds has the names that Mitsuba gives it, beside the colour; a PNG shows the colour."""
    scene(hdrfilm(format), AOV)
    command("render", "a.xml", "-o", "a.exr", "-o", "a.png", "--spp", "4")
    added = ["dd.y.T", "nn.X", "nn.Y", "nn.Z", "kd.R", "kd.G", "kd.B"]
    found, order = in_file("a.exr"), images.read_channels(Path("a.exr"))
    assert order == (*NAMES[format], *added) and set(found) == set(order)
    hit = found["dd.y.T"][0] > 0.5
    # Two pixels and a half, or half of its samples: the normal there is along the view.
    assert 2 <= hit.sum() <= 3 and np.abs(found["nn.Z"][0][hit]).max() == 1
    assert not np.rint(found["nn.X"]).any() and found["kd.R"][0][hit].max() == pytest.approx(0.8, rel=1e-6)
    colour = images.read_exr(Path("a.exr"))
    assert colour.shape[-1] == {"rgb": 3, "rgba": 4, "xyza": 4, "luminance": 1}[format]
    images.write(Path("b.png"), colour)
    assert np.array_equal(png("a.png"), png("b.png"))
    values, _ = images.read_all(Path("a.exr"))
    assert np.array_equal(images.read_checked(Path("a.exr")), values)


def test_channels_without_a_colour(folder):
    """An `aov` with nothing inside: EXR only."""
    scene(hdrfilm("rgb"), BARE_AOV)
    command("render", "a.xml", "-o", "a.exr")
    assert list(in_file("a.exr")) == ["dd.y.T"]
    assert "only dd.y.T" in refused("render", "a.xml", "-o", "a.png")


def test_several_pictures_inside(folder):
    """The first has the colour's names, the others their own before them."""
    one = '<integrator type="path" name="img"/>'
    scene(hdrfilm("rgb"), AOV.replace(one, one + '<integrator type="whitted" name="w"/>'))
    command("render", "a.xml", "-o", "a.exr", "--spp", "4")
    order = images.read_channels(Path("a.exr"))
    assert order[:6] == (*"RGB", "w.R", "w.G", "w.B") and len(order) == 13
    found = in_file("a.exr")
    scene(hdrfilm("rgb"), WHITTED)
    command("render", "a.xml", "-o", "b.exr", "--spp", "4")
    for name in "RGB":
        assert np.abs(found[f"w.{name}"] - in_file("b.exr")[name]).max() < 1e-6


def test_moments(folder):
    """Another integrator that adds channels."""
    scene(hdrfilm("rgba"), '<integrator type="moment"><integrator type="path" name="img"/></integrator>')
    command("render", "a.xml", "-o", "a.exr", "--spp", "4")
    names, _ = by_mitsuba()
    assert images.read_channels(Path("a.exr")) == tuple(names) and "m2_img.X" in names


def test_what_nobody_can_name(folder):
    """Refused in a sentence before rendering, not written under other names."""
    inner = AOV.replace('value="dd.y', 'value="e').replace('name="img"', 'name="in"')
    inner = inner.replace('type="aov"', 'type="aov" name="k"')
    scene(hdrfilm("rgb"), AOV.replace('<integrator type="path" name="img"/>', inner))
    assert "an integrator 'aov' inside of another one" in refused("render", "a.xml", "-o", "a.exr")
    scene(specfilm("a", "b"), AOV, "")
    assert "mixes up the channels" in refused("render", "a.xml", "-o", "a.exr", "-m", "scalar_spectral")
    with pytest.raises(ValueError, match="two channels have the name 'a'"):
        images.write(Path("b.exr"), np.zeros((2, 2, 2)), channels=["a", "a"])
    with pytest.raises(ValueError, match="3 channels have 2 names"):
        images.write(Path("b.exr"), np.zeros((2, 2, 3)), channels=["a", "b"])


def test_crop_windows(folder):
    """The channels of a part of the film."""
    window = {"crop_offset_x": 1, "crop_width": 3, "crop_height": 2}
    window = "".join(f'<integer name="{name}" value="{value}"/>' for name, value in window.items())
    scene(hdrfilm("xyz", (6, 4)).replace("</film>", f"{window}</film>"))
    command("render", "a.xml", "-o", "a.exr", "-o", "a.png")
    assert in_file("a.exr").keys() == set("XYZ") and images.read_all(Path("a.exr"))[0].shape == (2, 3, 3)
    assert png("a.png").shape == (2, 3, 3)


# Read back ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("film", "integrator"), [("xyz", PATH), ("xyza", WHITTED), ("rgb", AOV), ("luminance_alpha", PATH)]
)
def test_passes_and_merge(folder, film, integrator):
    """Passes hold all channels, and so does what becomes of them, in any order, on the way through files."""
    scene(hdrfilm(film), integrator)
    command("render", "a.xml", "-o", "a.exr", "-o", "a.png", "--passes", "p", "--spp", "16", "--pass-spp", "4")
    command("merge", "p", "-o", "b.exr", "-o", "b.png")
    order = images.read_channels(Path("a.exr"))
    assert order[: len(NAMES[film])] == tuple(NAMES[film])
    assert images.read_channels(Path("b.exr")) == order == images.read_channels(next(Path("p").rglob("*.exr")))
    assert np.array_equal(images.read_all(Path("a.exr"))[0], images.read_all(Path("b.exr"))[0])
    assert np.array_equal(png("a.png"), png("b.png"))
    next(Path("p").rglob("*.exr")).unlink()
    command("render", "a.xml", "-o", "a.exr", "--passes", "p", "--resume")
    assert np.array_equal(images.read_all(Path("a.exr"))[0], images.read_all(Path("b.exr"))[0])


def test_parts_of_other_channels(folder):
    """Pictures whose channels differ are not averaged, whatever else they say."""
    scene(hdrfilm("xyz"), PATH)
    for name, seed in (("a", 1), ("b", 2)):
        command("render", "a.xml", "-o", f"{name}.exr", "-s", seed)
    part = parts.read(Path("b.exr"))
    # As version 0.1 wrote X, Y and Z.
    images.write(Path("b.exr"), images.read_checked(Path("b.exr")), metadata=parts.metadata(part.subject, part.samples))
    assert "channels R, G, B, not X, Y, Z" in refused("merge", "a.exr", "b.exr", "-o", "c.exr")
    with pytest.raises(ValueError, match="PNG shows colours"):
        images.check_channels(Path("c.png"), ["a", "b", "c"])


def test_checksum_covers_all_channels(folder):
    """A file whose depth was changed is broken, as one whose colour was."""
    image = np.random.default_rng(0).uniform(0, 1, (3, 4, 5)).astype(np.float32)
    names = ["Z", "B", "depth", "R", "G"]
    images.write(Path("a.exr"), image, channels=names)
    assert np.array_equal(images.read_checked(Path("a.exr")), image)
    assert images.read_all(Path("a.exr"))[1] == tuple(names)
    assert np.array_equal(images.read_exr(Path("a.exr")), image[..., [3, 4, 1]])
    with OpenEXR.File("a.exr", separate_channels=True) as file:
        header, channels = dict(file.header()), {n: np.array(c.pixels) for n, c in file.channels().items()}
    channels["depth"][1, 1] += 1
    OpenEXR.File({k: header[k] for k in ("crc32", "channel_order", "compression", "type")}, channels).write("a.exr")
    with pytest.raises(ValueError, match="broken"):
        images.read_checked(Path("a.exr"))


def test_files_of_other_programs(folder):
    """Colour first, the rest by name; X, Y and Z become RGB where colours are wanted."""
    xyz = (np.linalg.inv(images.XYZ_TO_RGB) @ np.array(FULL)).astype(np.float32)
    stored = {**dict(zip("XYZ", xyz, strict=True)), "depth": 1, "A": 1}
    channels = {name: np.full((2, 3), value, np.float32) for name, value in stored.items()}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, channels).write("a.exr")
    assert images.read_channels(Path("a.exr")) == (*"XYZA", "depth")
    # float32 of a matrix of three terms.
    assert np.abs(images.read_exr(Path("a.exr")) - [*FULL, 1]).max() < 1e-6


@pytest.mark.parametrize("format", ["rgba", "xyz", "xyza", "luminance_alpha"])
def test_check_accepts_its_own_pictures(folder, format):
    """EXR and PNG that `render` wrote of a scene are right, half-covered pixels too."""
    scene(hdrfilm(format, (41, 30)))
    for name, options in (("a.exr", ()), ("a.png", ()), ("b.png", ("--linear",))):
        command("render", "a.xml", "-o", name, *options)
        assert "right, score 1.00" in command("check", name, "a.xml", *options, "--edges", 0)


def test_check_of_partly_transparent_pictures(folder):
    """Colours over black are what counts; colours that were multiplied already pass, too, wrong ones do not."""
    scene(hdrfilm("rgba", (41, 30)))
    command("render", "a.xml", "-o", "a.png")
    values = png("a.png")
    edge = (values[..., 3] > 0) & (values[..., 3] < 255)
    assert edge.any()
    stored = images.srgb(images.from_srgb(values[..., :3] / 255) * (values[..., 3:] / 255))
    for name, colours in (("multiplied", stored), ("wrong", 0.9 * values[..., :3] / 255)):
        made = np.concatenate([np.rint(255 * colours), values[..., 3:]], axis=-1).astype(np.uint8)
        Bitmap(made).write(f"{name}.png")
    assert "right" in command("check", "multiplied.png", "a.xml", "--edges", 0)
    assert CliRunner().invoke(main, ["check", "wrong.png", "a.xml", "--no-diagnosis"]).exit_code == 1


def test_what_wants_colours_refuses_bands(folder):
    """By name, and before anything is rendered: check, compare, references."""
    scene(specfilm("red", "far red"), PATH, "")
    mi.set_variant("llvm_ad_spectral")
    with pytest.raises(rendering.SceneError, match=r"no colours, only the channels (far red, red|red, far red)"):
        references.update(Path("ref"), "a.xml", references.Options())
    images.write(Path("a.png"), np.zeros((1, 5, 3)))
    assert "no colours" in refused("check", "a.png", "a.xml", "-m", "llvm_ad_spectral")
    command("render", "a.xml", "-o", "bands.exr", "-m", "llvm_ad_spectral")
    scene(hdrfilm("rgb"))
    result = CliRunner().invoke(main, ["check", "bands.exr", "a.xml"])
    assert result.exit_code == 2 and "holds no colours, only the channels" in result.output


def test_references_of_xyz_and_added_channels(folder):
    """A reference is the colour: that of a film of XYZ is that of RGB, and channels beside it do not count."""
    scene(hdrfilm("rgb"))
    references.update(Path("ref"), "a.xml", references.Options())
    for film, integrator in (("xyz", WHITTED), ("rgb", AOV.replace('"path"', '"whitted"'))):
        scene(hdrfilm(film), integrator)
        assert references.check(Path("ref"), "a.xml", references.Options(absolute=1e-5, spp=4)).verdict.passed


def test_sweep_keeps_all_channels(folder):
    """Its files are as `render` writes them, and the mean that it tells is that of the colour."""
    scene(hdrfilm("xyz"), AOV)
    text = Path("a.xml").read_text().replace("0.8, 0.4, 0.2", "$kd, 0.4, 0.2")
    Path("a.xml").write_text(text.replace("    <integrator", '    <default name="kd" value="0.8"/><integrator', 1))
    command("sweep", "a.xml", "-D", "kd=0.5,0.8", "-o", "out", "--spp", "4")
    rows = (Path("out") / "sweep.csv").read_text().splitlines()
    mean = rows[0].split(",").index("mean")
    loaded = rendering.load(Path("a.xml"))
    for row, file in zip(rows[1:], sorted(Path("out").glob("*.exr")), strict=True):
        order = images.read_channels(file)
        assert order == rendering.channels(loaded, 1) and order[:4] == (*"XYZ", "dd.y.T")
        assert float(row.split(",")[mean]) == pytest.approx(images.read_exr(file).mean(), rel=1e-5)


def test_ordinary_files_are_what_they_were(folder):
    """Y, YA, RGB and RGBA need no names, and their headers have none."""
    for names in images.CHANNELS.values():
        image = np.random.default_rng(0).uniform(0, 1, (3, 4, len(names))).astype(np.float32)
        images.write(Path("a.exr"), image)
        images.write(Path("b.exr"), image, channels=tuple(names))
        assert Path("a.exr").read_bytes() == Path("b.exr").read_bytes()
        assert "channel_order" not in images.read_metadata(Path("a.exr"))
