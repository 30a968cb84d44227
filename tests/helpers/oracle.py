"""The lecture's ray tracer in float64 NumPy: slow, plain, and written from the formulas alone.

No Mitsuba, no Dr.Jit, nothing of the package. Spheres, triangle meshes with interpolated normals, point and
directional lights, shadows, mirrors; one ray through each pixel's centre. `physical` is Mitsuba's convention:
falloff, 1/pi, and behind the last mirror nothing but the background.
"""

from dataclasses import dataclass, field

import numpy as np

WHITE = (1.0, 1.0, 1.0)
BLACK = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Sphere:
    center: tuple
    radius: float
    kd: tuple = WHITE
    ks: tuple = BLACK
    p: float = 1.0
    km: float = 0.0

    def hit(self, o, d, start):
        """Distance along each ray to the sphere, beyond `start`; infinity where it is missed."""
        oc = o - np.array(self.center)
        b = dot(oc, d)
        disc = b * b - (dot(oc, oc) - self.radius**2)
        root, nearest = np.sqrt(np.maximum(disc, 0)), np.full(len(o), np.inf)
        for t in (-b + root, -b - root):
            nearest = np.where((disc >= 0) & (t > start) & (t < nearest), t, nearest)
        return nearest

    def normals(self, o, d, t):
        """Geometric and shading normal at `t` along each ray."""
        n = (o + t[:, None] * d - np.array(self.center)) / self.radius
        return n, n


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles: positions and, for each of these, a normal, (n, 3), and the numbers of their corners, (m, 3)."""

    positions: np.ndarray
    vertex_normals: np.ndarray
    faces: np.ndarray
    kd: tuple = WHITE
    ks: tuple = BLACK
    p: float = 1.0
    km: float = 0.0
    radius = 1.0

    def _hits(self, o, d, start):
        """Distance, triangle, and two barycentric coordinates."""
        a, b, c = (self.positions[self.faces[:, k]] for k in range(3))
        e, f, tests = b - a, c - a, []
        for rays in np.array_split(np.arange(len(o)), max(len(o) // 2048, 1)):
            begin = np.broadcast_to(start, len(o))[rays, None]
            across = np.cross(d[rays, None], f)
            with np.errstate(divide="ignore", invalid="ignore"):
                inverse = 1 / dot(e, across)
                from_a = o[rays, None] - a
                u = dot(from_a, across) * inverse
                other = np.cross(from_a, e)
                v = dot(d[rays, None], other) * inverse
                t = dot(f, other) * inverse
            t = np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > begin), t, np.inf)
            k = np.argmin(t, axis=1)
            row = np.arange(len(rays))
            tests.append((t[row, k], k, u[row, k], v[row, k]))
        return [np.concatenate(x) for x in zip(*tests, strict=True)]

    def hit(self, o, d, start):
        """As that of `Sphere`."""
        return self._hits(o, d, start)[0]

    def normals(self, o, d, t):
        """As that of `Sphere`; the shading normal is interpolated."""
        _, k, u, v = self._hits(o, d, t - 1e-7)
        a, b, c = (self.positions[self.faces[k, i]] for i in range(3))
        na, nb, nc = (self.vertex_normals[self.faces[k, i]] for i in range(3))
        shading = (1 - u - v)[:, None] * na + u[:, None] * nb + v[:, None] * nc
        return normalize(np.cross(b - a, c - a)), normalize(shading)


@dataclass(frozen=True)
class Light:
    """A point light at `position`, or a directional one with the direction `toward` it."""

    intensity: float
    position: tuple | None = None
    toward: tuple | None = None


@dataclass(frozen=True)
class Camera:
    """Eye, view direction and up; the image is one unit wide at distance `focal`, where seeing begins."""

    eye: tuple = (0, 0, 0)
    view: tuple = (0, 0, -1)
    up: tuple = (0, 1, 0)
    focal: float = 1.0


@dataclass(frozen=True)
class Scene:
    spheres: list
    lights: list = field(default_factory=list)
    camera: Camera = field(default_factory=Camera)
    background: tuple = BLACK
    ambient: float = 0.0
    lobe: str = "blinnphong"
    bounces: int = 8
    physical: bool = False
    meshes: list = field(default_factory=list)

    @property
    def shapes(self):
        return [*self.spheres, *self.meshes]


def normalize(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def dot(a, b):
    return np.einsum("...i,...i->...", a, b)


def render(scene, width=490, height=490, start=None):
    """Linear image, (height, width, 3); sees what is beyond `start`, by default beyond the image plane."""
    camera = scene.camera
    back = -normalize(np.array(camera.view, float))
    right = normalize(np.cross(camera.up, back))
    up = np.cross(back, right)
    x = (np.arange(width) + 0.5) / width - 0.5
    y = (0.5 - (np.arange(height) + 0.5) / height) * height / width
    plane = x[None, :, None] * right + y[:, None, None] * up - camera.focal * back
    d = normalize(plane).reshape(-1, 3)
    o = np.broadcast_to(np.array(camera.eye, float), d.shape)
    start = np.linalg.norm(plane, axis=-1).reshape(-1) if start is None else start
    return radiance(scene, o, d, scene.bounces, start).reshape(height, width, 3)


def intersect(scene, o, d, start):
    """Distance to and index of the nearest shape beyond `start`; infinity and -1 where there is none."""
    nearest, index = np.full(len(o), np.inf), np.full(len(o), -1)
    for i, shape in enumerate(scene.shapes):
        t = shape.hit(o, d, start)
        nearest, index = np.where(t < nearest, t, nearest), np.where(t < nearest, i, index)
    return nearest, index


def radiance(scene, o, d, bounces, start):
    image = np.tile(np.array(scene.background, float), (len(o), 1))
    if len(o) == 0:
        return image
    t, index = intersect(scene, o, d, start)
    if bounces < 0:
        return np.where((index >= 0)[:, None], 0, image)
    for i, shape in enumerate(scene.shapes):
        hit = index == i
        if not hit.any():
            continue
        p = o[hit] + t[hit, None] * d[hit]
        ng, n = shape.normals(o[hit], d[hit], t[hit])
        v = -d[hit]
        # The lecture asks for n.l, n.h and r.v, not for n.v: black only where both normals face away.
        front = (dot(ng, v) > 0) | (dot(n, v) > 0)
        if scene.physical:
            front = dot(n, v) > 0
        color = local(scene, shape, p, ng, n, v, front)
        if shape.km > 0 and (bounces > 0 or scene.physical):
            r = 2 * dot(n, v)[:, None] * n - v
            mirrored = radiance(scene, leave(shape, p, ng, r), r, bounces - 1, 0.0)
            color = np.where(front[:, None], shape.km * mirrored, 0) + (1 - shape.km) * color
        image[hit] = color
    return image


def leave(shape, p, ng, d):
    """Where a ray starts that leaves `p` in the direction `d`."""
    return p + 1e-9 * shape.radius * np.sign(dot(ng, d))[:, None] * ng


def local(scene, shape, p, ng, n, v, front):
    """Ambient, diffuse and specular light of all lights at the points `p`."""
    color = np.tile(scene.ambient * np.array(shape.kd, float), (len(p), 1))
    for light in scene.lights:
        if light.position is not None:
            toward = np.array(light.position, float) - p
            distance = np.linalg.norm(toward, axis=-1)
            l = toward / distance[:, None]  # noqa: E741
        else:
            l = np.broadcast_to(normalize(np.array(light.toward, float)), p.shape)  # noqa: E741
            distance = np.full(len(p), np.inf)
        t, _ = intersect(scene, leave(shape, p, ng, l), l, 0.0)
        lit = front & (dot(n, l) > 0) & (t >= distance)
        falloff = np.pi * np.where(np.isfinite(distance), distance**2, 1) if scene.physical else 1
        color += np.where(lit, light.intensity / falloff, 0)[:, None] * unit_point(shape, n, l, v, scene.lobe)
    return color


def unit_point(material, n, l, v, lobe):  # noqa: E741
    """k_d max(0, n.l) + k_s lobe^p for light from `l` seen from `v`."""
    if lobe == "phong":
        r = 2 * dot(n, l)[..., None] * n - l
        cos = dot(r, v)
    else:
        cos = dot(n, normalize(v + l))
    diffuse = np.maximum(dot(n, l), 0)[..., None] * np.array(material.kd)
    return diffuse + np.maximum(cos, 0)[..., None] ** material.p * np.array(material.ks)


# The course's scenes, as the contract lists them ------------------------------------------------

BLUE = (0.0, 0.0, 1.0)
FLOOR = ((0, -5001, 0), 5000)

COURSE = {
    1: Scene([Sphere((0, 0, -5), 1, (0.73, 0, 0.17))], ambient=1.0, background=(0.95, 0.95, 0.95)),
    2: Scene([Sphere((2, 0, -8), 1), Sphere((-2, 0, -8), 2, BLUE)], [Light(1, toward=(1, 0.5, -0.1))]),
    3: Scene([Sphere((-2, 1, -8), 1), Sphere((2, 1, -8), 1)], [Light(1, (0, 5, -8.5))]),
    4: Scene(
        [
            Sphere((-2, -1, -8), 1, WHITE, WHITE, 10),
            Sphere((2, -1, -8), 1, WHITE, WHITE, 10),
            Sphere((-1, 1, -8), 1, BLUE, WHITE, 10),
            Sphere((1, 1, -8), 1, BLUE, WHITE, 10),
            Sphere((0, -1, -8), 1, BLUE, (1, 0, 0), 100),
            Sphere(*FLOOR),
        ],
        [Light(0.8, (0, 4, -8)), Light(0.2, (0, 0, 0))],
    ),
    5: Scene(
        [
            Sphere((-1, 0, -6), 0.5),
            Sphere((1, 0, -5), 0.5, km=0.4),
            Sphere((-1, 0, -4), 0.5),
            Sphere(*FLOOR, km=0.5),
        ],
        [Light(0.6, toward=(1, 1, 0)), Light(0.4, (0, 0, 0))],
    ),
    6: Scene(
        [
            Sphere((-1, -1.1, -3), 0.5, (1, 0, 0), WHITE, 10),
            Sphere((-0.5, -1, -4), 0.5, (0, 1, 0), WHITE, 10),
            Sphere((0, -0.9, -5), 0.5, BLUE, WHITE, 10),
            Sphere((5, -1, -4), 4, km=0.6),
            Sphere(*FLOOR, km=0.5),
        ],
        [Light(0.6, (1, 10, -4)), Light(0.4, (0, 0, 0))],
    ),
}

CAMERAS = {
    1: Camera(),
    2: Camera(eye=(20, 4, 10), view=(-21, -4, -15), focal=8),
    3: Camera(eye=(-1, 0.8, -1.2), view=(1, -1, -1), focal=0.3),
}
