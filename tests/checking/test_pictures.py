"""Whatever is handed in: the right numbers, or a sentence that says what is wrong with the file."""

import io
import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from phong_bsdf.checking.pictures import Encoding, PictureError, read
from phong_bsdf.pictures import images


@pytest.fixture
def pixels():
    """9 x 7 pixels of 8 bits."""
    return np.random.default_rng(0).integers(0, 256, (7, 9, 3), np.uint8)


@pytest.mark.parametrize("name", ("a.png", "a.bmp", "a.ppm", "picture without suffix", "a.jpg as.png"))
def test_eight_bits(tmp_path, pixels, name):
    """The numbers of the file, whatever it is called."""
    Image.fromarray(pixels).save(tmp_path / name, "BMP" if "bmp" in name else "PPM" if "ppm" in name else "PNG")
    picture = read(tmp_path / name, linear=True)
    assert np.array_equal(picture.values, pixels / 255)
    assert picture.encoding == Encoding(1 / 255, srgb=False) and picture.notes == ()
    assert read(tmp_path / name).encoding.srgb


@pytest.mark.parametrize("channels", (1, 3, 4))
def test_sixteen_bits(tmp_path, channels):
    """All 16 of them, of grey, RGB and RGBA."""
    from mitsuba.mitsuba_ext import Bitmap

    deep = np.random.default_rng(0).integers(0, 65536, (7, 9, channels), np.uint16)
    Bitmap(deep).write(str(tmp_path / "a.png"))
    picture = read(tmp_path / "a.png")
    assert np.array_equal(picture.values, np.broadcast_to(deep[..., : min(channels, 3)], (7, 9, 3)) / 65535)
    assert picture.encoding.step == 1 / 65535


def test_palette_grey_and_one_bit(tmp_path, pixels):
    """What looks the same is the same: a palette, a grey picture, black and white."""
    few = pixels // 128 * 255
    Image.fromarray(few).convert("P", palette=Image.Palette.ADAPTIVE).save(tmp_path / "palette.png")
    palette = read(tmp_path / "palette.png")
    assert np.array_equal(palette.values, few / 255) and "256 colours" in palette.notes[0]
    Image.fromarray(pixels[..., 0]).save(tmp_path / "grey.png")
    assert np.array_equal(read(tmp_path / "grey.png").values, np.repeat(pixels[..., :1], 3, axis=2) / 255)
    Image.fromarray(few[..., 0]).convert("1").save(tmp_path / "bit.png")
    assert np.array_equal(read(tmp_path / "bit.png").values[..., 1], few[..., 0] / 255)


def test_alpha(tmp_path, pixels):
    """Opaque, it is nothing; else the colours are compared as they are stored, and that is said."""
    for alpha, notes in ((255, 0), (100, 1)):
        Image.fromarray(np.dstack([pixels, np.full((7, 9), alpha, np.uint8)])).save(tmp_path / "a.png")
        picture = read(tmp_path / "a.png")
        assert np.array_equal(picture.values, pixels / 255) and len(picture.notes) == notes
    transparent = Image.fromarray(pixels // 128 * 255).convert("P", palette=Image.Palette.ADAPTIVE)
    transparent.save(tmp_path / "a.png", transparency=0)
    assert "transparent" in read(tmp_path / "a.png").notes[0]


def test_exr_and_arrays(tmp_path):
    """Linear, of any range; grey is three equal channels."""
    image = np.random.default_rng(0).uniform(0, 3, (7, 9, 3)).astype(np.float32)
    images.write(tmp_path / "a.exr", image)
    np.save(tmp_path / "a.npy", image)
    np.save(tmp_path / "grey.npy", image[..., 0])
    for name in ("a.exr", "a.npy"):
        picture = read(tmp_path / name)
        assert np.array_equal(picture.values, image) and picture.encoding == Encoding()
    assert np.array_equal(read(tmp_path / "grey.npy").values[..., 2], image[..., 0])
    np.save(tmp_path / "b.npy", np.full((7, 9, 3), 255, np.uint8))
    assert read(tmp_path / "b.npy").encoding.srgb and read(tmp_path / "b.npy").values.max() == 1


@pytest.mark.parametrize("quality", (50, 75, 95))
@pytest.mark.parametrize("mode", ("RGB", "L"))
def test_jpeg_may_lose_what_jpeg_loses(tmp_path, quality, mode):
    """The same picture through JPEG is within what the encoding says it can lose; another is not."""
    y, x = np.mgrid[0:60, 0:80] / 80
    image = np.stack([x, y, 0.5 + 0 * x], axis=-1) if mode == "RGB" else np.repeat(x[..., None], 3, axis=2)
    image = np.where(((x - 0.5) ** 2 + (y - 0.4) ** 2 < 0.05)[..., None], 0.9 * image, 0.2)
    Image.fromarray(images.to_8bit(image)).convert(mode).save(tmp_path / "a.jpg", quality=quality)
    picture = read(tmp_path / "a.jpg", linear=True)
    expected = picture.encoding.encode(image)
    allowed = picture.encoding.loss(expected) + 1 / 255
    assert np.all(np.abs(picture.values - expected) <= allowed)
    # Half a step, one step of tolerance, and where nothing is there to be lost at most 1.5 more.
    assert allowed.min() < 3.1 / 255 and np.any(np.abs(picture.values - 0.9 * expected) > allowed)


def test_encodings():
    """Linear and sRGB, clamped where integers are; decoding undoes it."""
    x = np.array([-0.5, 0.0, 0.001, 0.2, 1.0, 3.0])
    assert np.array_equal(Encoding().encode(x), x)
    assert np.array_equal(Encoding(1 / 255).encode(x), np.clip(x, 0, 1))
    srgb = Encoding(1 / 255, srgb=True)
    assert srgb.encode(np.array([0.2]))[0] == pytest.approx(0.484529)
    assert srgb.decode(srgb.encode(x)) == pytest.approx(np.clip(x, 0, 1))


def png_header(width, height):
    """The beginning of a PNG file that claims to be of this size, with next to no data."""

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    data = chunk(b"IDAT", zlib.compress(bytes(1000)))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + data + chunk(b"IEND", b"")


def encoded(pixels, kind, **options):
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, kind, **options)
    return stream.getvalue()


def bad_files():
    pixels = np.random.default_rng(0).integers(0, 256, (64, 64, 3), np.uint8)
    png, jpeg = encoded(pixels, "PNG"), encoded(pixels, "JPEG")
    stream = io.BytesIO()
    np.save(stream, np.array(["a"], object), allow_pickle=True)
    pickled = stream.getvalue()
    stream = io.BytesIO()
    Image.fromarray(pixels).convert("CMYK").save(stream, "JPEG")
    return {
        "empty": (b"", "the file is empty"),
        "text": (b"I could not finish in time.", "this is no picture"),
        "gif": (encoded(pixels[..., 0], "GIF"), "this is no picture"),
        "truncated png": (png[: len(png) // 2], "damaged"),
        "truncated jpeg": (jpeg[: len(jpeg) // 2], "damaged"),
        "broken png": (png[:60] + bytes(20) + png[80:], "damaged"),
        "header only": (png[:20], "(damaged|no picture)"),
        "cmyk": (stream.getvalue(), "CMYK, for print; save it as RGB"),
        "bomb": (png_header(60000, 60000), "(too large|too many)"),
        "large": (png_header(17000, 16000), "(too large|too many)"),
        "exr": (b"\x76\x2f\x31\x01" + bytes(100), "EXR file cannot be read"),
        "pickle": (pickled, "array cannot be read"),
        "vector": (b"\x93NUMPY\x01\x00", "array cannot be read"),
    }


@pytest.mark.parametrize("what", list(bad_files()))
def test_bad_files(tmp_path, what):
    """One sentence, which names the file."""
    data, said = bad_files()[what]
    (tmp_path / "student.png").write_bytes(data)
    with pytest.raises(PictureError, match=said) as error:
        read(tmp_path / "student.png")
    assert "student.png" in str(error.value) and "\n" not in str(error.value)


def test_paths_that_are_no_file(tmp_path):
    """Nothing there, and a folder."""
    with pytest.raises(PictureError, match="there is no such file"):
        read(tmp_path / "a.png")
    with pytest.raises(PictureError, match="this is a folder"):
        read(tmp_path)


def test_size_is_checked_before_anything_is_decoded(tmp_path):
    """A file that claims to be large costs nothing, and the sentence has both sizes."""
    (tmp_path / "a.png").write_bytes(png_header(12000, 12000))
    with pytest.raises(PictureError, match="is 12000 x 12000 pixels and should be 9 x 7"):
        read(tmp_path / "a.png", size=(9, 7))
    images.write(tmp_path / "a.exr", np.zeros((3, 4, 3)))
    with pytest.raises(PictureError, match="is 4 x 3 pixels and should be 9 x 7"):
        read(tmp_path / "a.exr", size=(9, 7))
    np.save(tmp_path / "a.npy", np.zeros((3, 4, 3)))
    with pytest.raises(PictureError, match="is 4 x 3 pixels"):
        read(tmp_path / "a.npy", size=(9, 7))
    np.save(tmp_path / "a.npy", np.zeros((3, 4, 3), complex))
    with pytest.raises(PictureError, match="is no picture"):
        read(tmp_path / "a.npy")
    np.save(tmp_path / "a.npy", np.zeros((3, 4, 7)))
    with pytest.raises(PictureError, match="7 channels"):
        read(tmp_path / "a.npy")
