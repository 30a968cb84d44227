"""Triangles -> one indexed mesh for each material, with the normals that the OBJ specification asks for, as PLY."""

import os
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .objfile import Triangles


@dataclass
class Mesh:
    """A mesh whose corners share what they have in common."""

    positions: np.ndarray
    normals: np.ndarray | None
    """None: each face has its own, and shades flat."""
    texcoords: np.ndarray | None
    faces: np.ndarray


def split(triangles: Triangles) -> Iterator[tuple[int, Mesh]]:
    """For each material in use (-1: none) its mesh."""
    normals, vn, flat = _corner_normals(triangles)
    order = np.argsort(triangles.material, kind="stable")
    materials, starts = np.unique(triangles.material[order], return_index=True)
    for material, part in zip(materials, np.split(order, starts[1:]), strict=True):
        yield int(material), _mesh(triangles, part, normals, vn, bool(flat[part].all()))


def write_ply(path: Path, mesh: Mesh) -> None:
    """Write a mesh as binary PLY, with Mitsuba, whole or not at all. Sets the variant `scalar_rgb` if there is none."""
    import mitsuba as mi

    if mi.variant() is None:
        mi.set_variant("scalar_rgb")
    made = mi.Mesh(
        path.stem, len(mesh.positions), len(mesh.faces),
        has_vertex_normals=mesh.normals is not None, has_vertex_texcoords=mesh.texcoords is not None,
    )  # fmt: skip
    params = mi.traverse(made)
    arrays = {
        "vertex_positions": mesh.positions, "vertex_normals": mesh.normals, "vertex_texcoords": mesh.texcoords,
        "faces": mesh.faces.astype(np.uint32),
    }  # fmt: skip
    for name, array in arrays.items():
        if array is not None:
            kind: Any = type(params[name])
            params[name] = kind(np.ascontiguousarray(array).ravel())
    params.update()
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        temporary = Path(folder) / path.name
        made.write_ply(str(temporary))
        if not temporary.is_file() or temporary.stat().st_size < mesh.positions.nbytes:
            raise OSError(f"'{path}' could not be written")
        os.replace(temporary, path)


def _corner_normals(t: Triangles) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """All normals, their indices at the corners, and for each triangle whether it shades flat.

    A corner keeps the normal it was given. Without one it has, in a smoothing group, the
    mean over the group's triangles there, weighted by their angles, and else its face's.
    """
    missing = t.vn < 0
    if not missing.any():
        return t.normals, t.vn, np.zeros(len(t.v), bool)
    sides = [t.positions[t.v[:, (i + 1) % 3]].astype(np.float64) - t.positions[t.v[:, i]] for i in range(3)]
    across = np.cross(sides[0], -sides[2])
    face = _unit(across)
    vn, normals = t.vn.copy(), [t.normals.astype(np.float64)]
    flat = missing & (t.smoothing == 0)[:, None]
    smooth = missing & ~flat

    rows, columns = np.nonzero(smooth)
    key = t.smoothing[rows] * len(t.positions) + t.v[rows, columns]
    _, group = np.unique(key, return_inverse=True)
    ahead, back = (np.stack(sides)[columns, rows], -np.stack(sides)[columns - 1, rows])
    angle = np.arccos(np.clip(np.sum(_unit(ahead) * _unit(back), axis=1), -1, 1))
    # Triangles without area, as at the poles of spheres, have no direction to add.
    angle *= across[rows].any(axis=1)
    count = int(group.max(initial=-1)) + 1
    sums = [np.bincount(group, weights=angle * face[rows, axis], minlength=count) for axis in range(3)]
    vn[rows, columns] = len(t.normals) + group
    normals.append(_unit(np.stack(sums, axis=1)))

    rows, columns = np.nonzero(flat)
    vn[rows, columns] = len(t.normals) + count + rows
    normals.append(face)
    return np.concatenate(normals).astype(np.float32), vn, flat.all(axis=1)


def _unit(v: np.ndarray) -> np.ndarray:
    """Unit vectors; z where there is no direction."""
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.where(length > 0, v / np.where(length > 0, length, 1), np.array([0.0, 0.0, 1.0]))


def _mesh(t: Triangles, part: np.ndarray, normals: np.ndarray, vn: np.ndarray, flat: bool) -> Mesh:
    v, vt = t.v[part].ravel().astype(np.int64), t.vt[part].ravel().astype(np.int64)
    textured = bool((vt >= 0).any())
    corner = v
    for index, size in (
        (vt if textured else None, len(t.texcoords)),
        (None if flat else vn[part].ravel(), len(normals)),
    ):
        if index is not None:
            _, corner = np.unique(corner, return_inverse=True)
            corner = corner * (size + 1) + index + 1
    _, first, faces = np.unique(corner, return_index=True, return_inverse=True)
    uv = None
    if textured:
        # OBJ counts v from the bottom of an image, Mitsuba from its top.
        uv = np.where((vt >= 0)[first, None], t.texcoords[vt[first]], [0.0, 1.0]).astype(np.float32)
        uv[:, 1] = 1 - uv[:, 1]
    return Mesh(
        t.positions[v[first]], None if flat else normals[vn[part].ravel()[first]], uv, faces.reshape(-1, 3)
    )  # fmt: skip
