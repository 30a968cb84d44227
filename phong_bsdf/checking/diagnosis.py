"""Which usual mistake explains a wrong picture: the scene is shaded with each, and with pairs of them.

The hits are traced once for a scene and shaded often, on a part of the pixels; a class of pictures shares them.
"""

import heapq
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from ..scene import rendering
from . import mistakes
from .hits import Undiagnosable
from .mistakes import Change, Mistake
from .pictures import Encoding, Picture
from .stage import Stage
from .views import View, choose, unflipped

# Pixels that are looked at: half of them anywhere, half where the picture changes. Pairs are searched on fewer.
LOOKED_AT = 16000
LOOKED_AT_FIRST = 2000

# A pixel that is off is half wrong at least, and wholly where it is off by this much more than allowed: a picture that
# is merely as dark as a mistake makes it is not explained by that.
FAR = 0.05

# A mistake is named if it explains this part of what is wrong. A pair has more ways to do so by chance, acne still
# more.
ENOUGH, ENOUGH_PAIR, ENOUGH_ACNE = 0.6, 0.75, 0.8

# A single mistake that explains this much is not asked for a second.
NEARLY_ALL = 0.97

# In pairs, of a mistake that has more forms than this, those that explain most alone are tried.
MOST_FORMS = 8

# Two mistakes whose parts differ by less are not told apart.
SAME = 0.01

# Acne is a matter of single pixels, but of many: at so many of the lit pixels' sides the picture jumps where the right
# one does not.
SPECKLED = 0.05


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
        """The mistakes' names, with + between them."""
        return "+".join(mistake.name for mistake in self.mistakes)

    @property
    def title(self) -> str:
        """What is wrong, in words."""
        both = zip(self.mistakes, self.changes, strict=True)
        parts = (f"{mistake.title} ({change.detail})" if change.detail else mistake.title for mistake, change in both)
        return "; and ".join(parts)

    @property
    def advice(self) -> str:
        """What to do about it."""
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
        if type(scene.integrator()).__name__ != rendering.WHITTED or scene.integrator().convention != "course":
            raise Undiagnosable("diagnosis knows the integrator whitted in the course convention")
        side = int(np.sqrt(spp))
        if side * side != spp or not sensor.film().rfilter().is_box_filter():
            raise Undiagnosable("diagnosis needs the box filter and 1, 4, 9, ... samples per pixel")
        self.stage, self.sensor, self.encoding = Stage(scene, directions), sensor, encoding
        self.height, self.width = reference.shape[:2]
        self.grid = np.stack(np.meshgrid(*2 * [(np.arange(side) + 0.5) / side]), -1).reshape(-1, 2)
        self.right = encoding.encode(reference)
        self.pixels = choose(self.right, max(LOOKED_AT // spp, LOOKED_AT_FIRST))
        self.views = [self._view(self.pixels[:n]) for n in (len(self.pixels), LOOKED_AT_FIRST)]

    @cached_property
    def usual(self) -> list[Mistake]:
        """The mistakes that this scene can show."""
        integrator, hits = self.stage.integrator, self.views[0].hits()
        mirrors = any(bounce.km.any() for bounce in hits.bounces)
        near = self.sensor.near_clip() if hasattr(self.sensor, "near_clip") else 1.0
        return mistakes.usual(
            self.stage.materials, srgb=self.encoding.srgb, integers=self.encoding.step > 0,
            square=self.height == self.width, lights=self.stage.lights.count, shadows=integrator.shadows,
            mirror_bounces=min(len(hits.bounces), self.stage.most_hits - 1) if mirrors else 0,
            bounces_asked=self.stage.most_hits - 1 if integrator.depth > 0 else None, plane=near,
        )  # fmt: skip

    def explain(self, picture: Picture, allowed: np.ndarray) -> Diagnosis:
        """The mistakes that make the scene look like `picture`; `allowed` is what its values may be off."""
        judge = _Judge(self.views[0], picture.values, allowed, self.right)
        if judge.wrong == 0:
            return Diagnosis(None, ())
        singles = self._singles(judge)
        best = singles[0] if singles else None
        explained = best.explained if best else 0.0
        if explained < NEARLY_ALL:
            pair = self._best_pair(judge, picture, allowed)
            # The second has to explain most of what the first leaves.
            if pair and judge.names(pair) and 1 - pair.explained <= 0.5 * (1 - explained):
                best, singles = pair, [pair, *singles]
        named = best if best and judge.names(best) else None
        return Diagnosis(named, tuple(singles))

    def picture(self, explanation: Explanation, handed_in: np.ndarray) -> np.ndarray:
        """The whole picture with the mistakes, encoded; acne, which is random, as close to `handed_in` as it gets."""
        changes = explanation.changes
        view = self._everything
        if any(change.acne for change in changes):
            values = view.shadowed(changes, unflipped(handed_in, changes).reshape(-1, 3))
        else:
            values = view.encoded(changes)
        return unflipped(values.reshape(self.height, self.width, 3), changes)

    @cached_property
    def _everything(self) -> View:
        rows, columns = np.mgrid[: self.height, : self.width]
        return self._view(np.stack([rows.ravel(), columns.ravel()], axis=-1))

    def _view(self, pixels: np.ndarray) -> View:
        return View(self.stage, self.sensor, self.encoding, self.grid, pixels)

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
        forms = {
            mistake.name: heapq.nlargest(MOST_FORMS, mistake.changes, key=lambda change: quick.explained((change,)))
            for mistake in self.usual
        }
        found = []
        for one, other in combinations(self.usual, 2):
            for a in forms[one.name]:
                found += [
                    (quick.explained((a, b)), len(found) + i, (one, other), (a, b))
                    for i, b in enumerate(forms[other.name]) if a.goes_with(b)
                ]  # fmt: skip
        found.sort(key=lambda pair: (-pair[0], pair[1]))
        pairs = [Explanation(both, changes, judge.explained(changes)) for _, _, both, changes in found[:10]]
        return max(pairs, key=lambda pair: pair.explained, default=None)


class _Judge:
    """How well changes explain one picture, on the pixels of a view."""

    def __init__(self, view: View, values: np.ndarray, allowed: np.ndarray, right: np.ndarray):
        self.view, self.values = view, values
        self.allowed = np.broadcast_to(allowed, values.shape)[tuple(view.pixels.T)]
        self.speckled = _is_speckled(values, right, allowed)
        self.wrong = self.error(())

    def explained(self, changes: Sequence[Change]) -> float:
        """The part of what is wrong that these changes explain; below 0 where they make it worse."""
        return 1 - self.error(changes) / self.wrong if self.wrong else 0.0

    def names(self, explanation: Explanation) -> bool:
        """Whether it explains enough to be told."""
        return explanation.explained >= _enough(explanation) and self.shows(explanation.changes)

    def shows(self, changes: Sequence[Change]) -> bool:
        """Whether the changes also explain what the picture shows besides its most common colour."""
        colours, counts = np.unique(self.values.reshape(-1, 3), axis=0, return_counts=True)
        content = (self.values != colours[np.argmax(counts)]).any(axis=-1)
        return self.error(changes, content) <= 1 - ENOUGH

    def error(self, changes: Sequence[Change], only: np.ndarray | None = None) -> float:
        """Between 0, every pixel (of those in the mask `only`) is right, and 1."""
        errors = self._errors_of(changes)
        if only is not None:
            errors = errors[unflipped(only[..., None], changes)[tuple(self.view.pixels.T)][..., 0]]
        return float(errors.mean()) if errors.size else 1.0

    def _errors_of(self, changes: Sequence[Change]) -> np.ndarray:
        values = unflipped(self.values, changes)
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


def _is_speckled(values: np.ndarray, right: np.ndarray, allowed: np.ndarray) -> bool:
    """Whether a picture jumps from pixel to pixel where the right one is smooth and not black."""
    limit, jumps, sides = 2 * float(np.mean(allowed)), 0, 0
    for axis in (0, 1):
        jump, expected = (np.abs(np.diff(image, axis=axis)).max(axis=-1) for image in (values, right))
        lit = np.delete(right.max(axis=-1) > limit, -1, axis=axis) & (expected <= limit)
        jumps, sides = jumps + np.count_nonzero(lit & (jump > 2 * limit)), sides + np.count_nonzero(lit)
    return bool(jumps > SPECKLED * sides)
