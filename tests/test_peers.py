"""POV-Ray and Tachyon, which know nothing of Mitsuba, render the picture that the package renders.

The float64 oracle renders it too, so that a disagreement says who is wrong. Pixels on an
edge are judged apart: there the last bit of a coordinate chooses between two colours.
"""

import dataclasses
import math
import re
import shutil
import subprocess
from unittest import mock

import numpy as np
import oracle
import pytest
from oracle import Camera, Light, Scene, Sphere

import phong_bsdf  # noqa: F401  # isort: skip  (before mitsuba: it chooses the LLVM)
import mitsuba as mi  # isort: skip

WIDTH, HEIGHT = 128, 96

# Half a step of the peers' 16-bit files, and the single precision of their colours.
PEER_ERROR = 0.5 / 65535 + 1e-6

# What float32 loses on the way. Measured: 6.8e-6, where the floor mirrors the highlight of p = 150,
# and 8.6e-6 on an edge.
PACKAGE_ERROR = 1.1e-5

# The sum of both: what an outside check of a float32 renderer can see.
BAR = 2e-5

# Tachyon takes a light for hidden where n.l is not above this: it lacks up to 0.002 k_d I there.
TACHYON_HORIZON = 0.001959

# A round trip between the two mirrors keeps k_m k_m' = 0.12 of the light, so that 20 bounces
# leave 6e-10: how a renderer ends the chain does not matter.
BOUNCES = 20


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


def mitsuba_scene(scene):
    """The scene as Mitsuba's dictionary, rendered by `whitted`."""
    camera = scene.camera
    target = [float(e + v) for e, v in zip(camera.eye, camera.view, strict=True)]
    result = {
        "type": "scene",
        "integrator": {"type": "whitted", "max_depth": scene.bounces + 2},
        "sensor": {
            "type": "perspective",
            "fov_axis": "x",
            "fov": math.degrees(2 * math.atan(0.5 / camera.focal)),
            "near_clip": camera.focal,
            "to_world": mi.ScalarTransform4f().look_at(list(camera.eye), target, list(camera.up)),
            "sampler": {"type": "independent", "sample_count": 1},
            "film": {
                "type": "hdrfilm",
                "width": WIDTH,
                "height": HEIGHT,
                "pixel_format": "rgb",
                "component_format": "float32",
                "rfilter": {"type": "box"},
            },
        },
        "background": {"type": "constant", "radiance": {"type": "rgb", "value": list(scene.background)}},
    }
    for i, light in enumerate(scene.lights):
        position = list(light.position)
        result[f"light_{i}"] = {"type": "point", "position": position, "intensity": light.intensity}
    for i, sphere in enumerate(scene.spheres):
        bsdf = {
            "type": scene.lobe,
            "kd": {"type": "rgb", "value": list(sphere.kd)},
            "ks": sphere.ks[0],
            "p": sphere.p,
        }
        if sphere.km > 0:
            bsdf = {"type": "mirrorblend", "km": sphere.km, "nested": bsdf}
        center = list(sphere.center)
        result[f"sphere_{i}"] = {"type": "sphere", "center": center, "radius": sphere.radius, "bsdf": bsdf}
    return result


def povray_scene(scene):
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
        f"         up y right {WIDTH / HEIGHT!r}*x direction {camera.focal * WIDTH / HEIGHT!r}*z",
        f"         look_at {vector(target)} }}",
    ]
    lines += [f"light_source {{ {vector(light.position)}, rgb {light.intensity!r} }}" for light in scene.lights]
    for sphere in scene.spheres:
        ks = (1 - sphere.km) * sphere.ks[0]
        highlight = {
            "phong": f"phong {ks!r} phong_size {sphere.p!r}",
            "blinnphong": f"specular {ks!r} roughness 1/{sphere.p!r}",
        }[scene.lobe]
        lines += [
            f"sphere {{ {vector(sphere.center)}, {sphere.radius!r}",
            f"  pigment {{ rgb {vector(sphere.kd)} }}",
            f"  finish {{ ambient 0 emission 0 diffuse {1 - sphere.km!r} {highlight}",
            f"           reflection {{ rgb {sphere.km!r} }} }} }}",
        ]
    return "\n".join(lines) + "\n"


def tachyon_scene(scene):
    """The scene in Tachyon's language; its samples lie half a pixel right of and above the centres."""

    def vector(v):
        return " ".join(repr(float(x)) for x in v)

    camera = scene.camera
    zoom = camera.focal * WIDTH / HEIGHT
    px, py = WIDTH / HEIGHT / zoom, 1 / zoom
    sx, sy = px / WIDTH, py / HEIGHT
    frustum = (-px / 2 - sx / 2, px / 2 - sx / 2, -py / 2 - sy / 2, py / 2 - sy / 2)
    lines = [
        "BEGIN_SCENE",
        f"RESOLUTION {WIDTH} {HEIGHT}",
        f"CAMERA ZOOM {zoom!r} ASPECTRATIO 1.0 ANTIALIASING 0 RAYDEPTH {scene.bounces + 1}",
        f"CENTER {vector(camera.eye)} VIEWDIR {vector(camera.view)} UPDIR {vector(camera.up)}",
        f"FRUSTUM {vector(frustum)} END_CAMERA",
        f"BACKGROUND {vector(scene.background)}",
    ]
    for light in scene.lights:
        lines.append(f"LIGHT CENTER {vector(light.position)} RAD 0.001 COLOR {vector([light.intensity] * 3)}")
    for sphere in scene.spheres:
        lines += [
            f"SPHERE CENTER {vector(sphere.center)} RAD {sphere.radius!r}",
            f"TEXTURE AMBIENT 0 DIFFUSE {1 - sphere.km!r} SPECULAR {sphere.km!r} OPACITY 1.0",
            f"PHONG PLASTIC {(1 - sphere.km) * sphere.ks[0]!r} PHONG_SIZE {sphere.p!r}",
            f"COLOR {vector(sphere.kd)} TEXFUNC 0",
        ]
    return "\n".join([*lines, "END_SCENE"]) + "\n"


# Who renders it ---------------------------------------------------------------------------------


def run(command, folder):
    """Runs a peer; what it prints goes to `log.txt`, the picture comes back linear and unmirrored."""
    with (folder / "log.txt").open("w") as log:
        subprocess.run(
            command,
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            timeout=60,
            check=True,
        )
    data = (folder / "scene.ppm").read_bytes()
    header = re.match(rb"P6\s+(?:#.*\n)*(\d+)\s+(\d+)\s+65535\s", data)
    width, height = map(int, header.groups())
    pixels = np.frombuffer(data, ">u2", offset=header.end()).reshape(height, width, 3)
    # Both cameras are left-handed.
    return pixels[:, ::-1] / 65535


def povray(scene, folder):
    (folder / "scene.pov").write_text(povray_scene(scene))
    size = [f"+W{WIDTH}", f"+H{HEIGHT}"]
    options = ["-D", "-A", "+FP16", "File_Gamma=1.0", "+WT2"]
    return run(["povray", "+Iscene.pov", "+Oscene.ppm", *size, *options], folder)


def tachyon(scene, folder):
    """Tachyon's picture, and the light that it leaves out at the horizon of each surface."""
    (folder / "scene.dat").write_text(tachyon_scene(scene))
    shade = {"phong": "-shade_phong", "blinnphong": "-shade_blinn"}[scene.lobe]
    options = ["-fullshade", shade, "-format", "PPM48", "-numthreads", "2"]
    picture = run(["tachyon", "scene.dat", *options, "-o", "scene.ppm"], folder)
    # Its 16 bits are truncated: the middle of the step is half a step up.
    return picture + 0.5 / 65535 + horizon_light(scene)


def oracle_with(shade, scene, width=WIDTH, height=HEIGHT):
    """The oracle's picture with another local shading than the lecture's."""
    with mock.patch.object(oracle, "unit_point", shade):
        return oracle.render(scene, width, height)


def horizon_light(scene):
    """The part of the picture that light with n.l <= TACHYON_HORIZON makes; the rest of it is black."""
    unit_point = oracle.unit_point

    def shade(material, n, l, v, lobe):  # noqa: E741
        low = oracle.dot(n, l)[:, None] <= TACHYON_HORIZON
        return np.where(low, unit_point(material, n, l, v, lobe), 0)

    return oracle_with(shade, dataclasses.replace(scene, background=oracle.BLACK))


def near_edges(scene):
    """Pixels with a silhouette or a shadow's edge within 1/9 of a pixel of their centre.

    Where all shading is one flat colour for each surface and light, the oracle's picture is
    constant between the edges, those seen in mirrors included. The horizon of a light, n.l = 0,
    is an edge too: there the highlight ends.
    """

    def flat(material, n, l, v, lobe):  # noqa: E741
        return np.broadcast_to(material.kd, n.shape)

    fine = oracle_with(flat, scene, 9 * WIDTH, 9 * HEIGHT).reshape(HEIGHT, 9, WIDTH, 9, 3)
    # Edges that many reflections have dimmed below 1e-6 change nothing that is tested here.
    return (np.ptp(fine[:, 3:6, :, 3:6], axis=(1, 3)) > 1e-6).any(axis=-1)


@pytest.fixture(scope="module", params=["phong", "blinnphong"])
def scene(request):
    return lecture_scene(request.param)


@pytest.fixture(scope="module")
def truth(scene):
    return oracle.render(scene, WIDTH, HEIGHT)


@pytest.fixture(scope="module")
def package(scene):
    mi.set_variant("llvm_ad_rgb")
    return np.array(mi.render(mi.load_dict(mitsuba_scene(scene)), spp=1), dtype=float)


@pytest.fixture(scope="module", params=[povray, tachyon], ids=lambda program: program.__name__)
def peer(request, scene, tmp_path_factory):
    name = request.param.__name__
    if shutil.which(name) is None:
        pytest.skip(f"{name} is not installed")
    return request.param(scene, tmp_path_factory.mktemp(name))


@pytest.fixture(scope="module")
def edges():
    # The edges of both lobes are the same.
    return near_edges(lecture_scene("phong"))


def assert_same(a, b, edges, bar):
    """`a` is `b` up to `bar` in every pixel away from edges, and in nearly all the others."""
    difference = np.abs(a - b).max(axis=-1)
    worst = np.where(edges, 0, difference).max()
    assert worst <= bar, f"differs by up to {worst:.2e} away from edges"
    # Measured: all. A pixel whose centre lies on an edge may have either colour: 6 of 12288 are let through.
    assert np.mean(difference <= bar) >= 1 - 5e-4


# The tests --------------------------------------------------------------------------------------


def test_scene_suits_the_comparison(scene, truth, edges):
    """The picture fits into the peers' files, and few pixels are edges or lack light in Tachyon's."""
    assert truth.max() < 1
    # Measured: 4.4 % and 8 pixels.
    assert edges.mean() < 0.05
    assert np.mean(horizon_light(scene).max(axis=-1) > 0) < 1e-3


def test_package_is_the_formula(package, truth, edges):
    """The package's picture is the oracle's."""
    assert_same(package, truth, edges, PACKAGE_ERROR)


def test_peer_is_the_formula(peer, truth, edges):
    """The peer's picture is the oracle's, rounded to 16 bits."""
    assert_same(peer, truth, edges, PEER_ERROR)


def test_package_is_the_peer(package, peer, edges):
    """The package's picture is the peer's."""
    assert_same(package, peer, edges, BAR)
