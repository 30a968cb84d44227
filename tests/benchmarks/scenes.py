"""The scenes that are timed: each function returns one, loaded, with `whitted`, of `size` pixels square."""

import mitsuba as mi
import numpy as np

from helpers import SCENES, oracle, peers
from phong_bsdf.tracing.needs import ROBUST

# `max_depth` where nothing else is said: the course's eight mirror bounces.
DEPTH = 10


def _file(name, size, depth=DEPTH):
    return mi.load_file(str(SCENES / name), width=str(size), height=str(size), max_depth=str(depth))


def lecture(size, depth=DEPTH):
    """Three balls on a mirrored floor, two lights, a background."""
    return _file("lecture/mirror-floor.xml", size, depth)


def course(size):
    """Course scene 6: a floor of radius 5000, half a mirror, beside a large mirrored ball."""
    return _file("course/scene-6.xml", size)


def look(size, eye, target, fov=45):
    """A camera of `size` pixels square, one sample a pixel, box filter."""
    return {
        "type": "perspective",
        "fov": fov,
        "to_world": mi.ScalarTransform4f().look_at(eye, target, [0, 1, 0]),
        "sampler": {"type": "independent", "sample_count": 1},
        "film": {"type": "hdrfilm", "width": size, "height": size, "pixel_format": "rgb", "rfilter": {"type": "box"}},
    }


def _load(size, eye, target, objects, depth=DEPTH, **integrator):
    return mi.load_dict({
        "type": "scene",
        "integrator": {"type": "whitted", "max_depth": depth, **integrator},
        "sensor": look(size, eye, target),
        **objects,
    })  # fmt: skip


def lights_around(n, radius=8.0, height=6.0):
    """`n` point lights on a circle, of intensities that add up to 1."""
    turn = 2 * np.pi * (np.arange(n) + 0.3) / n
    positions = np.stack([radius * np.cos(turn), np.full(n, height), radius * np.sin(turn)], axis=-1)
    return {
        f"light_{i}": {"type": "point", "position": p.tolist(), "intensity": 1 / n} for i, p in enumerate(positions)
    }


def terrain(triangles, bsdf):
    """A mesh of hills over the square from -4 to 4, with smooth normals, of at least `triangles` triangles."""
    side = int(np.ceil(np.sqrt(triangles / 2))) + 1
    x, z = np.meshgrid(*2 * [np.linspace(-4, 4, side)])
    y = 0.35 * np.sin(2.1 * x) * np.cos(1.7 * z) + 0.12 * np.sin(7.3 * x + 1) * np.sin(6.1 * z)
    y += 0.02 * np.sin(31 * x) * np.cos(29 * z)
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    faces = np.concatenate([
        np.stack([corner, corner + side, corner + 1], axis=-1),
        np.stack([corner + 1, corner + side, corner + side + 1], axis=-1),
    ])  # fmt: skip
    props = mi.Properties()
    props["bsdf"] = mi.load_dict(bsdf)
    mesh = mi.Mesh("terrain", side * side, len(faces), has_vertex_normals=True, props=props)
    params = mi.traverse(mesh)
    params["vertex_positions"] = np.stack([x, y, z], axis=-1).ravel().astype(np.float32)
    params["faces"] = faces.ravel().astype(np.uint32)
    params.update()
    return mesh


def mesh(size, triangles=524_288, robust=True):
    """Hills of that many triangles under four lights, Blinn-Phong; `robust`: no ray slips between two triangles."""
    bsdf = {"type": "blinnphong", "kd": {"type": "rgb", "value": [0.5, 0.6, 0.3]}, "ks": 0.3, "p": 40}
    return _load(
        size, [0, 4, 7], [0, -0.4, 0], {ROBUST: robust, "terrain": terrain(triangles, bsdf), **lights_around(4)}
    )


def sphere_grid(n, materials):
    """`n` spheres, one of them the floor and the others in a square grid on it, with `materials` different surfaces,
    as the oracle's scene."""
    side = int(np.ceil(np.sqrt(max(n - 1, 1))))
    colours = np.random.default_rng(5).uniform(0.2, 0.8, (materials, 3))
    spheres = []
    for i in range(n):
        m = i % materials
        look = {"kd": tuple(colours[m].tolist()), "ks": (0.2,) * 3, "p": 10.0 + m}
        if i == 0:
            spheres.append(oracle.Sphere((0.0, -50.4, 0.0), 50.0, **look))
            continue
        row, column = divmod(i - 1, side)
        x, z = ((np.array([column, row]) + 0.5) / side - 0.5) * 8
        spheres.append(oracle.Sphere((float(x), 0.0, float(z)), 3.2 / side, **look))
    return oracle.Scene(
        spheres,
        [oracle.Light(0.4, (-4, 7, 5)), oracle.Light(0.3, (5, 6, 6))],
        oracle.Camera(eye=(0, 5, 8), view=(0, -5.2, -8), focal=1.1),
        background=(0.35, 0.45, 0.6),
        bounces=DEPTH - 2,
    )


def spheres(size, n=100, materials=100):
    """That many spheres with that many different materials under two lights."""
    return mi.load_string(peers.mitsuba_scene(sphere_grid(n, materials), size, size))


def _bitmap(side, channels, low, high, seed):
    values = np.random.default_rng(seed).uniform(low, high, (side, side, channels)).astype(np.float32)
    return {"type": "bitmap", "data": mi.TensorXf(values), "raw": True}


def textured(size, side=512):
    """Three balls and a floor whose kd, ks and p are bitmaps; the floor mirrors."""

    def bsdf(seed):
        return {
            "type": "blinnphong",
            "kd": _bitmap(side, 3, 0.1, 0.9, seed),
            "ks": _bitmap(side, 3, 0.1, 0.5, seed + 1),
            "p": _bitmap(side, 1, 5, 100, seed + 2),
        }

    balls = {
        f"ball_{i}": {"type": "sphere", "center": [2.1 * (i - 1), 0, 0], "bsdf": bsdf(10 * i)} for i in range(3)
    }  # fmt: skip
    floor = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(20),
        "bsdf": {"type": "mirrorblend", "km": 0.3, "nested": bsdf(40)},
    }
    return _load(size, [0, 1.6, 8], [0, -0.25, 0], {**balls, "floor": floor, **lights_around(2)})


def lit(size, lights=1):
    """Three balls on a dull floor, all of one Blinn-Phong surface, under that many lights."""
    return _load(size, [0, 1.6, 8], [0, -0.25, 0], {**_still_life({"type": "blinnphong"}), **lights_around(lights)})


def _still_life(bsdf):
    balls = {f"ball_{i}": {"type": "sphere", "center": [2.1 * (i - 1), 0, 0], "bsdf": bsdf} for i in range(3)}
    floor = mi.ScalarTransform4f().translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(20)
    return {**balls, "floor": {"type": "rectangle", "to_world": floor, "bsdf": bsdf}}


def under(size, bsdf, integrator):
    """The same balls and floor with the BSDF and the integrator of these dictionaries, under one light."""
    return mi.load_dict({
        "type": "scene",
        "integrator": integrator,
        "sensor": look(size, [0, 1.6, 8], [0, -0.25, 0]),
        **_still_life(bsdf),
        **lights_around(1),
    })  # fmt: skip


def bouncing(size, bounces=8, robust=True):
    """The camera inside a closed box of mirrors with a ball in it: every ray goes on until the budget ends; `robust` as
    in `mesh`."""
    mirror = {"type": "mirrorblend", "km": 0.8, "nested": {"type": "blinnphong", "ks": 0.2}}
    walls = {"type": "cube", "flip_normals": True, "to_world": mi.ScalarTransform4f().scale(4), "bsdf": mirror}
    ball = {"type": "sphere", "center": [0, -1, 0], "bsdf": mirror}
    light = {"type": "point", "position": [1, 3, 1], "intensity": 0.8}
    objects = {ROBUST: robust, "walls": walls, "ball": ball, "light": light}
    return _load(size, [0.5, 1, 3.5], [0, -0.5, 0], objects, depth=bounces + 2)
