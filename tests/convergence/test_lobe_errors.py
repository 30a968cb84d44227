"""`phong-bsdf converge --lobes`: errors of formulas against their time, from the sweep of `stability`."""

import json
import math
from pathlib import Path

import pytest
from click.testing import CliRunner

from phong_bsdf import stability
from phong_bsdf.cli import main
from phong_bsdf.convergence import lobe_errors
from phong_bsdf.pictures import store as passes
from phong_bsdf.report import lobe_errors as report


def row(error, native=None, naive=1.0, ns=4.0):
    inputs = ((0.0,) * 6, 1.0, (0.0,) * 6)
    return stability.Row(
        "value", "phong", 10.0, 100, error, *inputs, naive, 1.0, native, native, ns, 3.0, native and 5.0
    )


def test_repeats_give_intervals():
    """The geometric mean of the worst errors, and the median of the times; a formula that is missing has no row."""
    found = lobe_errors.summarise([[row(1e-6, ns=4)], [row(4e-6, ns=9)], [row(2e-6, ns=5)]])
    assert [r.formula for r in found] == ["stable", "naive"]
    assert found[0].error.value == pytest.approx(2e-6) and 0 < found[0].error.low < 2e-6 < found[0].error.high
    assert found[0].nanoseconds.median == 5 and found[1].error.value == 1
    assert [r.formula for r in lobe_errors.summarise([[row(1e-6, native=0.5)]])] == ["stable", "naive", "native"]


def test_overflow_is_not_averaged_away():
    """Infinite in one repeat is infinite."""
    found = lobe_errors.summarise([[row(1e-6, naive=math.inf)], [row(1e-6)]])
    assert math.isinf(found[1].error.value) and "inf" in " ".join(report.brief(found))


@pytest.mark.slow
def test_study_of_the_lobes(tmp_path, monkeypatch):
    """Records, page and table are there; the next run measures only what is missing; a scene does not go in there."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(lobe_errors, "EXPONENTS", (10.0, 1e6))
    monkeypatch.setattr(stability, "QUICK_CASES", 2**12)
    run = lambda *args: CliRunner().invoke(main, ["converge", *args])  # noqa: E731
    first = run("--lobes", "-o", "out", "--repeats", "1")
    assert first.exit_code == 0, first.stderr or first.exception
    (kept,) = Path("out/passes").glob("lobes-*/*.json")
    before = kept.stat().st_mtime_ns
    assert run("--lobes", "-o", "out", "--repeats", "2").exit_code == 0
    assert kept.stat().st_mtime_ns == before and len(list(kept.parent.iterdir())) == 2
    found = json.loads(Path("out/lobe-errors.json").read_text())
    assert len(found["rows"]) == 2 * (4 * 2 + 4 * 2 + 1) and all(r["repeats"] == 2 for r in found["rows"])
    values = {(r["lobe"], r["formula"], r["p"]): r["error"]["value"] for r in found["rows"] if r["quantity"] == "value"}
    assert values["phong", "stable", 1e6] < 1e-3 < values["phong", "naive", 1e6]
    Path("a.xml").write_text('<scene version="3.0.0"><integrator type="path"/><sensor type="perspective"/></scene>')
    other = run("a.xml", "-o", "out")
    assert other.exit_code == 2 and "holds measurements of the lobes' formulas" in other.stderr
    assert run("--from", "out").exit_code == 0


def test_killed_run_can_be_drawn(tmp_path, monkeypatch):
    """Before its first repeat is done, too: the page says that nothing is there."""

    def killed(**options):
        raise KeyboardInterrupt

    monkeypatch.setattr(stability, "sweep", killed)
    out = str(tmp_path / "out")
    assert CliRunner().invoke(main, ["converge", "--lobes", "-o", out, "--repeats", "2"]).exit_code == 1
    drawn = CliRunner().invoke(main, ["converge", "--from", out])
    assert drawn.exit_code == 0, drawn.stderr or drawn.exception
    text = (tmp_path / "out" / "index.html").read_text()
    assert "Nothing has been measured yet." in text and "2 repeats are missing" in text


def test_needs_a_jit_variant(tmp_path):
    """In scalar variants there is no kernel to time."""
    result = CliRunner().invoke(main, ["converge", "--lobes", "-o", str(tmp_path / "out"), "-m", "scalar_rgb"])
    assert result.exit_code == 2 and "JIT variant" in result.stderr
    assert not (tmp_path / "out" / passes.LOBES).exists()
