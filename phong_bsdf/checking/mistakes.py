"""The usual mistakes of a first ray tracer, each as what it changes in a picture that is right."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from ..pictures import images
from .hits import Material

# More swaps of materials than this are not tried: a scene of many materials has thousands.
MOST_SWAPS = 60

# What can be exchanged, as it is called.
SWAPPED = {"specular": "k_s", "exponent": "exponent"}

CORNERS = {
    (-0.5, -0.5): "top left corners", (0.5, -0.5): "top right corners",
    (-0.5, 0.5): "bottom left corners", (0.5, 0.5): "bottom right corners",
    (0.0, -0.5): "top edges", (0.0, 0.5): "bottom edges", (-0.5, 0.0): "left edges", (0.5, 0.0): "right edges",
}  # fmt: skip

FLIPS = {
    "upside down": lambda image: image[::-1],
    "left and right exchanged": lambda image: image[:, ::-1],
    "turned by half a turn": lambda image: image[::-1, ::-1],
    "rows and columns exchanged": lambda image: image.swapaxes(0, 1),
}


@dataclass(frozen=True)
class Change:
    """One form of a mistake. In a pair, two changes go together unless they touch the same thing."""

    recipe: Mapping[str, object] = field(default_factory=dict)
    """Fields of `shading.Recipe`."""
    flip: str = ""
    """One of `FLIPS`, or `red and blue exchanged`."""
    curve: str = ""
    """One of `CURVES`: what is stored instead of the right encoding."""
    acne: bool = False
    """Surfaces block their own light at random."""
    detail: str = ""
    """What tells this form from the others."""

    def goes_with(self, other: "Change") -> bool:
        """Whether both can be made at once."""
        both_flip = self.flip and other.flip
        return not (set(self.recipe) & set(other.recipe) or both_flip or (self.curve and other.curve))


@dataclass(frozen=True)
class Mistake:
    """A mistake with its forms, of which a picture shows one."""

    name: str
    title: str
    advice: str
    """What to do about it."""
    changes: tuple[Change, ...]


def unflip(image: np.ndarray, flip: str) -> np.ndarray:
    """A picture (height, width, 3) as it was before it was flipped."""
    if flip == "red and blue exchanged":
        return image[..., ::-1]
    return FLIPS[flip](image) if flip else image


CURVES = {
    "srgb applied": images.srgb,
    "srgb twice": lambda image: images.srgb(images.srgb(image)),
    "gamma": lambda image: np.clip(image, 0, 1) ** (1 / 2.2),
    "srgb forgotten": lambda image: np.clip(image, 0, 1),
    "clamped": lambda image: np.clip(image, 0, 1),
    "wrapped": lambda image: np.mod(np.rint(255 * np.clip(image, 0, 1e6)), 256) / 255,
}


def usual(
    materials: Sequence[Material],
    *,
    srgb: bool,
    integers: bool,
    square: bool,
    lights: int,
    shadows: bool,
    mirror_bounces: int,
    bounces_asked: int | None,
    plane: float,
) -> list[Mistake]:
    """The mistakes that can be made with a scene, the simplest first.

    `srgb`, `integers`: how the picture is to be stored; `mirror_bounces`: how often its rays are mirrored, and
    `bounces_asked`: how often they are to be, None for without end; `plane`: distance of the camera's image plane.
    """
    found = [*_picture(srgb, integers, square), *_vectors(plane), *_lights(lights)]
    found += _shadows() if shadows else []
    found += _highlights(materials)
    found += _mirrors(mirror_bounces, bounces_asked) if mirror_bounces else []
    return [*found, *_swaps(materials)]


def _one(name: str, title: str, advice: str, **recipe) -> Mistake:
    return Mistake(name, title, advice, (Change(recipe),))


def _picture(srgb: bool, integers: bool, square: bool) -> Iterator[Mistake]:
    if srgb:
        yield Mistake("srgb-forgotten", "the sRGB curve is missing", "Encode with the sRGB curve before storing.",
                      (Change(curve="srgb forgotten"),))  # fmt: skip
        yield Mistake("gamma", "a gamma of 2.2 is used for the sRGB curve",
                      "Use 12.92 x up to 0.0031308, above 1.055 x^(1/2.4) - 0.055.",
                      (Change(curve="gamma"),))  # fmt: skip
        yield Mistake("srgb-twice", "the sRGB curve is applied twice", "Encode once; perhaps a library did already.",
                      (Change(curve="srgb twice"),))  # fmt: skip
    else:
        yield Mistake("srgb-applied", "the sRGB curve is applied to a picture that should be linear",
                      "Store 255 times the value, without a gamma curve.",
                      (Change(curve="srgb applied"), Change(curve="gamma", detail="a gamma of 2.2")))  # fmt: skip
    if integers and not srgb:
        yield Mistake("wrapped", "values above 1 wrap around to dark ones", "Clamp to [0, 1] before the cast.",
                      (Change(curve="wrapped"),))  # fmt: skip
    if not integers:
        yield Mistake("clamped", "values above 1 are cut off", "Floating point holds any value: store it as it is.",
                      (Change(curve="clamped"),))  # fmt: skip
    flips = [Change(flip=name, detail=name) for name in FLIPS if square or name != "rows and columns exchanged"]
    yield Mistake("flipped", "the picture is flipped", "Row 0 is the top of the picture, column 0 its left.",
                  tuple(flips))  # fmt: skip
    yield Mistake("red-blue", "red and blue are exchanged", "Store red, green, blue, in this order.",
                  (Change(flip="red and blue exchanged"),))  # fmt: skip
    yield Mistake(
        "half-pixel", "the picture is shifted by half a pixel", "Send rays through the centres of the pixels: add 0.5.",
        tuple(Change({"shift": s}, detail=f"through the {name} of the pixels") for s, name in CORNERS.items()),
    )  # fmt: skip


def _vectors(plane: float) -> Iterator[Mistake]:
    rays = [Change({"view": "ray", "plane": p}, detail="as long as the camera ray") for p in sorted({1.0, plane})]
    yield Mistake(
        "view-length", "v is not normalised", "Divide the vector toward the viewer by its length.",
        (Change({"view": "distance"}, detail="as long as the distance to the eye"), *rays),
    )  # fmt: skip
    yield _one("light-length", "l is not normalised", "Divide the vector toward the light by its length.", light="raw")
    yield Mistake(
        "normal-length", "n is not normalised", "Divide the normal by its length (on a sphere, by the radius).",
        (Change({"normal": "raw"}), Change({"normal": "raw", "raw_mirrors": True}, detail="for mirrors, too")),
    )  # fmt: skip
    yield Mistake(
        "half-length", "h is not normalised", "Divide v + l by its length.",
        (Change({"half": "raw"}), Change({"half": "halved"}, detail="(v + l) / 2")),
    )  # fmt: skip


def _lights(count: int) -> Iterator[Mistake]:
    yield _one("falloff", "the light falls off with 1/r²", "Use the intensity as it is, at any distance.", falloff=True)
    if count > 1:
        changes = (Change({"missing_light": i}, detail=f"light {i + 1} of {count}") for i in range(count))
        yield Mistake(
            "light-missing", "one light is missing", "Add up the contributions of all lights.", tuple(changes)
        )
    forms = {"highlight": "in the highlight", "absolute": "with |n.l|", "negative": "with a negative n.l"}
    yield Mistake(
        "behind", "light from behind the surface is counted", "Where n.l <= 0, the light contributes nothing.",
        tuple(Change({"behind": form}, detail=detail) for form, detail in forms.items()),
    )  # fmt: skip


def _shadows() -> Iterator[Mistake]:
    yield _one("no-shadows", "there are no shadows", "Send a ray to each light; where it is blocked, leave it out.",
               shadows="none")  # fmt: skip
    yield _one("shadow-past-light", "shadow rays go past the light", "Only what is between surface and light blocks.",
               shadows="past")  # fmt: skip
    yield Mistake("shadow-acne", "shadow acne: surfaces shadow themselves",
                  "Start shadow rays a little above the surface.", (Change(acne=True),))  # fmt: skip


def _highlights(materials: Sequence[Material]) -> Iterator[Mistake]:
    lobes = {material.lobe for material in materials}
    if "blinnphong" in lobes:
        yield _one("phong", "Phong is used where Blinn-Phong is asked", "Use (n.h)^p, h half-way between v and l.",
                   lobe="phong")  # fmt: skip
    if "phong" in lobes:
        yield _one("blinnphong", "Blinn-Phong is used where Phong is asked", "Use (r.v)^p, r the mirrored l.",
                   lobe="blinnphong")  # fmt: skip
    if lobes != {"diffuse"}:
        yield _one("highlight-missing", "the highlights are missing", "Add k_s times the lobe.", highlight=False)
        yield _one("highlight-cosine", "the highlight is multiplied by n.l", "Only the diffuse part has a factor n.l.",
                   cosine=True)  # fmt: skip


def _mirrors(bounces: int, asked: int | None) -> Iterator[Mistake]:
    yield _one("mirror-added", "the mirror is added, not blended: (1 - k_m) is missing", "Use k_m L_r + (1 - k_m) L.",
               mirror="added")  # fmt: skip
    yield _one("mirror-full", "the mirror is added in full, without k_m", "Use k_m L_r + (1 - k_m) L.", mirror="full")
    yield _one("highlight-unblended", "(1 - k_m) is missing from the highlight",
               "(1 - k_m) multiplies diffuse part and highlight.", mirror="highlight")  # fmt: skip
    instead = "" if asked is None else f" instead of {asked}"
    fewer = (Change({"bounces": n}, detail=f"{n}{instead}") for n in range(bounces - 1, -1, -1))
    yield Mistake("too-few-bounces", "rays are mirrored too few times", "Follow mirrors as often as the scene asks.",
                  tuple(fewer))  # fmt: skip
    yield _one("dark-end", "after the last bounce the mirrored part is black",
               "There a mirror shows its own colour in full, as if k_m = 0.", end="dark")  # fmt: skip


def _swaps(materials: Sequence[Material]) -> Iterator[Mistake]:
    """Two surfaces, or all with the highlight of either, have each other's k_s, exponent, or both."""
    groups: dict[tuple, list[int]] = {}
    for i, material in enumerate(materials):
        if material.specular is not None and material.exponent is not None:
            groups.setdefault((_three(material.specular), material.exponent), []).append(i)
    changes = []
    for one, other in combinations(groups, 2):
        differ = tuple(name for name, a, b in zip(SWAPPED, one, other, strict=True) if a != b)
        both = [(tuple(groups[one]), tuple(groups[other]))]
        both += [((a,), (b,)) for a in groups[one] for b in groups[other] if ((a,), (b,)) != both[0]]
        for names in dict.fromkeys([(name,) for name in differ] + [differ]):
            changes += [
                Change({"swapped": (names, *pair)}, detail=_swap_words(names, pair, materials)) for pair in both
            ]
    if changes:
        yield Mistake("materials-swapped", "two materials have each other's values", "Compare with the scene file.",
                      tuple(changes[:MOST_SWAPS]))  # fmt: skip


def _swap_words(names, pair, materials: Sequence[Material]) -> str:
    a, b = (", ".join(materials[i].name for i in group) for group in pair)
    return f"{' and '.join(SWAPPED[name] for name in names)} of {a} and of {b}"


def _three(value) -> tuple[float, ...]:
    return tuple(float(x) for x in np.broadcast_to(value, 3))
