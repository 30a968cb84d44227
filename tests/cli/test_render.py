"""`phong-bsdf render`: what is asked for is written; every mistake is one sentence and leaves nothing."""

import os
import re
import subprocess
import sys
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import OpenEXR
import pytest
from click.testing import CliRunner

from helpers import SCENES
from phong_bsdf.cli import main
from phong_bsdf.host import machine
from phong_bsdf.pictures import images

COURSE = SCENES / "course/scene-3.xml"

# A lit sphere that fills part of the picture; its colour reaches above 1. Tests refer to its lines.
SCENE = """\
<scene version="3.0.0">
    <default name="kd" value="0.8, 0.4, 0.1"/>
    <default name="format" value="rgb"/>
    <integrator type="whitted"/>
    <sensor type="perspective">
        <sampler type="independent"><integer name="sample_count" value="1"/></sampler>
        <film type="hdrfilm">
            <integer name="width" value="12"/> <integer name="height" value="8"/>
            <string name="pixel_format" value="$format"/> <rfilter type="box"/>
        </film>
    </sensor>
    <emitter type="point"><float name="intensity" value="2"/></emitter>
    <shape type="sphere">
        <point name="center" x="0" y="0" z="4"/>
        <bsdf type="phong"><rgb name="kd" value="$kd"/></bsdf>
    </shape>
</scene>
"""


def phong_bsdf(*args):
    return CliRunner().invoke(main, ["render", *map(str, args)])


def child(*args, **options):
    """The command in a process of its own."""
    command = [sys.executable, "-m", "phong_bsdf", *map(str, args)]
    return subprocess.run(command, capture_output=True, text=True, **options)


def draw(*args):
    """Run a rendering that must succeed."""
    result = phong_bsdf(*args)
    assert (result.exit_code, result.stderr) == (0, ""), result.stderr or result.exception
    return result.stdout


def read_exr(path):
    """Height x width x channels, read by OpenEXR alone."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = file.channels()
        return np.stack([channels[name].pixels for name in "YRGBA" if name in channels], axis=-1)


def read_png(path):
    return np.atleast_3d(np.array(mi.Bitmap(str(path))))


def by_mitsuba(path, *, camera=1, spp=1, seed=0, **defines):
    scene = mi.load_file(str(path), **{name: str(value) for name, value in defines.items()})
    return np.atleast_3d(np.array(mi.render(scene, sensor=camera - 1, spp=spp, seed=seed)))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder, with the scene above in `a.xml`."""
    monkeypatch.chdir(tmp_path)
    Path("a.xml").write_text(SCENE)
    return tmp_path


# What is written --------------------------------------------------------------------------------------------


def test_exr_is_mitsubas_picture(folder):
    """The EXR holds, to the last bit, what `mi.render` gives, channel by channel."""
    draw("a.xml", "-o", "a.exr")
    picture = read_exr("a.exr")
    assert picture.dtype == np.float32
    assert np.array_equal(picture, by_mitsuba("a.xml"))
    assert picture.min() == 0 and picture.max() > 1
    assert picture[4, 6, 0] > picture[4, 6, 1] > picture[4, 6, 2]


@pytest.mark.parametrize(("format_", "channels"), [("luminance", "Y"), ("rgb", "BGR"), ("rgba", "ABGR")])
def test_channels_are_the_films(folder, format_, channels):
    """The EXR has the film's channels under their usual names, in 32 bits."""
    draw("a.xml", "-o", "a.exr", "-D", f"format={format_}")
    with OpenEXR.File("a.exr", separate_channels=True) as file:
        assert "".join(sorted(file.channels())) == channels
        assert {c.pixels.dtype for c in file.channels().values()} == {np.dtype("float32")}
    assert np.array_equal(read_exr("a.exr"), by_mitsuba("a.xml", format=format_))


@pytest.mark.parametrize("linear", [True, False])
@pytest.mark.parametrize("format_", ["luminance", "rgb", "rgba"])
def test_png_is_the_exr_in_8_bits(folder, linear, format_):
    """PNG is round(255 clamp(x)), x the value with `--linear`, else its sRGB encoding; alpha stays."""
    draw("a.xml", "-o", "a.exr", "-o", "a.png", "-D", f"format={format_}", *["--linear"] * linear)
    x = np.clip(read_exr("a.exr").astype(np.float64), 0, 1)
    if not linear:
        color = x[..., :3]
        x[..., :3] = np.where(color <= 0.0031308, 12.92 * color, 1.055 * color ** (1 / 2.4) - 0.055)
    png = read_png("a.png")
    assert png.dtype == np.uint8 and png.shape == x.shape
    # The encoding is computed in float32: 255 x may be off by 2e-5 before it is rounded.
    assert np.abs(png - 255 * x).max() <= 0.5 + 1e-4
    assert len(np.unique(png)) > 5


def test_files_beside_the_scene_are_found(folder):
    """Textures and meshes lie where the scene says, from wherever it is rendered."""
    scene = COURSE.parent / "textured.xml"
    draw(scene, "-o", "a.exr", "--size", "20x15")
    assert np.array_equal(read_exr("a.exr"), by_mitsuba(scene, width=20, height=15))


def test_several_outputs_in_one_run(folder):
    """Each `-o` is written, in any order, in upper case too, and with the permissions of any new file."""
    out = draw("a.xml", "-o", "a.PNG", "-o", "b.exr", "-o", "c.exr")
    assert out.startswith("a.PNG, b.exr, c.exr: ")
    assert np.array_equal(read_exr("b.exr"), read_exr("c.exr"))
    assert read_png("a.PNG").shape == (8, 12, 3)
    assert sorted(os.listdir()) == ["a.PNG", "a.xml", "b.exr", "c.exr"]
    assert {Path(p).stat().st_mode for p in ("a.PNG", "b.exr")} == {Path("a.xml").stat().st_mode}


def test_exr_tells_where_it_comes_from(folder):
    """The EXR's header names scene, variant, samples and seed."""
    draw("a.xml", "-o", "a.exr", "--spp", 4, "--seed", 7)
    with OpenEXR.File("a.exr") as file:
        said = [file.header()[name] for name in ("scene", "variant", "spp", "seed")]
    assert said == ["a.xml", "llvm_ad_rgb", "4", "7"]


# Options ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("camera", [1, 2, 3])
def test_camera(folder, camera):
    """`--camera` counts the scene's sensors from 1."""
    draw(COURSE, "-o", "a.exr", "-D", "width=40", "-D", "height=30", "--camera", camera)
    wanted = by_mitsuba(COURSE, camera=camera, width=40, height=30)
    assert np.array_equal(read_exr("a.exr"), wanted)
    others = [by_mitsuba(COURSE, camera=c, width=40, height=30) for c in {1, 2, 3} - {camera}]
    assert not any(np.array_equal(wanted, other) for other in others)


def test_size(folder):
    """`--size 40x30` makes the chosen camera's picture 40 wide and 30 high, as if its scene had said so."""
    out = draw(COURSE, "-o", "a.exr", "--size", "40x30", "--camera", 3)
    assert ": 40 x 30, " in out
    assert np.array_equal(read_exr("a.exr"), by_mitsuba(COURSE, camera=3, width=40, height=30))


def test_size_removes_a_crop_window(folder):
    """A picture of another size is the whole picture."""
    crop = '<integer name="crop_width" value="5"/> <integer name="crop_offset_x" value="3"/> <rfilter'
    Path("crop.xml").write_text(SCENE.replace("<rfilter", crop))
    draw("crop.xml", "-o", "crop.exr")
    assert read_exr("crop.exr").shape == (8, 5, 3)
    draw("crop.xml", "-o", "crop.exr", "--size", "6x4")
    draw("a.xml", "-o", "a.exr", "--size", "6x4")
    assert np.array_equal(read_exr("crop.exr"), read_exr("a.exr"))


def test_define(folder):
    """Each `-D name=value` replaces one default of the scene."""
    draw("a.xml", "-o", "a.exr", "-D", "kd=0, 0, 0.5", "-D", "format=rgba")
    picture = read_exr("a.exr")
    assert np.array_equal(picture, by_mitsuba("a.xml", kd="0, 0, 0.5", format="rgba"))
    assert picture.shape == (8, 12, 4)
    assert picture[4, 6, 2] > 2 * picture[4, 6, 0]


def test_spp_and_seed(folder):
    """`--spp` is the number of samples, `--seed` which ones: the same seed gives the same picture."""
    pictures = []
    for seed in (0, 1, 1):
        out = draw("a.xml", "-o", "a.exr", "--spp", 2, "--seed", seed)
        assert ", 2 spp, " in out
        pictures.append(read_exr("a.exr"))
        assert np.array_equal(pictures[-1], by_mitsuba("a.xml", spp=2, seed=seed))
    assert np.array_equal(pictures[1], pictures[2])
    assert not np.array_equal(pictures[0], pictures[1])


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_threads(folder, threads):
    """`-t` is the number of Dr.Jit's threads, but at least 2, since Mitsuba's textures hang with 1."""
    before = dr.thread_count()
    draw("a.xml", "-o", "a.exr", "-t", threads)
    try:
        assert dr.thread_count() == max(2, threads)
    finally:
        dr.set_thread_count(before)


def test_threads_are_the_cores_that_may_be_used(folder, monkeypatch):
    """A batch system that gives a part of a machine gets no more threads than that."""
    code = "import os; os.sched_setaffinity(0, [min(os.sched_getaffinity(0))]); from phong_bsdf.host import machine"
    child = subprocess.run([sys.executable, "-c", f"{code}; print(machine.cores())"], capture_output=True, text=True)
    assert child.stdout == "1\n", child.stderr
    before = dr.thread_count()
    monkeypatch.setattr(machine, "cores", lambda: 5)
    draw("a.xml", "-o", "a.exr")
    try:
        assert dr.thread_count() == 5
    finally:
        dr.set_thread_count(before)


@pytest.mark.parametrize("variant", ["scalar_rgb", "llvm_ad_mono", "llvm_ad_spectral"])
@pytest.mark.parametrize("spp", [1, 2])
def test_mode(folder, variant, spp):
    """`-m` chooses the variant."""
    out = draw("a.xml", "-o", "a.exr", "-m", variant, "--spp", spp)
    assert f", {variant}; " in out
    assert mi.variant() == variant
    assert np.array_equal(read_exr("a.exr"), by_mitsuba("a.xml", spp=spp))


@pytest.mark.slow
def test_default_mode_without_llvm(folder):
    """Without an LLVM the scene is rendered in scalar_rgb, with a warning that names the remedy."""
    result = child("render", "a.xml", "-o", "a.exr", env={**os.environ, "DRJIT_LIBLLVM_PATH": "/no/such.so"})
    assert result.returncode == 0, result.stderr
    assert ", scalar_rgb; " in result.stdout
    assert "Warning: no usable LLVM" in result.stderr and "pip install" in result.stderr
    mi.set_variant("scalar_rgb")
    assert np.array_equal(read_exr("a.exr"), by_mitsuba("a.xml"))


# What is said -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lights", [0, 1, 2])
def test_summary(folder, lights):
    """One line tells files, size, samples, lights, variant and seconds."""
    light = '<emitter type="point"><float name="intensity" value="2"/></emitter>'
    assert light in SCENE
    Path("a.xml").write_text(SCENE.replace(light, lights * light))
    out = draw("a.xml", "-o", "a.exr")
    wanted = (
        rf"a\.exr: 12 x 8, 1 spp, {lights} light{'' if lights == 1 else 's'}, llvm_ad_rgb; "
        r"loading \d+\.\d\d s, compiling \d+\.\d\d s, rendering \d+\.\d\d s\n"
    )
    assert re.fullmatch(wanted, out), out


@pytest.mark.slow
def test_quiet_in_a_pipe(folder):
    """Where no terminal listens, a good rendering writes its one line to stdout and nothing to stderr."""
    result = child("render", "a.xml", "-o", "a.exr")
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout.count("\n") == 1


def test_progress_on_a_terminal(folder):
    """On a terminal a progress bar shows loading and rendering, and is gone in the end."""
    pty = pytest.importorskip("pty", reason="no pseudo terminals on this system")
    reader, terminal = pty.openpty()
    command = [sys.executable, "-m", "phong_bsdf", "render", "a.xml", "-o", "a.exr"]
    env = {**os.environ, "TERM": "xterm", "COLUMNS": "100"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=terminal, env=env) as process:
        os.close(terminal)
        shown = b""
        # Linux reports the end of the terminal as an error.
        try:
            while part := os.read(reader, 4096):
                shown += part
        except OSError:
            pass
        out = process.stdout.read()
    os.close(reader)
    assert process.returncode == 0
    assert out.startswith(b"a.exr: 12 x 8") and out.count(b"\n") == 1
    assert b"loading" in shown and b"rendering" in shown and "━".encode() in shown
    # Cursor visible again, line cleared.
    assert shown.rindex(b"\x1b[?25h") > shown.rindex("━".encode())
    assert shown.endswith(b"\x1b[2K")


@pytest.mark.parametrize("args", [["--help"], ["-h"], ["render", "--help"], ["--version"]])
def test_python_m(args):
    """`python -m phong_bsdf` is the command, under its usual name."""
    result = child(*args)
    assert (result.returncode, result.stderr) == (0, "")
    assert "phong-bsdf" in result.stdout.splitlines()[0]


def test_help_lists_every_command_with_a_whole_sentence():
    """In the order of the page; none is cut."""
    result = CliRunner().invoke(main, ["--help"])
    listed = result.output.partition("Commands:")[2]
    assert re.findall(r"^  (\w+) ", listed, re.M) == list(main.commands)
    assert "..." not in listed and listed.count(".\n") == len(main.commands)


# Mistakes ---------------------------------------------------------------------------------------------------


def line_of(text):
    return SCENE[: SCENE.index(text)].count("\n") + 1


PHONG = '<bsdf type="phong"><rgb name="kd" value="$kd"/></bsdf>'
SENSOR = SCENE[SCENE.index("    <sensor") : SCENE.index("    <emitter")]

WHITTED = '<integrator type="whitted"/>'


def phong(parameter):
    return f'<bsdf type="phong">{parameter}</bsdf>'


# What is replaced in the scene, by what, and what the message says after the file and the line.
BAD_SCENES = {
    "malformed": ("</shape>", "", "mismatch"),
    "attribute without quotes": ('"phong"', "phong", "attribute"),
    "misspelt plugin": (
        PHONG,
        '<bsdf type="Blinn-Phong"/>',
        r"there is no bsdf 'Blinn-Phong' \(did you mean 'blinnphong'\?\)$",
    ),
    "unknown plugin": (WHITTED, '<integrator type="ray"/>', "there is no integrator 'ray'$"),
    "misspelt parameter": (
        PHONG,
        phong('<float name="k_s" value="1"/>'),
        r"'phong' has no parameter 'k_s' \(did you mean 'ks'\?\)$",
    ),
    "unknown parameter": (
        PHONG,
        phong('<float name="q" value="1"/>'),
        "'phong' has no parameter 'q'; it has kd, ks, p, ",
    ),
    "unknown parameters": (
        PHONG,
        phong('<float name="k_s" value="1"/><rgb name="q" value="1"/>'),
        r"'phong' has no parameters 'k_s' \(did you mean 'ks'\?\), 'q'; it has kd, ",
    ),
    "parameter of Mitsuba's": (
        '<emitter type="point">',
        '<emitter type="point"><float name="falloff" value="1"/>',
        "'point' has no parameter 'falloff'$",
    ),
    "twice the same parameter": (
        PHONG,
        phong('<rgb name="kd" value="1"/><float name="kd" value="0.5"/>'),
        "0.5 .*already$",
    ),
    "no pixels": ('name="height" value="8"', 'name="height" value="0"', "the film has no pixels"),
    "one surface inside of another": (PHONG, phong('<bsdf type="diffuse"/>'), "'phong' takes no SmoothDiffuse$"),
    "negative p": (PHONG, phong('<float name="p" value="-1"/>'), "'p' must be finite and >= 0, got -1"),
    "p is no number": (PHONG, phong('<float name="p" value="x"/>'), '"x"'),
    "p is a word": (PHONG, phong('<string name="p" value="x"/>'), "'p' must be finite and >= 0, got x"),
    "area light": (PHONG, PHONG + '<emitter type="area"/>', "'area'.*use the integrator 'path'"),
    "kind of plugin": (WHITTED, '<integrator type="phong"/>', 'type "bsdf"'),
    "max_depth": (
        WHITTED,
        '<integrator type="whitted"><integer name="max_depth" value="0"/></integrator>',
        "'max_depth' must be",
    ),
    "missing texture": (
        PHONG,
        phong('<texture name="kd" type="bitmap"><string name="filename" value="nix.png"/></texture>'),
        "nix.png.*No such file",
    ),
    "no integrator": (WHITTED, "", f"no integrator; add {WHITTED}"),
    "no sensor": (SENSOR, "", "no camera; add a <sensor"),
    "no scene": (SCENE, '<bsdf version="3.0.0" type="phong"/>', "no <scene>"),
    "empty file": (SCENE, "", "element"),
}


def fails(*args):
    """The one sentence that the command says when it fails; nothing else comes of it."""
    before = {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()}
    result = phong_bsdf(*args)
    assert isinstance(result.exception, SystemExit), repr(result.exception)
    assert (result.exit_code, result.stdout) == (2, "")
    assert {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()} == before
    assert re.fullmatch(r"Error: [^\n]+\n", result.stderr), result.stderr
    return result.stderr[len("Error: ") :].rstrip()


@pytest.mark.parametrize("case", BAD_SCENES)
def test_bad_scene(folder, case):
    """A mistake in the scene is named with its file and, where it has one, its line; no file is left."""
    old, new, message = BAD_SCENES[case]
    assert old in SCENE
    Path("bad.xml").write_text(SCENE.replace(old, new))
    said = fails("bad.xml", "-o", "a.exr", "-o", "a.png")
    # A tag that is not closed is noticed at the next one.
    line = line_of(old) + (case == "malformed")
    where = "bad.xml" if case.startswith("no ") else f"bad.xml, line {line}"
    assert re.match(f"{where}: .*{message}", said), said


# Further arguments of `render a.xml -o a.exr`, and what the message says.
BAD_OPTIONS = {
    "one of two outputs": (["-o", "a.tif"], "'a.tif': an image file must end in .exr or .png"),
    "no such folder": (["-o", "no/a.exr"], "'no/a.exr' cannot be written: No such file or directory"),
    "output is a folder": (["-o", "folder.exr"], "'folder.exr' is a folder"),
    "no suffix": (["-o", "a"], "'a': an image file must end in .exr or .png"),
    "-D unknown": (["-D", "nix=3", "-D", "no=4"], "a.xml: the scene has no <default> for nix=3, no=4; add "),
    "-D value": (["-D", "kd=x"], rf'a.xml, line {line_of("$kd")}: .*"x"'),
    "-D refused by a plugin": (["-D", "format=x"], rf"a.xml, line {line_of('<film')}: .*Found x"),
    "no such camera": (["--camera", "2"], "a.xml: there is no camera 2, the scene has 1"),
    "camera 0": (["--camera", "0"], "a.xml: there is no camera 0, the scene has 1"),
    "size of no camera": (["--camera", "2", "--size", "2x2"], "a.xml: there is no camera 2"),
    "unknown variant": (["-m", "nix"], "there is no variant 'nix'; this Mitsuba has scalar_rgb, "),
}


@pytest.mark.parametrize("case", BAD_OPTIONS)
def test_bad_option(folder, case):
    """An option that the scene, the machine or the disk cannot serve is one sentence; no file is left."""
    Path("folder.exr").mkdir()
    options, message = BAD_OPTIONS[case]
    said = fails("a.xml", "-o", "a.exr", *options)
    assert re.match(message, said), said


@pytest.mark.parametrize("scene", ["nix.xml", "."])
def test_no_such_scene(folder, scene):
    """A scene that is not there, or a folder, is named."""
    problem = "this is a folder" if scene == "." else "there is no such file"
    assert fails(scene, "-o", "a.exr") == f"{scene}: {problem}"


def test_mistake_in_an_included_file(folder):
    """A mistake in a file that the scene includes is named with that file and its line."""
    said = fails(COURSE, "-o", "a.exr", "-D", "width=x")
    assert re.search(r'cameras\.xml\W+line 26\b.*"x"', said), said


@pytest.mark.parametrize(
    "args",
    [
        [],
        ["--size", "3"],
        ["--size", "0x3"],
        ["--size", "3x-3"],
        ["--size", "9000000x3"],
        ["--spp", "0"],
        ["--seed", "-1"],
        ["--seed", str(2**32)],
        ["-t", "0"],
        ["-D", "kd"],
        ["-D", "=1"],
        ["--camera", "x"],
        ["--nix"],
    ],
)
def test_usage(folder, args):
    """A malformed option is explained in click's words, before anything is done."""
    result = phong_bsdf("a.xml", *(["-o", "a.exr", *args] if args else []))
    assert (result.exit_code, result.stdout, os.listdir()) == (2, "", ["a.xml"])
    assert re.match(r"Usage: .* render .*\n\nError: [^\n]*\n", result.stderr, re.DOTALL)
    assert (args or ["--output"])[0] in result.stderr


def test_mistake_in_a_process_of_its_own(folder):
    """Neither Mitsuba's log nor a traceback surrounds the sentence that a user sees."""
    Path("a.xml").write_text(SCENE.replace(PHONG, '<bsdf type="phong"><float name="p" value="-1"/></bsdf>'))
    result = child("render", "a.xml", "-o", "a.exr")
    assert (result.returncode, result.stdout) == (2, "")
    wanted = f"Error: a.xml, line {line_of(PHONG)}: phong: 'p' must be finite and >= 0, got -1.0\n"
    assert result.stderr == wanted


def test_unusable_variant(folder):
    """A variant that this machine cannot run is a mistake like others."""
    result = child("render", "a.xml", "-o", "a.exr", "-m", "llvm_ad_rgb",
                   env={**os.environ, "DRJIT_LIBLLVM_PATH": "/no/such.so"})  # fmt: skip
    assert (result.returncode, result.stdout, os.listdir()) == (2, "", ["a.xml"])
    # Dr.Jit itself has written of the library that it could not load.
    assert re.match(r"Error: .*LLVM", result.stderr.splitlines()[-1])


# Files whole or absent --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["a.exr", "a.png"])
@pytest.mark.parametrize("error", [OSError, RuntimeError])
def test_old_file_survives_a_failed_write(folder, monkeypatch, name, error):
    """Where writing fails halfway, the old file is untouched and no temporary file stays."""

    def fail(path, *_):
        Path(path).write_bytes(b"half a picture")
        raise error("no space left")

    monkeypatch.setattr(images, f"_write_{name[2:]}", fail)
    Path(name).write_bytes(b"old")
    assert "no space left" in fails("a.xml", "-o", name)


@pytest.mark.parametrize("name", ["a.exr", "a.png"])
def test_full_disk(folder, name):
    """A file that the system cuts short is a failure: the old file survives, not half of the new one."""
    pytest.importorskip("resource", reason="no limits on the size of a file on this system")
    Path(name).write_bytes(b"old")
    # The picture needs a few hundred bytes. Dr.Jit's kernels are written, too: they must be there before.
    code = (
        "import resource, sys; from phong_bsdf.cli import main\n"
        "try: main(['render', 'a.xml', '-o', 'first.exr'])\n"
        "except SystemExit: pass\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))\n"
        "main(['render', 'a.xml', *sys.argv[1:]])"
    )
    result = subprocess.run([sys.executable, "-c", code, "-o", name], capture_output=True, text=True)
    assert result.returncode == 2, result.stdout + result.stderr
    assert re.fullmatch(r"Error: [^\n]+\n", result.stderr)
    assert Path(name).read_bytes() == b"old"
    assert sorted(os.listdir()) == sorted(["a.xml", name, "first.exr"])


@pytest.mark.parametrize(("pixels", "channels"), [("luminance", 1), ("luminance_alpha", 2), ("rgb", 3), ("rgba", 4)])
def test_films_of_all_formats(folder, pixels, channels):
    """Grey and transparent films are written, too."""
    result = phong_bsdf("a.xml", "-o", "a.exr", "-o", "a.png", "-D", f"format={pixels}")
    assert result.exit_code == 0, result.stderr
    assert images.read_exr(Path("a.exr")).shape[2] == channels


def test_interrupt_leaves_nothing(folder, monkeypatch):
    """Ctrl-C while a file is written ends the command and leaves no half file."""

    def interrupt(path, *_):
        Path(path).write_bytes(b"half a picture")
        raise KeyboardInterrupt

    monkeypatch.setattr(images, "_write_exr", interrupt)
    result = phong_bsdf("a.xml", "-o", "a.exr")
    assert (result.exit_code, result.stdout, os.listdir()) == (1, "", ["a.xml"])
    assert "Traceback" not in result.stderr
