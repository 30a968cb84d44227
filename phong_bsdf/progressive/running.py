"""Renders the passes of a picture that are missing."""

import contextlib
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from ..pictures import images, parts
from ..pictures.estimates import WeightedMean
from ..pictures.parts import Samples, Subject
from ..scene import rendering
from ..scene.rendering import LoadedScene, Rendering
from ..tracing import camera as cameras
from .folder import Folder
from .planning import Plan


def render_pass(
    loaded: LoadedScene, plan: Plan, index: int, on_progress: Callable[[float], None] = lambda share: None
) -> Rendering:
    """Render one pass of the plan's scene, as `planning.load` loaded it."""
    samples = plan.samples(index)
    with _part_of_grid(loaded, samples):
        return rendering.render(
            loaded, camera=plan.subject.camera, spp=plan.asked, seed=samples.seed, on_progress=on_progress
        )


def check_subject(plan: Plan, subject: Subject) -> None:
    """ValueError where a scene, as `load` found it here, is not the one that the plan is for."""
    if found := parts.differences(subject, plan.subject):
        raise ValueError(f"this is not what was planned: {'; '.join(found)}")


def render(
    loaded: LoadedScene,
    folder: Folder,
    *,
    on_broken: Callable[[str], None] = lambda text: None,
    on_progress: Callable[[float], None] = lambda share: None,
) -> Iterator[WeightedMean]:
    """Render the passes that are not on disk; the picture so far after each pass, in the order of their numbers.

    A file that is broken is named to `on_broken`, and its pass rendered again.
    """
    plan = folder.plan
    mean = WeightedMean(images.judged(rendering.channels(loaded, plan.subject.camera)))
    for index in range(plan.count):
        image = on_disk(folder, index, on_broken)
        if image is None:
            start = time.perf_counter()
            made = render_pass(loaded, plan, index, lambda share: on_progress((index + share) / plan.count))  # noqa: B023
            image = made.image
            folder.write(index, image, time.perf_counter() - start, made.channels)
        mean.add(image, plan.spp)
        on_progress((index + 1) / plan.count)
        yield mean


def on_disk(folder: Folder, index: int, on_broken: Callable[[str], None]) -> np.ndarray | None:
    """The picture of a pass; None where there is none, or its file is broken, which `on_broken` hears."""
    if not folder.has(index):
        return None
    try:
        return folder.read(index)
    except ValueError as error:
        on_broken(str(error))
        return None


@contextlib.contextmanager
def _part_of_grid(loaded: LoadedScene, samples: Samples):
    """Inside, `whitted` renders this part of its grid."""
    integrator: Any = loaded.scene.integrator()
    if samples.step > 1:
        integrator.part = samples.step, samples.shift
    try:
        yield
    finally:
        if samples.step > 1:
            integrator.part = cameras.WHOLE
