"""Derivatives of the BSDFs: finite everywhere, and those of the formulas."""

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from helpers.bsdfs import BSDFS, hemisphere, incidence, interaction


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


# Where a parameter is 0 ----------------------------------------------------------------------------------


@pytest.mark.parametrize("update", (False, True))
@pytest.mark.parametrize("parameter", ("kd", "ks"))
def test_a_zero_that_is_differentiated_is_not_left_out(parameter, update):
    """Its component has a derivative; `params.update()` is not needed for it."""
    bsdf = mi.load_dict({"type": "phong", "kd": 0, "ks": 0, "p": 3})
    params = mi.traverse(bsdf)
    dr.enable_grad(params[f"{parameter}.value"])
    if update:
        params.update()
    value = bsdf.eval(mi.BSDFContext(), interaction(incidence(0)), incidence(60))
    dr.backward(value.x)
    expected = {"kd": 0.5, "ks": 0.5**3}[parameter] / math.pi
    assert dr.grad(params[f"{parameter}.value"])[0] == pytest.approx(expected, rel=1e-5)


def mirror_scene(km, kd=0.5, ks=0.0, light=None, integrator="whitted", **options):
    """A floor under a ceiling; both are lit, the floor mirrors the ceiling."""
    t = mi.ScalarTransform4f()
    floor = {"type": "phong", "kd": kd, "ks": ks, "p": 2}
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": integrator, **options},
            "sensor": {
                "type": "perspective",
                "to_world": t.look_at([0, 1, 3], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}},
                "sampler": {"type": "independent", "sample_count": 1},
            },
            "floor": {
                "type": "rectangle",
                "to_world": t.rotate([1, 0, 0], -90).scale([20, 20, 1]),
                "bsdf": {"type": "mirrorblend", "id": "mirror", "km": km, "nested": floor},
            },
            "ceiling": {
                "type": "rectangle",
                "to_world": t.translate([0, 4, 0]).rotate([1, 0, 0], 90).scale([20, 20, 1]),
                "bsdf": {"type": "phong", "kd": 0.8, "ks": 0.0},
            },
            "light": light or {"type": "point", "position": [0, 2, 0]},
        }
    )


def gradient(scene, name, update=False, **options):
    params = mi.traverse(scene)
    key = next(key for key in params.keys() if key.startswith("floor.") and key.endswith(f".{name}.value"))  # noqa: SIM118
    dr.enable_grad(params[key])
    if update:
        params.update()
    dr.backward(dr.mean(mi.render(scene, params, **options)))
    return dr.grad(params[key])[0]


@pytest.mark.parametrize("name", ("km", "kd", "ks"))
def test_whitted_at_zero(name):
    """All parameters enter linearly: the derivative at 0 is that at 1/1000."""
    build = {"km": mirror_scene, "kd": lambda x: mirror_scene(0.3, kd=x), "ks": lambda x: mirror_scene(0.3, ks=x)}[name]
    at_zero, near = (gradient(build(x), name) for x in (0.0, 1e-3))
    assert at_zero == pytest.approx(near, rel=1e-4) and at_zero != 0


def test_general_kernels_are_differentiated():
    """`specialize` = false has the derivative of the specialised kernel."""
    special, general = (gradient(mirror_scene(0.3, specialize=flag), "km") for flag in (True, False))
    assert general == pytest.approx(special, rel=1e-4)


LIGHTS = {
    "point": {"type": "point", "position": [0, 2, 0]},
    "sky": {"type": "constant", "radiance": 0.5},
    "lamp": {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().look_at([1, 3.5, 0], [0, 0, 0], [0, 0, 1]),
        "emitter": {"type": "area", "radiance": 2.0},
    },
}


@pytest.mark.slow
@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("km", (0.0, 0.02, 0.5, 1.0))
def test_path_differentiates_the_blend(km, light):
    """d/dkm in Mitsuba's `path`, where one of the two that are blended is absent, too, is a difference of pictures."""

    def scene(km):
        return mirror_scene(km, light=LIGHTS[light], integrator="path", max_depth=3)

    # The picture is linear in km. Over ten seeds both differ by less than 1 %.
    expected = np.array(mi.render(scene(1.0), spp=2**14)).mean() - np.array(mi.render(scene(0.0), spp=2**14)).mean()
    assert gradient(scene(km), "km", spp=2**14) == pytest.approx(expected, rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("integrator", ("path", "prb"))
@pytest.mark.parametrize("name", ("kd", "ks"))
def test_indirect_light_at_zero(name, integrator):
    """The picture is all but linear in kd and ks: at 0 the derivative is that at 1/100, indirect light included."""

    def scene(x):
        scales = {"kd": 0.5, "ks": 0.4, name: x}
        return mirror_scene(0.0, **scales, light=LIGHTS["lamp"], integrator=integrator, max_depth=3)

    at_zero, near = (gradient(scene(x), name, update=True, spp=2**14) for x in (0.0, 0.01))
    assert at_zero == pytest.approx(near, rel=0.03)


# Sample weights ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("p", (0.0, 3.0, 1e4, 1e8))
@pytest.mark.parametrize("kd", (0.0, 0.5))
@pytest.mark.parametrize("kind", ("phong", "blinnphong"))
def test_derivatives_of_sample_weights(kind, kd, p):
    """d weight = d eval / pdf, the direction and its density held fixed: so E[weight] has the right derivative."""
    bsdf = mi.load_dict({"type": kind, "kd": kd, "ks": 0.4, "p": p})
    params = mi.traverse(bsdf)
    xi = [0, 2.0**-24, 0.1, 0.3, 0.7, 0.999, 1 - 2.0**-24]
    si = interaction(incidence(40) + dr.zeros(mi.Vector3f, len(xi)))
    for name in ("kd", "ks", "p"):
        key = f"{name}.value"
        dr.enable_grad(params[key])
        bs, weight = bsdf.sample(mi.BSDFContext(), si, 0.9, mi.Point2f(mi.Float(xi), 0.4))
        dr.forward(params[key])
        computed = dr.grad(weight).x.numpy()
        assert not dr.grad_enabled(bs.wo) and not dr.grad_enabled(bs.pdf)
        dr.enable_grad(params[key])
        value = bsdf.eval(mi.BSDFContext(), si, bs.wo)
        dr.forward(params[key])
        pdf = bs.pdf.numpy()
        expected = np.where(pdf > 0, dr.grad(value).x.numpy() / np.where(pdf > 0, pdf, 1), 0)
        dr.disable_grad(params[key])
        assert np.all(np.isfinite(computed))
        assert computed == pytest.approx(expected, rel=1e-5)
