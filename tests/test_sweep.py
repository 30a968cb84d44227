"""Sweeps: every combination has its row and its picture, and none is rendered twice."""

import csv
import os
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from phong_bsdf import sweep
from phong_bsdf.cli import main
from phong_bsdf.pictures import images
from phong_bsdf.scene import fingerprint, rendering

SCENE = """\
<scene version="3.0.0">
    <default name="kd" value="0.8"/>
    <default name="ks" value="0"/>
    <default name="width" value="12"/>
    <integrator type="whitted"/>
    <sensor type="perspective">
        <sampler type="independent"><integer name="sample_count" value="1"/></sampler>
        <film type="hdrfilm">
            <integer name="width" value="$width"/> <integer name="height" value="8"/>
            <string name="pixel_format" value="rgb"/> <rfilter type="box"/>
        </film>
    </sensor>
    <emitter type="point"><float name="intensity" value="2"/></emitter>
    <shape type="sphere">
        <point name="center" x="0" y="0" z="4"/>
        <bsdf type="phong"><rgb name="kd" value="$kd"/><float name="ks" value="$ks"/></bsdf>
    </shape>
</scene>
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder, with the scene above in `a.xml`."""
    monkeypatch.chdir(tmp_path)
    Path("a.xml").write_text(SCENE)
    return tmp_path


def run(*args):
    return CliRunner().invoke(main, ["sweep", "a.xml", *map(str, args)])


def table(folder):
    with open(folder / "sweep.csv", newline="") as file:
        return list(csv.DictReader(file))


# Values ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("5", ["5"]),
        ("0,.5,1", ["0", ".5", "1"]),
        ("1:1000:log4", ["1", "10", "100", "1000"]),
        ("-1:-100:log3", ["-1", "-10", "-100"]),
        ("0:1:lin5", ["0", "0.25", "0.5", "0.75", "1"]),
        ("3:1:lin3", ["3", "2", "1"]),
        ("2:9:lin1", ["2"]),
        ("0, 1:3:lin2 ,red", ["0", "1", "3", "red"]),
        ("0.9 0.3 0.2,1 1 1", ["0.9 0.3 0.2", "1 1 1"]),
    ],
)
def test_values(text, wanted):
    """Lists, ranges, words, and colours with spaces."""
    assert sweep.values(text) == wanted


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1:10", "no range"),
        ("1:10:5", "no range"),
        ("a:b:lin3", "no range"),
        ("1:2:lin0", "1 to 100000"),
        ("1:inf:lin3", "from number to number"),
        ("0:10:log3", "not 0, both of one sign"),
        ("-1:10:log3", "not 0, both of one sign"),
        ("1,,2", "empty value"),
    ],
)
def test_values_that_are_none(text, words):
    """Told with the form that is meant."""
    with pytest.raises(ValueError, match=words):
        sweep.values(text)


def test_file_names():
    """As written where that can be a name; else with digits that tell it from others; never elsewhere."""
    assert sweep.file_name([("km", ".5"), ("p", "10")]) == "km=.5,p=10.exr"
    odd = [sweep.file_name([("t", value)]) for value in ("../a b", "../a-b", "../a/b", "x" * 300, "x" * 301)]
    assert len(set(odd)) == 5
    assert all(os.path.basename(name) == name and len(name) < 130 and not name.startswith(".") for name in odd)


# What is written ---------------------------------------------------------------------------------------------------


def test_a_picture_and_a_row_for_each(folder):
    """The product of all lists, the last fastest; each picture as `render` would make it."""
    result = run("-D", "kd=0.2:0.8:lin2", "-D", "ks=0,1", "-D", "width=16", "-o", "out")
    assert (result.exit_code, result.output) == (0, "out/sweep.csv: 4 pictures\n")
    rows = table(folder / "out")
    assert [(r["kd"], r["ks"], r["width"]) for r in rows] == [(k, s, "16") for k in ("0.2", "0.8") for s in "01"]
    for row in rows:
        # What does not vary is not in the name.
        assert row["file"] == f"kd={row['kd']},ks={row['ks']}.exr"
        image = images.read_exr(folder / "out" / row["file"])
        loaded = rendering.load("a.xml", {name: row[name] for name in ("kd", "ks", "width")})
        assert np.array_equal(image, rendering.render(loaded).image)
        assert float(row["mean"]) == pytest.approx(image.mean(dtype=np.float64), rel=1e-12)
        assert float(row["seconds"]) > 0 and row["error"] == ""


def test_options_are_those_of_render(folder):
    """Size, samples, seed."""
    assert run("-D", "ks=0,1", "-o", "out", "--size", "6x4", "--spp", 2, "--seed", 3).exit_code == 0
    loaded = rendering.load("a.xml", {"ks": "1"})
    rendering.resize(loaded, 1, 6, 4)
    expected = rendering.render(loaded, spp=2, seed=3).image
    assert np.array_equal(images.read_exr(folder / "out/ks=1.exr"), expected)


def test_resumes(folder):
    """What is there is not rendered again; what is new, was lost, cut off, or shows something else now, is."""
    arguments = ("-D", "ks=0,1", "-o", "out")
    assert run(*arguments).exit_code == 0
    before = table(folder / "out")
    (folder / "out/ks=1.exr").unlink()
    result = run("-D", "ks=0,1,2", "-o", "out")
    assert result.output == "out/sweep.csv: 3 pictures, 1 of them from before\n"
    assert table(folder / "out")[0] == before[0]
    (folder / "out/ks=0.exr").write_bytes(b"")
    assert ", 2 of them from before" in run("-D", "ks=0,1,2", "-o", "out").output
    Path("a.xml").write_text(SCENE.replace('"$kd"', '"0.1"'))
    Path("a.xml").write_text(SCENE.replace('name="kd" value="0.8"', 'name="kd" value="0.3"'))
    assert "from before" not in run(*arguments).output
    assert "from before" not in run(*arguments, "--spp", 4).output
    assert float(table(folder / "out")[0]["mean"]) < float(before[0]["mean"])


def test_bad_combinations_are_rows(folder):
    """With their errors, found on reading or on loading; the rest is rendered; exit 1."""
    result = run("-D", "kd=0.5,red,-1", "-D", "ks=0,1", "-o", "out")
    assert result.exit_code == 1
    assert "2 pictures; 4 failed, the first with kd=red, ks=0: a.xml, line 16: could not parse RGB" in result.output
    rows = table(folder / "out")
    assert [bool(row["error"]) for row in rows] == [False, False, True, True, True, True]
    assert rows[4]["error"].startswith("a.xml, line 16: ") and rows[4]["file"] == rows[4]["mean"] == ""
    assert len(list((folder / "out").glob("*.exr"))) == 2


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("-D", "nothing=1,2"), "no <default> for nothing"),
        (("-D", "ks=1", "-D", "ks=2"), "given twice"),
        (("-D", "ks=1:2:3"), "no range"),
        (("-D", "ks=1:2:lin1000", "-D", "kd=1:2:lin1000"), "1000000 combinations"),
        ((), "say what to vary"),
        (("-D", "ks=1", "--task-timeout", "3"), "are for --cluster"),
        (("-D", "ks=1", "--cluster", "nowhere"), "neither local"),
    ],
)
def test_mistakes(folder, arguments, words):
    """Exit 2 before anything is rendered or written."""
    result = run(*arguments, "-o", "out")
    assert result.exit_code == 2 and words in result.output
    assert not Path("out").exists()


def test_parquet(folder):
    """The same rows; parameters are numbers where all values are, errors are null where there are none."""
    parquet = pytest.importorskip("pyarrow.parquet")
    assert run("-D", "kd=0.5 0.5 0.5,red", "-D", "ks=0,1", "-o", "out", "--parquet").exit_code == 1
    read = parquet.read_table(folder / "out/sweep.parquet").to_pydict()
    assert read["ks"] == [0.0, 1.0, 0.0, 1.0] and read["kd"][0] == "0.5 0.5 0.5"
    assert [error is None for error in read["error"]] == [True, True, False, False]
    assert read["mean"][0] == float(table(folder / "out")[0]["mean"]) and read["file"][2] is None


def test_large_files_are_read_once(folder, monkeypatch):
    """Not for each combination: meshes may be large, combinations many."""
    texture = '<texture name="kd" type="bitmap"><string name="filename" value="a.png"/></texture>'
    Path("a.xml").write_text(SCENE.replace('<rgb name="kd" value="$kd"/>', texture))
    images.write(folder / "a.png", np.full((2, 2, 3), 0.5, np.float32))
    read, file_hash = [], fingerprint.file_hash
    monkeypatch.setattr(fingerprint, "file_hash", lambda path: read.append(path) or file_hash(path))
    assert len(sweep.plan(Path("a.xml"), [("ks", "0:1:lin5")]).rows) == 5 and len(read) == 1


@pytest.mark.slow
def test_on_a_cluster(folder):
    """The same pictures bit by bit, the same errors, and neither run renders what the other has."""
    arguments = ("-D", "kd=0.5,-1", "-D", "ks=0,1,2", "-o")
    assert run(*arguments, "here").exit_code == 1
    result = run(*arguments, "there", "--cluster", "local:2")
    assert result.exit_code == 1, result.output
    rows = [
        [{k: v for k, v in row.items() if k != "seconds"} for row in table(folder / name)] for name in ("here", "there")
    ]
    assert rows[0] == rows[1] and len(rows[0]) == 6
    for file in (folder / "here").glob("*.exr"):
        assert np.array_equal(images.read_exr(file), images.read_exr(folder / "there" / file.name))
    assert "3 of them from before" in run(*arguments, "there").output


@pytest.mark.slow
def test_missing_file_on_a_cluster(folder):
    """A file that is not there, or must not be sent, fails the combination that names it, and no other."""
    texture = '<texture name="kd" type="bitmap"><string name="filename" value="$file"/></texture>'
    scene = SCENE.replace('<rgb name="kd" value="$kd"/>', texture).replace(
        'name="kd" value="0.8"', 'name="file" value=""'
    )
    Path("a.xml").write_text(scene)
    for name in ("here.png", "../there.png"):
        images.write(folder / name, np.full((2, 2, 3), 0.5, np.float32))
    result = run("-D", "file=here.png,none.png,../there.png", "-o", "out", "--cluster", "local:1")
    assert result.exit_code == 1, result.output
    errors = [row["error"] for row in table(folder / "out")]
    assert errors[0] == "" and "no file 'none.png'" in errors[1] and "lies outside of" in errors[2]
