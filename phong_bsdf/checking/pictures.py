"""Pictures that somebody hands in, in whatever file, as numbers that can be compared with a rendering.

A file's values are kept as they are stored, 0 to 1 for integers; a rendering is brought to them with `Encoding.encode`,
not the other way round, since 8 bits cannot be undone.
"""

import io
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ..pictures import images, metrics

EXR_MAGIC = b"\x76\x2f\x31\x01"
NPY_MAGIC = b"\x93NUMPY"

# What Pillow is asked to recognise. All of them have a signature: a text file is not taken for one.
PILLOW_FORMATS = ("PNG", "JPEG", "PPM", "BMP")
SUFFIXES = (".png", ".jpg", ".jpeg", ".exr", ".ppm", ".bmp", ".npy")

# 16384 x 16384 in three channels of 8 bits is 800 MB. A small file can claim to hold far more.
MOST_PIXELS = 2**28

# JPEG works on blocks of 8 pixels, of 16 where colours are stored at half the resolution.
JPEG_BLOCK = 16

# Where an edge is hit in another pixel, which is no mistake, all of its block is compressed in another way. Right
# pictures of the course's scenes need up to 1.2.
JPEG_EDGES = 1.5


class PictureError(ValueError):
    """A file that holds no picture that can be compared."""


@dataclass(frozen=True)
class Encoding:
    """How a file stores linear values."""

    step: float = 0.0
    """Distance of two values that it can store: 1/255 for 8 bits, 0 for floating point."""
    srgb: bool = False
    jpeg: Mapping[str, object] | None = None
    """The JPEG tables it was compressed with."""
    spread: np.ndarray | None = field(default=None, compare=False)
    """How far values can be off that were weighted by alpha, (height, width, 1)."""

    def encode(self, image: np.ndarray) -> np.ndarray:
        """Linear values as this file would store them, not rounded: integers hold 0 to 1 only."""
        image = np.asarray(image, np.float64)
        if self.srgb:
            return images.srgb(image)
        return np.clip(image, 0, 1) if self.step else image

    def decode(self, values: np.ndarray) -> np.ndarray:
        """Linear values of encoded ones."""
        return images.from_srgb(values) if self.srgb else values

    def loss(self, image: np.ndarray) -> np.ndarray:
        """What storing an encoded image (height, width, 3) can take from each pixel, (height, width, 1) or one number.

        Half a step; for JPEG also 1.5 times the largest change that the same compression makes in the same block.
        """
        if self.spread is not None:
            return self.spread
        if self.jpeg is None:
            return np.full((1, 1, 1), self.step / 2)
        change = np.abs(_compressed(image, self.jpeg) - image).max(axis=-1)
        return JPEG_EDGES * _largest_in_blocks(change, JPEG_BLOCK)[..., None] + self.step / 2


@dataclass(frozen=True)
class Picture:
    """A picture as its file stores it."""

    values: np.ndarray
    """(height, width, 3), float64, encoded."""
    encoding: Encoding = field(default_factory=Encoding)
    notes: tuple[str, ...] = ()
    weighted: "Picture | None" = None
    """Of a file of integers that is partly transparent: its colours times alpha, over black, as a film has them."""


def read(path: Path, *, linear: bool = False, size: tuple[int, int] | None = None) -> Picture:
    """The picture in a PNG, JPEG, PPM, BMP, EXR or NumPy file; `PictureError` says what is wrong with any other.

    Integers are taken as sRGB, or as 255 (or 65535) times the linear value if `linear`; EXR and arrays of
    floating-point numbers are linear. A picture that is not of `size` (width, height) is refused before it is decoded.
    """
    path = Path(path)
    try:
        with open(path, "rb") as file:
            head = file.read(8)
        if not head:
            raise PictureError(f"{path.name}: the file is empty")
        if head.startswith(EXR_MAGIC):
            return _read_exr(path, size)
        if head.startswith(NPY_MAGIC):
            return _read_array(path, linear, size)
        return _read_integers(path, linear, size)
    except IsADirectoryError:
        raise PictureError(f"{path.name}: this is a folder") from None
    except FileNotFoundError:
        raise PictureError(f"{path}: there is no such file") from None
    except PermissionError:
        raise PictureError(f"{path.name}: this file may not be read") from None


def _read_exr(path: Path, size) -> Picture:
    import OpenEXR

    try:
        with OpenEXR.File(str(path), header_only=True) as file:
            low, high = file.header()["dataWindow"]
        _check_size(path, (int(high[0] - low[0]) + 1, int(high[1] - low[1]) + 1), size)
        image = images.read_exr(path)
    except PictureError:
        raise
    except Exception as error:
        # OpenEXR raises whatever its C++ side throws.
        raise PictureError(f"{path.name}: the EXR file cannot be read: {_first_line(error)}") from None
    return Picture(_three_channels(path, image.astype(np.float64)), notes=_alpha_note(image))


def _read_array(path: Path, linear: bool, size) -> Picture:
    try:
        # Mapped: a header can claim any size.
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except (ValueError, OSError, EOFError, SyntaxError) as error:
        raise PictureError(f"{path.name}: the array cannot be read: {_first_line(error)}") from None
    if array.ndim not in (2, 3) or array.dtype.kind not in "fu" or 0 in array.shape:
        raise PictureError(f"{path.name}: an array of shape {array.shape} and type {array.dtype} is no picture; "
                           "save (height, width, channels) as float32 or uint8")  # fmt: skip
    _check_size(path, (array.shape[1], array.shape[0]), size)
    array = np.array(array if array.ndim == 3 else array[..., None])
    if array.dtype.kind == "f":
        return Picture(_three_channels(path, array.astype(np.float64)), notes=_alpha_note(array))
    return _integers(path, array, linear)


def _read_integers(path: Path, linear: bool, size) -> Picture:
    image_module = _pillow()
    jpeg, notes = None, ()
    try:
        with warnings.catch_warnings():
            # The size is checked here, by what is wanted.
            warnings.simplefilter("ignore", image_module.DecompressionBombWarning)
            with image_module.open(path, formats=PILLOW_FORMATS) as file:
                _check_size(path, file.size, size)
                if file.mode in ("CMYK", "LAB", "HSV"):
                    raise PictureError(f"{path.name}: the picture is {file.mode}, for print; save it as RGB")
                deep = any("16B" in str(tile[3]) for tile in file.tile) and file.mode in ("RGB", "RGBA", "LA")
                if file.format == "JPEG":
                    from PIL import JpegImagePlugin

                    tables = file.quantization  # pyright: ignore[reportAttributeAccessIssue]  (files of this format have)
                    jpeg = {"qtables": tables, "subsampling": JpegImagePlugin.get_sampling(file)}
                if file.mode in ("P", "PA"):
                    notes = ("the file has a palette, which holds 256 colours at most; save it as RGB",)
                array = _sixteen_bits(path) if deep else _eight_bits(file)
    except image_module.UnidentifiedImageError:
        raise PictureError(f"{path.name}: this is no picture, or of another kind; hand in PNG, JPEG or EXR") from None
    except image_module.DecompressionBombError:
        raise PictureError(f"{path.name}: the picture is too large to be opened") from None
    except PictureError:
        raise
    except Exception as error:
        # Broken files make the decoders raise nearly anything.
        raise PictureError(f"{path.name}: the file is damaged: {_first_line(error)}") from None
    picture = _integers(path, array, linear, jpeg)
    return replace(picture, notes=(*picture.notes, *notes))


def _pillow():
    try:
        from PIL import Image
    except ImportError:
        raise ImportError(
            "reading PNG and JPEG needs the package pillow, which is not installed: pip install 'phong-bsdf[check]'"
        ) from None
    return Image


def _eight_bits(file) -> np.ndarray:
    if file.mode in ("P", "PA"):
        file = file.convert("RGBA" if "transparency" in file.info or file.mode == "PA" else "RGB")
    elif file.mode not in ("L", "LA", "RGB", "RGBA") and not file.mode.startswith("I"):
        file = file.convert("RGB")
    array = np.array(file)
    return array.astype(np.uint16) if file.mode.startswith("I") else array


def _sixteen_bits(path: Path) -> np.ndarray:
    """Pillow would drop the lower 8 bits of several channels."""
    from mitsuba.mitsuba_ext import Bitmap

    return np.array(Bitmap(str(path)))


def _integers(path: Path, array: np.ndarray, linear: bool, jpeg=None) -> Picture:
    array = array if array.ndim == 3 else array[..., None]
    largest = np.iinfo(array.dtype).max
    stored, encoding = array / largest, Encoding(1 / largest, not linear, jpeg)
    picture = Picture(_three_channels(path, stored), encoding, _alpha_note(stored))
    return replace(picture, weighted=_weighted(picture, stored[..., -1:])) if picture.notes else picture


def _weighted(picture: Picture, alpha: np.ndarray) -> Picture:
    """What a picture adds to black, and how far that can be off: neither colours nor alpha are stored exactly."""
    encoding, half = picture.encoding, picture.encoding.step / 2

    def shown(off: float) -> np.ndarray:
        colors, weights = (np.clip(x + off, 0, 1) for x in (picture.values, alpha))
        return encoding.encode(encoding.decode(colors) * weights)

    values = shown(0)
    spread = np.maximum(shown(half) - values, values - shown(-half)).max(axis=-1, keepdims=True)
    note = "the picture is partly transparent: it was compared as it looks over black"
    return Picture(values, replace(encoding, jpeg=None, spread=np.maximum(spread, half)), (note,))


def _three_channels(path: Path, image: np.ndarray) -> np.ndarray:
    if image.shape[2] > 4:
        raise PictureError(f"{path.name}: the picture has {image.shape[2]} channels, not grey or RGB")
    return np.ascontiguousarray(np.broadcast_to(metrics.colors(image), (*image.shape[:2], 3)))


def _alpha_note(image: np.ndarray) -> tuple[str, ...]:
    """Where alpha is not 1 everywhere, what was done with it."""
    if image.shape[2] in (2, 4) and np.any(image[..., -1] != 1):
        return ("the picture is partly transparent: its colours were compared as they are stored",)
    return ()


def _check_size(path: Path, found, wanted) -> None:
    if wanted is not None and tuple(found) != tuple(wanted):
        raise PictureError(
            f"{path.name}: the picture is {found[0]} x {found[1]} pixels and should be {wanted[0]} x {wanted[1]}"
        )
    if found[0] * found[1] > MOST_PIXELS:
        raise PictureError(f"{path.name}: {found[0]} x {found[1]} pixels are too many")


def _compressed(image: np.ndarray, jpeg: Mapping[str, object]) -> np.ndarray:
    """An encoded image after the same JPEG compression."""
    image_module = _pillow()
    stream = io.BytesIO()
    # Files without colour have one table; -1 is a subsampling that Pillow has no name for.
    known = {name: value for name, value in jpeg.items() if value != -1}
    image_module.fromarray(images.to_8bit(image)).save(stream, "JPEG", **known)
    return np.array(image_module.open(stream)) / 255


def _largest_in_blocks(values: np.ndarray, side: int) -> np.ndarray:
    """Each value of a (height, width) array replaced by the largest of its block."""
    height, width = values.shape
    padded = np.pad(values, ((0, -height % side), (0, -width % side)), mode="edge")
    blocks = padded.reshape(padded.shape[0] // side, side, -1, side).max(axis=(1, 3))
    return blocks.repeat(side, 0).repeat(side, 1)[:height, :width]


def _first_line(error: Exception) -> str:
    return (str(error).strip() or type(error).__name__).split("\n")[0]
