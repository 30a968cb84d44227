"""What a study of error against time renders: methods, numbers of samples, references; checked, not rendered."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi

from ..host import machine
from ..pictures import images
from ..pictures import store as passes
from ..pictures.store import Store
from ..scene import fingerprint, rendering, surfaces
from ..tracing import camera as cameras
from . import methods
from .defaults import LEVELS, REPEATS

# The reference of random methods: with 32 times the samples of the finest level, its noise is 3 % of that level's.
REFERENCE_PASSES = 16
REFERENCE_SPP = 2
# The reference of a grid: so many times as many samples across. A power of two, so that no sample is on a coarser grid.
REFERENCE_GRID = 4
# Of methods without a grid, as if they had one of so many samples.
LEAST_GRID = 16


@dataclass(frozen=True)
class MethodRun:
    """A method of a run."""

    name: str
    spec: Mapping[str, Any]
    """Integrator, parameters, sampler, sampling, bsdf and reference, as `--method` has them; "": as the scene says."""
    key: str
    """Name of the folder with its passes."""
    limit: str
    """The reference's name."""
    levels: tuple[int, ...]
    """Samples per pixel, as the sampler rounds them."""


@dataclass(frozen=True)
class ReferenceRun:
    """A picture that methods are measured against."""

    name: str
    key: str
    """Name of the folder with its passes."""
    kind: str
    """`passes` of different seeds, a `grid`, or a `file`."""
    levels: tuple[int, ...]
    """Samples per pixel of each pass; of a grid, its own and that of half as many across, which tells its error."""
    file: str = ""
    """The EXR file, where it is one."""


@dataclass(frozen=True)
class Run:
    """What is measured, as `run.json` keeps it."""

    scene: str
    """Name of its file."""
    scene_hash: str
    integrator: str
    """Of the scene, by the name of its plugin."""
    variant: str
    """Of Mitsuba."""
    camera: int
    """From 1."""
    levels: tuple[int, ...]
    """Samples per pixel to measure at."""
    repeats: int
    """Passes for each method and number of samples."""
    seed: int
    methods: tuple[MethodRun, ...]
    references: tuple[ReferenceRun, ...]
    versions: str
    machine: str


@dataclass(frozen=True)
class Plan:
    """What will be rendered: checked, but not loaded."""

    path: Path
    states: Mapping[str, "mi.parser.ParserState"]
    """Key -> parsed scene."""
    limits: Mapping[str, methods.Method]
    """Key of a reference -> the method that it is made by."""
    size: tuple[int, int] | None
    run: Run


def plan(
    path: Path,
    defines: Mapping[str, str] | None = None,
    *,
    given: Sequence[tuple[str, Mapping[str, object]]] = (),
    levels: Sequence[int] = LEVELS,
    repeats: int = REPEATS,
    camera: int = 1,
    size: tuple[int, int] | None = None,
    seed: int = 0,
    reference: Path | None = None,
) -> Plan:
    """What to render; ValueError where that is not possible. `given`: methods as (name, specification).

    `reference`: an EXR file that all methods are measured against, instead of their own limits.
    """
    scene = methods.read(path, defines)
    film = _film_size(scene, camera, size)
    if reference is not None:
        _check_reference(reference, film)
    chosen = methods.chosen(scene, given)
    limits = {method.name: methods.limit(scene, method) for method in chosen}
    real = {method.name: _rounded(scene, method, method.levels or levels) for method in chosen}
    versions, scene_hash = fingerprint.versions(), fingerprint.scene_hash(scene.path, scene.state)
    context = [scene_hash, camera, film, mi.variant(), seed, versions]
    where = machine.described(dr.thread_count())
    states, used = {}, {}

    def key(method: methods.Method, *more) -> str:
        made = f"{method.name}-{fingerprint.digest([*context, method.spec(), *more])}"
        states[made], used[made] = methods.applied(scene, method), method
        return made

    runs = tuple(
        MethodRun(m.name, m.spec(), key(m, where), Path(reference or limits[m.name].name).name, real[m.name])
        for m in chosen
    )
    if reference is not None:
        file = Path(reference).resolve()
        references = [ReferenceRun(Path(reference).name, fingerprint.file_hash(file)[:12], "file", (), str(file))]
    else:
        references = [
            _reference(scene, limit, [(m, max(real[m.name])) for m in chosen if limits[m.name] == limit], key)
            for limit in {limit.name: limit for limit in limits.values()}.values()
        ]
    run = Run(Path(path).name, scene_hash, scene.integrator, str(mi.variant()), camera, tuple(levels), repeats, seed,
              runs, tuple(references), versions, where)  # fmt: skip
    return Plan(Path(path), states, {r.key: used[r.key] for r in references if r.key in used}, size, run)


def reference_grid(spp: int) -> int:
    """Samples across of the grid that methods with up to `spp` samples are measured against."""
    return 2 ** math.ceil(math.log2(REFERENCE_GRID * math.sqrt(spp)))


def _reference(scene: methods.Scene, limit: methods.Method, finest: Sequence[tuple], key) -> ReferenceRun:
    """`finest`: the methods with this limit, each with its most samples. `key` makes the key of a method."""
    if methods.integrator_of(scene, limit) == methods.WHITTED:
        grids = [spp for method, spp in finest if methods.integrator_of(scene, method) == methods.WHITTED]
        across = reference_grid(max(grids, default=LEAST_GRID))
        return ReferenceRun(limit.name, key(limit, "reference"), "grid", (across**2, (across // 2) ** 2))
    spp = REFERENCE_SPP * max(spp for _, spp in finest)
    return ReferenceRun(limit.name, key(limit, "reference"), "passes", (spp,) * REFERENCE_PASSES)


def _rounded(scene: methods.Scene, method: methods.Method, levels: Sequence[int]) -> tuple[int, ...]:
    """The numbers of samples that the method takes when asked for `levels`."""
    grid = methods.integrator_of(scene, method) == methods.WHITTED
    sampler = mi.load_dict({"type": method.sampler})
    real = (spp if grid and cameras.grid(spp) else cameras.samples_taken(sampler, spp) for spp in sorted(levels))
    return tuple(dict.fromkeys(real))


def _film_size(scene: methods.Scene, camera: int, size: tuple[int, int] | None) -> tuple[int, int]:
    """Width and height of the pictures; SceneError where there is no such camera."""
    sensors = [node.props for node in scene.state.nodes if node.type == mi.ObjectType.Sensor]
    if not 1 <= camera <= len(sensors):
        raise rendering.SceneError(f"{scene.path}: there is no camera {camera}, the scene has {len(sensors)}")
    if size:
        return size
    nodes = (scene.state.nodes[i] for i in surfaces.children(sensors[camera - 1]))
    film: Any = next((node.props for node in nodes if node.type == mi.ObjectType.Film), mi.Properties("hdrfilm"))
    width, height = (film.get(name, default) for name, default in (("width", 768), ("height", 576)))
    return film.get("crop_width", width), film.get("crop_height", height)


def _check_reference(path: Path, size: tuple[int, int]) -> None:
    """ValueError where the file is no EXR picture of this size."""
    if not Path(path).is_file():
        raise ValueError(f"converge: the reference '{path}' cannot be read: there is no such file")
    try:
        height, width = images.read_exr(path).shape[:2]
    except (OSError, RuntimeError, ValueError) as error:
        raise ValueError(f"converge: the reference '{path}' cannot be read as EXR: {error}") from None
    if (width, height) != size:
        raise ValueError(f"converge: the reference '{path}' is {width} x {height}, the pictures are "
                         f"{size[0]} x {size[1]}; choose them with --size")  # fmt: skip


def write_run(store: Store, run: Run) -> None:
    """Keep what is measured, for `--from`."""
    store.claim(passes.RUN)
    images.replace_file(store.folder / passes.RUN, json.dumps(asdict(run), indent=1) + "\n")


def read_run(store: Store) -> Run:
    """The run of a folder; ValueError where there is none."""
    path = store.folder / passes.RUN
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        for name, kind in {"methods": MethodRun, "references": ReferenceRun}.items():
            items = ({**item, "levels": tuple(item["levels"])} for item in data[name])
            data[name] = tuple(kind(**item) for item in items)
        return Run(**{**data, "levels": tuple(data["levels"])})
    except (FileNotFoundError, NotADirectoryError):
        raise ValueError(f"'{store.folder}': there is no {passes.RUN} here, so no measurement to draw") from None
    except (KeyError, TypeError, ValueError):
        raise ValueError(f"'{path}' is nothing that this version wrote; measure again, with the command that made the "
                         "folder: its passes are kept") from None  # fmt: skip
