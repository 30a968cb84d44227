"""What camera rays meet, bounce by bounce, as NumPy arrays: traced once by `stage.py`, shaded in many ways."""

from dataclasses import dataclass

import numpy as np


class Undiagnosable(ValueError):
    """A scene that cannot be shaded here; the words say why."""


@dataclass(frozen=True)
class Material:
    """One BSDF of the scene; colours and exponents that are textures are None."""

    name: str
    lobe: str
    """`phong`, `blinnphong`, or `diffuse`, which has no highlight."""
    specular: tuple[float, ...] | None
    exponent: float | None


@dataclass(frozen=True)
class Light:
    """One light as the hits of a bounce see it; arrays over the hits."""

    toward: np.ndarray
    """Unit vectors, (n, 3)."""
    length: np.ndarray
    """Of the vector that points to the light before it is normalised."""
    falloff: np.ndarray
    """1 / distance^2; 1 for directional lights."""
    intensity: np.ndarray
    visible: np.ndarray
    """Whether nothing is between surface and light."""
    visible_past: np.ndarray
    """Whether nothing is on the ray, even behind the light."""
    visible_through: np.ndarray
    """Whether nothing but the surface itself is between."""


@dataclass(frozen=True)
class Bounce:
    """The hits at one depth; arrays over them."""

    ray: np.ndarray
    """Which camera ray led here."""
    material: np.ndarray
    """Number of the `Material`."""
    normal: np.ndarray
    """Unit shading normals, (n, 3)."""
    normal_length: np.ndarray
    """Of the vector from the centre of the sphere that was hit; 1 on other shapes."""
    front: np.ndarray
    """Whether the surface is seen from a side that it has: one of its normals, geometric or shading, faces the ray."""
    view: np.ndarray
    """Unit vectors back along the ray, (n, 3)."""
    distance: np.ndarray
    """To where the ray came from."""
    diffuse: np.ndarray
    specular: np.ndarray
    """Height of the highlight, (n, 3)."""
    cosine: np.ndarray
    """Whether the highlight carries the factor n.l: with reflectances, not with coefficients."""
    exponent: np.ndarray
    km: np.ndarray
    lights: tuple[Light, ...]


@dataclass(frozen=True)
class Hits:
    """All bounces of some camera rays."""

    count: int
    """Number of camera rays."""
    bounces: tuple[Bounce, ...]
    background: tuple[np.ndarray, ...]
    """What the rays of each depth see that meet nothing, (count, 3), 0 elsewhere."""
    ray_length: np.ndarray
    """Of the camera rays' vectors that end in a plane at distance 1, (count,)."""
    ambient: np.ndarray
