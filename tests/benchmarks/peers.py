"""The package beside POV-Ray and Tachyon, which render the same picture: warm, cold, and whether it is the same.

Warm: the second and later renderings of a loaded scene, against the time that a peer reports for
tracing alone. Cold: whole processes, start to written file, ours with an empty kernel cache.
"""

import dataclasses
import shutil
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

from helpers import oracle, peers

from . import scenes
from .measure import Plan, compared, fresh_environment, fresh_process, interleaved, record, seconds
from .rays import Floor

PROGRAMS = {"povray": peers.povray, "tachyon": peers.tachyon}

# What an outside check of a float32 renderer can see in 16-bit files.
BAR = 2e-5


def _lecture(plan, folder):
    return peers.lecture_scene("blinnphong")


def _many_lights(plan, folder):
    lights = [oracle.Light(0.9 / 8, tuple(x["position"])) for x in scenes.lights_around(8).values()]
    return dataclasses.replace(peers.lecture_scene("phong"), lights=lights)


def _spheres(plan, folder):
    return scenes.sphere_grid(100, 100)


def _mesh(plan, folder):
    """The hills of the benchmark `floor`, with fewer triangles: parsing them is not what is timed."""
    mesh = scenes.terrain(plan.of(100_000, 2_000), {"type": "diffuse"})
    mesh.write_ply(str(folder / "hills.ply"))
    params = mi.traverse(mesh)
    arrays = (np.array(params[name]).reshape(-1, 3) for name in ("vertex_positions", "vertex_normals", "faces"))
    return peers.MeshScene(
        [],
        [oracle.Light(0.9 / 4, tuple(x["position"])) for x in scenes.lights_around(4).values()],
        oracle.Camera(eye=(0, 4, 7), view=(0, -4.4, -7), focal=1.1),
        background=(0.35, 0.45, 0.6),
        bounces=0,
        meshes=(peers.Mesh(folder / "hills.ply", *arrays, kd=(0.5, 0.6, 0.3), ks=(0.3,) * 3, p=40.0),),
    )


SCENES = {"lecture": _lecture, "100 spheres": _spheres, "8 lights": _many_lights, "mesh": _mesh}


def records(plan: Plan):
    """Times of all programs that are installed, their ratios to ours, and how far the pictures differ."""
    installed = [name for name in PROGRAMS if shutil.which(name)]
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for name, build in SCENES.items():
            scene = build(plan, Path(folder))
            for size in plan.of((512, 1024, 2048, 4096), (64,)):
                found += _race(plan, name, scene, size, installed)
            found += _agreement(plan, name, scene, plan.of(512, 64), installed)
    return found


def _race(plan, name, scene, size, installed):
    # Large pictures take POV-Ray many seconds, and vary less; targets are about the lecture scene.
    rounds = plan.of(5 if size <= 1024 else 3 if size <= 2048 or name == "lecture" else 1, 1)
    warm, cold = {"phong_bsdf": []}, {"phong_bsdf": []}
    with ExitStack() as stack:
        run = stack.enter_context(fresh_process(plan.variant))
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        run(_load, peers.mitsuba_scene(scene, size, size))
        for _ in range(rounds):
            # Many short renderings for one long one of a peer: their median.
            warm["phong_bsdf"].append(float(np.median([run(_render) for _ in range(5 if size <= 1024 else 3)])))
            cold["phong_bsdf"].append(command_line(plan, scene, size, folder))
            for program in installed:
                result = PROGRAMS[program](scene, folder, size, size, dr.thread_count())
                warm.setdefault(program, []).append(result.seconds)
                cold.setdefault(program, []).append(result.seconds_in_all)
    return _named("warm", compared("peers", name, warm, "phong_bsdf", size)) + _named(
        "cold", compared("peers", name, cold, "phong_bsdf", size)
    )


def _named(kind, records):
    return [dataclasses.replace(r, quantity=f"{kind} {r.quantity}") for r in records]


def command_line(plan, scene, size, folder):
    """Seconds of `phong-bsdf render` in all, with an empty kernel cache."""
    source = folder / "scene.xml"
    source.write_text(peers.mitsuba_scene(scene, size, size))
    command = [sys.executable, "-m", "phong_bsdf", "render", str(source), "-o", str(folder / "scene.exr")]
    with fresh_environment():
        start = time.perf_counter()
        subprocess.run([*command, "-m", plan.variant], check=True, stdout=subprocess.DEVNULL)
        return time.perf_counter() - start


def _agreement(plan, name, scene, size, installed):
    """Largest difference of a pixel away from edges, the share of such pixels, and of pixels that differ at all."""
    text = peers.mitsuba_scene(scene, size, size)
    with fresh_process(plan.variant) as run, tempfile.TemporaryDirectory() as folder:
        ours, edges = run(_picture, text, size, scene.bounces + 2)
        found = [record("peers", name, "phong_bsdf", "share of pixels near edges", edges.mean(), "1", size)]
        for program in installed:
            theirs = PROGRAMS[program](scene, Path(folder), size, size, dr.thread_count()).picture
            difference = np.abs(ours - theirs).max(axis=-1)
            worst = np.where(edges, 0, difference).max()
            found.append(record("peers", name, program, "largest difference away from edges", worst, "1", size))
            differ = np.mean(difference > BAR)
            found.append(
                record("peers", name, program, f"share of pixels that differ by more than {BAR}", differ, "1", size)
            )
    return found


# In the process of one scene -------------------------------------------------------------------------

_loaded = {}


def _load(text):
    scene = _loaded["scene"] = mi.load_string(text)
    interleaved({"render": lambda: mi.render(scene)}, 1)


def _render() -> float:
    return seconds(lambda: mi.render(_loaded["scene"]))


def _picture(text, size, max_depth):
    """The picture, and where something that decides on a colour changes within a third of a pixel."""
    scene = mi.load_string(text)
    fine = np.array(Floor(scene, size, max_depth).signature(3 * size)).reshape(size, 3, size, 3)
    # Where light grazes a surface the signature is NaN, and so is the difference.
    same = np.ptp(fine, axis=(1, 3)) == 0
    return np.array(mi.render(scene), float), ~same
