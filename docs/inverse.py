"""Makes the pictures of docs/inverse-rendering.md by running the page's own examples: `make inverse`."""

import os
import re
from pathlib import Path
from unittest import mock

import phong_bsdf  # noqa: F401

import drjit as dr  # isort: skip
import mitsuba as mi
import numpy as np

from phong_bsdf.pictures import images

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs/inverse-rendering.md"
IMAGES = ROOT / "docs/images"
BALLS = ROOT / "scenes/inverse/three-balls.xml"

# After how many steps the balls are shown.
STEPS = (0, 10, 30, 100, 300)

# Pixels: a texel of the wall, a square picture, what is left white between pictures.
TEXEL = 12
SIDE = 16 * TEXEL
GAP = 8


def examples() -> list[str]:
    """The page's Python, block by block. They build on each other, and are run in the project's folder."""
    return re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)


def run(block: str, names: dict) -> None:
    """Run one of the `examples` among `names`, what the ones before it left behind."""
    exec(compile(block, PAGE.name, "exec"), names)


def recovered(blocks: list[str], names: dict) -> list[np.ndarray]:
    """Run the example of the balls; the pictures after `STEPS` steps, and the one that was given."""
    scene = mi.load_file(str(BALLS), width=240, height=160)
    found, done, freeze = [picture(scene)], 0, dr.freeze

    def show():
        if done in STEPS:
            params = mi.traverse(scene)
            for key in names["keys"]:
                params[key] = names["unknown"].value(key)
            params.update()
            found.insert(-1, picture(scene))

    def watched(step):
        frozen = freeze(step)

        def call(*arguments):
            nonlocal done
            show()
            frozen(*arguments)
            done += 1

        return call

    with mock.patch.object(dr, "freeze", watched):
        for block in blocks:
            run(block, names)
    show()
    return found


def picture(scene, side: int = 0) -> np.ndarray:
    """Smooth at the edges; square, of `side` pixels, where that is not 0."""
    if side:
        params = mi.traverse(scene)
        params["sensor.film.size"] = [side, side]
        params.update()
    return np.array(mi.render(scene, spp=16))


def tiles(values: np.ndarray) -> np.ndarray:
    """A square for each of (rows, columns, 1) values from 0 to 1: its grey."""
    squares = np.kron(np.clip(values[..., 0], 0, 1) ** 2.2, np.ones((TEXEL, TEXEL)))
    return np.repeat(squares[..., None], 3, axis=2)


def beside(pictures: list[np.ndarray], axis: int = 1) -> np.ndarray:
    """Pictures side by side, or one below the other, with a gap between them."""
    height, width, _ = pictures[0].shape
    gap = np.ones((height, GAP, 3) if axis == 1 else (GAP, width, 3))
    return np.concatenate([part for one in pictures for part in (gap, one)][1:], axis=axis)


def main():
    """Run the examples, and write the pictures in docs/images."""
    os.chdir(ROOT)
    mi.set_variant("llvm_ad_rgb")
    *balls, metal, wall = examples()
    names = {}
    pictures = recovered(balls, names)
    rows = [beside(pictures[:3]), beside(pictures[3:])]
    images.write(IMAGES / "inverse-balls.png", beside(rows, axis=0))

    run(metal, names)
    rough = picture(names["ball"]({"type": "roughconductor", "alpha": 0.2, "material": "none"}), SIDE)
    fitted = picture(names["classic"], SIDE)
    images.write(IMAGES / "inverse-metal.png", beside([rough / 7, fitted / 7, np.abs(rough - fitted)]))

    run(wall, names)
    seen = picture(names["wall"](names["exponents"]), SIDE)
    known, found = names["exponents"], np.array(names["texels"].value("wall.bsdf.p.data"))
    shades = [tiles(np.log(p / 10) / np.log(20)) for p in (known, found)]
    images.write(IMAGES / "inverse-texture.png", beside([seen, *shades, tiles(100 * names["errors"])]))


if __name__ == "__main__":
    main()
