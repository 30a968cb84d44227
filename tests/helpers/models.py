"""OBJ models to convert: a square that faces the camera which the converter makes, and what its lights add up to."""

import re
import xml.etree.ElementTree as ET

import mitsuba as mi
import numpy as np

import phong_bsdf  # noqa: F401
from phong_bsdf.importers import convert_model, model

VIEW = np.array(model.VIEW) / np.linalg.norm(model.VIEW)
RIGHT = np.cross([0.0, 1.0, 0.0], VIEW) / np.linalg.norm(np.cross([0.0, 1.0, 0.0], VIEW))
UP = np.cross(VIEW, RIGHT)


def square(material="m", *, shift=0.0, turn=1, uv=True):
    """A square that faces the camera, `shift` nearer to it, with the corners of its texture at its corners."""
    corners = [x * RIGHT + y * UP + shift * VIEW for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    lines = ["v {:.9f} {:.9f} {:.9f}".format(*c) for c in corners]
    order = [-4, -3, -2, -1][::turn]
    lines += ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1"] * uv
    face = " ".join(f"{i}/{i}" if uv else f"{i}" for i in order)
    return "\n".join([*lines, f"usemtl {material}", f"f {face}", ""])


def converting(tmp_path):
    """convert(obj, mtl) -> the conversion, the text of the new scene, a function that renders it."""

    def run(obj, mtl="", **options):
        (tmp_path / "a.obj").write_text(f"mtllib a.mtl\n{obj}")
        (tmp_path / "a.mtl").write_text(mtl)
        result = convert_model(tmp_path / "a.obj", tmp_path / "new.xml", **options)
        text = re.sub(r">\s+<", "><", re.sub(r"<!--.*?-->", "", result.output.read_text(), flags=re.S))

        def render(size=15, spp=1):
            scene = mi.load_file(str(result.output), width=str(size), height=str(size), spp=str(spp))
            return np.array(mi.render(scene))

        return result, text, render

    return run


def sums(scene_text, p):
    """Of the lights of a scene, seen along the square's normal: sum of I n.l, and of I (n.h)^p."""
    root = ET.fromstring(scene_text)
    diffuse = specular = 0.0
    for light in root.iter("emitter"):
        if light.get("type") == "directional":
            direction = light.find("vector")
            toward = -np.array([float(direction.get(axis)) for axis in "xyz"])
            toward /= np.linalg.norm(toward)
            h = (toward + VIEW) / np.linalg.norm(toward + VIEW)
            intensity = float(light.find("rgb").get("value"))
            diffuse += intensity * (toward @ VIEW)
            specular += intensity * (h @ VIEW) ** p * (toward @ VIEW > 0)
    return diffuse, specular


KD, KS, NS, BACK = np.array([0.6, 0.3, 0.1]), np.array([0.2, 0.3, 0.4]), 20, model.BACKGROUND
MTL = "newmtl m\nKd 0.6 0.3 0.1\nKs 0.2 0.3 0.4\nNs 20\n"
