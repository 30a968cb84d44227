"""Textures of Mitsuba 0.6 as those of Mitsuba 3: `scale`, `bitmap` with all its options, and what is gone."""

import numpy as np

from . import bake
from .context import Context
from .values import color, number, set_color, to_text
from .xmlfile import Node

FILTERS = {"ewa": "bilinear", "trilinear": "bilinear", "nearest": "nearest", "none": "nearest"}
CHANNELS = {"r": 0, "g": 1, "b": 2, "x": 0, "y": 1, "z": 2, "red": 0, "green": 1, "blue": 2}

# Parameters that take numbers from a texture, not colours.
NUMBERS = ("exponent", "alpha", "alpha_u", "alpha_v", "opacity", "weight")

CHECKERBOARD = {"color0": 0.4, "color1": 0.2}


def rewrite(context: Context) -> None:
    """All textures of the scene, inner ones and those that are referred to first."""
    parents = {child: parent for parent in context.root.all() for child in parent.nodes}
    for node in context.inner_first():
        if node.tag != "texture":
            continue
        rule = RULES.get(node.type)
        if rule:
            rule(node, parents[node], context)
        if node.type in ("bitmap", "checkerboard"):
            _offsets(node, context)


def _scale(node: Node, parent: Node, context: Context) -> None:
    """A texture times a factor."""
    given = node.take("scale")
    factor = [1.0] if given is None else (color(given) or [1.0])
    inner = next((n for n in node.nodes if n.tag in ("texture", "ref", "rgb", "spectrum", "float")), None)
    if inner is None:
        context.journal.loss(node.place, "texture 'scale' without a texture", "now the constant 1")
        _constant(node, [1.0])
        return
    if (parent.tag, parent.type) == ("bsdf", "bumpmap") and len(factor) == 1:
        # The height of bumps is a parameter of the BSDF.
        own = parent.take("scale")
        parent.add("float", name="scale", value=to_text([factor[0] * (number(own) if own is not None else 1)]))
        context.journal.change(node.place, "texture 'scale' in 'bumpmap'", "now its parameter 'scale'")
        node.become(context.dereference(inner))
        return
    node.become(context.dereference(inner))
    what = f"texture 'scale' by {to_text(factor)}"
    why = _multiply(node, factor, context)
    if why:
        context.journal.loss(node.place, what, why)
    else:
        context.journal.change(node.place, what, "now part of what it scaled, for Mitsuba 3 has no such texture")


def _multiply(node: Node, factor: list[float], context: Context) -> str | None:
    """Multiply a texture or constant; why not, where that is not possible."""
    constant = color(node)
    if constant is not None:
        product = _product(constant, factor)
        set_color(node, product)
        if node.get("id"):
            _constant(node, product)
    elif node.type == "checkerboard":
        for name, default in CHECKERBOARD.items():
            square = node.find_named(name)
            if square is None:
                square = node.add("rgb", name=name, value=to_text([default]))
            set_color(square, _product(color(square) or [default], factor))
    elif node.type == "bitmap" and set(factor) != {1.0}:
        path = _image(node, context)
        if path is None:
            return "the image is missing"
        new = bake.copy(context.files, path, lambda x: bake.scaled(x, factor), "scaled", _gamma(node))
        _use(node, new, context)
    elif set(factor) != {1.0}:
        return f"Mitsuba 3 cannot scale a '{node.type}'"
    return None


def _bitmap(node: Node, parent: Node, context: Context) -> None:
    """An image: gamma, channel, filter, wrapping."""
    journal = context.journal
    kind = node.find_named("filter_type")
    asked = kind.get("value", "") if kind is not None else ""
    if kind is not None and FILTERS.get(asked, asked) != asked:
        journal.change(kind.place, f"filter '{asked}'", "now 'bilinear', the best that Mitsuba 3 has")
        kind.set("value", FILTERS[asked])
    _wrapping(node, context)
    gamma, channel = node.take("gamma"), node.take("channel")
    power = number(gamma) if gamma is not None else -1.0
    which = (channel.get("value", "") if channel is not None else "").lower()
    if power in (-1.0, 0.0) and not which:
        return
    path = _image(node, context)
    if path is None:
        journal.loss(node.place, f"bitmap with gamma {power:g}", "the image is missing, so it cannot be decoded")
    elif path.suffix.lower() in (".exr", ".hdr", ".rgbe", ".pfm") and not which:
        pass  # linear, whatever the gamma
    elif power == 1.0 and not which and _holds_numbers(node, parent, context):
        node.add("boolean", name="raw", value="true")
        journal.change(gamma.place, "gamma 1", "now raw: the numbers as they are in the file")
    else:
        new = bake.copy(context.files, path, lambda x: _channel(x, which), "linear", power if power > 0 else None)
        _use(node, new, context)
        what = f"gamma {power:g}" if power > 0 else f"channel '{which}'"
        journal.change(node.place, f"bitmap with {what}", f"decoded into the linear image '{new.name}'")


def _holds_numbers(node: Node, parent: Node, context: Context) -> bool:
    """Whether a texture is one of numbers, perhaps scaled ones, and not of colours."""
    above = {child: node for node in context.root.all() for child in node.nodes}
    while (parent.tag, parent.type) == ("texture", "scale"):
        node, parent = parent, above[parent]
    return node.name in NUMBERS or parent.type in ("bumpmap", "normalmap")


def _channel(image: np.ndarray, which: str) -> np.ndarray:
    if which in CHANNELS and image.shape[2] > CHANNELS[which]:
        return image[..., CHANNELS[which]][..., None]
    return image


def _wrapping(node: Node, context: Context) -> None:
    modes = {name: node.take(name) for name in ("wrap_mode", "wrap_mode_u", "wrap_mode_v")}
    given = [n for n in modes.values() if n is not None]
    if not given:
        return
    values = [n.get("value", "repeat") for n in given]
    mode = "clamp" if values[0] in ("zero", "one") else values[0]
    if len(set(values)) > 1:
        context.journal.loss(
            given[1].place, f"wrap modes {' and '.join(values)}", "Mitsuba 3 has one for both directions"
        )
    if mode != values[0]:
        context.journal.loss(given[0].place, f"wrap mode '{values[0]}'", "now 'clamp', the nearest of Mitsuba 3")
    node.add("string", name="wrap_mode", value=mode)


def _offsets(node: Node, context: Context) -> None:
    """uv times a scale plus an offset. (Mitsuba 3's own reading of old files scales the offset, too.)"""
    taken = {name: node.take(name) for name in ("uscale", "vscale", "uoffset", "voffset", "uvscale")}
    given = [n for n in taken.values() if n is not None]
    if not given:
        return
    both = taken["uvscale"]

    def value(name, default):
        node = taken[name]
        return to_text([number(node)]) if node is not None else default

    base = to_text([number(both)]) if both is not None else "1"
    transform = node.add("transform", name="to_uv")
    transform.add("scale", x=value("uscale", base), y=value("vscale", base))
    transform.add("translate", x=value("uoffset", "0"), y=value("voffset", "0"))
    context.journal.change(given[0].place, ", ".join(n.name for n in given), "now the transform 'to_uv'")


def _grid(node: Node, parent: Node, context: Context) -> None:
    _flat(node, context, "color0", 0.2, "Mitsuba 3 has no grid; now the colour between its lines")


def _wireframe(node: Node, parent: Node, context: Context) -> None:
    _flat(node, context, "interior_color", 0.5, "Mitsuba 3 has no wireframe; now the colour between its lines")


def _curvature(node: Node, parent: Node, context: Context) -> None:
    _flat(node, context, "", 0.5, "Mitsuba 3 has no curvature texture; now grey")


def _flat(node: Node, context: Context, name: str, default: float, why: str) -> None:
    chosen = node.find_named(name) if name else None
    context.journal.loss(node.place, f"texture '{node.type}'", why)
    _constant(node, (color(chosen) if chosen is not None else None) or [default])


def _vertex_colors(node: Node, parent: Node, context: Context) -> None:
    kept = {key: node.attrib[key] for key in ("name", "id") if key in node.attrib}
    node[:] = []
    node.attrib = {"type": "mesh_attribute", **kept}
    node.add("string", name="name", value="vertex_color")
    context.journal.change(node.place, "texture 'vertexcolors'", "now 'mesh_attribute' of 'vertex_color'")


def _constant(node: Node, values: list[float]) -> None:
    """Make a texture a constant; one that others refer to must stay an object."""
    kept = {key: node.attrib[key] for key in ("name", "id") if key in node.attrib}
    node[:] = []
    if "id" in kept:
        node.tag, node.attrib = "texture", {"type": "srgb", **kept}
        node.add("rgb", name="color", value=to_text([min(v, 1.0) for v in values]))
    else:
        node.tag, node.attrib = "rgb", {**kept, "value": to_text(values)}


def _image(node: Node, context: Context):
    """The file of a bitmap, None where it is not there."""
    name = node.find_named("filename")
    path = context.filename(name) if name is not None else None
    return path if path is not None and path.is_file() else None


def _use(node: Node, path, context: Context) -> None:
    """Let a bitmap show an image that was made for the new scene."""
    name = node.find_named("filename")
    name.final = True
    name.set("value", context.files.relative(path.resolve()))


def mean(node: Node, context: Context) -> float | None:
    """The mean of a bitmap that was rewritten, None for other textures and where there is no image."""
    name = node.find_named("filename")
    if node.type != "bitmap" or name is None:
        return None
    path = context.files.written_as(name.attrib["value"]) if name.final else _image(node, context)
    if path is None:
        return None
    return float(bake.decode(bake.read(path), _gamma(node)).mean())


def _gamma(node: Node) -> float | None:
    """1 where a bitmap's integers are numbers as they are in the file, else None: sRGB."""
    raw = node.find_named("raw")
    return 1.0 if raw is not None and raw.get("value") == "true" else None


def _product(a: list[float], b: list[float]) -> list[float]:
    if len(a) < len(b):
        a, b = b, a
    return [x * y for x, y in zip(a, b * len(a) if len(b) == 1 else b, strict=False)]


RULES = {
    "scale": _scale,
    "bitmap": _bitmap,
    "gridtexture": _grid,
    "wireframe": _wireframe,
    "curvature": _curvature,
    "vertexcolors": _vertex_colors,
}
