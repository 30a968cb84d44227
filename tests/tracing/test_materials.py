"""Kernels without what a scene does not need show what the general ones show, bit by bit."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from helpers.bsdfs import mirror
from helpers.small_scenes import BLINN, PHONG, POINTS, SUN, balls
from phong_bsdf.tracing.materials import Table
from phong_bsdf.tracing.needs import FEATURES, REQUIRED

BRIGHT = {"type": "blinnphong", "diffuse_reflectance": 0.9, "specular_reflectance": 0.8, "exponent": 10.0}
NORMALIZED = {"type": "phong", "diffuse_reflectance": 0.2, "specular_reflectance": 0.3, "exponent": 3.0}
CHECKS = {"type": "checkerboard", "color0": {"type": "rgb", "value": [0.1, 0.9, 0.4]}, "color1": 0.7}
BITMAP = {
    "type": "bitmap", "raw": True,
    "bitmap": mi.Bitmap(np.random.default_rng(5).uniform(0, 300, (8, 8, 1)).astype(np.float32)),
}  # fmt: skip
GREY = {"diffuse_reflectance": {"type": "checkerboard", "color0": 0.2, "color1": 0.9}}


SCENES = {
    "one": ([PHONG], SUN),
    "both lobes": ([PHONG, BLINN], POINTS),
    "mirrors": ([mirror(PHONG), BLINN, mirror(BLINN, 1.0), mirror(PHONG, {"type": "rgb", "value": [0, 0.5, 1]})], SUN),
    "vocabularies": ([PHONG, BRIGHT, NORMALIZED, mirror(BRIGHT)], {**SUN, "point": POINTS["light 0"]}),
    "textures": (
        [{**PHONG, "kd": CHECKS}, BLINN, mirror({**BLINN, "p": BITMAP, "ks": CHECKS}, CHECKS), {**BRIGHT, **GREY}],
        POINTS,
    ),
    "one texture": ([{**PHONG, "p": BITMAP}], SUN),
    "no highlight": ([{"type": "phong", "ks": 0}, {"type": "blinnphong", "ks": 0, "kd": 0.2}], SUN),
    "highlight only": ([{"type": "phong", "kd": 0}, {"type": "phong", "kd": 0, "p": 0}], SUN),
    "black": ([{"type": "phong", "kd": 0, "ks": 0}], SUN),
    "no light": ([mirror(PHONG)], {"sky": {"type": "constant"}}),
    "no surface": ([], SUN),
}


def differences(name, keeps, **options):
    """Largest relative difference of a picture to the specialised one, for each set of features kept."""
    bsdfs, lights = SCENES[name]
    if bsdfs:
        loaded = balls(bsdfs, lights, **options)
    else:
        sensor = {"type": "perspective", "film": {"type": "hdrfilm", "width": 8, "height": 8}}
        loaded = mi.load_dict({"type": "scene", "integrator": {"type": "whitted"}, "sensor": sensor, **lights})
    pictures = []
    for keep in ((), *keeps):
        loaded.integrator().keep = frozenset(keep)
        pictures.append(np.array(mi.render(loaded)))
    reference = pictures[0]
    assert name in ("black", "no surface") or options == {"max_depth": 2} or reference.max() > 0
    return [np.max(np.abs(p - reference) / np.maximum(reference, 1e-30)) for p in pictures[1:]]


@pytest.mark.parametrize(
    "options", ({}, {"convention": "physical"}, {"ambient": 0.3}, {"max_depth": 2}, {"max_depth": -1})
)
@pytest.mark.parametrize("name", SCENES)
def test_general_kernels_show_the_same(name, options):
    """Bit by bit where BSDFs are called; with everything there for nothing but for the rounding of an ambient term."""
    called, general = differences(name, ({"bsdf calls"}, set(FEATURES)), **options)
    assert called == 0
    assert general <= (2e-7 if options.get("ambient") else 0)


@pytest.mark.parametrize("feature", FEATURES)
def test_each_feature_alone_changes_nothing(feature):
    """Whatever a kernel could leave out, and holds."""
    for name in ("both lobes", "mirrors", "no highlight", "vocabularies"):
        (difference,) = differences(name, [{feature, *REQUIRED.get(feature, ())}])
        assert difference == 0


@pytest.mark.parametrize(
    "bsdf",
    [
        {"type": "diffuse"},
        {"type": "twosided", "b": PHONG},
        {"type": "mask", "opacity": 0.5, "b": PHONG},
        mirror({"type": "diffuse"}),
        mirror(mirror(PHONG)),
    ],
)
def test_other_bsdfs_are_called(bsdf):
    """Then the scene is no table."""
    assert Table().of(balls([PHONG, bsdf], SUN)) is None


def test_updates_are_seen():
    """A constant that is changed, and one that a frozen function changes."""
    loaded, general = (balls([PHONG, mirror(BLINN)], SUN, specialize=flag) for flag in (True, False))
    keys = [key for key in mi.traverse(loaded).keys() if key.endswith(("kd.value", "km.value", ".p.value"))]  # noqa: SIM118
    assert len(keys) == 5

    def change(scene, x):
        params = mi.traverse(scene)
        for key in keys:
            params[key] = type(params[key])(x)
        params.update()

    before = np.array(mi.render(loaded))
    for x in (0.3, 0.7):
        change(loaded, x)
        change(general, x)
        after = np.array(mi.render(loaded))
        assert np.array_equal(after, np.array(mi.render(general))) and not np.array_equal(after, before)

    @dr.freeze
    def frozen(scene, x):
        change(scene, x)
        return mi.render(scene)

    for x in (0.2, 0.5, 0.9):
        picture = np.array(frozen(loaded, mi.Float(x)))
        change(general, x)
        assert np.array_equal(picture, np.array(mi.render(general)))
        assert np.array_equal(picture, np.array(mi.render(loaded)))


def test_scenes_that_share_bsdfs():
    """The same BSDFs on other shapes, whose numbers are others, rendered in turn by one integrator."""
    bsdfs = [mi.load_dict(bsdf) for bsdf in (PHONG, BLINN, mirror(PHONG))]
    integrator = mi.load_dict({"type": "whitted"})
    first, second = balls(bsdfs, SUN), balls(bsdfs, SUN)
    expected = np.array(mi.render(first))
    for loaded in (first, second, first):
        assert np.array_equal(np.array(mi.render(loaded, integrator=integrator)), expected)


def operations(scene):
    """Operations of the largest kernel of a rendering, and how many kernels were compiled by rendering again."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        dr.eval(mi.render(scene))
        largest = max(k["operation_count"] for k in dr.kernel_history() if "operation_count" in k)
        dr.kernel_history_clear()
        dr.eval(mi.render(scene))
        again = [k for k in dr.kernel_history() if "operation_count" in k]
    return largest, len(again), sum(not k["cache_hit"] for k in again)


def test_kernels_hold_what_the_scene_needs():
    """A diffuse scene's kernel has at most 60 % of the general one's operations, and is all that a frame runs."""
    diffuse = [{"type": "phong", "ks": 0}]
    size, kernels, compiled = operations(balls(diffuse, SUN))
    assert (kernels, compiled) == (1, 0)
    mirrored = [PHONG, mirror(BLINN)]
    assert size <= 0.6 * operations(balls(mirrored, {**SUN, "point": POINTS["light 0"]}, specialize=False))[0]
    assert operations(balls(mirrored, SUN))[0] < operations(balls(mirrored, SUN, specialize=False))[0]


def test_values_are_no_part_of_the_kernel():
    """Other constants, and more materials and lights, are the same kernel."""
    three = [PHONG, *[BLINN] * 9, mirror(BLINN)]
    operations(balls(three, POINTS))
    for bsdfs, lights in (
        ([{**PHONG, "p": 3, "ks": 0.9}, *[{**BLINN, "kd": 0.1}] * 9, mirror({**BLINN, "p": 7}, 0.2)], POINTS),
        (three, {**POINTS, "another": {"type": "point", "position": [3, 3, 3]}}),
        ([PHONG, *[{**BLINN, "p": 10 + i} for i in range(9)], mirror(BLINN)], POINTS),
    ):
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            dr.eval(mi.render(balls(bsdfs, lights)))
            assert all(k["cache_hit"] for k in dr.kernel_history() if k.get("operation_count", 0) > 200)


@pytest.mark.parametrize(
    "film",
    [
        {"pixel_format": "rgb"},
        {"pixel_format": "rgba"},
        {"pixel_format": "luminance"},
        {"crop_width": 20, "crop_height": 9, "crop_offset_x": 7, "crop_offset_y": 30},
    ],
)
def test_pixels_written_directly_are_the_film(film):
    """Without a film's block: the same picture, and the film holds it for those who develop it later."""
    pictures = []
    for flag in (True, False):
        loaded = balls([PHONG], SUN, specialize=flag)
        sensor = mi.load_dict({
            "type": "perspective", "to_world": mi.ScalarTransform4f().look_at([0, 2, 8], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 48, "height": 48, "rfilter": {"type": "box"}, **film},
            "sampler": {"type": "independent", "sample_count": 1},
        })  # fmt: skip
        pictures += [np.array(mi.render(loaded, sensor=sensor)), np.array(sensor.film().develop())]
    for picture in pictures[1:]:
        assert picture.shape == pictures[0].shape and np.array_equal(picture, pictures[0])


@pytest.mark.parametrize("specialize", (True, False))
@pytest.mark.parametrize(("before", "after"), [(0.3, 0.9), (0.0, 0.4), (0.5, 0.0)])
def test_shared_textures_are_followed(before, after, specialize):
    """Mitsuba tells one of the BSDFs that share a texture of its change; the others look themselves."""

    def build(value):
        shared = {"type": "ref", "id": "shared"}
        bsdfs = [
            {"type": "phong", "diffuse_reflectance": shared, "specular_reflectance": 0.5},
            {"type": "blinnphong", "kd": shared, "ks": 0.1},
            {"type": "blinnphong", "diffuse_reflectance": shared, "specular_reflectance": 0.6},
            mirror({"type": "phong", "kd": 0.2, "ks": shared}),
        ]
        return balls(
            bsdfs, {"shared": {"type": "uniform", "id": "shared", "value": value}, **SUN}, specialize=specialize
        )

    loaded = build(before)
    first = np.array(mi.render(loaded))
    params = mi.traverse(loaded)
    # Named by its id, or by the first that has it.
    key = next(k for k in params.keys() if k.startswith("shared.") or ".diffuse_reflectance." in k or ".kd." in k)  # noqa: SIM118
    params[key] = after
    params.update()
    assert np.array_equal(np.array(mi.render(loaded)), np.array(mi.render(build(after))))
    assert not np.array_equal(np.array(mi.render(loaded)), first)
