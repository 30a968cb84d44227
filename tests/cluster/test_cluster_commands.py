"""`--cluster`: the same files and pictures as without it, whatever happens to workers and to the command itself."""

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import psutil
import pytest
from click.testing import CliRunner

from helpers import SCENES
from helpers.dask_processes import PATIENCE, Processes, end, processes, python, until
from phong_bsdf.cli import clusters, main
from phong_bsdf.cluster.connection import address, connected
from phong_bsdf.pictures import images

pytestmark = pytest.mark.usefixtures("limited")

BALLS = SCENES / "compare/balls.xml"
FLOOR = SCENES / "lecture/mirror-floor.xml"

# Eight passes of about half a second each.
PICTURE = (BALLS, "--size", "160x120", "--spp", 512, "--pass-spp", 64)


def run(*args):
    return CliRunner().invoke(main, [*map(str, args)])


def drawn(*args):
    result = run("render", *args)
    assert result.exit_code == 0, result.output or result.exception
    return result.output


def command(*args):
    """The same in a process of its own."""
    return python("phong_bsdf", *args, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def passes(folder):
    return sorted((folder / "passes/picture").glob("0*.exr"))


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """The picture, and its passes, made by one process without a cluster."""
    folder = tmp_path_factory.mktemp("alone")
    drawn(*PICTURE, "-o", folder / "a.exr", "--passes", folder / "passes")
    return folder


def same(alone, folder):
    """Whether picture and passes are those of `alone`: the picture to the last byte of its file."""
    assert (folder / "a.exr").read_bytes() == (alone / "a.exr").read_bytes()
    ours, theirs = passes(folder / "passes"), passes(alone / "passes")
    assert [p.name for p in ours] == [p.name for p in theirs] and len(ours) == 8
    return all(np.array_equal(images.read_exr(a), images.read_exr(b)) for a, b in zip(ours, theirs, strict=True))


def test_waiting_is_said_without_a_bar(monkeypatch, capsys):
    """In a batch job that waits for workers, a line says so, after some seconds and once."""
    shown = []
    wait = clusters.Choice(None, None, None).waiting(lambda what, share: shown.append(what))
    wait("waiting for workers")
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(clusters, "QUIET", 0)
    for _ in range(3):
        wait("waiting for workers")
    assert capsys.readouterr().err == "Waiting for workers\n" and len(shown) == 4


@pytest.mark.slow
def test_worker_is_killed_while_it_renders(two, alone, tmp_path):
    """The picture is the same, to the last byte."""
    client = command(
        "render", *PICTURE, "-o", tmp_path / "a.exr", "--passes", tmp_path / "passes", "--cluster", two.url
    )
    try:
        until(lambda: passes(tmp_path / "passes"))
        # Not its helper, which minds semaphores.
        max(psutil.Process(two.started[1].pid).children(), key=lambda p: p.cpu_times().user).kill()
        assert client.wait(PATIENCE) == 0, client.stdout.read()
    finally:
        end(client)
    assert same(alone, tmp_path)


@pytest.mark.slow
def test_client_is_killed(two, alone, tmp_path):
    """What had come is not rendered again by the same command with --resume, and the picture is the same."""
    arguments = ("render", *PICTURE, "-o", tmp_path / "a.exr", "--passes", tmp_path / "passes", "--cluster", two.file)
    client = command(*arguments)
    try:
        until(lambda: len(passes(tmp_path / "passes")) >= 2)
        client.send_signal(signal.SIGKILL)
    finally:
        end(client)
    kept = {path: path.stat().st_mtime_ns for path in passes(tmp_path / "passes")}
    assert run(*arguments).exit_code == 2
    result = run(*arguments, "--resume")
    assert result.exit_code == 0 and f"{len(kept)} of them from before" in result.output, result.output
    assert all(path.stat().st_mtime_ns == time for path, time in kept.items())
    assert same(alone, tmp_path)


@pytest.mark.slow
def test_interrupted(tmp_path):
    """Ctrl-C ends a local cluster with all its processes, says what was kept, and exits with 1."""
    client = command("render", *PICTURE, "--spp", 16384, "-o", tmp_path / "a.exr", "--passes", tmp_path / "passes",
                     "--cluster", "local:2")  # fmt: skip
    try:
        until(lambda: passes(tmp_path / "passes"))
        family = psutil.Process(client.pid).children(recursive=True)
        # As a terminal does: to all of them.
        for member in [psutil.Process(client.pid), *family]:
            member.send_signal(signal.SIGINT)
        said = client.communicate(timeout=PATIENCE)[0]
    finally:
        end(client)
    assert client.returncode == 1 and "go" in said and "--resume" in said, said
    assert "Traceback" not in said
    until(lambda: not any(member.is_running() for member in family))


@pytest.mark.slow
def test_broken_pass_is_rendered_again(two, alone, tmp_path):
    """A file that was cut off is named, and its pass comes from the cluster; so is a pass that was deleted."""
    shutil.copytree(alone / "passes", tmp_path / "passes")
    passes(tmp_path / "passes")[2].write_bytes(b"half")
    passes(tmp_path / "passes")[5].unlink()
    result = run("render", *PICTURE, "-o", tmp_path / "a.exr", "--passes", tmp_path / "passes", "--resume",
                 "--cluster", two.url)  # fmt: skip
    assert result.exit_code == 0, result.output
    assert "repeat-002.exr' is broken; it is rendered again" in result.stderr
    assert same(alone, tmp_path)


@pytest.mark.slow
def test_grid_of_whitted(two, tmp_path):
    """Without random numbers passes are parts of the grid; the size of a pass is chosen, and the folder beside the
    picture."""
    said = drawn(FLOOR, "--size", "60x40", "--spp", 16, "-o", tmp_path / "a.exr", "--cluster", two.url)
    (folder,) = tmp_path.glob("a.passes")
    spp = int(passes(folder)[0].name[:6])
    assert f"passes of {spp} spp" in said or "1 pass of" in said or "1 passes of" in said
    drawn(
        FLOOR, "--size", "60x40", "--spp", 16, "-o", tmp_path / "b.exr", "--passes", tmp_path / "b", "--pass-spp", spp
    )
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()


@pytest.mark.slow
def test_pictures_are_checked(two, tmp_path):
    """The same grades and pages as here, of good, wrong, unreadable and missing pictures."""
    scene = SCENES / "course/scene-2.xml"
    drawn(scene, "--size", "60x48", "--linear", "-o", tmp_path / "right.png")
    drawn(scene, "--size", "60x48", "-o", tmp_path / "wrong.png")
    (tmp_path / "bad.png").write_bytes(b"no")
    pictures = [tmp_path / f"{name}.png" for name in ("right", "wrong", "bad", "none")]
    arguments = ("check", *pictures, scene, "--size", "60x48", "--linear")
    here = run(*arguments, "--html", tmp_path / "here")
    there = run(*arguments, "--html", tmp_path / "there", "--cluster", two.url)
    said = there.stdout.replace(str(tmp_path / "there"), str(tmp_path / "here"))
    assert (there.exit_code, said) == (here.exit_code, here.stdout) and here.exit_code == 1
    files = [sorted(p.name for p in (tmp_path / name).iterdir()) for name in ("here", "there")]
    assert files[0] == files[1] and len(files[0]) == 5


@pytest.mark.slow
def test_references_come_from_the_cluster(two, tmp_path, monkeypatch):
    """Bit by bit those that are rendered here; what is timed is timed here."""
    # The page takes longer than all of that.
    monkeypatch.setattr(sys.modules["phong_bsdf.cli.converge"], "_draw", lambda store, show: False)
    arguments = ("converge", BALLS, "--size", "24x18", "--spp", "1", "--repeats", 2, "--method", "path", "-o")
    assert run(*arguments, tmp_path / "here").exit_code == 0
    result = run(*arguments, tmp_path / "there", "--cluster", two.url)
    assert result.exit_code == 0, result.output
    found = sorted((tmp_path / "here/passes").glob("*/*.exr"))
    assert len(found) == 18
    for path in found:
        other = tmp_path / "there/passes" / path.parent.name / path.name
        assert np.array_equal(images.read_exr(path), images.read_exr(other))


@pytest.fixture
def elsewhere(tmp_path):
    """A command for what is to run in a network of its own, which is another machine for all that it can tell; the
    addresses of this one and that one."""
    if os.geteuid() or not all(map(shutil.which, ("ip", "nsenter", "unshare"))):
        pytest.skip("network namespaces need root")
    # It is gone with the process that lives in it. Numbers, so that several runs of the tests can do this at once.
    number = os.getpid()
    here, there = (f"10.{64 + number % 128}.{number // 128 % 256}.{last}" for last in (1, 2))
    holder = subprocess.Popen(["unshare", "--net", "sleep", str(10 * PATIENCE)])
    try:
        inside = ("nsenter", "--net", "--target", str(holder.pid))
        own = os.readlink("/proc/self/ns/net")
        until(lambda: holder.poll() is not None or os.readlink(f"/proc/{holder.pid}/ns/net") != own)
        link = f"phong{number}"
        for words in (
            f"ip link add {link} type veth peer name phong netns {holder.pid}",
            f"ip addr add {here}/24 dev {link}",
            f"ip link set {link} up",
            f"{' '.join(inside)} ip addr add {there}/24 dev phong",
            f"{' '.join(inside)} ip link set phong up",
            f"{' '.join(inside)} ip link set lo up",
        ):
            if subprocess.run(words.split()).returncode:
                pytest.skip("networks cannot be made here")
        yield inside, here, there
    finally:
        end(holder)


@pytest.mark.slow
def test_two_machines(elsewhere, tmp_path):
    """A worker on another one: both render, and the picture is the same."""
    inside, here, there = elsewhere
    group = Processes(tmp_path, host=here)
    try:
        group.scheduler()
        group.worker()
        group.worker(there, inside)
        with connected(address(group.url)) as cluster:
            until(lambda: cluster.workers() == {here: 1, there: 1})
        arguments = (FLOOR, "--size", "60x40", "--spp", 16, "--pass-spp", 1)
        said = drawn(*arguments, "-o", tmp_path / "a.exr", "--cluster", group.url)
        assert "16 passes of 1 spp" in said
        drawn(*arguments, "-o", tmp_path / "b.exr", "--passes", tmp_path / "b")
        assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()
    finally:
        group.end()


@pytest.mark.slow
def test_tls(tmp_path):
    """With certificates all goes encrypted; without them nobody gets in."""
    if not shutil.which("openssl"):
        pytest.skip("needs openssl")
    key, certificate = tmp_path / "key.pem", tmp_path / "cert.pem"
    subprocess.run(["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-keyout", key, "-out", certificate,
                    "-days", "2", "-subj", "/CN=127.0.0.1"], check=True, capture_output=True)  # fmt: skip
    tls = [part for name, file in (("ca", certificate), ("cert", certificate), ("key", key)) for part in
           (f"--tls-{name}", file)]  # fmt: skip
    names = {"--tls-ca": "--tls-ca-file"}
    with processes(tmp_path, 1, *(names.get(part, part) for part in tls), "--protocol", "tls") as group:
        assert group.url.startswith("tls://")
        arguments = (FLOOR, "--size", "30x20", "--spp", 4, "-o", tmp_path / "a.exr", "--cluster", group.url)
        drawn(*arguments, *tls)
        refused = run("render", *arguments[:-1], group.url.replace("tls", "tcp"), "--passes", tmp_path / "b")
        assert refused.exit_code == 2 and "does not answer" in refused.output


@pytest.mark.slow
def test_examples_of_the_documents(tmp_path, monkeypatch):
    """The commands of docs/clusters.md that need no other machine."""
    text = (SCENES.parent / "docs/clusters.md").read_text().partition("## Dask")[2]
    lines = [line for block in re.findall(r"```bash\n(.*?)```", text, re.DOTALL) for line in block.splitlines()]
    assert [line.split()[1] for line in lines] == ["render", "sweep"]
    monkeypatch.chdir(tmp_path)
    scene = FLOOR.read_text().replace('value="900"', 'value="30"').replace('value="600"', 'value="20"')
    scene = scene.replace('<float name="p" value="60"/>', '<float name="p" value="$p"/>')
    Path("scene.xml").write_text(scene.replace("<default", '<default name="p" value="60"/> <default', 1))
    for line in lines:
        result = run(*shlex.split(line)[1:])
        assert result.exit_code == 0, result.output
    assert images.read_exr("picture.exr").shape == (20, 30, 3)
    assert len(list(Path("sweep").glob("*.exr"))) == 12
