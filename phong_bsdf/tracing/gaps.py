"""Whether rays slip between two triangles of a mesh: some are aimed at edges that triangles share."""

import math

import drjit as dr
import mitsuba as mi
import numpy as np

# Meshes that are tried, triangles of each whose edges are looked at, and rays aimed at them, of which most count. Of
# those one in fifty or more slips through a scene without the flag.
MESHES, TRIANGLES, RAYS = 16, 256, 16384

# Weights that make one number of three.
PRIMES = (2654435761, 40503, 2246822519)

# How far from an edge, in its lengths, the rays start: some near, where other surfaces are close.
NEAR, FAR = 0.05, 3.0

# What counts as a hit of the edge that a ray was aimed at, relative to the distance, and to the coordinates.
CLOSE, ROUNDING = 1e-3, 2**-20


def has_gaps(scene, meshes) -> bool:
    """Whether rays slip between the triangles of `meshes`, shapes of `scene`."""
    tried = [rays for mesh in meshes[:MESHES] if len((rays := _rays_at_edges(mesh))[0])]
    if not tried:
        return False
    o, d, reach = (np.concatenate(parts) for parts in zip(*tried, strict=True))
    if dr.is_jit_v(mi.Float):
        ray = dr.zeros(mi.Ray3f, len(o))
        ray.o, ray.d, ray.maxt = mi.Point3f(o.T), mi.Vector3f(d.T), mi.Float(dr.inf)
        found = scene.ray_intersect_preliminary(ray).t.numpy()
    else:
        found = np.array([_distance(scene, *ray) for ray in zip(o.tolist(), d.tolist(), strict=True)])
    # What is met before is another surface.
    return bool((found > (1 + CLOSE) * reach + ROUNDING * np.abs(o).max(axis=1)).any())


def _distance(scene, o, d) -> float:
    ray = dr.zeros(mi.Ray3f)
    ray.o, ray.d, ray.maxt = o, d, math.inf
    return scene.ray_intersect_preliminary(ray).t


def _rays_at_edges(mesh):
    """Rays that must meet `mesh`, each at an edge that two of its triangles share: origins, directions, distances."""
    positions = np.array(mesh.vertex_positions_buffer(), np.float32).reshape(-1, 3)
    faces = np.array(mesh.faces_buffer(), np.int64).reshape(-1, 3)
    few = faces[:: max(len(faces) // TRIANGLES, 1)]
    corners, first, second = _shared_edges(positions, faces, np.isin(np.arange(len(positions)), few))
    if len(first) == 0 and len(faces):
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
    # Where both triangles lie on one side of the edge, or nearly so, it is an outline, which rays may miss.
    with np.errstate(divide="ignore", invalid="ignore"):
        cosines = [np.abs((d * normal).sum(axis=1)) / _length(normal)[:, 0] for normal in (n, m)]
    aside = np.cross(b - a, d)
    sides = [(aside * (corners[k // 3, (k + 2) % 3] - a)).sum(axis=1) for k in (first, second)]
    count = (np.minimum(*cosines) > 0.2) & (sides[0] * sides[1] < 0)
    a, b, d = a[count], b[count], d[count]
    reach = _length(b - a) * np.exp(rng.uniform(np.log(NEAR), np.log(FAR), (len(d), 1)))
    o = a + rng.uniform(0.05, 0.95, (len(d), 1)) * (b - a) - d * reach
    return o.astype(np.float32), d, reach[:, 0].astype(np.float32)


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
