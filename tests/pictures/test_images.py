"""Files <-> arrays."""

import sys

import numpy as np
import OpenEXR
import pytest

from phong_bsdf.pictures import images


@pytest.fixture
def picture():
    """13 x 7 pixels from -0.5 to 2.5."""
    return np.random.default_rng(0).uniform(-0.5, 2.5, (7, 13, 3)).astype(np.float32)


@pytest.mark.parametrize("channels", (1, 3, 4))
def test_exr_keeps_every_bit(tmp_path, picture, channels):
    """Values far outside [0, 1], infinities and metadata included."""
    image = np.concatenate([picture, picture[..., :1]], axis=2)[..., :channels]
    image[0, 0, 0] = np.inf
    images.write(tmp_path / "a.exr", image, metadata={"scene": "ball.xml"})
    assert np.array_equal(images.read_exr(tmp_path / "a.exr"), image)
    with OpenEXR.File(str(tmp_path / "a.exr")) as file:
        assert file.header()["scene"] == "ball.xml"


def test_png_is_srgb_or_linear(tmp_path, picture):
    """Linear: round(255 clamp(x)); else of the sRGB curve."""
    from mitsuba.mitsuba_ext import Bitmap

    for linear in (False, True):
        images.write(tmp_path / "a.png", picture, linear=linear)
        x = np.clip(picture.astype(float), 0, 1)
        if not linear:
            x = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
        # Half a step, and the float32 in which the file's value was formed.
        assert np.abs(np.array(Bitmap(str(tmp_path / "a.png"))) - 255 * x).max() < 0.5001


def test_not_a_number_is_black_in_png():
    """8 bits cannot say NaN."""
    assert list(images.to_8bit(np.array([np.nan, np.inf, -np.inf, 0.5]))) == [0, 255, 0, 128]


def test_a_failed_write_leaves_the_old_file(tmp_path, picture, monkeypatch):
    """Whole or not at all, and nothing else in the folder."""
    images.write(tmp_path / "a.exr", picture)
    before = (tmp_path / "a.exr").read_bytes()

    def fail(path, *_):
        with open(path, "wb") as file:
            file.write(b"half")
        raise OSError("disk full")

    monkeypatch.setattr(images, "_write_exr", fail)
    with pytest.raises(OSError, match="disk full"):
        images.write(tmp_path / "a.exr", picture * 2)
    assert (tmp_path / "a.exr").read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.exr"]


def test_unwritable_paths_are_named_before_work_is_done(tmp_path):
    """`check_writable` says what is wrong, and leaves no trace when nothing is."""
    images.check_writable(tmp_path / "a.png")
    assert not list(tmp_path.iterdir())
    for path, message in (
        (tmp_path / "no/a.png", "No such file"),
        (tmp_path / "a.jpg", "must end in"),
        (tmp_path, "end in"),
    ):
        with pytest.raises(ValueError, match=message):
            images.check_writable(path)


def test_ctrl_c_while_the_library_is_imported(monkeypatch, tmp_path):
    """Is Ctrl-C, though the library makes an ImportError of it."""

    class Interrupted:
        def find_spec(self, name, *_):
            if name == "OpenEXR":
                raise ImportError("initialization failed") from KeyboardInterrupt()

    monkeypatch.delitem(sys.modules, "OpenEXR")
    monkeypatch.setattr(sys, "meta_path", [Interrupted(), *sys.meta_path])
    with pytest.raises(KeyboardInterrupt):
        images.read_exr(tmp_path / "a.exr")
