"""How close `whitted` is to the ray floor: the same rays on plain arrays, without film, sampler and shading.

python tests/benchmarks/floor.py [REPEATS]

Interleaved with the general kernel (`specialize = false`), medians and their ratios.
"""

import sys
import time
from pathlib import Path

import phong_bsdf  # noqa: F401

import drjit as dr  # isort: skip
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_rgb")

SCENE = Path(__file__).parent.parent.parent / "scenes/lecture/mirror-floor.xml"
SIZE = 2048
DEPTH = 10


@dr.syntax
def floor(scene):
    """Camera, shadow and mirror rays of the scene; one float a pixel."""
    sensor = scene.sensors()[0]
    index = dr.arange(mi.UInt32, SIZE * SIZE)
    row = index // SIZE
    ray, _ = sensor.sample_ray(0, 0, (mi.Point2f(index - row * SIZE, row) + 0.5) / SIZE, mi.Point2f(0.5))
    o, d = mi.Point3f(ray.o), mi.Vector3f(ray.d)
    alive, lit, depth = dr.full(mi.UInt32, 1, SIZE * SIZE), dr.zeros(mi.Float, SIZE * SIZE), mi.UInt32(0)
    lights = [mi.Point3f(emitter.sample_direction(dr.zeros(mi.Interaction3f), mi.Point2f(0))[0].p)
              for emitter in scene.emitters()]  # fmt: skip
    mirrors = [mi.ShapePtr(shape) for shape in scene.shapes() if mi.has_flag(shape.bsdf().flags(), mi.BSDFFlags.Delta)]
    while dr.hint(alive != 0, max_iterations=DEPTH - 1):
        si = scene.ray_intersect(mi.Ray3f(o, d), mi.RayFlags.All, coherent=depth == 0, active=alive != 0)
        hit = si.is_valid() & (alive != 0)
        start = si.p + 1e-4 * si.n
        for light in lights:
            toward = light - start
            distance = dr.norm(toward)
            facing = hit & (dr.dot(toward, si.n) > 0) & (dr.dot(d, si.n) < 0)
            shadow = mi.Ray3f(start, toward / distance, distance, 0, [])
            lit += dr.select(facing & ~scene.ray_test(shadow, False, facing), mi.Float(1), mi.Float(0))
        is_mirror = mi.Bool(False)
        for mirror in mirrors:
            is_mirror |= si.shape == mirror
        o, d = mi.Point3f(start), mi.Vector3f(d - 2 * dr.dot(d, si.n) * si.n)
        depth += 1
        alive = dr.select(hit & is_mirror, mi.UInt32(1), mi.UInt32(0))
    return lit


def main(repeats=15):
    """Prints one line for each."""
    scene = mi.load_file(str(SCENE), width=str(SIZE), height=str(SIZE), max_depth=str(DEPTH))
    integrator = scene.integrator()

    def render(specialize):
        integrator.specialize = specialize
        return mi.render(scene)

    tasks = {"ray floor": lambda: floor(scene), "whitted": lambda: render(True), "general": lambda: render(False)}
    times = {name: [] for name in tasks}
    for repeat in range(repeats + 2):
        for name, task in tasks.items():
            dr.sync_thread()
            start = time.perf_counter()
            dr.eval(task())
            dr.sync_thread()
            # The first two rounds compile and warm up.
            if repeat >= 2:
                times[name].append(time.perf_counter() - start)
    medians = {name: float(np.median(t)) for name, t in times.items()}
    for name, seconds in medians.items():
        print(f"{name:10} {SIZE} x {SIZE}: {seconds * 1e3:6.1f} ms, {seconds / medians['ray floor']:.2f} x the floor")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
