"""Whether rays slip between two triangles of a mesh: some are aimed at edges that triangles share."""

import drjit as dr
import mitsuba as mi
import numpy as np

# Triangles of a mesh whose edges are looked at, and rays aimed at them, a third of which count. Of those
# one in fifty or more slips through a scene without the flag.
TRIANGLES, RAYS = 256, 16384

# Weights that make one number of three.
PRIMES = (2654435761, 40503, 2246822519)


def has_gaps(scene, meshes) -> bool:
    """Whether rays slip between the triangles of `meshes`, shapes of `scene`: tried on the first that shares edges."""
    for mesh in meshes:
        o, d, reach = _rays_at_edges(mesh)
        if len(o):
            break
    else:
        return False
    if dr.is_jit_v(mi.Float):
        blocked = scene.ray_test(mi.Ray3f(mi.Point3f(o.T), mi.Vector3f(d.T), mi.Float(reach), 0, []))
        return not dr.all(blocked)
    rays = (mi.Ray3f(mi.Point3f(*a), mi.Vector3f(*b), float(c), 0, []) for a, b, c in zip(o, d, reach, strict=True))
    return not all(map(scene.ray_test, rays))


def _rays_at_edges(mesh):
    """Rays that must meet `mesh`, each at an edge that two of its triangles share: origins, directions, lengths."""
    positions = np.array(mesh.vertex_positions_buffer(), np.float32).reshape(-1, 3)
    faces = np.array(mesh.faces_buffer(), np.int64).reshape(-1, 3)
    few = faces[:: max(len(faces) // TRIANGLES, 1)]
    corners, first, second = _shared_edges(positions, faces, np.isin(np.arange(len(positions)), few))
    if len(first) == 0:
        # No two triangles have a vertex in common, but perhaps a place.
        places = _places(positions)
        corners, first, second = _shared_edges(positions, faces, np.isin(places, places[few]))
    if len(first) == 0:
        return np.empty((0, 3), np.float32), np.empty((0, 3), np.float32), np.empty(0, np.float32)

    chosen = np.resize(np.arange(len(first)), RAYS)
    first, second = first[chosen], second[chosen]
    n, m = (np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]) for t in (corners[first // 3], corners[second // 3]))
    a, b = corners[first // 3, first % 3], corners[first // 3, (first + 1) % 3]
    rng = np.random.default_rng(1)
    d = rng.normal(size=(RAYS, 3))
    d = (d / _length(d)).astype(np.float32)
    # Where a triangle is seen from behind, or both lie on one side, the edge may be an outline, which rays may miss.
    with np.errstate(divide="ignore", invalid="ignore"):
        cosines = [-(d * normal).sum(axis=1) / _length(normal)[:, 0] for normal in (n, m)]
    aside = np.cross(b - a, d)
    sides = [(aside * (corners[k // 3, (k + 2) % 3] - a)).sum(axis=1) for k in (first, second)]
    facing = (np.minimum(*cosines) > 0.2) & (sides[0] * sides[1] < 0)
    a, b, d = a[facing], b[facing], d[facing]
    reach = 3 * _length(b - a)
    o = a + rng.uniform(0.05, 0.95, (len(d), 1)) * (b - a) - d * reach
    # No further than to the edge: behind it the mesh may have another side.
    return o.astype(np.float32), d, (1.001 * reach[:, 0]).astype(np.float32)


def _shared_edges(positions, faces, marked):
    """Corners of the triangles that have two of the vertices `marked`, (n, 3, 3), and, for each edge that two of them
    share, its two numbers: edge k of triangle i is 3 i + k."""
    corners = positions[faces[marked[faces].sum(axis=1) > 1]]
    ends = _places(corners)
    edges = np.sort(np.stack([ends, np.roll(ends, -1, axis=1)], axis=-1), axis=-1).reshape(-1, 2)
    order = np.lexsort(edges.T)
    shared = np.flatnonzero((edges[order][1:] == edges[order][:-1]).all(axis=1))
    return corners, order[shared], order[shared + 1]


def _places(points):
    """A number for each point: vertices at the same place are one, whatever their numbers in the mesh."""
    # -0 is 0.
    return (points + np.float32(0)).view(np.uint32).astype(np.uint64) @ np.array(PRIMES, np.uint64)


def _length(vectors):
    return np.linalg.norm(vectors, axis=-1, keepdims=True)
