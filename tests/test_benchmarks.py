"""The benchmarks run and say what they claim to; how fast anything is, they leave to `make bench`."""

import importlib
import json
import math
import re
import shutil
from dataclasses import replace
from unittest import mock

import phong_bsdf  # noqa: F401

import drjit as dr  # isort: skip
import mitsuba as mi
import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks import __main__ as command
from benchmarks import measure, rays, scenes, tables, targets
from helpers import ROOT

DOCS = ROOT / "docs"

MEASURED = {}


def quick(name):
    """Records of a quick run, measured once."""
    if name not in MEASURED:
        MEASURED[name] = importlib.import_module(f"benchmarks.{name}").records(measure.Plan(quick=True))
    return MEASURED[name]


def a_record(**fields):
    return replace(measure.record("floor", "lecture", "whitted", "time", [1, 2, 4], "s", 64), **fields)


# What they are made of ------------------------------------------------------------------------------


def test_rounds_are_interleaved():
    """Every task runs in every round, forwards and backwards in turn; those that warm up are not counted."""
    order = []
    tasks = {"a": lambda: order.append("a"), "b": lambda: order.append("b")}
    times = measure.interleaved(tasks, 3, warmup=1)
    assert "".join(order) == "baabbaab"
    assert {name: len(found) for name, found in times.items()} == {"a": 3, "b": 3}


def test_ratios_are_of_one_round():
    """A ratio compares times of the same round, so that what slows a whole round down cancels."""
    found = measure.compared("floor", "lecture", {"a": [1, 10, 100], "b": [2, 100, 150]}, "a")
    ratio = next(row for row in found if row.quantity == "time / a")
    assert (ratio.task, ratio.low, ratio.median, ratio.high) == ("b", 1.75, 2, 6)


def test_exponent_is_that_of_the_larger_half():
    """A constant that matters for small sizes only does not bend the fitted exponent."""
    x = [1, 10, 100, 1000, 1e4, 1e5]
    assert measure.slope(x, [50 + v**2 for v in x]) == pytest.approx(2, abs=1e-4)


def test_kernels_are_counted():
    """The kernels of a task: operations, launches, and that the second time nothing is compiled."""
    scene = scenes.lecture(8)
    mi.render(scene)
    again = measure.kernels(lambda: mi.render(scene))
    assert again.launches == 1 and again.compiled == 0 and again.compile_seconds < 0.1
    assert 100 < again.operations < 10_000


def test_fresh_process_has_an_empty_kernel_cache():
    """Two fresh processes compile the same scene, each for itself."""
    for _ in range(2):
        with measure.fresh_process("llvm_ad_rgb") as run:
            assert run(_compiled) > 0


def _compiled():
    scene = scenes.lit(8)
    return measure.kernels(lambda: mi.render(scene)).compiled


def test_rays_are_counted():
    """A wall that fills the picture under two lights, one behind it: a camera ray and a shadow ray a pixel."""
    scene = mi.load_dict({
        "type": "scene",
        "integrator": {"type": "whitted"},
        "sensor": scenes.look(16, [0, 0, 5], [0, 0, 0]),
        "wall": {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(50), "bsdf": {"type": "phong"}},
        "before": {"type": "point", "position": [0, 0, 3]},
        "behind": {"type": "point", "position": [0, 0, -3]},
    })  # fmt: skip
    for task in (lambda: mi.render(scene), rays.Floor(scene, 16, 10)):
        counts = rays.counted(task)
        assert counts["ray_intersect"] + counts["ray_intersect_preliminary"] == 256
        assert counts["ray_test"] == 256


@pytest.mark.parametrize("bounces", [0, 3])
def test_floor_follows_mirrors(bounces):
    """In a closed box of mirrors every pixel has as many rays as the budget allows, on the floor and in `whitted`."""
    scene = scenes.bouncing(16, bounces)
    for task in (lambda: mi.render(scene), rays.Floor(scene, 16, bounces + 2)):
        counts = rays.counted(task)
        assert counts["ray_intersect"] + counts["ray_intersect_preliminary"] == 256 * (bounces + 1)


def test_floor_of_many_lights_is_that_of_few():
    """The loop over lights sees what lights that stand in the kernel one by one see, and so does a table of mirrors."""
    scene = scenes.lit(32, 3)
    few = np.array(rays.Floor(scene, 32, 2)())
    with mock.patch.object(rays, "FEW_LIGHTS", 0):
        assert np.array_equal(np.array(rays.Floor(scene, 32, 2)()), few)
    assert 0 < few.mean() < 3
    scene = scenes.lecture(32)
    few = np.array(rays.Floor(scene, 32, 10)())
    with mock.patch.object(rays, "FEW_MIRRORS", 0):
        assert np.array_equal(np.array(rays.Floor(scene, 32, 10)()), few)


def test_signatures_are_one_number_where_nothing_changes():
    """The signature is one number over the background and over the floor in plain light, and others in the shadow."""
    scene = scenes.lit(32, 1)
    signature = np.array(rays.Floor(scene, 32, 2).signature(32)).reshape(32, 32)
    # The background above, the floor below.
    assert len(np.unique(signature[0])) == 1 and len(np.unique(signature[-1])) == 1
    assert signature[0, 0] != signature[-1, 0]
    # Four shapes, the background, and what lies in the shadow.
    assert len(np.unique(signature[np.isfinite(signature)])) > 5


# What is made of the records --------------------------------------------------------------------------


def test_targets_take_the_worst():
    """A target is met where the worst of its records meets it, missed where not, and open without records."""
    at = next(t for t in targets.TARGETS if t.what == "Tachyon / ours, warm, least of all scenes and sizes")
    ratios = [
        a_record(benchmark="peers", task="tachyon", quantity="warm time / phong_bsdf", median=m) for m in (3.0, 1.5)
    ]  # fmt: skip
    for rows, measured, met in ((ratios, 1.5, True), ([*ratios, replace(ratios[0], median=0.5)], 0.5, False)):
        outcome = targets.outcomes(rows)[targets.TARGETS.index(at)]
        assert (outcome.measured, outcome.met) == (measured, met)
    assert all(outcome.met is None for outcome in targets.outcomes([]))
    assert "MISSED" in targets.table(targets.outcomes([replace(ratios[0], median=0.5)]))


def test_page_keeps_its_words(tmp_path):
    """Only what stands between the marks changes; a second time nothing does."""
    (tmp_path / "images").mkdir()
    shutil.copy(DOCS / "speed.md", tmp_path)
    before = (tmp_path / "speed.md").read_text()
    records = [a_record(benchmark="memory", quantity="growth of arrays", unit="bytes", median=123456.0)]
    (tmp_path / "bench").mkdir()
    command.write(tmp_path / "bench", "memory", records)
    command.document(tmp_path / "bench", tmp_path)
    once = (tmp_path / "speed.md").read_text()
    assert "123456" in once and "123456" not in before
    command.document(tmp_path / "bench", tmp_path)
    assert (tmp_path / "speed.md").read_text() == once
    assert _words(once) == _words(before)


def _words(page):
    """The page without what its marks enclose."""
    return re.sub(r"<!-- (\w+) -->\n.*?<!-- end of \1 -->", "", page, flags=re.DOTALL)


def test_page_has_a_place_for_every_benchmark():
    """Each benchmark has its marks on its page, and each plot its picture."""
    pages = {name: (DOCS / command.PAGES.get(name, "speed.md")).read_text() for name in (*tables.TABLES, "targets")}
    for name, page in pages.items():
        assert page.count(f"<!-- {name} -->\n") == page.count(f"<!-- end of {name} -->\n") == 1
    for name in command.plots.PLOTS:
        assert f"images/speed-{name}.svg" in pages[name]


# All of them, quickly ---------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", tables.TABLES)
def test_benchmark_runs(name, tmp_path):
    """Each benchmark yields finite records, one for each quantity, that survive their file and fill its table."""
    records = quick(name)
    keys = [(row.scene, row.task, row.quantity, row.x) for row in records]
    assert records and len(set(keys)) == len(keys)
    for row in records:
        assert row.benchmark == name and row.threads == dr.thread_count() and "mitsuba 3." in row.versions
        assert math.isfinite(row.median) and row.low <= row.median <= row.high and row.repeats >= 1
        if row.unit == "s":
            assert row.median > 0

    command.write(tmp_path, name, records)
    assert command.read(tmp_path) == {name: records}
    assert json.loads((tmp_path / f"{name}.json").read_text())["context"]["machine"]
    text = (tmp_path / f"{name}.txt").read_text()
    assert all(table.title in text for table in tables.TABLES[name] if name != "peers" or shutil.which("povray"))
    assert (tmp_path / f"{name}.svg").exists() == (name in command.plots.PLOTS)


@pytest.mark.slow
def test_floor_traces_the_same_rays():
    """Floor and `whitted` trace as many shadow rays and as many others: where rounding decides, 1 in 1000 differs."""
    shares = [row.median for row in quick("floor") if row.quantity == "share of rays that differ"]
    # Measured: 4e-4 in course 6, whose floor has a radius of 5000, none elsewhere.
    assert len(shares) == 5 and max(shares) <= 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("scene", ("lecture", "8 lights", "100 spheres"))
def test_peers_render_the_same_picture(scene):
    """Away from edges POV-Ray and Tachyon agree with the package within what 16-bit files can show."""
    if not (shutil.which("povray") and shutil.which("tachyon")):
        pytest.skip("povray or tachyon is not installed")
    rows = [r for r in quick("peers") if r.scene == scene and r.quantity == "largest difference away from edges"]
    assert [row.task for row in rows] == ["povray", "tachyon"]
    assert max(row.median for row in rows) <= 2e-5


@pytest.mark.slow
def test_command_writes_everything(tmp_path):
    """The command runs what it is asked to, and judges the targets by all records in the folder."""
    result = CliRunner().invoke(command.main, ["lobes", "--quick", "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {f"{stem}.{kind}" for stem in ("lobes", "targets") for kind in ("csv", "json", "txt")}
    assert "not measured" in result.output
