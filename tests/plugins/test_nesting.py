"""In every variant, inside of every adapter, the BSDFs do what a native one does."""

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from helpers.bsdfs import (
    ADAPTERS,
    LOBES,
    OURS,
    first,
    formula,
    interaction,
    material,
    mirror,
    normals,
    number,
    pane,
    pixels,
    row,
)
from helpers.small_scenes import render

# Each of them is quick, all of them are not.
pytestmark = pytest.mark.slow

# Every variant ----------------------------------------------------------------------------------------------


def test_values_and_types(any_variant):
    """`eval`, `pdf` and `sample` return the variant's own types, and the formula's numbers, unpolarized."""
    wi, wo = dr.normalize(mi.Vector3f(0.3, 0.1, 0.9)), dr.normalize(mi.Vector3f(-0.2, 0.3, 0.9))
    si, ctx = interaction(wi), mi.BSDFContext()
    for name, parameters in OURS.items():
        bsdf = mi.load_dict(parameters)
        kind, _, vocabulary = name.partition(" ")
        expected = formula(kind, vocabulary, wi, wo)[0] if vocabulary else 0.7 * formula(
            "blinnphong", "coefficients", wi, wo)[0]  # fmt: skip
        value, pdf = bsdf.eval(ctx, si, wo), bsdf.pdf(ctx, si, wo)
        assert type(value) is mi.Spectrum and type(pdf) is mi.Float
        # The exponent of 20 multiplies the roundings of the direction.
        assert first(value) == pytest.approx(expected, rel=1e-5)
        if mi.is_polarized:
            # A depolarizer: all but the intensity is lost.
            entries = [value[i, j] for i in range(4) for j in range(4)][1:]
            assert all(dr.all(entry == 0, axis=None) for entry in entries)
        bs, weight = bsdf.sample(ctx, si, 0.9, mi.Point2f(0.3, 0.6))
        assert type(bs) is mi.BSDFSample3f and type(weight) is mi.Spectrum
        assert first(weight) * number(bs.pdf) == pytest.approx(first(bsdf.eval(ctx, si, bs.wo)), rel=1e-5)


@pytest.mark.parametrize("integrator", ("path", "direct"))
def test_pictures_in_every_variant(any_variant, integrator):
    """Under a directional light each picture is that of a native `diffuse`, times the ratio of the formulas."""
    light = {"type": "directional", "direction": [0.3, 0.4, -1], "irradiance": 2.0}
    wi, wo = dr.normalize(mi.Vector3f(0.5, 0, math.sqrt(0.75))), dr.normalize(mi.Vector3f(-0.3, -0.4, 1))
    # The same seed draws the same wavelengths, so even noise is the same.
    native = render(pane({"type": "diffuse", "reflectance": 0.4}, {"type": integrator}, light=light))
    assert native.min() > 0.05
    for name, parameters in OURS.items():
        kind, _, vocabulary = name.partition(" ")
        value = formula(kind, vocabulary, wi, wo) if vocabulary else 0.7 * formula("blinnphong", "coefficients", wi, wo)
        # The camera's thousandth of a degree, which the exponent of 20 multiplies.
        picture = render(pane(parameters, {"type": integrator}, light=light))
        assert picture == pytest.approx(native * value[0] / (0.4 / math.pi * number(wo.z)), rel=1e-4)


# Nesting ----------------------------------------------------------------------------------------------------

ALL_LOBES = [OURS[f"{kind} {vocabulary}"] for kind, vocabulary in LOBES]


def dull(kind, vocabulary, reflectance=0.4):
    return material(kind, vocabulary, reflectance, 0)


@pytest.mark.parametrize("integrator", ("path", "direct"))
@pytest.mark.parametrize("adapter", ADAPTERS)
def test_adapters_hold_them_as_they_hold_diffuse(adapter, integrator):
    """Without a highlight, the picture is the native `diffuse`'s: random numbers are used in the same way."""
    wrap = ADAPTERS[adapter]
    options = {"type": integrator, **({"max_depth": 4} if integrator == "path" else {})}

    def flipped(ball):
        return [{**ball, "flip_normals": adapter == "two sides"}]

    ours = render(row([wrap(dull(*lobe)) for lobe in LOBES], options, flipped))
    native = render(row([wrap({"type": "diffuse", "reflectance": 0.4})] * 4, options, flipped))
    # A rounding, and no sample that went elsewhere.
    assert ours == pytest.approx(native, rel=1e-4, abs=1e-5)
    assert np.ptp(native) > 0.3


def instances(ball):
    """The same ball, as an instance of a group."""
    name = f"group {ball['center'][0]:.1f}".replace(".", "_")
    group = {"type": "shapegroup", "ball": ball, "id": name}
    return [group, {"type": "instance", "ref": {"type": "ref", "id": name}}]


@pytest.mark.parametrize("integrator", ("path", "direct"))
def test_adapters_that_change_nothing(integrator):
    """Glossy ones and mirrors inside of adapters that do nothing, and of instances, look as they do alone."""
    options = {"type": integrator, **({"max_depth": 4} if integrator == "path" else {})}
    bsdfs = list(OURS.values())
    plain = render(row(bsdfs, options))
    assert np.ptp(plain) > 0.5
    again = render(row([{"type": "twosided", "b": b} for b in bsdfs], options))
    assert again == pytest.approx(plain, rel=1e-4, abs=1e-5)
    inside = render(row(bsdfs, options, instances))
    # Mitsuba intersects instances in their own space: a few rays at a silhouette miss.
    assert np.mean(np.abs(inside - plain).max(axis=2) > 1e-3) < 0.03
    # These turn the frame about the normal, and with it the samples: what needs no sample is the same.
    lit = {"sky": {"type": "constant", "radiance": 0.0}}
    plain = render(row(bsdfs, {"type": "direct"}, **lit))
    assert np.ptp(plain) > 0.5
    for wrap in (
        lambda b: {"type": "bumpmap", "t": {**pixels([[[0.3]]]), "filter_type": "bilinear"}, "b": b},
        lambda b: {"type": "normalmap", "normalmap": normals(0), "b": b},
    ):
        # The map's normal has a rounding, which the highlight multiplies.
        picture = render(row([wrap(b) for b in bsdfs], {"type": "direct"}, **lit))
        assert picture == pytest.approx(plain, rel=1e-3, abs=1e-5)


def test_adapters_that_share():
    """`mask` and `blendbsdf` show their share of a highlight, `twosided` the same from behind."""
    light = {"type": "directional", "direction": [0.3, 0.4, -1], "irradiance": 2.0}
    for bsdf in OURS.values():
        plain = render(pane(bsdf, {"type": "direct"}, light=light))
        half = render(pane({"type": "mask", "opacity": 0.6, "b": bsdf}, {"type": "direct"}, light=light))
        assert half == pytest.approx(0.6 * plain, rel=1e-5)
        grey = {"type": "diffuse", "reflectance": 0.9}
        under = render(pane(grey, {"type": "direct"}, light=light))
        blend = {"type": "blendbsdf", "weight": 0.3, "a": bsdf, "b": grey}
        assert render(pane(blend, {"type": "direct"}, light=light)) == pytest.approx(
            0.7 * plain + 0.3 * under, rel=1e-5
        )
        scene = pane({"type": "twosided", "a": grey, "b": bsdf}, {"type": "direct"}, light=light)
        scene["pane"]["flip_normals"] = True
        # Seen from behind, Mitsuba turns both directions about an axis of the frame: the plane of incidence remains.
        assert render(scene) == pytest.approx(plain, rel=1e-5)


SKY = [[[0.2, 0.5, 1]] * 2, [[1, 0.6, 0.1]] * 2]
NATIVE = ("diffuse", "roughplastic", "roughconductor", "plastic", "dielectric", "principled")


@pytest.mark.parametrize("nested", NATIVE)
def test_mirrors_over_native_bsdfs(nested):
    """In `path`, on a pane under a sky: km of what a perfect mirror shows, and 1 - km of what the nested one shows."""

    def picture(bsdf, spp, seed=0):
        sky = {"type": "envmap", "bitmap": mi.Bitmap(np.array(SKY, np.float32))}
        light = {"type": "directional", "direction": [0.3, 0.4, -1], "irradiance": 2.0}
        return render(pane(bsdf, {"type": "path", "max_depth": 3}, spp=spp, width=8, sky=sky, light=light), seed=seed)

    # Of 64 independent pixels each; a pane scatters light once, so the picture is linear in f.
    blend = picture(mirror({"type": nested}, 0.4), 256)
    inside, perfect = picture({"type": nested}, 256, seed=1), picture({"type": "conductor"}, 4)
    expected = 0.4 * perfect.mean((0, 1)) + 0.6 * inside.mean((0, 1))
    deviation = np.sqrt((blend.var((0, 1)) + 0.36 * inside.var((0, 1))) / 63) + 1e-6
    assert np.all(np.abs(blend.mean((0, 1)) - expected) < 4 * deviation)
    # It would be seen if 3 % of the mirror went missing.
    assert np.all(4 * deviation < 0.03 * blend.mean((0, 1)))
