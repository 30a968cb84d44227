"""Transforms of old scenes: as matrices, and where Mitsuba 3 reads them otherwise."""

import math
import re

import numpy as np

from ..tracing import needs
from .context import Context
from .xmlfile import Node

AXES = ("x", "y", "z")


def matrix(transform: Node, context: Context) -> np.ndarray | None:
    """The 4 x 4 matrix of a `<transform>`; None where it depends on a parameter without default, or is none."""
    result = np.eye(4)
    try:
        for child in transform.nodes:
            result = _step(child, context) @ result
    except (ValueError, KeyError, np.linalg.LinAlgError):
        return None
    return result if np.all(np.isfinite(result)) else None


def unit_axis(node: Node, context: Context) -> None:
    """Mitsuba 0.6 made the axis of a rotation a unit vector; Mitsuba 3 would stretch what it turns."""
    try:
        axis = _vector(node, context, 0)
    except ValueError:
        return
    length = math.hypot(*axis)
    if 0 < length < math.inf and abs(length - 1) > 1e-6:
        for name, x in zip(AXES, axis, strict=True):
            node.set(name, f"{x / length:.9g}")
        context.journal.change(node.place, f"<rotate> about an axis of length {length:.4g}", "now a unit vector")


def round_sphere(node: Node, context: Context) -> None:
    """Mitsuba 0.6 drew a stretched sphere round, as large as the transform makes its x axis: so it is written."""
    transform = node.find_named("to_world")
    if transform is None:
        return
    whole = matrix(transform, context)
    if whole is None or not needs.stretched(needs.axes(whole[:3, :3])):
        return
    try:
        center = _center(node, context)
    except (ValueError, KeyError):
        return
    lengths = needs.axes(whole[:3, :3])
    u, _, v = np.linalg.svd(whole[:3, :3])
    size = float(np.linalg.norm(whole[:3, 0]))
    made = whole.copy()
    made[:3, :3] = size * u @ v
    made[:3, 3] += (whole - made)[:3, :3] @ center
    transform[:] = [transform.like("matrix", value=" ".join(f"{x:.9g}" for x in made.ravel()))]
    axes = ", ".join(f"{length:.4g}" for length in lengths)
    context.journal.loss(
        node.place, f"'sphere' that is stretched to axes of {axes}",
        f"round, scaled by {size:.4g}, the scale of its x axis, as Mitsuba 0.6 drew it. "
        f"For an ellipsoid {needs.ELLIPSOIDS}",
    )  # fmt: skip


def _center(node: Node, context: Context) -> list[float]:
    given = node.find_named("center")
    if given is None:
        return [0.0, 0.0, 0.0]
    value = given.get("value")
    return _numbers(value, context) if value is not None else _vector(given, context, 0)


def _step(node: Node, context: Context) -> np.ndarray:
    made = np.eye(4)
    if node.tag == "translate":
        made[:3, 3] = _vector(node, context, 0)
    elif node.tag == "scale":
        value = node.get("value")
        uniform = _numbers(value, context)[0] if value is not None else 1
        made[:3, :3] = np.diag(_vector(node, context, uniform))
    elif node.tag == "rotate":
        axis = np.array(_vector(node, context, 0))
        x, y, z = axis / np.linalg.norm(axis)
        angle = math.radians(_numbers(node.attrib["angle"], context)[0])
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        made[:3, :3] += math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    elif node.tag == "lookat":
        origin, target, up = (np.array(_numbers(node.attrib[key], context)) for key in ("origin", "target", "up"))
        ahead = (target - origin) / np.linalg.norm(target - origin)
        left = np.cross(up, ahead) / np.linalg.norm(np.cross(up, ahead))
        made[:3] = np.column_stack([left, np.cross(ahead, left), ahead, origin])
    elif node.tag == "matrix":
        numbers = _numbers(node.attrib["value"], context)
        size = math.isqrt(len(numbers))
        made[:size, :size] = np.reshape(numbers, (size, size))
    return made


def _vector(node: Node, context: Context, default: float) -> list[float]:
    return [_numbers(node.get(axis, str(default)), context)[0] for axis in AXES]


def _numbers(text: str, context: Context) -> list[float]:
    return [float(part) for part in re.split(r"[\s,;]+", context.substituted(text).strip())]
