"""Which usual mistake explains a wrong picture: the scene is shaded with each, and with pairs of them.

The hits are traced once for a scene and shaded often, on a part of the pixels; a class of pictures shares them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from . import mistakes
from .hits import Stage, Undiagnosable
from .mistakes import Change, Mistake
from .pictures import Encoding, Picture
from .shading import RIGHT, Recipe, shade, terms

# Pixels that are looked at: half of them anywhere, half where the picture changes. Pairs are searched on fewer.
LOOKED_AT = 16000
LOOKED_AT_FIRST = 3000

# A pixel that is off is half wrong at least, and wholly where it is off by this much more than allowed: a picture that
# is merely as dark as a mistake makes it is not explained by that.
FAR = 0.05

# A mistake is named if it explains this part of what is wrong. A pair has more ways to do so by chance, acne still
# more.
ENOUGH, ENOUGH_PAIR, ENOUGH_ACNE = 0.6, 0.75, 0.8

# A single mistake that explains this much is not asked for a second.
NEARLY_ALL = 0.97

# Two mistakes whose parts differ by less are not told apart.
SAME = 0.01

# Acne is a matter of single pixels, but of many: at so many of the lit pixels' sides the picture jumps where the right
# one does not.
SPECKLED = 0.05

# Vectors that are too long, to the power of an exponent, leave float32.
LARGEST = 1e30


@dataclass(frozen=True)
class Explanation:
    """One mistake, or two, as the explanation of a picture."""

    mistakes: tuple[Mistake, ...]
    changes: tuple[Change, ...]
    """The form of each that fits best."""
    explained: float
    """The part of what is wrong that is right with the mistakes, 0 to 1."""
    same: tuple[str, ...] = ()
    """Titles of other mistakes that explain it as well: in this scene they look alike."""

    @property
    def confidence(self) -> float:
        """`explained`, shared with the mistakes that look alike."""
        return self.explained / (1 + len(self.same))

    @property
    def name(self) -> str:
        return "+".join(mistake.name for mistake in self.mistakes)

    @property
    def title(self) -> str:
        """What is wrong, in words."""
        both = zip(self.mistakes, self.changes, strict=True)
        parts = (f"{mistake.title} ({change.detail})" if change.detail else mistake.title for mistake, change in both)
        return "; and ".join(parts)

    @property
    def advice(self) -> str:
        return " ".join(mistake.advice for mistake in self.mistakes)


@dataclass(frozen=True)
class Diagnosis:
    """The explanations of one picture, the best first."""

    named: Explanation | None
    """The one to tell; None: none of the usual mistakes."""
    ranked: tuple[Explanation, ...]


class Diagnostician:
    """Knows one scene, as seen by one camera, with every usual mistake."""

    def __init__(self, scene, sensor, reference: np.ndarray, *, spp: int, encoding: Encoding, directions=()):
        """`reference`: the right picture, linear; `encoding`: of the pictures; `directions` as for `Stage`."""
        if scene.integrator().__class__.__name__ != "Whitted" or scene.integrator().convention != "course":
            raise Undiagnosable("diagnosis knows the integrator whitted in the course convention")
        side = int(np.sqrt(spp))
        if side * side != spp or not sensor.film().rfilter().is_box_filter():
            raise Undiagnosable("diagnosis needs the box filter and 1, 4, 9, ... samples per pixel")
        self.stage, self.sensor, self.encoding = Stage(scene, directions), sensor, encoding
        self.height, self.width = reference.shape[:2]
        self.grid = np.stack(np.meshgrid(*2 * [(np.arange(side) + 0.5) / side]), -1).reshape(-1, 2)
        self.right = encoding.encode(reference)
        self.pixels = _choose(self.right, max(LOOKED_AT // spp, LOOKED_AT_FIRST))
        self.views = [View(self, self.pixels[:n]) for n in (len(self.pixels), LOOKED_AT_FIRST)]
        self._predicted = {}

    @cached_property
    def usual(self) -> list[Mistake]:
        """The mistakes that this scene can show."""
        integrator, hits = self.stage.integrator, self.views[0].hits()
        mirrors = any(bounce.km.any() for bounce in hits.bounces)
        near = self.sensor.near_clip() if hasattr(self.sensor, "near_clip") else 1.0
        return mistakes.usual(
            self.stage.materials, srgb=self.encoding.srgb, integers=self.encoding.step > 0,
            square=self.height == self.width, lights=self.stage.lights.count, shadows=integrator.shadows,
            mirror_bounces=min(len(hits.bounces), self.stage.most_hits - 1) if mirrors else 0, plane=near,
        )  # fmt: skip

    def explain(self, picture: Picture, allowed: np.ndarray) -> Diagnosis:
        """The mistakes that make the scene look like `picture`; `allowed` is what its values may be off."""
        judge = _Judge(self.views[0], picture.values, allowed, self.right)
        if judge.error(RIGHT_CHANGES) == 0:
            return Diagnosis(None, ())
        singles = self._singles(judge)
        best = singles[0] if singles else None
        if best and best.explained < NEARLY_ALL:
            pair = self._best_pair(judge, picture, allowed)
            # The second has to explain most of what the first leaves.
            if pair and pair.explained >= _enough(pair) and 1 - pair.explained <= 0.5 * (1 - best.explained):
                best, singles = pair, [pair, *singles]
        named = best if best and best.explained >= _enough(best) and judge.shows(best.changes) else None
        return Diagnosis(named, tuple(singles))

    def picture(self, explanation: Explanation, handed_in: np.ndarray) -> np.ndarray:
        """The whole picture as the mistakes make it, encoded; acne, which is random, as close to `handed_in` as it gets."""
        changes = explanation.changes
        rows, columns = np.mgrid[: self.height, : self.width]
        view = View(self, np.stack([rows.ravel(), columns.ravel()], axis=-1))
        if any(change.acne for change in changes):
            values = view.shadowed(changes, _unflipped(handed_in, changes).reshape(-1, 3))
        else:
            values = view.encoded(changes)
        return _unflipped(values.reshape(self.height, self.width, 3), changes)

    def _singles(self, judge: "_Judge") -> list[Explanation]:
        """Every mistake in its best form, the best first; equals, the simplest first."""
        found = []
        for mistake in self.usual:
            forms = [(judge.explained((change,)), -i) for i, change in enumerate(mistake.changes)]
            explained, i = max(forms)
            if explained > 0:
                found.append(Explanation((mistake,), (mistake.changes[-i],), explained))
        order = sorted(range(len(found)), key=lambda i: (-round(found[i].explained / SAME), i))
        found = [found[i] for i in order if found[i].explained > SAME]
        if not found:
            return []
        top = found[0]
        same = (e for e in found[1:] if e.explained >= top.explained - SAME and e.explained >= _enough(e))
        return [replace(top, same=tuple(e.title for e in same)), *found[1:]]

    def _best_pair(self, judge: "_Judge", picture: Picture, allowed) -> Explanation | None:
        """Searched among all on few pixels, decided among the best of them on more."""
        quick = _Judge(self.views[1], picture.values, allowed, self.right)
        found = []
        for one, other in combinations(self.usual, 2):
            for a in one.changes:
                found += [
                    (quick.explained((a, b)), len(found) + i, (one, other), (a, b))
                    for i, b in enumerate(other.changes) if a.goes_with(b)
                ]  # fmt: skip
        found.sort(key=lambda pair: (-pair[0], pair[1]))
        pairs = [Explanation(both, changes, judge.explained(changes)) for _, _, both, changes in found[:10]]
        return max(pairs, key=lambda pair: pair.explained, default=None)


RIGHT_CHANGES: tuple[Change, ...] = ()


class View:
    """Some pixels of the scene, shaded with any mistakes."""

    def __init__(self, scene: Diagnostician, pixels: np.ndarray):
        self.scene, self.pixels = scene, pixels
        self._hits, self._shaded = {}, {}

    def hits(self, recipe: Recipe = RIGHT):
        """The camera rays' hits; shifted rays and other mirror directions are traced on their own."""
        key = recipe.shift, recipe.raw_mirrors
        if key not in self._hits:
            inside = (self.pixels[:, None, ::-1] + self.scene.grid[None] + np.array(recipe.shift)).reshape(-1, 2)
            self._hits[key] = self.scene.stage.trace(self.scene.sensor, inside, recipe.raw_mirrors)
        return self._hits[key]

    def shaded(self, changes: Sequence[Change]) -> np.ndarray:
        """Linear colours of the pixels, (n, 3), float32."""
        recipe = _recipe(changes)
        if recipe not in self._shaded:
            shaded = self._mean(shade(self.hits(recipe), recipe, *self._options()))
            self._shaded[recipe] = np.clip(shaded, -LARGEST, LARGEST).astype(np.float32)
        return self._shaded[recipe]

    def encoded(self, changes: Sequence[Change]) -> np.ndarray:
        """The colours as the picture's file would store them."""
        return _encode(self.shaded(changes), changes, self.scene.encoding)

    def shadowed(self, changes: Sequence[Change], values: np.ndarray) -> np.ndarray:
        """The encoded colours that are closest to `values`, of those that acne can make: any light may be missing."""
        recipe = _recipe(changes)
        hits = self.hits(recipe)
        fixed, lights = np.zeros((hits.count, 3)), []
        for ray, light, colour in terms(hits, recipe, *self._options()):
            part = fixed if light < 0 else np.zeros((hits.count, 3))
            part[ray] += colour
            lights += [part] * (light >= 0)
        lights.sort(key=lambda part: -part.sum())
        fixed, lights = self._mean(fixed), [self._mean(part) for part in lights if part.any()]
        found = [self._closest(start, fixed, lights, values, changes) for start in (1.0, 0.0)]
        closer = found[0][1] <= found[1][1]
        return np.where(closer[:, None], found[0][0], found[1][0])

    def _closest(self, start: float, fixed, lights, values, changes):
        """Light by light, the part of its samples that brings each pixel closest; the colours, and how close."""
        # Of several samples in a pixel, some may be shadowed.
        levels = np.linspace(0, 1, min(len(self.scene.grid), 4) + 1)
        shares = [np.full((len(values), 1), start) for _ in lights]
        total = fixed + start * sum(lights, start=np.zeros_like(fixed))
        best = _encode(total, changes, self.scene.encoding)
        distance = np.abs(best - values).sum(axis=-1)
        for i, part in enumerate(lights):
            rest = total - shares[i] * part
            for level in levels:
                encoded = _encode(rest + level * part, changes, self.scene.encoding)
                candidate = np.abs(encoded - values).sum(axis=-1)
                better = candidate < distance
                distance = np.where(better, candidate, distance)
                best = np.where(better[:, None], encoded, best)
                shares[i] = np.where(better[:, None], level, shares[i])
            total = rest + shares[i] * part
        return best, distance

    def _options(self):
        stage = self.scene.stage
        return stage.most_hits, stage.integrator.shadows, stage.materials

    def _mean(self, samples: np.ndarray) -> np.ndarray:
        return samples.reshape(len(self.pixels), -1, 3).mean(axis=1)


class _Judge:
    """How well changes explain one picture, on the pixels of a view."""

    def __init__(self, view: View, values: np.ndarray, allowed: np.ndarray, right: np.ndarray):
        self.view, self.values = view, values
        self.allowed = np.broadcast_to(allowed, values.shape)[tuple(view.pixels.T)]
        self.speckled = _is_speckled(values, right, allowed)
        self.wrong = self.error(RIGHT_CHANGES)

    def explained(self, changes: Sequence[Change]) -> float:
        """The part of what is wrong that these changes explain; below 0 where they make it worse."""
        return 1 - self.error(changes) / self.wrong if self.wrong else 0.0

    def shows(self, changes: Sequence[Change]) -> bool:
        """Whether the changes also explain what the picture shows besides its most common colour."""
        colours, counts = np.unique(self.values.reshape(-1, 3), axis=0, return_counts=True)
        content = (self.values != colours[np.argmax(counts)]).any(axis=-1)
        return self.error(changes, content) <= 1 - ENOUGH

    def error(self, changes: Sequence[Change], only: np.ndarray | None = None) -> float:
        """Between 0, every pixel (of those in the mask `only`) is right, and 1."""
        errors = self._errors_of(changes)
        if only is not None:
            errors = errors[_unflipped(only[..., None], changes)[tuple(self.view.pixels.T)][..., 0]]
        return float(errors.mean()) if errors.size else 1.0

    def _errors_of(self, changes: Sequence[Change]) -> np.ndarray:
        values = _unflipped(self.values, changes)
        values = values[tuple(self.view.pixels.T)]
        if not any(change.acne for change in changes):
            return self._errors(values, self.view.encoded(changes))
        if not self.speckled:
            return np.ones(len(values))
        return self._errors(values, self.view.shadowed(changes, values))

    def _errors(self, values, expected) -> np.ndarray:
        excess = (np.abs(values - expected) - self.allowed).max(axis=-1)
        return np.where(excess > 0, 0.5 + 0.5 * np.clip(excess / FAR, 0, 1), 0)


def _enough(explanation: Explanation) -> float:
    if len(explanation.changes) > 1:
        return ENOUGH_PAIR
    return ENOUGH_ACNE if any(change.acne for change in explanation.changes) else ENOUGH


def _unflipped(values: np.ndarray, changes: Sequence[Change]) -> np.ndarray:
    """A picture before it was flipped; every flip is its own inverse."""
    for change in changes:
        values = mistakes.unflip(values, change.flip)
    return values


def _recipe(changes: Sequence[Change]) -> Recipe:
    fields = {}
    for change in changes:
        fields.update(change.recipe)
    return replace(RIGHT, **fields)


def _encode(image: np.ndarray, changes: Sequence[Change], encoding: Encoding) -> np.ndarray:
    curves = [change.curve for change in changes if change.curve]
    return mistakes.CURVES[curves[0]](image) if curves else encoding.encode(image)


def _choose(image: np.ndarray, count: int) -> np.ndarray:
    """`count` pixels (row, column): half of them anywhere, half where the picture changes; in random order."""
    rng = np.random.default_rng(0)
    height, width = image.shape[:2]
    change = sum(np.abs(np.gradient(image, axis=axis)).max(axis=-1) for axis in (0, 1) if image.shape[axis] > 1)
    change = np.broadcast_to(change, (height, width)).ravel()
    every = rng.permutation(height * width)
    if len(every) > count:
        keys = rng.random(len(every)) ** (1 / np.maximum(change[every], 1e-12))
        edges = every[np.argsort(-keys)[: count // 2]]
        anywhere = np.setdiff1d(every, edges, assume_unique=True)
        every = rng.permutation(np.concatenate([edges, rng.choice(anywhere, count - len(edges), replace=False)]))
    return np.stack(np.unravel_index(every, (height, width)), -1)


def _is_speckled(values: np.ndarray, right: np.ndarray, allowed: np.ndarray) -> bool:
    """Whether a picture jumps from pixel to pixel where the right one is smooth and not black."""
    limit, jumps, sides = 2 * float(np.mean(allowed)), 0, 0
    for axis in (0, 1):
        jump, expected = (np.abs(np.diff(image, axis=axis)).max(axis=-1) for image in (values, right))
        lit = np.delete(right.max(axis=-1) > limit, -1, axis=axis) & (expected <= limit)
        jumps, sides = jumps + np.count_nonzero(lit & (jump > 2 * limit)), sides + np.count_nonzero(lit)
    return jumps > SPECKLED * sides
