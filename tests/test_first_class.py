"""Whatever a native BSDF can do in a scene, those of the package can: nest, update, freeze, sample, conserve light."""

import itertools
import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from test_bsdf_contract import hemisphere, interaction
from test_bsdf_contract import incidence as direction

from phong_bsdf.albedo import directional_albedo

KINDS = ("phong", "blinnphong")
VOCABULARIES = {
    "coefficients": ("kd", "ks", "p"),
    "reflectances": ("diffuse_reflectance", "specular_reflectance", "exponent"),
}
LOBES = [(kind, vocabulary) for kind in KINDS for vocabulary in VOCABULARIES]
RADIANCE = mi.TransportMode.Radiance
LOBE_FLAGS = {"diffuse": mi.BSDFFlags.DiffuseReflection, "glossy": mi.BSDFFlags.GlossyReflection}

both_lobes = pytest.mark.parametrize(("kind", "vocabulary"), LOBES)


def material(kind, vocabulary, diffuse=0.4, specular=0.3, p=20.0, **more):
    """A BSDF of either vocabulary; one that is no lobe is wrapped in the mirror that `kind` stands for."""
    return {"type": kind, **dict(zip(VOCABULARIES[vocabulary], (diffuse, specular, p), strict=True)), **more}


def mirror(nested, km=0.3):
    return {"type": "mirrorblend", "km": km, "nested": nested}


# The five of the package: two lobes in two vocabularies each, and the mirror.
OURS = {f"{kind} {vocabulary}": material(kind, vocabulary) for kind, vocabulary in LOBES}
OURS["mirrorblend"] = mirror(material("blinnphong", "coefficients"))


def formula(kind, vocabulary, wi, wo, diffuse=0.4, specular=0.3, p=20.0):
    """f cos(theta_o) of the contract in float64, from its text alone; columns are directions."""
    wi, wo = (np.asarray(w, np.float64).reshape(3, -1) for w in (wi, wo))
    axis, other = (wi * [[-1], [-1], [1]], wo) if kind == "phong" else (np.array([[0.0], [0], [1]]), wi + wo)
    cos = np.sum(axis * other, axis=0) / np.linalg.norm(axis, axis=0) / np.linalg.norm(other, axis=0)
    lobe = np.maximum(cos, 0) ** p
    if vocabulary == "coefficients":
        f = (diffuse * wo[2] + specular * lobe) / np.pi
    else:
        c = (p + 2) / (2 * np.pi) if kind == "phong" else (p + 2) * (p + 4) / (8 * np.pi * (2 ** (-p / 2) + p))
        f = (diffuse / np.pi + specular * c * lobe) * wo[2]
    return np.where((wi[2] > 0) & (wo[2] > 0), f, 0)


def draw(bsdf, wi, n, ctx=None, seed=0):
    """`n` samples for one direction of incidence: (interaction, samples, weights)."""
    rng = mi.PCG32(n, seed)
    # Opaque, so that each direction does not take a kernel of its own.
    dr.make_opaque(wi)
    si = interaction(wi + dr.zeros(mi.Vector3f, n))
    return si, *bsdf.sample(
        ctx or mi.BSDFContext(), si, rng.next_float32(), mi.Point2f(rng.next_float32(), rng.next_float32())
    )


def number(value):
    """A Python number from the only lane of a variant's own."""
    return float(value[0] if dr.is_jit_v(value) else value)


def first(value):
    """First channel of a colour, spectrum or Mueller matrix."""
    return number(mi.unpolarized_spectrum(value)[0])


def pixels(values):
    return {"type": "bitmap", "raw": True, "filter_type": "nearest", "bitmap": mi.Bitmap(np.array(values, np.float32))}


def sensor(origin, target, width=16, height=None, fov=40.0, spp=4):
    # `look_at` needs an up direction that is not the view's.
    up = [0, 1, 0] if origin[0] != target[0] or origin[2] != target[2] else [0, 0, 1]
    return {
        "type": "perspective", "fov": fov, "to_world": mi.ScalarTransform4f().look_at(origin, target, up),
        "near_clip": 1e-3, "sampler": {"type": "independent", "sample_count": spp},
        "film": {"type": "hdrfilm", "width": width, "height": height or width, "pixel_format": "rgb",
                 "component_format": "float32", "rfilter": {"type": "box"}},
    }  # fmt: skip


def row(bsdfs, integrator, wrap=lambda shape: [shape], **objects):
    """A row of spheres, one for each BSDF, before a bright sky and a point light."""
    shapes = {}
    for i, bsdf in enumerate(bsdfs):
        ball = {"type": "sphere", "center": [2.2 * i - 1.1 * (len(bsdfs) - 1), 0, 0], "bsdf": bsdf}
        shapes |= {f"shape {i} {j}": shape for j, shape in enumerate(wrap(ball))}
    return {
        "type": "scene", "integrator": integrator, "sensor": sensor([0, 2, 14], [0, 0, 0], 32, 8),
        "sky": {"type": "constant", "radiance": 0.6},
        "light": {"type": "point", "position": [0, 5, 9], "intensity": 80},
        **shapes, **objects,
    }  # fmt: skip


def pane(bsdf, integrator, degrees=30.0, spp=4, width=4, **objects):
    """A large pane in the plane z = 0, of which the camera sees a point, `degrees` from the normal."""
    eye = [4 * math.sin(math.radians(degrees)), 0, 4 * math.cos(math.radians(degrees))]
    return {
        "type": "scene", "integrator": integrator, "sensor": sensor(eye, [0, 0, 0], width, fov=1e-3, spp=spp),
        "pane": {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(100), "bsdf": bsdf}, **objects,
    }  # fmt: skip


def render(scene, **options):
    scene = mi.load_dict(scene) if isinstance(scene, dict) else scene
    return np.array(mi.render(scene, **options))


# Every variant ---------------------------------------------------------------------------------------------


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


# Nesting ---------------------------------------------------------------------------------------------------

ALL_LOBES = [OURS[f"{kind} {vocabulary}"] for kind, vocabulary in LOBES]


def dull(kind, vocabulary, reflectance=0.4):
    return material(kind, vocabulary, reflectance, 0)


def bumps():
    y, x = np.mgrid[:16, :16] / 2.5
    return pixels((0.05 * np.sin(x) * np.cos(y))[..., None])


def normals(tilt):
    n = np.random.default_rng(0).normal(0, tilt, (8, 8, 2))
    n = np.concatenate([n, np.ones((8, 8, 1))], axis=2)
    return pixels(0.5 + 0.5 * n / np.linalg.norm(n, axis=2, keepdims=True))


# Mitsuba's adapters, as functions of what they hold.
ADAPTERS = {
    "twosided": lambda b: {"type": "twosided", "b": b},
    "two sides": lambda b: {"type": "twosided", "a": {"type": "diffuse", "reflectance": 0.8}, "b": b},
    "mask": lambda b: {"type": "mask", "opacity": 0.6, "b": b},
    "bumpmap": lambda b: {"type": "bumpmap", "t": {**bumps(), "filter_type": "bilinear"}, "scale": 1.0, "b": b},
    "normalmap": lambda b: {"type": "normalmap", "normalmap": normals(0.2), "b": b},
    "blendbsdf": lambda b: {"type": "blendbsdf", "weight": 0.3, "a": b, "b": {"type": "diffuse", "reflectance": 0.9}},
    "blend in twosided": lambda b: {"type": "twosided", "n": {"type": "blendbsdf", "weight": 0.3, "a": b,
                                                              "b": {"type": "diffuse", "reflectance": 0.9}}},
}  # fmt: skip


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
    si, wo = interaction(direction(40) + dr.zeros(mi.Vector3f, n)), hemisphere(n, 3)
    total = dr.zeros(mi.Color3f, n)
    for i, kind, ctx in contexts(bsdf):
        value, pdf = bsdf.eval_pdf(ctx, si, wo)
        assert dr.all(value == bsdf.eval(ctx, si, wo), axis=None) and dr.all(pdf == bsdf.pdf(ctx, si, wo))
        total += 0.5 * value
        _, bs, weight = draw(bsdf, direction(40), n, ctx)
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
        _, weight = draw(bsdf, direction(40), n, nothing)[1:]
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
        wi, wo = direction(30), direction(20, 3.5)
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
    value = bsdf.eval(mi.BSDFContext(), interaction(direction(30)), mi.Vector3f(0, 0, 1))
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


# Attributes --------------------------------------------------------------------------------------------------


def test_attributes(any_variant):
    """Every parameter is an attribute by its name, of one channel and of three; what is no parameter is none."""
    si = interaction(direction(10))
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
    si = interaction(direction(10))
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
    wi, wo = direction(50), direction(30, 3.6)
    now = [0.4, 0.3, 20.0]
    for i, (name, value) in enumerate(zip(names, (0.25, 0.55, 3.0), strict=True)):
        params[f"{name}.value"] = now[i] = value
        params.update()
        value = bsdf.eval(mi.BSDFContext(), interaction(wi), wo)
        assert dr.allclose(value, formula(kind, vocabulary, wi, wo, *now)[0], rtol=1e-5)
    textured = mi.traverse(mi.load_dict(material(kind, vocabulary, pixels([[[0.3]]]), pixels([[[0.3]]]))))
    assert {f"{names[0]}.data", f"{names[1]}.data", f"{names[2]}.value"} <= set(textured.keys())


# Frozen functions and kernels --------------------------------------------------------------------------------

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


# Sampling ------------------------------------------------------------------------------------------------------

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
    for incidence in INCIDENCES:
        wi = direction(incidence[0], math.radians(incidence[1]))
        test = chi_square(kind, vocabulary, p, wi, 61)
        # 96 tests: none may be significant at 1e-4 by chance more often than once in 100 seeds.
        assert test.run(1e-4, test_count=96), (incidence, test.messages)


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
    for incidence in INCIDENCES[:6] if p == 1000 else INCIDENCES:
        wi = direction(incidence[0], math.radians(incidence[1]))
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
            _, bs, weight = draw(bsdf, direction(degrees), 2**15)
            below = dr.mean(dr.select(bs.wo.z < 0, 1.0, 0.0))[0]
            if kind == "phong":
                assert below == 0
            elif p >= 30:
                assert below < 0.01
            assert dr.all(dr.select(bs.wo.z < 0, weight.x == 0, True))


# Energy ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("p", (0, 1, 30, 1000))
@both_lobes
def test_samples_carry_the_albedo(kind, vocabulary, p):
    """weight x pdf = eval, and the mean weight is the diffuse scale plus the directional albedo of the lobe."""
    bsdf = mi.load_dict(material(kind, vocabulary, 0.3, 0.6, p))
    for degrees in (0, 30, 60, 80, 88):
        si, bs, weight = draw(bsdf, direction(degrees), 2**17, seed=int(degrees))
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


class Messages(mi.Appender):
    """Collects what Mitsuba logs."""

    def __init__(self):
        super().__init__()
        self.lines = []

    def append(self, level, text):
        self.lines.append((level, text))

    def log_progress(self, *_):
        pass


@pytest.fixture
def messages():
    """Mitsuba's warnings, instead of on the terminal."""
    logger, collected = mi.logger(), Messages()
    before = [logger.appender(i) for i in range(logger.appender_count())]
    logger.clear_appenders()
    logger.add_appender(collected)
    mi.set_log_level(mi.LogLevel.Warn)
    yield collected.lines
    logger.clear_appenders()
    for appender in before:
        logger.add_appender(appender)
    mi.set_log_level(mi.LogLevel.Error)


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
    warnings = [text for level, text in messages if level == mi.LogLevel.Warn]
    assert len(warnings) == (scale != 1)
    assert scale == 1 or (f"multiplied by {scale:.3g}" in warnings[0] and f"{kind}: " in warnings[0])
    off = mi.load_dict(material(kind, "reflectances", diffuse, specular, ensure_energy_conservation=False))
    assert len(messages) == len(warnings)
    si, wo = interaction(direction(40)), direction(30, 3.6)
    for ctx in (mi.BSDFContext(), *(mi.BSDFContext(RADIANCE, 0x1FF, i) for i in (0, 1))):
        assert dr.allclose(bsdf.eval(ctx, si, wo), off.eval(ctx, si, wo) * scale, rtol=1e-5)
    # What the share of the highlight is does not change.
    assert dr.allclose(bsdf.pdf(mi.BSDFContext(), si, wo), off.pdf(mi.BSDFContext(), si, wo))


@pytest.mark.parametrize(("diffuse", "specular"), [(0.4, 0.6), (0.2, 0.8), (0.6, 0.4)])
def test_reflectances_that_sum_to_1_are_kept(diffuse, specular, messages):
    """1 does not exceed 1, whatever the numbers' last bits are."""
    bsdf = mi.load_dict(material("phong", "reflectances", diffuse, specular, 30))
    wi = direction(0)
    expected = formula("phong", "reflectances", wi, wi, diffuse, specular, 30)[0]
    assert dr.allclose(bsdf.eval(mi.BSDFContext(), interaction(wi), wi), expected, rtol=1e-5)
    assert messages == []


@both_lobes
def test_energy_rule_after_updates(kind, vocabulary):
    """The scale follows updates both ways, of numbers and textures; the lecture's coefficients have none."""
    diffuse, specular, _ = VOCABULARIES[vocabulary]
    wi, wo = direction(40), direction(30, 3.6)
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


# Files of Mitsuba 0.6 ---------------------------------------------------------------------------------------------

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
