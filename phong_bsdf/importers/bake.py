"""Images that are changed on the way: multiplied, decoded with another gamma, cut to one channel.

Mitsuba 3 has no texture that scales another, so what an old texture did to its image is done to a copy of it.
The copy is linear, 32-bit EXR.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from .. import images
from .paths import Files
from .records import ConversionError

LARGEST_IMAGE = 2**28


def read(path: Path, gamma: float | None = None) -> np.ndarray:
    """A linear image, shape (height, width, channels), float32. 8- and 16-bit files are decoded: as sRGB, or with
    `gamma`; alpha stays. Files that hold floating point numbers are linear already."""
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
    if array.dtype.kind == "f":
        return array.astype(np.float32)
    x = array.astype(np.float32) / np.iinfo(array.dtype).max
    colors = x.shape[2] - (x.shape[2] in (2, 4))
    color = x[..., :colors]
    if gamma is None:
        color = np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)
    else:
        color = color**gamma
    return np.concatenate([color, x[..., colors:]], axis=2)


def write(files: Files, path: Path, image: np.ndarray, what: str) -> Path:
    """Write a changed copy of the image `path` among the new scene's files, `what` was done in its name."""
    new = files.beside_output(f"{path.stem}-{what}", ".exr")
    images.write(new, image)
    return new


def copy(files: Files, path: Path, change: Callable[[np.ndarray], np.ndarray], what: str, gamma=None) -> Path:
    """The same, of `change` of the image, without alpha."""
    image = read(path, gamma)
    color = image[..., : image.shape[2] - (image.shape[2] in (2, 4))]
    return write(files, path, np.ascontiguousarray(change(color), np.float32), what)


def scaled(color: np.ndarray, factor: list[float]) -> np.ndarray:
    """An image times a grey or RGB factor."""
    if len(set(factor)) == 1:
        return color * np.float32(factor[0])
    return np.broadcast_to(color, (*color.shape[:2], 3)) * np.asarray(factor, np.float32)
