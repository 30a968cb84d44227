"""The scenes of `scenes/stress/`, each against the value that its header promises."""

import mitsuba as mi
import numpy as np
import pytest

from helpers import SCENES, oracle

STRESS = SCENES / "stress"


def render(name, **defines):
    scene = mi.load_file(str(STRESS / f"{name}.xml"), **{k: str(v) for k, v in defines.items()})
    image = np.array(mi.render(scene))
    assert np.all(np.isfinite(image))
    return image


def close_to_oracle(image, scene, edges=0.003):
    """Off edges and contacts (see `test_whitted.py`) within 3e-4."""
    height, width = image.shape[:2]
    error = np.abs(image - oracle.render(scene, width, height)).max(axis=2)
    assert np.mean(error > 3e-4) <= edges
    assert np.mean(error > 1e-2) <= max(edges / 3, 1e-3)


def grey(x):
    return (x, x, x)


TINY_AND_HUGE = oracle.Scene(
    [
        oracle.Sphere((0, -1, -5), 1, (0.8, 0.2, 0.2), grey(0.5), 50),
        oracle.Sphere((1.2, -1.6, -4.2), 0.4, (0.2, 0.8, 0.2), grey(0.5), 50, km=0.3),
        oracle.Sphere((-1.1, -1.7, -4), 0.3, (0.2, 0.2, 0.8), grey(0.5), 50),
        oracle.Sphere((0, -1002, -5), 1000, km=0.3),
    ],
    [oracle.Light(0.7, (2, 6, -1)), oracle.Light(0.3, toward=(-1, 2, 1))],
    oracle.Camera(view=(0, -0.25, -1)),
)

TWO_BALLS = [
    oracle.Sphere((0, -0.5, -5), 1, (0.8, 0.3, 0.2), grey(0.5), 50),
    oracle.Sphere((1.2, 0.3, -4), 0.3, (0.2, 0.3, 0.8), grey(0.5), 50, km=0.3),
    oracle.Sphere((0, -51.5, -5), 50),
]


@pytest.mark.parametrize("name", ("tiny", "huge"))
def test_size_does_not_matter(name):
    """Three balls that touch a floor, at 1e-3 and at 1e4 times the size: contact shadows close, nothing leaks."""
    close_to_oracle(render(name), TINY_AND_HUGE)


def test_light_far():
    """A light at distance 2e7 is a directional one."""
    close_to_oracle(render("light-far"), oracle.Scene(TWO_BALLS, [oracle.Light(0.9, toward=(1, 2, 1))]))


def test_radii_from_1e_3_to_1e4():
    """Three sizes seven decades apart; only what touches the resolution of the largest may differ."""
    spheres = [
        oracle.Sphere((0, 0, -0.01), 1e-3, (0.8, 0.3, 0.2), grey(0.5), 50),
        oracle.Sphere((1.2, 0.3, -4), 1, (0.2, 0.3, 0.8), grey(0.5), 50),
        oracle.Sphere((0, -10001, -5), 1e4),
    ]
    scene = oracle.Scene(spheres, [oracle.Light(0.9, (0.5, 1, 0.5))])
    image = render("radii")
    truth = oracle.render(scene, 128, 128)
    # The course's camera sees nothing nearer than 1, and the small ball is at 0.01: it is put there by hand.
    nearer = oracle.render(scene, 128, 128, start=1e-3)
    assert np.any(truth != nearer)
    error = np.abs(image - nearer).max(axis=2)
    assert np.mean(error > 3e-4) <= 0.005


def heights(extent, height):
    """0.8 cos(theta) of a light at `height` over a plane of which the picture shows `extent` to each side."""
    x = (np.arange(33) - 16) / 16.5 * extent
    return 0.8 * height / np.sqrt(height**2 + x[:, None] ** 2 + x[None, :] ** 2)


def test_light_near_a_surface():
    """At 1e-4: lit by the cosine, not blocked by the floor itself."""
    truth = heights(0.1 * np.tan(np.radians(0.5)), 1e-4)
    image = render("light-near")[..., 0]
    assert image[16, 16] == pytest.approx(0.8, rel=1e-6)
    # Mitsuba's camera matrix places the rays of so small a field of view to a few hundredths of a pixel only.
    assert image == pytest.approx(truth, rel=0.01)


def test_light_on_a_surface():
    """The ball that the light touches does not block it."""
    assert render("light-on-surface")[..., 0] == pytest.approx(heights(1.0, 1.5), rel=1e-5)


def test_facing_mirrors_end():
    """An endless chain of km = 0.9 converges to its limit."""
    limit = 0.1 * (0.3 + 0.9 * 0.8) / (1 - 0.81)
    assert render("facing-mirrors") == pytest.approx(limit, abs=2e-6)


def test_thousand_bounces():
    """1000 bounces with km = 0.999, the last surface undiminished; 1000 roundings and no more."""
    km, shades = 0.999, (0.3, 0.8)
    truth = sum(km**i * (1 - km) * shades[i % 2] for i in range(1000)) + km**1000 * shades[0]
    assert render("thousand-bounces") == pytest.approx(truth, rel=1000 * 2**-24)
    assert round(truth, 4) == 0.458


def test_mirrors_everywhere():
    """km = 1 on all surfaces, before a background of the shade that the last surface has."""
    assert render("all-mirrors") == pytest.approx(0.5, rel=1e-6)


@pytest.mark.parametrize("intensity", (1e-30, 1e30))
def test_intensities(intensity):
    """The picture is proportional to the light, thirty decades up and down."""
    one = render("intensities")
    image = render("intensities", intensity=intensity)
    assert one.max() > 0.5
    assert image.astype(np.float64) / intensity == pytest.approx(one, rel=1e-5, abs=1e-7)


def test_exponents_from_0_to_1e6():
    """One texture from p = 0 to 1e6: 1 where the light is straight above, cos(theta)^p beside it."""
    assert render("exponents", tilt=0) == pytest.approx(1, abs=1e-6)
    p = 1e6 * (np.arange(64) + 0.5) / 64
    theta = 0.5 * np.arctan(0.002)
    image = render("exponents")[4, :, 0]
    truth = np.cos(theta) ** p
    # The interpolated exponent has a few roundings: p ln cos(theta) of them.
    assert image == pytest.approx(truth, rel=1e-5)


@pytest.mark.parametrize("variant", ("llvm_ad_rgb", "scalar_rgb"))
@pytest.mark.parametrize("intensity", (1e-30, 1e-36, 1e30))
@pytest.mark.parametrize("distance", (1e-4, 1, 1e4, 1e7))
@pytest.mark.parametrize("kind", ("point", "spot"))
def test_intensity_is_that_of_the_light_at_any_distance(kind, distance, intensity, variant):
    """No falloff is applied and undone: kd I comes out of a plane seen straight from above, exactly."""
    if (kind, intensity, distance) in {("spot", 1e-36, 1e4), ("spot", 1e-30, 1e7), ("spot", 1e-36, 1e7)}:
        pytest.skip("the intensity of a spot is read at 1/64 of its distance from the origin: 1/r^2 underflows")
    mi.set_variant(variant)
    t = mi.ScalarTransform4f()
    toward = t.look_at([0, 0, distance], [0, 0, 0], [0, 1, 0])
    light = {"position": [0, 0, distance]} if kind == "point" else {"to_world": toward, "cutoff_angle": 40}
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "whitted"},
            "sensor": {
                "type": "perspective",
                "fov": 0.01,
                "to_world": t.look_at([0, 0, 2], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}},
                "sampler": {"type": "independent", "sample_count": 1},
            },
            "plane": {"type": "rectangle", "bsdf": {"type": "phong", "kd": 0.5, "ks": 0}},
            "light": {"type": kind, "intensity": intensity, **light},
        }
    )
    assert np.array(mi.render(scene)) == pytest.approx(0.5 * intensity, rel=1e-5)
