"""Pictures of more samples than one kernel should or can have."""

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from helpers import SCENES
from phong_bsdf.scene import rendering
from phong_bsdf.tracing import camera


def lecture_scene(film, spp, sampler="independent"):
    """The mirror floor in 60 x 40 pixels."""
    loaded = mi.load_file(str(SCENES / "lecture/mirror-floor.xml"), width="60", height="40")
    sensor = {
        "type": "perspective",
        "to_world": mi.ScalarTransform4f().look_at([0, 1.6, 8], [0, -0.25, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 60, "height": 40, "rfilter": {"type": film}},
        "sampler": {"type": sampler, "sample_count": spp},
    }
    return loaded, mi.load_dict(sensor)


@pytest.mark.parametrize(("film", "spp", "bound"), [("box", 4, 0), ("gaussian", 4, 1e-6), ("gaussian", 1, 1e-6)])
def test_passes_show_the_same(film, spp, bound, monkeypatch):
    """More samples than are rendered at once: the same picture, and the share done after each pass."""
    loaded, sensor = lecture_scene(film, spp)
    whole = np.array(mi.render(loaded, sensor=sensor, spp=spp))
    monkeypatch.setattr(camera, "LANES", 1000)
    shares = []
    loaded.integrator().on_progress = shares.append
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        parts = np.array(mi.render(loaded, sensor=sensor, spp=spp))
        tracing = {kernel["hash"] for kernel in dr.kernel_history() if kernel.get("operation_count", 0) > 300}
    assert np.abs(parts - whole).max() <= bound
    assert (
        shares == sorted(shares) and len(shares) == math.ceil(60 * 40 * spp / (1000 // spp * spp)) and shares[-1] == 1
    )
    # One for the first pass, whose block is empty, and one for all others; the last is shorter.
    assert len(tracing) <= 2


def test_bands_are_one_kernel(monkeypatch):
    """The command renders large pictures in bands of rows, and compiles once for all of one height."""
    monkeypatch.setattr(rendering, "SAMPLES_PER_PASS", 500)
    loaded = rendering.load(SCENES / "lecture/mirror-floor.xml", {"width": "60", "height": "44"})
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        images = [image.copy() for image, _ in rendering._passes(loaded, loaded.sensor(1), 1, 0)]
        tracing = [k["hash"] for k in dr.kernel_history() if k.get("operation_count", 0) > 300]
    assert len(images) == len(tracing) == 6 and len(set(tracing[:-1])) == 1
    whole = np.array(mi.render(loaded.scene))
    assert np.mean(np.abs(images[-1] - whole).max(axis=2) > 1e-5) < 0.002


def test_passes_of_random_samples(monkeypatch):
    """Large pictures of other integrators: powers of two of samples, so that each run has the same bits; seeds of which
    no neighbour's picture has one."""
    monkeypatch.setattr(rendering, "SAMPLES_PER_PASS", 60 * 40 * 7)
    loaded = rendering.load(SCENES / "compare/balls.xml", {"width": "60", "height": "40"})
    render, made = rendering._render, []
    monkeypatch.setattr(rendering, "_render", lambda *args: made.append(args[2:]) or render(*args))
    for seed in (0, 1, 2):
        rendering.render(loaded, spp=16, seed=seed)
    assert [spp for spp, _ in made] == [4] * 12 and len({seed for _, seed in made}) == 12


def test_passes_draw_other_numbers(monkeypatch):
    """Random samples of two passes are different: a picture of few passes is as noisy as that of one."""
    sky, sensor = lecture_scene("box", 8)
    spread = {}
    for lanes in (2**26, 1000):
        monkeypatch.setattr(camera, "LANES", lanes)
        pictures = [np.array(mi.render(sky, sensor=sensor, spp=8, seed=seed)) for seed in range(6)]
        spread[lanes] = np.var(pictures, axis=0).mean()
        assert len({picture.tobytes() for picture in pictures}) == 6
    assert spread[1000] == pytest.approx(spread[2**26], rel=0.2)


def test_passes_can_be_interrupted(monkeypatch):
    """Ctrl-C is heard between two passes, and the next rendering is whole."""
    loaded, sensor = lecture_scene("gaussian", 1)
    whole = np.array(mi.render(loaded, sensor=sensor))

    def interrupt(share):
        raise KeyboardInterrupt

    monkeypatch.setattr(camera, "LANES", 1000)
    loaded.integrator().on_progress = interrupt
    with pytest.raises((KeyboardInterrupt, RuntimeError)):
        mi.render(loaded, sensor=sensor)
    loaded.integrator().on_progress = lambda share: None
    assert np.abs(np.array(mi.render(loaded, sensor=sensor)) - whole).max() < 1e-6


@pytest.mark.slow
def test_more_samples_than_a_kernel_has_lanes():
    """256 x 256 pixels of 65537 samples and a few: 2^32 lanes are too many for one kernel."""
    scene = mi.load_dict(
        {"type": "scene", "integrator": {"type": "whitted"}, "sky": {"type": "constant", "radiance": 0.25}}
    )
    film = {"type": "hdrfilm", "width": 256, "height": 256, "rfilter": {"type": "box"}}
    sensor = mi.load_dict({"type": "perspective", "film": film, "sampler": {"type": "independent"}})
    assert 256 * 256 * 257**2 > 2**32
    picture = np.array(mi.render(scene, sensor=sensor, spp=257**2))
    np.testing.assert_allclose(picture, 0.25, rtol=1e-4)
