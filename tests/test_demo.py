"""`phong-bsdf demo`: the lecture's pictures, and scenes to begin with."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from helpers import SCENES
from phong_bsdf import demo
from phong_bsdf.cli import main, session

LECTURE = sorted((SCENES / "lecture").glob("*.xml"))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(*args):
    return CliRunner().invoke(main, ["demo", *args])


def test_pictures_and_scenes(folder):
    """One picture for each of the lecture's scenes, which it names and explains; the scenes are there to be changed."""
    result = run()
    assert result.exit_code == 0, result.stderr
    assert {p.name for p in Path("demo").iterdir()} == {f"{p.stem}.{kind}" for p in LECTURE for kind in ("png", "xml")}
    for scene in LECTURE:
        assert Path("demo", scene.name).read_text() == scene.read_text()
        assert np.asarray(Image.open(f"demo/{scene.stem}.png")).std() > 20
    assert "demo/lights.png: Light is additive: a red, a green and a blue light on white balls\n" in result.stdout


def test_falloff_is_shown_without_and_with_it(folder):
    """Two pictures in one: above, all balls are lit alike; below, the far ones are darker."""
    picture = next(p.image for p in demo.draw() if p.scene.stem == "falloff")
    without, with_ = np.split(picture, 2)
    right = slice(3 * picture.shape[1] // 4, None)
    assert np.abs(without - with_).max() > 0.1
    assert with_[:200, right].max() < 0.6 * without[:200, right].max()


def test_a_changed_scene_is_kept(folder):
    """A second demo does not undo what somebody has changed."""
    Path("demo").mkdir()
    Path("demo/lights.xml").write_text("mine")
    assert run("-o", "demo").exit_code == 0
    assert Path("demo/lights.xml").read_text() == "mine" and Path("demo/models.xml").is_file()


def test_its_advice_can_be_copied(folder, monkeypatch):
    """Also by who calls it by its path, as `make demo` does."""
    assert run().stdout.endswith("then: phong-bsdf render demo/models.xml -o new.png\n")
    monkeypatch.setattr("sys.argv", [".venv/bin/phong-bsdf"])
    monkeypatch.setenv("PATH", "")
    assert session.to_copy("render", "a b.xml") == ".venv/bin/phong-bsdf render 'a b.xml'"


def test_a_bad_folder(folder):
    """One sentence, exit code 2, before anything is rendered."""
    Path("file").write_text("")
    result = run("-o", "file")
    assert (result.exit_code, result.stdout) == (2, "") and result.stderr.startswith("Error: 'file' cannot be written")
