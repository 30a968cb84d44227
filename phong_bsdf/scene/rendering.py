"""Load a scene file, render it, and say what that took.

Everything a user can get wrong in a scene is a `SceneError` here.
"""

import contextlib
import gc
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..pictures import images
from ..tracing import camera as cameras
from ..tracing import films, needs, sums
from . import soundness
from .errors import SceneError, located, sentence

__all__ = ["LoadedScene", "Rendering", "SceneError", "load", "render", "resize"]

# A pass of this many samples takes a few seconds at most: often enough for a progress bar and Ctrl-C.
SAMPLES_PER_PASS = 2**24

# Beyond so many samples of a pixel the sums in a pass may be longer by this factor, and lose more: up to 1e-5. Only
# where `sums` has no better way.
LONG_SUMS, LONGER = 2**20, 4

# The class of the integrator `whitted`.
WHITTED = "Whitted"


@dataclass(frozen=True)
class LoadedScene:
    """A scene in memory, with what its file says about it."""

    path: Path
    """The file."""
    scene: "mi.Scene"
    """What Mitsuba made of it."""
    integrator: str
    """Name of its class."""
    seconds: float
    """What loading took."""

    def sensor(self, camera: int) -> "mi.Sensor":
        """Camera number `camera`, counted from 1; SceneError where there is none."""
        sensors = self.scene.sensors()
        if not sensors:
            raise SceneError(f'{self.path}: the scene has no camera; add a <sensor type="perspective">')
        if not 1 <= camera <= len(sensors):
            raise SceneError(f"{self.path}: there is no camera {camera}, the scene has {len(sensors)}")
        return sensors[camera - 1]


@dataclass(frozen=True)
class Rendering:
    """A picture and what it took."""

    image: np.ndarray
    """Linear, shape (height, width, channels), float32."""
    variant: str
    """Of Mitsuba, in which it was rendered."""
    spp: int
    """Samples per pixel that were asked for."""
    seed: int
    lights: int
    """Lights of the scene; with `whitted` without its background, which lights nothing."""
    seconds_compiling: float
    seconds_rendering: float
    """Without compiling."""
    compiled: bool
    """Whether a kernel was compiled that no earlier rendering of the process had needed."""
    channels: tuple[str, ...] = ()
    """Names of the picture's channels, as Mitsuba has them: R, G, B, A, ..."""


def load(path: Path, defines: Mapping[str, str] | None = None) -> LoadedScene:
    """Load a Mitsuba XML scene in the active variant; `defines` gives values for its `<default>`s.

    SceneError, with file and line, for whatever is wrong in it, and for what no picture of it would show.
    """
    start = time.perf_counter()
    return load_parsed(path, parse(path, defines), start)


def parse(path: Path, defines: Mapping[str, str] | None = None, *, merge: bool = True) -> "mi.parser.ParserState":
    """The nodes of a scene file, references resolved, nothing made of them yet: a `mitsuba.parser.ParserState`.

    With `merge` nodes that are equal become one, as Mitsuba does it, and lose their ids.
    """
    path = Path(path)
    if not path.is_file():
        raise SceneError(f"{path}: this is a folder" if path.is_dir() else f"{path}: there is no such file")
    try:
        with files_beside(path):
            config = mi.parser.ParserConfig(str(mi.variant()))
            config.merge_equivalent = config.merge_meshes = merge
            state = mi.parser.parse_file(config, str(path), **(defines or {}))
            mi.parser.transform_all(config, state)
    except RuntimeError as error:
        raise SceneError(sentence(error, path)) from None
    return state


def merged(state: "mi.parser.ParserState") -> "mi.parser.ParserState":
    """A copy of a parsed scene in which equal nodes are one, as Mitsuba makes them when it loads a file: faster to
    render."""
    state = mi.parser.ParserState(state)
    config = mi.parser.ParserConfig(str(mi.variant()))
    mi.parser.transform_merge_equivalent(config, state)
    mi.parser.transform_merge_meshes(config, state)
    return state


def make(path: Path, state: "mi.parser.ParserState") -> Any:
    """The object that the root of a parsed scene, perhaps changed since, describes."""
    try:
        with files_beside(path), undisturbed():
            # A copy: Mitsuba puts the objects that it makes into the nodes, and they would live as long as those.
            state = mi.parser.ParserState(state)
            _close_gaps(state)
            made: Any = mi.parser.instantiate(mi.parser.ParserConfig(str(mi.variant())), state)
        # Our BSDFs look now at what their constructors could not look at (`parameters.py`).
        mi.traverse(made)
        return made
    except (RuntimeError, ValueError) as error:
        raise SceneError(sentence(error, path)) from None


def _close_gaps(state: "mi.parser.ParserState") -> None:
    """Ask for meshes without gaps between their triangles, unless the scene says otherwise."""
    shapes = {node.props.plugin_name() for node in state.nodes if node.type == mi.ObjectType.Shape}
    # A `merge` is what Mitsuba puts meshes into; rectangles in one have no gaps.
    triangles = shapes - {*needs.ANALYTIC, "merge"}
    root = state.nodes[0]
    if root.type == mi.ObjectType.Scene and triangles and needs.ROBUST not in root.props:
        root.props[needs.ROBUST] = True
        state.nodes[0] = root


def check(path: Path, state: "mi.parser.ParserState") -> None:
    """Raises `SceneError` for what a parsed scene says that no picture of it would show: before anything is made."""
    _refuse(path, soundness.wrong(state))


def _refuse(path: Path, found: str | None) -> None:
    if found:
        raise SceneError(sentence(RuntimeError(found), path))


def load_parsed(path: Path, state: "mi.parser.ParserState", start: float | None = None) -> LoadedScene:
    """Load a parsed scene, perhaps changed since; `path` is where it came from, `start` when that began."""
    start = start or time.perf_counter()
    check(path, state)
    ignored = soundness.ignored(state)
    if ignored:
        mi.Log(mi.LogLevel.Warn, f"{path}: {ignored}")  # pyright: ignore[reportCallIssue]  (not in Mitsuba's stubs)
    scene = make(path, state)
    if not isinstance(scene, mi.Scene):
        raise SceneError(f"{path}: the file describes no <scene>")
    if scene.integrator() is None:
        raise SceneError(f'{path}: the scene has no integrator; add <integrator type="whitted"/>')
    integrator = type(scene.integrator()).__name__
    if integrator == WHITTED:
        try:
            needs.check_lights(scene)
        except needs.UnsupportedScene as error:
            raise SceneError(located(error, path, state)) from None
    _refuse(path, soundness.wrong_image(scene, state))
    return LoadedScene(Path(path), scene, integrator, time.perf_counter() - start)


def resize(loaded: LoadedScene, camera: int, width: int, height: int) -> None:
    """Give the film of camera number `camera` (from 1) another size in pixels, without a crop window.

    SceneError where there is no such camera.
    """
    params = mi.traverse(loaded.sensor(camera))
    # This resets the crop window too.
    params["film.size"] = mi.ScalarVector2u(width, height)
    params.update()


def count_lights(loaded: LoadedScene) -> int:
    """Lights of the scene; in a `whitted` scene a background lights nothing."""
    return sum(loaded.integrator != WHITTED or needs.is_delta(emitter) for emitter in loaded.scene.emitters())


def channels(loaded: LoadedScene, camera: int) -> tuple[str, ...]:
    """Names of the channels of the camera's picture; SceneError where it can have none."""
    try:
        return films.channels(loaded.sensor(camera).film(), loaded.scene.integrator())
    except (RuntimeError, ValueError) as error:
        raise SceneError(sentence(error, loaded.path)) from None


def pass_seed(seed: int, done: int) -> int:
    """Seed of a pass before which `done` samples were taken: passes of nearby seeds have none in common."""
    return (seed + done * cameras.STRIDE) % 2**32


def render(
    loaded: LoadedScene,
    *,
    camera: int = 1,
    spp: int = 0,
    seed: int = 0,
    color: bool = False,
    on_progress: Callable[[float], None] = lambda share: None,
) -> Rendering:
    """Render camera number `camera` (from 1) with `spp` samples per pixel (0: as the scene says).

    The picture is linear, (height, width, channels), float32. SceneError where the scene cannot be rendered as asked.
    Large renderings go in passes, and `on_progress` hears the share done, 0 to 1, after each. A
    `whitted` picture of n^2 samples goes in bands of rows, and depends on them only where
    rounding decides (2 pixels of 30 000 in a test). Others with the `independent` sampler go in
    passes of different seeds, and so have other noise than one pass would. Of many samples for
    a pixel the sum is exact to 2e-6: of the same samples, where they are seen by rays of
    one integrator; else (scalar variants, `aov`, `moment`, `ptracer`) in passes of different
    seeds, whatever the sampler. With `color` the picture is its colour, Y, YA, RGB or RGBA,
    without what the integrator or film adds; SceneError where it has none.
    """
    scene = loaded.scene
    sensor = loaded.sensor(camera)
    if 0 in sensor.film().crop_size():
        raise SceneError(f"{loaded.path}: the film has no pixels; its width and height must be at least 1")
    spp = spp or sensor.sampler().sample_count()
    names = channels(loaded, camera)
    if color and not images.color_channels(names):
        raise SceneError(f"{loaded.path}: the picture has no colours, only the channels {', '.join(names)}; "
                         "use a film of RGB, XYZ or luminance")  # fmt: skip
    try:
        with _CompileTime() as compiling, _heard(scene.integrator(), on_progress):
            start = time.perf_counter()
            for image, share in _passes(loaded, sensor, spp, seed):  # noqa: B007  (the last one counts)
                on_progress(share)
            seconds = time.perf_counter() - start
    except (RuntimeError, ValueError) as error:
        raise SceneError(sentence(error, loaded.path)) from None
    if image.shape[2] != len(names):
        raise SceneError(f"{loaded.path}: the picture has {image.shape[2]} channels, and not those that Mitsuba names: "
                         f"{', '.join(names)}")  # fmt: skip
    if color:
        image = images.color(image, names)
        names = tuple(images.CHANNELS[image.shape[2]])
    seconds = max(seconds - compiling.seconds, 0.0)
    return Rendering(
        image, str(mi.variant()), spp, seed, count_lights(loaded), compiling.seconds, seconds, compiling.happened, names
    )


@contextlib.contextmanager
def undisturbed():
    """Garbage waits: to free a dead scene is to wait for threads, of which one may wait for Python to make a BSDF."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


@contextlib.contextmanager
def files_beside(path: Path):
    """Inside, Mitsuba finds files that the scene names relative to its own folder."""
    before = mi.file_resolver()  # pyright: ignore[reportCallIssue]  (not in Mitsuba's stubs)
    resolver = mi.FileResolver(before)
    resolver.prepend(str(Path(path).parent))
    mi.set_file_resolver(resolver)  # pyright: ignore[reportCallIssue]  (not in Mitsuba's stubs)
    try:
        yield
    finally:
        mi.set_file_resolver(before)  # pyright: ignore[reportCallIssue]  (not in Mitsuba's stubs)


def _passes(loaded: LoadedScene, sensor, spp: int, seed: int) -> Iterator[tuple[np.ndarray, float]]:
    """The picture so far (rows not rendered yet are 0) and the share that is done, after each pass."""
    film = sensor.film()
    width, height = (int(side) for side in film.crop_size())
    if loaded.integrator == WHITTED:
        # It makes its own passes, and adds up exactly enough.
        if width * height * spp > SAMPLES_PER_PASS and film.rfilter().is_box_filter() and cameras.grid(spp):
            yield from _bands(loaded.scene, sensor, spp, seed, max(SAMPLES_PER_PASS // (width * spp), 1))
        else:
            yield _render(loaded.scene, sensor, spp, seed), 1.0
    elif spp <= (per_pass := _pass_spp(loaded, sensor, spp)):
        yield _render(loaded.scene, sensor, spp, seed), 1.0
    else:
        total, done, taken = 0.0, 0, 0
        try:
            while done < spp:
                asked = min(per_pass, spp - done)
                # Samplers round the number as they need.
                n = cameras.samples_taken(sensor.sampler().clone(), asked)
                image = _render(loaded.scene, sensor, n, pass_seed(seed, done))
                total, done, taken = total + n * image.astype(np.float64), done + asked, taken + n
                yield (total / taken).astype(np.float32), done / spp
        finally:
            # As one rendering would leave it.
            cameras.samples_taken(sensor.sampler(), spp)


def _pass_spp(loaded: LoadedScene, sensor, spp: int) -> int:
    """How many of `spp` samples per pixel one pass has, of an integrator that does not care by itself."""
    film = sensor.film()
    width, height = (int(side) for side in film.crop_size())
    most = spp
    if width * height * spp > SAMPLES_PER_PASS and sensor.sampler().class_name() == "IndependentSampler":
        # A power of two: only those are the same picture, bit by bit, each time.
        most = 2 ** (max(SAMPLES_PER_PASS // (width * height), 1).bit_length() - 1)
    if not sums.can_render(loaded.scene, sensor, most):
        most = min(most, sums.most_summed(film, loaded.scene.integrator()) * (LONGER if spp > LONG_SUMS else 1))
    return most


def samples_taken(loaded: LoadedScene, camera: int, spp: int) -> int:
    """Samples per pixel that `render` takes when asked for `spp`: samplers round them in each pass."""
    sensor = loaded.sensor(camera)
    if loaded.integrator == WHITTED:
        if cameras.grid(spp):
            return spp
        sets = -(-spp // sums.most_summed(sensor.film(), loaded.scene.integrator()))
        taken = cameras.samples_taken(sensor.sampler().clone(), wanted := -(-spp // sets))
        return spp if taken == wanted else sets * taken
    whole, rest = divmod(spp, n := min(_pass_spp(loaded, sensor, spp), spp))
    return sum(k * cameras.samples_taken(sensor.sampler().clone(), m) for k, m in ((whole, n), (1, rest)) if m and k)


@contextlib.contextmanager
def _heard(integrator, on_progress):
    """Inside, `on_progress` also hears of passes that `whitted` makes by itself."""
    has_passes = hasattr(integrator, "on_progress")
    before = integrator.on_progress if has_passes else None
    if has_passes:
        integrator.on_progress = on_progress
    try:
        yield
    finally:
        if has_passes:
            integrator.on_progress = before


def _bands(scene, sensor, spp, seed, rows):
    params = mi.traverse(sensor)
    # Copies: what `traverse` gives changes with the film.
    size, offset = mi.ScalarVector2u(params["film.crop_size"]), mi.ScalarPoint2u(params["film.crop_offset"])
    (width, height), (left, top) = (tuple(map(int, v)) for v in (size, offset))
    image = None
    try:
        for first in range(0, height, rows):
            params["film.crop_size"] = mi.ScalarVector2u(width, min(rows, height - first))
            params["film.crop_offset"] = mi.ScalarPoint2u(left, top + first)
            params.update()
            band = _render(scene, sensor, spp, seed)
            if image is None:
                image = np.zeros((height, *band.shape[1:]), np.float32)
            image[first : first + len(band)] = band
            yield image, (first + len(band)) / height
    finally:
        params["film.crop_size"], params["film.crop_offset"] = size, offset
        params.update()


def _render(scene, sensor, spp, seed) -> np.ndarray:
    many = spp > sums.most_summed(sensor.film(), scene.integrator()) and sums.can_render(scene, sensor, spp)
    image = sums.render(scene, sensor, spp, seed) if many else mi.render(scene, sensor=sensor, spp=spp, seed=seed)
    image = np.array(image)
    return image if image.ndim == 3 else image[:, :, None]


class _CompileTime:
    """Seconds that Dr.Jit spent on code generation and in LLVM inside a `with` block."""

    seconds = 0.0
    happened = False

    def __enter__(self):
        self.before = dr.flag(dr.JitFlag.KernelHistory)
        dr.set_flag(dr.JitFlag.KernelHistory, True)
        dr.kernel_history_clear()
        return self

    def __exit__(self, *_):
        times = ("codegen_time", "backend_time")
        kernels = dr.kernel_history()
        self.seconds = sum(kernel.get(t, 0) for kernel in kernels for t in times) / 1000
        self.happened = any(kernel.get("cache_hit") == 0 for kernel in kernels)
        dr.set_flag(dr.JitFlag.KernelHistory, self.before)
