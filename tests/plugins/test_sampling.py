"""What samples are worth: no more noise than Mitsuba's `roughplastic`, bounded weights, few samples lost."""

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from helpers.bsdfs import interaction
from phong_bsdf.reflection.albedo import directional_albedo

VOCABULARIES = {
    "coefficients": ("kd", "ks", "p"),
    "reflectances": ("diffuse_reflectance", "specular_reflectance", "exponent"),
}
GLOSSY = {
    "phong": lambda p: {
        "type": "phong", "diffuse_reflectance": 0.4, "specular_reflectance": 0.04, "exponent": p / 4,
    },
    "blinnphong": lambda p: {
        "type": "blinnphong", "diffuse_reflectance": 0.4, "specular_reflectance": 0.04, "exponent": p,
    },
    "blinnphong, coefficients": lambda p: {"type": "blinnphong", "kd": 0.4, "ks": 0.04 * (p + 2) / 8, "p": p},
    "roughplastic": lambda p: {"type": "roughplastic", "diffuse_reflectance": 0.4, "alpha": math.sqrt(2 / (p + 2))},
}  # fmt: skip


def glossy_scene(bsdf, light):
    """A ball on a floor, under a lamp or under a white sky."""
    t = mi.ScalarTransform4f
    lights = {
        "lamp": {
            "type": "rectangle",
            "to_world": t().look_at([2, 4, 3], [0, 0, 0], [0, 1, 0]),
            "emitter": {"type": "area", "radiance": 8.0},
        },
        "sky": {"type": "constant", "radiance": 0.7},
    }
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 3},
            "sensor": {
                "type": "perspective",
                "fov": 35,
                "to_world": t().look_at([0, 2, 6], [0, 0.3, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 48, "height": 48, "rfilter": {"type": "box"}},
                "sampler": {"type": "independent"},
            },
            "floor": {
                "type": "rectangle",
                "to_world": t().translate([0, -1, 0]).rotate([1, 0, 0], -90).scale([8, 8, 1]),
                "bsdf": bsdf,
            },
            "ball": {"type": "sphere", "bsdf": bsdf},
            light: lights[light],
        }
    )


def relative_variance(bsdf, light, passes=24, spp=16):
    """Variance of one sample, over the square of the picture's mean."""
    scene = glossy_scene(bsdf, light)
    images = np.array([np.array(mi.render(scene, seed=i, spp=spp)).mean(axis=2) for i in range(passes)])
    return images.var(axis=0, ddof=1).mean() * spp / images.mean() ** 2


@pytest.mark.slow
@pytest.mark.parametrize("p", (10, 30, 300, 3000))
@pytest.mark.parametrize("light", ("lamp", "sky"))
def test_no_more_noise_than_roughplastic(light, p):
    """At the matched roughness alpha = sqrt(2 / (p + 2)) and its reflectance at normal incidence, 0.04."""
    limit = relative_variance(GLOSSY["roughplastic"](p), light)
    for name, bsdf in GLOSSY.items():
        # 55 000 pixels: each variance is known to 1 %. At p = 10 the two are within 3 %.
        assert relative_variance(bsdf(p), light) <= 1.01 * limit, name


def samples(kind, vocabulary, diffuse, specular, p, cos, n=2**16):
    bsdf = mi.load_dict(
        {"type": kind, **dict(zip(VOCABULARIES[vocabulary], (diffuse, specular, float(p)), strict=True))}
    )
    rng = mi.PCG32(n)
    si = interaction(mi.Vector3f(math.sqrt(1 - cos**2), 0, cos) + dr.zeros(mi.Vector3f, n))
    bs, weight = bsdf.sample(
        mi.BSDFContext(), si, rng.next_float32(), mi.Point2f(rng.next_float32(), rng.next_float32())
    )
    return bs, weight.x.numpy()


@pytest.mark.parametrize("p", (0, 1, 30, 1e3, 1e5))
@pytest.mark.parametrize("vocabulary", VOCABULARIES)
@pytest.mark.parametrize("kind", ("phong", "blinnphong"))
def test_weights_are_bounded(kind, vocabulary, p):
    """By the albedo: that at normal incidence for a lobe alone, four times that of this angle with a diffuse base."""
    reflectance = vocabulary == "reflectances"
    for cos in (1, 0.7, 0.3, 0.05, 0.001):
        _, weight = samples(kind, vocabulary, 0, 0.4, p, cos)
        # What Blinn-Phong's Jacobian 4 (v.h) adds for broad lobes.
        bound = 0.4 * directional_albedo(kind, 1, p, reflectance=reflectance) * (1 + 7 / (p + 1))
        assert weight.max() <= bound * (1 + 1e-5)
        _, weight = samples(kind, vocabulary, 0.5, 0.4, p, cos)
        assert weight.max() <= 4 * (0.5 + 0.4 * directional_albedo(kind, cos, p, reflectance=reflectance))


@pytest.mark.parametrize("p", (0, 1, 30, 1e3, 1e5))
@pytest.mark.parametrize("vocabulary", VOCABULARIES)
@pytest.mark.parametrize("kind", ("phong", "blinnphong"))
def test_mean_weight_is_the_albedo(kind, vocabulary, p):
    """At every angle, to four deviations."""
    for cos in (1, 0.7, 0.3, 0.05, 0.001):
        _, weight = samples(kind, vocabulary, 0.2, 0.4, p, cos)
        albedo = 0.2 + 0.4 * directional_albedo(kind, cos, p, reflectance=vocabulary == "reflectances")
        # 1e-5: float32, at grazing angles where the lobe is cut.
        assert weight.mean() == pytest.approx(albedo, abs=float(4 * weight.std() / 256 + 1e-5))


@pytest.mark.parametrize("cos", (1, 0.5, 0.05, 1e-4))
@pytest.mark.parametrize("p", (0, 1, 30, 1e5))
def test_few_samples_are_lost(p, cos):
    """Of `phong` none is below the surface; of `blinnphong` those of half vectors beyond 45 degrees can be."""
    bs, _ = samples("phong", "coefficients", 0, 1, p, cos)
    # One in a thousand may lie within a rounding of the horizon.
    assert dr.count(bs.pdf == 0)[0] <= 65
    bs, _ = samples("blinnphong", "coefficients", 0, 1, p, cos)
    beyond_45_degrees = 0.5 ** ((p + 1) / 2)
    lost = dr.count(bs.pdf == 0)[0] / 2**16
    assert lost <= beyond_45_degrees + 4 * math.sqrt(beyond_45_degrees / 2**16) + 1e-3


# One strategy alone ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ("phong", "blinnphong"))
@pytest.mark.parametrize("sampling", ("cosine", "lobe"))
def test_sampling_changes_no_value(kind, sampling):
    """Only how directions are drawn: f stays, the density is that of the strategy, and samples follow it."""
    description = {"type": kind, "kd": 0.4, "ks": 0.3, "p": 20}
    mixture, alone = mi.load_dict(description), mi.load_dict({**description, "sampling": sampling})
    n, rng = 2**12, mi.PCG32(2**12)
    si, ctx = interaction(mi.Vector3f(0.6, 0, 0.8) + dr.zeros(mi.Vector3f, n)), mi.BSDFContext()
    wo = mi.warp.square_to_uniform_hemisphere(mi.Point2f(rng.next_float32(), rng.next_float32()))
    value, pdf = alone.eval_pdf(ctx, si, wo)
    assert dr.allclose(value, mixture.eval(ctx, si, wo), rtol=0, atol=0)
    lobe = mi.load_dict({**description, "kd": 0})
    expected = wo.z * dr.inv_pi if sampling == "cosine" else lobe.pdf(ctx, si, wo)
    assert dr.allclose(pdf, expected, rtol=1e-6)
    bs, weight = alone.sample(ctx, si, rng.next_float32(), mi.Point2f(rng.next_float32(), rng.next_float32()))
    assert dr.allclose(weight * bs.pdf, alone.eval(ctx, si, bs.wo), rtol=1e-5)
    kinds = {"cosine": mi.BSDFFlags.DiffuseReflection, "lobe": mi.BSDFFlags.GlossyReflection}
    assert dr.all(bs.sampled_type == int(kinds[sampling]))


@pytest.mark.parametrize("kind", ("phong", "blinnphong"))
@pytest.mark.parametrize("sampling", ("cosine", "lobe"))
@pytest.mark.parametrize("part", ({"kd": 0, "ks": 0.3}, {"kd": 0.4, "ks": 0}))
def test_sampling_of_one_component(kind, sampling, part):
    """By cosine a lobe without a base, too; a base without a lobe has nothing but the cosine."""
    p = 5
    bsdf = mi.load_dict({"type": kind, **part, "p": p, "sampling": sampling})
    by_cosine = sampling == "cosine" or part["ks"] == 0
    si, ctx, wo = interaction(mi.Vector3f(0.6, 0, 0.8)), mi.BSDFContext(), dr.normalize(mi.Vector3f(-0.5, 0.1, 0.7))
    pdf = bsdf.pdf(ctx, si, wo)
    assert dr.allclose(pdf, wo.z * dr.inv_pi, rtol=1e-6) == by_cosine
    bs, weight = bsdf.sample(ctx, si, 0.3, mi.Point2f(0.4, 0.7))
    assert dr.allclose(weight * bs.pdf, bsdf.eval(ctx, si, bs.wo), rtol=1e-5)
    # What was sampled is a component that the BSDF has.
    assert dr.all(bs.sampled_type == (bsdf.flags() & int(mi.BSDFFlags.Smooth)))


@pytest.mark.parametrize("kind", ("phong", "blinnphong"))
@pytest.mark.parametrize("sampling", ("cosine", "lobe"))
def test_one_strategy_follows_its_density(kind, sampling):
    """Chi-square, at an oblique angle."""
    parameters = f'<float name="ks" value="2"/><float name="p" value="20"/><string name="sampling" value="{sampling}"/>'
    sample, pdf = mi.chi2.BSDFAdapter(kind, parameters, wi=[0.6, 0, 0.8])
    test = mi.chi2.ChiSquareTest(
        domain=mi.chi2.SphericalDomain(), sample_func=sample, pdf_func=pdf, sample_dim=3, ires=16, res=101
    )
    assert test.run(), test.messages


def test_unknown_sampling():
    """Named, with what there is."""
    with pytest.raises(RuntimeError, match="'sampling' must be mixture, cosine, lobe, got 'both'"):
        mi.load_dict({"type": "phong", "sampling": "both"})
