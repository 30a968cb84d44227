"""What the kernel of one scene holds and what it leaves out, and what that saves: measured with and without."""

import time
from collections import Counter
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .scene.rendering import WHITTED, LoadedScene, SceneError, resize
from .tracing.camera import CameraSamples
from .tracing.needs import FEATURES, LIGHTS, REQUIRED, is_delta

# Measured pictures have no more samples than this: enough to keep every core busy for some milliseconds.
MOST_SAMPLES = 2**20


@dataclass(frozen=True)
class Row:
    """One feature of a kernel."""

    feature: str
    scene: str
    """What the scene has of it."""
    held: bool
    """Whether the kernel holds it."""
    left_out: str
    """What a kernel without it lacks."""
    operations: int | None
    """What leaving it out saves, in operations of a frame's kernels; None where it is held, or there is nothing to
    hold."""
    milliseconds: float | None
    """The same in milliseconds of a frame, the median of interleaved renderings."""


@dataclass(frozen=True)
class Explanation:
    """One scene's kernel."""

    rows: tuple[Row, ...]
    width: int
    height: int
    spp: int
    operations: int
    milliseconds: float
    general_operations: int
    """Those of a kernel that holds everything."""
    general_milliseconds: float


def explain(
    loaded: LoadedScene, *, camera: int = 1, spp: int = 0, seed: int = 0, repeats: int = 9, on_progress=lambda *_: None
) -> Explanation:
    """An `Explanation` of the kernel that renders `loaded` with its `whitted`, in the active variant, a JIT one.

    Large pictures are measured smaller. `on_progress(what, share)` hears how far it is.
    """
    if loaded.integrator != WHITTED:
        raise SceneError(
            f"{loaded.path}: explain is about the integrator 'whitted', this scene has {loaded.integrator}"
        )
    if not dr.is_jit_v(mi.Float):
        raise SceneError(f"explain: the variant {mi.variant()} has no kernels; use llvm_ad_rgb")
    sensor = loaded.sensor(camera)
    spp = spp or sensor.sampler().sample_count()
    _shrink(loaded, camera, sensor, spp)
    integrator: Any = loaded.scene.integrator()

    held = integrator.features(loaded.scene, sensor, spp)
    # Each feature is measured against a kernel that holds what it requires.
    pairs = {}
    for feature in FEATURES.keys() - held:
        required = frozenset(REQUIRED.get(feature, ())) - held
        pairs[feature] = (required, required | {feature})
    kernels = {frozenset(), frozenset(FEATURES)}.union(*pairs.values())
    before = integrator.keep
    try:
        frame = _frames(loaded.scene, sensor, spp, seed, integrator)
        costs = _measure(frame, sorted(kernels, key=sorted), repeats, on_progress)
    finally:
        integrator.keep = before

    facts = _facts(loaded.scene, sensor, spp, integrator)
    rows = []
    for feature, left_out in FEATURES.items():
        saved = (None, None)
        if feature in pairs:
            without, with_it = (costs[keep] for keep in pairs[feature])
            saved = (with_it[0] - without[0], with_it[1] - without[1])
        rows.append(Row(feature, facts.pop(feature), feature in held, left_out, *saved))
    rows += [Row(feature, text, there, left_out, None, None) for feature, (text, there, left_out) in facts.items()]
    width, height = (int(side) for side in sensor.film().crop_size())
    return Explanation(tuple(rows), width, height, spp, *costs[frozenset()], *costs[frozenset(FEATURES)])


def _frames(scene, sensor, spp, seed, integrator):
    """A function: milliseconds of a frame whose kernel holds these features."""

    def frame(keep):
        integrator.keep = keep
        dr.sync_thread()
        start = time.perf_counter()
        dr.eval(mi.render(scene, sensor=sensor, spp=spp, seed=seed))
        dr.sync_thread()
        return (time.perf_counter() - start) * 1e3

    return frame


def _shrink(loaded, camera, sensor, spp):
    width, height = (int(side) for side in sensor.film().crop_size())
    factor = (MOST_SAMPLES / (width * height * spp)) ** 0.5
    if factor < 1:
        resize(loaded, camera, max(int(width * factor), 1), max(int(height * factor), 1))


def _measure(frame, kernels, repeats, on_progress):
    """For each set of features that are kept: (operations, milliseconds) of a frame."""
    operations, times = {}, {keep: [] for keep in kernels}
    for i, keep in enumerate(kernels):
        on_progress("compiling", i / len(kernels))
        frame(keep)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            frame(keep)
            operations[keep] = sum(k.get("operation_count", 0) for k in dr.kernel_history())
    for repeat in range(repeats):
        on_progress("measuring", repeat / repeats)
        for keep in kernels:
            times[keep].append(frame(keep))
    return {keep: (operations[keep], float(np.median(times[keep]))) for keep in kernels}


def _facts(scene, sensor, spp, integrator) -> dict:
    """What the scene has: text for each of the features, and (text, whether it is there, what is left out) for more."""
    tracer = integrator.tracer(scene)
    bsdfs = {b.ptr: b for b in (shape.bsdf() for shape in scene.shapes()) if b is not None}.values()
    plugins = {kind: plugin for plugin, kind in LIGHTS.items()}
    lights = Counter(plugins.get(e.class_name(), e.class_name()) for e in scene.emitters() if is_delta(e))
    textured = any(mi.has_flag(b.flags(), mi.BSDFFlags.SpatiallyVarying) for b in bsdfs)
    film = sensor.film()
    box = film.rfilter().is_box_filter()
    random = CameraSamples(sensor, 0, spp).sampler is not None
    spheres = len(tracer.surfaces.spheres)
    table = tracer.table

    def column(name):
        return "known to the BSDFs" if table is None else "some" if getattr(table, name) is not None else "0 everywhere"

    return {
        "bsdf calls": _bsdfs(bsdfs) if table is None else "own BSDFs",
        "materials": f"{len(bsdfs)} BSDFs" if table is None else f"{table.distinct} distinct",
        "diffuse": column("diffuse"),
        "highlights": column("specular"),
        "mirrors": _mirrors(tracer),
        "branches": f"at most {tracer.deltas.branches} delta lobe{'s' * (tracer.deltas.branches != 1)} on a side",
        "transparency": "some surfaces let rays through" if tracer.deltas.masks else "no mask, no null",
        "last bounce": f"max_depth {integrator.depth}" if tracer.deltas.fading else "no mirrorblend",
        "lights": _lights(lights, tracer.lights.dark),
        "light calls": "intensity by direction" if not tracer.lights.uniform else "the same in all directions",
        "ambient": "0" if integrator.ambient.left_out else "some",
        "film block": f"{'box' if box else film.rfilter().class_name().removesuffix('Filter')} filter, {spp} spp",
        "textures": ("some" if textured else "none", textured, "texture coordinates"),
        "shadows": ("on" if integrator.shadows else "off", integrator.shadows, "shadow rays"),
        "background": (
            "none" if tracer.background is None else tracer.background.class_name(),
            tracer.background is not None,
            "what escaped rays see",
        ),
        "random numbers": (
            "sampler" if random else "fixed sample positions",
            random,
            "the sampler",
        ),
        "large spheres": (f"{spheres}" if spheres else "none", spheres > 0, "refined hits"),
        "shape sizes": (
            "one order of magnitude" if tracer.surfaces.extent.uniform else "several orders of magnitude",
            not tracer.surfaces.extent.uniform,
            "ray offsets by shape",
        ),
    }


def _bsdfs(bsdfs) -> str:
    return _kinds("BSDFs", Counter(b.class_name() if type(b) is mi.BSDF else type(b).__name__ for b in bsdfs))


def _mirrors(tracer) -> str:
    if tracer.most_rays <= 1:
        return "max_depth ends paths first"
    return "some" if tracer.follows else "no delta lobe"


def _lights(lights, dark) -> str:
    names = _kinds("lights", lights) or "none"
    return f"{names}; {dark} send nothing" if dark else names


def _kinds(what, counts) -> str:
    """The names of two kinds at most, so that the table fits into a terminal."""
    if len(counts) > 2:
        return f"{counts.total()} {what} of {len(counts)} kinds"
    return ", ".join(f"{n} {name}" for name, n in counts.items())
