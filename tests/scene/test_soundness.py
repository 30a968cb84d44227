"""What a scene says and no picture would show is said: by the commands as an error, by `whitted` as one warning."""

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from click.testing import CliRunner

from helpers.messages import messages
from helpers.small_scenes import PHONG, film, look, point
from phong_bsdf.cli import main
from phong_bsdf.scene import rendering, soundness
from phong_bsdf.tracing import needs

# Tests refer to line 10, on which stands what they put in.
SCENE = """\
<scene version="3.0.0">
    <default name="integrator" value="whitted"/>
    <integrator type="$integrator"/>
    <sensor type="perspective">
        <transform name="to_world"><lookat origin="0,0,6" target="0,0,0" up="0,1,0"/></transform>
        <film type="hdrfilm">
            <integer name="width" value="8"/> <integer name="height" value="8"/> <rfilter type="box"/>
        </film> <sampler type="independent"><integer name="sample_count" value="1"/></sampler>
    </sensor>
    {}
    <shape type="sphere"/> <emitter type="point"><point name="position" x="2" y="3" z="4"/></emitter>
</scene>
"""
SHEAR = '<matrix value="1 0.5 0 0  0 1 0 0  0 0 1 0  0 0 0 1"/>'
FOG = '<medium type="homogeneous" name="interior"/>'
ELLIPSOID = """\
ply
format ascii 1.0
element vertex 1
{}
end_header
0 0 0 0 0 0 {} {} {} 1 0 0 0
"""


@pytest.fixture
def load(tmp_path):
    """load(elements, **defines) -> the scene in which they stand on line 10."""

    def run(elements, **defines):
        path = tmp_path / "scene.xml"
        path.write_text(SCENE.format(elements))
        return rendering.load(path, defines)

    return run


@pytest.fixture
def refusal(load):
    """refusal(elements) -> the sentence of the error, without its place, which must be line 10."""

    def run(elements, **defines):
        with pytest.raises(rendering.SceneError) as error:
            load(elements, **defines)
        place, _, said = str(error.value).partition(": ")
        assert place.endswith("scene.xml, line 10")
        return said

    return run


def shape(plugin, transform="", inside="", name="it"):
    transform = f'<transform name="to_world">{transform}</transform>' if transform else ""
    return f'<shape type="{plugin}" id="{name}">{transform}{inside}</shape>'


# Shapes whose proportions Mitsuba keeps ------------------------------------------------------------------


@pytest.mark.parametrize("integrator", ("whitted", "path", "direct"))
@pytest.mark.parametrize(
    ("transform", "axes"),
    [
        ('<scale x="2"/>', "2, 1, 1"),
        ('<scale x="2" y="2" z="0.5"/><rotate y="1" angle="30"/>', "2, 2, 0.5"),
        ('<rotate z="1" angle="45"/><scale y="3"/>', "3, 1, 1"),
        (SHEAR, "1.28078, 1, 0.780776"),
        ('<scale x="1.01"/>', "1.01, 1, 1"),
    ],
)
def test_a_stretched_sphere_is_refused(refusal, transform, axes, integrator):
    """By any integrator; the sentence names the shape, the axes that were asked for, and what draws them."""
    said = refusal(shape("sphere", transform), integrator=integrator)
    assert said.startswith("sphere 'it': 'to_world' must scale all directions alike, got axes of lengths " + axes)
    assert said.endswith(needs.ELLIPSOIDS)


@pytest.mark.parametrize(
    "transform", ('<scale value="2"/>', '<rotate x="1" angle="33"/><translate x="1"/>', '<scale x="1.00001"/>')
)
def test_a_sphere_that_stays_one_is_not(load, transform):
    """Nor is one whose axes differ by the last digits that exporters write."""
    load(shape("sphere", transform))


def test_every_variant_refuses(load, any_variant):
    """What is wrong does not depend on how it is rendered."""
    for elements in (shape("sphere", SHEAR), NUMBERS["intensity of a spectrum"].format("nan"), shape("cube", "", FOG)):
        with pytest.raises(rendering.SceneError, match=", line 10: "):
            load(elements)


def test_spheres_in_groups_are_looked_at(refusal):
    """A stretched sphere inside of a group is as round as any."""
    refusal(f'<shape type="shapegroup">{shape("sphere", SHEAR)}</shape>')


@pytest.mark.parametrize("plugin", ("bsplinecurve", "linearcurve", "ellipsoids"))
def test_other_shapes_that_keep_their_proportions(refusal, load, tmp_path, plugin):
    """Curves, whose cross-section stays round, and ellipsoids from files; scaled evenly all of them load."""
    (tmp_path / "curve.txt").write_text("".join(f"{x} 0 0 0.3\n" for x in (-2, -1, 1, 2)))
    ellipsoid(tmp_path / "one.ply", (1, 1, 1))
    file = {"ellipsoids": "one.ply"}.get(plugin, "curve.txt")
    inside = f'<string name="filename" value="{file}"/>'
    assert "'to_world' must scale all directions alike" in refusal(shape(plugin, SHEAR, inside))
    load(shape(plugin, '<scale value="2"/>', inside))


@pytest.mark.parametrize("transform", ('<scale x="2"/>', SHEAR, '<rotate y="1" angle="50"/><scale y="2" z="3"/>'))
@pytest.mark.parametrize("plugin", ("cylinder", "disk", "rectangle", "cube"))
def test_shapes_that_are_drawn_as_stretched(load, plugin, transform):
    """These load, and their distances along rays are those of the shape before, in the coordinates before."""
    scene = load(shape(plugin, transform)).scene
    plain = mi.load_dict({"type": "scene", "shape": {"type": plugin}})
    stretched = next(s for s in scene.shapes() if s.id() == "it")
    matrix = matrix_of(transform)
    n = 4096
    rng = np.random.default_rng(0)
    origins = rng.normal(size=(3, n))
    origins *= 9 / np.linalg.norm(origins, axis=0)
    directions = rng.uniform(-2, 2, (3, n)) - origins
    directions /= np.linalg.norm(directions, axis=0)
    back = np.linalg.inv(matrix)
    expected = plain.ray_intersect(mi.Ray3f(mi.Point3f(back @ origins), mi.Vector3f(back @ directions))).t.numpy()
    alone = mi.load_dict({"type": "scene", "shape": stretched})
    found = alone.ray_intersect(mi.Ray3f(mi.Point3f(origins), mi.Vector3f(directions))).t.numpy()
    hit = np.isfinite(expected) & np.isfinite(found)
    assert hit.sum() > 100
    # Rays that pass an edge within a rounding.
    assert np.sum(np.isfinite(expected) != np.isfinite(found)) <= 4
    # Roots at grazing incidence, in float32.
    assert found[hit] == pytest.approx(expected[hit], abs=2e-3)


def matrix_of(transform):
    """The 3 x 3 matrix of a transform, as Mitsuba's parser reads it."""
    config = mi.parser.ParserConfig(str(mi.variant()))
    state = mi.parser.parse_string(config, f'<scene version="3.0.0">{shape("cube", transform)}</scene>')
    node = next(node for node in state.nodes if node.props.plugin_name() == "cube")
    return np.array(node.props["to_world"].matrix)[:3, :3]


def ellipsoid(path, axes):
    """A file of the shape `ellipsoids`, which holds the logarithms of the axes."""
    names = ["x", "y", "z", "nx", "ny", "nz", *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]
    properties = "\n".join(f"property float {name}" for name in names)
    path.write_text(ELLIPSOID.format(properties, *map(math.log, axes)))


def test_the_remedy_is_drawn_right(load, tmp_path):
    """`ellipsoids` with extent 1 under `whitted`: the outline is that of the ellipsoid, pixel by pixel."""
    ellipsoid(tmp_path / "one.ply", (1.5, 0.8, 0.6))
    inside = (
        '<string name="filename" value="one.ply"/><float name="extent" value="1"/>'
        '<bsdf type="phong"><float name="kd" value="1"/></bsdf>'
    )
    loaded = load(shape("ellipsoids", "", inside))
    hit = next(s for s in loaded.scene.shapes() if s.id() == "it")
    scene = mi.load_dict({
        "type": "scene", "integrator": {"type": "whitted", "ambient": 1.0}, "shape": hit,
        "sensor": {**look([0, 0, 6], [0, 0, 0], 64, spp=1), "film": film(64)},
    })  # fmt: skip
    seen = np.array(mi.render(scene))[:, :, 0] > 0
    y, x = np.divmod(np.arange(64**2), 64)
    centers = mi.Point2f((np.stack([x, y]) + 0.5) / 64)
    ray, _ = scene.sensors()[0].sample_ray(0, 0, centers, mi.Point2f(0))
    o, d = np.array(ray.o) / [[1.5], [0.8], [0.6]], np.array(ray.d) / [[1.5], [0.8], [0.6]]
    inside = np.sum(o * d, axis=0) ** 2 > np.sum(d * d, axis=0) * (np.sum(o * o, axis=0) - 1)
    assert seen.sum() > 200
    assert np.array_equal(seen.ravel(), inside)


@pytest.mark.parametrize(
    ("elements", "said"),
    [
        (shape("sphere", "", '<float name="radius" value="0"/>'), "sphere 'it': 'radius' must be > 0, got 0"),
        (shape("sphere", "", '<float name="radius" value="-2"/>'), "sphere 'it': 'radius' must be > 0, got -2"),
        (shape("cylinder", "", '<float name="radius" value="-2"/>'), "cylinder 'it': 'radius' must be > 0, got -2"),
        (shape("cylinder", "", '<point name="p1" x="0" y="0" z="0"/><point name="p0" x="0" y="0" z="0"/>'),
         "cylinder 'it': 'p0' and 'p1' must not be the same point"),
        (shape("sphere", '<scale value="0"/>'), "sphere 'it': 'to_world' must not flatten it, got axes of 0, 0, 0"),
        (shape("disk", '<scale z="0"/>'), "disk 'it': 'to_world' must not flatten it, got axes of 1, 1, 0"),
        (shape("rectangle", '<scale x="0" z="0"/>'), "rectangle 'it': 'to_world' must not flatten it"),
    ],
)  # fmt: skip
def test_shapes_that_nobody_would_see(refusal, elements, said):
    """Shapes without extent, for which Mitsuba renders nothing, or fails without a line."""
    assert refusal(elements).startswith(said)


# Numbers that are none -----------------------------------------------------------------------------------

# Element and name of the parameter, with a place for the number.
NUMBERS = {
    "intensity": '<emitter type="point"><float name="intensity" value="{}"/></emitter>',
    "intensity of a colour": '<emitter type="spot"><rgb name="intensity" value="1 {} 1"/></emitter>',
    "intensity of a spectrum": '<emitter type="point"><spectrum name="intensity" value="400:1, 700:{}"/></emitter>',
    "irradiance": '<emitter type="directional"><rgb name="irradiance" value="{} 0 0"/></emitter>',
    "radiance": '<emitter type="constant"><rgb name="radiance" value="{}"/></emitter>',
    "position": '<emitter type="point"><point name="position" x="{}" y="0" z="0"/></emitter>',
    "direction": '<emitter type="directional"><vector name="direction" x="0" y="{}" z="0"/></emitter>',
    "cutoff_angle": '<emitter type="spot"><float name="cutoff_angle" value="{}"/></emitter>',
    "to_world of a light": '<emitter type="spot"><transform name="to_world"><translate x="{}"/></transform></emitter>',
    "to_world": shape("rectangle", '<scale x="{}"/>'),
    "radius": shape("sphere", "", '<float name="radius" value="{}"/>'),
    "center": shape("sphere", "", '<point name="center" x="0" y="0" z="{}"/>'),
    "reflectance": shape("sphere", "", '<bsdf type="diffuse"><rgb name="reflectance" value="{} 0 0"/></bsdf>'),
    "alpha": shape("sphere", "", '<bsdf type="roughplastic"><float name="alpha" value="{}"/></bsdf>'),
    "fov": '<sensor type="perspective"><float name="fov" value="{}"/><film type="hdrfilm"/></sensor>',
}


@pytest.mark.parametrize("number", ("nan", "inf", "-inf", "1e39"))
@pytest.mark.parametrize("what", NUMBERS)
def test_numbers_that_are_not_finite(refusal, what, number):
    """Wherever they stand, also those that float32 does not hold: with line, name, and value."""
    said = refusal(NUMBERS[what].format(number))
    assert f"'{what.split(' of ')[0]}' must be finite, got" in said
    assert f"{float(number):g}" in said


def test_a_direction_of_length_zero(refusal):
    """It lights nothing."""
    said = refusal('<emitter type="directional"><vector name="direction" x="0" y="0" z="0"/></emitter>')
    assert said.startswith("directional: 'direction' must not be zero")


@pytest.mark.parametrize("number", ("nan", "inf"))
def test_the_packages_own_bsdfs_say_their_range(refusal, number):
    """As before: they know more than that a number has to be finite."""
    assert "phong: 'kd' must be finite and >= 0" in refusal(
        f'<shape type="cube"><bsdf type="phong"><float name="kd" value="{number}"/></bsdf></shape>'
    )


@pytest.mark.parametrize("value", (np.nan, np.inf, -np.inf))
@pytest.mark.parametrize("light", ("envmap", "projector"))
def test_images_of_lights(refusal, tmp_path, light, value):
    """One texel is enough, whether the picture shows it or not."""
    image = np.ones((8, 16, 3), np.float32)
    image[3, 4, 1] = value
    mi.Bitmap(image).write(str(tmp_path / "sky.exr"))
    name = '<string name="filename" value="sky.exr"/>'
    inside = name if light == "envmap" else f'<texture type="bitmap" name="irradiance">{name}</texture>'
    said = refusal(f'<emitter type="{light}">{inside}</emitter>')
    assert said.startswith(f"{light}: its image must be finite, got NaN or infinity in ")


@pytest.mark.parametrize("light", ("directional", "projector", "envmap"))
def test_lights_that_a_scale_would_change(refusal, load, tmp_path, light):
    """Their brightness or picture would change with the scale of `to_world`; turned ones load."""
    mi.Bitmap(np.ones((8, 16, 3), np.float32)).write(str(tmp_path / "sky.exr"))
    inside = {"envmap": '<string name="filename" value="sky.exr"/>', "projector": '<texture type="checkerboard" '
              'name="irradiance"/>'}.get(light, "")  # fmt: skip
    lamp = f'<emitter type="{light}">{inside}<transform name="to_world">{{}}</transform></emitter>'
    assert f"{light}: 'to_world' must not scale, got a scale of 2" in refusal(lamp.format('<scale value="2"/>'))
    load(lamp.format('<rotate x="0.6" y="0.8" angle="40"/><translate x="3"/>'))


# Media ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "elements",
    [
        shape("sphere", "", FOG),
        shape("cube", "", FOG.replace("interior", "exterior")),
        '<medium type="homogeneous" id="fog"/>' + shape("sphere", "", '<ref id="fog" name="interior"/>'),
        '<sensor type="perspective"><medium type="homogeneous"/><film type="hdrfilm"/></sensor>',
        f'<shape type="shapegroup">{shape("cube", "", FOG)}</shape>',
    ],
)
def test_media_are_refused_under_whitted(refusal, load, elements):
    """Inside or outside of shapes, and around the camera; `volpath` takes them."""
    said = refusal(elements)
    assert "must be empty under 'whitted', got a 'homogeneous' medium" in said and said.endswith(needs.VOLPATH)
    load(elements, integrator="volpath")


def test_a_medium_that_fills_nothing_is_no_loss(load):
    """It is in no picture of any integrator."""
    load('<medium type="homogeneous" id="fog"/>')


def test_integrators_inside_of_others_are_found(refusal):
    """Under `aov` it is still `whitted` that leaves the medium out."""
    inner = '<integrator type="aov"><string name="aovs" value="d:depth"/><integrator type="whitted"/></integrator>'
    text = SCENE.replace('<integrator type="$integrator"/>', inner)
    text = text.replace('<default name="integrator" value="whitted"/>', "")
    config = mi.parser.ParserConfig(str(mi.variant()))
    state = mi.parser.parse_string(config, text.format(shape("sphere", "", FOG)))
    mi.parser.transform_all(config, state)
    assert "must be empty under 'whitted'" in soundness.wrong(state)


def test_path_is_told_to_ignore_media(load):
    """The commands warn where Mitsuba's own integrators leave the media out."""
    with messages() as said:
        load(shape("sphere", "", FOG), integrator="path")
    assert sum("does not render the scene's media" in text for text in said) == 1


@pytest.mark.parametrize("command", ("render", "explain", "compare", "converge", "check", "sweep"))
def test_commands_end_with_2(tmp_path, command):
    """All that render a scene refuse it before they do, with one sentence, and write nothing."""
    scene = tmp_path / "scene.xml"
    scene.write_text(SCENE.format(shape("sphere", SHEAR)))
    mi.Bitmap(np.ones((8, 8, 3), np.float32)).write(str(tmp_path / "mine.exr"))
    scene, out = str(scene), str(tmp_path / "out.exr")
    arguments = {
        "render": [scene, "-o", out], "explain": [scene], "check": [str(tmp_path / "mine.exr"), scene],
        "compare": [scene, "-o", str(tmp_path / "out")], "converge": [scene, "-o", str(tmp_path / "out")],
        "sweep": [scene, "-D", "integrator=whitted,path", "-o", str(tmp_path / "out")],
    }[command]  # fmt: skip
    result = CliRunner().invoke(main, [command, *arguments])
    assert result.exit_code == 2, result.output
    assert "scene.xml, line 10: sphere 'it': 'to_world' must scale all directions alike" in result.stderr
    assert not list(tmp_path.glob("out*/*.exr")) and not (tmp_path / "out.exr").exists()


# Loaded by Mitsuba ---------------------------------------------------------------------------------------


def scene_of(**objects):
    lamp = {"lamp": point([2, 3, 4])}
    return {
        "type": "scene", "integrator": {"type": "whitted"}, "sensor": look([0, 0, 6], [0, 0, 0], 8), **lamp, **objects,
    }  # fmt: skip


def stretched():
    return {"type": "sphere", "to_world": mi.ScalarTransform4f().scale([2, 1, 1]), "bsdf": PHONG}


@pytest.mark.parametrize("inside", ("shape", "group"))
def test_whitted_warns_once_of_a_stretched_sphere(any_variant, inside):
    """Once for each scene, whatever is rendered of it; in every variant, inside of groups too."""
    ball = {"ball": stretched()}
    if inside == "group":
        one = {"type": "instance", "group": {"type": "ref", "id": "group"}}
        ball = {"group": {"type": "shapegroup", **ball}, "one": one}
    scenes = [mi.load_dict(scene_of(**ball)) for _ in range(2)]
    with messages() as said:
        for scene in scenes:
            for seed in range(3):
                mi.render(scene, seed=seed)
    assert sum("whitted: Mitsuba draws sphere 'ball' round, though stretched" in text for text in said) == 2


def test_whitted_warns_once_of_media():
    """Those of shapes and of the camera, in one sentence."""
    fog = {"type": "homogeneous"}
    scene = scene_of(ball={"type": "sphere", "interior": fog})
    scene["sensor"]["medium"] = fog
    scene = mi.load_dict(scene)
    with messages() as said:
        for _ in range(2):
            mi.render(scene)
    assert len([text for text in said if "the medium of" in text]) == 1
    assert any("'ball', 'sensor' is not rendered" in text and needs.VOLPATH in text for text in said)


def test_whitted_warns_of_media_in_groups():
    """What instances hold is not listed by the scene, and is looked at all the same."""
    ball = {"type": "sphere", "id": "ball", "interior": {"type": "homogeneous"}}
    one = {"type": "instance", "group": {"type": "ref", "id": "group"}}
    scene = mi.load_dict(scene_of(group={"type": "shapegroup", "ball": ball}, one=one))
    with messages() as said:
        mi.render(scene)
    assert len([text for text in said if "the medium of 'ball'" in text]) == 1


def test_nothing_is_said_of_other_scenes():
    """Nor is anything looked at in functions that are recorded: the warning comes with the next rendering."""
    with messages() as said:
        mi.render(mi.load_dict(scene_of(ball={"type": "sphere", "bsdf": PHONG})))
    assert not [text for text in said if "whitted" in text]
    scene = mi.load_dict(scene_of(ball=stretched()))
    frozen = dr.freeze(lambda scene, seed: mi.render(scene, seed=seed))
    with messages() as said:
        for seed in range(3):
            frozen(scene, mi.UInt32(seed))
        assert not [text for text in said if "whitted" in text]
        mi.render(scene)
    assert len([text for text in said if "whitted" in text]) == 1


BAD = {
    "intensity": lambda x: {"type": "point", "intensity": x},
    "intensity of a colour": lambda x: {"type": "point", "intensity": {"type": "rgb", "value": [0.2, x, 0]}},
    "position": lambda x: {"type": "point", "position": [0, x, 0]},
    "to_world": lambda x: {"type": "directional", "direction": [0, x, 0]},
    "cutoff_angle": lambda x: {"type": "spot", "cutoff_angle": x},
    "radiance": lambda x: {"type": "constant", "radiance": x},
}


def why(action):
    """The message of the error that `action` ends with, without Dr.Jit's around it."""
    with pytest.raises((RuntimeError, ValueError)) as caught:
        action()
    error = caught.value
    while error.__cause__ is not None:
        error = error.__cause__
    return str(error)


@pytest.mark.parametrize("number", (math.nan, math.inf))
@pytest.mark.parametrize("variant", ("llvm_ad_rgb", "llvm_ad_mono", "scalar_rgb"))
@pytest.mark.parametrize("what", BAD)
def test_whitted_refuses_lights_that_are_not_finite(what, variant, number):
    """Those of scenes that the package did not load, too: they would light nothing, without a word."""
    mi.set_variant(variant)
    mi.set_log_level(mi.LogLevel.Error)
    scene = mi.load_dict(scene_of(ball={"type": "sphere"}, bad=BAD[what](number)))
    assert f"whitted: '{what.partition(' of ')[0]}' of the light 'bad' must be finite" in why(lambda: mi.render(scene))


@pytest.mark.parametrize("key", ("lamp.intensity.value", "lamp.position"))
def test_whitted_refuses_lights_that_became_not_finite(key):
    """After an update too; and what it renders once they are mended is the picture from before."""
    scene = mi.load_dict(scene_of(ball={"type": "sphere"}))
    before = np.array(mi.render(scene))
    params = mi.traverse(scene)
    good = type(params[key])(params[key])
    params[key] = type(good)(math.nan)
    params.update()
    assert "must be finite, got nan" in why(lambda: mi.render(scene))
    params[key] = good
    params.update()
    assert np.array_equal(np.array(mi.render(scene)), before)
