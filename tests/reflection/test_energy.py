"""Samples follow their density and carry the albedo; no more light is reflected than arrives."""

import itertools
import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from helpers.bsdfs import (
    KINDS,
    RADIANCE,
    VOCABULARIES,
    both_lobes,
    draw,
    formula,
    hemisphere,
    incidence,
    interaction,
    material,
    pane,
    pixels,
)
from helpers.small_scenes import render
from phong_bsdf.reflection.albedo import directional_albedo

# Each of them is quick, all of them are not.
pytestmark = pytest.mark.slow

# Sampling ---------------------------------------------------------------------------------------------------

# Normal incidence, grazing, and off the axes.
INCIDENCES = [(0, 0), (10, 100), (30, 200), (45, 300), (60, 45), (75, 135), (82, 10), (88, 250)]


def chi_square(kind, vocabulary, p, wi, resolution):
    names = VOCABULARIES[vocabulary]
    values = "".join(f'<float name="{n}" value="{v}"/>' for n, v in zip(names, (0.4, 0.55, p), strict=True))
    sample, pdf = mi.chi2.BSDFAdapter(kind, values, wi=[wi.x[0], wi.y[0], wi.z[0]])
    return mi.chi2.ChiSquareTest(
        domain=mi.chi2.SphericalDomain(), sample_func=sample, pdf_func=pdf, sample_dim=3, ires=32, res=resolution,
        sample_count=200_000,
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("p", (0, 1, 30))
@both_lobes
def test_samples_follow_the_density(kind, vocabulary, p):
    """Chi-square of `sample` against `pdf` over the sphere, from eight directions, both lobes together."""
    for degrees, azimuth in INCIDENCES:
        wi = incidence(degrees, math.radians(azimuth))
        test = chi_square(kind, vocabulary, p, wi, 61)
        # 96 tests: none may be significant at 1e-4 by chance more often than once in 100 seeds.
        assert test.run(1e-4, test_count=96), (degrees, azimuth, test.messages)


def lobe_coordinates(kind, wi, wo, p):
    """cos^(p + 1) of the angle to the lobe's axis, and the azimuth about it in turns: both uniform in a whole lobe."""
    wi, wo = (np.array(w, np.float64).reshape(3, -1).T for w in (wi, wo))
    wi, wo = (w / np.linalg.norm(w, axis=1, keepdims=True) for w in (wi, wo))
    axis, other = (wi * [-1, -1, 1], wo) if kind == "phong" else (np.array([[0.0, 0, 1]]), wi + wo)
    other = other / np.linalg.norm(other, axis=1, keepdims=True)
    s = np.cross(axis, [[1.0, 0, 0]])
    s /= np.linalg.norm(s, axis=1, keepdims=True)
    t = np.cross(axis, s)
    x, y = np.sum(s * other, axis=1), np.sum(t * other, axis=1)
    return np.exp(0.5 * (p + 1) * np.log1p(-(x**2 + y**2))), np.arctan2(y, x) / (2 * np.pi) % 1


def kolmogorov_smirnov(x):
    """Largest distance between the distribution of `x` and the uniform one, in units of 1 / sqrt(n)."""
    x = np.sort(x)
    i = np.arange(len(x))
    return max(np.max((i + 1) / len(x) - x), np.max(x - i / len(x))) * math.sqrt(len(x))


@pytest.mark.slow
@pytest.mark.parametrize("p", (1000, 1e5))
@both_lobes
def test_samples_of_narrow_lobes(kind, vocabulary, p):
    """Kolmogorov-Smirnov on the lobe's own angle and azimuth, as a table over the sphere sees it as one cell.

    At p = 1e5 the lobe is 0.2 degrees wide; a chi-square over the sphere would need a million cells to see its shape.
    """
    bsdf = mi.load_dict(material(kind, vocabulary, 0, 0.9, p))
    for degrees, azimuth in INCIDENCES[:6] if p == 1000 else INCIDENCES:
        wi = incidence(degrees, math.radians(azimuth))
        si, bs, _ = draw(bsdf, wi, 50_000, seed=3)
        u, phi = lobe_coordinates(kind, si.wi, bs.wo, p)
        # Float32 directions move u by (p + 1) tan(theta) 2^-24 / cos(theta_d): at p = 1e5 and 88 degrees by
        # 1e-3, 0.2 of these units. 2.2 is passed by chance once in 8000 tests, of which there are 56 x 2.
        assert kolmogorov_smirnov(u) < 2.2 and kolmogorov_smirnov(phi) < 2.2
        # And the density is that of a whole lobe.
        cos_p = u ** (p / (p + 1))
        expected = (p + 1) / (2 * np.pi) * cos_p
        if kind == "blinnphong":
            v, w = (np.array(x, np.float64).T for x in (si.wi, bs.wo))
            expected = expected / (2 * np.linalg.norm(v + w, axis=1))
        seen = u > 1e-3
        assert np.allclose(np.array(bs.pdf)[seen], expected[seen], rtol=0.05, atol=0)


@pytest.mark.parametrize("vocabulary", VOCABULARIES)
def test_samples_below_the_surface(vocabulary):
    """None of `phong`; of `blinnphong` at p >= 30 not one in 100, those whose half vector is beyond 45 degrees."""
    for kind, p in itertools.product(KINDS, (0, 1, 30, 1000, 1e5)):
        bsdf = mi.load_dict(material(kind, vocabulary, 0, 0.9, p))
        for degrees in (0, 45, 80, 89.9):
            _, bs, weight = draw(bsdf, incidence(degrees), 2**15)
            below = dr.mean(dr.select(bs.wo.z < 0, 1.0, 0.0))[0]
            if kind == "phong":
                assert below == 0
            elif p >= 30:
                assert below < 0.01
            assert dr.all(dr.select(bs.wo.z < 0, weight.x == 0, True))


# Energy -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("p", (0, 1, 30, 1000))
@both_lobes
def test_samples_carry_the_albedo(kind, vocabulary, p):
    """weight x pdf = eval, and the mean weight is the diffuse scale plus the directional albedo of the lobe."""
    bsdf = mi.load_dict(material(kind, vocabulary, 0.3, 0.6, p))
    for degrees in (0, 30, 60, 80, 88):
        si, bs, weight = draw(bsdf, incidence(degrees), 2**17, seed=int(degrees))
        value = bsdf.eval(mi.BSDFContext(), si, bs.wo)
        assert dr.allclose(weight.x * bs.pdf, value.x, rtol=1e-5)
        weight = np.array(weight.x, np.float64)
        cos = math.cos(math.radians(degrees))
        albedo = 0.3 + 0.6 * directional_albedo(kind, cos, p, reflectance=vocabulary == "reflectances")
        # Four deviations of the mean, and float32.
        assert weight.mean() == pytest.approx(albedo, abs=4 * weight.std() / math.sqrt(len(weight)) + 1e-6)
        # Samples are spread as the lobes are. Those of a wide lobe of half vectors less so.
        assert weight.std() < (0.6 if p >= 30 or kind == "phong" else 1.3) * weight.mean()


@pytest.mark.parametrize("degrees", (0, 50, 85))
@pytest.mark.parametrize("p", (1, 100))
@pytest.mark.parametrize("kind", KINDS)
def test_white_furnace(kind, p, degrees):
    """In `path`, before a uniform sky, a surface with reflectances that sum to 1 shows its albedo, at most 1."""
    bsdf = material(kind, "reflectances", 0.5, 0.5, p)
    scene = pane(bsdf, {"type": "path", "max_depth": 100}, degrees, 256, 8, sky={"type": "constant", "radiance": 1.0})
    image = render(scene)[..., 0]
    albedo = 0.5 + 0.5 * float(directional_albedo(kind, math.cos(math.radians(degrees)), p, reflectance=True))
    assert image.mean() == pytest.approx(albedo, abs=4 * float(image.std()) / 8 + 1e-5)
    assert albedo < 1 + 1e-9 and image.mean() < 1 + 4 * float(image.std()) / 8 + 1e-5


@pytest.mark.parametrize("kind", KINDS)
def test_reciprocity(kind):
    """f(wi, wo) = f(wo, wi) with reflectances; the lecture's, whose highlight has no cosine, is not reciprocal."""
    a, b = hemisphere(4096, 1), hemisphere(4096, 2)
    for vocabulary in VOCABULARIES:
        bsdf = mi.load_dict(material(kind, vocabulary, 0.2, 0.7, 30))
        one = bsdf.eval(mi.BSDFContext(), interaction(a), b).x / b.z
        other = bsdf.eval(mi.BSDFContext(), interaction(b), a).x / a.z
        if vocabulary == "reflectances":
            assert dr.allclose(one, other, rtol=1e-4)
        else:
            assert dr.mean(dr.select(dr.abs(one / other - 1) > 0.01, 1.0, 0.0))[0] > 0.1


def bright(values):
    return {"type": "rgb", "value": values}


# Diffuse and specular reflectance, and what both are multiplied with.
ENERGY = {
    "numbers": (0.9, 0.6, 0.99 / 1.5),
    "colours": (bright([0.9, 0.2, 0.1]), bright([0.1, 0.2, 0.95]), 0.99 / 1.05),
    "bitmap": (pixels([[[0.1, 0.2, 0.3]], [[0.2, 0.1, 0.9]]]), 0.4, 0.99 / 1.3),
    "two bitmaps": (pixels([[[0.8], [0.1]]]), pixels([[[0.1], [0.7]]]), 0.99 / 1.5),
    "checkerboard": ({"type": "checkerboard", "color0": 0.2, "color1": 0.8}, 0.4, 0.99 / 1.2),
    "below 1": (0.4, 0.5, 1),
    "1": (0.5, 0.5, 1),
    "colours below 1": (bright([0.9, 0.2, 0.1]), bright([0.1, 0.7, 0.9]), 1),
}


@pytest.mark.parametrize("case", ENERGY)
@pytest.mark.parametrize("variant", ("llvm_ad_rgb", "scalar_rgb"))
@pytest.mark.parametrize("kind", KINDS)
def test_energy_rule(kind, variant, case, messages):
    """The largest channel of the sum of the maxima decides; one warning says what the scale is, and none if it is 1."""
    mi.set_variant(variant)
    diffuse, specular, scale = ENERGY[case]
    # Mitsuba may change a bitmap that it is given: a fresh one each time.
    diffuse, specular = (
        pixels(np.array(x["bitmap"])) if isinstance(x, dict) and "bitmap" in x else x for x in (diffuse, specular)
    )
    bsdf = mi.load_dict(material(kind, "reflectances", diffuse, specular))
    # Warnings wait until somebody looks: while a scene loads they could wait for ever.
    assert messages == []
    mi.traverse(bsdf)
    warnings = list(messages)
    assert len(warnings) == (scale != 1)
    assert scale == 1 or (f"multiplied by {scale:.3g}" in warnings[0] and f"{kind}: " in warnings[0])
    off = mi.load_dict(material(kind, "reflectances", diffuse, specular, ensure_energy_conservation=False))
    assert len(messages) == len(warnings)
    si, wo = interaction(incidence(40)), incidence(30, 3.6)
    for ctx in (mi.BSDFContext(), *(mi.BSDFContext(RADIANCE, 0x1FF, i) for i in (0, 1))):
        assert dr.allclose(bsdf.eval(ctx, si, wo), off.eval(ctx, si, wo) * scale, rtol=1e-5)
    # What the share of the highlight is does not change.
    assert dr.allclose(bsdf.pdf(mi.BSDFContext(), si, wo), off.pdf(mi.BSDFContext(), si, wo))


@pytest.mark.parametrize(("diffuse", "specular"), [(0.4, 0.6), (0.2, 0.8), (0.6, 0.4)])
def test_reflectances_that_sum_to_1_are_kept(diffuse, specular, messages):
    """1 does not exceed 1, whatever the numbers' last bits are."""
    bsdf = mi.load_dict(material("phong", "reflectances", diffuse, specular, 30))
    wi = incidence(0)
    expected = formula("phong", "reflectances", wi, wi, diffuse, specular, 30)[0]
    assert dr.allclose(bsdf.eval(mi.BSDFContext(), interaction(wi), wi), expected, rtol=1e-5)
    assert messages == []


@both_lobes
def test_energy_rule_after_updates(kind, vocabulary):
    """The scale follows updates both ways, of numbers and textures; the lecture's coefficients have none."""
    diffuse, specular, _ = VOCABULARIES[vocabulary]
    wi, wo = incidence(40), incidence(30, 3.6)
    for textured in (False, True):
        bsdf = mi.load_dict(material(kind, vocabulary, pixels(np.full((2, 2, 1), 0.3)) if textured else 0.3, 0.3))
        params = mi.traverse(bsdf)
        for d, s in ((0.9, 0.6), (0.3, 0.3), (0.2, 1.8), (0.9, 0.05), (2.0, 0.0)):
            params[f"{diffuse}.{'data' if textured else 'value'}"] = (
                np.full((2, 2, 1), d, np.float32) if textured else d
            )
            params[f"{specular}.value"] = s
            params.update()
            scale = 0.99 / (d + s) if d + s > 1 and vocabulary == "reflectances" else 1
            expected = scale * formula(kind, vocabulary, wi, wo, d, s)[0]
            assert dr.allclose(bsdf.eval(mi.BSDFContext(), interaction(wi), wo), expected, rtol=1e-5)
            reflectance = bsdf.eval_diffuse_reflectance(interaction(wi))
            assert dr.allclose(reflectance, scale * d, rtol=1e-6)
