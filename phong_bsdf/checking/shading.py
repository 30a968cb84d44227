"""The course's shading of recorded hits, in NumPy, with a switch for each usual mistake.

`shade(hits, RIGHT)` is the picture of `whitted`; a test holds the two together.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from .hits import Bounce, Hits, Light

# What the fields of a `Recipe` that name something may be.
CHOICES = {
    "view": ("unit", "distance", "ray"),
    "light": ("unit", "raw"),
    "half": ("unit", "raw", "halved"),
    "normal": ("unit", "raw"),
    "lobe": (None, "phong", "blinnphong"),
    "shadows": ("right", "none", "past"),
    "behind": ("dark", "highlight", "negative", "absolute"),
    "mirror": ("blend", "added", "full", "highlight"),
    "end": ("bare", "dark"),
}


@dataclass(frozen=True)
class Recipe:
    """How a picture is made. Every default is right. ValueError for a choice that there is not."""

    falloff: bool = False
    """Lights fall off with 1/r^2."""
    view: str = "unit"
    """Length of v: `unit`, the `distance` to the surface, or that of a `ray` to an image plane at `plane`."""
    plane: float = 1.0
    light: str = "unit"
    """Length of l: `unit`, or `raw`, that of the vector to the light."""
    half: str = "unit"
    """Length of h: `unit`, `raw` (v + l), or `halved` ((v + l) / 2)."""
    normal: str = "unit"
    """Length of n: `unit`, or `raw`, the sphere's radius."""
    raw_mirrors: bool = False
    """Mirror directions are formed with raw normals, too; belongs to the tracing."""
    shift: tuple[float, float] = (0.0, 0.0)
    """Of the camera's rays in pixels, to the right and down; belongs to the tracing."""
    lobe: str | None = None
    """`phong` or `blinnphong` on every surface."""
    highlight: bool = True
    cosine: bool = False
    """The highlight is multiplied by n.l."""
    shadows: str = "right"
    """`right`, `none`, or `past`: what is behind the light blocks it, too."""
    behind: str = "dark"
    """Light from behind the surface: `dark`, counted in the `highlight`, as `negative` or as `absolute` light."""
    mirror: str = "blend"
    """`blend`; `added`: L + k_m L_r; `full`: L + L_r; `highlight`: of L only the diffuse part has (1 - k_m)."""
    bounces: int | None = None
    """Mirror bounces, if fewer than the scene asks for."""
    end: str = "bare"
    """After the last bounce a mirror is `bare`, as if k_m = 0, or `dark`: nothing is mirrored."""
    swapped: tuple[tuple[str, ...], tuple[int, ...], tuple[int, ...]] | None = None
    """`specular`, `exponent` or both, and two groups of materials that have each other's."""
    missing_light: int | None = None

    def __post_init__(self):
        for name, choices in CHOICES.items():
            if getattr(self, name) not in choices:
                raise ValueError(f"Recipe: '{name}' must be one of {choices}, got {getattr(self, name)!r}")


RIGHT = Recipe()


def shade(hits: Hits, recipe: Recipe, most_hits: int, materials, shadows: bool = True) -> np.ndarray:
    """The linear colours of all camera rays, (count, 3)."""
    image = np.zeros((hits.count, 3))
    for ray, _, colour in terms(hits, recipe, most_hits, materials, shadows):
        image[ray] += colour
    return image


def terms(hits: Hits, recipe: Recipe, most_hits: int, materials, shadows: bool = True) -> Iterator[tuple]:
    """What adds up to the picture: (camera rays, number of the light or -1, colours); one for each bounce and light.

    `most_hits` surfaces of a path are shaded; `materials` are those of the stage; `shadows`: whether the scene asks
    for them.
    """
    last = (most_hits if recipe.bounces is None else recipe.bounces + 1) - 1
    weight = np.ones((hits.count, 3))
    for depth, (bounce, background) in enumerate(zip(hits.bounces, hits.background, strict=True)):
        yield slice(None), -1, weight * background
        here = weight[bounce.ray]
        base, glossy, onward = _blend(recipe, bounce, depth == last)
        front = bounce.front[:, None]
        yield bounce.ray, -1, here * base * hits.ambient * bounce.diffuse
        view = bounce.view * _view_length(recipe, bounce, hits)[:, None]
        for number, light in enumerate(bounce.lights):
            if number != recipe.missing_light:
                diffuse, specular = _reflected(recipe, bounce, light, view, materials, shadows)
                yield bounce.ray, number, np.where(front, here * (base * diffuse + glossy * specular), 0)
        if depth == last:
            return
        weight = np.zeros_like(weight)
        weight[bounce.ray] = np.where(front, here * onward, 0)


def _blend(recipe: Recipe, bounce: Bounce, last: bool):
    """Weights of the diffuse part, of the highlight, and of what the mirror shows."""
    km = bounce.km
    rest = 1 - km
    if last and recipe.end == "bare":
        return np.ones_like(km), np.ones_like(km), 0 * km
    if recipe.mirror == "added":
        rest = np.ones_like(km)
    elif recipe.mirror == "full":
        rest, km = np.ones_like(km), np.where(km > 0, 1.0, 0.0)
    return rest, np.ones_like(km) if recipe.mirror == "highlight" else rest, km


def _view_length(recipe: Recipe, bounce: Bounce, hits: Hits) -> np.ndarray:
    if recipe.view == "distance":
        return bounce.distance
    if recipe.view == "ray":
        return recipe.plane * hits.ray_length[bounce.ray]
    return np.ones(len(bounce.ray))


def _reflected(recipe: Recipe, bounce: Bounce, light: Light, v, materials, shadows: bool):
    """Diffuse part and highlight of one light."""
    n = bounce.normal * bounce.normal_length[:, None] if recipe.normal == "raw" else bounce.normal
    l = light.toward * light.length[:, None] if recipe.light == "raw" else light.toward  # noqa: E741
    cos = _dot(n, l)
    above = cos > 0
    visible = light.visible_past if recipe.shadows == "past" else light.visible
    if recipe.behind != "dark":
        visible = np.where(above, visible, light.visible_through)
    if not shadows or recipe.shadows == "none":
        visible = np.ones_like(visible)
    if recipe.behind == "dark":
        visible = visible & above

    specular, exponent = _swapped(recipe, bounce, materials)
    base = np.maximum(_lobe_cosine(recipe, bounce, materials, n, l, v), 0)
    # An exponent far from its usual range overflows where vectors are too long.
    with np.errstate(over="ignore", invalid="ignore"):
        lobe = np.nan_to_num(base**exponent, nan=0.0, posinf=1e30)
        lobe = np.where(bounce.cosine | recipe.cosine, lobe * np.maximum(cos, 0), lobe)
        if recipe.behind in ("negative", "absolute"):
            cos, lobe = (cos if recipe.behind == "negative" else np.abs(cos)), np.where(above, lobe, 0)
        else:
            cos = np.maximum(cos, 0)
        intensity = light.intensity * (light.falloff if recipe.falloff else np.ones(len(cos)))[:, None]
        intensity = np.where(visible[:, None], intensity, 0)
        diffuse = intensity * bounce.diffuse * cos[:, None]
        return diffuse, intensity * specular * lobe[:, None] if recipe.highlight else 0 * diffuse


def _lobe_cosine(recipe: Recipe, bounce: Bounce, materials, n, l, v) -> np.ndarray:  # noqa: E741
    """What is raised to the exponent: r.v of Phong, n.h of Blinn-Phong."""
    lobes = [recipe.lobe or material.lobe for material in materials]
    phong = np.array([lobe == "phong" for lobe in lobes])[bounce.material]
    r = 2 * _dot(n, l)[:, None] * n - l
    if phong.all():
        return _dot(r, v)
    h = v + l
    length = np.linalg.norm(h, axis=-1, keepdims=True)
    h = h / (np.where(length > 0, length, 1) if recipe.half == "unit" else 2 if recipe.half == "halved" else 1)
    return np.where(phong, _dot(r, v), _dot(n, h))


def _swapped(recipe: Recipe, bounce: Bounce, materials):
    """Scale and exponent of the highlight."""
    if recipe.swapped is None:
        return bounce.specular, bounce.exponent
    values = {"specular": bounce.specular, "exponent": bounce.exponent[:, None]}
    names, *pair = recipe.swapped
    for mine, others in (pair, pair[::-1]):
        here = np.isin(bounce.material, mine)[:, None]
        for name in names:
            values[name] = np.where(here, getattr(materials[others[0]], name), values[name])
    return values["specular"], values["exponent"][:, 0]


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("ij,ij->i", a, b)
