"""A picture in passes: which samples each has, and that nothing but the set of passes decides what comes out."""

import math
import os
import subprocess
import sys

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from helpers import ROOT
from phong_bsdf.pictures import parts
from phong_bsdf.pictures.store import Store
from phong_bsdf.progressive import folder as folders
from phong_bsdf.progressive import planning, running
from phong_bsdf.scene import rendering

# Each of them is quick, all of them are not.
pytestmark = pytest.mark.slow

GLOSSY, MIRRORS = ROOT / "scenes/compare/balls.xml", ROOT / "scenes/lecture/mirror-floor.xml"
SIZE = (40, 30)


def planned(scene=GLOSSY, *, size=SIZE, **options):
    loaded, subject = planning.load(scene, size=size)
    return loaded, planning.plan(loaded, subject, **options)


def with_sampler(tmp_path, plugin, integrator="path", more=""):
    """A scene whose film has another sampler."""
    path = tmp_path / f"{plugin}.xml"
    path.write_text(
        f'<scene version="3.0.0"><integrator type="{integrator}"/><sensor type="perspective">{more}<sampler '
        f'type="{plugin}"/><film type="hdrfilm"><rfilter type="box"/></film></sensor>'
        '<emitter type="point"/><shape type="sphere"><point name="center" x="0" y="0" z="4"/></shape></scene>'
    )
    return path


@pytest.fixture
def store(tmp_path):
    with Store(tmp_path / "passes").opened() as store:
        yield store


def images_of(loaded, plan, indices):
    return {index: running.render_pass(loaded, plan, index).image for index in indices}


# Samples ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pass_spp", [None, 1, 3, 4, 5, 64, 10**6])
@pytest.mark.parametrize("across", [1, 2, 3, 4, 6, 7, 8, 12])
def test_passes_of_a_grid_are_the_grid(across, pass_spp):
    """Each sample of the n x n grid is in one pass, and there is no other."""
    _, plan = planned(MIRRORS, spp=across**2, pass_spp=pass_spp)
    assert not plan.random and plan.grid == across and plan.total == across**2
    names = [name for index in range(plan.count) for name in plan.samples(index).names()]
    whole = list(parts.Samples(across**2, random=False).names())
    assert len(names) == len(whole) and set(names) == set(whole)
    # Powers of two, no more than was asked for.
    assert plan.spp & (plan.spp - 1) == 0 and plan.spp <= (pass_spp or across**2)


def test_first_passes_of_a_grid_are_spread():
    """Half of them do not see the picture from a corner of the pixel."""
    _, plan = planned(MIRRORS, spp=64, pass_spp=1)
    for count in (8, 16, 32, 48):
        places = np.array([next(plan.samples(index).names()) for index in range(count)], float)
        assert np.abs(places.mean(axis=0) - 0.5).max() < 0.1


@pytest.mark.parametrize(
    ("spp", "pass_spp", "size", "count"),
    [(64, 8, 8, 8), (100, 16, 16, 7), (5, 2, 2, 3), (64, 7, 4, 16), (3, 8, 2, 2), (1, None, 1, 1)],
)
def test_random_passes(spp, pass_spp, size, count):
    """Of powers of two of samples, each with its own seed; together as many as asked for, or up to a pass more."""
    _, plan = planned(spp=spp, pass_spp=pass_spp, seed=11)
    assert (plan.spp, plan.count, plan.random) == (size, count, True)
    seeds = {plan.samples(index).seed for index in range(plan.count)}
    assert len(seeds) == count and plan.samples(0).seed == 11


def test_no_pass_has_a_seed_of_another_picture():
    """Parts of seeds 1, 2, 3, ... that are themselves in passes, and in passes of passes where they are large."""
    _, plan = planned(spp=4096, pass_spp=1)
    seeds = [rendering.pass_seed(seed, done) for seed in range(300) for done in range(plan.total)]
    assert len(set(seeds)) == len(seeds)


@pytest.mark.parametrize(("sampler", "pass_spp", "size"), [("stratified", 8, 4), ("stratified", 16, 16),
                                                           ("multijitter", 8, 8), ("ldsampler", 5, 4)])  # fmt: skip
def test_samplers_that_round(tmp_path, sampler, pass_spp, size):
    """Passes have sizes that the sampler can make: else a pass would count for fewer samples than it has."""
    loaded, plan = planned(with_sampler(tmp_path, sampler), spp=64, pass_spp=pass_spp)
    assert (plan.spp, plan.asked, plan.count) == (size, size, 64 // size)
    mi.set_log_level(mi.LogLevel.Warn)
    running.render_pass(loaded, plan, 0)


def test_whitted_with_a_sampler(tmp_path):
    """Numbers of samples that are no squares are random, and so must be those of each pass."""
    loaded, plan = planned(with_sampler(tmp_path, "independent", "whitted"), spp=24, pass_spp=4)
    assert plan.random and plan.spp == 2 and plan.count == 12
    pictures = images_of(loaded, plan, (0, 1))
    assert not np.array_equal(pictures[0], pictures[1])


def test_whitted_with_a_lens(tmp_path):
    """The grid is fixed, the place on the lens is random: each pass has cells and a seed of its own."""
    lens = '<float name="aperture_radius" value="0.2"/><float name="focus_distance" value="4"/>'
    path = with_sampler(tmp_path, "independent", "whitted", lens)
    path.write_text(path.read_text().replace('type="perspective"', 'type="thinlens"'))
    _, plan = planned(path, spp=16, pass_spp=4)
    assert plan.random and plan.grid == 4
    assert len({plan.samples(i).seed for i in range(4)}) == len({plan.samples(i).shift for i in range(4)}) == 4


def test_default_size_of_passes():
    """Enough passes to tell the error, enough work in each to cost little, no more than minutes."""
    for size in ((16, 16), (512, 512), (4096, 4096), (16384, 16384)):
        for spp in (1, 16, 256, 65536):
            n = planning.default_pass_spp(size, spp)
            pixels = size[0] * size[1]
            assert 1 <= n <= max(1, spp // 4) and pixels * n <= 2**30
            assert spp < 4096 or pixels * n >= 2**22


def test_plan_travels_as_json():
    """To another machine and back."""
    _, plan = planned(spp=16)
    assert planning.from_json(plan.json()) == plan
    with pytest.raises((KeyError, TypeError, ValueError)):
        planning.from_json('{"subject": {"defines": []}}')


# Pictures -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("variant", ["llvm_ad_rgb", "scalar_rgb"])
@pytest.mark.parametrize("spp", [16, 36, 9])
def test_passes_of_a_grid_make_its_picture(variant, spp):
    """That of `whitted` without passes, up to the rounding of sums."""
    mi.set_variant(variant)
    loaded, plan = planned(MIRRORS, size=(6, 4), spp=spp, pass_spp=4)
    pictures = images_of(loaded, plan, range(plan.count))
    mean = sum(picture.astype(float) for picture in pictures.values()) / plan.count
    whole = rendering.render(loaded, spp=spp).image
    # Sums of 36 float32 numbers below 2.
    np.testing.assert_allclose(mean, whole, atol=1e-6)
    assert not np.array_equal(pictures[0], pictures[1])
    assert np.array_equal(rendering.render(loaded, spp=spp).image, whole), "the part of the grid stays set"


def test_passes_share_a_kernel():
    """Parts of the grid, and seeds, are no constants of it."""
    for scene, spp in ((MIRRORS, 36), (GLOSSY, 8)):
        loaded, plan = planned(scene, spp=spp, pass_spp=4)
        compiled = [running.render_pass(loaded, plan, index).compiled for index in range(plan.count)]
        assert not any(compiled[1:])


@pytest.mark.parametrize("scene", [GLOSSY, MIRRORS])
def test_order_does_not_matter(store, scene):
    """Whoever renders passes backwards, with other threads and a scene loaded anew, makes the same bits."""
    loaded, plan = planned(scene, spp=64, pass_spp=8)
    *_, straight = running.render(loaded, folders.claim(store, plan))
    with Store(store.folder.parent / "other").opened() as other:
        folder = folders.claim(other, plan)
        threads = dr.thread_count()
        for index in reversed(range(plan.count)):
            dr.set_thread_count(2 + index % 3)
            again, _ = planning.load(scene, size=SIZE)
            folder.write(index, running.render_pass(again, plan, index).image)
        dr.set_thread_count(threads)
        assert np.array_equal(folder.mean().image(), straight.image())


CHILD = """
import sys, phong_bsdf, mitsuba as mi
mi.set_variant("llvm_ad_rgb")
import numpy as np
from phong_bsdf.progressive import planning, running
plan = planning.from_json(sys.stdin.read())
loaded, subject = planning.load(sys.argv[1], dict(plan.subject.defines), size=plan.subject.size)
running.check_subject(plan, subject)
np.save(sys.argv[2], running.render_pass(loaded, plan, 5).image)
"""


def test_another_process_makes_the_same_pass(tmp_path):
    """From the plan as text, and the scene."""
    loaded, plan = planned(spp=64, pass_spp=8)
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    subprocess.run(
        [sys.executable, "-c", CHILD, str(GLOSSY), "pass.npy"],
        input=plan.json(), text=True, check=True, cwd=tmp_path, env=env,
    )  # fmt: skip
    assert np.array_equal(np.load(tmp_path / "pass.npy"), running.render_pass(loaded, plan, 5).image)


def test_another_scene_is_not_rendered():
    """A worker with another file under the same name says so."""
    _, plan = planned(spp=16)
    _, subject = planning.load(MIRRORS, size=SIZE)
    with pytest.raises(ValueError, match=r"scene 'mirror-floor\.xml', not 'balls\.xml'"):
        running.check_subject(plan, subject)


@pytest.mark.slow
def test_error_is_right():
    """The relative standard error that is told is the distance from a picture of 32 times as many samples."""
    loaded, plan = planned(spp=2048 + 64, pass_spp=8, seed=3)
    mean, truth = parts.WeightedMean(), parts.WeightedMean()
    for index in range(plan.count):
        (mean if index < 8 else truth).add(running.render_pass(loaded, plan, index).image, 8)
    distance = mean.image().astype(float) - truth.image()
    error = math.sqrt(np.mean(distance**2)) / truth.image().mean()
    # A few bright pixels have most of the noise, so eight passes tell it to a fifth or so.
    assert mean.relative_error() == pytest.approx(error, rel=0.3)


# On disk ------------------------------------------------------------------------------------------------------------


def test_only_what_is_missing_is_rendered(store, monkeypatch):
    """And the picture so far comes after each pass, in order, whether it was there or not."""
    loaded, plan = planned(spp=16, pass_spp=2)
    folder = folders.claim(store, plan)
    for index in (1, 4):
        folder.write(index, running.render_pass(loaded, plan, index).image)
    rendered, render_pass = [], running.render_pass
    monkeypatch.setattr(running, "render_pass", lambda *a: rendered.append(a[2]) or render_pass(*a))
    counts = [mean.count for mean in running.render(loaded, folder)]
    assert (rendered, counts) == ([0, 2, 3, 5, 6, 7], [1, 2, 3, 4, 5, 6, 7, 8])


def test_folder_knows_what_it_holds(store):
    """Longer and shorter pictures share their passes; others are refused, with what differs."""
    _, plan = planned(spp=16, pass_spp=4)
    folders.claim(store, plan)
    _, longer = planned(spp=64, pass_spp=4)
    folders.claim(store, longer)
    folders.claim(store, plan)
    assert folders.stored(store) == longer
    for said, options in {
        "seed 1, not 0": {"seed": 1},
        "passes of 8 spp, not 4": {"pass_spp": 8},
        "size 20 x 10, not 40 x 30": {"size": (20, 10)},
    }.items():
        _, other = planned(**{"spp": 16, "pass_spp": 4, **options})
        with pytest.raises(ValueError, match=said):
            folders.claim(store, other)
    assert folders.stored(store) == longer


def test_grids_cannot_be_refined(store):
    """A finer grid is made of other samples."""
    folders.claim(store, planned(MIRRORS, spp=16, pass_spp=4)[1])
    with pytest.raises(ValueError, match="a grid of 8 x 8 samples, not a grid of 4 x 4 samples"):
        folders.claim(store, planned(MIRRORS, spp=64, pass_spp=4)[1])


def test_a_pass_of_another_picture_is_noticed(store):
    """A file that somebody copied into the folder, or under another number."""
    loaded, plan = planned(spp=8, pass_spp=2)
    folder = folders.claim(store, plan)
    folder.write(0, running.render_pass(loaded, plan, 0).image)
    folder.path(1).write_bytes(folder.path(0).read_bytes())
    with pytest.raises(ValueError, match="is not pass 1 of this picture"):
        folder.read(1)
    named = []
    *_, mean = running.render(loaded, folder, on_broken=named.append)
    assert named == [f"'{folder.path(1)}' is not pass 1 of this picture"] and mean.count == 4
    assert np.array_equal(folder.mean().image(), mean.image())


def test_a_lost_plan(store):
    """Passes without their plan are not taken for anything."""
    loaded, plan = planned(spp=8, pass_spp=2)
    folders.claim(store, plan).write(0, running.render_pass(loaded, plan, 0).image)
    (store.folder / "picture.json").write_text("{}")
    with pytest.raises(ValueError, match=r"picture\.json' is nothing that this version wrote"):
        folders.stored(store)
    (store.folder / "picture.json").unlink()
    with pytest.raises(ValueError, match=r"picture\.json is gone"):
        folders.stored(store)


def test_folder_of_a_study_is_refused(store):
    """Pictures and studies do not mix."""
    (store.folder / "run.json").write_text("{}")
    with pytest.raises(ValueError, match="holds measurements of a scene already"):
        folders.stored(store)
