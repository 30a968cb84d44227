"""The stability sweep: its truth, its bars, its report; and what the stable lobes cost."""

import csv
import dataclasses
import gc
import json
import sys

import drjit as dr
import mitsuba as mi
import mpmath as mp
import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.mpmath_lobes import by_mpmath, numbered_pairs
from phong_bsdf import stability
from phong_bsdf.cli import main
from phong_bsdf.reflection import lobes
from phong_bsdf.report import stability as report
from phong_bsdf.stability import exact, inputs, measuring, naive

# The inputs that came closest to a bar, found by climbing from the worst of millions: lobe, quantity, p, wi, wo.
WORST = [
    ("phong", "pdf", 1e-3, (0.88951403, -0.45690787, 3.8085465e-07), (-0.8290104, -0.5589666, 0.017264685)),
    ("phong", "value", 20.0, (-0.962389, 0.27167487, 0.0003837804), (0.3672046, -0.9300081, 0.015674578)),
    ("phong", "value", 150.0, (0.11394261, -0.46270135, 0.879162), (-0.2187027, 0.8968569, 0.38446951)),
    ("blinnphong", "value", 70.0, (-0.67175746, -0.17293014, 0.7203031), (-0.72942382, 0.083258078, 0.67897642)),
    ("blinnphong", "value", 20.0, (0.8245078, -0.09503341, 0.5578128), (0.70303273, -0.31645408, 0.63686877)),
    ("blinnphong", "pdf", 70.0, (-0.69648147, 0.2006311, 0.68895715), (-0.6572946, 0.57106113, 0.49178553)),
    ("blinnphong", "pdf", 1e-3, (0.9637072, -0.18569756, 0.19179364), (0.96225035, -0.18803129, 0.19677015)),
    # Opposite horizons, lengths off.
    ("blinnphong", "value", 1e8, (1.000001, 0.0, 1e-7), (-0.999999, 0.0, 1e-7)),
    ("blinnphong", "value", 1e8, (1.0, 0.0, 1e-12), (-0.99999994, 0.0, 1e-12)),
    # Worst of formulas that this package had before.
    ("blinnphong", "pdf", 100.0, (-0.013126123, 0.023917958, 0.99962777), (0.013126126, -0.023917962, 0.99962795)),
    ("phong", "value", 100.0, (-0.28564325, 0.9452962, 0.15755336), (-0.5213197, -0.82587457, 0.2148417)),
    ("phong", "value", 1e-10, (0.21925712, -0.9363884, 0.27404943), (-0.6529246, -0.34953958, 0.6719461)),
]


@pytest.mark.parametrize("p", (0.1, 1, 100, 1e5, 1e8))
@pytest.mark.parametrize("lobe", ("phong", "blinnphong"))
def test_float64_truth(lobe, p):
    """What the sweep calls true agrees with mpmath, to far below float32."""
    wi, wo, numbers = numbered_pairs(lobe, p, seed=7, n=200)
    with mp.workdps(40):
        for quantity, (values, kappa) in exact.value_and_pdf(lobe, wi, wo, float(np.float32(p))).items():
            for value, k, x in zip(values, kappa, numbers, strict=True):
                true = float(by_mpmath(lobe, quantity, x))
                if true > 1e-30 and k < measuring.WORST_CONDITION:
                    assert value == pytest.approx(true, rel=1e-14 * (1 + k))


@settings(deadline=None, max_examples=40, derandomize=True)
@given(
    seed=st.integers(0, 2**32),
    p=st.one_of(st.just(0.0), st.floats(-2, 8).map(lambda x: 10.0**x)),
    lobe=st.sampled_from(["phong", "blinnphong"]),
)
def test_bars_hold_for_any_seed(seed, p, lobe):
    """4096 pairs of directions for each seed and exponent."""
    wi, wo = inputs.pairs(lobe, p, 4096, np.random.default_rng(seed))
    truth = exact.value_and_pdf(lobe, wi, wo, float(np.float32(p)))
    for quantity in ("value", "pdf"):
        values = measuring.LOBES[lobe][quantity][0](mi.Vector3f(wi.T), mi.Vector3f(wo.T), dr.opaque(mi.Float, p))
        assert measuring.worst(values.numpy(), *truth[quantity])[1] <= stability.BARS[quantity]


@pytest.mark.parametrize(("lobe", "quantity", "p", "wi", "wo"), WORST)
def test_worst_inputs_found_so_far(lobe, quantity, p, wi, wo):
    """They stay within the bar, in the neighbourhood of a few roundings too."""
    rng = np.random.default_rng(0)
    shifts = [1 + 2.0**-24 * rng.integers(-2, 3, (4096, 3)) for _ in range(2)]
    wi, wo = ((np.array(v, np.float32) * shift).astype(np.float32) for v, shift in zip((wi, wo), shifts, strict=True))
    truth = exact.value_and_pdf(lobe, wi, wo, float(np.float32(p)))[quantity]
    values = measuring.LOBES[lobe][quantity][0](mi.Vector3f(wi.T), mi.Vector3f(wo.T), dr.opaque(mi.Float, p)).numpy()
    assert np.count_nonzero(truth[1] < measuring.WORST_CONDITION) > 4000
    assert measuring.worst(values, *truth)[1] <= stability.BARS[quantity]


@pytest.mark.parametrize("p", (1e5, 1e6, 1e8))
def test_phong_keeps_cancelling_products(p):
    """Near the peak every digit is needed: absolute errors stay below 1e-4, where plain products would give 4e-3."""
    wi, wo = inputs.pairs("phong", p, 2**18, np.random.default_rng(11))
    truth, _ = exact.value_and_pdf("phong", wi, wo, float(np.float32(p)))["value"]
    value = lobes.phong(mi.Vector3f(wi.T), mi.Vector3f(wo.T), dr.opaque(mi.Float, p)).numpy()
    assert np.abs(value - truth).max() < 1e-4


@pytest.mark.slow
def test_command(tmp_path):
    """`stability --quick` meets the bars, prints a line for each, and writes CSV, JSON, text and plots."""
    result = CliRunner().invoke(main, ["stability", "--quick", "-o", str(tmp_path / "new")])
    assert result.exit_code == 0, result.output
    rows = list(csv.DictReader((tmp_path / "new/stability.csv").read_text().splitlines()))
    kept = json.loads((tmp_path / "new/stability.json").read_text())
    assert len(rows) == len(kept["rows"]) == 4 * 2 * len(stability.EXPONENTS)
    assert kept["context"]["variant"] == "llvm_ad_rgb" and kept["context"]["mitsuba"] == mi.__version__
    assert result.output.startswith((tmp_path / "new/stability.txt").read_text())
    assert f"{len(rows)} of {len(rows)} bars met" in result.output
    # What the report is for: at p = 1e6 the naive highlight is wrong, the stable one is not.
    row = next(r for r in rows if (r["quantity"], r["lobe"], r["p"]) == ("value", "blinnphong", "1000000.0"))
    assert float(row["error"]) < 1e-4 < 0.1 < float(row["naive_error"])
    for quantity in stability.BARS:
        assert (tmp_path / f"new/{quantity}.svg").read_text().count("<svg") == 1


def test_a_missed_bar_is_exit_code_1(monkeypatch):
    """And the table says which."""
    monkeypatch.setattr(measuring, "EXPONENTS", (1e6,))
    monkeypatch.setitem(measuring.LOBES["phong"], "value", (naive.phong, naive.phong))
    result = CliRunner().invoke(main, ["stability", "--quick"])
    assert result.exit_code == 1
    assert [line.split()[0] for line in result.output.splitlines() if line.endswith("MISSED")] == ["value"]


def test_plots_need_matplotlib(tmp_path, monkeypatch):
    """Without it the numbers are written all the same."""
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    rows = list(stability.sweep(cases=2**10, exponents=(1.0,)))
    assert [p.name for p in report.write(tmp_path, rows)] == ["stability.csv", "stability.json", "stability.txt"]


@pytest.mark.parametrize("args", (["-m", "scalar_rgb"], ["-o", "/dev/null/x"], ["-m", "nix"]))
def test_bad_usage(args):
    """Exit code 2 and one sentence."""
    result = CliRunner().invoke(main, ["stability", "--quick", *args])
    assert result.exit_code == 2 and result.output.startswith("Error: ")


@pytest.mark.parametrize("integrator", ("whitted", "direct"))
@pytest.mark.parametrize("lobe", ("phong", "blinnphong"))
def test_price_in_a_render(lobe, integrator, monkeypatch):
    """A kernel with the stable lobe has at most 1.3 times the operations of one with `power(dot, p)`."""

    def operations():
        scene = {
            "type": "scene",
            "integrator": {"type": integrator},
            "sensor": {
                "type": "perspective",
                "film": {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}},
                "sampler": {"type": "independent", "sample_count": 1},
            },
            "ball": {"type": "sphere", "center": [0, 0, 5], "bsdf": {"type": lobe}},
            "light": {"type": "point", "position": [1, 2, 0]},
        }
        scene = mi.load_dict(scene)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            dr.eval(mi.render(scene))
            count = max(k["operation_count"] for k in dr.kernel_history() if "operation_count" in k)
        # Kernels hold every BSDF that is alive.
        del scene
        gc.collect()
        return count

    stable = operations()
    naive_lobe = dataclasses.replace(lobes.LOBES[lobe], value=getattr(naive, lobe), pdf=getattr(naive, f"{lobe}_pdf"))
    monkeypatch.setitem(lobes.LOBES, lobe, naive_lobe)
    common = operations()
    assert common < stable <= 1.3 * common
