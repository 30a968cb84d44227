"""docs/gallery.md: every scene, its picture, its XML and a sentence; the pictures are those of the scenes."""

import importlib.util
import re

import numpy as np
import pytest
from PIL import Image

from helpers import ROOT
from phong_bsdf.pictures import images

SCENES = sorted(path for path in (ROOT / "scenes").rglob("*.xml") if path.name != "cameras.xml")

specification = importlib.util.spec_from_file_location("gallery", ROOT / "docs/gallery.py")
gallery = importlib.util.module_from_spec(specification)
specification.loader.exec_module(gallery)

PAGE = gallery.PAGE.read_text(encoding="utf-8")


def test_page_is_current():
    """`make gallery` would write the same text, and `make docs` has nothing to render."""
    assert gallery.page() == PAGE and gallery.changed() == []


def test_what_changed_is_rendered_again(monkeypatch):
    """A scene that the page shows otherwise, and one without its picture; the others are left alone."""
    first, last = SCENES[0], SCENES[-1]
    entry, file = gallery.entry, gallery.picture_file
    monkeypatch.setattr(gallery, "entry", lambda path: entry(path) + " more" * (path == first))
    assert gallery.changed() == [first]
    monkeypatch.setattr(gallery, "entry", lambda path: "")
    monkeypatch.setattr(gallery, "picture_file", lambda path: file(path) if path != last else file(path) / "gone")
    assert gallery.changed() == [last]


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_scene_is_in_the_gallery(path):
    """With a picture that is there, a sentence from its header, and its XML as it stands, or how it begins."""
    name = path.relative_to(ROOT).as_posix()
    found = re.search(
        rf"!\[[^\]]+\]\((\S+)\)\n\n([^\n]+)\n\n<details><summary>{re.escape(name)}(, the first \d+ of \d+ lines)?"
        r"</summary>\n\n```xml\n(.*?)```",
        PAGE,
        re.S,
    )
    picture, sentence, shortened, xml = found.groups()
    assert (gallery.PAGE.parent / picture).is_file()
    text = path.read_text(encoding="utf-8")
    assert sentence.endswith(".") and sentence in " ".join(text.split())
    assert text.startswith(xml) if shortened else text == xml


def test_pictures_are_few_and_small():
    """One for each scene, all together less than 1.5 MB."""
    pictures = sorted(gallery.PICTURES.iterdir())
    assert pictures == sorted(map(gallery.picture_file, SCENES))
    assert sum(picture.stat().st_size for picture in pictures) < 1.5e6


@pytest.mark.parametrize("name", ("lecture/models", "lecture/mirror-floor", "course/scene-6", "stress/exponents"))
def test_picture_is_that_of_the_scene(name):
    """Rendered again, to one step of 8 bits: `whitted` has no noise, but another machine rounds otherwise."""
    path = ROOT / f"scenes/{name}.xml"
    written = np.array(Image.open(gallery.picture_file(path)).convert("RGB")).astype(int)
    off = np.abs(images.to_8bit(images.srgb(gallery.picture(path))) - written).max(axis=-1)
    assert written.std() > 5
    # Edges.
    assert (off > 1).mean() < 1e-3
