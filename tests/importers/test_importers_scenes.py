"""Scenes of Mitsuba 0.2 to 0.6 become scenes that load: each old word in its new one, every loss with its line."""

import math
import re

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import phong_bsdf  # noqa: F401
from phong_bsdf.importers import ConversionError, catalogue, convert_scene, values
from phong_bsdf.pictures import images
from phong_bsdf.reflection import lobes
from phong_bsdf.scene import rendering

SENSOR = """\
<sensor type="perspective">
    <transform name="toWorld"><lookAt origin="0, 0, 4" target="0, 0, 0" up="0, 1, 0"/></transform>
    <film type="hdrfilm">
        <integer name="width" value="16"/><integer name="height" value="12"/><rfilter type="box"/>
    </film>
    <sampler type="independent"><integer name="sampleCount" value="4"/></sampler>
</sensor>
"""


@pytest.fixture
def convert(tmp_path):
    """convert(elements) -> the conversion, its text without comments and blanks, the scene that Mitsuba loads."""

    def run(elements, version="0.6.0"):
        old, new = tmp_path / "old.xml", tmp_path / "new.xml"
        old.write_text(
            f'<scene version="{version}">\n{elements}\n</scene>' if version else f"<scene>\n{elements}\n</scene>"
        )
        before = old.read_bytes()
        result = convert_scene(old, new)
        assert old.read_bytes() == before
        text = re.sub(r"<!--.*?-->", "", new.read_text(), flags=re.S)
        scene = mi.load_file(str(new))
        return result, re.sub(r">\s+<", "><", text), scene

    return run


def bsdf(text):
    return f'<shape type="sphere">{text}</shape>'


def kinds(result):
    return {record.kind for record in result.records}


def images_of(tmp_path):
    """An image with 8 bits and one of float32."""
    grey = np.full((4, 4, 3), 100, np.uint8)
    mi.Bitmap(grey).write(str(tmp_path / "a.png"))
    images.write(tmp_path / "b.exr", np.full((4, 4, 3), 0.5, np.float32))


BITMAP = '<texture type="bitmap" name="reflectance"><string name="filename" value="{}"/>{}</texture>'


@pytest.mark.parametrize(("inside", "expected"), [
    (BITMAP.format("b.exr", ""), "0.5"),
    (f'<texture type="scale" name="reflectance"><float name="scale" value="0.2"/>{BITMAP.format("b.exr", "")}'
     '</texture>', "0.1"),
    ('<texture type="checkerboard" name="reflectance"/>', "0.1"),
])  # fmt: skip
def test_textures_of_roughness(convert, tmp_path, inside, expected):
    """Mitsuba 3's `roughplastic` takes numbers only."""
    images_of(tmp_path)
    result, text, _ = convert(bsdf(f'<bsdf type="roughplastic">{inside.replace("reflectance", "alpha")}</bsdf>'))
    assert f'<bsdf type="roughplastic"><float name="alpha" value="{expected}"/></bsdf>' in text
    assert [loss.what for loss in result.losses][-1] == "texture for 'alpha' of 'roughplastic'"


def test_parameters_of_the_command_line(tmp_path):
    """0.6 needed no <default> for them; the list says which there are."""
    (tmp_path / "old.xml").write_text(
        f'<scene version="0.6.0">{SENSOR}<shape type="sphere"><float name="radius" value="$r"/></shape></scene>'
    )
    losses = convert_scene(tmp_path / "old.xml", tmp_path / "new.xml").losses
    assert [loss.what for loss in losses] == ["$r"]
    assert "-D r=" in losses[0].why
    mi.load_file(str(tmp_path / "new.xml"), r="2")


# old elements, what the new scene must hold, whether something is lost
CASES = {
    "srgb": (
        bsdf('<bsdf type="diffuse"><srgb name="reflectance" value="#ff8000"/></bsdf>'),
        '<rgb name="reflectance" value="1, 0.2158605, 0"/>', False,
    ),
    "srgb numbers": (
        bsdf('<bsdf type="diffuse"><srgb name="reflectance" value="0.5, 0.5, 0.5"/></bsdf>'),
        '<rgb name="reflectance" value="0.2140411, 0.2140411, 0.2140411"/>', False,
    ),
    "rgb hex": (
        bsdf('<bsdf type="diffuse"><rgb name="reflectance" value="#ff8000"/></bsdf>'),
        '<rgb name="reflectance" value="1, 0.5019608, 0"/>', False,
    ),
    "rgb intent": (
        bsdf('<bsdf type="diffuse"><rgb name="reflectance" value="0.1 0.2 0.3" intent="reflectance"/></bsdf>'),
        '<rgb name="reflectance" value="0.1 0.2 0.3"/>', False,
    ),
    "spectrum of three": (
        bsdf('<bsdf type="diffuse"><spectrum name="reflectance" value=".1, .2, .3"/></bsdf>'),
        '<rgb name="reflectance" value="0.1, 0.2, 0.3"/>', False,
    ),
    "spectrum of many": (
        bsdf('<bsdf type="diffuse"><spectrum name="reflectance" value=".1, .2, .3, .4, .5"/></bsdf>'),
        'value="407:0.1, 501:0.2, 595:0.3, 689:0.4, 783:0.5"', False,
    ),
    "spectrum pairs": (
        bsdf('<bsdf type="diffuse"><spectrum name="reflectance" value="400:0.1; 700 : 0.2"/></bsdf>'),
        'value="400:0.1, 700:0.2"', None,
    ),
    "reflectance above 1": (
        bsdf('<bsdf type="diffuse"><rgb name="reflectance" value="2, 1, 0"/></bsdf>'),
        'value="0.99, 0.495, 0"', False,
    ),
    "blackbody": (
        '<emitter type="point"><blackbody name="intensity" temperature="5000K"/></emitter>',
        '<spectrum name="intensity" value="360:', False,
    ),
    "grey light": (
        '<emitter type="constant"><spectrum name="radiance" value="0.3"/></emitter>',
        '<rgb name="radiance" value="0.3"/>', False,
    ),
    "grey light, a parameter": (
        '<default name="power" value="2"/>'
        '<emitter type="constant"><spectrum name="radiance" value="$power"/></emitter>',
        '<rgb name="radiance" value="$power"/>', False,
    ),
    "medium without bsdf": (
        '<medium type="homogeneous" id="m"/><shape type="sphere"><ref name="interior" id="m"/></shape>',
        '<ref name="interior" id="m"/><bsdf type="null"/>', False,
    ),
    "coating of a reference to what stands before": (
        '<bsdf type="roughplastic" id="b"><string name="distribution" value="phong"/></bsdf>'
        + bsdf('<bsdf type="coating"><ref id="b"/></bsdf>'),
        '<bsdf type="roughplastic"><string name="distribution" value="beckmann"/></bsdf></bsdf></shape>', True,
    ),
    "scale of a reference to a scale": (
        '<texture type="scale" id="t"><float name="scale" value="0.5"/>'
        '<texture type="checkerboard"><float name="uscale" value="3"/></texture></texture>'
        + bsdf('<bsdf type="diffuse"><texture type="scale" name="reflectance"><float name="scale" value="0.5"/>'
               '<ref id="t"/></texture></bsdf>'),
        '<bsdf type="diffuse"><texture type="checkerboard" name="reflectance"><transform name="to_uv">'
        '<scale x="3" y="1"/><translate x="0" y="0"/></transform><rgb name="color0" value="0.1"/>', False,
    ),
    "lookAt": ("", '<lookat origin="0, 0, 4" target="0, 0, 0" up="0, 1, 0"/>', False),
    "defaults": ("", '<default name="spp" value="4"/><default name="width" value="16"/>'
                     '<default name="height" value="12"/>', False),
    "no integrator": ("", '<integrator type="direct"/>', False),
    "coating of diffuse": (
        bsdf('<bsdf type="coating"><float name="intIOR" value="1.7"/><bsdf type="diffuse">'
             '<rgb name="reflectance" value=".1 .2 .3"/></bsdf></bsdf>'),
        '<bsdf type="plastic"><float name="int_ior" value="1.7"/>'
        '<rgb name="diffuse_reflectance" value=".1 .2 .3"/>', True,
    ),
    "coating of metal": (
        bsdf('<bsdf type="coating"><float name="intIOR" value="1.5"/><float name="extIOR" value="1"/>'
             '<bsdf type="roughconductor"><string name="material" value="Au"/></bsdf></bsdf>'),
        '<bsdf type="mirrorblend"><float name="km" value="0.04"/><bsdf type="roughconductor">', True,
    ),
    "roughcoating of diffuse": (
        bsdf('<bsdf type="roughcoating"><float name="alpha" value="0.2"/><bsdf type="diffuse"/></bsdf>'),
        '<bsdf type="roughplastic"><float name="alpha" value="0.2"/>', True,
    ),
    "phong distribution": (
        bsdf('<bsdf type="roughplastic"><string name="distribution" value="phong"/>'
             '<float name="alpha" value="0.2"/></bsdf>'),
        '<string name="distribution" value="beckmann"/><float name="alpha" value="0.2"/>', True,
    ),
    "as distribution": (
        bsdf('<bsdf type="roughconductor"><string name="material" value="Cu"/><string name="distribution" value="as"/>'
             '<float name="alphaU" value="0.2"/><float name="alphaV" value="0.3"/></bsdf>'),
        '<string name="distribution" value="beckmann"/><float name="alpha_u" value="0.2"/><float name="alpha_v"', True,
    ),
    "exponent of a plastic": (
        bsdf('<bsdf type="roughplastic"><string name="distribution" value="phong"/>'
             '<float name="exponent" value="98"/></bsdf>'),
        '<float name="alpha" value="0.1414214"/>', True,
    ),
    "metal without material": (bsdf('<bsdf type="conductor"/>'), '<string name="material" value="Cu"/>', False),
    "blend without weight": (
        bsdf('<bsdf type="blendbsdf"><bsdf type="diffuse"/><bsdf type="phong"/></bsdf>'),
        '<bsdf type="blendbsdf"><float name="weight" value="0.5"/><bsdf type="diffuse"/>', False,
    ),
    "roughdiffuse": (
        bsdf('<bsdf type="roughdiffuse"><float name="alpha" value=".3"/>'
             '<spectrum name="diffuseReflectance" value=".2"/></bsdf>'),
        '<bsdf type="diffuse"><spectrum name="reflectance" value=".2"/></bsdf>', True,
    ),
    "ward": (
        bsdf('<bsdf type="ward"><float name="alphaU" value="0.1"/><float name="alphaV" value="0.4"/></bsdf>'),
        '<bsdf type="blinnphong"><float name="exponent" value="50"/></bsdf>', True,
    ),
    "difftrans": (
        bsdf('<bsdf type="difftrans"><rgb name="transmittance" value=".1 .2 .3"/></bsdf>'),
        '<bsdf type="diffuse"><rgb name="reflectance" value=".1 .2 .3"/></bsdf>', True,
    ),
    "unknown bsdf": (bsdf('<bsdf type="velvet"><float name="a" value="1"/></bsdf>'), '<bsdf type="diffuse"/>', True),
    "course mirror": (
        bsdf('<bsdf type="mirror"><rgb name="reflectance" value="0.25 0.25 0.25"/></bsdf>'),
        '<bsdf type="conductor"><rgb name="eta" value="3, 3, 3"/><float name="k" value="0"/></bsdf>', False,
    ),
    "course plastic": (
        bsdf('<bsdf type="plastic"><rgb name="reflectance" value="0.25 0.25 0.25"/>'
             '<float name="eta" value="1.6"/></bsdf>'),
        '<rgb name="diffuse_reflectance" value="0.25 0.25 0.25"/><float name="int_ior" value="1.6"/>', False,
    ),
    "ldrfilm": (
        '<sensor type="perspective"><film type="ldrfilm"><string name="fileFormat" value="png"/>'
        '<boolean name="banner" value="false"/><string name="pixelFormat" value="luminanceAlpha"/></film></sensor>',
        '<film type="hdrfilm"><string name="pixel_format" value="luminance_alpha"/></film>', False,
    ),
    "exposure": (
        '<sensor type="perspective"><film type="ldrfilm"><float name="exposure" value="1"/></film></sensor>',
        '<film type="hdrfilm"/>', True,
    ),
    "halton": (
        '<sensor type="perspective"><sampler type="halton"><integer name="scramble" value="1"/>'
        '<integer name="sampleCount" value="9"/></sampler></sensor>',
        '<sampler type="multijitter"><integer name="sample_count" value="$spp"/></sampler>', False,
    ),
    "rfilter": (
        '<sensor type="perspective"><film type="hdrfilm"><rfilter type="mitchell"><float name="B" value="0.3"/>'
        '<float name="radius" value="2"/></rfilter></film></sensor>',
        '<rfilter type="mitchell"><float name="B" value="0.3"/></rfilter>', True,
    ),
    "focal length": (
        '<sensor type="perspective"><string name="fovAxis" value="x"/><string name="focalLength" value="50mm"/>'
        '</sensor>',
        '<sensor type="perspective"><string name="focal_length" value="50mm"/></sensor>', False,
    ),
    "telecentric": ('<sensor type="telecentric"/>', '<sensor type="orthographic"/>', True),
    "bdpt": (
        '<integrator type="bdpt"><integer name="maxDepth" value="3"/><boolean name="lightImage" value="true"/>'
        '</integrator>',
        '<integrator type="path"><integer name="max_depth" value="3"/></integrator>', False,
    ),
    "adaptive": (
        '<integrator type="adaptive"><float name="maxError" value=".1"/><integrator type="path">'
        '<integer name="rrDepth" value="7"/></integrator></integrator>',
        '<integrator type="path"><integer name="rr_depth" value="7"/></integrator>', False,
    ),
    "strict normals": ('<integrator type="path"><boolean name="strictNormals" value="true"/>'
                       '</integrator>', '<integrator type="path"/>', True),
    "field": (
        '<integrator type="field"><string name="field" value="shNormal"/></integrator>',
        '<integrator type="aov"><string name="aovs" value="value:sh_normal"/></integrator>', False,
    ),
    "emitter scale": (
        '<emitter type="directional"><float name="scale" value="3"/><spectrum name="irradiance" value="2"/></emitter>',
        '<rgb name="irradiance" value="6"/>', False,
    ),
    "sky": (
        '<emitter type="sky"><float name="turbidity" value="4"/><vector name="sunDirection" x="0" y="1" z="0"/>'
        '</emitter>',
        '<emitter type="sunsky"><float name="turbidity" value="4"/><vector name="sun_direction" x="0" y="1" z="0"/>'
        '<float name="sun_scale" value="0"/><transform name="to_world"><rotate x="1" angle="-90"/></transform>', True,
    ),
    "collimated": ('<emitter type="collimated"/>', '<integrator type="direct"/>', True),
    "subsurface": (bsdf('<subsurface type="dipole"/>'), '<shape type="sphere"/>', True),
    "heightfield": ('<shape type="heightfield"/>', '<integrator type="direct"/>', True),
    "medium": (
        '<medium type="homogeneous" id="m"><rgb name="sigmaS" value="1 2 3"/><spectrum name="sigmaA" value="1"/>'
        '</medium>',
        '<rgb name="sigma_t" value="0.5, 0.75, 1"/><rgb name="albedo" value="0.5, 0.6666667, 0.75"/>'
        '<float name="scale" value="4"/>', False,
    ),
    "unknown element": ('<null id="a"/>', '<integrator type="direct"/>', True),
    "animation": (
        '<shape type="sphere"><animation name="toWorld"><transform time="0"><translate x="1"/></transform>'
        '<transform time="1"><translate x="2"/></transform></animation></shape>',
        '<transform name="to_world"><translate x="1"/></transform>', True,
    ),
    "several BSDFs": (
        '<shape type="sphere"><bsdf type="phong" name="a"/><bsdf type="diffuse" name="b"/></shape>',
        '<shape type="sphere"><bsdf type="phong"/></shape>', True,
    ),
    "diffuse of old": (
        bsdf('<bsdf type="diffuse"><rgb name="diffuseReflectance" value=".1 .2 .3"/></bsdf>'),
        '<bsdf type="diffuse"><rgb name="reflectance" value=".1 .2 .3"/></bsdf>', False,
    ),
    "uv": (
        bsdf('<bsdf type="diffuse"><texture type="checkerboard" name="reflectance"><float name="uscale" value="2"/>'
             '<float name="voffset" value="0.25"/></texture></bsdf>'),
        '<transform name="to_uv"><scale x="2" y="1"/><translate x="0" y="0.25"/></transform>', False,
    ),
    "scaled constant": (
        bsdf('<bsdf type="diffuse"><texture type="scale" name="reflectance"><rgb name="value" value=".2 .4 .6"/>'
             '<float name="scale" value="0.5"/></texture></bsdf>'),
        '<rgb name="reflectance" value="0.1, 0.2, 0.3"/>', False,
    ),
    "scaled checkerboard": (
        bsdf('<bsdf type="diffuse"><texture type="scale" name="reflectance"><texture type="checkerboard"/>'
             '<float name="scale" value="0.5"/></texture></bsdf>'),
        '<rgb name="color0" value="0.2"/><rgb name="color1" value="0.1"/>', False,
    ),
    "grid": (
        bsdf('<bsdf type="diffuse"><texture type="gridtexture" name="reflectance">'
             '<rgb name="color0" value=".3"/></texture></bsdf>'),
        '<rgb name="reflectance" value="0.3"/>', True,
    ),
    "bumps of no image": (
        bsdf('<bsdf type="bumpmap"><texture type="checkerboard"/><bsdf type="phong"/></bsdf>'),
        '<shape type="sphere"><bsdf type="phong"/></shape>', True,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", list(CASES))
def test_each_old_word(convert, name):
    """It is rewritten, loads in Mitsuba, and the journal says a change or a loss."""
    old, new, lost = CASES[name]
    sensor = "" if "<sensor" in old else SENSOR
    result, text, _ = convert(old + sensor)
    assert new in text
    about_it = [r for r in result.records if r.kind == "loss"]
    assert bool(about_it) == bool(lost), result.records
    if lost is False:
        assert result.changes


def test_stretched_spheres(convert):
    """As Mitsuba 0.6 drew them: round, by the scale of the x axis; the list says so, and the new scene loads."""
    result, _, scene = convert(
        '<shape type="sphere"><point name="center" x="1" y="1" z="0"/><float name="radius" value="3"/>'
        '<transform name="toWorld"><scale x="0.5" y="2"/><rotate x="1" y="1" angle="90"/></transform></shape>' + SENSOR
    )
    assert [loss.what for loss in result.losses] == ["'sphere' that is stretched to axes of 2, 1, 0.5"]
    assert "as Mitsuba 0.6 drew it" in result.losses[0].why
    box = scene.shapes()[0].bbox()
    # (0.5, 2, 0), turned by 90 degrees about the diagonal of x and y: the center stays where it was.
    assert np.array(box.center()) == pytest.approx([1.25, 1.25, 0.75 * math.sqrt(2)], abs=1e-6)
    assert np.array(box.extents()) == pytest.approx([3, 3, 3], rel=1e-6)
    assert bool(rendering.load(result.output))


def test_spheres_that_stay_spheres_are_left_alone(convert):
    """Scaled evenly, turned, moved, or by a parameter without a default."""
    inside = '<scale value="2"/><rotate y="1" angle="20"/><translate x="1"/>'
    result, text, _ = convert(f'<shape type="sphere"><transform name="toWorld">{inside}</transform></shape>{SENSOR}')
    assert inside in text and not result.losses


def test_axes_of_rotations(convert):
    """Mitsuba 0.6 made unit vectors of them; Mitsuba 3 would stretch what is turned."""
    result, _, scene = convert(
        '<shape type="rectangle"><transform name="toWorld"><rotate x="1" y="1" z="1" angle="120"/></transform></shape>'
        + SENSOR
    )
    assert any("<rotate> about an axis of length 1.732" in change.what for change in result.changes)
    matrix = np.array(mi.traverse(scene.shapes()[0])["to_world"].matrix)[:3, :3, 0]
    assert matrix == pytest.approx(np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]]), abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("tag", "plugin"), [(tag, plugin) for tag, plugins in catalogue.PLUGINS.items() for plugin in plugins]
)
def test_the_catalogue_is_mitsubas(tag, plugin):
    """No parameter that it lists is one that Mitsuba would refuse as unknown, whatever else it may want."""
    mi.set_variant("scalar_rgb")
    for parameter in catalogue.PLUGINS[tag][plugin].split():
        inside = f'<float name="{parameter}" value="0.5"/>'
        needed = f"{BASIC.get((tag, plugin), '')}" + BASIC.get((tag, plugin, parameter), inside)
        text = f'<{tag} type="{plugin}">{needed}</{tag}>'
        for outer in AROUND.get(tag, ()):
            text = f"<{outer}>{text}</{outer.split()[0]}>"
        try:
            mi.load_string(f'<scene version="3.0.0">{text}</scene>')
        except RuntimeError as error:
            assert not re.search(rf'unreferenced.*"{parameter}"', str(error), re.S), str(error)


AROUND = {
    "film": ['sensor type="perspective"'],
    "sampler": ['sensor type="perspective"'],
    "rfilter": ['film type="hdrfilm"', 'sensor type="perspective"'],
    "bsdf": ['shape type="sphere"'],
    "texture": ['bsdf type="diffuse"', 'shape type="sphere"'],
    "phase": ['medium type="homogeneous"'],
    "volume": ['medium type="homogeneous"'],
}
BASIC = {
    ("bsdf", "twosided"): '<bsdf type="diffuse"/>',
    ("bsdf", "mask"): '<bsdf type="diffuse"/>',
    ("bsdf", "mirrorblend"): '<bsdf type="diffuse"/>',
    ("bsdf", "blendbsdf"): '<bsdf type="diffuse"/><bsdf type="phong"/>',
    ("integrator", "aov"): '<string name="aovs" value="a:depth"/>',
    ("integrator", "aov", "aovs"): "",
    ("sensor", "thinlens"): '<float name="fov" value="40"/><float name="aperture_radius" value="1"/>',
    ("sensor", "thinlens", "aperture_radius"): "",
    ("sensor", "thinlens", "fov"): "",
    ("sensor", "thinlens", "fov_axis"): '<string name="fov_axis" value="x"/>',
    ("sensor", "perspective", "fov_axis"): '<float name="fov" value="40"/><string name="fov_axis" value="x"/>',
    ("emitter", "projector", "fov_axis"): '<float name="fov" value="40"/><string name="fov_axis" value="x"/>',
    ("shape", "instance"): '<shape type="shapegroup"><shape type="sphere"/></shape>',
}


def test_records_tell_the_line(convert):
    """The line of the old file, for changes and for losses, in their order."""
    result, _, _ = convert('\n<emitter type="collimated"/>\n\n<shape type="sphere"><bsdf type="hk"/></shape>')
    places = [(1, "loss"), (1, "change"), (3, "loss"), (5, "loss")]
    assert sorted((r.line, r.kind) for r in result.records) == sorted(places)
    assert [r.line for r in result.records] == [1, 1, 3, 5]
    assert result.losses[0].what == "no sensor"
    assert str(result.losses[1]).startswith("old.xml, line 3: emitter 'collimated': left out")
    header = result.output.read_text().split("-->")[0]
    assert "line 3" in header and "line 5" in header


def test_nothing_to_change(convert):
    """A plain scene keeps every word; its samples become a default."""
    result, text, _ = convert(
        '<integrator type="path"/><sensor type="perspective"/><shape type="sphere"><bsdf type="phong">'
        '<float name="exponent" value="3"/></bsdf></shape>'
    )
    assert result.records == ()
    assert text.strip() == (
        '<scene version="3.0.0"><integrator type="path"/><sensor type="perspective"/><shape type="sphere">'
        '<bsdf type="phong"><float name="exponent" value="3"/></bsdf></shape></scene>'
    )


# What old versions called otherwise ----------------------------------------------------------------------


def test_version_0_2(convert):
    """Names of 0.2: lambertian, microfacet with amounts, luminaire, camera with the old lookAt, films."""
    result, text, _ = convert(
        '<camera type="perspective"><float name="fov" value="40"/><float name="focusDepth" value="3"/>'
        '<boolean name="mapSmallerSide" value="false"/>'
        '<transform name="toWorld"><lookAt ox="0" oy="0" oz="4" tx="0" ty="0" tz="0" ux="0" uy="1" uz="0"/></transform>'
        '<film type="exrfilm"><boolean name="alpha" value="false"/></film>'
        '<sampler type="ldsampler"><integer name="depth" value="4"/></sampler></camera>'
        '<luminaire type="directional"><rgb name="intensity" value="1 2 3"/></luminaire>'
        '<luminaire type="constant"><spectrum name="intensity" value=".5"/></luminaire>'
        '<shape type="sphere"><boolean name="inverted" value="true"/><bsdf type="lambertian"/></shape>'
        '<shape type="cylinder"><point name="p1" x="0" y="0" z="0"/><point name="p2" x="0" y="1" z="0"/></shape>'
        '<shape type="sphere"><bsdf type="microfacet"><float name="alphaB" value=".3"/>'
        '<float name="diffuseAmount" value="2"/>'
        '<rgb name="diffuseReflectance" value=".1 .2 .3"/><float name="specularAmount" value=".5"/></bsdf></shape>'
        '<shape type="sphere"><bsdf type="mirror"/></shape>',
        version=None,
    )
    for expected in (
        '<string name="fov_axis" value="larger"/>',
        '<transform name="to_world"><scale x="-1"/><scale x="-1"/>'
        '<lookat origin="0, 0, 4" target="0, 0, 0" up="0, 1, 0"/>',
        '<film type="hdrfilm"><string name="pixel_format" value="rgb"/></film>',
        '<emitter type="directional"><rgb name="irradiance" value="1 2 3"/></emitter>',
        '<emitter type="constant"><rgb name="radiance" value=".5"/></emitter>',
        '<boolean name="flip_normals" value="true"/><bsdf type="diffuse"/>',
        '<point name="p0" x="0" y="0" z="0"/><point name="p1" x="0" y="1" z="0"/>',
        '<bsdf type="roughplastic"><float name="alpha" value=".3"/>'
        '<rgb name="diffuse_reflectance" value="0.2, 0.4, 0.6"/>'
        '<spectrum name="specular_reflectance" value="0.5"/></bsdf>',
        '<bsdf type="conductor"><string name="material" value="Cr"/></bsdf>',
    ):
        assert expected in text
    assert any(r.what == "<scene> without version" for r in result.changes)


def test_the_camera_of_0_3_is_mirrored(convert):
    """Its x axis pointed the other way: the picture is that of 0.4, mirrored."""
    ball = (
        '<shape type="sphere"><point name="center" x="1" y="0" z="0"/><float name="radius" value="0.5"/></shape>'
        '<emitter type="constant"/><integrator type="direct"/>'
    )
    hide = '<bsdf type="diffuse"><spectrum name="reflectance" value="0"/></bsdf></shape>'
    scene = ball.replace("</shape>", hide) + SENSOR
    new = np.array(mi.render(convert(scene)[2], spp=4))
    old = np.array(mi.render(convert(scene.replace("sensor", "camera"), version="0.3.0")[2], spp=4))
    dark = [np.argwhere(image[..., 0] < 0.5).mean(axis=0) for image in (new, old)]
    assert dark[0][1] + dark[1][1] == pytest.approx(15, abs=0.5)
    assert abs(dark[0][1] - 7.5) > 2


def test_background_of_0_4(convert):
    """<background> is the constant emitter."""
    _, text, _ = convert('<background><spectrum name="intensity" value=".5"/></background>', version="0.4.0")
    assert '<emitter type="constant"><rgb name="radiance" value=".5"/></emitter>' in text


def test_blackbody_is_plancks_law():
    """The same numbers as Mitsuba 3's own `blackbody`, which works in spectral variants only."""
    mi.set_variant("llvm_ad_spectral")
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wavelengths = mi.Spectrum(400, 500, 600, 700)
    mitsubas = np.array(mi.load_dict({"type": "blackbody", "temperature": 4500.0}).eval(si)).ravel()
    # Older digits of the constants.
    assert [values.planck(nm, 4500) for nm in (400, 500, 600, 700)] == pytest.approx(mitsubas, rel=1e-5)


def test_blackbody_renders(convert):
    """In RGB variants, too, and with its scale: a lamp of 4500 K is reddish, and a hundredth as bright at 0.01."""
    element = '<emitter type="constant"><blackbody name="radiance" temperature="4500K" scale="{}"/></emitter>'
    full, faint = (np.array(mi.render(convert(SENSOR + element.format(s))[2], spp=4)).mean((0, 1)) for s in (1, 0.01))
    assert full[0] > full[1] > full[2] > 0 and faint == pytest.approx(0.01 * full, rel=1e-3)


def test_the_sky_stands_on_y(convert):
    """The sun is where 0.6 had it: its radiance comes from there alone."""
    _, _, scene = convert('<emitter type="sun"><vector name="sunDirection" x="1" y="2" z="3"/></emitter>')
    si = mi.SurfaceInteraction3f()
    radiance = []
    for direction in ([1, 2, 3], [1, 3, -2], [3, 2, 1]):
        si.wi = mi.Vector3f((-np.array(direction) / np.sqrt(14)).tolist())
        radiance.append(float(mi.luminance(scene.environment().eval(si))[0]))
    assert radiance[0] > 0 and radiance[1:] == [0, 0]


# Textures ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("gamma", ["1", "2.2"])
def test_gamma(convert, tmp_path, gamma):
    """An image with a gamma of its own becomes a linear copy of what that gamma decodes."""
    images_of(tmp_path)
    inside = (
        f'<string name="filterType" value="ewa"/><float name="gamma" value="{gamma}"/>'
        '<string name="wrapMode" value="zero"/>'
    )
    result, text, _ = convert(bsdf(f'<bsdf type="diffuse">{BITMAP.format("a.png", inside)}</bsdf>'))
    assert '<string name="filename" value="new_files/a-linear.exr"/>' in text
    assert (
        '<string name="filter_type" value="bilinear"/>' in text and '<string name="wrap_mode" value="clamp"/>' in text
    )
    assert images.read_exr(tmp_path / "new_files/a-linear.exr") == pytest.approx((100 / 255) ** float(gamma), rel=1e-6)
    assert result.files == (tmp_path / "new.xml", tmp_path / "new_files/a-linear.exr")


def test_gamma_of_numbers(convert, tmp_path):
    """Where a texture holds numbers, gamma 1 is Mitsuba 3's `raw`, and the file stays as it is."""
    images_of(tmp_path)
    texture = BITMAP.replace("reflectance", "exponent").format("a.png", '<float name="gamma" value="1"/>')
    result, text, _ = convert(bsdf(f'<bsdf type="phong">{texture}</bsdf>'))
    assert '<string name="filename" value="a.png"/><boolean name="raw" value="true"/>' in text
    assert len(result.files) == 1


def test_scaled_image(convert, tmp_path):
    """`scale` around an image, here by reference and by a colour: a scaled copy."""
    images_of(tmp_path)
    texture = BITMAP.replace('name="reflectance"', 'id="t"').format("b.exr", "")
    scaled = '<texture type="scale" name="reflectance"><ref id="t"/><rgb name="scale" value="0.5, 1, 0.2"/></texture>'
    _, text, scene = convert(texture + bsdf(f'<bsdf type="diffuse">{scaled}</bsdf>'))
    assert images.read_exr(tmp_path / "new_files/b-scaled.exr")[0, 0] == pytest.approx([0.25, 0.5, 0.1])
    assert '<texture type="bitmap" name="reflectance"><string name="filename" value="new_files/b-scaled.exr"/>' in text
    value = mi.traverse(scene.shapes()[0].bsdf())["reflectance.data"]
    assert np.array(value)[1, 1] == pytest.approx([0.25, 0.5, 0.1], rel=1e-3)


@pytest.mark.parametrize("gamma", ["", '<float name="gamma" value="1"/>'])
def test_bump(convert, tmp_path, gamma):
    """0.4's `bump`, with the height as a texture `scale`: the parameter of `bumpmap`. The image stays where it is."""
    images_of(tmp_path)
    texture = BITMAP.replace(' name="reflectance"', "").format("a.png", gamma)
    height = f'<texture type="scale">{texture}<float name="scale" value="3"/></texture>'
    bump = f'<bsdf type="bump">{height}<bsdf type="phong"/></bsdf>'
    result, text, _ = convert(bsdf(bump), version="0.4.0")
    assert text.count("bump") == 1 and '<bsdf type="bumpmap"><texture type="bitmap">' in text
    assert '<float name="scale" value="3"/>' in text and len(result.files) == 1
    assert ('name="raw" value="true"' in text) == bool(gamma)


def test_scaled_numbers(convert, tmp_path):
    """A scaled image of exponents, gamma 1: its numbers are not decoded as colours."""
    images_of(tmp_path)
    texture = BITMAP.replace(' name="reflectance"', "").format("a.png", '<float name="gamma" value="1"/>')
    scaled = f'<texture type="scale" name="exponent">{texture}<float name="scale" value="50"/></texture>'
    convert(bsdf(f'<bsdf type="phong">{scaled}</bsdf>'))
    assert images.read_exr(tmp_path / "new_files/a-scaled.exr") == pytest.approx(50 * 100 / 255, rel=1e-6)


def test_offset_is_not_scaled(convert, tmp_path):
    """u' = 2 u + 0.25, as in 0.6: the picture is that of a texture with this matrix."""
    _, _, scene = convert(bsdf(
        '<bsdf type="diffuse"><texture type="checkerboard" name="reflectance"><float name="uscale" value="2"/>'
        '<float name="uoffset" value="0.25"/></texture></bsdf>'
    ))  # fmt: skip
    matrix = np.array(mi.traverse(scene.shapes()[0].bsdf())["reflectance.to_uv"].matrix)
    assert matrix.reshape(3, 3) == pytest.approx(np.array([[2, 0, 0.25], [0, 1, 0], [0, 0, 1]]))


# Mixtures and the course's dialect -----------------------------------------------------------------------


def value(bsdf_object, wi, wo):
    """f cos of a loaded BSDF."""
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f((np.array(wi) / np.linalg.norm(wi)).tolist())
    wo = mi.Vector3f((np.array(wo) / np.linalg.norm(wo)).tolist())
    return np.array(bsdf_object.eval(mi.BSDFContext(), si, wo)).ravel()


@pytest.mark.parametrize(
    ("weights", "expected"), [("0.5, 0.3", 0.5 * 0.2 + 0.3 * 0.8), ("2, 6", 0.25 * 0.2 + 0.75 * 0.8)]
)
def test_mixture(convert, weights, expected):
    """A weighted sum: what is missing to 1 is black, what exceeds 1 is divided by the sum."""
    parts = "".join(f'<bsdf type="diffuse"><spectrum name="reflectance" value="{r}"/></bsdf>' for r in (0.2, 0.8))
    _, _, scene = convert(bsdf(f'<bsdf type="mixturebsdf"><string name="weights" value="{weights}"/>{parts}</bsdf>'))
    assert value(scene.shapes()[0].bsdf(), [0, 0, 1], [0, 0, 1]) == pytest.approx(expected / np.pi, rel=1e-5)


@pytest.mark.parametrize("p", [1.0, 25.0])
def test_the_dialects_phong(convert, p):
    """A single `reflectance` R is that of the highlight alone: f cos = R (p+1)/(2 pi) (r.v)^p."""
    _, _, scene = convert(bsdf(
        f'<bsdf type="phong"><rgb name="reflectance" value="0.2 0.4 0.6"/><float name="exponent" value="{p}"/></bsdf>'
    ))  # fmt: skip
    wi, wo = np.array([0.3, 0.1, 1.0]), np.array([-0.2, 0.1, 1.0])
    r = wo * [-1, -1, 1]
    lobe = (r @ wi / np.linalg.norm(r) / np.linalg.norm(wi)) ** p
    expected = np.array([0.2, 0.4, 0.6]) * (p + 1) / (2 * np.pi) * lobe
    assert value(scene.shapes()[0].bsdf(), wi, wo) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("p", [1.0, 25.0])
def test_the_dialects_blinn(convert, p):
    """f cos = R (p+2)/(4 pi (2 - 2^(-p/2))) (n.h)^p, of its Fresnel term the value at normal incidence; it says so."""
    result, _, scene = convert(bsdf(
        f'<bsdf type="blinn"><rgb name="reflectance" value="0.2 0.4 0.6"/><float name="exponent" value="{p}"/></bsdf>'
    ))  # fmt: skip
    wi, wo = np.array([0.3, 0.1, 1.0]), np.array([-0.2, 0.1, 1.0])
    h = wi / np.linalg.norm(wi) + wo / np.linalg.norm(wo)
    lobe = (h[2] / np.linalg.norm(h)) ** p
    expected = np.array([0.2, 0.4, 0.6]) * (p + 2) / (4 * np.pi * (2 - 2 ** (-p / 2))) * lobe
    assert value(scene.shapes()[0].bsdf(), wi, wo) == pytest.approx(expected, rel=1e-5)
    assert any("Schlick" in record.why for record in result.losses)


def test_blinn_with_two_reflectances(convert):
    """`blinn` in the words of 0.6's `phong` is `blinnphong`."""
    _, _, scene = convert(bsdf('<bsdf type="blinn"><float name="exponent" value="7"/></bsdf>'))
    surface = scene.shapes()[0].bsdf()
    norm = lobes.LOBES["blinnphong"].normalization(mi.Float(7))[0]
    expected = (0.5 / np.pi + 0.2 * norm) * 1
    assert type(surface).__name__ == "BlinnPhong"
    assert value(surface, [0, 0, 1], [0, 0, 1]) == pytest.approx(expected, rel=1e-4)


def test_the_dialects_texture(convert, tmp_path):
    """An image for `reflectance` is scaled, too."""
    images_of(tmp_path)
    convert(bsdf(f'<bsdf type="phong">{BITMAP.format("b.exr", "")}<float name="exponent" value="9"/></bsdf>'))
    assert images.read_exr(tmp_path / "new_files/b-scaled.exr")[0, 0] == pytest.approx([2.5] * 3)


# Files and parameters ------------------------------------------------------------------------------------


def test_includes(convert, tmp_path):
    """Included files are converted, too, and stand in the new scene; what they name is found beside them."""
    (tmp_path / "parts").mkdir()
    images_of(tmp_path / "parts")
    inside = f'<bsdf type="diffuse" id="b">{BITMAP.format("b.exr", "")}</bsdf>'
    (tmp_path / "parts/one.xml").write_text(f'<scene version="0.6.0"><default name="n" value="7"/>{inside}</scene>')
    result, text, _ = convert(
        '<include filename="parts/one.xml"/><integrator type="path"><integer name="maxDepth" value="$n"/></integrator>'
        + bsdf('<ref id="b"/>')
    )
    assert '<default name="n" value="7"/>' in text and "include" not in text
    assert '<string name="filename" value="parts/b.exr"/>' in text
    assert any(r.what == "<include> of 'parts/one.xml'" for r in result.changes)


def test_another_folder(tmp_path):
    """The new scene finds the old files from where it is."""
    (tmp_path / "in").mkdir(), (tmp_path / "out").mkdir()
    images_of(tmp_path / "in")
    old, new = tmp_path / "in/old.xml", tmp_path / "out/new.xml"
    old.write_text(
        f'<scene version="0.6.0">{bsdf(f"""<bsdf type="diffuse">{BITMAP.format("a.png", "")}</bsdf>""")}</scene>'
    )
    convert_scene(old, new)
    assert 'value="../in/a.png"' in new.read_text()
    mi.load_file(str(new))


def test_missing_files_are_told(convert, tmp_path):
    """A mesh that is not there: the file is named, with its line."""
    old = tmp_path / "old.xml"
    old.write_text(
        '<scene version="0.6.0">\n<shape type="obj"><string name="filename" value="no.obj"/></shape></scene>'
    )
    result = convert_scene(old, tmp_path / "new.xml")
    assert str(result.losses[1]) == "old.xml, line 2: file 'no.obj': there is no such file"


@pytest.mark.parametrize(
    ("inside", "model", "told"),
    [
        ("", "mtllib a.mtl\n", True),
        ("", "# no materials\n", False),
        ('<bsdf type="diffuse"/>', "mtllib a.mtl\n", False),
        ('<boolean name="loadMaterials" value="false"/>', "mtllib a.mtl\n", False),
    ],
)
def test_materials_of_a_model(convert, tmp_path, inside, model, told):
    """0.6 took them from the MTL file, Mitsuba 3 does not."""
    (tmp_path / "a.obj").write_text(model + "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    result, _, _ = convert(f'<shape type="obj"><string name="filename" value="a.obj"/>{inside}</shape>')
    assert [r.what for r in result.losses if "MTL" in r.what] == ["MTL materials of 'a.obj'"] * told


def test_aliases_and_references(convert):
    """References through an alias count as what they stand for."""
    _, _, scene = convert(
        '<bsdf type="diffuse" id="a"><spectrum name="reflectance" value="0.5"/></bsdf><alias id="a" as="b"/>'
        + bsdf('<bsdf type="mixturebsdf"><string name="weights" value="0.25, 0.25"/><ref id="a"/><ref id="b"/></bsdf>')
    )
    assert value(scene.shapes()[0].bsdf(), [0, 0, 1], [0, 0, 1]) == pytest.approx(0.25 / np.pi, rel=1e-5)


def test_a_parameter_where_a_number_is_needed(convert):
    """What cannot be computed without its value is an error that says so."""
    with pytest.raises(ConversionError, match=r"line 2: '\$p' is needed for the conversion"):
        convert(
            bsdf('<bsdf type="phong"><rgb name="reflectance" value="1"/><float name="exponent" value="$p"/></bsdf>')
        )


def test_the_whole_picture(convert):
    """A converted scene renders: the highlight of `phong` is brighter than its surroundings, and nothing is NaN."""
    light = (
        '<luminaire type="point"><point name="position" x="2" y="3" z="4"/>'
        '<spectrum name="intensity" value="40"/></luminaire>'
    )
    ball = bsdf(
        '<bsdf type="phong"><srgb name="diffuseReflectance" value="#c04020"/><float name="exponent" value="40"/></bsdf>'
    )
    _, _, scene = convert(light + ball + SENSOR, version="0.5.0")
    image = np.array(mi.render(scene, spp=4))
    assert np.isfinite(image).all() and image.max() > 3 * image[image > 0].mean()
