"""Value and density of the lobes by mpmath, at the very numbers that float32 holds."""

import mpmath as mp
import numpy as np

from phong_bsdf.stability import inputs


def by_mpmath(lobe, quantity, x):
    """`value` or `pdf` at x = (wi, wo, p), the directions normalised exactly."""
    a, b, p = mp.matrix(x[0:3]), mp.matrix(x[3:6]), x[6]
    a, b = a / mp.norm(a), b / mp.norm(b)
    if lobe == "phong":
        cos, jacobian = a[2] * b[2] - a[0] * b[0] - a[1] * b[1], 1
        mirrored = 2 * a[2] * cos - b[2] if p > 0 else 1
    else:
        h = a + b
        cos, jacobian = h[2] / mp.norm(h), 1 / (2 * mp.norm(h))
        mirrored = 2 * a[2] * (2 * cos**2 - 1) - b[2]
    value = cos**p if cos > 0 else mp.mpf(p == 0)
    if quantity == "value":
        return value
    # Samples that would be below the surface are mirrored, which doubles the density where they go.
    return (p + 1) / (2 * mp.pi) * value * jacobian * (2 if mirrored < 0 else 1)


def numbered_pairs(lobe, p, seed, n):
    """`inputs.pairs`, and each of them once more as seven numbers of mpmath: wi, wo, p."""
    wi, wo = inputs.pairs(lobe, p, n, np.random.default_rng(seed))
    numbers = [[mp.mpf(float(x)) for x in (*v, *w, np.float32(p))] for v, w in zip(wi, wo, strict=True)]
    return wi, wo, numbers
