"""docs/error-vs-time.md: its scene is what it says, its figures and tables are there."""

import json
import re

import pytest
from click.testing import CliRunner

from helpers import ROOT
from phong_bsdf.cli import main

PAGE = (ROOT / "docs/error-vs-time.md").read_text()
LIGHTS = ROOT / "scenes/converge/thousand-lights.xml"


def run(arguments):
    result = CliRunner().invoke(main, list(map(str, arguments)))
    assert result.exit_code == 0, result.stderr or result.exception
    return result.stdout


@pytest.mark.slow
def test_thousand_lights(tmp_path):
    """Integrators that ask one lamp at random mean the picture of the one that asks them all: no bias in either."""
    given = ["--method", "path", "--method", "direct", "--method", "whitted=spp=1 4"]
    run(["converge", LIGHTS, "-o", tmp_path / "out", "--size", "16x12", "--spp", "64,256", "--repeats", "4", *given])
    found = json.loads((tmp_path / "out/convergence.json").read_text())
    path, direct, whitted = found["results"]
    assert (path["verdict"], direct["verdict"]) == ("unbiased", "unbiased")
    # Narrow enough to mean something: 2 % of the variance of 1 sample.
    assert path["bias"]["high"] < 0.02 * 256 * path["levels"][-1]["variance"]["value"]
    assert whitted["levels"][-1]["variance"]["value"] == pytest.approx(0, abs=1e-9)
    # What is left is its edges.
    assert whitted["levels"][-1]["relmse"]["value"] < 0.1 * path["levels"][0]["relmse"]["value"]


@pytest.mark.parametrize("name", ("mirror-floor", "glossy", "lights"))
def test_figures_and_tables_are_there(name):
    """Made by `make study`; the page shows them."""
    for kind in ("svg", "png"):
        assert f"(images/study-{name}.{kind})" in PAGE and (ROOT / f"docs/images/study-{name}.{kind}").is_file()
    table = re.search(rf"<!-- table {name} -->\n```text\n(.*?)```\n<!-- end of table -->", PAGE, re.S)[1]
    assert table.startswith("method ") and len(table.splitlines()) > 4
