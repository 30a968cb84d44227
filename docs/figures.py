"""Makes the figures of docs/stability.md and docs/albedo.md, and the table of the former: `make figures`."""

import io
import itertools
from dataclasses import replace
from pathlib import Path
from unittest import mock

import phong_bsdf  # noqa: F401

import mitsuba as mi  # isort: skip
import matplotlib
import numpy as np
from matplotlib.figure import Figure

mi.set_variant("llvm_ad_rgb")

from phong_bsdf import albedo, comparison, images, lobes, stability  # noqa: E402
from phong_bsdf.report import page  # noqa: E402
from phong_bsdf.report import stability as report  # noqa: E402

IMAGES = Path(__file__).parent / "images"
BALLS = Path(__file__).parent.parent / "scenes/compare/balls.xml"
SIZE = 240


def highlight(p):
    """A plane seen straight from above, a light above its centre; the field of view follows the highlight."""
    half = 6 * np.sqrt(2 / p)
    scene = {
        "type": "scene",
        "integrator": {"type": "whitted"},
        "sensor": {
            "type": "orthographic",
            "to_world": mi.ScalarTransform4f().look_at([0, 0, 2], [0, 0, 0], [0, 1, 0]).scale([half, half, 1]),
            "film": {
                "type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}, "pixel_format": "rgb",
            },
            "sampler": {"type": "independent", "sample_count": 1},
        },
        "plane": {"type": "rectangle", "bsdf": {"type": "blinnphong", "kd": 0.05, "ks": 0.8, "p": p}},
        "light": {"type": "point", "position": [0, 0, 1]},
    }  # fmt: skip
    return np.array(mi.render(mi.load_dict(scene)))


def albedo_curves():
    """The directional albedo of both lobes in both vocabularies, over the angle of incidence."""
    matplotlib.rcParams["svg.hashsalt"] = "phong_bsdf"
    figure = Figure(figsize=(9, 6.5), layout="constrained")
    degrees = np.linspace(0, 90, 181)
    cos = np.cos(np.radians(degrees)).clip(0)
    for axes, (reflectance, lobe) in zip(
        figure.subplots(2, 2, sharex=True).flat, itertools.product((False, True), albedo.LOBES), strict=True
    ):
        for p in (0, 1, 10, 100, 1000):
            values = albedo.directional_albedo(lobe, cos, p, reflectance=reflectance)
            axes.plot(degrees, values, label=f"p = {p}")
        axes.set(title=f"{lobe}, {'specular_reflectance' if reflectance else 'ks'} = 1", ylim=(0, None))
    figure.axes[0].legend()
    for axes in figure.axes[2:]:
        axes.set_xlabel("angle of incidence in degrees")
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None})
    images.replace_file(IMAGES / "albedo.svg", text.getvalue())


def compared():
    """The pictures of a comparison, and below each its difference to the first."""
    result = comparison.run(comparison.plan(BALLS, against=["roughplastic", "principled"]), size=(300, 225))
    pictures = list(result.images.values())
    maps = [page.false_colours(picture - pictures[0], 0.1) for picture in pictures]
    # The maps are colours of a file already.
    linear = [np.where(m <= 0.04045, m / 12.92, ((m + 0.055) / 1.055) ** 2.4) for m in maps]
    return np.concatenate([np.concatenate(row, axis=1) for row in (pictures, linear)], axis=0)


def main():
    """Writes the pictures in docs/images, and the table into docs/stability.md."""
    albedo_curves()
    images.write(IMAGES / "compare.png", compared())
    rows = []
    stable = lobes.LOBES["blinnphong"]
    for lobe in (replace(stable, value=stability.LOBES["blinnphong"]["value"][1]), stable):
        with mock.patch.dict(lobes.LOBES, blinnphong=lobe):
            rows.append(np.concatenate([highlight(p) for p in (1e5, 1e6, 1e7)], axis=1))
    images.write(IMAGES / "highlights.png", np.concatenate(rows, axis=0))

    records = list(stability.sweep())
    report.plot(IMAGES / "stability-value.svg", records, "value")
    page = Path(__file__).parent / "stability.md"
    before, _, rest = page.read_text().partition("<!-- table -->\n")
    _, _, after = rest.partition("<!-- end of table -->\n")
    chosen = [row for row in records if row.quantity in ("value", "pdf") and row.p in (1, 100, 1e4, 1e6, 1e8)]
    table = report.table(chosen)
    page.write_text(f"{before}<!-- table -->\n```text\n{table}```\n<!-- end of table -->\n{after}")


if __name__ == "__main__":
    main()
