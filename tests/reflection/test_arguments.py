"""What Python code may hand to a BSDF: all that Mitsuba's own take."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from helpers.bsdfs import BSDFS, interaction

# Each is the same direction, and the same random numbers, in another form.
DIRECTIONS = {
    "list": lambda: [0.6, 0.0, 0.8],
    "tuple": lambda: (0.6, 0.0, 0.8),
    "point": lambda: mi.Point3f(0.6, 0, 0.8),
    "normal": lambda: mi.Normal3f(0.6, 0, 0.8),
    "scalar vector": lambda: mi.ScalarVector3f(0.6, 0, 0.8),
    "float64": lambda: np.array([0.6, 0, 0.8]),
    "float32": lambda: np.array([0.6, 0, 0.8], np.float32),
}
SAMPLES = {
    "list": lambda: (0.7, [0.3, 0.4]),
    "tuple": lambda: (0.7, (0.3, 0.4)),
    "vector": lambda: (0.7, mi.Vector2f(0.3, 0.4)),
    "scalar point": lambda: (0.7, mi.ScalarPoint2f(0.3, 0.4)),
    "array": lambda: (np.float64(0.7), np.array([0.3, 0.4])),
}
MASKS = (True, False)


def same(a, b):
    """Whether two results are the same, bit by bit: arrays, samples, or tuples of them."""
    if isinstance(a, tuple):
        return all(map(same, a, b))
    if isinstance(a, mi.BSDFSample3f):
        return same((a.wo, a.pdf, a.eta), (b.wo, b.pdf, b.eta))
    return np.array_equal(np.array(a), np.array(b))


@pytest.mark.parametrize("kind", BSDFS)
def test_directions_in_any_form(kind, any_variant):
    """`eval`, `pdf` and `eval_pdf` give the same for a direction as a list, tuple, array or vector of any kind."""
    bsdf, ctx, si = mi.load_dict(BSDFS[kind]), mi.BSDFContext(), interaction(mi.Vector3f(0, 0, 1))
    wo = mi.Vector3f(0.6, 0, 0.8)
    for active in MASKS:
        expected = bsdf.eval(ctx, si, wo, active), bsdf.pdf(ctx, si, wo, active), bsdf.eval_pdf(ctx, si, wo, active)
        assert not active or dr.all(dr.ravel(mi.Vector3f(expected[1])) > 0)
        for form, make in DIRECTIONS.items():
            w = make()
            got = bsdf.eval(ctx, si, w, active), bsdf.pdf(ctx, si, w, active), bsdf.eval_pdf(ctx, si, w, active)
            assert same(got, expected), form


@pytest.mark.parametrize("kind", BSDFS)
def test_random_numbers_in_any_form(kind, any_variant):
    """`sample` gives the same for random numbers as Python's, NumPy's or Mitsuba's."""
    bsdf, ctx, si = mi.load_dict(BSDFS[kind]), mi.BSDFContext(), interaction(mi.Vector3f(0, 0, 1))
    expected = bsdf.sample(ctx, si, mi.Float(0.7), mi.Point2f(0.3, 0.4))
    for form, make in SAMPLES.items():
        assert same(bsdf.sample(ctx, si, *make()), expected), form


@pytest.mark.parametrize("kind", BSDFS)
def test_many_directions_as_an_array(kind):
    """A NumPy array of shape (3, n) is n directions, as for Mitsuba's own."""
    bsdf, ctx = mi.load_dict(BSDFS[kind]), mi.BSDFContext()
    si = interaction(mi.Vector3f(0, 0, 1) + dr.zeros(mi.Vector3f, 2))
    wo = np.array([[0.6, 0.0], [0.0, 0.6], [0.8, 0.8]])
    assert same(bsdf.eval(ctx, si, wo), bsdf.eval(ctx, si, mi.Vector3f(wo)))


@pytest.mark.parametrize("kind", BSDFS)
@pytest.mark.parametrize("wrong", ("up", [0, 1], None))
def test_what_is_no_direction_is_a_type_error(kind, wrong):
    """As Mitsuba's own BSDFs say it."""
    bsdf, si = mi.load_dict(BSDFS[kind]), interaction(mi.Vector3f(0, 0, 1))
    for method in (bsdf.eval, bsdf.pdf, bsdf.eval_pdf):
        with pytest.raises(TypeError):
            method(mi.BSDFContext(), si, wrong)


# Means over channels -------------------------------------------------------------------------------------


@pytest.mark.parametrize("differentiated", (False, True))
@pytest.mark.parametrize("channels", (1, 3))
@pytest.mark.parametrize("name", ("ks", "kd", "p", "specular_reflectance"))
@pytest.mark.parametrize("kind", ("phong", "blinnphong"))
def test_densities_of_large_texels_are_numbers(kind, name, channels, differentiated):
    """Densities of texels of 3e38 and infinity are finite, whatever the number of lanes, in samples too."""
    texels = np.full((4, 4, channels), 0.3, np.float32)
    texels[1, 1], texels[2, 2] = 3e38, np.inf
    image = {"type": "bitmap", "raw": True, "filter_type": "nearest", "bitmap": mi.Bitmap(texels)}
    bsdf = mi.load_dict({"type": kind, name: image})
    if differentiated:
        params = mi.traverse(bsdf)
        dr.enable_grad(params[f"{name}.data"])
        params.update()
    n = 4096
    rng = mi.PCG32(n)
    numbers = [rng.next_float32() for _ in range(7)]
    si = interaction(mi.Vector3f(0, 0.6, 0.8) + dr.zeros(mi.Vector3f, n))
    si.uv = mi.Point2f(*numbers[:2])
    wo = mi.warp.square_to_uniform_hemisphere(mi.Point2f(*numbers[2:4]))
    density = bsdf.pdf(mi.BSDFContext(), si, wo)
    sample, weight = bsdf.sample(mi.BSDFContext(), si, numbers[4], mi.Point2f(*numbers[5:]))
    assert dr.all(dr.isfinite(density)) and dr.all(dr.isfinite(sample.pdf))
    assert dr.all(dr.isfinite(weight), axis=None)


@pytest.mark.parametrize("kind", BSDFS)
def test_densities_do_not_depend_on_the_number_of_lanes(kind):
    """One direction has the same density, bit by bit, alone and among thousands."""
    colour = {"type": "rgb", "value": [0.1, 0.7, 0.3]}
    name = "km" if kind == "mirrorblend" else "ks"
    bsdf = mi.load_dict({**BSDFS[kind], name: colour})
    wi, wo = mi.Vector3f(0, 0.6, 0.8), mi.Vector3f(0.48, 0.36, 0.8)
    alone = bsdf.pdf(mi.BSDFContext(), interaction(wi), wo)[0]
    for n in (3, 1000, 12345):
        many = bsdf.pdf(mi.BSDFContext(), interaction(wi + dr.zeros(mi.Vector3f, n)), wo)
        assert dr.all(many == alone), n


@pytest.mark.parametrize("kind", BSDFS)
def test_a_constant_out_of_range_that_is_differentiated(kind):
    """Its range cannot be checked; its density is a number all the same."""
    colour = {"type": "rgb", "value": [0.1, 0.7, 0.3]}
    name = "km" if kind == "mirrorblend" else "ks"
    bsdf = mi.load_dict({**BSDFS[kind], name: colour})
    params = mi.traverse(bsdf)
    key = f"{name}.value"
    value = mi.Color3f(3e38)
    dr.enable_grad(value)
    params[key] = value
    params.update()
    density = bsdf.pdf(mi.BSDFContext(), interaction(mi.Vector3f(0, 0.6, 0.8)), mi.Vector3f(0, -0.6, 0.8))
    assert dr.all(dr.isfinite(density))
