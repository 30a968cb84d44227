"""What `phong-bsdf explain` says of a kernel is true of that kernel."""

import csv
import json

import mitsuba as mi
import numpy as np
import pytest
from click.testing import CliRunner

from helpers.bsdfs import mirror
from helpers.small_scenes import BLINN, PHONG, POINTS, SUN, balls
from phong_bsdf import explanation
from phong_bsdf.cli import main
from phong_bsdf.report import explanation as report
from phong_bsdf.scene.rendering import LoadedScene, SceneError
from phong_bsdf.tracing.needs import FEATURES

SPOT = {"spot": {"type": "spot", "to_world": mi.ScalarTransform4f().look_at([0, 5, 5], [0, 0, 0], [0, 1, 0])}}
GLASS = {"type": "dielectric"}
HOLE = {"type": "mask", "opacity": 0.5, "b": PHONG}
GAUSSIAN = {"type": "hdrfilm", "width": 48, "height": 48}


def features(bsdfs, lights=SUN, spp=1, film=None, **options):
    """What the kernel of a scene holds."""
    loaded = balls(bsdfs, lights, spp=spp, **options)
    sensor = mi.load_dict({"type": "perspective", "film": film}) if film else loaded.sensors()[0]
    return loaded.integrator().features(loaded, sensor, spp)


BARE = {"type": "phong", "ks": 0}


@pytest.mark.parametrize(
    ("changed", "more"),
    [
        ({"bsdfs": [{"type": "phong", "kd": 0}]}, {"highlights"}),
        ({"bsdfs": [PHONG]}, {"highlights"}),
        ({"bsdfs": [BARE, {**BARE, "kd": 0.3}]}, {"materials"}),
        ({"bsdfs": [mirror(BARE)]}, {"mirrors", "last bounce"}),
        ({"bsdfs": [mirror(BARE)], "max_depth": 2}, set()),
        ({"bsdfs": [mirror(BARE)], "max_depth": -1}, {"mirrors", "last bounce"}),
        ({"bsdfs": [mirror(BARE, 0)]}, set()),
        ({"bsdfs": [{"type": "diffuse"}]}, {"bsdf calls", "materials", "highlights"}),
        ({"bsdfs": [GLASS]}, {"bsdf calls", "materials", "highlights", "mirrors", "branches"}),
        ({"bsdfs": [HOLE]}, {"bsdf calls", "materials", "highlights", "mirrors", "transparency"}),
        ({"lights": POINTS}, {"lights"}),
        ({"lights": SPOT}, {"light calls"}),
        ({"ambient": 0.1}, {"ambient"}),
        ({"spp": 4}, {"film block"}),
        ({"film": GAUSSIAN}, {"film block"}),
        ({"specialize": False}, set(FEATURES)),
    ],
)
def test_features_are_those_of_the_scene(changed, more):
    """One diffuse BSDF under one light needs the diffuse part only; each change adds what it needs."""
    expected = {"diffuse"} | more
    if changed.get("bsdfs") == [{"type": "phong", "kd": 0}]:
        expected -= {"diffuse"}
    assert features(**{"bsdfs": [BARE], **changed}) == expected


def test_lights_that_send_nothing_are_gone():
    """They cost nothing, until their intensity is raised."""
    dark = {name: {**light, "intensity": 0.0} for name, light in POINTS.items()}
    with_dark, without = (balls([PHONG], {**SUN, **more}) for more in (dark, {}))
    assert "lights" not in with_dark.integrator().features(with_dark, with_dark.sensors()[0], 1)
    picture = np.array(mi.render(with_dark))
    assert np.array_equal(picture, np.array(mi.render(without)))
    params = mi.traverse(with_dark)
    key = next(k for k in params.keys() if k.endswith("intensity.value"))  # noqa: SIM118
    params[key] = 0.7
    params.update()
    raised = np.array(mi.render(with_dark))
    lit = balls([PHONG], {**SUN, "light": {**POINTS[key.split(".")[0].replace("_", " ")], "intensity": 0.7}})
    assert np.array_equal(raised, np.array(mi.render(lit))) and not np.array_equal(raised, picture)
    params[key] = 0.0
    params.update()
    assert np.array_equal(np.array(mi.render(with_dark)), picture)


@pytest.mark.slow
def test_what_is_left_out_would_cost_operations():
    """Every feature that is left out has a price; where more is held, the kernel is larger, the whole the largest."""
    loaded = LoadedScene("test", balls([PHONG, BLINN], {**SUN, "point": POINTS["light 0"]}), "Whitted", 0.0)
    result = explanation.explain(loaded, repeats=1)
    rows = {row.feature: row for row in result.rows}
    assert set(FEATURES) < set(rows)
    assert {name for name in FEATURES if rows[name].held} == {"materials", "diffuse", "highlights"}
    # These lights look alike from everywhere: what a call says of them is a constant of the kernel.
    assert rows["light calls"].operations == 0
    for name in ("mirrors", "ambient", "film block"):
        assert rows[name].operations > 0 and rows[name].milliseconds is not None
    assert rows["diffuse"].operations is None
    assert result.operations < result.general_operations
    # Nothing of the measurement stays.
    assert loaded.scene.integrator().keep == frozenset()


@pytest.mark.slow
def test_command(tmp_path):
    """A line for each feature, and the same as CSV, JSON and text; large pictures are measured smaller."""
    args = ["explain", "scenes/lecture/mirror-floor.xml", "-o", str(tmp_path / "new"), "-D", "max_depth=2"]
    result = CliRunner().invoke(main, [*args, "--size", "2000x1000"])
    assert result.exit_code == 0, result.output
    assert result.output == (tmp_path / "new/explain.txt").read_text()
    assert all(any(line.startswith(f"{name}  ") for line in result.output.splitlines()) for name in FEATURES)
    rows = {row["feature"]: row for row in csv.DictReader((tmp_path / "new/explain.csv").read_text().splitlines())}
    assert rows["mirrors"]["held"] == "False" and rows["highlights"]["held"] == "True"
    kept = json.loads((tmp_path / "new/explain.json").read_text())
    assert kept["context"]["variant"] == "llvm_ad_rgb" and len(kept["rows"]) == len(rows)
    assert kept["width"] * kept["height"] <= explanation.MOST_SAMPLES and kept["width"] == pytest.approx(
        2 * kept["height"], abs=2
    )
    assert kept["operations"] < kept["general_operations"]


def test_many_kinds_of_bsdfs_fit_into_a_line():
    """The table is no wider than a terminal of 100 columns."""
    bsdfs = [GLASS, HOLE, mirror(BLINN), {"type": "roughconductor"}, {"type": "roughplastic"}, {"type": "diffuse"}]
    loaded = LoadedScene("a.xml", balls(bsdfs, {**POINTS, **SPOT, **SUN}, size=8), "Whitted", 0.0)
    text = report.text(explanation.explain(loaded, repeats=1))
    assert "6 BSDFs of 6 kinds" in text and "8 lights of 3 kinds" in text and max(map(len, text.splitlines())) <= 100


def test_other_integrators_are_refused(tmp_path):
    """Exit code 2 and one sentence; so are variants without kernels."""
    loaded = LoadedScene("a.xml", balls([PHONG], SUN), "path", 0.0)
    with pytest.raises(SceneError, match="about the integrator 'whitted', this scene has path"):
        explanation.explain(loaded)
    result = CliRunner().invoke(main, ["explain", "scenes/lecture/falloff.xml", "-m", "scalar_rgb", "--size", "4x4"])
    assert result.exit_code == 2 and "has no kernels" in result.stderr
    assert CliRunner().invoke(main, ["explain", "scenes/lecture/falloff.xml", "-o", "/dev/null/x"]).exit_code == 2


def test_text_holds_every_number():
    """The table's numbers are those of the records."""
    row = explanation.Row("mirrors", "none", False, "loop", 17, -0.01)
    text = report.text(explanation.Explanation((row,), 4, 3, 1, 100, 1.5, 200, 2.5))
    assert "17  0.0" in text and "4 x 3, 1 spp: 100 operations, 1.5 ms" in text and "200 operations, 2.5 ms" in text
