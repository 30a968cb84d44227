"""The pytest plugin in a project of its own: references are made, kept, compared, and every failure says what to do."""

import re
import sys

import numpy as np
import pytest
import scipy.special  # noqa: F401

from helpers import ROOT
from phong_bsdf.pictures import images
from phong_bsdf.report import render_check  # noqa: F401

# Each of them is quick, all of them are not.
pytestmark = pytest.mark.slow

# All that the plugin imports is imported above: pytester forgets what is imported while it runs.
pytest_plugins = ["pytester"]


SCENE = """\
<scene version="3.0.0">
    <default name="kd" value="0.8"/>
    <default name="integrator" value="whitted"/>
    <integrator type="$integrator"/>
    <sensor type="perspective">
        <sampler type="independent"><integer name="sample_count" value="16"/></sampler>
        <film type="hdrfilm"><rfilter type="box"/>
            <integer name="width" value="32"/><integer name="height" value="24"/>
        </film>
    </sensor>
    <emitter type="point"><point name="position" x="1" y="2" z="0"/><float name="intensity" value="2"/></emitter>
    <shape type="sphere">
        <point name="center" x="0" y="0" z="4"/>
        <bsdf type="phong"><float name="kd" value="$kd"/></bsdf>
    </shape>
</scene>
"""

BALL = """
def test_ball(render_check):
    render_check("scene.xml"{})
"""


@pytest.fixture
def project(pytester, monkeypatch):
    """A folder outside of the checkout; the function runs pytest there, with warnings as errors, in this process or,
    much slower, as a child of its own."""
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    # The other plugins of this environment, and rewritten assertions, would cost more than the tests.
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    pytester.path.joinpath("scene.xml").write_text(SCENE)
    assert ROOT not in pytester.path.parents

    def run(*args, test=None, child=False):
        if test is not None:
            pytester.makepyfile(test_it=test)
        start = pytester.runpytest_subprocess if child else pytester.runpytest_inprocess
        return start("-p", "pytest_phong_bsdf", "-W", "error", "--assert=plain", *args)

    run.path = pytester.path
    return run


def brighter(project):
    """Something has gone wrong in the scene."""
    scene = project.path / "scene.xml"
    scene.write_text(scene.read_text().replace('value="0.8"', 'value="0.9"'))


def test_a_reference_is_made_and_serves(project):
    """Missing: it fails, and the command that it names makes the reference. Then it passes, and fails on a change."""
    result = project(test=BALL.format(""))
    result.assert_outcomes(failed=1)
    assert not (project.path / "references").exists()
    command = re.search(r"Make it with: pytest (.*)", result.stdout.str())[1].split()
    assert command == ["--phong-update-references", "test_it.py::test_ball"]
    # The same where the folder's parent is pytest's root.
    assert " ".join(command) in project(f"--rootdir={project.path.parent}").stdout.str()
    result = project(*command, child=True)
    result.assert_outcomes(passed=1)
    result.stdout.fnmatch_lines(["*references written*", "*references/test_it/test_ball.exr"])
    image = images.read_exr(project.path / "references/test_it/test_ball.exr")
    assert image.shape == (24, 32, 3) and image.max() > 0.5
    project().assert_outcomes(passed=1)
    brighter(project)
    result = project()
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*pixels are off*", "*If the new picture is right*--phong-update-references*"])
    project("--phong-update-references").assert_outcomes(passed=1)
    project().assert_outcomes(passed=1)


def test_options_and_markers(project):
    """Tolerances as arguments, or as defaults by the marker; a wrong name is an error that lists it."""
    project("--phong-update-references", test=BALL.format(""))
    brighter(project)
    project(test=BALL.format(", absolute=0.2")).assert_outcomes(passed=1)
    marked = "import pytest\n@pytest.mark.render_check(absolute=0.2)" + BALL
    project(test=marked.format("")).assert_outcomes(passed=1)
    project(test=marked.format(", absolute=0.01")).assert_outcomes(failed=1)
    result = project(test=BALL.format(", tolerance=1"))
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["render_check: there is no option 'tolerance'; there are camera, size, *, passes"])


def test_a_scene_that_is_missing_is_told_before_its_reference(project):
    """A misspelt name would else be told only to who runs the command that makes the reference."""
    result = project(test=BROKEN)
    result.assert_outcomes(failed=3)
    result.stdout.fnmatch_lines(["*no.xml: there is no such file"])


SCENES = """
import numpy as np, mitsuba as mi

FILM = {"type": "hdrfilm", "width": 16, "height": 12, "rfilter": {"type": "box"}}
SCENE = {
    "type": "scene", "integrator": {"type": "whitted"}, "light": {"type": "point", "position": [1, 2, 0]},
    "sensor": {"type": "perspective", "film": FILM},
    "ball": {"type": "sphere", "center": [0, 0, 4], "bsdf": {"type": "phong"}},
}

def test_dict(render_check):
    render_check(SCENE, spp=4)

def test_scene(render_check):
    render_check(mi.load_dict(SCENE), spp=4)

def test_array(render_check):
    render_check(np.full((4, 5, 3), 0.5), name="grey")
    render_check(np.full((4, 5), 0.25))

def test_twice(render_check):
    render_check("scene.xml", defines={"kd": 0.3}, size=(8, 6))
    render_check("scene.xml", defines={"kd": 0.6}, size=(8, 6))
"""


def test_everything_that_is_a_scene(project):
    """A dictionary, a loaded scene, arrays, a file with its options; each call has a reference of its own."""
    project("--phong-update-references", test=SCENES).assert_outcomes(passed=4)
    names = sorted(p.name for p in (project.path / "references/test_it").iterdir())
    assert names == [
        "grey.exr", "test_array.exr", "test_dict.exr", "test_scene.exr", "test_twice-2.exr", "test_twice.exr",
    ]  # fmt: skip
    project(test=SCENES).assert_outcomes(passed=4)


APART = """
import numpy as np, pytest

class TestDark:
    def test_grey(self, render_check):
        render_check(np.full((4, 5), 0.25))

class TestBright:
    def test_grey(self, render_check):
        render_check(np.full((4, 5), 0.75))

@pytest.mark.parametrize("sign", ("<", ">"))
def test_sign(render_check, sign):
    render_check(np.full((4, 5), ord(sign) / 100))
"""


def test_each_test_has_a_reference_of_its_own(project):
    """Methods of the same name in two classes, too, and parameters that cannot be part of a file's name."""
    project("--phong-update-references", test=APART).assert_outcomes(passed=4)
    names = sorted(p.name for p in (project.path / "references/test_it").iterdir())
    assert names == ["TestBright.test_grey.exr", "TestDark.test_grey.exr", "test_sign-_3c.exr", "test_sign-_3e.exr"]
    project(test=APART).assert_outcomes(passed=4)


BROKEN = """
import numpy as np

def test_hole(render_check):
    render_check(np.array([[[0.5], [np.nan]]]))

def test_missing(render_check):
    render_check("no.xml")

def test_line(render_check):
    render_check(np.zeros(5))
"""


def test_what_cannot_be_a_reference(project):
    """Is not written; the test fails and says why, without an advice to write it."""
    result = project("--phong-update-references", test=BROKEN)
    result.assert_outcomes(failed=3)
    result.stdout.fnmatch_lines(["*1 pixel of the picture is not finite*", "*no.xml: there is no such file*",
                                 "*not one of shape (5,)*"])  # fmt: skip
    assert not (project.path / "references").exists()
    # Nor is it advised beside one that is.
    hole = BROKEN.split("def test_missing")[0]
    project("--phong-update-references", test=hole.replace("np.nan", "0.5")).assert_outcomes(passed=1)
    result = project(test=hole)
    result.stdout.fnmatch_lines(["*not finite*", "*Reference: *"])
    result.stdout.no_fnmatch_line("*If the new picture is right*")


@pytest.mark.slow
def test_noise(project):
    """A path traced scene has a mean and a variance; other seeds pass, a brightness of 6 % more does not."""
    noisy = ", defines={'integrator': 'path', 'kd': KD}, spp=256, seed=SEED)"
    sky = '<emitter type="constant"><float name="radiance" value="0.3"/></emitter></scene>'
    scene = project.path / "scene.xml"
    scene.write_text(scene.read_text().replace("</scene>", sky))
    test = "def test_noisy(render_check):\n    render_check('scene.xml'" + noisy
    written = project("--phong-update-references", test=test.replace("KD", "0.8").replace("SEED", "0")).stdout
    files = sorted((project.path / "references/test_it").iterdir())
    assert [file.name for file in files] == ["test_noisy-variance.exr", "test_noisy.exr"]
    written.fnmatch_lines([f"*/{file.name}" for file in files])
    for seed in ("0", "1000"):
        project(test=test.replace("KD", "0.8").replace("SEED", seed)).assert_outcomes(passed=1)
    result = project("--phong-report", "out", test=test.replace("KD", "0.85").replace("SEED", "0"))
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*tiles of 16 x 16 pixels differ by more than noise*brighter*"])
    assert "differ by more than noise" in (project.path / "out/test_it-test_noisy.html").read_text()
    # Who commits one of the two files only is told.
    files[0].unlink()
    result = project(test=test.replace("KD", "0.8").replace("SEED", "0"))
    result.stdout.fnmatch_lines(["*test_noisy-variance.exr' is missing*--phong-update-references*"])


@pytest.mark.slow
def test_reports_of_all_workers(project):
    """With pytest-xdist too, each failure has a page, and the index has them all."""
    test = "import pytest\n@pytest.mark.parametrize('kd', (0.2, 0.5, 0.8))\ndef test_ball(render_check, kd):\n"
    test += "    render_check('scene.xml', defines={'kd': kd + CHANGE})\n"
    project("--phong-update-references", test=test.replace("CHANGE", "0"))
    options = ["-n", "2", "-p", "xdist", "--phong-report", "out"]
    result = project(*options, test=test.replace("CHANGE", "(kd > 0.3) * 0.1"), child=True)
    result.assert_outcomes(passed=1, failed=2)
    index = (project.path / "out/index.html").read_text()
    assert "2 render checks failed" in index and "Of 3 tests" in index
    for kd in ("0.5", "0.8"):
        page = f"test_it-test_ball-{kd}.html"
        assert f'href="{page}"' in index
        text = (project.path / "out" / page).read_text()
        assert all(f"<figcaption>{name}</figcaption>" in text for name in ("expected", "actual", "difference", "error"))
        assert "pixels are off" in text
    assert len(list((project.path / "out").iterdir())) == 3
    result = project("--phong-report", "out", test=test.replace("CHANGE", "0"))
    result.assert_outcomes(passed=3)
    assert "No render check failed" in (project.path / "out/index.html").read_text()


VARIANTS = """
import pytest

seen = []

@pytest.mark.phong_variants("llvm_ad_rgb", "scalar_rgb", "llvm_ad_rgb_polarized")
def test_ball(render_check, phong_variant):
    import mitsuba as mi
    assert mi.variant() == phong_variant
    render_check("scene.xml", spp=1)
"""


@pytest.mark.slow
def test_variants(project):
    """The marker runs a test in several variants against one reference; so does the command line for all tests."""
    available = project(test="import mitsuba as mi\ndef test_it():\n    assert 'llvm_ad_spectral' in mi.variants()")
    available.assert_outcomes(passed=1)
    test = VARIANTS.replace(', "llvm_ad_rgb_polarized"', "")
    project("--phong-update-references", "-k", "llvm", test=test).assert_outcomes(passed=1, deselected=1)
    project(test=test).assert_outcomes(passed=2)
    assert [p.name for p in (project.path / "references/test_it").iterdir()] == ["test_ball.exr"]
    result = project(test=VARIANTS.replace("scalar_rgb", "no_such_variant").replace(', "llvm_ad_rgb_polarized"', ""))
    result.assert_outcomes(passed=1, errors=1)
    result.stdout.fnmatch_lines(["*there is no variant 'no_such_variant'*"])
    assert "During handling" not in result.stdout.str()
    args = ["--phong-variant", "llvm_ad_rgb", "--phong-variant", "scalar_rgb"]
    plain = BALL.format(", spp=1, name='test_ball'")
    project(*args, test=plain).assert_outcomes(passed=2)


OFTEN = """
import mitsuba as mi

def test_integrator(phong_variant):
    for name in ("prb", "prb_basic"):
        assert isinstance(mi.load_dict({"type": name}), mi.SamplingIntegrator)
"""


def test_any_number_of_changes(project, monkeypatch):
    """After a hundred changes of variants Dr.Jit warns; where that is an error, Mitsuba's integrators stay whole."""
    monkeypatch.setattr("drjit.ast._syntax_counter", 1000)
    variants = ("llvm_ad_mono", "llvm_ad_rgb", "llvm_ad_mono")
    for variant in variants:
        project(f"--phong-variant={variant}", test=OFTEN).assert_outcomes(passed=1)


ISOLATION = """
import drjit as dr, mitsuba as mi

mi.set_variant("scalar_rgb")

def test_careless(render_check, phong_variant):
    assert mi.variant() == "llvm_ad_rgb"
    dr.set_flag(dr.JitFlag.SymbolicLoops, False)
    dr.set_flag(dr.JitFlag.KernelHistory, True)
    dr.set_thread_count(2)
    mi.set_variant("llvm_ad_mono")

def test_next():
    assert mi.variant() == "scalar_rgb"
    assert dr.flag(dr.JitFlag.SymbolicLoops) and not dr.flag(dr.JitFlag.KernelHistory)

def test_after_a_failure(render_check):
    dr.set_flag(dr.JitFlag.SymbolicLoops, False)
    raise ValueError

def test_last():
    assert mi.variant() == "scalar_rgb" and dr.flag(dr.JitFlag.SymbolicLoops)
"""


def test_tests_do_not_disturb_each_other(project):
    """Variant, flags and threads are restored, also after a test that fails."""
    project(test=ISOLATION, child=True).assert_outcomes(passed=3, failed=1)


def test_nothing_is_imported_before_it_is_needed(project):
    """A project without render checks pays for an environment variable only."""
    test = (
        "import sys, os\ndef test_it():\n    heavy = {'mitsuba', 'drjit', 'phong_bsdf', 'numpy'} & set(sys.modules)\n"
    )
    test += "    assert not heavy\n    assert os.environ.get('DRJIT_LIBLLVM_PATH') or sys.platform != 'linux'\n"
    project(test=test, child=True).assert_outcomes(passed=1)


def test_llvm_is_chosen_before_mitsuba_is_imported(project):
    """A test module that imports Mitsuba first gets one that can compile."""
    test = "import mitsuba as mi\nmi.set_variant('llvm_ad_rgb')\nimport drjit as dr\n"
    test += "def test_it():\n    assert dr.detail.llvm_version()[0] >= 17 and dr.sum(mi.Float(1, 2))[0] == 3\n"
    project(test=test, child=True).assert_outcomes(passed=1)


@pytest.mark.parametrize(
    ("broken", "said"),
    (
        (b"hello", "*cannot be read*"),
        (np.zeros((3, 4, 3)), "*images of different shapes cannot be compared*"),
        (np.full((24, 32, 3), np.nan), "*expected picture are not finite*"),
    ),
)
def test_bad_references(project, broken, said):
    """A reference that is no picture, of another size, or not finite, fails with a sentence."""
    path = project.path / "references/test_it/test_ball.exr"
    path.parent.mkdir(parents=True)
    if isinstance(broken, bytes):
        path.write_bytes(broken)
    else:
        images.write(path, broken)
    result = project(test=BALL.format(""))
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines([said])


def test_folders_are_those_of_the_test(project):
    """A scene lies beside its test file, and the report where pytest was started, whatever folder is current."""
    inner = project.path / "inner"
    inner.mkdir()
    (project.path / "scene.xml").rename(inner / "scene.xml")
    test = inner / "test_inner.py"
    test.write_text(BALL.format("") + "\ndef test_elsewhere(render_check, tmp_path, monkeypatch):\n"
                    "    monkeypatch.chdir(tmp_path)\n    render_check('scene.xml', name='test_ball')\n")  # fmt: skip
    project("--phong-update-references").assert_outcomes(passed=2)
    (inner / "scene.xml").write_text(SCENE.replace('value="0.8"', 'value="0.9"'))
    project("--phong-report", "out").assert_outcomes(failed=2)
    pages = sorted(p.name for p in (project.path / "out").iterdir())
    assert pages == ["index.html", "inner-test_inner-test_ball.html", "inner-test_inner-test_elsewhere.html"]
    (inner / "scene.xml").unlink()
    result = project()
    result.stdout.fnmatch_lines(["test_ball: scene.xml: there is no such file"])
    assert "--phong-update-references" not in result.stdout.str()


def test_a_report_that_cannot_be_written(project):
    """Said before any test runs."""
    (project.path / "file").write_text("")
    result = project("--phong-report", "file", test=BALL.format(""))
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(["*--phong-report: 'file' cannot be written*"])


def test_pytest_finds_the_plugin():
    """The entry point names the module, and the wheel carries it."""
    if sys.version_info < (3, 11):
        pytest.skip("tomllib is part of Python 3.11")
    import tomllib

    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    (name,) = project["project"]["entry-points"]["pytest11"].values()
    assert f"{name}.py" in project["tool"]["hatch"]["build"]["targets"]["wheel"]["only-include"]
    assert (ROOT / f"{name}.py").is_file()


def blocks():
    """The Python examples of docs/test-authors.md."""
    return re.findall(r"```python\n(.*?)```", (ROOT / "docs/test-authors.md").read_text(), re.S)


def test_documented_tests_work(project):
    """Every example is a test that passes once its reference is made, and the page's command makes it."""
    for number, text in enumerate(block for block in blocks() if "def test_" in block):
        test = f"# {number}\n{text}"
        count = 2 if "phong_variants" in text else 1
        project("--phong-update-references", test=test).assert_outcomes(passed=count)
        project(test=test).assert_outcomes(passed=count)
