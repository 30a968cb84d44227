"""Image files <-> arrays. Linear EXR through the OpenEXR package, 8-bit PNG through Mitsuba's bitmap.

A file is written under a temporary name and then renamed: it appears whole or not at all.
Mitsuba's own EXR routines are avoided: they wait for ever where Dr.Jit has no free thread.
"""

import contextlib
import glob
import io
import json
import os
import tempfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from ..host import machine

__all__ = ["color", "read_all", "read_exr", "read_metadata", "srgb", "write"]

FORMATS = (".exr", ".png")
CHANNELS = {1: "Y", 2: "YA", 3: "RGB", 4: "RGBA"}
# What colours can be stored as: the names of their channels, the first that are all there count.
COLORS = ("RGB", "XYZ", "Y")
CHECKSUM, ORDER = "crc32", "channel_order"

# Linear sRGB of X, Y, Z, as Mitsuba has it.
XYZ_TO_RGB = np.array([
    [3.240479, -1.537150, -0.498535], [-0.969256, 1.875991, 0.041556], [0.055648, -0.204043, 1.057311]
])  # fmt: skip


def check_writable(path: Path) -> None:
    """Raise ValueError if `write` could not write `path`."""
    path = Path(path)
    if path.suffix.lower() not in FORMATS:
        raise ValueError(f"'{path}': an image file must end in {' or '.join(FORMATS)}")
    if path.is_dir():
        raise ValueError(f"'{path}' is a folder")
    try:
        with _whole(path, keep=False):
            pass
    except OSError as error:
        raise ValueError(f"'{path}' cannot be written: {error.strerror or error}") from None


def check_folder(folder: Path) -> None:
    """Raise ValueError if files could not be written into `folder`, which need not exist yet."""
    existing = Path(folder)
    while not existing.exists():
        existing = existing.parent
    if not existing.is_dir():
        raise ValueError(f"'{folder}' cannot be written: '{existing}' is no folder")
    try:
        with _whole(existing / "test", keep=False):
            pass
    except OSError as error:
        raise ValueError(f"'{folder}' cannot be written: {error.strerror or error}") from None


def color_channels(channels: Sequence[str]) -> str:
    """Which of these channels are the colour, and alpha: "RGB", "XYZA", "Y", ..., or "" where there is none."""
    colors = next((names for names in COLORS if set(names) <= set(channels)), "")
    return colors and colors + "A" * ("A" in channels)


def judged(channels: Sequence[str]) -> list[int] | None:
    """The numbers of the channels that a picture's error is told of: its colour and alpha. None: all of them."""
    colors = color_channels(channels)
    return [list(channels).index(name) for name in colors] if 0 < len(colors) < len(channels) else None


def check_channels(path: Path, channels: Sequence[str]) -> None:
    """Raise ValueError if the file `path` cannot hold these channels: a PNG shows the colour, and nothing without."""
    if len(set(channels)) < len(channels):
        twice = next(name for name in channels if list(channels).count(name) > 1)
        raise ValueError(f"'{path}': two channels have the name '{twice}'; give each its own")
    if Path(path).suffix.lower() == ".png" and not color_channels(channels):
        raise ValueError(f"'{path}': a PNG shows colours, and the picture has none, only {', '.join(channels)}; "
                         "write an .exr")  # fmt: skip


def color(image: np.ndarray, channels: Sequence[str] | None = None) -> np.ndarray:
    """The colour of a linear image, (height, width, channels), as Y, YA, RGB or RGBA in its last axis.

    `channels` names those that the image has (None: Y, YA, RGB or RGBA). X, Y and Z become linear sRGB, by the matrix
    of ITU-R BT.709 as Mitsuba has it; alpha stays as it is. ValueError where there is no colour.
    """
    if channels is None:
        return image
    wanted = color_channels(channels)
    if not wanted:
        raise ValueError(f"the picture has no colour, only the channels {', '.join(channels)}")
    if wanted != "".join(channels):
        image = image[..., [list(channels).index(name) for name in wanted]]
    if not wanted.startswith("XYZ"):
        return image
    return np.concatenate([(image[..., :3] @ XYZ_TO_RGB.T).astype(image.dtype), image[..., 3:]], axis=-1)


def write(
    path: Path,
    image: np.ndarray,
    *,
    channels: Sequence[str] | None = None,
    linear: bool = False,
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Write a linear image of shape (height, width, channels); `channels` names them (None: Y, YA, RGB or RGBA).

    EXR holds it as it is (32-bit float), with `metadata` and a checksum as string attributes. PNG holds the colour:
    round(255 clamp(x, 0, 1)) of x = colour if `linear`, else of its sRGB encoding; with alpha the colour is divided
    by it, as PNG wants it. Raises OSError where the file cannot be written in full, ValueError where it cannot hold the
    image: other suffixes than .exr and .png, channels that no name is given for, a PNG without colours.
    """
    path = Path(path)
    image = np.asarray(image, np.float32)
    if channels is None and image.shape[2] not in CHANNELS:
        raise ValueError(f"'{path}': an image of {image.shape[2]} channels cannot be written without their names, only "
                         "Y, YA, RGB or RGBA")  # fmt: skip
    given, channels = channels is not None, tuple(channels or CHANNELS[image.shape[2]])
    if len(channels) != image.shape[2]:
        raise ValueError(f"'{path}': {image.shape[2]} channels have {len(channels)} names, {', '.join(channels)}")
    check_channels(path, channels)
    with _whole(path) as temporary:
        try:
            if path.suffix.lower() == ".exr":
                _write_exr(temporary, image, metadata or {}, *(channels if given else ()))
            else:
                _write_png(temporary, image, channels, linear)
        except RuntimeError as error:
            # The library names the temporary file first, then the reason.
            reason = str(error).rsplit('". ', 1)[-1].rstrip(".")
            raise OSError(f"'{path}' could not be written: {reason}") from None


def read_exr(path: Path) -> np.ndarray:
    """The colour in an EXR file, shape (height, width, channels), float32, channels Y or R, G, B, then A.

    X, Y and Z become linear sRGB; channels beside the colour are left out. ValueError where there is no colour;
    OpenEXR raises RuntimeError where the file is missing or broken.
    """
    OpenEXR = _openexr()
    with OpenEXR.File(str(path), separate_channels=True) as file:
        found = file.channels()
        names = tuple(color_channels(tuple(found)))
        if not names:
            raise ValueError(f"'{path}' holds no colours, only the channels {', '.join(sorted(found))}")
        return color(_stacked(found, names), names)


def read_all(path: Path) -> tuple[np.ndarray, tuple[str, ...]]:
    """All channels of an EXR file, (height, width, channels), float32, as they are stored, and their names.

    OpenEXR raises RuntimeError where the file is missing or broken.
    """
    OpenEXR = _openexr()
    with OpenEXR.File(str(path), separate_channels=True) as file:
        names = _ordered(file.header(), file.channels())
        return _stacked(file.channels(), names), names


def read_channels(path: Path) -> tuple[str, ...]:
    """The names of the channels of an EXR file, in the order of `read_all`."""
    OpenEXR = _openexr()
    with OpenEXR.File(str(path), separate_channels=True, header_only=True) as file:
        return _ordered(file.header(), [channel.name for channel in file.header()["channels"]])


def _ordered(header, found) -> tuple[str, ...]:
    """Names of channels as they were when the file was written; of other files the colour comes first."""
    order = json.loads(header[ORDER]) if isinstance(header.get(ORDER), str) else []
    if sorted(order) == sorted(found):
        return tuple(order)
    colors = color_channels(tuple(found))
    return (*colors, *sorted(set(found) - set(colors)))


def _stacked(found, names: Sequence[str]) -> np.ndarray:
    return np.stack([np.asarray(found[name].pixels, np.float32) for name in names], axis=-1)


def read_metadata(path: Path) -> dict[str, str]:
    """The string attributes of an EXR file, by their names.

    OpenEXR raises RuntimeError where the file is missing or broken.
    """
    OpenEXR = _openexr()
    with OpenEXR.File(str(path), header_only=True) as file:
        return {name: value for name, value in file.header().items() if isinstance(value, str)}


def read_checked(path: Path) -> np.ndarray:
    """All channels of an EXR file, as `read_all` has them; ValueError where they are not, bit by bit, as written."""
    try:
        # The library says what is wrong on stdout; before 3.5.3 it fails where there is none.
        with contextlib.redirect_stdout(io.StringIO()):
            image, wanted = read_all(path)[0], read_metadata(path).get(CHECKSUM)
    except (RuntimeError, ValueError):
        image, wanted = None, None
    # Files of other programs have none.
    if image is None or wanted not in (None, _checksum(image)):
        raise ValueError(f"'{path}' is broken")
    return image


def remove_leftovers(path: Path) -> None:
    """Remove what processes that were killed while they wrote `path` have left beside it."""
    path = Path(path)
    for leftover in path.parent.glob(f".{glob.escape(path.stem)}-????????{glob.escape(path.suffix)}"):
        leftover.unlink()


def replace_file(path: Path, content: str | bytes) -> None:
    """Write a file, whole or not at all; OSError, with its name, where that is not possible."""
    try:
        with _whole(Path(path)) as temporary:
            Path(temporary).write_bytes(content.encode() if isinstance(content, str) else content)
    except OSError as error:
        raise OSError(f"'{path}' could not be written: {error.strerror or error}") from None


def to_8bit(image: np.ndarray) -> np.ndarray:
    """round(255 clamp(x, 0, 1)); NaN becomes 0."""
    return np.rint(255 * np.clip(np.nan_to_num(image, nan=0.0), 0, 1)).astype(np.uint8)


def _write_exr(path: str, image: np.ndarray, metadata: Mapping[str, str], *names: str) -> None:
    OpenEXR = _openexr()
    names = names or tuple(CHANNELS[image.shape[2]])
    # Colours as they lie in memory: large pictures are not copied.
    usual = "".join(names) in CHANNELS.values()
    channels = (
        {"".join(names): np.ascontiguousarray(image)}
        if usual and len(names) > 2
        else {n: image[:, :, i].copy() for i, n in enumerate(names)}
    )
    # A file has its channels in the order of the alphabet.
    order = {} if usual else {ORDER: json.dumps(list(names))}
    # Compressing takes longer than rendering; the library's default is one thread.
    OpenEXR.set_global_thread_count(machine.cores())
    own = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, CHECKSUM: _checksum(image), **order}
    header = {**own, **metadata}
    with OpenEXR.File(header, channels) as file:
        file.write(path)
    # The library does not notice a full disk.
    with OpenEXR.File(path) as file:
        file.channels()


def _openexr():
    """The library, imported late; Ctrl-C meanwhile, which it turns into an error of its own, is Ctrl-C again."""
    try:
        import OpenEXR
    except ImportError as error:
        if isinstance(error.__cause__, KeyboardInterrupt):
            raise KeyboardInterrupt from None
        raise
    return OpenEXR


def _checksum(image: np.ndarray) -> str:
    return f"{zlib.crc32(np.ascontiguousarray(image).data):08x}"


def png(image: np.ndarray, *, channels: Sequence[str] | None = None, linear: bool = False) -> bytes:
    """The bytes of a PNG file of an image, (height, width, channels), as `write` writes it."""
    # Not `mitsuba.Bitmap`: this one needs no variant to be set.
    from mitsuba.mitsuba_ext import Bitmap, MemoryStream

    count = len(color_channels(channels)) if channels else image.shape[2]
    bytes_: np.ndarray = np.empty((*image.shape[:2], count), np.uint8)
    # Row by row: temporary arrays of a large picture would be several times its size.
    for row, values in zip(bytes_, image, strict=True):
        shown = _straight(color(values, channels))
        row[...] = to_8bit(shown if linear else _srgb_colors(shown))
    if count == 2:
        bytes_ = np.ascontiguousarray(bytes_[:, :, [0, 0, 0, 1]])
    stream = MemoryStream()
    Bitmap(bytes_).write(stream, Bitmap.FileFormat.PNG)
    return bytes(stream.raw_buffer())


def _write_png(path: str, image: np.ndarray, channels: Sequence[str], linear: bool) -> None:
    # By way of memory: the library does not notice a full disk.
    Path(path).write_bytes(png(image, channels=channels, linear=linear))


def srgb(colors: np.ndarray) -> np.ndarray:
    """The sRGB encoding of linear values, clamped to [0, 1], in an array of the same shape; NaN becomes 0.

    Source: IEC 61966-2-1.
    """
    colors = np.clip(np.nan_to_num(colors, nan=0.0), 0, 1)
    return np.where(colors <= 0.0031308, 12.92 * colors, 1.055 * colors ** (1 / 2.4) - 0.055)


def from_srgb(encoded: np.ndarray) -> np.ndarray:
    """The linear values that sRGB encodes as `encoded`, of 0 to 1."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def _straight(image: np.ndarray) -> np.ndarray:
    """Colours divided by their alpha, where it is not 0: films hold what a pixel adds to a picture, PNG its colour."""
    if image.shape[-1] in (1, 3):
        return image
    alpha = image[..., -1:]
    return np.concatenate([image[..., :-1] / np.where(alpha > 0, alpha, 1), alpha], axis=-1)


def _srgb_colors(image: np.ndarray) -> np.ndarray:
    alpha = 3 if image.shape[-1] > 2 else 1
    return np.concatenate([srgb(image[..., :alpha]), image[..., alpha:]], axis=-1)


def _sync_folder(folder: Path) -> None:
    """Make sure that a new name survives a power cut, where the system can."""
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


@contextlib.contextmanager
def _whole(path: Path, keep: bool = True) -> Iterator[str]:
    """A temporary file beside `path`, with its suffix, that becomes `path` if all goes well."""
    descriptor, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}-", suffix=path.suffix)
    os.close(descriptor)
    try:
        yield temporary
        if keep:
            with open(temporary, "rb+") as file:
                os.fsync(file.fileno())
            # As a new file of this user would have it, not private as mkstemp makes it.
            mask = os.umask(0)
            os.umask(mask)
            os.chmod(temporary, 0o666 & ~mask)
            os.replace(temporary, path)
            _sync_folder(path.parent)
    finally:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(temporary)
