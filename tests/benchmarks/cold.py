"""Cold start: import, variant, load, compile, render, write, with an empty and with a filled kernel cache.

Beside it what any script with Mitsuba pays before its first picture, and the compile time of the
lecture scene against that of the general kernel.
"""

import dataclasses
import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import mitsuba as mi

from helpers import peers
from phong_bsdf.tracing.needs import FEATURES

from . import scenes
from .measure import Plan, compared, fresh_environment, fresh_process, kernels, record

SCRIPT = Path(__file__).parent / "first_picture.py"


def records(plan: Plan):
    """Seconds of each stage, of all of them, their ratio to plain Mitsuba; compile times."""
    size, rounds = plan.of(512, 32), plan.of(7, 1)
    with tempfile.TemporaryDirectory() as folder:
        runs = _starts(plan, Path(folder), size, rounds)
    found = []
    for cache, stages in runs.items():
        for stage in stages[0]:
            found.append(record("cold", "lecture", cache, stage, [run[stage] for run in stages], "s", size))
    # To the picture in memory, and to the file.
    times = {cache: [sum(run.values()) - run.get("write", 0) for run in stages] for cache, stages in runs.items()}
    found += _renamed(compared("cold", "lecture", times, "plain Mitsuba", size), "first picture")
    return found + _compiling(plan, size)


def _renamed(found, name):
    return [dataclasses.replace(r, quantity=r.quantity.replace("time", name, 1)) for r in found]


def _starts(plan, folder, size, rounds):
    """The stages of each run, in rounds: nothing cached, everything cached, without the package."""
    text = peers.mitsuba_scene(peers.lecture_scene("blinnphong"), size, size)
    ours, plain = folder / "scene.xml", folder / "plain.xml"
    ours.write_text(text)
    native = re.sub(r"<bsdf.*</bsdf>", '<bsdf type="diffuse"/>', text).replace('"whitted"', '"path"')
    plain.write_text(native)
    runs = {"empty cache": [], "filled cache": [], "plain Mitsuba": []}
    for _ in range(rounds):
        with fresh_environment():
            # The second finds the kernels of the first.
            for cache in ("empty cache", "filled cache"):
                runs[cache].append(_stages(ours, folder, plan))
            runs["plain Mitsuba"].append(_stages(plain, folder, plan, "--plain"))
    return runs


def _stages(source, folder, plan, *options):
    command = [sys.executable, str(SCRIPT), str(source), str(folder / "picture.exr"), plan.variant, *options]
    return json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)


def _compiling(plan, size):
    """The first picture of the lecture scene in processes of their own: operations, and seconds of compiling."""
    first = {"whitted": [], "whitted, general": []}
    for _ in range(plan.of(7, 1)):
        for task, found in first.items():
            with fresh_process(plan.variant) as run:
                found.append(run(_first, size, task == "whitted"))
    times = {task: [k.compile_seconds for k in found] for task, found in first.items()}
    operations = [
        record("cold", "lecture", task, "operations", [k.operations for k in found], "operations", size)
        for task, found in first.items()
    ]
    return _renamed(compared("cold", "lecture", times, "whitted, general", size), "compile time") + operations


def _first(size, specialize):
    scene = scenes.lecture(size)
    integrator = scene.integrator()
    integrator.keep = frozenset() if specialize else frozenset(FEATURES)
    return kernels(lambda: mi.render(scene))
