"""Components, contexts, attributes, and names of Mitsuba 0.6: what others ask of a BSDF."""

import itertools
import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from helpers.bsdfs import (
    ADAPTERS,
    KINDS,
    LOBE_FLAGS,
    LOBES,
    OURS,
    RADIANCE,
    VOCABULARIES,
    both_lobes,
    draw,
    first,
    formula,
    hemisphere,
    incidence,
    interaction,
    material,
    mirror,
    number,
    pane,
    pixels,
    row,
)
from helpers.small_scenes import render

# Components and contexts ------------------------------------------------------------------------------------


def contexts(bsdf):
    """A context for each component, by its index and by its type."""
    for i in range(bsdf.component_count()):
        kind = int(bsdf.flags(i)) & int(mi.BSDFFlags.All)
        yield i, kind, mi.BSDFContext(RADIANCE, 0x1FF, i)
        yield i, kind, mi.BSDFContext(RADIANCE, kind, 0xFFFFFFFF)


@pytest.mark.parametrize("name", OURS)
def test_contexts(name):
    """A context with one component, by index or type: its part of the value, a density of its own, samples of it."""
    bsdf = mi.load_dict(OURS[name])
    n = 4096
    si, wo = interaction(incidence(40) + dr.zeros(mi.Vector3f, n)), hemisphere(n, 3)
    total = dr.zeros(mi.Color3f, n)
    for i, kind, ctx in contexts(bsdf):
        value, pdf = bsdf.eval_pdf(ctx, si, wo)
        assert dr.all(value == bsdf.eval(ctx, si, wo), axis=None) and dr.all(pdf == bsdf.pdf(ctx, si, wo))
        total += 0.5 * value
        _, bs, weight = draw(bsdf, incidence(40), n, ctx)
        alive = bs.pdf > 0
        assert dr.mean(dr.select(alive, 1.0, 0.0))[0] > 0.9
        assert dr.all(dr.select(alive, bs.sampled_component == i, True))
        assert dr.all(dr.select(alive, bs.sampled_type == kind, True))
        if kind & int(mi.BSDFFlags.DeltaReflection):
            assert dr.all(value == 0, axis=None) and dr.all(pdf == 0) and dr.all(bs.pdf == 1)
            assert dr.allclose(weight, 0.3)
            continue
        again, density = bsdf.eval_pdf(ctx, si, bs.wo)
        # Within a mirrorblend, what is left is 1 - km of the nested BSDF; its sampling is not.
        assert dr.allclose(dr.select(alive, weight * bs.pdf, 0), dr.select(alive, again, 0), rtol=1e-5)
        assert dr.allclose(dr.select(alive, bs.pdf, 0), dr.select(alive, density, 0), rtol=1e-5)
        # A density: 1 in all; the uniform samples of a lobe of p = 20 leave 5 %.
        assert dr.mean(pdf * dr.two_pi)[0] == pytest.approx(1, abs=0.1)
    assert dr.allclose(total, bsdf.eval(mi.BSDFContext(), si, wo), rtol=1e-5)
    for nothing in (mi.BSDFContext(RADIANCE, int(mi.BSDFFlags.Transmission)), mi.BSDFContext(RADIANCE, 0x1FF, 7)):
        value, pdf = bsdf.eval_pdf(nothing, si, wo)
        _, weight = draw(bsdf, incidence(40), n, nothing)[1:]
        assert dr.all(value == 0, axis=None) and dr.all(pdf == 0) and dr.all(weight == 0, axis=None)


def kinds(bsdf):
    """Names of a BSDF's components; their flags must add up to the BSDF's."""
    whole, names = 0, []
    for i in range(bsdf.component_count()):
        flags = bsdf.flags(i)
        whole |= int(flags)
        assert mi.has_flag(flags, mi.BSDFFlags.FrontSide) and not mi.has_flag(flags, mi.BSDFFlags.BackSide)
        names += [name for name, flag in LOBE_FLAGS.items() if mi.has_flag(flags, flag)]
        names += ["delta"] if mi.has_flag(flags, mi.BSDFFlags.DeltaReflection) else []
    assert int(bsdf.flags()) == whole
    return names


@both_lobes
def test_components_follow_updates(kind, vocabulary):
    """A scale that is 0 leaves no component, at load, after an update to 0 and one away from 0."""
    diffuse, specular, _ = VOCABULARIES[vocabulary]
    # Loaded with each, changed to each.
    cases = {(0.4, 0.3): ["diffuse", "glossy"], (0, 0.3): ["glossy"], (0.4, 0): ["diffuse"], (0, 0): []}
    for start, end in itertools.product(cases, cases):
        bsdf = mi.load_dict(mirror(material(kind, vocabulary, *start)))
        assert kinds(bsdf) == ["delta", *cases[start]]
        params = mi.traverse(bsdf)
        params[f"nested_bsdf.{diffuse}.value"], params[f"nested_bsdf.{specular}.value"] = end
        params.update()
        assert kinds(bsdf) == ["delta", *cases[end]]
        wi, wo = incidence(30), incidence(20, 3.5)
        expected = 0.7 * formula(kind, vocabulary, wi, wo, *end)[0]
        assert dr.allclose(bsdf.eval(mi.BSDFContext(), interaction(wi), wo), expected, rtol=1e-5)
        params["km.value"] = 0
        params.update()
        assert kinds(bsdf) == cases[end]
        params["km.value"] = 1
        params.update()
        assert kinds(bsdf) == ["delta", *cases[end]]


@both_lobes
def test_components_of_textures(kind, vocabulary):
    """A texture may turn from black to bright: its component is there, marked as varying; black constants are not."""
    grey = pixels([[[0.3]]])
    assert kinds(mi.load_dict(material(kind, vocabulary, grey, 0))) == ["diffuse"]
    assert kinds(mi.load_dict(material(kind, vocabulary, {"type": "rgb", "value": [0, 0, 0]}, grey))) == ["glossy"]
    bsdf = mi.load_dict(mirror(material(kind, vocabulary, pixels([[[0.0]]]), pixels([[[0.0]]])), pixels([[[0.0]]])))
    assert kinds(bsdf) == ["delta", "diffuse", "glossy"]
    varying = mi.BSDFFlags.SpatiallyVarying
    assert all(mi.has_flag(bsdf.flags(i), varying) for i in range(3))
    assert not mi.has_flag(mi.load_dict(mirror(material(kind, vocabulary))).flags(), varying)
    params = mi.traverse(bsdf)
    params[f"nested_bsdf.{VOCABULARIES[vocabulary][0]}.data"] = np.full((1, 1, 1), 0.5, np.float32)
    params.update()
    value = bsdf.eval(mi.BSDFContext(), interaction(incidence(30)), mi.Vector3f(0, 0, 1))
    assert dr.allclose(value, 0.5 / math.pi) and kinds(bsdf) == ["delta", "diffuse", "glossy"]


UPDATES = {
    "km": (mirror({"type": "phong"}, 1e-6), "km", 0.5),
    "kd": ({"type": "phong", "kd": 1e-6, "ks": 1e-6}, "kd", 0.5),
    "ks": ({"type": "phong", "kd": 1e-6, "ks": 1e-6}, "ks", 3.0),
}


@pytest.mark.parametrize(("integrator", "case"), [("direct", "kd"), ("direct", "ks"), ("whitted", "km")])
@pytest.mark.parametrize("adapter", ("twosided", "mask", "bumpmap", "normalmap", "blendbsdf"))
def test_updates_reach_through_adapters(adapter, integrator, case):
    """An update shows in the picture, inside of Mitsuba's adapters too, if it does not start at 0: they ask once."""
    bsdf, name, value = UPDATES[case]
    wrap = ADAPTERS[adapter]
    updated = mi.load_dict(row([wrap(bsdf)], {"type": integrator}))
    params = mi.traverse(updated)
    key = next(key for key in params.keys() if key.endswith(f"{name}.value"))  # noqa: SIM118
    params[key] = value
    params.update()
    expected = render(row([wrap({**bsdf, name: value})], {"type": integrator}), spp=64)
    assert render(updated, spp=64) == pytest.approx(expected, abs=0.02)


# Attributes -------------------------------------------------------------------------------------------------


def test_attributes(any_variant):
    """Every parameter is an attribute by its name, of one channel and of three; what is no parameter is none."""
    si = interaction(incidence(10))
    for kind, vocabulary in LOBES:
        bsdf = mi.load_dict(material(kind, vocabulary))
        for name, value in zip(VOCABULARIES[vocabulary], (0.4, 0.3, 20), strict=True):
            assert dr.all(bsdf.has_attribute(name))
            assert number(bsdf.eval_attribute_1(name, si)) == pytest.approx(value)
            assert first(bsdf.eval_attribute(name, si)) == pytest.approx(value)
            assert dr.allclose(bsdf.eval_attribute_3(name, si), value)
            assert f"{name} = " in str(bsdf)
        other = set(itertools.chain(*VOCABULARIES.values())) - set(VOCABULARIES[vocabulary])
        assert not any(dr.all(bsdf.has_attribute(name)) or f" {name} =" in str(bsdf) for name in other)
        assert type(bsdf).__name__ in str(bsdf)


def test_attributes_of_textures_and_mirrors():
    """Textures are attributes too, three channels as three, and so is `km`."""
    si = interaction(incidence(10))
    bsdf = mi.load_dict({"type": "phong", "kd": pixels([[[0.1, 0.2, 0.3]]]), "p": pixels([[[7.0]]])})
    assert dr.allclose(bsdf.eval_attribute_3("kd", si), mi.Color3f(0.1, 0.2, 0.3))
    assert dr.allclose(bsdf.eval_attribute_1("p", si), 7)
    bsdf = mi.load_dict(mirror(bsdf, pixels([[[0.2, 0.5, 0.8]]])))
    assert dr.all(bsdf.has_attribute("km")) and not dr.any(bsdf.has_attribute("kd"))
    assert dr.allclose(bsdf.eval_attribute_3("km", si), mi.Color3f(0.2, 0.5, 0.8))
    assert "MirrorBlend" in str(bsdf) and "Phong" in str(bsdf) and "km = " in str(bsdf)


ALBEDOS = {
    "coefficients": ({"type": "phong", "kd": 0.4, "ks": 0.9}, 0.4),
    "reflectances": (material("blinnphong", "reflectances", 0.4, 0.6 - 1e-6), 0.4),
    "scaled": (material("phong", "reflectances", 0.9, 0.9), 0.9 * 0.55),
    "mirror": (mirror({"type": "phong", "kd": 0.4}, 0.25), 0.3),
    "native in mirror": (mirror({"type": "diffuse", "reflectance": 0.4}, 0.25), 0.3),
    "twosided": ({"type": "twosided", "b": {"type": "phong", "kd": 0.4}}, 0.4),
    "mask": ({"type": "mask", "opacity": 0.5, "b": {"type": "phong", "kd": 0.4}}, 0.4),
    "black": ({"type": "phong", "kd": 0.0, "ks": 0.4}, 0.0),
}


@pytest.mark.parametrize("case", ALBEDOS)
def test_albedo_aov(case):
    """`albedo:albedo` is the diffuse part alone, as the picture shows it: scaled, under its mirror."""
    bsdf, albedo = ALBEDOS[case]
    integrator = {"type": "aov", "aovs": "albedo:albedo"}
    for variant in ("llvm_ad_rgb", "scalar_rgb"):
        mi.set_variant(variant)
        mi.set_log_level(mi.LogLevel.Error)
        assert render(pane(bsdf, integrator))[..., -3:] == pytest.approx(albedo, rel=1e-6)


@both_lobes
def test_parameters_by_name(kind, vocabulary):
    """`traverse` lists each parameter under its own name, and each update is what `eval` then uses."""
    names = VOCABULARIES[vocabulary]
    bsdf = mi.load_dict(material(kind, vocabulary))
    params = mi.traverse(bsdf)
    assert set(params.keys()) == {f"{name}.value" for name in names}
    wi, wo = incidence(50), incidence(30, 3.6)
    now = [0.4, 0.3, 20.0]
    for i, (name, value) in enumerate(zip(names, (0.25, 0.55, 3.0), strict=True)):
        params[f"{name}.value"] = now[i] = value
        params.update()
        value = bsdf.eval(mi.BSDFContext(), interaction(wi), wo)
        assert dr.allclose(value, formula(kind, vocabulary, wi, wo, *now)[0], rtol=1e-5)
    textured = mi.traverse(mi.load_dict(material(kind, vocabulary, pixels([[[0.3]]]), pixels([[[0.3]]]))))
    assert {f"{names[0]}.data", f"{names[1]}.data", f"{names[2]}.value"} <= set(textured.keys())


# Files of Mitsuba 0.6 ---------------------------------------------------------------------------------------

LEGACY = """
<scene version="0.6.0">
    <integrator type="direct"/>
    <sensor type="perspective">
        <float name="fov" value="40"/>
        <transform name="toWorld"><lookat origin="0, 0, 3" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm">
            <integer name="width" value="8"/><integer name="height" value="8"/>
            <string name="pixelFormat" value="rgb"/><rfilter type="box"/>
        </film>
        <sampler type="independent"><integer name="sampleCount" value="4"/></sampler>
    </sensor>
    <shape type="sphere">
        <bsdf type="{kind}">
            <rgb name="diffuseReflectance" value="0.9, 0.3, 0.2"/>
            <float name="specularReflectance" value="0.7"/>
            <float name="exponent" value="25"/>
            <boolean name="ensureEnergyConservation" value="{conserve}"/>
        </bsdf>
    </shape>
    <emitter type="point">
        <point name="position" x="0" y="2" z="3"/><rgb name="intensity" value="9"/>
    </emitter>
</scene>
"""


def test_legacy_files(any_variant):
    """A file of version 0.6 with camelCase names gives the same picture as one with today's."""
    for kind in KINDS:
        brightest = []
        for conserve in ("true", "false"):
            legacy = LEGACY.format(kind=kind, conserve=conserve)
            today = legacy.replace("0.6.0", "3.0.0")
            for name in ("toWorld", "pixelFormat", "sampleCount", "diffuseReflectance", "specularReflectance",
                         "ensureEnergyConservation"):  # fmt: skip
                today = today.replace(name, "".join(f"_{c.lower()}" if c.isupper() else c for c in name))
            picture = render(mi.load_string(legacy))
            assert picture.max() > 0.3
            assert np.array_equal(picture, render(mi.load_string(today)))
            brightest.append(picture.max())
        # And the flag counts: the red channel reaches 1.6, the luminance 1.1.
        assert brightest[1] > 1.05 * brightest[0]
