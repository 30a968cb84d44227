"""What is released: sdist and wheel are complete, and work in an environment of their own, without the checkout."""

import os
import re
import subprocess
import sys
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

from helpers import ROOT

pytestmark = pytest.mark.slow

# Nothing of this checkout, nor of the environment that runs the tests.
CLEAN = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "DRJIT_LIBLLVM_PATH")}


def run(*command, **options):
    result = subprocess.run([str(word) for word in command], capture_output=True, text=True, env=CLEAN, **options)
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


def reachable(folder):
    """Whether pip gets anything from its index."""
    command = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", "-d", str(folder), "hatchling"]
    return subprocess.run(command, capture_output=True).returncode == 0


@pytest.fixture(scope="module")
def released(tmp_path_factory):
    """The folder with the sdist, and the wheel that was built from it."""
    folder = tmp_path_factory.mktemp("release")
    if not reachable(folder / "index"):
        pytest.skip("no package index")
    run(sys.executable, "-m", "build", "--outdir", folder / "dist", ROOT)
    return folder / "dist"


@pytest.fixture(scope="module")
def installed(released, tmp_path_factory):
    """The programs of an environment that has the wheel and what that asks for."""
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder, with_pip=True)
    programs = folder / ("Scripts" if os.name == "nt" else "bin")
    (wheel,) = released.glob("*.whl")
    run(programs / "python", "-m", "pip", "install", "-q", wheel)
    return programs


def test_the_sdist_is_the_project(released):
    """Source, scenes, tests and pages; nothing that was built or installed here."""
    (sdist,) = released.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert {"README.md", "LICENSE", "CITATION.cff", "Makefile", "docs/index.md", "tests/test_packaging.py"} <= names
    assert {"phong_bsdf/plugins/phong.py", "scenes/lecture/lights.xml"} <= names
    assert not any(re.match(r"\.venv|out/|dist/|.*\.pyc$", name) for name in names)


def test_the_wheel_is_complete(released):
    """Each file of the package, the lecture's scenes, the pytest plugin; and nothing else at the top."""
    (wheel,) = released.glob("*.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    files = [p for p in (ROOT / "phong_bsdf").rglob("*") if p.is_file() and p.suffix != ".pyc"]
    assert {str(p.relative_to(ROOT)) for p in files} <= names
    assert {f"phong_bsdf/scenes/{p.name}" for p in (ROOT / "scenes/lecture").iterdir()} <= names
    assert {"pytest_phong_bsdf.py", "phong_bsdf/py.typed"} <= names
    tops = {name.split("/")[0] for name in names}
    assert {top for top in tops if ".dist-info" not in top} == {"phong_bsdf", "pytest_phong_bsdf.py"}


def test_the_demo_works_anywhere(installed, tmp_path):
    """The command renders the lecture's pictures in an empty folder, with an LLVM that works."""
    assert "llvm_ad_rgb             works" in run(installed / "phong-bsdf", "doctor", cwd=tmp_path)
    run(installed / "phong-bsdf", "demo", cwd=tmp_path)
    assert len(list(tmp_path.glob("demo/*.png"))) == len(list((ROOT / "scenes/lecture").glob("*.xml")))
    # All of them need nothing but what is installed.
    run(installed / "phong-bsdf", "render", "demo/lights.xml", "-o", "lights.exr", cwd=tmp_path)
    assert (tmp_path / "lights.exr").stat().st_size > 1000


def test_the_package_is_the_installed_one(installed, tmp_path):
    """Python finds it without the checkout, and Mitsuba its plugins."""
    code = (
        "import phong_bsdf, mitsuba as mi; mi.set_variant('llvm_ad_rgb'); "
        "print(phong_bsdf.__file__, type(mi.load_dict({'type': 'mirrorblend', 'n': {'type': 'phong'}})).__name__)"
    )
    file, name = run(installed / "python", "-c", code, cwd=tmp_path).split()
    assert Path(file).is_relative_to(installed.parent) and name == "MirrorBlend"


@pytest.mark.parametrize(
    ("extra", "arguments"),
    [("report", "compare SCENE -o out"), ("cluster", "render SCENE -o out.exr --cluster local")],
)
def test_without_extras_a_command_says_what_is_missing(installed, tmp_path, extra, arguments):
    """One sentence with the remedy, instead of a traceback; nothing is left."""
    arguments = arguments.replace("SCENE", str(ROOT / "scenes/compare/floor.xml")).split()
    command = [installed / "phong-bsdf", *arguments]
    result = subprocess.run(command, capture_output=True, text=True, env=CLEAN, cwd=tmp_path)
    assert result.returncode == 2 and f"pip install 'phong-bsdf[{extra}]'" in result.stderr
    assert "Traceback" not in result.stderr and not list(tmp_path.iterdir())


def test_one_version(released):
    """The same in the package, in what is released, and in how it is cited."""
    import phong_bsdf

    (wheel,) = released.glob("*.whl")
    cited = re.search(r"^version: (.*)$", (ROOT / "CITATION.cff").read_text(), re.M)[1]
    assert wheel.name.split("-")[1] == phong_bsdf.__version__ == cited
    assert f"## {cited}" in (ROOT / "CHANGELOG.md").read_text()
