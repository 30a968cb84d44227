"""Optimisation within legal ranges, and the examples of docs/inverse-rendering.md."""

import importlib.util
import math
import re

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from helpers import ROOT
from helpers.small_scenes import look, point
from phong_bsdf.optimization import Unknown, bounds

specification = importlib.util.spec_from_file_location("inverse", ROOT / "docs/inverse.py")
inverse = importlib.util.module_from_spec(specification)
specification.loader.exec_module(inverse)


def ball(**bsdf):
    nested = {"type": "blinnphong", "kd": 0.3, "ks": 0.5, "p": 40, **bsdf}
    blend = {"type": "mirrorblend", "km": 0.2, "nested": nested}
    return mi.load_dict(
        {
            "type": "scene", "integrator": {"type": "whitted"}, "sensor": look([0, 0, 5], [0, 0, 0]),
            "lamp": point([2, 3, 4]), "ball": {"type": "sphere", "bsdf": blend},
        }
    )  # fmt: skip


KD, P, KM = "ball.bsdf.nested_bsdf.kd.value", "ball.bsdf.nested_bsdf.p.value", "ball.bsdf.km.value"


def test_exponents_are_held_as_logarithms():
    """One step of the same size changes an exponent of 10 and one of 10000 by the same factor."""
    for p in (10, 10000):
        scene, opt = ball(p=p), mi.ad.SGD(lr=1)
        unknown = Unknown(opt, mi.traverse(scene), [P])
        assert opt[P][0] == pytest.approx(math.log(p)) and unknown.value(P)[0] == pytest.approx(p)
        opt[P] = opt[P] + 0.1
        params = unknown.apply(scene)
        assert params[P][0] == pytest.approx(p * math.exp(0.1)) and dr.grad_enabled(params[P])


@pytest.mark.parametrize(
    ("key", "held", "shown"),
    [(KM, 1.3, 1), (KM, -0.1, 0), (KD, -0.1, 0), (KD, 1.7, 1.7), (P, 99.0, 1e7), (P, -99.0, 1e-2),
     ("lamp.intensity.value", -1, 0)],
)  # fmt: skip
def test_values_stay_legal(key, held, shown):
    """What is out of range goes to its end before the scene sees it; coefficients above 1 are legal."""
    scene, opt = ball(), mi.ad.SGD(lr=1)
    unknown = Unknown(opt, mi.traverse(scene), [key])
    opt[key] = type(opt[key])(held)
    assert np.array(unknown.value(key)).ravel() == pytest.approx(shown)
    assert np.array(unknown.apply(scene)[key]).ravel() == pytest.approx(shown)
    # The next step starts from the end of the range.
    low, high = bounds(key)
    assert np.all((np.array(opt[key]) >= low) & (np.array(opt[key]) <= high))


def test_positions_have_no_range():
    """Nothing is known of them."""
    assert bounds("lamp.position") == (-math.inf, math.inf)
    scene, opt = ball(), mi.ad.SGD(lr=1)
    unknown = Unknown(opt, mi.traverse(scene), ["lamp.position"])
    assert list(unknown.apply(scene)["lamp.position"]) == [[2], [3], [4]]


def test_unknown_keys_are_named():
    """With the keys that there are."""
    scene = ball()
    with pytest.raises(KeyError, match=r"no parameter 'ball.kd' in this scene; it has .*nested_bsdf.kd.value"):
        Unknown(mi.ad.SGD(lr=1), mi.traverse(scene), ["ball.kd"])


def test_a_single_key():
    """Need not be in a list."""
    assert Unknown(mi.ad.SGD(lr=1), mi.traverse(ball()), KD).keys == [KD]


@pytest.mark.parametrize("key", ("ball.bsdf.nested_bsdf.kd.data", "lamp.position"))
def test_what_cannot_be_frozen_is_refused(key):
    """An error that names it, where Mitsuba would end the process or say what it cannot read."""
    scene, opt = ball(kd={"type": "bitmap", "raw": True, "data": mi.TensorXf(np.full((2, 2, 3), 0.5))}), mi.ad.SGD(lr=1)
    unknown = Unknown(opt, mi.traverse(scene), [key])

    @dr.freeze
    def step(scene, opt):
        return mi.render(scene, unknown.apply(scene))

    with pytest.raises(RuntimeError) as error:
        step(scene, opt)
    assert f"dr.freeze cannot change '{key}'" in f"{error.value}{error.value.__cause__}"


def test_texels_leave_the_end_of_their_range():
    """What a step has brought to 0 is not stuck there."""
    dark = {"type": "bitmap", "raw": True, "data": mi.TensorXf(np.zeros((2, 2, 3)))}
    picture, scene, opt = mi.render(ball(kd=0.5)), ball(kd=dark), mi.ad.Adam(lr=0.1)
    key = "ball.bsdf.nested_bsdf.kd.data"
    unknown = Unknown(opt, mi.traverse(scene), key)
    for _ in range(40):
        dr.backward(dr.mean(dr.square(mi.render(scene, unknown.apply(scene)) - picture), axis=None))
        opt.step()
    assert np.array(unknown.value(key)) == pytest.approx(0.5, abs=0.1)


# The page ------------------------------------------------------------------------------------------------


def test_pictures_of_the_page():
    """Each is there, and small; `make inverse` makes them."""
    names = re.findall(r"!\[.*?\]\((.*?)\)", inverse.PAGE.read_text(encoding="utf-8"))
    assert len(names) == 3
    for name in names:
        assert 1000 < (inverse.PAGE.parent / name).stat().st_size < 200_000


@pytest.fixture(scope="module")
def page():
    """What the examples leave behind, run as they stand."""
    names = {}
    for block in inverse.examples():
        inverse.run(block, names)
    return names


@pytest.mark.slow
def test_materials_and_lights_from_one_picture(page):
    """All 24 numbers are found, within 1 % at most; the start is more than 20 % off."""
    unknown, truth, start = page["unknown"], page["truth"], page["START"]
    for key in page["keys"]:
        value, wanted = (np.array(x).ravel() for x in (unknown.value(key), truth[key]))
        assert value == pytest.approx(wanted, rel=1e-2), key
        assert np.all(np.abs(start[key.split(".")[-2]] / wanted - 1) > 0.2)
    # What was found is what the scene holds.
    assert np.array(mi.render(page["scene"])) == pytest.approx(np.array(page["picture"]), abs=1e-3)


@pytest.mark.slow
def test_fitted_exponent_is_the_matched_one(page):
    """A Blinn-Phong fitted to `roughconductor` has the exponent of `compare`'s rule, alpha = sqrt(2 / (p + 2))."""
    assert math.sqrt(2 / (page["exponent"] + 2)) == pytest.approx(0.2, rel=0.02)
    assert page["found"].value("ball.bsdf.specular_reflectance.value")[0] == pytest.approx(1, abs=0.02)


@pytest.mark.slow
def test_texture_of_exponents(page):
    """Found from one picture; the start is off by a factor of 3 and more."""
    errors = page["errors"]
    assert np.median(errors) < 1e-3 and np.quantile(errors, 0.95) < 0.01 and errors.max() < 0.1
