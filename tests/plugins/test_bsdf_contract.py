"""What every BSDF of the package owes to Mitsuba."""

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from helpers.bsdfs import BSDFS, WITH_LOBES, hemisphere, incidence, interaction

ANGLES = (0, 20, 45, 70, 85)


# The lecture's unit points: n = (0, 0, -1), point at the origin, kd = ks = .9, p = 200 ----------------------

A = math.sqrt(2) / 2
UNIT_POINTS = [
    ((0, 0, -1), (0, 0, -10), 1.8, 1.8),
    ((0, A, -A), (0, 0, -10), 0.9, 0.900000119),
    ((0, 0, -1), (0, 10, -10), 0.636396103, 0.636396223),
    ((0, -A, -A), (0, 10, -10), 1.536396103, 1.536396103),
    ((0, 0, -1), (0, 0, 10), 0, 0),
]


@pytest.mark.parametrize(("viewer", "light", "phong", "blinnphong"), UNIT_POINTS)
def test_unit_points(any_variant, viewer, light, phong, blinnphong):
    """The lecture's values come out to float32 precision in every variant, as pi times f cos."""
    frame = mi.Frame3f(mi.Vector3f(0, 0, -1))
    wi, wo = (frame.to_local(dr.normalize(mi.Vector3f(*v))) for v in (viewer, light))
    for kind, expected in (("phong", phong), ("blinnphong", blinnphong)):
        bsdf = mi.load_dict({"type": kind, "kd": 0.9, "ks": 0.9, "p": 200})
        value = mi.unpolarized_spectrum(bsdf.eval(mi.BSDFContext(), interaction(wi), wo, True)) * dr.pi
        # Five roundings on the way, and an exponent of 200 at a half angle of 22.5 degrees.
        assert float(dr.ravel(value)[0] if dr.is_jit_v(mi.Float) else value[0]) == pytest.approx(expected, abs=4e-7)


@pytest.mark.parametrize("kind", BSDFS)
def test_eval_pdf_is_eval_and_pdf(kind, any_variant):
    """`eval_pdf` returns exactly what `eval` and `pdf` do."""
    bsdf, ctx = mi.load_dict(BSDFS[kind]), mi.BSDFContext()
    wi, wo = incidence(40), dr.normalize(mi.Vector3f(0.3, -0.2, 0.8))
    si = interaction(wi)
    value, pdf = bsdf.eval_pdf(ctx, si, wo, True)
    assert dr.allclose(value, bsdf.eval(ctx, si, wo, True), rtol=0, atol=0)
    assert dr.allclose(pdf, bsdf.pdf(ctx, si, wo, True), rtol=0, atol=0)
    assert dr.all(mi.unpolarized_spectrum(value) > 0, axis=None)


@pytest.mark.slow
@pytest.mark.parametrize("degrees", ANGLES)
@pytest.mark.parametrize("p", (0, 1, 30, 1000))
@pytest.mark.parametrize("kind", WITH_LOBES)
def test_samples_follow_the_density(kind, p, degrees):
    """Chi-square of `sample` against `pdf`, both lobes together."""
    theta = math.radians(degrees)
    parameters = f'<float name="ks" value="2"/><float name="p" value="{p}"/>'
    sample, pdf = mi.chi2.BSDFAdapter(kind, parameters, wi=[math.sin(theta), 0, math.cos(theta)])
    # The resolution must see the lobe: 1000 is half a degree wide in 1 of 404 columns.
    test = mi.chi2.ChiSquareTest(
        domain=mi.chi2.SphericalDomain(), sample_func=sample, pdf_func=pdf, sample_dim=3, ires=32, res=203
    )
    assert test.run(), test.messages


@pytest.mark.parametrize("degrees", ANGLES)
@pytest.mark.parametrize("kind", BSDFS)
def test_weight_times_density_is_the_value(kind, degrees):
    """For every sample of a smooth lobe, weight x pdf = eval."""
    bsdf, ctx = mi.load_dict(BSDFS[kind]), mi.BSDFContext()
    n = 10000
    rng = mi.PCG32(n)
    si = interaction(incidence(degrees) + dr.zeros(mi.Vector3f, n))
    bs, weight = bsdf.sample(ctx, si, rng.next_float32(), mi.Point2f(rng.next_float32(), rng.next_float32()))
    smooth = (bs.pdf > 0) & ~mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
    assert dr.count(smooth)[0] > n / 10
    value, pdf = bsdf.eval_pdf(ctx, si, bs.wo, smooth)
    assert dr.allclose(dr.select(smooth, weight * bs.pdf, 0), value, rtol=1e-5)
    assert dr.allclose(dr.select(smooth, bs.pdf, 0), pdf, rtol=1e-5)


@pytest.mark.parametrize("kind", BSDFS)
def test_samples_integrate_to_the_albedo(kind):
    """The mean weight equals the integral of `eval` over the hemisphere, plus km for the mirror."""
    bsdf, ctx = mi.load_dict(BSDFS[kind]), mi.BSDFContext()
    n = 2**20
    rng = mi.PCG32(n)
    si = interaction(incidence(50) + dr.zeros(mi.Vector3f, n))
    _, weight = bsdf.sample(ctx, si, rng.next_float32(), mi.Point2f(rng.next_float32(), rng.next_float32()))
    integral = dr.mean(bsdf.eval(ctx, si, hemisphere(n, 7)) * dr.two_pi, axis=1)
    mirror = 0.5 if kind == "mirrorblend" else 0
    # Both are Monte Carlo means of 2^20 samples; 4e-3 is more than four deviations of either.
    assert dr.allclose(dr.mean(weight, axis=1), integral + mirror, atol=4e-3)


@pytest.mark.parametrize("kind", BSDFS)
def test_surfaces_are_black_from_behind_and_below(kind):
    """One-sided: 0 unless both directions are above the surface."""
    bsdf, ctx = mi.load_dict(BSDFS[kind]), mi.BSDFContext()
    up, down = incidence(30), -incidence(30)
    for wi, wo in ((up, down), (down, up), (down, down)):
        value, pdf = bsdf.eval_pdf(ctx, interaction(wi), wo)
        assert dr.all(value == 0) and dr.all(pdf == 0)
    _, weight = bsdf.sample(ctx, interaction(down), 0.1, mi.Point2f(0.3, 0.6))
    assert dr.all(weight == 0)


@pytest.mark.parametrize("kind", WITH_LOBES)
def test_components_are_what_can_be_seen(kind):
    """kd = 0 leaves no diffuse component, ks = 0 no glossy one; each can be asked for alone."""
    diffuse, glossy = mi.BSDFFlags.DiffuseReflection, mi.BSDFFlags.GlossyReflection
    both = mi.load_dict({"type": kind})
    assert both.component_count() == 2
    assert mi.has_flag(both.flags(0), diffuse) and mi.has_flag(both.flags(1), glossy)
    for parameters, present, absent in (({"kd": 0}, glossy, diffuse), ({"ks": 0}, diffuse, glossy)):
        bsdf = mi.load_dict({"type": kind, **parameters})
        assert bsdf.component_count() == 1
        assert mi.has_flag(bsdf.flags(), present) and not mi.has_flag(bsdf.flags(), absent)

    si, wo = interaction(incidence(30)), incidence(50)
    whole = both.eval(mi.BSDFContext(), si, wo)
    parts = [both.eval(mi.BSDFContext(mi.TransportMode.Radiance, 0x1FF, i), si, wo) for i in (0, 1, 2)]
    assert dr.allclose(parts[0] + parts[1], whole) and dr.all(parts[2] == 0)
    assert dr.allclose(parts[0], 0.5 / math.pi * math.cos(math.radians(50)))


@pytest.mark.parametrize("km", (0, 0.25, 0.5, 1))
def test_mirrorblend_shares_the_light(km):
    """White furnace: the mirror gives km and a white Lambertian under it 1 - km, exactly and in sampling shares."""
    bsdf = mi.load_dict({"type": "mirrorblend", "km": km, "nested": {"type": "phong", "kd": 1, "ks": 0}})
    n = 2**16
    rng = mi.PCG32(n)
    si = interaction(incidence(60) + dr.zeros(mi.Vector3f, n))
    bs, weight = bsdf.sample(
        mi.BSDFContext(), si, rng.next_float32(), mi.Point2f(rng.next_float32(), rng.next_float32())
    )
    mirror = mi.has_flag(bs.sampled_type, mi.BSDFFlags.DeltaReflection)
    # Every sample carries all the light; the shares are km and 1 - km, within four deviations.
    assert dr.allclose(weight, 1, rtol=1e-5)
    assert dr.count(mirror)[0] / n == pytest.approx(km, abs=4 * math.sqrt(km * (1 - km) / n))
    assert dr.all(dr.select(mirror, bs.pdf, km) == km)
    assert dr.all(dr.select(mirror, bs.wo, mi.reflect(si.wi)) == mi.reflect(si.wi), axis=None)
    assert mi.has_flag(bsdf.flags(), mi.BSDFFlags.DeltaReflection) == (km > 0)


@pytest.mark.parametrize("nested", ("diffuse", "roughconductor", "plastic", "dielectric", "phong"))
def test_mirrorblend_wraps_any_bsdf(nested):
    """f = (1 - km) f_nested for native BSDFs too, component by component."""
    inside = mi.load_dict({"type": nested})
    bsdf = mi.load_dict({"type": "mirrorblend", "km": 0.3, "nested": {"type": nested}})
    si, wo = interaction(incidence(30)), incidence(30, azimuth=math.pi + 0.7)
    ctx = mi.BSDFContext()
    assert dr.allclose(bsdf.eval(ctx, si, wo), 0.7 * inside.eval(ctx, si, wo))
    assert dr.allclose(bsdf.pdf(ctx, si, wo), 0.7 * inside.pdf(ctx, si, wo))
    assert bsdf.component_count() == 1 + inside.component_count()
    for i in range(inside.component_count()):
        alone = mi.BSDFContext(mi.TransportMode.Radiance, 0x1FF, i)
        shifted = mi.BSDFContext(mi.TransportMode.Radiance, 0x1FF, i + 1)
        bs, weight = inside.sample(alone, si, 0.4, mi.Point2f(0.3, 0.6))
        bs2, weight2 = bsdf.sample(shifted, si, 0.4, mi.Point2f(0.3, 0.6))
        assert dr.allclose(weight2, 0.7 * weight) and dr.allclose(bs2.wo, bs.wo)


def test_textures_are_read_and_clamped():
    """Textures give kd, ks, p and km; values outside the legal range are clamped to it."""
    values = np.array([[[-1.0, 0.5, 2.0]]], np.float32)

    def texture():
        return {"type": "bitmap", "bitmap": mi.Bitmap(values), "raw": True}

    si, wo = interaction(incidence(0)), incidence(60)
    bsdf = mi.load_dict({"type": "phong", "kd": texture(), "ks": 0})
    assert dr.allclose(bsdf.eval(mi.BSDFContext(), si, wo) * dr.pi, mi.Color3f(0, 0.25, 1))
    # The exponent is the channels' mean, 0.5.
    bsdf = mi.load_dict({"type": "phong", "kd": 0, "ks": 1, "p": texture()})
    assert dr.allclose(bsdf.eval(mi.BSDFContext(), si, wo) * dr.pi, math.sqrt(0.5))
    bsdf = mi.load_dict({"type": "mirrorblend", "km": texture(), "nested": {"type": "phong", "kd": 1, "ks": 0}})
    assert dr.allclose(bsdf.eval(mi.BSDFContext(), si, wo) * dr.pi, mi.Color3f(0.5, 0.25, 0))


def test_mesh_attributes_are_textures():
    """Colours in the vertices of a mesh give kd, ks and km."""
    mesh = mi.Mesh("triangle", 3, 1, has_vertex_normals=False, has_vertex_texcoords=False)
    params = mi.traverse(mesh)
    params["vertex_positions"] = [-1, -1, 0, 1, -1, 0, 0, 1, 0]
    params["faces"] = [0, 1, 2]
    params.update()
    mesh.add_attribute("vertex_color", 3, [0.2, 0.4, 0.6] * 3)
    si = mi.load_dict({"type": "scene", "mesh": mesh}).ray_intersect(mi.Ray3f([0, 0, 1], [0, 0, -1]))
    colour = {"type": "mesh_attribute", "name": "vertex_color"}
    for bsdf, expected in (
        ({"type": "phong", "kd": colour, "ks": 0}, (0.2, 0.4, 0.6)),
        ({"type": "phong", "kd": 0, "ks": colour, "p": 0}, (0.2, 0.4, 0.6)),
        ({"type": "mirrorblend", "km": colour, "b": {"type": "phong", "kd": 1, "ks": 0}}, (0.8, 0.6, 0.4)),
    ):
        value = mi.load_dict(bsdf).eval(mi.BSDFContext(), si, mi.Vector3f(0, 0, 1)) * dr.pi
        assert dr.allclose(value, mi.Color3f(*expected))


@pytest.mark.parametrize(
    ("bsdf", "message"),
    [
        ({"type": "phong", "p": -1.0}, "phong: 'p' must be finite and >= 0, got -1"),
        ({"type": "phong", "p": math.nan}, "phong: 'p' must be finite and >= 0, got nan"),
        ({"type": "blinnphong", "p": math.inf}, "blinnphong: 'p' must be finite and >= 0, got inf"),
        ({"type": "phong", "kd": -0.1}, "phong: 'kd' must be finite and >= 0, got -0.1"),
        (
            {"type": "phong", "ks": {"type": "rgb", "value": [1, -2, 3]}},
            "phong: 'ks' must be finite and >= 0, got [1, -2, 3]",
        ),
        ({"type": "phong", "kd": "red"}, "phong: 'kd' must be finite and >= 0, got red"),
        ({"type": "phong", "shininess": 3.0}, "shininess"),
        ({"type": "mirrorblend", "km": 1.5, "b": {"type": "diffuse"}}, "mirrorblend: 'km' must be in [0, 1], got 1.5"),
        ({"type": "mirrorblend", "km": 0.5}, "mirrorblend: needs exactly one nested BSDF, got 0"),
        ({"type": "mirrorblend", "kmm": 0.4, "b": {"type": "diffuse"}}, "kmm"),
        ({"type": "mirrorblend", "kmm": {"type": "checkerboard"}, "b": {"type": "diffuse"}}, "kmm"),
        (
            {"type": "mirrorblend", "a": {"type": "diffuse"}, "b": {"type": "phong"}},
            "mirrorblend: needs exactly one nested BSDF, got 2",
        ),
    ],
)
def test_bad_parameters_are_errors_at_load(bsdf, message):
    """The message names plugin, parameter and value."""
    with pytest.raises(RuntimeError) as error:
        mi.load_dict(bsdf)
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("bsdf", "parameter", "bad"),
    [
        ({"type": "phong"}, "kd", -2.0),
        ({"type": "phong"}, "p", -5.0),
        ({"type": "blinnphong"}, "ks", math.nan),
        ({"type": "blinnphong"}, "p", math.inf),
        ({"type": "mirrorblend", "b": {"type": "diffuse"}}, "km", 3.0),
    ],
)
def test_bad_constants_are_errors_however_they_come(bsdf, parameter, bad, any_variant):
    """As a spectrum, and through an update, too; what arrives as an object, at the first look at it."""
    message = f"{bsdf['type']}: '{parameter}' must be"
    with pytest.raises(RuntimeError, match=message):
        mi.load_dict({**bsdf, parameter: {"type": "spectrum", "value": bad}})
    made = mi.load_dict({**bsdf, parameter: {"type": "uniform", "value": bad}})
    for look in (mi.traverse, lambda made: made.eval(mi.BSDFContext(), interaction(incidence(0)), incidence(0), True)):
        with pytest.raises(ValueError, match=message):
            look(made)
    if mi.is_spectral:
        with pytest.raises(RuntimeError, match=message):
            mi.load_dict({**bsdf, parameter: {"type": "spectrum", "value": [(400.0, 0.1), (700.0, bad)]}})
    params = mi.traverse(mi.load_dict({**bsdf, parameter: 0.5}))
    params[f"{parameter}.value"] = bad
    with pytest.raises(ValueError, match=message):
        params.update()


def test_parameters_can_be_changed():
    """`traverse` lists every parameter, and an update counts, components included."""
    bsdf = mi.load_dict(BSDFS["mirrorblend"])
    params = mi.traverse(bsdf)
    assert {key.rsplit(".", 1)[0] for key in params.keys()} >= {  # noqa: SIM118
        "km", "nested_bsdf.kd", "nested_bsdf.ks", "nested_bsdf.p",
    }  # fmt: skip
    params["nested_bsdf.kd.value"] = 0.25
    params["nested_bsdf.ks.value"] = 0
    params["km.value"] = 0
    params.update()
    value = bsdf.eval(mi.BSDFContext(), interaction(incidence(0)), incidence(0)) * dr.pi
    assert dr.allclose(value, 0.25)
    assert not mi.has_flag(bsdf.flags(), mi.BSDFFlags.Delta)
    assert "Phong" in str(bsdf)


@pytest.mark.parametrize("value", (3e38, 1e38, 1e-38))
@pytest.mark.parametrize("kind", WITH_LOBES)
def test_no_infinity_leaves_for_any_finite_parameter(kind, value):
    """eval, pdf and sample of the largest and smallest numbers are numbers."""
    n = 1000
    rng = mi.PCG32(n)
    xi = mi.Point2f(rng.next_float32(), rng.next_float32())
    for parameters in ({"kd": value, "ks": value, "p": value}, {"kd": value, "ks": value, "p": 1}, {"exponent": value}):
        bsdf = mi.load_dict({"type": kind, **parameters})
        for wi in (incidence(0), incidence(89.99)):
            si = interaction(wi + dr.zeros(mi.Vector3f, n))
            bs, weight = bsdf.sample(mi.BSDFContext(), si, rng.next_float32(), xi)
            f, pdf = bsdf.eval_pdf(mi.BSDFContext(), si, hemisphere(n))
            for x in (weight, bs.pdf, f, pdf):
                assert dr.all(dr.isfinite(x), axis=None)


def test_infinite_texels_are_clamped():
    """A texture's infinities and NaNs become numbers."""
    texels = np.array([[[np.inf], [np.nan]]], np.float32)
    texture = {"type": "bitmap", "bitmap": mi.Bitmap(texels), "raw": True, "filter_type": "nearest"}
    for parameter in ("kd", "ks", "p"):
        bsdf = mi.load_dict({"type": "phong", parameter: texture})
        si = interaction(incidence(30) + dr.zeros(mi.Vector3f, 2))
        si.uv = mi.Point2f([0.25, 0.75], 0.5)
        f, pdf = bsdf.eval_pdf(mi.BSDFContext(), si, mi.reflect(si.wi))
        assert dr.all(dr.isfinite(f) & dr.isfinite(pdf), axis=None)


def test_phong_of_exponent_0_is_sampled_everywhere():
    """The lobe is then 1 above the whole surface, and so are its samples: their mean weight is the albedo, 2 ks."""
    bsdf = mi.load_dict({"type": "phong", "kd": 0, "ks": 1, "p": 0})
    n = 2**12
    rng = mi.PCG32(n)
    si = interaction(incidence(80) + dr.zeros(mi.Vector3f, n))
    _, weight = bsdf.sample(mi.BSDFContext(), si, 0.5, mi.Point2f(rng.next_float32(), rng.next_float32()))
    assert dr.allclose(weight, 2)
