"""Directions at which formulas are tried: everywhere, and where float32 is in need."""

import numpy as np


def directions(rng, n: int) -> np.ndarray:
    """Unit vectors above the horizon, (n, 3), half of them spread over seven decades of grazing cosines."""
    cos = np.where(rng.random(n) < 0.5, rng.random(n), 10 ** rng.uniform(-7, 0, n))
    return _polar(cos, np.sqrt(1 - cos * cos), rng.random(n))


def pairs(lobe: str, p: float, n: int, rng) -> tuple[np.ndarray, np.ndarray]:
    """Float32 directions (wi, wo), each (<= n, 3): everywhere, and where the lobe is 1 down to 1e-30.

    One in a hundred pairs is an edge case: at the peak, at normal incidence, at opposite
    horizons, and one at a right angle to the axis up to 1e-10; three in ten directions have a length that is off by up
    to 1e-6.
    """
    wi = directions(rng, n)
    log_cos = -np.log(10) * rng.uniform(0, 30, n) * (rng.random(n) < 0.9) / max(p, 1e-3)
    cos = np.where(rng.random(n) < 0.01, rng.choice([-1, 1], n) * 10 ** rng.uniform(-10, -1, n), np.exp(log_cos))
    about_axis = _polar(cos, np.where(cos > 0.1, np.sqrt(-np.expm1(2 * log_cos)), np.sqrt(1 - cos**2)), rng.random(n))
    if lobe == "phong":
        wo = _to_axis(about_axis, wi * [-1, -1, 1])
    else:
        wo = 2 * np.sum(wi * about_axis, axis=1, keepdims=True) * about_axis - wi
    wo = np.where(rng.random((n, 1)) < 0.3, directions(rng, n), wo)
    for v in (wi, wo):
        v *= 1 + np.where(rng.random((n, 1)) < 0.3, rng.uniform(-1e-6, 1e-6, (n, 1)), 0)

    edge = rng.integers(0, 500, n)
    wo[edge == 0] = (wi * [-1, -1, 1])[edge == 0]
    wi[edge == 1], wo[edge == 1] = [0, 0, 1], [0, 0, 1]
    # At opposite horizons.
    cos = np.where(rng.random(n) < 0.5, 1e-7, 10 ** rng.uniform(-12, -4, n))
    low = _polar(cos, np.sqrt(1 - cos**2), rng.random(n))
    off = 1 + 10 ** rng.uniform(-7, -6, (2, n, 1)) * rng.choice([-1, 1], (2, n, 1))
    wi[edge == 2], wo[edge == 2] = (low * off[0])[edge == 2], (low * [-1, -1, 1] * off[1])[edge == 2]
    wo[edge == 3] = wi[edge == 3]
    # And across from each other at unequal heights.
    wi[edge == 4], wo[edge == 4] = (
        low[edge == 4],
        (_polar(cos[::-1], np.sqrt(1 - cos[::-1] ** 2), 0) + 0 * low)[edge == 4],
    )

    wi, wo = wi.astype(np.float32), wo.astype(np.float32)
    above = (wi[:, 2] > 0) & (wo[:, 2] > 0)
    return wi[above], wo[above]


def _polar(cos, sin, turn):
    phi = 2 * np.pi * turn
    return np.stack([sin * np.cos(phi), sin * np.sin(phi), cos + 0 * phi], axis=-1)


def _to_axis(v, axis):
    """Directions about +z as directions about `axis`."""
    z = axis + np.array([0, 0, 1])
    return 2 * np.sum(v * z, axis=1, keepdims=True) / np.sum(z * z, axis=1, keepdims=True) * z - v
