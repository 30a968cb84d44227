"""Images that are changed on the way: multiplied, decoded with another gamma, cut to one channel.

Mitsuba 3 has no texture that scales another, so what an old texture did to its image is done to a copy of it.
The copy is linear, 32-bit EXR.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..pictures import images
from .paths import Files
from .records import ConversionError

LARGEST_IMAGE = 2**28


def read(path: Path) -> np.ndarray:
    """An image as it is in its file, shape (height, width, channels): encoded integers, or linear floats."""
    # Not `mitsuba.Bitmap`: this one needs no variant to be set.
    from mitsuba.mitsuba_ext import Bitmap

    if path.suffix.lower() == ".exr":
        return images.read_exr(path)
    try:
        array = np.atleast_3d(np.array(Bitmap(str(path))))
    except (RuntimeError, ValueError) as error:
        raise ConversionError(f"{path}: this image cannot be read: {str(error).splitlines()[-1]}") from None
    if array.size > LARGEST_IMAGE:
        raise ConversionError(f"{path}: an image of {array.size} values is too large to be converted")
    return array


def decode(image: np.ndarray, gamma: float | None = None) -> np.ndarray:
    """Linear colours without alpha, float32. Integers are sRGB, or to the power of `gamma`; floats are linear."""
    color = image[..., : image.shape[2] - (image.shape[2] in (2, 4))]
    if image.dtype.kind == "f":
        return color.astype(np.float32)
    x = color.astype(np.float32) / np.iinfo(image.dtype).max
    if gamma is not None:
        return x**gamma
    return images.from_srgb(x)


def alpha(image: np.ndarray) -> np.ndarray | None:
    """The last channel, linear, of an image that has alpha."""
    if image.shape[2] not in (2, 4):
        return None
    last = image[..., -1:].astype(np.float32)
    return last if image.dtype.kind == "f" else last / np.iinfo(image.dtype).max


def write(files: Files, path: Path, image: np.ndarray, what: str) -> Path:
    """Write a changed copy of the image `path` among the new scene's files, `what` was done in its name."""
    new = files.beside_output(f"{path.stem}-{what}", ".exr")
    images.write(new, image)
    return new


def copy(files: Files, path: Path, change: Callable[[np.ndarray], np.ndarray], what: str, gamma=None) -> Path:
    """Write `change` of the decoded image `path` among the new scene's files, `what` was done in its name."""
    return write(files, path, np.ascontiguousarray(change(decode(read(path), gamma)), np.float32), what)


def scaled(color: np.ndarray, factor: list[float]) -> np.ndarray:
    """An image times a grey or RGB factor."""
    if len(set(factor)) == 1:
        return color * np.float32(factor[0])
    return np.broadcast_to(color, (*color.shape[:2], 3)) * np.asarray(factor, np.float32)
