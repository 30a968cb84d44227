"""Many samples of a pixel: their sum is exact enough, and that of ordinary numbers of samples is what it was.

Radiance 0.1 everywhere is the worst kind of scene: each addition of a long sum in float32 rounds in the same direction.
"""

import json
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from click.testing import CliRunner

from helpers import SCENES
from phong_bsdf.checking import references
from phong_bsdf.cli import main
from phong_bsdf.pictures import images
from phong_bsdf.pictures.estimates import WeightedMean
from phong_bsdf.scene import rendering
from phong_bsdf.tracing import camera, sums

LECTURE = SCENES / "lecture"
VALUE = float(np.float32(0.1))

# The loss that is promised; float32 pictures of float32 weights alone may lose 1e-7.
LOSS, LOSS_BEYOND = 2e-6, 1e-5

SKY = """\
<scene version="3.0.0">
    <integrator type="{integrator}"/>
    <sensor type="perspective">
        <sampler type="{sampler}"/>
        <film type="hdrfilm">
            <integer name="width" value="{width}"/> <integer name="height" value="{height}"/>
            <string name="pixel_format" value="{format}"/> <rfilter type="{rfilter}"/>
        </film>
    </sensor>
    <emitter type="constant"><rgb name="radiance" value="0.1"/></emitter>
</scene>
"""


@pytest.fixture
def sky(tmp_path, monkeypatch):
    """A function that loads the scene; its file is sky.xml in the current folder."""
    monkeypatch.chdir(tmp_path)

    def load(integrator="whitted", rfilter="box", size=(16, 12), sampler="independent", format="rgba"):
        given = {"integrator": integrator, "rfilter": rfilter, "sampler": sampler, "format": format}
        text = SKY.format(width=size[0], height=size[1], **given)
        Path("sky.xml").write_text(text)
        return rendering.load(Path("sky.xml"))

    return load


def loss(image):
    """The largest relative error of a picture of the sky, and of its alpha, which is 1, or 0 with some integrators."""
    image = np.asarray(image, np.float64)
    alpha = image[..., 3:]
    return max(np.abs(image[..., :3] / VALUE - 1).max(), np.minimum(np.abs(alpha - 1), alpha).max(initial=0))


def command(*args):
    result = CliRunner().invoke(main, [*map(str, args)])
    assert (result.exit_code, result.stderr) == (0, ""), result.output
    return result.stdout


@pytest.mark.parametrize("rfilter", ["box", "gaussian", "tent", "mitchell", "catmullrom", "lanczos"])
@pytest.mark.parametrize("spp", [4096, 4099, 65536])
def test_whitted_by_itself(sky, rfilter, spp):
    """Through plain `mi.render`, with a grid and with a sampler, whatever the filter; with three channels Dr.Jit adds
    sample by sample, with four it adds up neighbours first."""
    for format in ("rgb", "rgba"):
        assert loss(mi.render(sky(rfilter=rfilter, format=format).scene, spp=spp)) < LOSS


@pytest.mark.parametrize("size", [(1, 1), (3, 300), (200, 7)])
def test_whitted_in_films_of_any_shape(sky, size):
    """Tiles of a block beside and above each other, some of them empty: they show the same as a rendering by few."""
    loaded = sky(rfilter="gaussian", size=size)
    assert loss(mi.render(loaded.scene, spp=33**2)) < LOSS


@pytest.mark.parametrize(
    ("rfilter", "spp"),
    [("box", 10**6), pytest.param("gaussian", 10**6, marks=pytest.mark.slow)],
)
def test_a_million_samples(sky, rfilter, spp):
    """Of each of 16 x 12 pixels."""
    assert loss(mi.render(sky(rfilter=rfilter).scene, spp=spp)) < LOSS


@pytest.mark.slow
@pytest.mark.parametrize("spp", [10**7, 10**8])
@pytest.mark.parametrize("integrator", ["whitted", "path"])
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_more_samples_than_anyone_needs(sky, integrator, rfilter, spp):
    """Of one pixel: more than a kernel should have lanes."""
    assert loss(rendering.render(sky(integrator, rfilter, (1, 1)), spp=spp).image) < LOSS_BEYOND


@pytest.mark.parametrize("integrator", ["path", "direct", "prb", "volpath"])
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_other_integrators(sky, integrator, rfilter):
    """Through the commands: in passes that are added up in double precision."""
    for format in ("rgb", "rgba"):
        for spp in (4096, 4099, 65536):
            made = rendering.render(sky(integrator, rfilter, (8, 6), format=format), spp=spp)
            assert (loss(made.image) < LOSS, made.spp) == (True, spp)


@pytest.mark.parametrize("integrator", ["path", "whitted"])
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_scalar_variants(sky, integrator, rfilter):
    """They add sample by sample, so fewer of them are too many."""
    mi.set_variant("scalar_rgb")
    loaded = sky(integrator, rfilter, (3, 2))
    for spp in (100, 101, 1024):
        assert loss(rendering.render(loaded, spp=spp).image) < LOSS


@pytest.mark.parametrize("variant", ["llvm_ad_mono", "llvm_ad_spectral"])
def test_other_variants(sky, variant):
    """Luminance, and colours from wavelengths, whose noise is left: alpha has none."""
    mi.set_variant(variant)
    image = np.asarray(mi.render(sky().scene, spp=16384), np.float64)
    if variant == "llvm_ad_mono":
        assert np.abs(image / VALUE - 1).max() < LOSS
    else:
        assert np.array_equal(image[..., 3], np.ones((12, 16)))
        # 16384 samples of four wavelengths leave 0.3 % of noise.
        assert image[..., :3].mean() == pytest.approx(VALUE, rel=0.1)


# Values that differ -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_a_grid_stays_a_grid(rfilter):
    """A picture of 128 x 128 samples is the mean of its 16 parts of 32 x 32, each of which one block can add up."""
    loaded = rendering.load(LECTURE / "mirror-floor.xml", {"width": "12", "height": "8"})
    film = {"type": "hdrfilm", "width": 12, "height": 8, "component_format": "float32", "rfilter": {"type": rfilter}}
    place = mi.ScalarTransform4f().look_at([0, 1.6, 8], [0, -0.25, 0], [0, 1, 0])
    sensor = mi.load_dict({"type": "perspective", "to_world": place, "film": film})
    integrator, parts = loaded.scene.integrator(), []
    whole = np.array(mi.render(loaded.scene, sensor=sensor, spp=128**2))
    side = 4 if rfilter == "box" else 8
    for shift in np.ndindex(side, side):
        integrator.part = side, shift
        parts.append(np.array(mi.render(loaded.scene, sensor=sensor, spp=(128 // side) ** 2), np.float64))
    integrator.part = camera.WHOLE
    wanted = np.mean(parts, axis=0)
    # A filter of the mean is not the mean of filtered pictures: the weights of the parts differ by their positions.
    bound = LOSS if rfilter == "box" else 2e-3
    assert np.abs(whole / wanted - 1)[wanted > 0.01].max() < bound


@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
@pytest.mark.parametrize("lanes", [96 * 1024, 5000])
def test_several_kernels(rfilter, lanes, monkeypatch):
    """More samples than a kernel should have, by sets or by pixels: the same picture, and the share done."""
    loaded = rendering.load(LECTURE / "mirror-floor.xml", {"width": "12", "height": "8"})
    place = mi.ScalarTransform4f().look_at([0, 1.6, 8], [0, -0.25, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 12, "height": 8, "rfilter": {"type": rfilter}}
    sensor = mi.load_dict({"type": "perspective", "to_world": place, "film": film})
    params = mi.traverse(loaded.scene)
    key = next(key for key in params.keys() if key.endswith("kd.value"))  # noqa: SIM118

    def made():
        picture = np.array(mi.render(loaded.scene, sensor=sensor, spp=65**2))
        dr.enable_grad(params[key])
        dr.set_grad(params[key], 1)
        return picture, np.array(loaded.scene.integrator().render_forward(loaded.scene, params, sensor, spp=65**2))

    whole, shares = made(), []
    monkeypatch.setattr(camera, "LANES", lanes)
    loaded.scene.integrator().on_progress = shares.append
    parts = made()
    # Sets of the box filter that lie in blocks of two threads may have another last bit (of values up to 2); of other
    # filters neighbours are added up in any order.
    bound = 2e-7 if rfilter == "box" else 3e-6
    assert np.abs(parts[0] - whole[0]).max() <= bound and whole[0].max() < 2
    # Derivatives of other filters are Mitsuba's own, which sums 4225 samples in float32.
    bound = 1e-6 if rfilter == "box" else 1e-4
    assert whole[1].any() and np.abs(parts[1] - whole[1]).max() <= bound * np.abs(whole[1]).max()
    assert len(shares) > 3 and shares == sorted(shares) and shares[-1] == 1


def test_random_samples_are_others_in_each_set(sky):
    """The noise of 4099 samples is that of 4099, not of a set that is used again and again."""
    loaded = rendering.load(LECTURE / "mirror-floor.xml", {"width": "12", "height": "8"})
    spread = []
    for spp in (1023, 16383):
        pictures = [np.array(mi.render(loaded.scene, spp=spp, seed=seed), np.float64) for seed in range(8)]
        spread.append(np.var(pictures, axis=0).mean())
        assert len({picture.tobytes() for picture in pictures}) == 8
    # Sixteen times the samples; eight pictures tell a variance of some 100 pixels to 20 %.
    assert spread[0] / spread[1] == pytest.approx(16, rel=0.5)


def test_crop_windows(sky):
    """A window shows what the whole picture has there."""
    loaded = rendering.load(LECTURE / "mirror-floor.xml", {"width": "30", "height": "20"})
    for rfilter in ("box", "gaussian"):
        film = {"type": "hdrfilm", "width": 30, "height": 20, "rfilter": {"type": rfilter}}
        place = mi.ScalarTransform4f().look_at([0, 1.6, 8], [0, -0.25, 0], [0, 1, 0])
        window = {"crop_offset_x": 11, "crop_offset_y": 5, "crop_width": 9, "crop_height": 7}
        whole, part = (
            np.array(mi.render(loaded.scene, sensor=mi.load_dict(
                {"type": "perspective", "to_world": place, "film": {**film, **crop}}), spp=48**2))
            for crop in ({}, window)
        )  # fmt: skip
        inner = np.abs(part - whole[5:12, 11:20])[2:-2, 2:-2]
        # Rays of a window are the same to a rounding, which decides for a sample in a thousand at an edge.
        assert inner.max() < 1e-3 and np.median(inner) < 1e-6


# As before ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rfilter", "format", "spp"),
    [("box", "rgba", 1024), ("box", "rgba", 1000), ("box", "rgb", 128), ("gaussian", "rgba", 256), ("tent", "rgb", 64)],
)
@pytest.mark.parametrize("integrator", ["whitted", "path"])
def test_ordinary_pictures_are_one_rendering(sky, integrator, rfilter, format, spp, monkeypatch):
    """Up to these numbers nothing is split: the same bits, seeds and time as ever."""
    loaded = sky(integrator, rfilter, format=format)
    made, render = [], rendering._render
    monkeypatch.setattr(rendering, "_render", lambda *args: made.append(args[2:]) or render(*args))
    monkeypatch.setattr(sums, "Sets", None)
    image = rendering.render(loaded, spp=spp, seed=5).image
    assert made == [(spp, 5)]
    # Filters that add up neighbours do so in any order.
    bound = 0 if rfilter == "box" and spp in (128, 1024) else 2e-6
    assert np.abs(image - np.array(mi.render(loaded.scene, spp=spp, seed=5))).max() <= bound


@pytest.mark.parametrize(
    ("sampler", "spp", "taken"),
    [("independent", 5000, 5000), ("stratified", 5000, 5041), ("ldsampler", 4000, 4096), ("multijitter", 4096, 4096)],
)
@pytest.mark.parametrize("integrator", ["path", "prb"])
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_samples_stay_what_they_are(sky, sampler, spp, taken, integrator, rfilter):
    """Of integrators that look along one ray: no sampler's set is split, and a picture has the noise that Mitsuba's own
    has of the same seed."""
    loaded = sky(integrator, rfilter, sampler=sampler, size=(5, 4))
    text = Path("sky.xml").read_text()
    ball = '<shape type="sphere"><point name="center" value="0, 0, 4"/></shape>'
    Path("sky.xml").write_text(text.replace("</scene>", f"{ball}</scene>"))
    loaded = rendering.load(Path("sky.xml"))
    assert rendering.samples_taken(loaded, 1, spp) == taken
    image = rendering.render(loaded, spp=spp, seed=3).image
    by_mitsuba = np.array(mi.render(loaded.scene, spp=spp, seed=3), np.float64)
    # What float32 loses of 5000 additions of the filter's small weights; another seed differs by some 1e-2.
    assert np.abs(image / by_mitsuba - 1).max() < 1e-4
    assert np.abs(image / np.array(mi.render(loaded.scene, spp=spp, seed=4)) - 1).max() > 1e-3


@pytest.mark.parametrize(("sampler", "rest"), [("independent", 904), ("stratified", 961)])
def test_others_go_in_passes(sky, sampler, rest, monkeypatch):
    """Integrators of another kind: each pass is a set of its own, of another seed; those that samplers round count as
    what they are, and the sampler is left as one rendering leaves it."""
    loaded = sky("ptracer", sampler=sampler, size=(3, 2))
    made, render = [], rendering._render
    monkeypatch.setattr(rendering, "_render", lambda *args: made.append(args[2:]) or render(*args))
    rendering.render(loaded, spp=5000, seed=3)
    passes = [1024] * 4 + [rest]
    assert [n for n, _ in made] == passes and len({seed for _, seed in made}) == len(passes)
    assert rendering.samples_taken(loaded, 1, 5000) == sum(passes)
    once = sky("path", sampler=sampler, size=(3, 2)).sensor(1).sampler()
    camera.samples_taken(once, 5000)
    assert loaded.sensor(1).sampler().sample_count() == once.sample_count()


def test_grids_of_large_pictures_stay_grids(monkeypatch):
    """With other filters than the box `whitted` makes its passes by itself: 2 x 2 samples are no four pixel centres."""
    loaded = rendering.load(LECTURE / "mirror-floor.xml", {"width": "30", "height": "20"})
    film = {"type": "hdrfilm", "width": 30, "height": 20, "rfilter": {"type": "gaussian"}}
    scene = mi.load_dict({"type": "scene", "integrator": {"type": "whitted"}, "sky": {"type": "constant"},
                          "ball": {"type": "sphere"}, "sensor": {"type": "perspective", "film": film,
                          "to_world": mi.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0])}})  # fmt: skip
    loaded = rendering.LoadedScene(Path("x.xml"), scene, rendering.WHITTED, 0.0)
    whole = rendering.render(loaded, spp=4).image
    monkeypatch.setattr(rendering, "SAMPLES_PER_PASS", 600)
    # The filter adds up in any order.
    assert np.abs(rendering.render(loaded, spp=4).image - whole).max() < 2e-6


# What uses them -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("integrator", ["path", "whitted"])
def test_commands(sky, integrator):
    """`render`, its passes and `merge` say how many samples they took, and lose no more."""
    sky(integrator, size=(4, 3))
    count = 16384
    command("render", "sky.xml", "-o", "a.exr", "--spp", count)
    command("render", "sky.xml", "-o", "b.exr", "--spp", count, "--passes", "p", "--pass-spp", 4096)
    command("merge", "p", "-o", "c.exr")
    for name in "abc":
        assert loss(images.read_exr(Path(f"{name}.exr"))) < LOSS
        assert json.loads(images.read_metadata(Path(f"{name}.exr"))["spp"]) == count


def test_references(sky):
    """What `render_check` stores and renders."""
    sky("path", size=(4, 3))
    options = references.Options(spp=65536, passes=4)
    references.update(Path("ref"), "sky.xml", options)
    assert loss(images.read_exr(Path("ref.exr"))) < LOSS
    assert references.check(Path("ref"), "sky.xml", options).verdict.passed


def test_added_channels(sky):
    """The channels of `aov` are added up with the rest: depth 0 and the colour of the sky."""
    sky("path", size=(4, 3))
    text = Path("sky.xml").read_text()
    inside = '<integrator type="path" name="img"/><string name="aovs" value="dd:depth"/>'
    Path("sky.xml").write_text(text.replace('"path"/>', f'"aov">{inside}</integrator>'))
    made = rendering.render(rendering.load(Path("sky.xml")), spp=20000)
    assert made.channels == (*"RGBA", "dd.T") and loss(made.image[..., :4]) < LOSS and not made.image[..., 4].any()


def test_derivatives(sky):
    """The derivative of the picture by a gain of 0.1, forward; backward Dr.Jit adds up by itself, to 3e-5."""
    scene = sky().scene
    params = mi.traverse(scene)
    key = next(key for key in params.keys() if "radiance" in key)  # noqa: SIM118
    dr.enable_grad(params[key])
    for spp in (4096, 4225, 65536):
        dr.set_grad(params[key], 0.1)
        change = np.array(scene.integrator().render_forward(scene, params, spp=spp), np.float64)
        assert np.abs(change[..., :3] / VALUE - 1).max() < LOSS and not change[..., 3:].any()
        dr.set_grad(params[key], 0)
        scene.integrator().render_backward(scene, params, dr.full(mi.TensorXf, 0.1, (12, 16, 4)), spp=spp)
        assert np.abs(np.array(dr.grad(params[key])) / (192 * VALUE) - 1).max() < 1e-4


def test_recordings(sky):
    """A frozen function renders many samples, too, and its second call the same."""
    scene = sky(size=(4, 3)).scene
    frozen = dr.freeze(lambda scene, seed: mi.render(scene, spp=4096, seed=seed))
    for seed in range(3):
        assert loss(frozen(scene, mi.UInt32(seed))) < LOSS


def test_weighted_mean():
    """Pictures of a hundred million samples each, in double precision."""
    mean = WeightedMean()
    for _ in range(1000):
        mean.add(np.full((2, 2, 3), 0.1, np.float32), 10**8)
    assert np.abs(mean.image() / VALUE - 1).max() < 1e-7 and mean.samples == 10**11
    assert mean.relative_error() < 1e-6


def test_error_of_the_colour_alone():
    """Channels beside the colour, as a depth of 1000, do not change what error is told."""
    rng = np.random.default_rng(0)
    pictures = rng.uniform(0, 1, (6, 4, 5, 4)).astype(np.float32)
    colour, all_of_it = WeightedMean(), WeightedMean(judged=[0, 1, 2])
    for picture in pictures:
        colour.add(picture[..., :3], 16)
        all_of_it.add(picture * [1, 1, 1, 1000], 16)
    assert all_of_it.relative_error() == pytest.approx(colour.relative_error(), rel=1e-12)
