"""Small scenes, and what they are made of."""

import mitsuba as mi
import numpy as np

PHONG = {"type": "phong", "kd": {"type": "rgb", "value": [0.8, 0.3, 0.1]}, "ks": 0.4, "p": 20}
BLINN = {"type": "blinnphong", "kd": 0.3, "ks": {"type": "rgb", "value": [0.1, 0.5, 0.9]}, "p": 200}
POINTS = {f"light {i}": {"type": "point", "position": [i - 2, 3, -1 - i], "intensity": 0.2} for i in range(6)}
SUN = {"sun": {"type": "directional", "direction": [0.3, -1, 0.4], "irradiance": 0.4}}


def render(scene, **options):
    scene = mi.load_dict(scene) if isinstance(scene, dict) else scene
    return np.array(mi.render(scene, **options))


def film(width, height=None, rfilter="box"):
    return {
        "type": "hdrfilm", "width": width, "height": height or width, "pixel_format": "rgb",
        "component_format": "float32", "rfilter": {"type": rfilter},
    }  # fmt: skip


def look(origin, target, width=16, fov=40.0, spp=1, **more):
    up = [0, 1, 0] if abs(origin[0] - target[0]) + abs(origin[2] - target[2]) > 0 else [0, 0, 1]
    return {
        "type": "perspective", "fov": fov, "film": film(width), "near_clip": 1e-3, **more,
        "to_world": mi.ScalarTransform4f().look_at(origin, target, up),
        "sampler": {"type": "independent", "sample_count": spp},
    }  # fmt: skip


def point(position, intensity=1.0):
    return {"type": "point", "position": list(position), "intensity": intensity}


def rgb(*value):
    return {"type": "rgb", "value": list(value)}


def balls(bsdfs, lights, size=48, spp=1, **options):
    """A scene: balls in a row on a floor of the last material."""
    t = mi.ScalarTransform4f
    *row, floor = bsdfs if len(bsdfs) > 1 else bsdfs * 2
    shapes = {
        f"ball {i}": {"type": "sphere", "center": [2.2 * i - 1.1 * (len(row) - 1), 0, 0], "bsdf": bsdf}
        for i, bsdf in enumerate(row)
    }
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "whitted", **options},
            "sensor": {
                "type": "perspective",
                "to_world": t().look_at([0, 2, 8], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
                "sampler": {"type": "independent", "sample_count": spp},
            },
            "floor": {
                "type": "rectangle",
                "to_world": t().translate([0, -1, 0]).rotate([1, 0, 0], -90).scale([9, 9, 1]),
                "bsdf": floor,
            },
            **shapes,
            **lights,
        }
    )
