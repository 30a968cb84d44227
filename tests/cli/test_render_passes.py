"""`phong-bsdf render --passes`: what was finished is kept, however the run ended, and goes into the same picture."""

import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from helpers import ROOT
from phong_bsdf.cli import main
from phong_bsdf.cli import passes as command
from phong_bsdf.pictures import images, parts
from phong_bsdf.progressive import running

# Each of them is quick, all of them are not.
pytestmark = pytest.mark.slow

SCENE = ROOT / "scenes/compare/balls.xml"
MIRRORS = ROOT / "scenes/lecture/mirror-floor.xml"
OPTIONS = ("--size", "24x16", "--spp", "32", "--pass-spp", "4")
# Long enough to be stopped in the middle.
LONG = ("--size", "96x64", "--spp", "256", "--pass-spp", "4")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def render(*args, scene=SCENE, code=0):
    """The result of the command."""
    result = CliRunner().invoke(main, ["render", str(scene), *map(str, args)])
    assert result.exit_code == code, result.output
    return result


def fails(*args, scene=SCENE):
    """The one sentence of a mistake, which changes no file."""
    before = contents()
    said = render(*args, scene=scene, code=2).stderr
    assert contents() == before
    assert re.fullmatch(r"Error: [^\n]+\n", said), said
    return said[len("Error: ") :].rstrip()


def contents():
    """Everything but the locks, which are empty."""
    return {path: path.read_bytes() for path in Path().rglob("*") if path.is_file() and path.name != ".lock"}


def files(folder="d"):
    return sorted(path.name for path in Path(folder).glob("passes/picture/*"))


def start(*args, **options):
    """The command in a process of its own."""
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    line = [sys.executable, "-m", "phong_bsdf", "render", str(SCENE), *map(str, args)]
    return subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=env, **options)


def wait_for_passes(process, count, folder="d"):
    deadline = time.monotonic() + 60
    while len([name for name in files(folder) if name[0] != "."]) < count:
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.002)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The bytes of the picture in 64 passes, rendered without an interruption."""
    folder = tmp_path_factory.mktemp("whole")
    main(
        ["render", str(SCENE), "-o", str(folder / "a.exr"), *LONG, "--passes", str(folder / "d")], standalone_mode=False
    )
    return (folder / "a.exr").read_bytes()


# Without an accident ------------------------------------------------------------------------------------------------


def test_picture_is_the_mean_of_its_passes():
    """In the file of each are its samples and the scene; the picture says how many samples it has."""
    said = render("-o", "a.exr", "-o", "a.png", *OPTIONS, "--passes", "d", "--seed", 5).stdout
    assert re.fullmatch(
        r"a\.exr, a\.png: 24 x 16, 32 spp, 2 lights, llvm_ad_rgb; 8 passes of 4 spp, error \d\S* %; "
        r"loading \d+\.\d\d s, passes \d+\.\d\d s\n", said,
    ), said  # fmt: skip
    paths = sorted(Path("d/passes/picture").iterdir())
    assert len(paths) == 8
    mean = sum(images.read_exr(path).astype(float) for path in paths) / 8
    assert np.array_equal(images.read_exr("a.exr"), mean.astype(np.float32))
    found = [parts.read(path) for path in paths]
    assert {part.subject for part in found} == {parts.read("a.exr").subject} and found[0].samples[0].seed == 5
    assert images.read_metadata("a.exr")["spp"] == "32" and images.read_metadata(paths[3])["spp"] == "4"
    assert {"scene", "spp", "seed", "variant", "phong_bsdf", "subject"} <= images.read_metadata(paths[3]).keys()


def test_passes_cost_no_accuracy():
    """The picture is as near to the truth as that without passes: its mean is within the noise."""
    render("-o", "a.exr", *OPTIONS, "--passes", "d")
    render("-o", "b.exr", "--size", "24x16", "--spp", 32)
    a, b = images.read_exr("a.exr"), images.read_exr("b.exr")
    # Both have a relative standard error of some 10 % in each of 1152 values.
    assert a.mean() == pytest.approx(b.mean(), rel=0.03) and not np.array_equal(a, b)


def test_finished_passes_are_not_rendered_again(monkeypatch):
    """A second run reads them, and writes the same file."""
    render("-o", "a.exr", *OPTIONS, "--passes", "d")
    monkeypatch.setattr(running, "render_pass", None)
    said = render("-o", "b.exr", *OPTIONS, "--passes", "d", "--resume").stdout
    assert "8 passes of 4 spp, 8 of them from before" in said
    assert Path("a.exr").read_bytes() == Path("b.exr").read_bytes()


@pytest.mark.slow
def test_more_samples_later():
    """Four times as many: the passes that are there stay, and the picture is that of all at once."""
    render("-o", "a.exr", *OPTIONS, "--passes", "d")
    before = {name: Path("d/passes/picture", name).stat().st_mtime_ns for name in files()}
    said = render("-o", "b.exr", "--size", "24x16", "--spp", 128, "--passes", "d", "--resume").stdout
    assert "128 spp" in said and "32 passes of 4 spp, 8 of them from before" in said
    assert {name: Path("d/passes/picture", name).stat().st_mtime_ns for name in before} == before
    render("-o", "c.exr", "--size", "24x16", "--spp", 128, "--pass-spp", 4, "--passes", "e")
    assert Path("b.exr").read_bytes() == Path("c.exr").read_bytes()
    # And the first ones alone are still the first picture; without --spp, all are asked for.
    render("-o", "b.exr", *OPTIONS, "--passes", "d", "--resume")
    assert Path("b.exr").read_bytes() == Path("a.exr").read_bytes()
    render("-o", "b.exr", "--size", "24x16", "--passes", "d", "--resume")
    assert Path("b.exr").read_bytes() == Path("c.exr").read_bytes()


def test_merge_of_a_folder():
    """Is the picture, byte for byte; with passes of another seed it is that of both."""
    render("-o", "a.exr", *OPTIONS, "--passes", "d")
    render("-o", "b.exr", *OPTIONS, "--passes", "e", "--seed", 1)
    merged = CliRunner().invoke(main, ["merge", "d", "-o", "m.exr"])
    assert merged.exit_code == 0 and Path("m.exr").read_bytes() == Path("a.exr").read_bytes()
    both = CliRunner().invoke(main, ["merge", "e", "d", "-o", "m.exr"])
    assert "64 spp of 16 parts" in both.stdout
    mean = (images.read_exr("a.exr").astype(float) + images.read_exr("b.exr")) / 2
    # Each of the two is rounded to float32.
    np.testing.assert_allclose(images.read_exr("m.exr"), mean, rtol=1e-6)


def test_merge_of_what_is_there():
    """Jobs that have not finished a pass yet are no mistake, unless there is nothing at all."""
    render("-o", "a.exr", *OPTIONS, "--passes", "d")
    shutil.copytree("d", "e")
    shutil.rmtree("e/passes")
    for name in files()[2:]:
        os.remove(f"d/passes/picture/{name}")
    merged = CliRunner().invoke(main, ["merge", "e", "d", "-o", "m.exr"])
    assert "8 spp of 2 parts" in merged.stdout, merged.output
    merged = CliRunner().invoke(main, ["merge", "e", "-o", "n.exr"])
    assert (merged.exit_code, "no pass is finished" in merged.stderr, Path("n.exr").exists()) == (2, True, False)


def test_target_error():
    """Rendering ends as soon as the picture is good enough; the rest can follow."""
    said = render("-o", "a.exr", "--size", "24x16", "--spp", 4096, "--pass-spp", 4, "--passes", "d",
                  "--target-error", 12).stdout  # fmt: skip
    error = float(re.search(r"error (\S+) %", said)[1])
    count = len(files())
    assert 4 <= count < 1024 and error <= 12 and f"{4 * count} spp" in said
    again = render("-o", "b.exr", "--size", "24x16", "--passes", "d", "--resume", "--target-error", 12).stdout
    assert f"{count} of them from before" in again and Path("a.exr").read_bytes() == Path("b.exr").read_bytes()


def test_pictures_in_between(monkeypatch):
    """The output files are rewritten on the way, whole, and say of how many samples they are."""
    monkeypatch.setattr(command, "LEAST_SECONDS", 0)
    monkeypatch.setattr(command, "TIMES_WRITING", 0)
    seen, render_pass = [], running.render_pass

    def look(*args):
        if Path("a.exr").exists():
            seen.append((images.read_metadata("a.exr")["spp"], images.read_checked("a.exr").shape))
        return render_pass(*args)

    monkeypatch.setattr(running, "render_pass", look)
    render("-o", "a.exr", "-o", "a.png", *OPTIONS, "--passes", "d")
    assert seen == [(str(4 * k), (16, 24, 3)) for k in range(1, 8)]


def test_writing_in_between_costs_little():
    """Pictures are so far apart that writing them takes a fortieth of the time, or less."""
    assert command.TIMES_WRITING >= 40 and command.LEAST_SECONDS >= 1


def test_progress_on_a_terminal():
    """The bar tells the pass, and the error as soon as there is one."""
    pty = pytest.importorskip("pty", reason="no pseudo terminals on this system")
    reader, terminal = pty.openpty()
    env = {**os.environ, "TERM": "xterm", "COLUMNS": "100", "PYTHONPATH": str(ROOT)}
    line = [sys.executable, "-m", "phong_bsdf", "render", str(SCENE), "-o", "a.exr", *OPTIONS, "--passes", "d"]
    with subprocess.Popen(line, stdout=subprocess.PIPE, stderr=terminal, env=env) as process:
        os.close(terminal)
        shown = b""
        # Linux reports the end of the terminal as an error.
        with contextlib.suppress(OSError):
            while part := os.read(reader, 4096):
                shown += part
        process.stdout.read()
    os.close(reader)
    assert process.returncode == 0
    assert re.search(rb"pass \d+ of 8, error \d", shown), shown[-2000:]


# Accidents ----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_kill_in_the_middle(whole):
    """kill -9, several times, at moments that nobody chose: the picture is the same, bit by bit."""
    resume, counts = [], []
    for count in (3, 11, 20):
        process = start("-o", "a.exr", *LONG, "--passes", "d", *resume)
        wait_for_passes(process, count)
        process.kill()
        process.communicate()
        counts.append(len([name for name in files() if name[0] != "."]))
        resume = ["--resume"]
    assert counts[-1] < 64
    said = render("-o", "a.exr", *LONG, "--passes", "d", "--resume").stdout
    assert 20 <= int(re.search(r"(\d+) of them from before", said)[1]) == counts[-1], said
    assert Path("a.exr").read_bytes() == whole
    assert len(files()) == 64 and not [name for name in files() if name.startswith(".")]


@pytest.mark.slow
def test_ctrl_c(whole):
    """Says how many passes are kept and how to go on, exit code 1; and it goes on."""
    process = start("-o", "a.exr", *LONG, "--passes", "d")
    wait_for_passes(process, 5)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    kept = len(files())
    # Mitsuba may have said on stdout that it heard the signal, too.
    assert process.returncode == 1 and kept >= 5 and "spp" not in out
    wanted = f"Stopped: {kept} of 64 passes are in 'd', and the same command with --resume goes on from there\n"
    assert wanted in err and "Traceback" not in err
    render("-o", "a.exr", *LONG, "--passes", "d", "--resume")
    assert Path("a.exr").read_bytes() == whole


def test_half_files_do_not_count():
    """What a killed run was writing is removed, beside the output as well; files of others stay."""
    render("-o", "a.exr", *OPTIONS, "--passes", "d")
    Path("d/passes/picture/.000004-spp-repeat-007-abcd1234.exr").write_bytes(b"half")
    Path(".a-abcd1234.exr").write_bytes(b"half")
    Path(".ab-abcd1234.exr").write_bytes(b"another's")
    os.remove("d/passes/picture/000004-spp-repeat-007.exr")
    said = render("-o", "b.exr", "-o", "a.exr", *OPTIONS, "--passes", "d", "--resume").stdout
    assert "7 of them from before" in said
    assert sorted(os.listdir()) == [".ab-abcd1234.exr", "a.exr", "b.exr", "d"] and len(files()) == 8


@pytest.mark.parametrize("how", ["cut", "empty", "flipped", "of another scene"])
def test_broken_passes_are_rendered_again(how):
    """And named; the picture is what it was."""
    render("-o", "a.exr", *OPTIONS, "--passes", "d")
    path = Path("d/passes/picture/000004-spp-repeat-002.exr")
    before, pixels = path.read_bytes(), images.read_checked(path)
    if how == "of another scene":
        render("-o", "b.exr", *OPTIONS, "--passes", "e", scene=MIRRORS, code=0)
        shutil.copy(sorted(Path("e/passes/picture").iterdir())[2], path)
    else:
        # Near the end, where the pixels are.
        flipped = before[:-100] + bytes([before[-100] ^ 4]) + before[-99:]
        path.write_bytes({"cut": before[:-100], "empty": b"", "flipped": flipped}[how])
    result = render("-o", "b.exr", *OPTIONS, "--passes", "d", "--resume")
    assert "7 of them from before" in result.stdout
    assert re.fullmatch(rf"Warning: '{path}' is [^\n]+; it is rendered again\n", result.stderr), result.stderr
    assert Path("b.exr").read_bytes() == Path("a.exr").read_bytes()
    assert np.array_equal(images.read_checked(path), pixels)
    assert "8 of them from before" in render("-o", "b.exr", *OPTIONS, "--passes", "d", "--resume").stdout


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root can mount a small disk")
def test_full_disk():
    """An error that says so; what fitted is kept, and with more room the picture is as if there always had been."""
    os.mkdir("disk")
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=48k", "tmpfs", "disk"], capture_output=True).returncode:
        pytest.skip("no disk can be mounted here")
    try:
        said = render("-o", "a.exr", *OPTIONS, "--passes", "disk/d", code=2).stderr
        wanted = (
            r"Error: '[^']+\.exr' could not be written: No space left on device; [1-7] of 8 passes are in 'disk/d', "
            r"and the same command with --resume goes on from there\n"
        )
        assert re.fullmatch(wanted, said), said
        kept = files("disk/d")
        assert 1 <= len(kept) < 8 and not any(name.startswith(".") for name in kept) and not Path("a.exr").exists()
        subprocess.run(["mount", "-o", "remount,size=4m", "disk"], check=True, capture_output=True)
        said = render("-o", "a.exr", *OPTIONS, "--passes", "disk/d", "--resume").stdout
        assert f"{len(kept)} of them from before" in said
    finally:
        subprocess.run(["umount", "disk"], check=True)
    render("-o", "b.exr", *OPTIONS, "--passes", "d")
    assert Path("a.exr").read_bytes() == Path("b.exr").read_bytes()


def test_two_runs_at_once():
    """The second one is refused."""
    from phong_bsdf.pictures.store import Store

    with Store("d").opened():
        assert "another run is writing there" in fails("-o", "a.exr", *OPTIONS, "--passes", "d")


# Mistakes -----------------------------------------------------------------------------------------------------------

OTHERS = {
    "size": (["--size", "20x10"], r"size 20 x 10, not 24 x 16"),
    "seed": (["--seed", "3"], r"seed 3, not 0"),
    "pass-spp": (["--pass-spp", "8"], r"passes of 8 spp, not 4"),
    "variant": (["-m", "scalar_rgb"], r"variant scalar_rgb, not llvm_ad_rgb"),
    "defines": (["-D", "max_depth=2"], r"scene 'balls\.xml -D max_depth=2', not 'balls\.xml'"),
}


@pytest.mark.parametrize("case", OTHERS)
def test_passes_of_another_picture(case):
    """Are refused, with what differs; nothing is changed."""
    render("-o", "a.exr", *OPTIONS, "--passes", "d")
    options, said = OTHERS[case]
    wanted = rf"this is another picture than that of the passes in 'd': {said}\. Choose another folder"
    assert re.fullmatch(wanted, fails("-o", "b.exr", *OPTIONS, *options, "--passes", "d", "--resume"))


def test_passes_that_are_there():
    """Are not used unless the user says so."""
    render("-o", "a.exr", *OPTIONS, "--passes", "d")
    said = fails("-o", "b.exr", *OPTIONS, "--passes", "d")
    assert said == "'d' holds 8 of 8 passes already; go on with them: --resume, or choose another folder"


def test_resume_of_nothing():
    """Begins: a script may always say --resume."""
    assert "from before" not in render("-o", "a.exr", *OPTIONS, "--passes", "d", "--resume").stdout


@pytest.mark.parametrize("option", [["--resume"], ["--pass-spp", "4"], ["--target-error", "1"]])
def test_options_of_passes(option):
    """Without a folder they would mean nothing."""
    assert fails("-o", "a.exr", *option) == (
        f"{option[0]} is for a picture in passes; say where to keep them: --passes DIR"
    )


def test_folder_that_cannot_be():
    """Is a mistake before anything is rendered."""
    Path("file").write_text("x")
    assert "is no folder" in fails("-o", "a.exr", *OPTIONS, "--passes", "file")
    assert "cannot be both" in fails("-o", "a.exr", *OPTIONS, "--passes", "./a.exr")


def test_a_finer_grid():
    """`whitted` pictures of other numbers of samples have other samples."""
    options = ("-o", "a.exr", "--size", "24x16", "--passes", "d")
    render(*options, "--spp", 16, scene=MIRRORS)
    said = fails(*options, "--spp", 64, "--resume", scene=MIRRORS)
    assert "a grid of 8 x 8 samples, not a grid of 4 x 4 samples" in said


# The document -------------------------------------------------------------------------------------------------------


def bash(text, **variables):
    """A script of docs/clusters.md, with the scene of the tests; what it says."""
    Path("bin").mkdir(exist_ok=True)
    Path("bin/phong-bsdf").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m phong_bsdf "$@"\n')
    os.chmod("bin/phong-bsdf", 0o755)
    env = {**os.environ, "PYTHONPATH": str(ROOT), "PATH": f"{os.getcwd()}/bin:{os.environ['PATH']}", **variables}
    done = subprocess.run(["bash", "-e", "-c", text], capture_output=True, text=True, env=env)
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    return done.stdout


@pytest.mark.slow
def test_documented_jobs():
    """The array of jobs and both ways to merge, as docs/clusters.md has them; only the picture is smaller."""
    shutil.copy(SCENE, "scene.xml")
    text = (ROOT / "docs/clusters.md").read_text()
    job, merge, preemptible, merge_folders = re.findall(r"```bash\n(.*?)```", text, re.S)[:4]
    for script in (job, preemptible):
        small = script.replace("--spp 256", "--spp 16 --size 24x16")
        assert small != script
        for k in (1, 2):
            bash(small, SLURM_ARRAY_TASK_ID=str(k))
    assert "32 spp of 2 parts" in bash(merge) and Path("picture.png").is_file()
    assert "32 spp of 8 parts" in bash(merge_folders)
