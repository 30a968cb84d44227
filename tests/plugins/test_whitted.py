"""The integrator: the course's pictures, its rules, and its agreement with Mitsuba's own integrators."""

import math
from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from helpers import SCENES, oracle
from helpers.small_scenes import look, point, render, rgb
from phong_bsdf.pictures.images import to_8bit

# Row, column (from 1, top left) and value; then the picture's mean.
COURSE_VALUES = {
    3: ({(140, 150): 0.573349, (150, 360): 0.190617}, 0.0093303),
    4: (
        {(130, 200): (0.728131, 0.728131, 1.325446), (260, 245): (0.773919, 0, 0.674971), (420, 245): 0.622415},
        (0.2533276, 0.2527497, 0.2777815),
    ),
    6: (
        {
            (380, 90): (1.374825, 0.626829, 0.626829),
            (340, 190): (0.582628, 1.296575, 0.582628),
            (330, 395): (0.343174, 0.343174, 0.692373),
        },
        (0.1914023, 0.1785481, 0.1695479),
    ),
}


def course(number, **defines):
    return mi.load_file(str(SCENES / f"course/scene-{number}.xml"), **{k: str(v) for k, v in defines.items()})


def floor(bsdf, size=10.0, y=0.0):
    to_world = mi.ScalarTransform4f().translate([0, y, 0]).rotate([1, 0, 0], -90).scale(size)
    return {"type": "rectangle", "to_world": to_world, "bsdf": bsdf}


def sphere(center, radius, bsdf):
    return {"type": "sphere", "center": center, "radius": radius, "bsdf": bsdf}


def scene(integrator=None, sensor=None, **objects):
    sensor = sensor or look([0, 3, 0], [0, 0, 0])
    return {"type": "scene", "integrator": {"type": "whitted", **(integrator or {})}, "sensor": sensor, **objects}


# The contract's numbers ---------------------------------------------------------------------------


@pytest.mark.parametrize("number", COURSE_VALUES)
def test_course_values(number):
    """The published pixels and means of the course's scenes, 490 x 490."""
    image = render(course(number))
    pixels, mean = COURSE_VALUES[number]
    for (row, column), value in pixels.items():
        assert image[row - 1, column - 1] == pytest.approx(np.broadcast_to(value, 3), abs=1e-5)
    # A mean moves with the pixels at contacts and edges that float32 decides otherwise.
    assert image.mean((0, 1)) == pytest.approx(np.broadcast_to(mean, 3), abs=1.5e-4)


@pytest.mark.parametrize("camera", (1, 2, 3))
@pytest.mark.parametrize("number", (1, 2, 3, 4, 5, 6))
def test_course_pictures_match_the_oracle(number, camera):
    """Every pixel against float64 NumPy: 99 % within 3e-5, at most 0.3 % off by more than 3e-4."""
    truth = oracle.render(replace(oracle.COURSE[number], camera=oracle.CAMERAS[camera]))
    loaded = course(number)
    error = np.abs(render(loaded, sensor=camera - 1) - truth).max(axis=2)
    # What remains are pixel centres within float32 of a silhouette or the edge of a shadow.
    assert np.mean(error > 3e-5) < 0.01
    assert np.mean(error > 3e-4) < 0.003
    assert np.mean(error > 1e-2) <= 0.001


@pytest.mark.parametrize(("kind", "value"), [("phong", 0.80498447), ("blinnphong", 0.80895671)])
def test_cavity(kind, value):
    """Inside a sphere of radius 0.5, normals facing in: the value that tells the two models apart."""
    material = {"type": kind, "kd": 0.9, "ks": 0.9, "p": 200}
    image = render(
        scene(
            sensor=look([0, 0, 0], [0, 0, 1], width=1, fov=1e-3),
            light=point([0, 0.25, 0]),
            wall={**sphere([0, 0, 0], 0.5, material), "flip_normals": True},
        )
    )
    assert image[0, 0] == pytest.approx(value, abs=1e-6)


def test_mirrors_end_where_the_course_ends_them():
    """Scene 5 changes in 11 502 pixels of an 8-bit picture between 1 and 8 bounces, and in none between 7 and 8."""
    one, seven, eight = (to_8bit(render(course(5, max_depth=bounces + 2))) for bounces in (1, 7, 8))
    assert np.sum(np.any(one != eight, axis=2)) == 11502
    assert np.array_equal(seven, eight)


# The integrator's rules ----------------------------------------------------------------------------


def corridor(km, below, above):
    """Two mirrors that face each other, with the camera between them looking straight down."""

    def half(kd):
        return {"type": "mirrorblend", "km": km, "nested": {"type": "phong", "kd": kd, "ks": 0}}

    return {
        "sensor": look([0, 0, 0], [0, -1, 0], width=1, fov=1e-3),
        "below": floor(half(below), y=-1),
        "above": {**floor(half(above), y=1), "flip_normals": True},
    }


@pytest.mark.parametrize("max_depth", (1, 2, 3, 4, 7, 10, 200))
def test_depth_counts_mirrors_as_path_does(max_depth):
    """Between two mirrors: depth 1 shades nothing, 2 the first surface, each further one a bounce;
    the last surface shows its local shade undiminished."""
    km, shades = 0.6, (0.3, 0.8)
    hits = max_depth - 1
    expected = 0.0
    for i in reversed(range(hits)):
        expected = shades[i % 2] if i == hits - 1 else km * expected + (1 - km) * shades[i % 2]
    image = render(scene({"max_depth": max_depth, "ambient": 1.0}, **corridor(km, *shades)))
    assert image[0, 0] == pytest.approx(expected, rel=1e-5)


def test_unlimited_depth_ends():
    """max_depth = -1: a chain that fades reaches its limit."""
    image = render(scene({"max_depth": -1, "ambient": 1.0}, **corridor(0.6, 0.3, 0.8)))
    assert image[0, 0] == pytest.approx(0.4 * (0.3 + 0.6 * 0.8) / (1 - 0.36), abs=2e-6)


@pytest.mark.parametrize("nested", (False, True))
def test_unlimited_chains_end_like_others(nested):
    """Between perfect mirrors a chain ends after 1000 bounces, as that of max_depth = 1002: the last surface shows its
    local shade. `nested`: in a `twosided`, which no table describes."""
    mirrors = corridor(1.0, 0.3, 0.8)
    if nested:
        for name in ("below", "above"):
            mirrors[name] = {**mirrors[name], "bsdf": {"type": "twosided", "nested": mirrors[name]["bsdf"]}}
    unlimited, limited = (render(scene({"max_depth": depth, "ambient": 1.0}, **mirrors)) for depth in (-1, 1002))
    assert unlimited[0, 0] == pytest.approx(0.3, abs=2e-6) and np.array_equal(unlimited, limited)


def test_unlimited_chains_end_when_they_are_faint():
    """A mirror that is left out for its faintness shows its surface undiminished: k_m L_local is missing nowhere."""
    km = 5e-7
    image = render(scene({"max_depth": -1, "ambient": 1e6}, **corridor(km, 1.0, 0.9)))
    # (1 - km) of 1e6 would be 0.5 less.
    assert image[0, 0] == pytest.approx(1e6, abs=0.1)


def test_backs_of_mirrors_are_no_ends():
    """Seen from behind a mirror shows nothing, limit or not; ambient light is as much as with a limit."""
    mirror = {"type": "mirrorblend", "km": 0.6, "nested": {"type": "phong", "kd": 0.5, "ks": 0}}
    back = {**floor(mirror, y=-1), "flip_normals": True}
    camera = look([0, 0, 0], [0, -1, 0], width=1, fov=1e-3)
    unlimited, limited = (
        render(scene({"max_depth": depth, "ambient": 1.0}, sensor=camera, back=back)) for depth in (-1, 10)
    )
    assert unlimited[0, 0] == pytest.approx(0.2, abs=1e-6) and np.array_equal(unlimited, limited)


def test_perfect_mirrors_show_the_last_surface():
    """km = 1 everywhere: the last surface of the budget shows what is under its mirror."""
    image = render(scene({"max_depth": 4, "ambient": 1.0}, **corridor(1.0, 0.3, 0.8)))
    assert image[0, 0] == pytest.approx(0.3, rel=1e-6)
    lit = scene({"max_depth": 3}, **corridor(1.0, 0.3, 0.8), light=point([0, 0, 0.5], 2.0))
    # Depth 3 is one bounce, from the lower mirror to the upper: kd I n.l there.
    assert render(lit)[0, 0] == pytest.approx(0.8 * 2 / math.sqrt(1.25), rel=1e-5)


def test_background_is_seen_and_lights_nothing():
    """Rays that leave the scene see the background, mirrored ones weighted by km; hidden from the camera on demand."""
    mirror = {"type": "mirrorblend", "km": rgb(0.25, 0.5, 1), "nested": {"type": "phong"}}
    objects = {"floor": floor(mirror, size=0.2), "sky": {"type": "constant", "radiance": rgb(0.8, 0.4, 0.2)}}
    image = render(scene(**objects))
    assert image[0, 0] == pytest.approx([0.8, 0.4, 0.2]) and image[8, 8] == pytest.approx([0.2, 0.2, 0.2])
    hidden = render(scene({"hide_emitters": True}, **objects))
    assert np.all(hidden[0, 0] == 0) and np.array_equal(hidden[8, 8], image[8, 8])
    assert np.all(render(scene({"max_depth": 1}, **objects))[8, 8] == 0)


def test_lights_add_up():
    """A picture under many lights of all kinds is the sum of the pictures under each."""
    spot = {
        "type": "spot", "intensity": rgb(0.9, 0.1, 0.4), "cutoff_angle": 30,
        "to_world": mi.ScalarTransform4f().look_at([1, 2, 1], [0, 0, 0], [0, 1, 0]),
    }  # fmt: skip
    lights = {
        "a": point([1, 2, 0], 0.4), "b": point([-1, 0.5, 1], rgb(0.1, 0.2, 0.3)), "c": spot,
        "d": {"type": "directional", "direction": [1, -2, 0.5], "irradiance": rgb(0.5, 0.6, 0.7)},
    }  # fmt: skip
    objects = {"floor": floor({"type": "blinnphong", "ks": 0.5}), "ball": sphere([0.3, 0.3, 0], 0.3, {"type": "phong"})}
    together = render(scene(**objects, **lights))
    alone = [render(scene(**objects, **{name: light})) for name, light in lights.items()]
    assert all(image.max() > 0.05 for image in alone)
    assert together == pytest.approx(sum(alone), rel=1e-5, abs=1e-6)


def test_falloff_is_the_physical_conventions():
    """A point light at height h over a Lambertian floor: I in the course, I / (pi h^2) in the physical convention."""
    for height in (0.5, 2.0):
        objects = {"floor": floor({"type": "phong", "kd": 0.7, "ks": 0}), "light": point([0, height, 0], 3.0)}
        sensor = look([0, 1, 0], [0, 0, 0], width=1, fov=1e-3)
        assert render(scene(sensor=sensor, **objects))[0, 0] == pytest.approx(2.1, rel=1e-6)
        physical = render(scene({"convention": "physical"}, sensor, **objects))
        assert physical[0, 0] == pytest.approx(2.1 / (math.pi * height**2), rel=1e-6)


def test_shadows_can_be_left_out():
    """`shadows` = false lights what an occluder hides."""
    objects = {"floor": floor({"type": "phong", "kd": 1, "ks": 0}), "light": point([0, 4, 0]),
               "lid": sphere([0, 3.5, 0], 0.2, {"type": "phong"})}  # fmt: skip
    assert np.all(render(scene(**objects))[8, 8] == 0)
    assert render(scene({"shadows": False}, **objects))[8, 8] == pytest.approx(1, abs=0.01)


def test_grid_of_samples():
    """spp = n^2 is the mean over an n x n grid: the picture of n times the size, averaged."""
    loaded = course(4, width=60, height=60)
    coarse = render(loaded, spp=9)
    fine = render(course(4, width=180, height=180))
    # Ray directions at equal positions differ by a rounding, which decides a few edge samples otherwise.
    error = np.abs(coarse - fine.reshape(60, 3, 60, 3, 3).mean((1, 3))).max(axis=2)
    assert np.mean(error > 1e-5) < 0.01


@pytest.mark.parametrize("sampler", ("independent", "ldsampler", "multijitter"))
def test_square_sample_counts_ignore_the_sampler(sampler):
    """No random number reaches the picture: sampler and seed change nothing, and neither does a second run."""

    def picture(spp, seed):
        sensor = {**look([0, 2, 2], [0, 0, 0]), "sampler": {"type": sampler, "sample_count": spp}}
        return render(scene(sensor=sensor, floor=floor({"type": "phong"}), light=point([1, 1, 1]),
                            ball=sphere([0, 0.5, 0], 0.5, {"type": "blinnphong"})), seed=seed)  # fmt: skip

    for spp in (1, 9):
        assert np.array_equal(picture(spp, 0), picture(spp, 5))
    assert sampler != "independent" or not np.array_equal(picture(5, 0), picture(5, 5))


@pytest.mark.slow
def test_same_picture_in_every_variant(any_variant):
    """Course scene 6 at 32 x 32; spectral variants draw wavelengths, so within their noise."""
    spectral = "spectral" in any_variant
    spp = (16 if "scalar" in any_variant else 1024) if spectral else 1
    image = render(course(6, width=32, height=32, spp=spp, max_depth=5))
    mi.set_variant("llvm_ad_rgb")
    truth = render(course(6, width=32, height=32, spp=spp, max_depth=5))
    if "mono" in any_variant:
        luminance = truth @ [0.212671, 0.715160, 0.072169]
        # Colours become grey before the light is multiplied: mirrors of white surfaces only agree.
        assert np.mean(np.abs(image[..., 0] - luminance) < 1e-5) > 0.95
    elif spectral:
        error = np.abs(image - truth)
        assert error.mean() < (0.05 if "scalar" in any_variant else 0.01)
    else:
        # Scalar variants intersect spheres in double precision: edges differ.
        assert np.mean(np.abs(image - truth).max(axis=2) > 3e-5) < 0.01


# Agreement with Mitsuba ------------------------------------------------------------------------------


LIGHTS = {
    "point": point([1, 3, 2], 20.0),
    "directional": {"type": "directional", "direction": [1, -1, -0.5], "irradiance": 2.0},
    "spot": {
        "type": "spot", "intensity": 30.0, "cutoff_angle": 35,
        "to_world": mi.ScalarTransform4f().look_at([-2, 2, 1], [0, 0, 0], [0, 1, 0]),
    },
}  # fmt: skip


def centres(origin, target, width=64):
    """A camera whose sampler gives Mitsuba's own integrators the pixel centres too."""
    return {**look(origin, target, width), "sampler": {"type": "stratified", "sample_count": 1, "jitter": False}}


def agree(image, truth, tolerance=1e-5):
    error = np.abs(image - truth).max(axis=2)
    # Mitsuba starts secondary rays further off: the edges of shadows fall on other pixels.
    assert truth.max() > 0.1
    assert np.mean(error > tolerance * max(truth.max(), 1)) <= 0.005


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("bsdf", ("diffuse", "roughplastic", "roughconductor", "principled", "phong", "blinnphong"))
def test_physical_convention_equals_direct(bsdf, light):
    """Without mirrors, under a delta light, pixel by pixel."""
    objects = {
        "floor": floor({"type": "diffuse", "reflectance": rgb(0.6, 0.5, 0.4)}, y=-0.5),
        "ball": sphere([0, 0, 0], 0.5, {"type": bsdf}),
        "light": LIGHTS[light],
    }
    loaded = mi.load_dict(scene({"convention": "physical"}, centres([0, 1, 4], [0.3, 0, 0]), **objects))
    agree(render(loaded), render(loaded, integrator=mi.load_dict({"type": "direct"})))


@pytest.mark.parametrize("mirror", ({"type": "conductor"}, {"type": "mirrorblend", "km": 1.0, "b": {"type": "phong"}}))
def test_physical_convention_equals_path(mirror):
    """One mirror bounce: a ball and its image. (`path` at greater depth adds light that the ball sends to itself.)"""
    objects = {
        "mirror": floor(mirror, y=-0.8),
        "ball": sphere([0, 0, 0], 0.5, {"type": "phong", "ks": 0.5}),
        "light": LIGHTS["point"],
    }
    loaded = mi.load_dict(
        scene({"convention": "physical", "max_depth": 3}, centres([0, 1.5, 4], [0, -0.4, 0]), **objects)
    )
    path = render(loaded, integrator=mi.load_dict({"type": "path", "max_depth": 3}))
    # Mitsuba moves a mirrored ray sideways by 9e-5 (1 + |p|): the image in the mirror shifts by as much.
    agree(render(loaded), path, tolerance=2e-4)


@pytest.mark.parametrize("max_depth", (1, 2, 3, 6))
def test_mirrors_see_the_background_as_in_path(max_depth):
    """Metal balls before a background: the same depth shows it as often as `path` does."""
    gold = {"type": "conductor", "specular_reflectance": rgb(0.9, 0.7, 0.3)}
    objects = {f"ball {i}": sphere([i - 1.5, 0, 0.3 * (i % 2)], 0.5, gold) for i in range(4)}
    sky = {"type": "constant", "radiance": rgb(0.5, 0.7, 1)}
    integrator = {"convention": "physical", "max_depth": max_depth}
    loaded = mi.load_dict(scene(integrator, centres([0, 1, 4], [0, 0, 0]), sky=sky, **objects))
    path = mi.load_dict({"type": "path", "max_depth": max_depth, "rr_depth": 1000})
    agree(render(loaded), render(loaded, integrator=path))


@pytest.mark.parametrize("bsdf", ("dielectric", "thindielectric", "plastic", "conductor"))
def test_native_mirrors_match_path_on_average(bsdf):
    """One ray through a ball before a background of two colours: the tree is what `path` draws at random."""
    sky = np.array([[[0.2, 0.5, 1]], [[1, 0.6, 0.1]]], np.float32)
    objects = {
        "sky": {"type": "envmap", "bitmap": mi.Bitmap(sky)},
        "ball": sphere([0, 0, 0], 1.0, {"type": bsdf, **({"diffuse_reflectance": 0.0} if bsdf == "plastic" else {})}),
    }
    sensor = look([0.2, 1, 4], [0.45, 0.3, 0], width=1, fov=1e-4)
    loaded = mi.load_dict(scene({"convention": "physical", "max_depth": 8}, sensor, **objects))
    path = render(loaded, integrator=mi.load_dict({"type": "path", "max_depth": 8, "rr_depth": 1000}), spp=2**17)
    # 2^17 samples of values up to 1: four deviations are below 6e-3.
    assert render(loaded)[0, 0] == pytest.approx(path[0, 0], abs=6e-3)


def test_glass_conserves_light():
    """White furnace: a glass ball before a uniform background is invisible, both branches followed."""
    for bsdf in ("dielectric", "thindielectric"):
        image = render(
            scene({"max_depth": -1}, look([0, 0, 3], [0, 0, 0], width=8), sky={"type": "constant", "radiance": 1.0},
                  ball=sphere([0, 0, 0], 1.0, {"type": bsdf}))
        )  # fmt: skip
        # What is left in branches below 1e-6 of the light, many times.
        assert image == pytest.approx(1, abs=1e-4)


GREY_SKY = {"type": "constant", "radiance": 0.5}
ELSEWHERE = {
    "nothing": {},
    "mirror": {"elsewhere": sphere([50, 0, 0], 1.0, {"type": "mirrorblend", "km": 0.5, "b": {"type": "phong"}})},
    "glass": {"elsewhere": sphere([50, 0, 0], 1.0, {"type": "dielectric"})},
}


def seen(bsdf, elsewhere, variant, flip=False, **integrator):
    """The centre of a pane of `bsdf` before a grey background, with something else far away."""
    mi.set_variant(variant)
    pane = {**floor(bsdf), "flip_normals": flip}
    sensor = look([0, 1, 0], [0, 0, 0], width=1, fov=1e-3)
    image = render(scene(integrator, sensor, pane=pane, sky=GREY_SKY, **ELSEWHERE[elsewhere]))
    mi.set_variant("llvm_ad_rgb")
    return image[0, 0, 0]


@pytest.mark.parametrize("variant", ("llvm_ad_rgb", "scalar_rgb"))
@pytest.mark.parametrize("elsewhere", ELSEWHERE)
@pytest.mark.parametrize("opacity", (0.0, 0.25, 1.0))
def test_masks_let_light_through(opacity, elsewhere, variant):
    """A mask shows 1 - opacity of what is behind, whatever else the scene holds; so does a mask over a mirror."""
    inside = {"type": "phong", "kd": 0.5, "ks": 0}
    plain = seen({"type": "mask", "opacity": opacity, "b": inside}, elsewhere, variant)
    assert plain == pytest.approx(0.5 * (1 - opacity), abs=1e-6)
    mirror = {"type": "mirrorblend", "km": 0.4, "b": inside}
    mirrored = seen({"type": "mask", "opacity": opacity, "b": mirror}, elsewhere, variant)
    assert mirrored == pytest.approx(0.5 * (1 - opacity) + 0.5 * opacity * 0.4, abs=1e-6)


@pytest.mark.parametrize("variant", ("llvm_ad_rgb", "scalar_rgb"))
@pytest.mark.parametrize("elsewhere", ELSEWHERE)
def test_sides_of_a_surface_have_their_own_mirrors(elsewhere, variant):
    """`twosided` with a mirror on the back only: the front is dull, the back mirrors once."""
    mirror = {"type": "mirrorblend", "km": 0.4, "b": {"type": "phong"}}
    bsdf = {"type": "twosided", "a": {"type": "phong"}, "b": mirror}
    assert seen(bsdf, elsewhere, variant) == 0
    assert seen(bsdf, elsewhere, variant, flip=True) == pytest.approx(0.2, abs=1e-6)


@pytest.mark.parametrize(
    ("bsdf", "expected"),
    [
        ({"type": "blendbsdf", "weight": 0.5, "a": {"type": "phong"}, "b": {"type": "conductor"}}, 0.25),
        ({"type": "mirrorblend", "km": 0.5, "b": {"type": "conductor"}}, 0.5),
        ({"type": "twosided", "b": {"type": "mirrorblend", "km": 0.3, "b": {"type": "phong"}}}, 0.15),
    ],
)
def test_adapters_around_mirrors(bsdf, expected):
    """Each passes its share of the mirror on, exactly."""
    assert seen(bsdf, "nothing", "llvm_ad_rgb") == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("variant", ("llvm_ad_rgb", "scalar_rgb"))
@pytest.mark.parametrize("km", (None, 0.4))
def test_native_bsdfs_shade_as_the_lobes_do(variant, km):
    """`diffuse` of reflectance 0.5 is kd = 0.5, under a mirror or not; scalar natives do not look at `active`."""
    mi.set_variant(variant)
    pictures = []
    for bsdf in ({"type": "diffuse", "reflectance": 0.5}, {"type": "phong", "kd": 0.5, "ks": 0.0}):
        bsdf = bsdf if km is None else {"type": "mirrorblend", "km": km, "b": bsdf}
        objects = {"sky": GREY_SKY, "light": point([2, 3, 4]), "ball": sphere([0, 0, 0], 1.0, bsdf)}
        pictures.append(render(scene(sensor=look([0, 0, 4], [0, 0, 0], width=8), **objects)))
    assert pictures[0] == pytest.approx(pictures[1], abs=1e-6)
    assert pictures[0].std() > 0.05


@pytest.mark.parametrize("variant", ("llvm_ad_rgb", "scalar_rgb"))
def test_mirrors_in_instances(variant):
    """Inside of a shapegroup they are followed as outside."""
    mi.set_variant(variant)
    ball = sphere([0, 0, 0], 1.0, {"type": "mirrorblend", "km": 0.6, "b": {"type": "phong", "kd": 0.3}})
    sensor = look([0, 0, 4], [0, 0, 0], width=8)
    objects = {"sky": GREY_SKY, "light": point([2, 3, 4])}
    plain = render(scene(sensor=sensor, ball=ball, **objects))
    objects["group"] = {"type": "shapegroup", "ball": ball}
    instance = {"type": "instance", "ref": {"type": "ref", "id": "group"}}
    assert render(scene(sensor=sensor, ball=instance, **objects)) == pytest.approx(plain, abs=1e-4)
    assert np.abs(plain - 0.5).max() > 0.1


def test_ambient_in_every_variant(any_variant):
    """Course scene 1 is flat: the same colour under every representation of light."""
    image = render(course(1, width=15, height=15, spp=16, max_depth=2))[6:9, 6:9].mean((0, 1))
    middle = [0.73, 0, 0.17] if "mono" not in any_variant else mi.luminance(mi.ScalarColor3f(0.73, 0, 0.17))
    # Mitsuba's spectra of so saturated a red come out as 0.85, 0.03, 0.2; 144 wavelengths are off by 0.1 besides.
    assert image == pytest.approx(np.broadcast_to(middle, image.shape), abs=0.45 if "spectral" in any_variant else 1e-3)
    mirror = {"type": "mirrorblend", "km": 0.5, "b": {"type": "phong", "kd": 0.4}}
    image = render(scene({"ambient": 1.0}, look([0, 1, 0], [0, 0, 0], width=1, fov=1e-3), pane=floor(mirror)))
    assert image[0, 0].mean() == pytest.approx(0.2, rel=0.3 if "spectral" in any_variant else 1e-5)


@pytest.mark.parametrize("sampler", ("independent", "stratified", "ldsampler"))
@pytest.mark.parametrize("camera", ("perspective", "thinlens"))
@pytest.mark.parametrize("variant", ("llvm_ad_rgb", "llvm_ad_spectral", "scalar_rgb"))
def test_any_number_of_samples(variant, camera, sampler):
    """Square or not, whatever has to be drawn besides the position: the picture is the same but for noise."""
    mi.set_variant(variant)
    lens = {"aperture_radius": 0.01, "focus_distance": 1.0} if camera == "thinlens" else {}
    sensor = {**look([0, 1, 0], [0, 0, 0], width=4, **lens), "type": camera}
    sensor["sampler"] = {"type": sampler, "sample_count": 4}
    loaded = mi.load_dict(scene(sensor=sensor, floor=floor({"type": "phong"}), light=point([0, 0.7, 0])))
    means = [render(loaded, spp=spp).mean() for spp in (0, 9, 25, 5)]
    assert means == pytest.approx([means[0]] * 4, rel=0.2 if "spectral" in variant else 0.05)


def test_glass_pane_splits_the_light():
    """A thin pane at normal incidence shows (1 - R) of what is behind and R of what is before it."""
    r = ((1.5 - 1) / (1.5 + 1)) ** 2
    r = 2 * r / (1 + r)
    pane = {"type": "thindielectric", "int_ior": 1.5, "ext_ior": 1.0}
    objects = {
        "pane": floor(pane, y=0.0),
        "behind": floor({"type": "phong", "kd": 0.9, "ks": 0}, y=-1.0),
        "before": {**floor({"type": "phong", "kd": 0.2, "ks": 0}, y=2.0), "flip_normals": True},
    }
    image = render(scene({"ambient": 1.0}, look([0, 1, 0], [0, 0, 0], width=1, fov=1e-3), **objects))
    assert image[0, 0] == pytest.approx((1 - r) * 0.9 + r * 0.2, rel=1e-5)


# Precision ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", ("rectangle", "cube", "disk", "cylinder", "sphere", "mesh"))
@pytest.mark.parametrize("scale", (1e-3, 1.0, 1e4))
def test_no_acne(shape, scale):
    """No lit surface shadows itself, at any size, far from the origin too, under a grazing light."""
    to_world = mi.ScalarTransform4f().translate([3 * scale, -2 * scale, scale]).rotate([0.6, 0.8, 0], 40).scale(scale)
    bsdf = {"type": "phong", "kd": 1, "ks": 0}
    target = mi.ScalarPoint3f(3 * scale, -2 * scale, scale)
    origin = target + mi.ScalarVector3f(2, 3, 4) * scale
    objects = {
        "thing": {"type": shape, "to_world": to_world, "bsdf": bsdf},
        "light": point(target + mi.ScalarVector3f(4, 1, 3) * scale),
    }
    if shape == "mesh":
        objects["thing"] = {"type": "obj", "filename": str(SCENES / "course/models/torus.obj"),
                            "to_world": to_world, "bsdf": bsdf}  # fmt: skip
    sensor = look(origin, target, width=128, far_clip=1e6)
    lit = render(scene({"shadows": False}, sensor, **objects))
    shadowed = render(scene({"shadows": True}, sensor, **objects))
    # True self-shadowing exists on the torus only, and at the terminator of a smooth mesh's normals.
    lost = np.mean((lit > 0.02) & (shadowed == 0)) / np.mean(lit > 0.02)
    assert lost <= (0.2 if shape == "mesh" else 0)


# Frozen functions ------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", ("one light", "lights", "mirrors", "glass", "sizes"))
def test_frozen_rendering(case):
    """`dr.freeze` records a rendering, replays it bit by bit, and follows changed parameters."""
    bsdf = {"one light": {"type": "phong"}, "glass": {"type": "dielectric"}}.get(
        case, {"type": "mirrorblend", "km": 0.5, "b": {"type": "blinnphong"}}
    )
    objects = {"ball": sphere([0, 0.5, 0], 0.5, bsdf), "a": point([1, 3, 1])}
    if case != "one light":
        objects["b"] = {"type": "directional", "direction": [1, -2, 0.5]}
        objects["sky"] = {"type": "constant", "radiance": 0.2}
    size = 1000.0 if case == "sizes" else 1.0
    objects["ground"] = sphere([0, -size, 0], size, {"type": "phong", "kd": 0.5, "ks": 0})
    loaded = mi.load_dict(scene(sensor=look([0, 2, 4], [0, 0.3, 0]), **objects))
    key = next(key for key in mi.traverse(loaded).keys() if key.endswith("kd.value"))  # noqa: SIM118

    def step(scene, value, seed):
        params = mi.traverse(scene)
        params[key] = value
        params.update()
        return mi.render(scene, seed=seed)

    frozen = dr.freeze(step)
    pictures = []
    for seed, value in enumerate((0.2, 0.9, 0.4, 0.9)):
        pictures.append(np.array(frozen(loaded, dr.opaque(mi.Float, value), mi.UInt32(seed))))
        assert np.array_equal(pictures[-1], np.array(step(loaded, dr.opaque(mi.Float, value), seed)))
    assert np.array_equal(pictures[1], pictures[3]) and not np.array_equal(pictures[0], pictures[1])
    assert frozen.n_recordings <= 3


# Bad input --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"max_depth": 0}, "whitted: 'max_depth' must be -1 or an integer >= 1, got 0"),
        ({"max_depth": -2}, "whitted: 'max_depth' must be -1 or an integer >= 1, got -2"),
        ({"convention": "lecture"}, "whitted: 'convention' must be 'course' or 'physical', got 'lecture'"),
        ({"shadows": 3}, "whitted: 'shadows' must be true or false, got 3"),
        ({"ambient": -1.0}, "whitted: 'ambient' must be finite and >= 0, got -1"),
        ({"depth": 3}, "depth"),
    ],
)
def test_bad_parameters_are_errors_at_load(parameters, message):
    """The message names plugin, parameter and value."""
    with pytest.raises(RuntimeError) as error:
        mi.load_dict({"type": "whitted", **parameters})
    assert message in str(error.value)


@pytest.mark.parametrize("emitter", ("area", "sunsky"))
def test_lights_without_a_direction_are_refused(emitter):
    """An area light has no single direction, a sky with a sun is more than a background: the error names it."""
    if emitter == "area":
        lamp = {**sphere([0, 1, 0], 0.1, {"type": "phong"}), "emitter": {"type": "area", "id": "the lamp"}}
    else:
        lamp = {"type": "sunsky", "id": "the lamp"}
    with pytest.raises(RuntimeError) as error:
        render(scene(floor=floor({"type": "phong"}), lamp=lamp))
    assert "whitted: cannot render with the emitter 'the lamp'" in str(error.value.__cause__)
    assert "'path'" in str(error.value.__cause__)


def test_no_scene_is_kept_alive():
    """Rendering leaves nothing behind that would slow later scenes down."""
    import gc

    def alive():
        gc.collect()
        return sum(type(o).__name__ in ("Phong", "Whitted", "Tracer") for o in gc.get_objects())

    before = alive()
    for _ in range(3):
        render(scene(floor=floor({"type": "phong"}), light=point([0, 1, 0])))
    assert alive() == before
    dr.sync_thread()
