"""Frozen functions follow updates, and kernels are used again."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from helpers.bsdfs import VOCABULARIES, both_lobes, material, mirror, pixels, row
from helpers.small_scenes import render

INTEGRATORS = {"path": {"type": "path", "max_depth": 4}, "direct": {"type": "direct"}}


def values_of(bsdf, vocabulary, scene):
    """Keys of diffuse scale, specular scale and exponent among the parameters of `scene`."""
    keys = list(mi.traverse(scene).keys())
    return [next(key for key in keys if f".{name}.value" in key) for name in VOCABULARIES[vocabulary]]


@pytest.mark.parametrize("mirrored", (False, True))
@pytest.mark.parametrize("integrator", INTEGRATORS)
@both_lobes
def test_frozen_functions_follow_updates(kind, vocabulary, integrator, mirrored):
    """Updates before and inside of a frozen function: bit by bit the picture that is not frozen."""
    bsdf = material(kind, vocabulary)
    scene = mi.load_dict(row([mirror(bsdf) if mirrored else bsdf], INTEGRATORS[integrator]))
    keys = values_of(bsdf, vocabulary, scene)

    def change(scene, values):
        params = mi.traverse(scene)
        for key, value in zip(keys, values, strict=True):
            params[key] = value
        params.update()

    def step(scene, values, seed):
        change(scene, values)
        return mi.render(scene, seed=seed)

    inside, outside = dr.freeze(step), dr.freeze(lambda scene, seed: mi.render(scene, seed=seed))
    pictures = []
    # The energy rule is kept throughout.
    for seed, values in enumerate(((0.4, 0.3, 20), (0.2, 0.1, 5), (0.5, 0.4, 70), (0.1, 0.8, 1), (0.2, 0.1, 5))):
        values = [dr.opaque(mi.Float, value) for value in values]
        pictures.append(np.array(inside(scene, values, mi.UInt32(seed))))
        truth = np.array(step(scene, values, seed))
        assert np.array_equal(pictures[-1], truth)
        assert np.array_equal(np.array(outside(scene, mi.UInt32(seed))), truth)
    assert len({picture.tobytes() for picture in pictures}) == 5
    assert inside.n_recordings <= 3 and outside.n_recordings <= 3


@pytest.mark.parametrize(
    ("bsdf", "name", "values"),
    [
        (material("phong", "reflectances", 0.5, 0.3), "diffuse_reflectance", (0.4, 0.2, 0.3, 0.95)),
        (material("phong", "reflectances", 0.9, 0.3), "diffuse_reflectance", (0.8, 0.95, 0.85, 0.75)),
        ({"type": "phong", "kd": 0.5, "ks": 0.0}, "ks", (0.0, 0.0, 0.0, 0.5)),
        (mirror({"type": "phong"}, 0.0), "km", (0.0, 0.0, 0.0, 0.5)),
    ],
    ids=("energy rule begins to apply", "energy rule applies", "ks from 0", "km from 0"),
)
def test_frozen_functions_follow_what_the_kernel_depends_on(bsdf, name, values):
    """An update before a frozen function that needs other arithmetic is not ignored."""
    scene = mi.load_dict(row([bsdf], {"type": "direct"}))
    params = mi.traverse(scene)
    key = next(key for key in params.keys() if key.endswith(f"{name}.value"))  # noqa: SIM118
    frozen = dr.freeze(lambda scene, seed: mi.render(scene, seed=seed))
    for seed, value in enumerate(values):
        params[key] = value
        params.update()
        assert np.array_equal(np.array(frozen(scene, mi.UInt32(seed))), render(scene, seed=seed))


@pytest.fixture
def compiled():
    """Renders, and says whether that took a kernel that had never been compiled in this process."""

    def compiled(scene, **options):
        dr.kernel_history_clear()
        dr.eval(mi.render(scene, **options))
        kernels = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
        # Clearing film and counters are kernels of a few operations; that of the picture has hundreds.
        assert max(k["operation_count"] for k in kernels) > 100
        return [k["operation_count"] for k in kernels if not k["cache_hit"]]

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        yield compiled


@pytest.mark.parametrize("textured", (False, True))
@pytest.mark.parametrize("integrator", ("path", "direct", "whitted"))
@both_lobes
def test_kernels_are_reused(kind, vocabulary, integrator, textured, compiled):
    """New values of constants and textures are data: nothing is compiled."""
    bsdf = material(kind, vocabulary, pixels(np.full((2, 2, 3), 0.3)) if textured else 0.3)
    scene = mi.load_dict(row([mirror(bsdf)], INTEGRATORS.get(integrator, {"type": integrator})))
    params = mi.traverse(scene)
    diffuse, specular, exponent = (
        next(k for k in params.keys() if f".{name}." in k and "to_uv" not in k)  # noqa: SIM118
        for name in VOCABULARIES[vocabulary]
    )
    km = next(k for k in params.keys() if "km.value" in k)  # noqa: SIM118
    compiled(scene)
    for seed, (a, b, p, m) in enumerate(((0.4, 0.3, 30, 0.2), (0.2, 0.1, 5, 0.9), (0.1, 0.8, 1e4, 0.4))):
        params[diffuse] = np.full((2, 2, 3), a, np.float32) if textured else a
        params[specular], params[exponent], params[km] = b, p, m
        params.update()
        assert compiled(scene, seed=seed) == []


def test_the_energy_scale_is_data(compiled):
    """Another scale is not another kernel; only where the rule begins to apply, one is compiled, once."""
    scene = mi.load_dict(row([material("phong", "reflectances", 0.9, 0.8, 21)], INTEGRATORS["direct"]))
    params = mi.traverse(scene)
    compiled(scene)
    diffuse = next(key for key in params.keys() if "diffuse_reflectance" in key)  # noqa: SIM118

    def after(value):
        params[diffuse] = value
        params.update()
        return compiled(scene)

    assert [after(value) for value in (0.7, 0.95, 0.3)] == [[], [], []]
    after(0.1)
    assert [after(value) for value in (0.6, 0.15, 0.8)] == [[], [], []]
