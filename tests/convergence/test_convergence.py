"""`phong-bsdf converge`: what is rendered, kept and resumed, and what is refused. Small pictures, real renderings."""

import csv
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from click.testing import CliRunner

from phong_bsdf.cli import main
from phong_bsdf.convergence import conclusions, measuring, planning, study, tradeoff
from phong_bsdf.pictures import images, metrics
from phong_bsdf.pictures.store import Store
from phong_bsdf.scene import rendering

SCENE = """\
<scene version="3.0.0">
    <default name="ks" value="0.5"/>
    <integrator type="path"><integer name="max_depth" value="3"/></integrator>
    <sensor type="perspective">
        <film type="hdrfilm"><rfilter type="box"/><string name="pixel_format" value="rgb"/>
            <integer name="width" value="20"/> <integer name="height" value="14"/>
        </film>
    </sensor>
    <emitter type="{light}"/>
    <shape type="sphere">
        <point name="center" x="0" y="0" z="4"/>
        <bsdf type="phong"><float name="ks" value="$ks"/> <float name="kd" value="0.4"/></bsdf>
    </shape>
    <shape type="sphere"><point name="center" x="0" y="-101" z="4"/><float name="radius" value="100"/>
        <bsdf type="diffuse"><texture type="bitmap" name="reflectance"><string name="filename" value="t.png"/></texture>
        </bsdf>
    </shape>
</scene>
"""
TWO = ("--method", "path", "--method", "path-lobe")
FAST = ("--spp", "1,4", "--repeats", "3")


@pytest.fixture
def scene(tmp_path, monkeypatch):
    """The current folder, with a sky-lit ball on a textured floor."""
    monkeypatch.chdir(tmp_path)
    images.write(Path("t.png"), np.full((2, 2, 3), 0.3))
    Path("a.xml").write_text(SCENE.format(light="constant"))
    return tmp_path


def command(*args):
    return CliRunner().invoke(main, ["converge", *map(str, args)])


def converge(*args, code=0):
    """Run a study that must end with `code`; its JSON."""
    result = command("a.xml", "-o", "out", *args)
    assert result.exit_code == code, result.stderr or result.exception
    return json.loads(Path("out/convergence.json").read_text())


def made():
    """Every pass on disk -> when it was written."""
    return {path: path.stat().st_mtime_ns for path in Path("out/passes").glob("*/[0-9]*.exr")}


@pytest.mark.slow
def test_study_end_to_end(scene):
    """The defaults of a scene: each method has its passes, its errors are those of its pictures, and all is written."""
    found = converge(*FAST)
    names = [method["name"] for method in found["run"]["methods"]]
    assert names == ["path", "direct", "path-cosine", "path-lobe", "path-stratified", "path-multijitter",
                     "path-ldsampler", "path-roughplastic"]  # fmt: skip
    assert [r["name"] for r in found["references"]] == ["path", "path-roughplastic"]
    # ldsampler rounds 1 to 4.
    assert len(found["rows"]) == 3 * (2 * 7 + 1)
    assert {p.name for p in Path("out").iterdir()} >= {"index.html", "passes.csv", "relmse.svg", "pictures", "run.json"}
    with open("out/passes.csv") as file:
        lines = list(csv.DictReader(file))
    assert [float(line["relmse"]) for line in lines] == [row["relmse"] for row in found["rows"]]
    for row in found["rows"]:
        assert row["scene_hash"] and row["machine"] and "Mitsuba 3.9" in row["versions"] and row["variant"]
        assert row["seconds"] > 0 and row["nonfinite"] == 0
        # The interval is of the mean over the passes; some are outside.
        assert row["relmse_low"] < row["relmse_high"]
    assert found["relmse_epsilon"] == metrics.EPSILON


@pytest.mark.slow
def test_errors_are_those_of_the_pictures(scene):
    """Recomputed from the files: mean of (x - r)^2 / (r^2 + epsilon), less the reference's own noise."""
    found = converge(*FAST, *TWO)
    store = Store(Path("out"))
    run = planning.read_run(store)
    reference = run.references[0]
    truth = np.stack([store.image(reference.key, p) for p in store.list(reference.key)]).astype(np.float64)
    assert truth.shape == (planning.REFERENCE_PASSES, 14, 20, 3)
    mean = truth.mean(axis=0)
    weight = 1 / (mean**2 + metrics.EPSILON)
    noise = np.mean(weight * truth.var(axis=0, ddof=1)) / len(truth)
    for row in found["rows"]:
        key = next(method.key for method in run.methods if method.name == row["method"])
        p = next(p for p in store.list(key) if (p.spp, p.repeat) == (row["spp"], row["repeat"]))
        difference = store.image(key, p).astype(np.float64) - mean
        assert row["relmse"] == pytest.approx(np.mean(weight * difference**2) - noise, rel=1e-6)
        assert row["max_error"] == pytest.approx(np.abs(difference).max(), rel=1e-6)
        if metrics.has_flip():
            assert row["flip"] == pytest.approx(metrics.flip(difference + mean, mean), rel=1e-5)


@pytest.mark.slow
def test_passes_are_renderings_of_their_seeds(scene):
    """Each file is the picture that the same method, samples and seed give; no seed is used twice."""
    converge(*FAST, *TWO)
    store = Store(Path("out"))
    run = planning.read_run(store)
    seeds = [p.seed for m in (*run.methods, *run.references) for p in store.list(m.key)]
    assert len(seeds) == len(set(seeds)) == 12 + planning.REFERENCE_PASSES
    # References, and only they, have the bit that keeps their samples apart from every method's.
    assert all(p.seed >= measuring.REFERENCE_SEED for p in store.list(run.references[0].key))
    assert all(p.seed < measuring.REFERENCE_SEED for m in run.methods for p in store.list(m.key))
    p = store.list(run.methods[0].key)[-1]
    again = rendering.render(rendering.load(Path("a.xml")), spp=p.spp, seed=p.seed).image
    assert np.array_equal(metrics.colors(again), store.image(run.methods[0].key, p))


@pytest.mark.slow
def test_next_run_goes_on(scene):
    """More repeats, levels and methods add passes; those on disk stay as they are. `--from` renders nothing."""
    converge("--spp", "4", "--repeats", "2", "--method", "path")
    before = made()
    # The same levels: the reference, too, is there.
    found = converge("--spp", "4", "--repeats", "3", *TWO)
    after = made()
    assert before.items() <= after.items() and len(after) - len(before) == 4
    assert len(found["rows"]) == 6
    again = command("--from", "out")
    assert again.exit_code == 0 and made() == after
    assert json.loads(Path("out/convergence.json").read_text())["rows"] == found["rows"]


@pytest.mark.slow
def test_killed_run_goes_on(scene):
    """`kill -9` loses the pass under way at most, and the study ends with the numbers of an undisturbed one."""
    arguments = ["a.xml", "--spp", "4,16", "--repeats", "3", *TWO]
    child = subprocess.Popen([sys.executable, "-m", "phong_bsdf", "converge", *arguments, "-o", "out"])
    limit = time.monotonic() + 60
    while len(made()) < planning.REFERENCE_PASSES + 3 and time.monotonic() < limit and child.poll() is None:
        time.sleep(0.002)
    child.send_signal(signal.SIGKILL)
    assert child.wait() == -signal.SIGKILL
    before = made()
    assert planning.REFERENCE_PASSES + 3 <= len(before) < planning.REFERENCE_PASSES + 12
    # What it was writing when it was killed, in the worst case.
    leftover = next(iter(before)).parent / ".half.exr"
    leftover.write_bytes(b"half a file")
    assert command("--from", "out").exit_code in (0, 1)
    resumed = converge(*arguments[1:])
    assert before.items() <= made().items() and not leftover.exists()
    os.rename("out", "resumed")
    undisturbed = converge(*arguments[1:])
    for a, b in zip(resumed["rows"], undisturbed["rows"], strict=True):
        assert (a["method"], a["spp"], a["seed"]) == (b["method"], b["spp"], b["seed"])
        # Threads add up the samples of a pixel in any order.
        assert a["relmse"] == pytest.approx(b["relmse"], rel=1e-6)


@pytest.mark.slow
def test_method_that_fails_is_reported(scene):
    """`whitted` refuses area lights, with file and line; the others go on. The exit code is 1."""
    lamp = '<shape type="sphere"><point name="center" x="3" y="3" z="0"/><emitter type="area"/></shape>'
    Path("a.xml").write_text(SCENE.format(light="constant").replace("</scene>", f"{lamp}</scene>"))
    found = converge(*FAST, "--method", "whitted=integrator=whitted", "--method", "path", code=1)
    whitted, path = found["results"]
    assert "area" in whitted["failure"] and whitted["levels"] == []
    assert path["failure"] is None and len(path["levels"]) == 2
    said = command("--from", "out")
    assert said.exit_code == 1 and "whitted failed: a.xml, line 18: " in said.stdout
    assert "whitted failed: " in Path("out/index.html").read_text()
    # Once it can be rendered, it is.
    Path("a.xml").write_text(SCENE.format(light="point"))
    assert all(
        result["failure"] is None for result in converge(*FAST, "--method", "whitted", "--method", "path")["results"]
    )


def test_any_exception_of_a_method_is_a_failure(scene, monkeypatch):
    """Plugins in Python may raise anything; only what the disk says ends a run."""
    monkeypatch.setattr(planning, "REFERENCE_PASSES", 1)
    planned = planning.plan(Path("a.xml"), given=[("path", {}), ("direct", {})], levels=(1,), repeats=1)
    store, real = Store(Path("out")), measuring._Session._pass

    def made(self, loaded, key, *args, **more):
        if key.startswith("direct"):
            raise KeyError("k_s")
        real(self, loaded, key, *args, **more)

    monkeypatch.setattr(measuring._Session, "_pass", made)
    with store.opened():
        measuring.measure(planned, store)
        path, direct = planned.run.methods
        assert store.failure(direct.key) == "KeyError: 'k_s'" and store.list(direct.key) == []
        assert store.failure(path.key) is None and len(store.list(path.key)) == 1
        monkeypatch.setattr(Store, "add", lambda *args: (_ for _ in ()).throw(OSError("disk full")))
        with pytest.raises(OSError, match="disk full"):
            measuring.measure(planning.plan(Path("a.xml"), given=[("path", {})], seed=1), store)


@pytest.mark.parametrize("text", ("{", "[]", '{"methods": []}'))
def test_broken_record_of_a_run_is_named(scene, text):
    """Nothing is drawn; the sentence says what to do."""
    Path("out").mkdir()
    Path("out/run.json").write_text(text)
    said = command("--from", "out")
    assert said.exit_code == 2 and "run.json' is nothing that this version wrote; measure again" in said.stderr


def test_text_longer_than_a_file_name(scene):
    """A value of the scene that no file can be named after is no file."""
    other = Path("a.xml").read_text().replace("</scene>", '<shape type="sphere" id="%s"/></scene>' % ("x" * 300))
    for value in (other, Path("a.xml").read_text().replace("t.png", "x" * 300)):
        Path("b.xml").write_text(value)
        assert planning.plan(Path("b.xml"), given=[("path", {})]).run.scene_hash


def test_integrator_with_more_channels(scene):
    """Its picture has the channels of `aov` beside the colour; a study is made of the colour alone."""
    integrator = '<integrator type="aov"><string name="aovs" value="d:depth"/><integrator type="path"/></integrator>'
    path = '<integrator type="path"><integer name="max_depth" value="3"/></integrator>'
    Path("b.xml").write_text(Path("a.xml").read_text().replace(path, integrator))
    loaded = rendering.load(Path("b.xml"))
    made = rendering.render(loaded, spp=1)
    colour = "".join(made.channels).removesuffix("d.T")
    assert made.channels == (*colour, "d.T") and colour in ("RGB", "RGBA")
    assert np.array_equal(rendering.render(loaded, spp=1, color=True).image, made.image[..., :-1])


@pytest.mark.slow
def test_time_budget(scene):
    """Out of time it stops with what there is, says what is missing, and the same command goes on."""
    arguments = ("--spp", "4,4096", "--repeats", "3", "--method", "path")
    found = converge(*arguments, "--time-budget", "0.2")
    assert len(found["rows"]) < 6
    # A reference of fewer passes than asked for is one all the same.
    assert measuring.LEAST_REFERENCE_PASSES <= found["references"][0]["passes"] < planning.REFERENCE_PASSES
    said = command("--from", "out").stdout
    assert f"{6 - len(found['rows'])} of 6 passes are missing" in said


@pytest.mark.slow
def test_method_without_a_pass_has_not_failed(scene):
    """It is said to be missing, not to have failed: no exit code 1."""
    found = converge("--spp", "4", "--repeats", "2", "--method", "path", "--time-budget", "1e-9")
    assert found["rows"] == [] and found["results"][0]["failure"] is None
    said = command("--from", "out")
    assert said.exit_code == 0 and "2 of 2 passes are missing" in said.stdout and "not measured yet" in said.stdout
    assert "failed" not in said.stdout and "failed" not in Path("out/index.html").read_text()


@pytest.mark.slow
def test_reference_from_a_file(scene):
    """All methods are measured against the picture that the user gives, which counts as exact."""
    image = rendering.render(rendering.load(Path("a.xml")), spp=4096).image
    images.write(Path("ref.exr"), image)
    found = converge(*FAST, *TWO, "--reference", "ref.exr")
    assert [(r["name"], r["kind"], r["relmse"]) for r in found["references"]] == [("ref.exr", "file", None)]
    assert {result["reference"] for result in found["results"]} == {"ref.exr"}
    assert not list(Path("out/passes").glob("*reference*"))
    # Without its own noise taken out, the error is the plain one.
    store = Store(Path("out"))
    key = planning.read_run(store).methods[0].key
    p = store.list(key)[0]
    assert found["rows"][0]["relmse"] == pytest.approx(metrics.errors(store.image(key, p), image).relmse, rel=1e-5)


@pytest.mark.slow
def test_whitted_is_measured_against_a_finer_grid(scene):
    """Without noise: all repeats are the same picture; the reference is a grid with no sample of a coarser one."""
    Path("a.xml").write_text(
        SCENE.format(light="point").replace(
            '<integrator type="path"><integer name="max_depth" value="3"/></integrator>', '<integrator type="whitted"/>'
        )
    )
    found = converge(*FAST, "--method", "whitted")
    (reference,) = found["run"]["references"]
    assert (reference["kind"], reference["levels"]) == ("grid", [64, 16])
    result = found["results"][0]
    for level in result["levels"]:
        assert level["relmse"]["low"] == pytest.approx(level["relmse"]["high"], rel=1e-9)
        assert level["variance"]["value"] == pytest.approx(0, abs=1e-12)
    assert result["efficiency"] is None and result["verdict"] in ("falling", "reference", "biased")


def test_references_are_finer_than_all_methods(scene):
    """Whatever numbers of samples each method has of its own, and in whichever order they come."""
    for given in ([("path", {"spp": "256"}), ("direct", {})], [("direct", {}), ("path", {"spp": "256"})]):
        (reference,) = planning.plan(Path("a.xml"), given=given, levels=(1, 4)).run.references
        assert set(reference.levels) == {planning.REFERENCE_SPP * 256}
        assert len(reference.levels) == planning.REFERENCE_PASSES
    fine, coarse = ("whitted", {"spp": "64"}), ("coarse", {"integrator": "whitted", "spp": "1"})
    Path("a.xml").write_text(
        SCENE.format(light="point").replace('<integrator type="path">', '<integrator type="whitted">')
    )
    for given in ([fine, coarse], [coarse, fine]):
        # The samples of random methods do not refine a grid.
        (reference,) = planning.plan(Path("a.xml"), given=given).run.references
        assert reference.levels == (32**2, 16**2)


def test_grids_share_no_sample():
    """The centres of an n x n grid are on no reference grid that can follow from n."""
    for n in range(1, 33):
        across = planning.reference_grid(n * n)
        assert across >= planning.REFERENCE_GRID * n
        centres = {(2 * i + 1) / (2 * n) for i in range(n)}
        assert not centres & {(2 * i + 1) / (2 * across) for i in range(across)}


def test_interleaved(scene, monkeypatch):
    """Each method makes one pass at each level before any makes its second; references come first."""
    order = []
    monkeypatch.setattr(Store, "add", lambda self, key, p, image: order.append((key.split("-")[0:2], p.spp, p.repeat)))
    planned = planning.plan(Path("a.xml"), given=[("path", {}), ("direct", {})], levels=(1, 4), repeats=2)
    measuring.measure(planned, Store(Path("out")))
    references, passes = order[: planning.REFERENCE_PASSES], order[planning.REFERENCE_PASSES :]
    assert [repeat for *_, repeat in references] == list(range(planning.REFERENCE_PASSES))
    assert [(spp, repeat) for _, spp, repeat in passes] == [(1, 0), (4, 0)] * 2 + [(1, 1), (4, 1)] * 2
    assert len({key[0] for key, *_ in passes[:4]}) == 2


def test_first_rendering_and_compiling_are_not_timed(scene, monkeypatch):
    """A scene's first rendering, and one that compiles, is made again; what it took longer is its warm-up."""
    calls, made = [], []

    def timed(loaded, camera, spp, seed):
        calls.append(spp)
        compiled = spp == 16 and calls.count(16) == 1
        seconds = {1: 3.0, 2: 0.5}[calls.count(spp)] + 0.25 * spp
        return rendering.Rendering(np.zeros((2, 2, 3)), "none", spp, seed, 1, 0.0, seconds, compiled), seconds

    monkeypatch.setattr(measuring, "timed_rendering", timed)
    monkeypatch.setattr(Store, "add", lambda self, key, p, image: made.append(p))
    planned = planning.plan(Path("a.xml"), given=[("path", {})], levels=(1, 4, 16), repeats=1)
    monkeypatch.setattr(measuring._Session, "make_reference", lambda self, reference: None)
    measuring.measure(planned, Store(Path("out")))
    assert calls == [1, 1, 4, 16, 16]
    assert [(p.seconds, p.seconds_warmup) for p in made] == [(0.75, 2.5), (4.0, 0.0), (4.5, 2.5)]


def test_hash_follows_all_that_a_picture_depends_on(scene):
    """Defines, files that the scene names, size, camera and seed: not comments, and not the folder."""

    def key(**options):
        planned = planning.plan(Path("a.xml"), options.pop("defines", None), given=[("path", {})], **options)
        return planned.run.methods[0].key

    first = key()
    assert key() == first
    assert len({first, key(defines={"ks": "0.6"}), key(size=(10, 7)), key(seed=1)}) == 4
    Path("a.xml").write_text(Path("a.xml").read_text().replace("<emitter", "<!-- a sky -->\n<emitter"))
    assert key() == first
    # What is measured beside it does not matter.
    assert key(levels=(1, 64), repeats=9) == first
    images.write(Path("t.png"), np.full((2, 2, 3), 0.31))
    assert key() != first


@pytest.mark.parametrize(
    ("arguments", "said"),
    (
        (("b.xml", "-o", "out"), "there is no such file"),
        (("a.xml",), "-o DIR"),
        ((), "give a scene"),
        (("a.xml", "-o", "out", "--lobes"), "give a scene, --lobes, or --from"),
        (("a.xml", "--from", "out"), "give no scene"),
        (("--from", "nowhere"), "no run.json here"),
        (("a.xml", "-o", "a.xml"), "is no folder"),
        (("a.xml", "-o", "out", "--spp", "1,x"), "write it as 1,4,16"),
        (("a.xml", "-o", "out", "--spp", "0"), "write it as 1,4,16"),
        (("a.xml", "-o", "out", "--method", "x"), "there is no method 'x'"),
        (("a.xml", "-o", "out", "--method", "x=fast"), "name=key=value"),
        (("a.xml", "-o", "out", "--camera", "2"), "there is no camera 2"),
        (("a.xml", "-o", "out", "--reference", "none.exr"), "'none.exr' cannot be read"),
        (("a.xml", "-o", "out", "--reference", "small.exr"), "is 4 x 3, the pictures are 20 x 14"),
        (("a.xml", "-o", "out", "-D", "kd=1"), "no <default>"),
    ),
)
def test_mistakes_cost_no_rendering(scene, arguments, said):
    """Exit code 2, one sentence, and nothing is written."""
    images.write(Path("small.exr"), np.zeros((3, 4, 3)))
    result = command(*arguments)
    assert result.exit_code == 2 and said in result.stderr
    assert not Path("out").exists() and Path("a.xml").is_file()


def test_without_scipy(scene, monkeypatch):
    """The remedy is named before anything is rendered."""
    monkeypatch.setitem(sys.modules, "scipy", None)
    result = command("a.xml", "-o", "out")
    assert result.exit_code == 2 and "pip install 'phong-bsdf[report]'" in result.stderr


@pytest.mark.slow
def test_full_disk(scene):
    """One sentence; no half file; and with room again the run goes on."""
    limited = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000))\n"
        "import signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "from phong_bsdf.cli import main; main(sys.argv[1:])"
    )
    arguments = ["converge", "a.xml", "-o", "out", "--spp", "1", "--repeats", "2", "--method", "path",
                 "--size", "200x140"]  # fmt: skip
    child = subprocess.run([sys.executable, "-c", limited, *arguments], capture_output=True, text=True)
    assert child.returncode == 2 and re.search(r"Error: 'out/.*\.exr' could not be written", child.stderr), child.stderr
    assert not made() and not list(Path("out/passes").glob("*/.*"))
    assert len(converge(*arguments[4:])["rows"]) == 2


@pytest.mark.slow
def test_pixels_that_are_no_numbers_are_reported(scene):
    """Counted on the terminal, in the rows and on the page; no error is formed where they are."""
    mi.Bitmap(np.full((2, 2, 3), np.inf, np.float32)).write("infinite.exr")
    Path("a.xml").write_text(SCENE.format(light="constant").replace("</scene>", """
        <shape type="sphere"><point name="center" x="0" y="1" z="3"/><float name="radius" value="0.3"/>
            <bsdf type="diffuse"><texture type="bitmap" name="reflectance"><boolean name="raw" value="true"/>
                <string name="filename" value="infinite.exr"/></texture></bsdf></shape></scene>"""))  # fmt: skip
    found = converge(*FAST, "--method", "path")
    assert all(row["nonfinite"] > 0 and row["relmse"] is None for row in found["rows"])
    assert "no numbers" in Path("out/index.html").read_text()
    assert "no numbers" in command("--from", "out").stdout


@pytest.mark.slow
@pytest.mark.parametrize("variant", ("llvm_ad_mono", "scalar_rgb"))
def test_other_variants(scene, variant):
    """Pictures of one channel, and variants without kernels."""
    found = converge("--size", "10x8", "--spp", "1,4", "--repeats", "3", *TWO, "-m", variant)
    assert len(found["rows"]) == 12 and {row["variant"] for row in found["rows"]} == {variant}
    assert all(row["relmse"] > 0 for row in found["rows"] if row["spp"] == 1)
    channels = 1 if variant.endswith("mono") else 3
    assert images.read_exr(Path("out/pictures/path.exr")).shape == (8, 10, channels)


@pytest.mark.parametrize(
    ("slow", "time", "chosen"), (((2.0, 8.0), 4.0, (64, 1)), ((16.0, 64.0), 16.0, (64, 1)), ((1.5, 3.0), 3.0, (64, 64)))
)
def test_pictures_at_equal_time(slow, time, chosen):
    """The longest time that all were given; where there is none, the shortest of the slowest."""

    def result(name, times):
        spread = [study.Spread(t, t, t) for t in times]
        nothing = [None] * 6
        levels = tuple(study.Level(n, 1, s, 0.0, *nothing, 0) for n, s in zip((1, 64), spread, strict=True))
        passes = tuple(study.PassErrors(n, 0, None, None, None, None, 0) for n in (1, 64))
        return study.Result(name, "r", None, levels, passes, None, None, None, None, "unknown")

    found, shown = conclusions._at_equal_time([result("fast", (1.0, 4.0)), result("slow", slow)])
    assert found == time and tuple(s.spp for s in shown) == chosen


def test_conclusions_of_nothing(scene):
    """A folder in which nothing has been rendered yet has a page that says so."""
    store = Store(Path("out"))
    planned = planning.plan(Path("a.xml"), given=[("path", {})])
    with store.opened():
        planning.write_run(store, planned.run)
    found, pictures = conclusions.conclude(store, planning.read_run(store))
    assert pictures == {} and found.results[0].levels == () and isinstance(found.equal_time, tradeoff.Table)
    result = command("--from", "out")
    assert result.exit_code == 0 and "not measured yet" in result.stdout
