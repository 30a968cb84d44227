"""Dr.Jit gets an LLVM that it can use, or the user a sentence that says what to do; no process dies."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from phong_bsdf.host import llvm

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="elsewhere Dr.Jit finds LLVM by itself")

SET = "mi.set_variant('llvm_ad_rgb')\n"
# LLVM 15 and 16 cannot translate a maximum: they abort the process.
COMPUTE = "import drjit as dr; print(dr.maximum(mi.Float([1, 5]), 2))\n"

# What `llvm` asks for the wheel and the system, before it is imported.
NO_WHEEL = (
    "from importlib import metadata\n"
    "def absent(name): raise metadata.PackageNotFoundError(name)\n"
    "metadata.files = absent\n"
)
NO_SYSTEM = "import pathlib; pathlib.Path.glob = lambda *_: iter(())\n"


def run(*args, path=None):
    """A new Python with these arguments, and LLVM at `path` if given."""
    env = {name: value for name, value in os.environ.items() if name != llvm.VARIABLE}
    if path:
        env[llvm.VARIABLE] = str(path)
    return subprocess.run([sys.executable, *args], env=env, capture_output=True, text=True)


@pytest.fixture
def bad_llvm():
    """A libLLVM of the system that aborts."""
    majors = [(path, llvm._version(path.name)[0]) for path in llvm._system_files()]
    for path, major in majors:
        if major in (15, 16):
            return path
    pytest.skip("the system has no LLVM 15 or 16")


def assert_refused(child):
    """It ended with the exception, not with a signal, and the user reads what to do."""
    assert child.returncode == 1, child.stderr
    message = child.stderr.rstrip().rsplit("\n", 1)[-1]
    assert message.startswith("phong_bsdf.host.llvm.LLVMError: phong_bsdf: Dr.Jit has loaded LLVM 1")
    assert "`import phong_bsdf` before `import mitsuba`" in message
    assert f"pip install {llvm.WHEEL}" in message
    assert llvm.VARIABLE in message


@pytest.mark.parametrize("setup", ["", NO_SYSTEM], ids=["as it is", "no LLVM in the system"])
def test_import_is_enough_to_compute(setup):
    """After `import phong_bsdf` an llvm variant computes, without any environment variable or message."""
    child = run("-c", setup + "import phong_bsdf, mitsuba as mi\n" + SET + COMPUTE)
    assert (child.returncode, child.stdout, child.stderr) == (0, "[2, 5]\n", "")


def test_wheel_without_its_links(tmp_path):
    """The wheel's LLVM loads where the links `libc++.so.1` could not be made, as in a read-only folder."""
    wanted = {path.name: path for path in llvm._wheel_files().values()}
    files = [path for name, path in wanted.items() if name in llvm.RUNTIME or llvm._version(name) > (0,)]
    if not files:
        pytest.skip(f"{llvm.WHEEL} is not installed")
    for path in files:
        try:
            os.link(path, tmp_path / path.name)
        except OSError:
            shutil.copy(path, tmp_path / path.name)
    only_these = (
        "from importlib import metadata; from pathlib import Path\n"
        "class File(type(Path())):\n"
        "    def locate(self): return self\n"
        f"metadata.files = lambda name: [File(path) for path in Path({str(tmp_path)!r}).iterdir()]\n"
    )
    child = run("-c", only_these + NO_SYSTEM + "import phong_bsdf, mitsuba as mi\n" + SET + COMPUTE)
    assert (child.returncode, child.stdout, child.stderr) == (0, "[2, 5]\n", "")


@pytest.mark.parametrize("order", ["phong_bsdf, drjit", "drjit, phong_bsdf"])
def test_users_choice_wins(order):
    """`DRJIT_LIBLLVM_PATH` stays as the user has set it, even if that file is of no use."""
    code = f"import os, {order}; print(os.environ[{llvm.VARIABLE!r}], drjit.detail.llvm_version()[0] > 0)"
    child = run("-c", code, path="/no/such/libLLVM.so")
    assert child.stdout == "/no/such/libLLVM.so False\n"


@pytest.mark.parametrize(
    "code",
    [
        "import phong_bsdf, mitsuba as mi\n" + SET,
        "import drjit, phong_bsdf, mitsuba as mi\n" + SET,
        "import os, drjit; del os.environ['DRJIT_LIBLLVM_PATH']; import phong_bsdf, mitsuba as mi\n" + SET,
        "import mitsuba as mi\n" + SET + "import phong_bsdf\n",
        f"import mitsuba as mi\n{SET}try: import phong_bsdf\nexcept ImportError: import phong_bsdf\n{SET}",
        "import phong_bsdf, mitsuba as mi\ntry: " + SET + "except ImportError: " + SET,
    ],
    ids=["chosen", "drjit first", "drjit first, not chosen", "variant first", "import again", "set again"],
)
def test_bad_llvm_is_an_exception(bad_llvm, code):
    """LLVM 15 and 16 raise an exception with the remedy before they can abort, in any order of imports."""
    assert_refused(run("-c", code + COMPUTE, path=bad_llvm))


@pytest.mark.parametrize(
    "code",
    [
        "import phong_bsdf, mitsuba as mi\n",
        "import phong_bsdf, mitsuba as mi\ntry: " + SET + "except ImportError: pass\n",
        "import mitsuba as mi\n" + SET + "try: import phong_bsdf\nexcept ImportError: pass\n",
    ],
    ids=["at once", "after the refusal", "after a refused import"],
)
def test_scalar_variants_work_with_a_bad_llvm(bad_llvm, code):
    """The scalar variants and their plugins do not mind a bad LLVM."""
    code += "mi.set_variant('scalar_rgb'); print(type(mi.load_dict({'type': 'phong'})).__name__)"
    assert run("-c", code, path=bad_llvm).stdout == "Phong\n"


@pytest.mark.parametrize("before", ["scalar_rgb", "scalar_spectral"])
def test_refusal_keeps_the_variant(bad_llvm, before):
    """After a refusal the variant from before is active still, with its plugins."""
    refusal = f"try: {SET}except ImportError: pass\n"
    code = f"import phong_bsdf, mitsuba as mi; mi.set_variant({before!r})\n" + refusal
    code += "print(mi.variant(), type(mi.load_dict({'type': 'phong'})) is phong_bsdf.plugins.phong.Phong)"
    assert run("-c", code, path=bad_llvm).stdout == f"{before} True\n"


def test_no_llvm_warns():
    """Where there is no LLVM at all, the line that imports the package warns and names the remedy."""
    child = run("-c", NO_WHEEL + NO_SYSTEM + "import phong_bsdf")
    assert child.returncode == 0
    line = (NO_WHEEL + NO_SYSTEM).count("\n") + 1
    assert child.stderr.startswith(f"<string>:{line}: RuntimeWarning: phong_bsdf: found no libLLVM")
    assert f"pip install {llvm.WHEEL}" in child.stderr


@pytest.mark.parametrize(
    "code",
    [
        "dr.while_loop((mi.Float([1, 2]),), lambda x: x < 5, lambda x: (mi.UInt32(x),))",
        "mi.load_dict({'type': 'phong', 'p': -1})",
    ],
)
def test_exceptions_of_cpp_code_arrive(code):
    """Exceptions thrown by C++ become Python's: the wheel's C++ runtime does not get hold of them."""
    child = run("-c", f"import phong_bsdf, drjit as dr, mitsuba as mi\n{SET}try: {code}\n"
                      "except RuntimeError: print('caught')")  # fmt: skip
    assert (child.returncode, child.stdout) == (0, "caught\n"), child.stderr


@pytest.mark.parametrize(
    ("name", "version"),
    [
        ("libLLVM.so.23.1", (23, 1)),
        ("libLLVM-17.so", (17,)),
        ("libLLVM-17.so.1", (17,)),
        ("libLLVM-14.0.6.so.1", (14, 0, 6)),
        ("libLLVM-15.so.1", (15,)),
        ("libLLVM.so", (0,)),
        ("libLLVM-C.so", (0,)),
        ("libLLVMCore.so.18", (0,)),
    ],
)
def test_version_of_a_name(name, version):
    """The version is read off the file's name, where it has one."""
    assert llvm._version(name) == version


@pytest.mark.parametrize(
    ("names", "chosen"),
    [
        (["libLLVM-15.so.1", "libLLVM-17.so", "libLLVM.so.18.1", "libLLVM.so"], "libLLVM.so.18.1"),
        (["libLLVM-9.so", "libLLVM-19.so", "libLLVM.so.20.1"], "libLLVM.so.20.1"),
        (["libLLVM-15.so.1", "libLLVM-16.so.1", "libLLVM.so"], None),
        ([], None),
    ],
)
def test_newest_usable_one_of_the_system(tmp_path, monkeypatch, names, chosen):
    """Of the system's libraries the newest is chosen, and none that aborts or has no version in its name."""
    monkeypatch.setattr(llvm, "SYSTEM_FOLDERS", [str(tmp_path)])
    for name in names:
        (tmp_path / name).touch()
    assert llvm._newest(llvm._system_files()) == (chosen and str(tmp_path / chosen))


def test_doctor_says_that_it_works():
    """`phong-bsdf doctor` names the LLVM, proves that it works and ends with 0."""
    child = run("-m", "phong_bsdf", "doctor")
    lines = dict(line.split("  ", 1) for line in child.stdout.splitlines())
    assert int(lines["LLVM loaded by Dr.Jit"].split(".")[0]) >= llvm.OLDEST
    assert Path(child.stdout.split(llvm.VARIABLE)[1].split()[0]).is_file()
    assert (child.returncode, lines["llvm_ad_rgb"].strip(), child.stderr) == (0, "works", "")


def test_doctor_explains_a_bad_llvm(bad_llvm):
    """With LLVM 15 or 16 `phong-bsdf doctor` names it and the remedy, and ends with 1."""
    child = run("-m", "phong_bsdf", "doctor", path=bad_llvm)
    assert child.returncode == 1
    assert str(bad_llvm) in child.stdout
    assert "does not work" in child.stdout
    assert f"pip install {llvm.WHEEL}" in child.stdout


def test_doctor_explains_a_missing_llvm():
    """Without any LLVM `phong-bsdf doctor` says so and names the remedy, and ends with 1."""
    child = run("-m", "phong_bsdf", "doctor", path="/no/such/libLLVM.so")
    assert child.returncode == 1
    assert f"{'LLVM loaded by Dr.Jit':24}none" in child.stdout
    assert f"pip install {llvm.WHEEL}" in child.stdout
