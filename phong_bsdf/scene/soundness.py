"""What a scene says that no picture would show: found in the parsed file, before anything is made of it.

Mitsuba draws a stretched sphere round, renders black where a light is at NaN, and `whitted` leaves out fog, each
without an error. `needs.py` has the same for scenes that were not loaded by this package.
"""

import collections
import math

import mitsuba as mi
import numpy as np

from ..host.registry import PLUGINS as OURS
from ..tracing import needs

Type = mi.Properties.Type

# The largest number of float32, in which Mitsuba renders.
LARGEST = float(np.finfo(np.float32).max)

# What Mitsuba 3.9 makes of a `to_world` that stretches or shears. Measured: all other shapes are drawn as it says.
ROUND = {
    **dict.fromkeys(("sphere", "ellipsoids", "ellipsoidsmesh"), "Mitsuba keeps its proportions"),
    **dict.fromkeys(("bsplinecurve", "linearcurve"), "Mitsuba keeps its cross-section round"),
}
REMEDIES = {
    "sphere": needs.ELLIPSOIDS,
    "ellipsoids": "put the axes into the data of the shape",
    "ellipsoidsmesh": "put the axes into the data of the shape",
    "bsplinecurve": "move its control points, or use a mesh",
    "linearcurve": "move its control points, or use a mesh",
}

# What a scale makes brighter, or distorts: only its rotation and position mean something.
RIGID = ("directional", "projector", "envmap")

# Lengths that must not be 0 or negative.
POSITIVE = {"sphere": ("radius",), "cylinder": ("radius",)}

# What is made of triangles, which Mitsuba lights also when they are flattened; of a `rectangle` or `cube` it loses the
# normals then.
FLAT = ("obj", "ply", "serialized", "merge", "blender")

# What may be infinite: no limit.
LIMITS = ("far_clip", "focus_distance")


def wrong(state: "mi.parser.ParserState") -> str | None:
    """The first thing in a parsed scene that would go wrong unseen, and where, as Mitsuba says it: "At ...: ..."."""
    # To read a property marks it as known to the plugin: Mitsuba would no longer refuse misspelt ones.
    copy = mi.parser.ParserState(state)
    whitted = "whitted" in _used(copy)[mi.ObjectType.Integrator]
    for node, own in zip(copy.nodes, state.nodes, strict=True):
        message = _wrong(node) or (_medium(node, copy) if whitted else None)
        if message:
            return f"At {mi.parser.file_location(state, own)}: {message}"
    return None


def ignored(state: "mi.parser.ParserState") -> str | None:
    """A medium that Mitsuba's integrator, say `path`, does not render and does not mention: as `wrong`."""
    copy = mi.parser.ParserState(state)
    plugins = _used(copy)
    if any("vol" in plugin for plugin in plugins[mi.ObjectType.Integrator]) or not plugins[mi.ObjectType.Medium]:
        return None
    integrator = ", ".join(sorted(plugins[mi.ObjectType.Integrator]))
    return f"the integrator '{integrator}' does not render the scene's media; {needs.VOLPATH}"


def wrong_image(scene: "mi.Scene", state: "mi.parser.ParserState") -> str | None:
    """As `wrong`, for the first light or background of the loaded scene whose image holds NaN or infinity."""
    for emitter in scene.emitters():
        params = mi.traverse(emitter)
        for key in params.keys():  # noqa: SIM118
            pixels = np.array(params[key]) if key.rsplit(".", 1)[-1] == "data" else np.zeros(1)
            if not np.all(np.isfinite(pixels)):
                plugin = needs.PLUGIN_OF.get(emitter.class_name(), emitter.class_name())
                places = [mi.parser.file_location(state, n) for n in state.nodes if n.props.plugin_name() == plugin]
                message = f"{plugin}: its image must be finite, got NaN or infinity in it; mend the image"
                return f"At {places[0]}: {message}" if len(places) == 1 else message
    return None


def _wrong(node) -> str | None:
    plugin, props = node.props.plugin_name(), node.props
    # This package's own say so themselves, with their ranges.
    if plugin in OURS:
        return None
    called = _called(node)
    for name in props.keys():  # noqa: SIM118
        numbers = _numbers(props, name)
        bad = [x for x in numbers if not abs(x) <= LARGEST and not (name in LIMITS and x == math.inf)]
        if bad:
            got = _text(numbers) if len(numbers) <= 4 else f"{bad[0]:g} among its {len(numbers)} numbers"
            remedy = "write a number" if math.isnan(bad[0]) else "float32 has numbers up to 3.4e+38"
            return f"{called}: '{name}' must be finite, got {got}; {remedy}"
    for name in POSITIVE.get(plugin, ()):
        if name in props and props[name] <= 0:
            inside_out = "; to see its inside, set flip_normals" if props[name] < 0 else "; leave the shape out"
            return f"{called}: '{name}' must be > 0, got {props[name]:g}{inside_out}"
    if plugin == "cylinder" and "p0" in props and "p1" in props and list(props["p0"]) == list(props["p1"]):
        return f"{called}: 'p0' and 'p1' must not be the same point, got {_text(props['p0'])}; leave the shape out"
    if plugin == "directional" and "direction" in props and not any(props["direction"]):
        return f"{called}: 'direction' must not be zero, got {_text(props['direction'])}; write where the light goes"
    if "to_world" in props and props.type("to_world") == Type.Transform:
        return _deformed(node, plugin, called, np.array(props["to_world"].matrix, np.float64)[:3, :3])
    return None


def _deformed(node, plugin: str, called: str, matrix: np.ndarray) -> str | None:
    lengths = needs.axes(matrix)
    stretched = needs.stretched(lengths)
    if node.type == mi.ObjectType.Shape and not lengths[1 if plugin in FLAT else 2] > 1e-12 * lengths[0]:
        return f"{called}: 'to_world' must not flatten it, got axes of {_text(lengths)}; scale by more than 0"
    if plugin in ROUND and stretched:
        got = f"axes of lengths {_text(lengths)}"
        return (
            f"{called}: 'to_world' must scale all directions alike, got {got}, and {ROUND[plugin]}; {REMEDIES[plugin]}"
        )
    if plugin == "directional":
        lengths = [float(np.linalg.norm(matrix[:, 2]))] * 3
    if plugin in RIGID and max(abs(length - 1) for length in lengths) > needs.UNLIKE:
        got = f"{lengths[0]:g}" if not needs.stretched(lengths) else _text(lengths)
        return (
            f"{called}: 'to_world' must not scale, got a scale of {got}, and Mitsuba would change the light with it; "
            "leave the scale out"
        )
    return None


def _medium(node, state) -> str | None:
    if _lists(node) or node.type not in (mi.ObjectType.Shape, mi.ObjectType.Sensor):
        return None
    for name, target in _references(node):
        if state.nodes[target].type == mi.ObjectType.Medium:
            where = f"'{name}'" if not name.startswith("_arg_") else "the medium"
            plugin = state.nodes[target].props.plugin_name()
            return f"{_called(node)}: {where} must be empty under 'whitted', got a '{plugin}' medium; {needs.VOLPATH}"
    return None


def _used(state) -> dict:
    """The plugins of each type that the scene uses: nodes of a changed scene can be left over."""
    waiting, seen, plugins = [0], {0}, collections.defaultdict(set)
    while waiting:
        node = state.nodes[waiting.pop()]
        plugins[node.type].add(node.props.plugin_name())
        new = {
            target
            for _, target in _references(node)
            # A medium that nothing is filled with is no loss.
            if not (_lists(node) and state.nodes[target].type == mi.ObjectType.Medium)
        } - seen
        seen |= new
        waiting += new
    return plugins


def _lists(node) -> bool:
    """Whether a node only lists all there is: the scene, or what Mitsuba puts in its place to merge meshes."""
    return node.type == mi.ObjectType.Scene or node.props.plugin_name() == "merge"


def _references(node):
    for name in node.props.keys():  # noqa: SIM118
        if node.props.type(name) == Type.ResolvedReference:
            yield name, node.props[name].index()


def _numbers(props, name: str) -> list[float]:
    """The numbers in a property: a number, point, colour, spectrum or transform; none in anything else."""
    kind, value = props.type(name), props[name]
    if kind == Type.Float:
        return [value]
    if kind in (Type.Vector, Type.Color):
        return [float(x) for x in value]
    if kind == Type.Spectrum:  # pyright: ignore[reportAttributeAccessIssue]  (not in Mitsuba's stubs)
        return [*value.values, *value.wavelengths]
    if kind == Type.Transform:
        return [float(x) for x in np.array(value.matrix, np.float64).ravel()]
    return []


def _called(node) -> str:
    name = node.props.id()
    return f"{node.props.plugin_name()} '{name}'" if name else node.props.plugin_name()


def _text(numbers) -> str:
    return ", ".join(f"{x:g}" for x in numbers)
