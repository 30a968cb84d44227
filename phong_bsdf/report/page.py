"""Self-contained HTML pages: the layout, the picture viewer's data, inline plots. Nothing is asked for from outside.

The templates in `templates/` extend `page.html`; `viewer.html` has the macro for the viewer.
"""

import base64
import importlib
import io
import re
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..pictures.images import png, replace_file

TEMPLATES = Path(__file__).parent / "templates"

# Drawn in this colour, a line of a plot takes that of the page's text, in light and dark.
INK = "#010203"

# Of curves: told apart with any kind of colour vision, on white and on black.
PALETTE = ("#d55e00", "#1f9e89", "#7b6fd0", "#c99700", "#3b8fd6", "#cc6699")

# Half floats end at 65504.
LARGEST_HALF = 6e4

# Beside the first, brighter ones take the largest colour: single bright pixels would leave a map dark.
MAP_PERCENTILE = 99.0


def check_installed(*more: str) -> None:
    """Raise ImportError with the remedy where the package for plots and maps, or one of `more`, is missing."""
    for package in ("matplotlib", *more):
        try:
            importlib.import_module(package)
        except ImportError as error:
            raise ImportError(
                f"the page needs the package {error.name}, which is not installed: pip install 'phong-bsdf[report]'"
            ) from None


def write(path: Path, template: str, **context) -> None:
    """Write the page that `template` makes of `context`."""
    import jinja2

    loader = jinja2.FileSystemLoader(TEMPLATES)
    environment = jinja2.Environment(
        loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    replace_file(path, environment.get_template(template).render(**context))


def viewer(
    pictures: Mapping[str, np.ndarray], difference_scale: float, against: Mapping[str, str] | None = None
) -> dict[str, object]:
    """Data of the picture viewer. A picture is compared with that which `against` names, or with the first.

    Pixels are half floats: 3 digits. `difference_scale` is the difference that has the brightest colour.
    """
    names, against = list(pictures), against or {}
    bases = {name: against.get(name, name if name in against.values() else names[0]) for name in names}
    largest = max(float(np.max(np.abs(image), initial=0, where=np.isfinite(image))) for image in pictures.values())
    scale = max(largest / LARGEST_HALF, 1.0)
    return {
        "pictures": [
            {
                "name": name, "against": names.index(bases[name]),
                "height": image.shape[0], "width": image.shape[1], "channels": image.shape[2],
                "data": _base64(zlib.compress((image / scale).astype("<f2").tobytes(), 9)),
            }
            for name, image in pictures.items()
        ],
        "base": "its reference" if len(set(bases.values())) > 1 else next(iter(bases.values())),
        "scale": scale,
        "difference": difference_scale,
        "colours": _base64(colour_map().tobytes()),
    }  # fmt: skip


def colour_map() -> np.ndarray:
    """256 colours from black to bright, (256, 3), 8 bits."""
    from matplotlib import colormaps

    return np.rint(255 * colormaps["inferno"](np.arange(256))[:, :3]).astype(np.uint8)


def false_colours(difference: np.ndarray, scale: float) -> np.ndarray:
    """The mean over the colours of |difference|, an image, as colours for `picture(..., linear=True)`."""
    share = np.abs(difference).mean(axis=-1) / scale if scale > 0 else np.zeros(difference.shape[:2])
    return colour_map()[np.rint(255 * np.clip(np.nan_to_num(share, nan=1.0), 0, 1)).astype(int)] / 255.0


def difference_scale(differences: Iterable[np.ndarray]) -> float:
    """The difference that the brightest colour of every map stands for: few pixels are beyond it."""
    finite = [m[np.isfinite(m)] for m in (np.abs(d).mean(axis=-1) for d in differences)]
    return max((float(np.percentile(m, MAP_PERCENTILE)) for m in finite if m.size), default=0.0) or 1.0


def picture(image: np.ndarray, *, linear: bool = False) -> str:
    """An image, (height, width, 1 or 3), as the address of an `<img>`."""
    colours = np.broadcast_to(np.asarray(image, np.float32), (*image.shape[:2], 3))
    return "data:image/png;base64," + _base64(png(colours, linear=linear))


def svg_file(figure, **options) -> str:
    """A matplotlib figure as the text of an SVG file, which does not change when the figure does not."""
    import matplotlib

    text = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": "phong_bsdf"}):
        figure.savefig(text, format="svg", metadata={"Date": None}, **options)
    return text.getvalue()


def svg(figure, label: str):
    """A matplotlib figure as inline SVG that follows the page's colours; `label` is for those who do not see it."""
    import matplotlib
    from markupsafe import Markup, escape

    # Text stays text.
    with matplotlib.rc_context({"svg.fonttype": "none"}):
        drawing = svg_file(figure, transparent=True).replace(INK, "currentColor")
    drawing = drawing[drawing.index("<svg") :]
    drawing = re.sub(r"<metadata>.*?</metadata>", "", drawing, flags=re.DOTALL)
    drawing = re.sub(r' (width|height)="[\d.]+pt"', "", drawing, count=2)
    return Markup(drawing.replace("<svg ", f'<svg role="img" aria-label="{escape(label)}" ', 1))


def ink_style() -> dict[Any, Any]:
    """Matplotlib settings for a figure that `svg` makes inline."""
    inked = ("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color")
    return {**dict.fromkeys(inked, INK), "grid.color": "#808080", "grid.alpha": 0.35, "font.size": 8}


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")
