"""Errors of images: the formulas, and what must never be hidden."""

import math
import sys

import numpy as np
import pytest

from phong_bsdf.pictures import metrics


@pytest.fixture
def pictures():
    """A picture of 8 x 6 pixels with values up to 2, and one with an error of 0.1 everywhere."""
    reference = np.random.default_rng(0).uniform(0, 2, (6, 8, 3))
    return reference + 0.1, reference


def test_formulas(pictures):
    """Mean squared error, relMSE with its epsilon of 0.01, largest error."""
    image, reference = pictures
    found = metrics.errors(image, reference)
    assert found.mse == pytest.approx(0.01)
    assert found.max_error == pytest.approx(0.1)
    assert found.relmse == pytest.approx(np.mean(0.01 / (reference**2 + 0.01)))
    assert metrics.energy(image) == pytest.approx(np.mean(reference) + 0.1)


def test_black_pixels_do_not_decide():
    """Where the reference is black, relMSE is 100 times the squared error, not infinite."""
    assert metrics.errors(np.full((2, 2, 1), 0.1), np.zeros((2, 2, 1))).relmse == pytest.approx(1)


def test_same_image(pictures):
    """An image has no error against itself."""
    found = metrics.errors(pictures[1], pictures[1])
    assert (found.mse, found.relmse, found.max_error, found.flip) == (0, 0, 0, 0)


@pytest.mark.parametrize("bad", (math.nan, math.inf, -math.inf))
@pytest.mark.parametrize("which", (0, 1))
def test_pixels_that_are_no_numbers(pictures, bad, which):
    """One such pixel, in the image or in the reference, is counted and leaves no error standing."""
    pictures[which][2, 3, 1] = bad
    assert metrics.nonfinite(pictures[which]) == 1
    found = metrics.errors(*pictures)
    assert all(math.isnan(error) for error in (found.mse, found.relmse, found.max_error))
    assert found.flip is None or math.isnan(found.flip)


def test_a_bad_pixel_counts_once(pictures):
    """Pixels are counted, not channels."""
    image = pictures[0]
    image[0, 0] = math.nan
    image[5, 7, 2] = math.inf
    assert metrics.nonfinite(image) == 2


@pytest.mark.parametrize(("channels", "colours"), ((1, 1), (2, 1), (3, 3), (4, 3)))
def test_alpha_is_no_colour(channels, colours):
    """Errors and energy are those of the colours."""
    image = np.random.default_rng(0).random((6, 8, channels))
    other = image.copy()
    other[..., colours:] += 1
    assert metrics.errors(image, other).mse == 0
    assert metrics.energy(other) == pytest.approx(image[..., :colours].mean())


@pytest.mark.parametrize("shape", ((6, 9, 3), (7, 8, 3), (6, 8, 1)))
def test_different_shapes(pictures, shape):
    """They are named, width first."""
    said = f"8 x 6 with 3 channels and {shape[1]} x {shape[0]} with {shape[2]} channel"
    with pytest.raises(ValueError, match=said):
        metrics.errors(pictures[0], np.zeros(shape))


def test_flip_grows_with_the_error(pictures):
    """Between 0 and 1, for grey pictures and values below 0, too."""
    pytest.importorskip("flip_evaluator")
    reference = pictures[1]
    found = [metrics.errors(reference * (1 + e), reference).flip for e in (0.01, 0.1, 1)]
    assert 0 < found[0] < found[1] < found[2] < 1
    grey = reference[..., :1]
    assert metrics.errors(grey * 1.1, grey).flip > 0
    assert metrics.errors(-grey, grey).flip > 0.1


def test_flip_does_not_depend_on_what_is_compared(pictures):
    """Its exposures are fixed: a brighter pixel elsewhere leaves the rest as it was."""
    pytest.importorskip("flip_evaluator")
    size = (64, 64, 3)
    reference, image = np.full(size, 0.2), np.full(size, 0.25)
    before = metrics.errors(image, reference).flip
    reference[0, 0] = image[0, 0] = 50
    # One pixel and its neighbourhood in 4096 are blended.
    assert metrics.errors(image, reference).flip == pytest.approx(before, rel=0.05)


def test_without_flip(pictures, monkeypatch):
    """Where `flip-evaluator` is not installed, FLIP is missing and the rest is as before."""
    monkeypatch.setitem(sys.modules, "flip_evaluator", None)
    found = metrics.errors(*pictures)
    assert found.flip is None and found.mse == pytest.approx(0.01)


def test_flip_is_quiet(pictures, capfd):
    """Nothing is printed between the lines of a table."""
    pytest.importorskip("flip_evaluator")
    metrics.errors(*pictures)
    assert capfd.readouterr() == ("", "")
