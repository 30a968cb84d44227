"""Renders a scene by several methods, at growing numbers of samples, again and again -> passes on disk.

Each limit's reference comes first. Then come the passes, interleaved: each method in turn makes one pass at each number
of samples, then all of them the next. Scenes are loaded in turn, too: Dr.Jit puts every BSDF that is alive into each kernel.
"""

import gc
import math
import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime, timezone
from pathlib import Path

import drjit as dr
import mitsuba as mi

from . import __version__, images, methods, metrics, passes, rendering
from .passes import Pass, Store

LEVELS = (1, 4, 16, 64)
REPEATS = 5

# The reference of random methods: with 32 times the samples of the finest level, its noise is 3 % of that level's.
REFERENCE_PASSES = 16
REFERENCE_SPP = 2
# Fewer give it no error bar worth the name, however short of time.
LEAST_REFERENCE_PASSES = 4

# The reference of a grid: so many times as many samples across. A power of two, so that no sample is on a coarser grid.
REFERENCE_GRID = 4

# Seeds of references, and of nothing else, have this bit.
REFERENCE_SEED = 2**31


@dataclass(frozen=True)
class MethodRun:
    """A method of a run."""

    name: str
    spec: Mapping[str, object]
    key: str
    limit: str
    """The reference's name."""
    levels: tuple[int, ...]
    """Samples per pixel, as the sampler rounds them."""


@dataclass(frozen=True)
class ReferenceRun:
    """A picture that methods are measured against."""

    name: str
    key: str
    kind: str
    """`passes` of different seeds, a `grid`, or a `file`."""
    levels: tuple[int, ...]
    """Samples per pixel of each pass; of a grid, its own and that of half as many across, which tells its error."""
    file: str = ""


@dataclass(frozen=True)
class Run:
    """What is measured, as `run.json` keeps it."""

    scene: str
    scene_hash: str
    integrator: str
    variant: str
    camera: int
    levels: tuple[int, ...]
    repeats: int
    seed: int
    methods: tuple[MethodRun, ...]
    references: tuple[ReferenceRun, ...]
    versions: str
    machine: str
    reference_file: str = ""


@dataclass(frozen=True)
class Plan:
    """What will be rendered: checked, but not loaded."""

    path: Path
    states: Mapping[str, object]
    """Key -> parsed scene."""
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
    scene_hash = _scene_hash(scene)
    machine = passes.machine(dr.thread_count())
    context = [scene_hash, camera, size, mi.variant(), seed, versions()]
    states, runs, references = {}, [], {}

    def key(method: methods.Method, *more) -> str:
        made = f"{method.name}-{passes.digest([*context, method.spec(), *more])}"
        states[made] = methods.applied(scene, method)
        return made

    for method in methods.chosen(scene, given):
        limit = methods.limit(scene, method)
        name = limit.name
        if reference is not None:
            name = Path(reference).name
            references[name] = ReferenceRun(name, passes.digest(_file_hash(reference)), "file", (), str(reference))
        elif name not in references:
            references[name] = _reference(limit, methods.integrator_of(scene, limit), levels, key(limit, "reference"))
        real = tuple(dict.fromkeys(_rounded(method, methods.integrator_of(scene, method), n) for n in sorted(levels)))
        runs.append(MethodRun(method.name, method.spec(), key(method, machine), name, real))
    run = Run(Path(path).name, scene_hash, scene.integrator, mi.variant(), camera, tuple(levels), repeats, seed,
              tuple(runs), tuple(references.values()), versions(), machine, str(reference or ""))  # fmt: skip
    return Plan(Path(path), states, size, run)


def versions() -> str:
    """All that a picture depends on besides its scene."""
    return f"phong_bsdf {__version__}, Mitsuba {mi.__version__}, Dr.Jit {dr.__version__}"


def measure(
    planned: Plan,
    store: Store,
    *,
    time_budget: float = math.inf,
    on_progress: Callable[[str, float], None] = lambda what, share: None,
) -> int:
    """Make the passes that are not on disk yet; returns how many are missing because of the time budget.

    Half of the budget, in seconds, is for the references, the rest for the passes. A method that
    fails is left out, its reason kept in the store.
    """
    session = _Session(planned, store, on_progress)
    session.deadline = time.perf_counter() + time_budget / 2
    for reference in planned.run.references:
        session.make_reference(reference)
    session.deadline = time.perf_counter() + time_budget / 2
    for method in planned.run.methods:
        store.set_failure(method.key, session.failed_references.get(method.limit))
    for repeat in range(planned.run.repeats):
        for method in planned.run.methods:
            session.make_passes(method, repeat)
    return session.skipped


class _Session:
    """One run of `measure`."""

    def __init__(self, planned: Plan, store: Store, on_progress):
        self.plan, self.store, self.on_progress = planned, store, on_progress
        self.deadline, self.skipped = math.inf, 0
        self.failed_references: dict[str, str] = {}
        # (key, spp) -> seconds of its last pass.
        self.known: dict[tuple[str, int], float] = {}
        run = planned.run
        self.done, self.work = 0, run.repeats * sum(sum(method.levels) for method in run.methods)
        self.work += sum(sum(reference.levels) for reference in run.references)

    def make_reference(self, reference: ReferenceRun) -> None:
        """Its passes; why that fails is kept for the methods that need it."""
        if reference.kind == "file":
            return
        try:
            self._block(reference.key, f"reference {reference.name}", reference.levels, seed_bit=REFERENCE_SEED)
        except (ValueError, RuntimeError, MemoryError) as error:
            self.failed_references[reference.name] = f"its reference failed: {_reason(error)}"

    def make_passes(self, method: MethodRun, repeat: int) -> None:
        """One pass at each level."""
        if self.store.failure(method.key) is None:
            try:
                self._block(method.key, method.name, method.levels, repeat=repeat)
            except (ValueError, RuntimeError, MemoryError) as error:
                self.store.set_failure(method.key, _reason(error))

    def _block(self, key: str, what: str, levels: Sequence[int], *, repeat: int | None = None, seed_bit: int = 0):
        """The passes of one method that are not there yet. Without `repeat`, as of a reference, each level is one."""
        jobs = [(spp, i if repeat is None else repeat) for i, spp in enumerate(levels)]
        todo = [job for job in jobs if not self.store.has(key, *job)]
        self._progress(what, sum(levels) - sum(spp for spp, _ in todo))
        if not todo:
            return
        least = LEAST_REFERENCE_PASSES if repeat is None else 0
        gc.collect()
        loaded = rendering.load_parsed(self.plan.path, methods.loadable(self.plan.states[key]))
        if self.plan.size:
            rendering.resize(loaded, self.plan.run.camera, *self.plan.size)
        for i, (spp, number) in enumerate(todo):
            if number >= least and time.perf_counter() + self._expected(key, spp) > self.deadline:
                self.skipped += 1
            else:
                self._pass(loaded, key, spp, number, seed_bit, timed=repeat is not None, first=i == 0)
            self._progress(what, spp)

    def _pass(self, loaded, key: str, spp: int, repeat: int, seed_bit: int, *, timed: bool, first: bool) -> None:
        run = self.plan.run
        text = passes.digest(f"{run.seed}/{key}/{spp}/{repeat}", 8)
        # A large rendering goes in passes of consecutive seeds: leave them room.
        seed = int(text, 16) % 2**30 | seed_bit
        result, seconds = _timed(loaded, run.camera, spp, seed)
        warmup = 0.0
        # The first rendering of a scene, and one that compiles, says what that costs; the next one its own time.
        if timed and dr.is_jit_v(mi.Float) and (first or result.compiled):
            before = seconds
            result, seconds = _timed(loaded, run.camera, spp, seed)
            warmup = max(before - seconds, 0.0)
        self.known[key, spp] = seconds
        now = datetime.now(timezone.utc).isoformat(timespec="seconds")
        made = Pass(spp, seed, repeat, seconds, warmup, run.variant, run.versions, run.machine, now)
        self.store.add(key, made, metrics.colors(result.image))

    def _expected(self, key: str, spp: int) -> float:
        """Seconds of a pass, from the last one like it, or in proportion from a smaller one."""
        smaller = [n for k, n in self.known if k == key and n <= spp]
        return self.known[key, max(smaller)] * spp / max(smaller) if smaller else 0.0

    def _progress(self, what: str, done: int) -> None:
        self.done += done
        self.on_progress(what, min(self.done / self.work, 1.0))


def _timed(loaded, camera: int, spp: int, seed: int):
    """A rendering, and the seconds from nothing being under way to all of it being done."""
    dr.sync_thread()
    start = time.perf_counter()
    result = rendering.render(loaded, camera=camera, spp=spp, seed=seed)
    dr.sync_thread()
    return result, time.perf_counter() - start


def _reference(limit: methods.Method, integrator: str, levels: Sequence[int], key: str) -> ReferenceRun:
    if integrator == methods.WHITTED:
        across = 2 ** math.ceil(math.log2(REFERENCE_GRID * math.sqrt(max(levels))))
        return ReferenceRun(limit.name, key, "grid", (across**2, (across // 2) ** 2))
    return ReferenceRun(limit.name, key, "passes", (REFERENCE_SPP * max(levels),) * REFERENCE_PASSES)


def _rounded(method: methods.Method, integrator: str, spp: int) -> int:
    """The number of samples that the method takes when asked for `spp`."""
    if integrator == methods.WHITTED and math.isqrt(spp) ** 2 == spp:
        return spp
    before = mi.log_level()
    mi.set_log_level(mi.LogLevel.Error)
    try:
        sampler = mi.load_dict({"type": method.sampler})
        sampler.set_sample_count(spp)
        return int(sampler.sample_count())
    finally:
        mi.set_log_level(before)


def _scene_hash(scene: methods.Scene) -> str:
    """Of all that the scene says, its defines put in, and of every file that it names."""
    files = {}
    for node in scene.state.nodes:
        for name in node.props.keys():  # noqa: SIM118
            value = node.props[name] if node.props.type(name) == mi.Properties.Type.String else ""
            file = scene.path.parent / value if value else None
            if file and file.is_file():
                files[value] = _file_hash(file)
    text = mi.parser.write_string(scene.state)
    return passes.digest([text, files])


def _file_hash(path: Path) -> str:
    try:
        return passes.digest(Path(path).read_bytes().hex(), 64)
    except OSError as error:
        raise ValueError(f"'{path}' cannot be read: {error.strerror}") from None


def _reason(error: BaseException) -> str:
    text = re.sub(r"\s+", " ", str(error)).strip()
    return text if isinstance(error, rendering.SceneError) else f"{type(error).__name__}: {text}"


def write_run(store: Store, run: Run) -> None:
    """Keep what is measured, for `--from`."""
    import json

    images.replace_file(store.folder / passes.RUN, json.dumps(asdict(run), indent=1) + "\n")


def read_run(store: Store) -> Run:
    """The run of a folder; ValueError where there is none."""
    import json

    path = store.folder / passes.RUN
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ValueError(f"'{store.folder}': there is no {passes.RUN} here, so no measurement to draw") from None
    tuples = {"methods": MethodRun, "references": ReferenceRun}
    for name, kind in tuples.items():
        items = ({**item, "levels": tuple(item["levels"])} for item in data[name])
        data[name] = tuple(kind(**item) for item in items)
    return Run(**{**data, "levels": tuple(data["levels"])})
