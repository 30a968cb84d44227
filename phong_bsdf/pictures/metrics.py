"""How far an image is from a reference, on arrays. Linear images of shape (height, width, channels); alpha is left out.

Pixels that are not finite are counted first, and no error is formed from an image that has
some: a mean that hides them would call a broken picture good.
"""

import contextlib
import io
import math
from dataclasses import dataclass

import numpy as np

__all__ = ["Errors", "errors"]

# relMSE = mean((x - r)^2 / (r^2 + EPSILON)): keeps black pixels from deciding alone.
EPSILON = 1e-2

# HDR-FLIP looks at a picture at several exposures and keeps the worst. Its own choice depends on the reference; fixed
# ones keep numbers comparable: two stops down, as it is, two stops up.
FLIP_EXPOSURES = {"startExposure": -2.0, "stopExposure": 2.0, "numExposures": 3}


@dataclass(frozen=True)
class Errors:
    """Errors of one image; NaN where the image or the reference has pixels that are not finite."""

    mse: float
    """Mean of (x - r)^2 over pixels and channels."""
    relmse: float
    """Mean of (x - r)^2 / (r^2 + 0.01), which keeps black pixels from deciding alone."""
    max_error: float
    """Largest |x - r|."""
    flip: float | None
    """Mean HDR-FLIP at the exposures -2, 0 and 2 stops, 0 to 1; None where `flip-evaluator` is not installed."""


def errors(image: np.ndarray, reference: np.ndarray) -> Errors:
    """How far `image` is from `reference`, both linear, (height, width, channels), without their alpha.

    Channels are Y, YA, RGB or RGBA. ValueError where the shapes differ. Sources: relMSE, Rousselle et al., "Adaptive
    sampling and reconstruction using greedy error minimization", 2011; HDR-FLIP, Andersson et al., "Visualizing errors
    in rendered high dynamic range images", 2021.
    """
    x, r = check_shapes(image, reference)
    if nonfinite(x) or nonfinite(r):
        return Errors(math.nan, math.nan, math.nan, math.nan if has_flip() else None)
    x, r = (colors(a).astype(np.float64) for a in (x, r))
    square = (x - r) ** 2
    return Errors(
        mse=float(square.mean()),
        relmse=float((square / (r * r + EPSILON)).mean()),
        max_error=float(np.sqrt(square.max())),
        flip=flip(x, r) if has_flip() else None,
    )


def check_shapes(image: np.ndarray, reference: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both as arrays; ValueError, which names both shapes, where they differ."""
    x, r = (np.asarray(a) for a in (image, reference))
    if x.ndim != 3 or x.shape != r.shape:
        raise ValueError(f"images of different shapes cannot be compared: {_shape(x)} and {_shape(r)}")
    return x, r


def nonfinite(image: np.ndarray) -> int:
    """Number of pixels with a NaN or an infinity in some channel."""
    return int(np.sum(~np.isfinite(image).all(axis=-1)))


def energy(image: np.ndarray) -> float:
    """Mean over pixels and colour channels: NaN or infinite if one of them is."""
    return float(colors(image).mean(dtype=np.float64))


def colors(image: np.ndarray) -> np.ndarray:
    """The image without its alpha channel: channels are Y, YA, RGB or RGBA."""
    return image[..., : 3 if image.shape[-1] > 2 else 1]


def has_flip() -> bool:
    """Whether the package `flip-evaluator` is installed."""
    try:
        import flip_evaluator  # noqa: F401
    except ImportError:
        return False
    return True


def flip(image: np.ndarray, reference: np.ndarray) -> float:
    """Mean HDR-FLIP of finite images of one or three channels; negative values count as 0."""
    import flip_evaluator

    # It takes float32 RGB >= 0 only, ends the process on anything else, and writes to stdout.
    both = (np.broadcast_to(np.clip(a, 0, None), (*a.shape[:2], 3)) for a in (reference, image))
    r, x = (np.ascontiguousarray(a, np.float32) for a in both)
    with contextlib.redirect_stdout(io.StringIO()):
        _, mean, _ = flip_evaluator.evaluate(r, x, "HDR", applyMagma=False, parameters=dict(FLIP_EXPOSURES))
    return float(mean)


def _shape(image: np.ndarray) -> str:
    if image.ndim != 3:
        return f"an array of {image.ndim} dimensions"
    height, width, channels = image.shape
    return f"{width} x {height} with {channels} channel{'' if channels == 1 else 's'}"
