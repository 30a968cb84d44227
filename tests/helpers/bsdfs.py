"""BSDFs of the package in both vocabularies, their formula in float64, and scenes to look at them."""

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from helpers.small_scenes import film, look

KINDS = ("phong", "blinnphong")
VOCABULARIES = {
    "coefficients": ("kd", "ks", "p"),
    "reflectances": ("diffuse_reflectance", "specular_reflectance", "exponent"),
}
LOBES = [(kind, vocabulary) for kind in KINDS for vocabulary in VOCABULARIES]
RADIANCE = mi.TransportMode.Radiance
LOBE_FLAGS = {"diffuse": mi.BSDFFlags.DiffuseReflection, "glossy": mi.BSDFFlags.GlossyReflection}

both_lobes = pytest.mark.parametrize(("kind", "vocabulary"), LOBES)
# One of each plugin.
BSDFS = {
    "phong": {"type": "phong", "kd": {"type": "rgb", "value": [0.9, 0.3, 0.1]}, "ks": 0.4, "p": 30},
    "blinnphong": {"type": "blinnphong", "kd": {"type": "rgb", "value": [0.9, 0.3, 0.1]}, "ks": 0.4, "p": 30},
    "mirrorblend": {"type": "mirrorblend", "km": 0.5, "nested": {"type": "blinnphong", "ks": 0.7, "p": 100}},
}
# Those that are lobes themselves.
WITH_LOBES = [kind for kind, description in BSDFS.items() if "p" in description]


def material(kind, vocabulary, diffuse=0.4, specular=0.3, p=20.0, **more):
    """A lobe BSDF, of `kind` `phong` or `blinnphong`, in either vocabulary."""
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


def row(bsdfs, integrator, wrap=lambda shape: [shape], **objects):
    """A row of spheres, one for each BSDF, before a bright sky and a point light."""
    shapes = {}
    for i, bsdf in enumerate(bsdfs):
        ball = {"type": "sphere", "center": [2.2 * i - 1.1 * (len(bsdfs) - 1), 0, 0], "bsdf": bsdf}
        shapes |= {f"shape {i} {j}": shape for j, shape in enumerate(wrap(ball))}
    return {
        "type": "scene", "integrator": integrator, "sensor": look([0, 2, 14], [0, 0, 0], spp=4, film=film(32, 8)),
        "sky": {"type": "constant", "radiance": 0.6},
        "light": {"type": "point", "position": [0, 5, 9], "intensity": 80},
        **shapes, **objects,
    }  # fmt: skip


def pane(bsdf, integrator, degrees=30.0, spp=4, width=4, **objects):
    """A large pane in the plane z = 0, of which the camera sees a point, `degrees` from the normal."""
    eye = [4 * math.sin(math.radians(degrees)), 0, 4 * math.cos(math.radians(degrees))]
    return {
        "type": "scene", "integrator": integrator, "sensor": look(eye, [0, 0, 0], width, fov=1e-3, spp=spp),
        "pane": {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(100), "bsdf": bsdf}, **objects,
    }  # fmt: skip


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
