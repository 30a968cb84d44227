"""The lecture's pictures, from the scenes that come with the package."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .scene import rendering

# A scene that is shown twice, one picture above the other: name -> values of its <default>s.
TWICE = {"falloff": ({}, {"convention": "physical", "intensity": "91.6"})}


@dataclass(frozen=True)
class Picture:
    """A scene's picture, linear, shape (height, width, 3), and what its file says that it shows."""

    scene: Path
    shows: str
    image: np.ndarray


def scenes() -> list[Path]:
    """The lecture's scenes: a wheel holds them inside of the package, a checkout beside it."""
    here = Path(__file__).parent
    inside = here / "scenes"
    return sorted((inside if inside.is_dir() else here.parent / "scenes/lecture").glob("*.xml"))


def draw(spp: int = 0) -> Iterator[Picture]:
    """Each picture as it is done, with `spp` samples per pixel (0: as the scenes say)."""
    for scene in scenes():
        images = [rendering.render(rendering.load(scene, d), spp=spp).image for d in TWICE.get(scene.stem, ({},))]
        yield Picture(scene, shows(scene), np.concatenate(images))


def shows(scene: Path) -> str:
    """The first sentence of the comment that a scene begins with."""
    sentence = re.match(r"<!--\s*(.*?)\.?(?=\s*-->|\.\s)", scene.read_text(encoding="utf-8"), re.S)
    return re.sub(r"\s+", " ", sentence[1]) if sentence else ""
