"""Is a picture right: pixel by pixel without noise, by statistics with it."""

import mitsuba as mi
import numpy as np
import pytest

from phong_bsdf.checking import verdict


@pytest.fixture
def picture():
    """40 x 30 pixels from 0.1 to 2, smooth but for an edge: the right half is brighter by 1."""
    y, x = np.mgrid[0:30, 0:40] / 40
    image = np.stack([0.1 + x * 0.5, 0.2 + y * 0.5, 0.3 + 0 * x], axis=-1)
    image[:, 20:] += 1
    return image.astype(np.float32)


def test_the_same_picture_is_right(picture):
    """Without any tolerance."""
    assert verdict.compare(picture, picture).passed


@pytest.mark.parametrize(("limits", "error"), (({"absolute": 0.01}, 0.01), ({"relative": 0.01}, 0.003)))
def test_tolerances(picture, limits, error):
    """An error just below the limit is right, one just above is wrong."""
    for factor, passed in ((0.98, True), (1.02, False)):
        image = picture.copy()
        image[7, 9, 2] = 0.3 + factor * error
        found = verdict.compare(image, picture, **limits)
        assert found.passed == passed
        assert np.argwhere(found.wrong).tolist() == ([] if passed else [[7, 9]])


def test_words_name_the_worst_pixel(picture):
    """Where, what, instead of what, and how much of the picture."""
    image = picture.copy()
    image[3, 4] = 0.7, 0.8, 0.9
    image[5, 6, 2] += 0.1
    words = verdict.compare(image, picture, absolute=0.01).words
    assert "2 of 1200 pixels are off (0.167 %)" in words
    assert "row 3, column 4: 0.7, 0.8, 0.9 instead of 0.15, 0.2375, 0.3" in words


def test_brightness_is_told(picture):
    """That all of it is too bright is the first hint at a mistake."""
    assert "On the whole it is 5 % brighter." in verdict.compare(picture * 1.05, picture).words
    assert "On the whole it is 5 % darker." in verdict.compare(picture * 0.95, picture).words
    assert "On the whole it is 99 % darker." in verdict.compare(picture * 0.0051, picture).words
    assert "On the whole it is black." in verdict.compare(picture * 0, picture).words
    assert "On the whole it is 3 times as bright." in verdict.compare(picture * 3, picture).words


def test_ulps(picture):
    """Steps of float32 are counted, also across 0."""
    up = np.nextafter(np.nextafter(picture, np.float32(9)), np.float32(9))
    assert verdict.compare(up, picture, ulps=2).passed
    assert not verdict.compare(up, picture, ulps=1).passed
    zero, tiny = np.zeros((1, 1, 1), np.float32), np.full((1, 1, 1), 1e-45, np.float32)
    assert verdict.compare(-tiny, tiny, ulps=2).passed and not verdict.compare(-tiny, tiny, ulps=1).passed
    assert verdict.compare(-zero, zero, ulps=0).passed


def test_edges_are_forgiven_up_to_a_share(picture):
    """Where the picture changes, as far as there are few such pixels; nothing else is forgiven."""
    image = picture.copy()
    image[:10, 19] = picture[:10, 20]
    limits = {"absolute": 1e-3}
    assert not verdict.compare(image, picture, **limits).passed
    assert not verdict.compare(image, picture, edges=9 / 1200, **limits).passed
    found = verdict.compare(image, picture, edges=10 / 1200, **limits)
    assert found.passed and "10 pixels at edges are off" in found.words
    image[20, 5] = 1.0
    found = verdict.compare(image, picture, edges=0.5, **limits)
    assert np.argwhere(found.wrong).tolist() == [[20, 5]]


@pytest.mark.parametrize("bad", (np.nan, np.inf))
def test_not_finite_fails_first(picture, bad):
    """Whatever the tolerance, in either picture."""
    image = picture.copy()
    image[4, 5, 1] = bad
    found = verdict.compare(image, picture, absolute=np.inf, edges=1.0)
    assert not found.passed and "1 pixel of the picture is not finite, first at row 4, column 5" in found.words
    assert "expected picture" in verdict.compare(picture, image, absolute=np.inf).words


def test_shapes(picture):
    """Size and channels must agree."""
    with pytest.raises(ValueError, match="40 x 30 with 3 channels and 39 x 30 with 3 channels"):
        verdict.compare(picture, picture[:, 1:])
    with pytest.raises(ValueError, match="40 x 30 with 1 channel"):
        verdict.compare(picture[..., :1], picture)


# With noise -------------------------------------------------------------------------------------------------


def noisy(rng, scale=1.0, passes=16, shape=(70, 50, 3)):
    """Passes of a picture that is a ramp from 0.2 to 1.2, with exponential noise as large as itself."""
    ramp = np.linspace(0.2, 1.2, shape[1])[None, :, None] * np.ones(shape)
    return verdict.sample(scale * ramp * rng.exponential(size=(passes, *shape)))


def test_means_and_variances():
    """Those of the passes' tiles, whole or cut off at the border."""
    images = np.random.default_rng(0).random((5, 20, 40, 3))
    found = verdict.sample(iter(images))
    assert found.mean == pytest.approx(images.mean(axis=0))
    tiles = np.stack([verdict.tile_means(image) for image in images])
    assert tiles[2, 1, 2] == pytest.approx(images[2, 16:, 32:].mean(axis=(0, 1)))
    assert found.variance == pytest.approx(tiles.var(axis=0, ddof=1)) and found.passes == 5


def test_noise_is_no_difference():
    """Of 200 pairs of right pictures at most six are called different, at a false alarm rate of 1 % (two expected)."""
    rng = np.random.default_rng(1)
    alarms = [not verdict.compare_noisy(noisy(rng), noisy(rng)).passed for _ in range(200)]
    assert sum(alarms) <= 6


def test_false_alarms_come_at_the_rate_that_is_asked_for():
    """With alpha = 0.2, between 10 and 32 % of 100 pairs: three standard deviations."""
    rng = np.random.default_rng(2)
    alarms = [not verdict.compare_noisy(noisy(rng), noisy(rng), alpha=0.2).passed for _ in range(100)]
    assert 0.1 <= np.mean(alarms) <= 0.32


def test_the_whole_shows_what_no_part_does():
    """2 % of a picture of 64 tiles, of which each scatters by that much."""
    rng = np.random.default_rng(3)
    found = verdict.compare_noisy(noisy(rng, 1.02, shape=(128, 128, 1)), noisy(rng, passes=64, shape=(128, 128, 1)))
    assert not found.passed and "as a whole" in found.words and found.wrong.all()


def test_what_does_not_scatter_may_not_differ():
    """Black stays black, and a constant may round, no more."""
    flat = np.full((4, 20, 20, 3), 0.5)
    reference = verdict.sample(flat)
    assert verdict.compare_noisy(verdict.sample(flat * (1 + 1e-6)), reference).passed
    found = verdict.compare_noisy(verdict.sample(flat * 1.001), reference)
    assert not found.passed and "4 of 4 tiles" in found.words


def test_one_pass_has_no_scatter():
    """Said so, before anything is divided by zero."""
    with pytest.raises(ValueError, match="at least 2 passes, got 1"):
        verdict.sample(np.zeros((1, 4, 4, 3)))


def test_noise_with_a_hole(picture):
    """A NaN in one of the passes fails."""
    passes = np.stack([picture] * 3)
    passes[1, 2, 3] = np.nan
    assert (
        "not finite, first at row 2, column 3"
        in verdict.compare_noisy(verdict.sample(passes), verdict.sample(passes[[0, 2]])).words
    )


@pytest.mark.slow
def test_one_percent_is_found_on_a_path_traced_scene():
    """The Cornell box, 64 x 64, 16 passes of 16 samples against 64: 12 of 12 pictures 1 % too bright are found, 0 of 12
    right ones."""
    scene = mi.cornell_box()
    scene["sensor"]["film"]["width"] = scene["sensor"]["film"]["height"] = 64
    scene = mi.load_dict(scene)
    seeds = iter(range(10000))

    def run(passes):
        return np.stack([np.array(mi.render(scene, spp=16, seed=next(seeds))) for _ in range(passes)])

    reference = verdict.sample(run(64))
    runs = [run(16) for _ in range(12)]
    assert all(verdict.compare_noisy(verdict.sample(passes), reference).passed for passes in runs)
    assert not any(verdict.compare_noisy(verdict.sample(1.01 * passes), reference).passed for passes in runs)
