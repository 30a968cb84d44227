"""Parts of a picture, and `phong-bsdf merge`: weighed by samples, in any order, and only what belongs together."""

import dataclasses
import json
import os
import re
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from click.testing import CliRunner

from phong_bsdf.cli import main
from phong_bsdf.pictures import images, parts
from phong_bsdf.pictures.parts import Samples, Subject

SUBJECT = Subject("ball.xml", "0123456789abcdef", (("p", "3"),), "path", "llvm_ad_rgb", 1, (8, 6), "phong_bsdf 1")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def image(seed):
    return np.random.default_rng(seed).uniform(0, 4, (6, 8, 3)).astype(np.float32)


def part(name, samples, subject=SUBJECT, pixels=None):
    """A file as `render` writes it."""
    pixels = image(samples.seed) if pixels is None else pixels
    images.write(Path(name), pixels, metadata=parts.metadata(subject, [samples]))
    return name


def merge(*args, code=0):
    """What the command says; of a mistake, which leaves no file, the one sentence."""
    before = sorted(os.listdir())
    result = CliRunner().invoke(main, ["merge", *map(str, args)])
    assert result.exit_code == code, result.output
    if code == 0:
        return result.stdout
    assert (result.stdout, sorted(os.listdir())) == ("", before)
    assert re.fullmatch(r"Error: [^\n]+\n", result.stderr), result.stderr
    return result.stderr


# The mean -----------------------------------------------------------------------------------------------------------


def test_weighed_by_samples(folder):
    """The mean of all samples, as double precision has it; and the result says how many there are."""
    files = [part(f"part_{k}.exr", Samples(spp, k)) for k, spp in ((1, 16), (2, 1), (3, 47))]
    said = merge(*files, "-o", "out.exr", "-o", "out.png")
    wanted = (16 * image(1).astype(float) + image(2) + 47 * image(3).astype(float)) / 64
    assert np.array_equal(images.read_exr("out.exr"), wanted.astype(np.float32))
    assert re.fullmatch(r"out\.exr, out\.png: 8 x 6, 64 spp of 3 parts, error \S+ %\n", said), said
    header = images.read_metadata("out.exr")
    assert (header["spp"], header["scene"], "seed" in header) == ("64", "ball.xml", False)
    assert np.array_equal(np.array(mi.Bitmap("out.png")), images.to_8bit(images.srgb(wanted)))


def test_order_of_arguments_does_not_matter(folder):
    """The same bytes, whatever a shell's pattern makes of the names. The numbers are such that sums differ by order."""
    rng = np.random.default_rng(5)
    # 1e30 + 1 - 1e30 is 0 or 1.
    values = rng.permuted(np.tile([1e30, -1e30, 1, 2, 3, 4], (48 * 3, 1)), axis=1)
    files = [part(f"part_{k}.exr", Samples(3, k), pixels=values[:, k].reshape(6, 8, 3)) for k in range(6)]
    found = set()
    for _ in range(6):
        merge(*rng.permutation(files), "-o", "out.exr")
        found.add(Path("out.exr").read_bytes())
    assert len(found) == 1


def test_merged_parts_can_be_merged_again(folder):
    """As jobs finish; a part that is in both is noticed."""
    files = [part(f"part_{k}.exr", Samples(2**k, k)) for k in range(4)]
    merge(*files, "-o", "all.exr")
    merge(*files[:2], "-o", "some.exr")
    merge("some.exr", *files[2:], "-o", "again.exr")
    # The mean of some is rounded to float32.
    np.testing.assert_allclose(images.read_exr("again.exr"), images.read_exr("all.exr"), rtol=2e-7)
    assert parts.read("again.exr").samples == parts.read("all.exr").samples
    assert "'part_1.exr' and 'some.exr'" in merge("some.exr", *files[1:], "-o", "no.exr", code=2)


def test_error_of_the_mean(folder):
    """From the spread of parts, weighed: what is left of noise of known size."""
    rng, sigma, errors = np.random.default_rng(0), 2.0, []
    for _ in range(20):
        mean = parts.WeightedMean()
        for spp in (4, 4, 8, 16, 32):
            mean.add((10 + rng.normal(0, sigma / np.sqrt(spp), (40, 50, 3))).astype(np.float32), spp)
        errors.append(mean.relative_error())
    # 6000 values and 4 degrees of freedom: 0.6 % each; 20 of them.
    assert np.mean(errors) == pytest.approx(sigma / np.sqrt(64) / 10, rel=0.01)


def test_no_error_of_one_part(folder):
    """It is unknown, not 0; and that of pictures without a number in them is unknown, too."""
    merge(part("a.exr", Samples(4, 1)), "-o", "out.exr")
    assert "1 part, error unknown" in merge("a.exr", "-o", "out.exr")
    part("b.exr", Samples(4, 2), pixels=np.full((6, 8, 3), np.nan, np.float32))
    assert "error unknown" in merge("a.exr", "b.exr", "-o", "out.exr")


# What does not belong together --------------------------------------------------------------------------------------

OTHERS = {
    "scene_hash": ("f" * 16, "another version of the scene 'ball.xml -D p=3' or of a file that it names"),
    "scene": (None, "scene 'cube.xml -D p=3', not 'ball.xml -D p=3'"),
    "defines": (None, "scene 'ball.xml -D p=4', not 'ball.xml -D p=3'"),
    "size": ((6, 8), "size 6 x 8, not 8 x 6"),
    "integrator": ("direct", "integrator direct, not path"),
    "variant": ("scalar_rgb", "variant scalar_rgb, not llvm_ad_rgb"),
    "camera": (2, "camera 2, not 1"),
    "versions": ("phong_bsdf 2", "versions phong_bsdf 2, not phong_bsdf 1; --mixed-versions merges all the same"),
}


@pytest.mark.parametrize("field", OTHERS)
def test_others_are_refused(folder, field):
    """Which file, of what, and what it should be."""
    value, said = OTHERS[field]
    change = {
        "scene": {"scene": "cube.xml", "scene_hash": "1" * 16},
        "defines": {"defines": (("p", "4"),), "scene_hash": "1" * 16},
    }.get(field, {field: value})
    files = [part(f"part_{k}.exr", Samples(4, k)) for k in (1, 2)]
    files.append(part("odd.exr", Samples(4, 3), dataclasses.replace(SUBJECT, **change)))
    assert merge(*files, "-o", "out.exr", code=2) == f"Error: 'odd.exr' does not belong to 'part_1.exr': {said}\n"


def test_mixed_versions(folder):
    """On request; the result names both, and other differences are still refused."""
    new = dataclasses.replace(SUBJECT, versions="phong_bsdf 2")
    files = [part("a.exr", Samples(4, 1)), part("b.exr", Samples(4, 2), new)]
    merge(*files, "-o", "out.exr", "--mixed-versions")
    assert parts.read("out.exr").subject.versions == "phong_bsdf 1; phong_bsdf 2"
    part("b.exr", Samples(4, 2), dataclasses.replace(new, camera=3))
    assert "camera 3, not 1" in merge(*files, "-o", "no.exr", "--mixed-versions", code=2)


def test_a_seed_twice(folder):
    """Also with other numbers of samples: they begin alike."""
    files = [part("a.exr", Samples(4, 7)), part("b.exr", Samples(8, 7))]
    assert merge(*files, "-o", "out.exr", code=2) == (
        "Error: 'b.exr' and 'a.exr' hold the same samples: seed 7; give each part its own --seed\n"
    )


def test_a_file_twice(folder):
    """By one name, by another, by a link."""
    part("a.exr", Samples(4, 7))
    os.symlink("a.exr", "link.exr")
    assert "'a.exr' is given twice" in merge("a.exr", "a.exr", "-o", "out.exr", code=2)
    assert "'link.exr' and 'a.exr' are the same file" in merge("a.exr", "link.exr", "-o", "out.exr", code=2)


def test_fixed_grids(folder):
    """They share samples with themselves and with grids an odd number of times as fine, and with no others."""
    named = {n: part(f"grid-{n}.exr", Samples(n * n, n, random=False), pixels=image(n)) for n in (1, 2, 3, 4, 6)}
    merge(named[2], named[3], named[4], "-o", "out.exr")
    said = merge(named[2], named[6], "-o", "no.exr", code=2)
    assert "hold the same samples" in said and "2 x 2" in said and "6 x 6" in said and "--seed changes nothing" in said
    part("again.exr", Samples(4, 99, random=False))
    said = merge(named[2], "again.exr", "-o", "no.exr", code=2)
    assert "the fixed grid of 2 x 2 samples. `whitted` uses no random numbers here" in said
    assert "hold the same" in merge(named[1], named[3], "-o", "no.exr", code=2)


def test_pictures_without_a_word(folder):
    """Pictures of other programs, of older versions, and what is no picture."""
    part("a.exr", Samples(4, 7))
    images.write(Path("plain.exr"), image(0))
    images.write(Path("half.exr"), image(0), metadata={"subject": json.dumps({"scene": "x"}), "samples": "[]"})
    known = json.dumps(dataclasses.asdict(SUBJECT))
    images.write(Path("none.exr"), image(0), metadata={"subject": known, "samples": "[]"})
    images.write(Path("odd.exr"), image(0), metadata={"subject": known, "samples": '[{"spp": 5, "random": false}]'})
    images.write(Path("a.png"), image(0))
    Path("text.exr").write_text("no picture")
    for name, said in {
        "plain.exr": "does not say which samples",
        "half.exr": "does not say which samples",
        "none.exr": "does not say which samples",
        "odd.exr": "does not say which samples",
        "a.png": "cannot be read as EXR",
        "text.exr": "cannot be read as EXR",
        "nix.exr": "there is no such file",
    }.items():
        assert re.match(rf"Error: '{re.escape(name)}'.* {said}", merge("a.exr", name, "-o", "no.exr", code=2))
    os.mkdir("empty")
    assert "'empty' holds no passes" in merge("empty", "-o", "no.exr", code=2)


@pytest.mark.parametrize("how", ["cut", "flipped"])
def test_broken_parts(folder, how):
    """A file that was cut short or changed on the way is named."""
    files = [part("a.exr", Samples(4, 1)), part("b.exr", Samples(4, 2))]
    whole = Path("b.exr").read_bytes()
    middle = len(whole) - 200
    flipped = whole[:middle] + bytes([whole[middle] ^ 16]) + whole[middle + 1 :]
    Path("b.exr").write_bytes(whole[:-60] if how == "cut" else flipped)
    assert merge(*files, "-o", "out.exr", code=2) == "Error: 'b.exr' is broken\n"


def test_result_is_no_part(folder):
    """A part is never overwritten."""
    part("a.exr", Samples(4, 1))
    assert "'a.exr' is one of the parts" in merge("a.exr", "-o", "./a.exr", code=2)
    assert "must end in .exr or .png" in merge("a.exr", "-o", "out.jpg", code=2)
