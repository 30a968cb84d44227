"""The `phong` and `blinnphong` surfaces of a parsed scene: found by name, wherever they are nested, and replaced."""

import os
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..reflection import energy
from ..reflection.lobes import LOBES
from ..reflection.matching import Carried, Lobe
from ..reflection.vocabulary import COEFFICIENTS, DEFAULTS, ENERGY, REFLECTANCES

# The first two of a vocabulary.
SCALES = ("diffuse", "specular")

# Textures that cannot be looked at without the shape that they are on.
ON_SHAPES = ("mesh_attribute", "volume")

# What a parameter can be besides a number or a colour. (Mitsuba's stubs lack the second.)
OBJECTS = (mi.Properties.Type.ResolvedReference, mi.Properties.Type.Spectrum)  # pyright: ignore[reportAttributeAccessIssue]


@dataclass(frozen=True)
class Surface:
    """One lobe BSDF of the scene."""

    name: str
    """Its id; without one, that of what holds it, with the plugin's name; without that, plugin and a number."""
    where: str
    """File and line."""
    node: int
    lobe: Lobe
    textured: tuple[str, ...]
    """Parameters that are textures."""
    notes: tuple[str, ...]

    def is_textured(self, scale: str) -> bool:
        """Whether the `diffuse` or the `specular` scale is a texture."""
        which = SCALES.index(scale)
        return COEFFICIENTS[which] in self.textured or REFLECTANCES[which] in self.textured


def find(state, make: Callable[[Any], Any]) -> list[Surface]:
    """All lobe BSDFs that the scene uses, in the order of the file; `make` makes the root of a parsed scene."""
    names: dict[str, int] = {}
    for index, owner in sorted(_bsdfs(state)):
        props = state.nodes[index].props
        plugin = props.plugin_name()
        if plugin in LOBES:
            stem = props.id() or (f"{owner}.{plugin}" if owner else plugin)
            name, number = (stem if props.id() or owner else f"{plugin}-1"), 1
            while name in names:
                number += 1
                name = f"{stem}-{number}"
            names[name] = index
    return [_surface(state, make, name, index) for name, index in names.items()]


def replaced(state, surface: Surface, plugin: str, parameters: Mapping[str, object]):
    """A copy of the parsed scene in which `surface` has become `plugin`."""
    node = mi.parser.SceneNode(state.nodes[surface.node])
    props = mi.Properties(plugin)
    props.set_id(node.props.id())
    for name, value in parameters.items():
        if isinstance(value, Carried):
            source = _names(node.props)[SCALES.index(value.scale)]
            # Numbers and colours come from the lobe: defaults are nowhere in the scene.
            as_it_stands = source in node.props and node.props.type(source) in OBJECTS
            value = node.props[source] if as_it_stands else getattr(surface.lobe, value.scale)
        props[name] = mi.ScalarColor3f(*value) if isinstance(value, tuple) else value
    node.props = props
    return _with_node(state, surface.node, node)


def alone(state, surface: Surface):
    """A copy of the parsed scene whose root is the BSDF of `surface`."""
    return _with_node(state, 0, state.nodes[surface.node])


def parameters(lobe: Lobe) -> dict[str, object]:
    """A lobe's parameters by their names in its vocabulary."""
    names = REFLECTANCES if lobe.reflectances else COEFFICIENTS
    return dict(zip(names, (lobe.diffuse, lobe.specular, lobe.exponent), strict=True))


def color(value: tuple[float, float, float]) -> dict[str, object]:
    """A colour, as `mitsuba.load_dict` takes it."""
    return {"type": "rgb", "value": list(value)}


def _bsdfs(state) -> Iterator[tuple[int, str]]:
    """Index of every BSDF that is reached from the root, each once, and the id of what holds it."""
    seen, waiting = set(), [(0, "")]
    while waiting:
        index, owner = waiting.pop()
        if index in seen:
            continue
        seen.add(index)
        node = state.nodes[index]
        if node.type == mi.ObjectType.BSDF:
            yield index, owner
        owner = node.props.id() if index > 0 and node.props.id() else owner
        waiting += [(child, owner) for child in reversed(children(node.props))]


def children(props) -> list[int]:
    """The nodes that a node of a parsed scene refers to."""
    return [props[name].index() for name in props.keys() if _is_object(props, name)]  # noqa: SIM118


def _is_object(props, name: str) -> bool:
    return props.type(name) == mi.Properties.Type.ResolvedReference


def _names(props) -> tuple[str, str, str]:
    return REFLECTANCES if any(name in props for name in REFLECTANCES) else COEFFICIENTS


def _surface(state, make, name: str, index: int) -> Surface:
    props = state.nodes[index].props
    names = _names(props)
    means, textured, notes = [], [], []
    for parameter, default in zip(names, DEFAULTS, strict=True):
        value, is_texture = _mean(state, make, props, parameter, default)
        means.append(value)
        textured += [parameter] * is_texture
    kd, ks, p = means
    if names[2] in textured:
        notes.append(f"'{names[2]}' is a texture: its mean {np.mean(p):.4g} is matched")
    if names == REFLECTANCES and not textured and props.get(ENERGY, True):
        factor = energy.factor(max(d + s for d, s in zip(kd, ks, strict=True)))
        kd, ks = (tuple(factor * x for x in scale) for scale in (kd, ks))
    lobe = Lobe(props.plugin_name(), kd, ks, float(np.mean(p)), names == REFLECTANCES)
    file, line = re.match(r"(.*) \(line (\d+)", mi.parser.file_location(state, state.nodes[index])).groups()
    where = f"{os.path.basename(file)}, line {line}"
    return Surface(name, where, index, lobe, tuple(textured), tuple(notes))


def _mean(state, make, props, name: str, default: float) -> tuple[tuple[float, ...], bool]:
    """The mean colour of a parameter over the texture's unit square, and whether it is a texture."""
    value = props.get(name, default)
    if isinstance(value, int | float):
        return (float(value),) * 3, False
    if props.type(name) == mi.Properties.Type.Color:
        return tuple(float(x) for x in value), False
    is_texture = _is_object(props, name)
    plugin = state.nodes[value.index()].props.plugin_name() if is_texture else ""
    if plugin in ON_SHAPES:
        raise ValueError(f"{props.plugin_name()}: '{name}' is a '{plugin}', whose mean depends on the shape; "
                         "compare knows numbers, colours, spectra and textures over (u, v)")  # fmt: skip
    # Whatever the parameter is, `diffuse` can show it.
    node = mi.parser.SceneNode(state.nodes[0])
    node.type, shown = mi.ObjectType.BSDF, mi.Properties("diffuse")
    shown["reflectance"] = value
    node.props = shown
    return _mean_reflectance(make(_with_node(state, 0, node))), is_texture


def _mean_reflectance(bsdf, side: int = 64) -> tuple[float, ...]:
    """Mean over a grid of the unit square; in spectral variants grey."""
    steps = (np.arange(side) + 0.5) / side
    points = [mi.Point2f(float(u), float(v)) for u in steps for v in steps]
    if dr.is_jit_v(mi.Float):
        points = [mi.Point2f(np.repeat(steps, side), np.tile(steps, side))]
    total = np.zeros(3)
    for point in points:
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.uv = point
        if mi.is_spectral:
            si.wavelengths = mi.UnpolarizedSpectrum(450.0, 520.0, 580.0, 640.0)
        value = mi.unpolarized_spectrum(bsdf.eval_diffuse_reflectance(si))
        channels = [np.mean(np.array(channel)) for channel in value]
        total += channels if len(channels) == 3 else np.mean(channels)
    return tuple(float(x) for x in total / len(points))


def _with_node(state, index: int, node):
    copy = mi.parser.ParserState(state)
    copy.nodes[index] = node
    return copy
