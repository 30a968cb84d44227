"""Renders every scene of scenes/ small, and writes docs/gallery.md with the pictures: `make gallery`.

What is said about a scene is the first sentence of its header comment. With `--changed`, as `make docs` has it, only
scenes that the page shows otherwise, or without a picture, are rendered.
"""

import sys
from pathlib import Path

import phong_bsdf  # noqa: F401

import mitsuba as mi  # isort: skip
import numpy as np

from phong_bsdf import demo
from phong_bsdf.pictures import images
from phong_bsdf.scene import rendering

ROOT = Path(__file__).parent.parent
SCENES = ROOT / "scenes"
PAGE = ROOT / "docs/gallery.md"
PICTURES = ROOT / "docs/images/gallery"

# Pixels; at least these samples in each: pictures of this size show stairs without.
WIDTH = 320
SPP = 4

# Lines of XML beyond which only the first are shown.
LONGEST = 120
SHOWN = 70

FOLDERS = {
    "lecture": "The lecture's pictures, in its own terms: coefficients, no falloff.",
    "course": "The course's test scenes, with its first camera.",
    "compare": "For `phong-bsdf compare`, which swaps their surfaces for Mitsuba's own.",
    "converge": "For `phong-bsdf converge`, which measures error against time.",
    "inverse": "What [Inverse rendering](inverse-rendering.md) recovers from the picture alone.",
    "stress": "Scenes that are hard in float32. Some of them are one even grey, as they have to be.",
}

INTRODUCTION = """\
# Gallery

Every scene of `scenes/`, each with the first sentence of its own description.
`phong-bsdf render SCENE.xml -o picture.png` makes the pictures at full size; these are {width} pixels wide, made by
`make docs` where a scene has changed, all of them by `make gallery`.
"""


def scenes(folder: str) -> list[Path]:
    """The scenes of a folder; what others include is none."""
    return [path for path in sorted((SCENES / folder).glob("*.xml")) if path.name != "cameras.xml"]


def picture(path: Path) -> np.ndarray:
    """The scene, small, with its own samples per pixel where those are more."""
    loaded = rendering.load(path)
    width, height = (int(side) for side in loaded.sensor(1).film().size())
    rendering.resize(loaded, 1, WIDTH, max(round(WIDTH * height / width), 1))
    spp = max(SPP, loaded.sensor(1).sampler().sample_count())
    return rendering.render(loaded, spp=spp).image


def picture_file(path: Path) -> Path:
    """Where the picture of a scene is."""
    return PICTURES / f"{path.parent.name}-{path.stem}.png"


def entry(path: Path) -> str:
    """Heading, picture, sentence and XML of one scene."""
    name, lines = path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8").rstrip("\n").split("\n")
    title = path.stem.replace("-", " ").capitalize()
    note = ""
    if len(lines) > LONGEST:
        note = f", the first {SHOWN} of {len(lines)} lines"
        lines = lines[:SHOWN]
    return (
        f"### {title}\n\n![{title}]({picture_file(path).relative_to(PAGE.parent).as_posix()})\n\n"
        f"{demo.shows(path)}.\n\n"
        f"<details><summary>{name}{note}</summary>\n\n```xml\n" + "\n".join(lines) + "\n```\n\n</details>\n"
    )


def page() -> str:
    """The text of docs/gallery.md."""
    parts = [INTRODUCTION.format(width=WIDTH)]
    for folder, words in FOLDERS.items():
        parts.append(f"## {folder.capitalize()}\n\n{words}\n")
        parts += [entry(path) for path in scenes(folder)]
    return "\n".join(parts)


def changed() -> list[Path]:
    """The scenes that the page on disk shows otherwise than they are, or without a picture."""
    there = PAGE.read_text(encoding="utf-8") if PAGE.is_file() else ""
    everything = [path for folder in FOLDERS for path in scenes(folder)]
    return [path for path in everything if entry(path) not in there or not picture_file(path).is_file()]


def main(only_changed: bool) -> None:
    """Write the pictures, all or those of changed scenes, and the page."""
    mi.set_variant("llvm_ad_rgb")
    PICTURES.mkdir(parents=True, exist_ok=True)
    for path in changed() if only_changed else [path for folder in FOLDERS for path in scenes(folder)]:
        print(path.relative_to(ROOT), flush=True)
        images.write(picture_file(path), picture(path))
    if not PAGE.is_file() or PAGE.read_text(encoding="utf-8") != page():
        images.replace_file(PAGE, page())


if __name__ == "__main__":
    main("--changed" in sys.argv[1:])
