"""`whitted` with `convention` = physical computes what Mitsuba's `direct` and `path` do, where all of them can.

`path` also carries light from one smooth surface to the next, which a Whitted ray tracer does not.
So the scenes here have either no smooth surface (mirrors and glass before a sky), or smooth ones
that the camera sees in mirrors and glass alone, at a `max_depth` at which they are the last to be
met.
"""

import math
import subprocess
import sys

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest


def rgb(*value):
    return {"type": "rgb", "value": list(value)}


def pixels(values):
    return {"type": "bitmap", "raw": True, "bitmap": mi.Bitmap(np.array(values, np.float32))}


def facing(origin, target):
    return mi.ScalarTransform4f().look_at(list(origin), list(target), [0.1, 1, 0])


CENTRES = {"type": "stratified", "sample_count": 1, "jitter": False}
RANDOM = {"type": "independent", "sample_count": 1}


def camera(origin, target, width=32, height=None, fov=40.0, sampler=CENTRES):
    """By default it gives every integrator the pixel centres; but then `path` draws no random numbers at all."""
    return {
        "type": "perspective", "fov": fov, "fov_axis": "x", "near_clip": 1e-3, "to_world": facing(origin, target),
        "sampler": sampler,
        "film": {"type": "hdrfilm", "width": width, "height": height or width, "pixel_format": "rgb",
                 "component_format": "float32", "rfilter": {"type": "box"}},
    }  # fmt: skip


def ball(center, radius, bsdf):
    return {"type": "sphere", "center": list(center), "radius": radius, "bsdf": bsdf}


def wall(origin, target, size, bsdf):
    """A square at `origin` that faces `target`."""
    return {"type": "rectangle", "to_world": facing(origin, target).scale(size), "bsdf": bsdf}


def slab(back, front):
    """Glass between two planes z = constant. (A cube: Mitsuba joins two rectangles to one mesh without a size.)"""
    to_world = mi.ScalarTransform4f().translate([0, 0, (back + front) / 2]).scale([9, 9, (front - back) / 2])
    return {"type": "cube", "to_world": to_world, "bsdf": GLASS}


def load(sensor, **objects):
    return mi.load_dict({"type": "scene", "sensor": sensor, **objects})


def whitted(scene, convention="physical", spp=1, **options):
    integrator = mi.load_dict({"type": "whitted", "convention": convention, **options})
    return np.array(mi.render(scene, integrator=integrator, spp=spp))


def direct(scene):
    return np.array(mi.render(scene, integrator=mi.load_dict({"type": "direct"})))


def path(scene, max_depth, **options):
    # Without Russian roulette: it would only add noise.
    integrator = mi.load_dict({"type": "path", "max_depth": max_depth, "rr_depth": 1000})
    return np.array(mi.render(scene, integrator=integrator, **options))


def equal(image, truth, rel, edges=0.01):
    """Pixel by pixel, but for a share `edges` of them: Mitsuba starts secondary rays further off the surface."""
    assert np.mean(truth.max(axis=2) > 0.02 * truth.max()) > 0.1
    error = np.abs(image - truth).max(axis=2)
    # At the edge of a spot's cone, all is lost to cancellation; so a part of the largest value counts.
    assert np.mean(error > rel * (truth.max(axis=2) + 0.05 * truth.max())) <= edges


def same_mean(scene, max_depth, passes=12, tile=4):
    """A z-test of each tile of pixels, `whitted` on a grid of 8 x 8 in each against independent passes of `path`."""

    def tiles(x):
        height, width = x.shape[0] // tile, x.shape[1] // tile
        return x[: height * tile, : width * tile].reshape(height, tile, width, tile, 3).mean((1, 3))

    drawn = np.array([tiles(path(scene, max_depth, spp=64, seed=seed)) for seed in range(passes)], np.float64)
    mean, deviation = drawn.mean(0), drawn.std(0, ddof=1) / math.sqrt(passes)
    # A deviation from 12 passes is one of Student's t: 7 of them are passed by chance once in 40 000 tests.
    error, noise = np.abs(tiles(whitted(scene, spp=64, max_depth=max_depth)) - mean), 7 * deviation
    # Besides, a grid misjudges an edge in a pixel, and Mitsuba moves rays by up to 1e-3 sideways.
    assert np.all(error < noise + 3e-3 * mean.max())
    # One would see it if a twentieth of the light went another way.
    assert mean.max() > 0.01 and np.median(noise) < 0.05 * mean.max()


# No mirrors: `direct` ------------------------------------------------------------------------------------------

SMOOTH = {
    "diffuse": {"type": "diffuse", "reflectance": rgb(0.6, 0.5, 0.2)},
    "roughplastic": {"type": "roughplastic", "alpha": 0.2},
    "roughconductor": {"type": "roughconductor", "alpha": 0.3, "material": "Cu"},
    "principled": {"type": "principled", "base_color": rgb(0.2, 0.6, 0.7), "roughness": 0.4, "metallic": 0.3},
    "plastic": {"type": "plastic", "diffuse_reflectance": rgb(0.1, 0.3, 0.6)},
    "phong": {"type": "phong", "kd": 0.4, "ks": 0.6, "p": 20},
    "blinnphong": {"type": "blinnphong", "diffuse_reflectance": 0.4, "specular_reflectance": 0.3, "exponent": 80},
    "two sides": {"type": "twosided", "b": {"type": "phong"}},
    "blendbsdf": {"type": "blendbsdf", "weight": 0.4, "a": {"type": "phong", "ks": 0.8}, "b": {"type": "diffuse"}},
}  # fmt: skip

LIGHTS = {
    "point": {"type": "point", "position": [2, 6, 5], "intensity": rgb(60, 70, 80)},
    "spot": {"type": "spot", "to_world": facing([-3, 6, 5], [0.5, 0, 0]), "intensity": rgb(90, 60, 80),
             "cutoff_angle": 30, "beam_width": 12},
    "directional": {"type": "directional", "direction": [0.3, -1, -0.6], "irradiance": rgb(3, 2, 1)},
    "projector": {"type": "projector", "to_world": facing([1, 7, 5], [0, 0, 0]), "fov": 60, "scale": 40,
                  "irradiance": pixels(np.random.default_rng(1).uniform(0.2, 1, (6, 6, 3)))},
}  # fmt: skip


def smooth_scene(**lights):
    """Each smooth BSDF on a ball over a diffuse floor, which takes their shadows."""
    balls = {
        f"ball {i}": ball((1.5 * (i % 5) - 3 + 0.7 * (i // 5), 0, 1.6 * (i // 5)), 0.6, bsdf)
        for i, bsdf in enumerate(SMOOTH.values())
    }
    floor = wall((0, -0.6, 0), (0, 5, 0), 12, {"type": "diffuse", "reflectance": rgb(0.5, 0.6, 0.7)})
    return load(camera((0, 4, 7), (0, 0, 0.5), 96, 64, 60), floor=floor, **balls, **lights)


@pytest.mark.parametrize("light", LIGHTS)
def test_direct(light):
    """Without mirrors, under one delta light: every smooth BSDF, to 1e-5 of each pixel."""
    scene = smooth_scene(light=LIGHTS[light])
    # Float32 directions, of which an exponent of 80 makes 5e-6.
    equal(whitted(scene), direct(scene), 1e-5)


def test_direct_with_several_lights():
    """All lights at once are the sum of `direct`'s pictures under each: it would choose one at random."""
    truth = sum(direct(smooth_scene(light=light)) for light in LIGHTS.values())
    equal(whitted(smooth_scene(**LIGHTS)), truth, 1e-5)


def test_direct_inside_of_instances():
    """A group of shapes, turned and scaled."""
    to_world = mi.ScalarTransform4f().translate([0.3, 0.1, 0]).rotate([0, 1, 0], 40).scale(1.3)
    objects = {
        "group": {"type": "shapegroup", "a": ball((-1, 0, 0), 0.6, SMOOTH["phong"]),
                  "b": {"type": "cube", "to_world": mi.ScalarTransform4f().translate([1, 0, 0]).scale(0.5),
                        "bsdf": SMOOTH["roughplastic"]}},
        "instance": {"type": "instance", "to_world": to_world, "shapes": {"type": "ref", "id": "group"}},
        "floor": wall((0, -0.8, 0), (0, 5, 0), 12, SMOOTH["diffuse"]),
        "light": LIGHTS["point"],
    }  # fmt: skip
    scene = load(camera((0, 3, 6), (0, 0, 0), 64, 48), **objects)
    # The instance's own space adds roundings.
    equal(whitted(scene), direct(scene), 1e-4)


@pytest.mark.parametrize("scale", ([3.2, 0.44, 0.32], [0.3, 0.9, 2.0]))
def test_stretched_instances_cast_no_specks(scale):
    """A ball as an ellipsoid is lit as `direct` has it: its own roundings do not shade it."""
    objects = {
        "group": {"type": "shapegroup", "a": ball((0, 0, 0), 1.9, SMOOTH["phong"])},
        "instance": {"type": "instance", "to_world": mi.ScalarTransform4f().rotate([0, 1, 0], 30).scale(scale),
                     "shapes": {"type": "ref", "id": "group"}},
        "light": LIGHTS["point"],
    }  # fmt: skip
    scene = load(camera((-4, 7, 2), (0, 0, 0), 64, 64), **objects)
    equal(whitted(scene), direct(scene), 1e-3, edges=0.001)


def test_depth_one_is_dark():
    """max_depth 1 is emitters alone, 2 the lights: more changes nothing without mirrors, as in `direct`."""
    scene = smooth_scene(light=LIGHTS["point"])
    pictures = [whitted(scene, max_depth=depth) for depth in (1, 2, 3, 9)]
    assert np.all(pictures[0] == 0)
    assert np.array_equal(pictures[0], path(scene, 1))
    # `plastic` also mirrors: 4 % of its neighbours.
    assert np.mean(np.abs(pictures[2] - pictures[1]) > 1e-6) < 0.15
    assert pictures[3] == pytest.approx(pictures[2], abs=0.02 * float(pictures[2].max()))


# Falloff --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("light", ("point", "spot", "directional"))
def test_conventions_differ_by_falloff_and_pi(light):
    """The physical picture is the course's over pi d^2, d the distance to the light; over pi if that is directional."""
    sensor = camera((0, 4, 7), (0, 0, 0.5), 48, 32, 60)
    objects = {
        "floor": wall((0, -0.6, 0), (0, 5, 0), 12, SMOOTH["diffuse"]),
        "a": ball((-1, 0, 0), 0.6, SMOOTH["phong"]),
        "b": ball((1, 0, 1), 0.6, SMOOTH["blinnphong"]),
    }
    scene = load(sensor, **objects, light=LIGHTS[light])
    course, physical = whitted(scene, "course"), whitted(scene)
    assert physical.max() > 0.3
    square = 1.0
    if light != "directional":
        aov = mi.load_dict({"type": "aov", "aovs": "p:position"})
        p = np.array(mi.render(scene, integrator=aov))[..., -3:]
        square = np.sum((p - {"point": [2, 6, 5], "spot": [-3, 6, 5]}[light]) ** 2, axis=2, keepdims=True)
    equal(physical * math.pi * square, course, 1e-5, edges=0)


# Mirrors, without chance: `path` ----------------------------------------------------------------------------------

MIRRORS = {
    "conductor": {"type": "conductor", "material": "Au"},
    "mirrorblend": {"type": "mirrorblend", "km": 1.0, "b": {"type": "phong"}},
    "twosided": {"type": "twosided", "b": {"type": "conductor", "specular_reflectance": rgb(0.9, 0.5, 0.7)}},
    "two mirrors": {"type": "mirrorblend", "km": rgb(1, 1, 1), "b": {"type": "conductor"}},
}


@pytest.mark.parametrize("mirror", MIRRORS)
def test_mirrored_balls(mirror):
    """Every smooth BSDF, behind the camera: a mirror fills the frame, so the balls are the last that `path` meets."""
    balls = {
        f"ball {i}": ball((1.5 * (i % 5) - 3, 1.5 * (i // 5) - 0.5, -2), 0.6, bsdf)
        for i, bsdf in enumerate(SMOOTH.values())
    }
    pane = wall((0, 0, 4), (0, 0, 0), 20, MIRRORS[mirror])
    scene = load(
        camera((0, 0, 0), (0, 0, 4), 64, 48, 50), pane=pane, **balls,
        light={"type": "point", "position": [1, 3, 3], "intensity": 50},
    )  # fmt: skip
    truth = path(scene, 3)
    # Mitsuba moves the mirrored ray by 4e-4 sideways: the balls shift by 1e-3 of their size, and their edges more.
    equal(whitted(scene, max_depth=3), truth, 4e-3, edges=0.03)
    assert np.all(whitted(scene, max_depth=2) == 0)


def sky():
    """Three colours that fade into each other."""
    y, x = np.mgrid[:8, :16] / 8
    image = np.stack([0.6 + 0.4 * np.sin(np.pi * x), 0.5 + 0.5 * np.sin(np.pi * x + 2), 1 - 0.8 * y], axis=2)
    return {"type": "envmap", "bitmap": mi.Bitmap(image.astype(np.float32))}


@pytest.mark.parametrize("max_depth", (1, 2, 3, 5, 20))
def test_mirrors_before_a_sky(max_depth):
    """Metal balls that mirror each other, at each depth, are the picture that `path` makes without any noise."""
    gold, silver = {"type": "conductor", "material": "Au"}, {"type": "twosided", "b": {"type": "conductor"}}
    balls = {
        f"ball {i}": ball(
            (0.95 * math.sin(2 * i), 0.95 * math.cos(2 * i), 0.5 * (i % 2)), 0.8, gold if i % 2 else silver
        )
        for i in range(3)
    }
    scene = load(camera((0, 0, 5), (0, 0, 0), 64), **balls, sky=sky())
    # Three convex mirrors multiply the 4e-4 by which Mitsuba moves a ray.
    equal(whitted(scene, max_depth=max_depth), path(scene, max_depth), 4e-3, edges=0.03)


# Branches, of which `path` takes one at random -----------------------------------------------------------------------

GLASS = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
BRANCHED = {
    "dielectric": {"ball": ball((0, 0, 0), 1.0, GLASS)},
    "thindielectric": {"ball": ball((0, 0, 0), 1.0, {"type": "thindielectric"})},
    # Without a diffuse part, and half a mirror over glass.
    "plastic": {"ball": ball((0, 0, 0), 1.0, {"type": "plastic", "diffuse_reflectance": 0.0})},
    "half mirror": {"ball": ball((0, 0, 0), 1.0, {"type": "mirrorblend", "km": rgb(0.3, 0.5, 0.7), "b": GLASS})},
    "hollow": {
        "outside": ball((0, 0, 0), 1.0, GLASS),
        "inside": ball((0.2, 0.1, 0.1), 0.6, {"type": "dielectric", "int_ior": 1.0, "ext_ior": 1.5}),
    },
    "nested": {
        "outside": ball((0, 0, 0), 1.0, GLASS),
        "inside": ball((0.2, 0.1, 0.1), 0.6, {"type": "dielectric", "int_ior": 1.9, "ext_ior": 1.5}),
        "core": ball((0.3, 0, 0.2), 0.2, {"type": "conductor", "material": "Au"}),
    },
    "pane and mirror": {
        "pane": wall((0, 0, 1), (1, 0, 6), 2, {"type": "thindielectric"}),
        "ball": ball((0, 0, 0), 0.8, {"type": "conductor", "specular_reflectance": rgb(0.9, 0.6, 0.4)}),
    },
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("max_depth", (2, 3, 6))
@pytest.mark.parametrize("case", BRANCHED)
def test_branches(case, max_depth):
    """Glass, plastic and half mirrors before a sky: every branch up to `max_depth`, the expectation of `path`."""
    sensor = camera((0.3, 0.5, 4), (0, 0, 0), 32, fov=36, sampler=RANDOM)
    same_mean(load(sensor, **BRANCHED[case], sky=sky()), max_depth)


@pytest.mark.slow
@pytest.mark.parametrize("smooth", ("diffuse", "roughplastic", "principled", "phong", "blinnphong"))
@pytest.mark.parametrize(
    "glass",
    (
        "dielectric",
        "thindielectric",
        "mirrorblend",
    ),
)
def test_smooth_surfaces_behind_glass(glass, smooth):
    """A lit wall behind a slab or a pane that fills the frame: the wall is the last that either integrator meets."""
    light = {"type": "point", "position": [1, 2, -1], "intensity": 20}
    target = wall((0, 0, -3), (0, 0, 0), 10, SMOOTH[smooth])
    if glass == "dielectric":
        # Shadow rays of both integrators stop at glass: the light is between slab and wall.
        panes = {"slab": slab(0.5, 1)}
        max_depth = 4
    elif glass == "thindielectric":
        panes = {"pane": wall((0, 0, 1), (0.5, 0, 6), 10, {"type": "thindielectric"})}
        max_depth = 3
    else:
        # Seen through half a mirror over glass that is not there.
        air = {"type": "thindielectric", "int_ior": 1.0, "ext_ior": 1.0}
        panes = {"pane": wall((0, 0, 1), (0.5, 0, 6), 10, {"type": "mirrorblend", "km": 0.4, "b": air})}
        max_depth = 3
    scene = load(camera((0, 0, 4), (0, 0, 0), 32, fov=30, sampler=RANDOM), wall=target, light=light, **panes)
    same_mean(scene, max_depth)
    assert np.all(whitted(scene, max_depth=max_depth - 1) == 0)


@pytest.mark.parametrize("variant", ("llvm_ad_rgb", "scalar_rgb"))
def test_branches_of_a_slab(variant):
    """The whole series of a glass slab at normal incidence: it lets 2 n / (n^2 + 1) of a uniform light through."""
    mi.set_variant(variant)
    mi.set_log_level(mi.LogLevel.Error)
    n = 1.5
    for back, front in ((0, 1), (-0.5, 0.5)):
        # A wall of ambient light behind, black elsewhere.
        lit = wall((0, 0, -2), (0, 0, 0), 9, {"type": "phong", "kd": 0.8, "ks": 0})
        scene = load(camera((0, 0, 3), (0, 0, 0), 1, fov=1e-3), slab=slab(back, front), lit=lit)
        for max_depth in (20, -1):
            image = whitted(scene, ambient=1.0, max_depth=max_depth)
            assert image[0, 0] == pytest.approx(0.8 * 2 * n / (n * n + 1), rel=1e-5)


# As in `test_branches_of_a_slab`.
DEEP = """
import phong_bsdf, mitsuba as mi, sys
mi.set_variant("llvm_ad_rgb")
T = mi.ScalarTransform4f()
GLASS = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
scene = mi.load_dict({
    "type": "scene",
    "integrator": {"type": "whitted", "convention": "physical", "ambient": 1.0, "max_depth": int(sys.argv[1])},
    "sensor": {
        "type": "perspective", "fov": 1e-3, "near_clip": 1e-3, "to_world": T.look_at([0, 0, 3], [0, 0, 0], [0.1, 1, 0]),
        "sampler": {"type": "stratified", "sample_count": 1, "jitter": False},
        "film": {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}},
    },
    "slab": {"type": "cube", "to_world": T.translate([0, 0, 0.5]).scale([9, 9, 0.5]), "bsdf": GLASS},
    "lit": {
        "type": "rectangle", "to_world": T.look_at([0, 0, -2], [0, 0, 0], [0.1, 1, 0]).scale(9),
        "bsdf": {"type": "phong", "kd": 0.8, "ks": 0},
    },
})
print(mi.render(scene)[0, 0, 0])
"""


@pytest.mark.slow
@pytest.mark.parametrize("max_depth", (30, 60))
def test_deep_branches_of_a_slab(max_depth):
    """A larger max_depth than the branches need adds nothing. (In a process of its own.)"""
    result = subprocess.run([sys.executable, "-c", DEEP, str(max_depth)], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    assert float(result.stdout) == pytest.approx(0.8 * 12 / 13, rel=1e-5)


@pytest.mark.parametrize("km", (0.0, 0.4))
@pytest.mark.parametrize(
    ("nested", "through"),
    [({"type": "mask", "opacity": 0.3, "b": {"type": "phong", "kd": 0.0}}, 0.7), ({"type": "null"}, 1.0)],
    ids=("mask", "null"),
)
def test_mirrors_over_holes(nested, through, km):
    """A mirrorblend lets 1 - km of what its nested BSDF lets through pass: here the ambient light of a wall behind."""
    bright = pixels([[[1.0, 0.5, 0.0]] * 4] * 4)
    target = wall((0, 0, -3), (0, 0, 0), 9, {"type": "phong", "kd": bright, "ks": 0})
    pane = wall((0, 0, 0), (0, 0, 4), 9, {"type": "mirrorblend", "km": km, "b": nested})
    scene = load(camera((0, 0, 4), (0, 0, 0), 1, fov=1e-3), wall=target, pane=pane)
    # The pane itself is black, and there is nothing to mirror.
    image = whitted(scene, ambient=1.0, max_depth=3)[0, 0]
    assert image == pytest.approx((1 - km) * through * np.array([1, 0.5, 0]), abs=1e-5)


def test_ambient_light_on_a_mask():
    """A surface that is there to 30 % shows 30 % of its ambient light, as of any other."""
    pane = {"type": "mask", "opacity": 0.3, "b": {"type": "phong", "kd": 0.5, "ks": 0}}
    scene = load(camera((0, 0, 4), (0, 0, 0), 1, fov=1e-3), pane=wall((0, 0, 0), (0, 0, 4), 9, pane))
    assert whitted(scene, ambient=1.0)[0, 0] == pytest.approx(0.15, rel=1e-5)


# What a kernel holds -----------------------------------------------------------------------------------------------


def kernel(bsdf):
    """Operations of the largest kernel of a picture, and arrays that it holds for each ray."""
    scene = load(
        camera((0, 0, 5), (0, 0, 0), 8), light=LIGHTS["point"], sky=sky(), ball=ball((0, 0, 0), 1.0, bsdf)
    )  # fmt: skip
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        whitted(scene)
        kernels = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
    # One allocation is LLVM's own, for the arguments of a call.
    arrays = max(k["ir"].read().count("= alloca") for k in kernels)
    return max(k["operation_count"] for k in kernels), max(arrays - 1, 0)


def test_only_glass_takes_a_stack():
    """Mirrors of one lobe add a loop to the kernel; the arrays of branches that wait come with glass alone."""
    size, arrays = {}, {}
    for bsdf in ("diffuse", "conductor", "plastic", "dielectric", "thindielectric"):
        size[bsdf], arrays[bsdf] = kernel({"type": bsdf})
    size["mirrorblend"], arrays["mirrorblend"] = kernel({"type": "mirrorblend", "b": {"type": "phong"}})
    size["both"], arrays["both"] = kernel({"type": "mirrorblend", "b": {"type": "conductor"}})
    assert all(arrays[name] == 0 for name in ("diffuse", "conductor", "plastic", "mirrorblend"))
    # Origin, direction, throughput and depth of a branch: ten numbers.
    assert all(arrays[name] == 10 for name in ("dielectric", "thindielectric", "both"))
    assert size["diffuse"] < size["conductor"] < size["dielectric"] - 150


# Joined shapes ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("convention", ("course", "physical"))
def test_rectangles_that_mitsuba_joins(convention):
    """Two walls of the same BSDF look as they do with one each: they block light and mirror."""
    lamp = {"type": "point", "position": [0, 3, 2], "intensity": 20}
    parts = {
        "left": wall((-1, 0, 0), (-1, 0, 9), 0.8, SMOOTH["phong"]),
        "right": wall((1, 0, 0), (1, 0, 9), 0.8, SMOOTH["phong"]),
        "lid": ball((0, 1, 1), 0.4, SMOOTH["diffuse"]), "lamp": lamp,
    }  # fmt: skip
    sensor = camera((0, 0, 5), (0, 0, 0), 48)
    apart = mi.load_dict({"type": "scene", "sensor": sensor, **parts}, optimize=False)
    joined = load(sensor, **parts)
    assert len(joined.shapes()) < len(apart.shapes())
    equal(whitted(joined, convention), whitted(apart, convention), 1e-5, edges=0)
