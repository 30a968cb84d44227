"""Image files <-> arrays. Linear EXR through the OpenEXR package, 8-bit PNG through Mitsuba's bitmap.

A file is written under a temporary name and then renamed: it appears whole or not at all.
Mitsuba's own EXR routines are avoided: they wait for ever where Dr.Jit has no free thread.
"""

import contextlib
import glob
import io
import os
import tempfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

FORMATS = (".exr", ".png")
CHANNELS = {1: "Y", 2: "YA", 3: "RGB", 4: "RGBA"}
CHECKSUM = "crc32"


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


def write(path: Path, image: np.ndarray, *, linear: bool = False, metadata: Mapping[str, str] | None = None) -> None:
    """Write a linear image of shape (height, width, channels), channels Y, YA, RGB or RGBA.

    EXR holds it as it is (32-bit float), with `metadata` and a checksum as string attributes. PNG holds
    round(255 clamp(x, 0, 1)) of x = image if `linear`, else of its sRGB encoding. Raises OSError
    where the file cannot be written in full.
    """
    path = Path(path)
    image = np.asarray(image, np.float32)
    if image.shape[2] not in CHANNELS:
        raise ValueError(f"'{path}': an image of {image.shape[2]} channels cannot be written, only Y, YA, RGB or RGBA")
    with _whole(path) as temporary:
        try:
            if path.suffix.lower() == ".exr":
                _write_exr(temporary, image, metadata or {})
            else:
                _write_png(temporary, image, linear)
        except RuntimeError as error:
            # The library names the temporary file first, then the reason.
            reason = str(error).rsplit('". ', 1)[-1].rstrip(".")
            raise OSError(f"'{path}' could not be written: {reason}") from None


def read_exr(path: Path) -> np.ndarray:
    """The image in an EXR file, shape (height, width, channels), float32, channels in the order Y or R, G, B, A."""
    OpenEXR = _openexr()
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = file.channels()
        names = [name for name in ("Y", "R", "G", "B", "A") if name in channels]
        return np.stack([np.asarray(channels[name].pixels, np.float32) for name in names], axis=-1)


def read_metadata(path: Path) -> dict[str, str]:
    """The string attributes of an EXR file."""
    OpenEXR = _openexr()
    with OpenEXR.File(str(path), header_only=True) as file:
        return {name: value for name, value in file.header().items() if isinstance(value, str)}


def read_checked(path: Path) -> np.ndarray:
    """The image in an EXR file, as `read_exr` has it; ValueError where it is not, bit by bit, what `write` wrote."""
    try:
        # The library says what is wrong on stdout; before 3.5.3 it fails where there is none.
        with contextlib.redirect_stdout(io.StringIO()):
            image, wanted = read_exr(path), read_metadata(path).get(CHECKSUM)
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


def _write_exr(path: str, image: np.ndarray, metadata: Mapping[str, str]) -> None:
    OpenEXR = _openexr()
    names = CHANNELS[image.shape[2]]
    # Three and four channels as they lie in memory: large pictures are not copied.
    together = len(names) > 2
    channels = (
        {names: np.ascontiguousarray(image)} if together else {n: image[:, :, i].copy() for i, n in enumerate(names)}
    )
    # Compressing takes longer than rendering; the library's default is one thread.
    OpenEXR.set_global_thread_count(os.cpu_count() or 1)
    own = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, CHECKSUM: _checksum(image)}
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


def png(image: np.ndarray, *, linear: bool = False) -> bytes:
    """The bytes of a PNG file of an image, (height, width, 1 to 4 channels), as `write` writes it."""
    # Not `mitsuba.Bitmap`: this one needs no variant to be set.
    from mitsuba.mitsuba_ext import Bitmap, MemoryStream

    bytes_ = np.empty(image.shape, np.uint8)
    # Row by row: temporary arrays of a large picture would be several times its size.
    for row, values in zip(bytes_, image, strict=True):
        row[:] = to_8bit(values if linear else _srgb_colors(values))
    if image.shape[2] == 2:
        bytes_ = np.ascontiguousarray(bytes_[:, :, [0, 0, 0, 1]])
    stream = MemoryStream()
    Bitmap(bytes_).write(stream, Bitmap.FileFormat.PNG)
    return bytes(stream.raw_buffer())


def _write_png(path: str, image: np.ndarray, linear: bool) -> None:
    # By way of memory: the library does not notice a full disk.
    Path(path).write_bytes(png(image, linear=linear))


def srgb(colors: np.ndarray) -> np.ndarray:
    """The sRGB encoding of linear values, clamped to [0, 1]; NaN becomes 0."""
    colors = np.clip(np.nan_to_num(colors, nan=0.0), 0, 1)
    return np.where(colors <= 0.0031308, 12.92 * colors, 1.055 * colors ** (1 / 2.4) - 0.055)


def from_srgb(encoded: np.ndarray) -> np.ndarray:
    """The linear values that sRGB encodes as `encoded`, of 0 to 1."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


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
