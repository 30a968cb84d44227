"""Pixels of a scene as they are with mistakes: shaded from recorded hits, encoded as a file stores them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from . import mistakes
from .mistakes import Change
from .pictures import Encoding
from .shading import RIGHT, Recipe, shade, terms
from .stage import Stage

# Vectors that are too long, to the power of an exponent, leave float32.
LARGEST = 1e30


class View:
    """Some pixels of the scene, shaded with any mistakes."""

    def __init__(self, stage: Stage, sensor, encoding: Encoding, grid: np.ndarray, pixels: np.ndarray):
        """`grid`: where in a pixel its samples are, (spp, 2); `pixels`: (n, 2), row and column."""
        self.stage, self.sensor, self.encoding, self.grid, self.pixels = stage, sensor, encoding, grid, pixels
        self._hits, self._shaded = {}, {}

    def hits(self, recipe: Recipe = RIGHT):
        """The camera rays' hits; shifted rays and other mirror directions are traced on their own."""
        key = recipe.shift, recipe.raw_mirrors
        if key not in self._hits:
            inside = (self.pixels[:, None, ::-1] + self.grid[None] + np.array(recipe.shift)).reshape(-1, 2)
            self._hits[key] = self.stage.trace(self.sensor, inside, recipe.raw_mirrors)
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
        return _encode(self.shaded(changes), changes, self.encoding)

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
        levels = np.linspace(0, 1, min(len(self.grid), 4) + 1)
        shares = [np.full((len(values), 1), start) for _ in lights]
        total = fixed + start * sum(lights, start=np.zeros_like(fixed))
        best = _encode(total, changes, self.encoding)
        distance = np.abs(best - values).sum(axis=-1)
        for i, part in enumerate(lights):
            rest = total - shares[i] * part
            for level in levels:
                encoded = _encode(rest + level * part, changes, self.encoding)
                candidate = np.abs(encoded - values).sum(axis=-1)
                better = candidate < distance
                distance = np.where(better, candidate, distance)
                best = np.where(better[:, None], encoded, best)
                shares[i] = np.where(better[:, None], level, shares[i])
            total = rest + shares[i] * part
        return best, distance

    def _options(self):
        return self.stage.most_hits, self.stage.materials, self.stage.integrator.shadows

    def _mean(self, samples: np.ndarray) -> np.ndarray:
        return samples.reshape(len(self.pixels), -1, 3).mean(axis=1)


def unflipped(values: np.ndarray, changes: Sequence[Change]) -> np.ndarray:
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


def choose(image: np.ndarray, count: int) -> np.ndarray:
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
