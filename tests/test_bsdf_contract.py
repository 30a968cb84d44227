"""What every BSDF of the package owes to Mitsuba."""

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

BSDFS = {
    "phong": {"type": "phong", "kd": {"type": "rgb", "value": [0.9, 0.3, 0.1]}, "ks": 0.4, "p": 30},
    "blinnphong": {"type": "blinnphong", "kd": {"type": "rgb", "value": [0.9, 0.3, 0.1]}, "ks": 0.4, "p": 30},
    "mirrorblend": {"type": "mirrorblend", "km": 0.5, "nested": {"type": "blinnphong", "ks": 0.7, "p": 100}},
}
ANGLES = (0, 20, 45, 70, 85)


def incidence(degrees, azimuth=0.7):
    theta = math.radians(degrees)
    return mi.Vector3f(math.sin(theta) * math.cos(azimuth), math.sin(theta) * math.sin(azimuth), math.cos(theta))


def interaction(wi):
    si = dr.zeros(mi.SurfaceInteraction3f, dr.width(wi))
    si.wi, si.p, si.uv = wi, mi.Point3f(0), mi.Point2f(0.5)
    return si


def hemisphere(n, seed=0):
    rng = mi.PCG32(n, seed)
    return mi.warp.square_to_uniform_hemisphere(mi.Point2f(rng.next_float32(), rng.next_float32()))


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
@pytest.mark.parametrize("kind", ("phong", "blinnphong"))
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


@pytest.mark.parametrize("kind", ("phong", "blinnphong"))
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


# Derivatives ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("p", (0, 30, 1e6))
@pytest.mark.parametrize("kind", ("phong", "blinnphong"))
def test_derivatives_of_the_parameters(kind, p):
    """d/d kd, ks, p and km of `eval` under a mirrorblend are those of the formula."""
    bsdf = mi.load_dict({"type": "mirrorblend", "km": 0.3, "b": {"type": kind, "kd": 0.6, "ks": 0.8, "p": p}})
    params = mi.traverse(bsdf)
    n = 64
    wi, wo = incidence(30), hemisphere(n)
    if p == 1e6:
        # Within the highlight.
        wo = dr.normalize(mi.reflect(wi) + 1e-3 * wo)
    si = interaction(wi + dr.zeros(mi.Vector3f, n))
    v, w = (np.array(x, np.float64).T for x in (si.wi, wo))
    axis, other = (v * [-1, -1, 1], w) if kind == "phong" else (np.array([[0.0, 0, 1]]), v + w)
    sin = np.linalg.norm(np.cross(axis, other), axis=1) / np.linalg.norm(other, axis=1)
    cos = np.sum(axis * other, axis=1) / np.linalg.norm(other, axis=1)
    log_cos = np.where(cos > 0.9, 0.5 * np.log1p(-(sin**2)), np.log(np.maximum(cos, 1e-30)))
    lobe = np.where(cos > 0, np.exp(p * log_cos), float(p == 0))
    f = 0.6 * w[:, 2] + 0.8 * lobe
    expected = {
        "nested_bsdf.kd.value": 0.7 * w[:, 2] / math.pi,
        "nested_bsdf.ks.value": 0.7 * lobe / math.pi,
        "nested_bsdf.p.value": 0.7 * 0.8 * lobe * log_cos / math.pi,
        "km.value": -f / math.pi,
    }
    # 0^p has no derivative at p = 0.
    defined = (cos > 0) | (p > 0)
    for key, truth in expected.items():
        parameter = mi.Float(dr.detach(params[key]))
        dr.enable_grad(parameter)
        params[key] = parameter
        params.update()
        value = bsdf.eval(mi.BSDFContext(), si, wo)
        dr.forward(parameter)
        computed = dr.grad(value).x.numpy()
        # Some u (1 + kappa), at p = 1e6 and 1e-3 off the axis.
        tolerance = {"rel": 1e-3 if p == 1e6 else 1e-5, "abs": 1e-6 * np.abs(truth).max()}
        assert computed[defined] == pytest.approx(truth[defined], **tolerance)


@pytest.mark.parametrize("p", (0, 1, 1e8))
@pytest.mark.parametrize("kind", BSDFS)
def test_derivatives_of_samples_are_finite(kind, p):
    """Weight and density of samples, with respect to every parameter, xi = 0 and xi -> 1 included."""
    parameters = {**BSDFS[kind]}
    nested = {**parameters["nested"], "p": p} if kind == "mirrorblend" else None
    bsdf = mi.load_dict({**parameters, "nested": nested} if nested else {**parameters, "p": p})
    params = mi.traverse(bsdf)
    keys = [key for key in params.keys() if key.endswith(".value")]  # noqa: SIM118
    for key in keys:
        dr.enable_grad(params[key])
    params.update()
    xi = [0, 2.0**-24, 0.3, 0.999, 1 - 2.0**-24]
    for wi in (incidence(0), incidence(60), mi.Vector3f(1, 0, 1e-7)):
        si = interaction(wi + dr.zeros(mi.Vector3f, 5))
        for choice in (0.0, 0.5, 0.999):
            bs, weight = bsdf.sample(mi.BSDFContext(), si, mi.Float(choice), mi.Point2f(mi.Float(xi), 0.4))
            dr.backward(dr.sum(weight.x) + dr.sum(bs.pdf), flags=dr.ADFlag.Default | dr.ADFlag.AllowNoGrad)
            for key in keys:
                assert dr.all(dr.isfinite(dr.grad(params[key])), axis=None), (key, choice)


@pytest.mark.parametrize("p", (0, 30, 1e8))
@pytest.mark.parametrize("kind", ("phong", "blinnphong"))
def test_derivatives_of_the_shading_normal(kind, p):
    """Through the shading frame: finite, and equal to central differences in float64 where p allows them."""
    bsdf = mi.load_dict({"type": kind, "kd": 0.5, "ks": 0.5, "p": p})
    viewer, light = mi.Vector3f(0.3, 0.1, 0.9), mi.Vector3f(-0.5, 0.3, 0.7)
    viewer, light = dr.normalize(viewer), dr.normalize(light)

    def truth(n):
        v, w = np.array(viewer, np.float64).ravel(), np.array(light, np.float64).ravel()
        n = n / np.linalg.norm(n)
        axis, other = (2 * n.dot(v) * n - v, w) if kind == "phong" else (n, (v + w) / np.linalg.norm(v + w))
        return (0.5 * n.dot(w) + 0.5 * max(axis.dot(other), 0) ** p) / math.pi

    normal = dr.normalize(mi.Vector3f(0.05, 0.1, 1))
    dr.enable_grad(normal)
    frame = mi.Frame3f(dr.normalize(normal))
    si = interaction(frame.to_local(viewer))
    value = bsdf.eval(mi.BSDFContext(), si, frame.to_local(light))
    dr.backward(value.x)
    gradient = np.array(dr.grad(normal)).ravel()
    assert np.all(np.isfinite(gradient))
    if p <= 30:
        n = np.array(normal, np.float64).ravel()
        steps = np.eye(3) * 1e-6
        expected = [(truth(n + h) - truth(n - h)) / 2e-6 for h in steps]
        assert gradient == pytest.approx(expected, rel=1e-4, abs=1e-5)
