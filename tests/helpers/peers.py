"""One scene in three languages, and the two programs that know nothing of Mitsuba and render it.

The scene is the float64 oracle's (`oracle.Scene`): spheres, point lights, a camera.
"""

import math
import re
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from helpers.oracle import Camera, Light, Scene, Sphere

# Half a step of the peers' 16-bit files.
HALF_STEP = 0.5 / 65535

# Tachyon takes a light for hidden where n.l is not above this: it lacks up to 0.002 k_d I there.
TACHYON_HORIZON = 0.001959

# A round trip between the two mirrors keeps k_m k_m' = 0.12 of the light, so that 20 bounces
# leave 6e-10: how a renderer ends the chain does not matter.
BOUNCES = 20


@dataclass(frozen=True)
class Run:
    """A picture of a peer, linear and unmirrored, and what it took."""

    picture: np.ndarray
    seconds: float
    """What the program itself reports for tracing."""
    seconds_in_all: float
    """The whole process, start to written file."""


@dataclass(frozen=True)
class Mesh:
    """A mesh with smooth normals, of one surface; only the peers and Mitsuba render it, not the oracle."""

    path: Path
    """The same as a PLY file, which Mitsuba reads."""
    vertices: np.ndarray
    normals: np.ndarray
    faces: np.ndarray
    kd: tuple
    ks: tuple
    p: float
    km: float = 0.0


@dataclass(frozen=True)
class MeshScene(Scene):
    """A scene with meshes."""

    meshes: tuple[Mesh, ...] = ()


def lecture_scene(lobe):
    """Three balls on a mirrored floor under two lights; no pixel is as bright as 1, where the files end."""

    def material(kd, ks, p, km=0.0):
        return {"kd": kd, "ks": (ks, ks, ks), "p": p, "km": km}

    return Scene(
        [
            Sphere((-2.1, 0, 0), 1, **material((0.8, 0.15, 0.1), 0.35, 20)),
            Sphere((0, 0, -0.8), 1, **material((0.6, 0.45, 0.1), 0.4, 150)),
            Sphere((2.1, 0, 0), 1, **material((0.1, 0.3, 0.75), 0.5, 60, km=0.3)),
            Sphere((0, -51, 0), 50, **material((0.6, 0.55, 0.5), 0.2, 10, km=0.4)),
        ],
        [Light(0.65, (-4, 6, 5)), Light(0.3, (5, 4, 6))],
        Camera(eye=(0, 1.6, 8), view=(0, -1.85, -8), focal=1.1),
        background=(0.35, 0.45, 0.6),
        lobe=lobe,
        bounces=BOUNCES,
    )


# One scene, three languages ---------------------------------------------------------------------


def mitsuba_scene(scene, width, height, integrator="whitted"):
    """The scene in Mitsuba's language."""

    def numbers(v):
        return ", ".join(repr(float(x)) for x in v)

    camera = scene.camera
    target = np.add(camera.eye, camera.view)
    lines = [
        '<scene version="3.0.0">',
        f'<integrator type="{integrator}"><integer name="max_depth" value="{scene.bounces + 2}"/></integrator>',
        '<sensor type="perspective"><string name="fov_axis" value="x"/>',
        f'  <float name="fov" value="{math.degrees(2 * math.atan(0.5 / camera.focal))!r}"/>',
        f'  <float name="near_clip" value="{camera.focal!r}"/>',
        f'  <transform name="to_world"><lookat origin="{numbers(camera.eye)}" target="{numbers(target)}"',
        f'    up="{numbers(camera.up)}"/></transform>',
        '  <sampler type="independent"><integer name="sample_count" value="1"/></sampler>',
        f'  <film type="hdrfilm"><integer name="width" value="{width}"/><integer name="height" value="{height}"/>',
        '    <string name="pixel_format" value="rgb"/><string name="component_format" value="float32"/>',
        '    <rfilter type="box"/></film>',
        "</sensor>",
        f'<emitter type="constant"><rgb name="radiance" value="{numbers(scene.background)}"/></emitter>',
    ]
    for light in scene.lights:
        x, y, z = map(float, light.position)
        lines += [
            f'<emitter type="point"><point name="position" x="{x!r}" y="{y!r}" z="{z!r}"/>',
            f'  <float name="intensity" value="{light.intensity!r}"/></emitter>',
        ]

    def bsdf(shape):
        nested = (
            f'<bsdf type="{scene.lobe}"><rgb name="kd" value="{numbers(shape.kd)}"/>'
            f'<float name="ks" value="{shape.ks[0]!r}"/><float name="p" value="{shape.p!r}"/></bsdf>'
        )
        if shape.km == 0:
            return nested
        return f'<bsdf type="mirrorblend"><float name="km" value="{shape.km!r}"/>{nested}</bsdf>'

    for sphere in scene.spheres:
        x, y, z = map(float, sphere.center)
        lines += [
            f'<shape type="sphere"><point name="center" x="{x!r}" y="{y!r}" z="{z!r}"/>',
            f'  <float name="radius" value="{sphere.radius!r}"/>{bsdf(sphere)}</shape>',
        ]
    for mesh in _meshes(scene):
        lines.append(f'<shape type="ply"><string name="filename" value="{mesh.path}"/>{bsdf(mesh)}</shape>')
    return "\n".join([*lines, "</scene>"]) + "\n"


def povray_scene(scene, width, height):
    """The scene in POV-Ray's language; `direction` is in units of the picture's height."""

    def vector(v):
        return "<" + ", ".join(repr(float(x)) for x in v) + ">"

    camera = scene.camera
    target = np.add(camera.eye, camera.view)
    lines = [
        "#version 3.7;",
        f"global_settings {{ assumed_gamma 1.0 max_trace_level {scene.bounces + 1}",
        "                  adc_bailout 0 ambient_light 0 }",
        f"background {{ rgb {vector(scene.background)} }}",
        f"camera {{ perspective location {vector(camera.eye)} sky {vector(camera.up)}",
        f"         up y right {width / height!r}*x direction {camera.focal * width / height!r}*z",
        f"         look_at {vector(target)} }}",
    ]
    lines += [f"light_source {{ {vector(light.position)}, rgb {light.intensity!r} }}" for light in scene.lights]

    def surface(shape):
        ks = (1 - shape.km) * shape.ks[0]
        highlight = {
            "phong": f"phong {ks!r} phong_size {shape.p!r}",
            "blinnphong": f"specular {ks!r} roughness 1/{shape.p!r}",
        }[scene.lobe]
        return [
            f"  pigment {{ rgb {vector(shape.kd)} }}",
            f"  finish {{ ambient 0 emission 0 diffuse {1 - shape.km!r} {highlight}",
            f"           reflection {{ rgb {shape.km!r} }} }} }}",
        ]

    def listed(name, vectors):
        return f"  {name} {{ {len(vectors)}, " + ", ".join(map(vector, vectors)) + " }"

    for sphere in scene.spheres:
        lines += [f"sphere {{ {vector(sphere.center)}, {sphere.radius!r}", *surface(sphere)]
    for mesh in _meshes(scene):
        faces = ", ".join(f"<{a}, {b}, {c}>" for a, b, c in mesh.faces.tolist())
        lines += ["mesh2 {", listed("vertex_vectors", mesh.vertices), listed("normal_vectors", mesh.normals)]
        lines += [f"  face_indices {{ {len(mesh.faces)}, {faces} }}", *surface(mesh)]
    return "\n".join(lines) + "\n"


def tachyon_scene(scene, width, height):
    """The scene in Tachyon's language; its samples lie half a pixel right of and above the centres."""

    def vector(v):
        return " ".join(repr(float(x)) for x in v)

    camera = scene.camera
    zoom = camera.focal * width / height
    px, py = width / height / zoom, 1 / zoom
    sx, sy = px / width, py / height
    frustum = (-px / 2 - sx / 2, px / 2 - sx / 2, -py / 2 - sy / 2, py / 2 - sy / 2)
    lines = [
        "BEGIN_SCENE",
        f"RESOLUTION {width} {height}",
        f"CAMERA ZOOM {zoom!r} ASPECTRATIO 1.0 ANTIALIASING 0 RAYDEPTH {scene.bounces + 1}",
        f"CENTER {vector(camera.eye)} VIEWDIR {vector(camera.view)} UPDIR {vector(camera.up)}",
        f"FRUSTUM {vector(frustum)} END_CAMERA",
        f"BACKGROUND {vector(scene.background)}",
    ]
    for light in scene.lights:
        lines.append(f"LIGHT CENTER {vector(light.position)} RAD 0.001 COLOR {vector([light.intensity] * 3)}")

    def surface(shape):
        return (
            f"AMBIENT 0 DIFFUSE {1 - shape.km!r} SPECULAR {shape.km!r} OPACITY 1.0\n"
            f"PHONG PLASTIC {(1 - shape.km) * shape.ks[0]!r} PHONG_SIZE {shape.p!r}\n"
            f"COLOR {vector(shape.kd)} TEXFUNC 0"
        )

    for sphere in scene.spheres:
        lines += [f"SPHERE CENTER {vector(sphere.center)} RAD {sphere.radius!r}", f"TEXTURE {surface(sphere)}"]
    for i, mesh in enumerate(_meshes(scene)):
        lines.append(f"TEXDEF surface{i} {surface(mesh)}")
        points, normals = (list(map(vector, v)) for v in (mesh.vertices, mesh.normals))
        for face in mesh.faces.tolist():
            corners = " ".join(f"V{k} {points[v]}" for k, v in enumerate(face))
            lines += [f"STRI {corners}", " ".join(f"N{k} {normals[v]}" for k, v in enumerate(face)), f"surface{i}"]
    return "\n".join([*lines, "END_SCENE"]) + "\n"


def _meshes(scene):
    return getattr(scene, "meshes", ())


# Who renders it ---------------------------------------------------------------------------------


def povray(scene, folder, width, height, threads=2):
    """POV-Ray's picture."""
    (folder / "scene.pov").write_text(povray_scene(scene, width, height))
    options = [f"+W{width}", f"+H{height}", "-D", "-A", "+FP16", "File_Gamma=1.0", f"+WT{threads}"]
    return _run(["povray", "+Iscene.pov", "+Oscene.ppm", *options], folder, r"Trace Time:.*\(([\d.]+) seconds\)")


def tachyon(scene, folder, width, height, threads=2):
    """Tachyon's picture."""
    (folder / "scene.dat").write_text(tachyon_scene(scene, width, height))
    shade = {"phong": "-shade_phong", "blinnphong": "-shade_blinn"}[scene.lobe]
    options = ["-fullshade", shade, "-format", "PPM48", "-numthreads", str(threads)]
    command = ["tachyon", "scene.dat", *options, "-o", "scene.ppm"]
    # Its 16 bits are truncated: the middle of the step is half a step up.
    return _run(command, folder, r"Ray Tracing Time:\s*([\d.]+) seconds", HALF_STEP)


def _run(command, folder, trace_time, offset=0.0):
    # POV-Ray shows its progress with carriage returns.
    with (folder / "log.txt").open("w") as log:
        start = time.perf_counter()
        subprocess.run(
            command,
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            timeout=300,
            check=True,
        )
        seconds_in_all = time.perf_counter() - start
    seconds = float(re.search(trace_time, (folder / "log.txt").read_text(errors="replace")).group(1))
    return Run(read_ppm(folder / "scene.ppm") + offset, seconds, seconds_in_all)


def read_ppm(path):
    """A 16-bit PPM as floats up to 1; the peers' cameras are left-handed, so it is mirrored."""
    data = path.read_bytes()
    header = re.match(rb"P6\s+(?:#.*\n)*(\d+)\s+(\d+)\s+65535\s", data)
    width, height = map(int, header.groups())
    return np.frombuffer(data, ">u2", offset=header.end()).reshape(height, width, 3)[:, ::-1] / 65535
