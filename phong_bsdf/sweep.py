"""A scene under every combination of some parameters: planned, rendered one by one, told in rows."""

import functools
import gc
import itertools
import json
import math
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import mitsuba as mi
import numpy as np

from .pictures import images, metrics, parts
from .progressive import planning
from .scene import fingerprint, rendering

# Columns that a table has besides the parameters.
COLUMNS = ("file", "seconds", "mean", "error")

RANGE = re.compile(r"(?P<first>[^:]+):(?P<last>[^:]+):(?P<kind>lin|log)(?P<count>\d+)")
MOST = 100_000

# A file's record of its row.
RECORD = "sweep"

LONGEST_NAME = 100


@dataclass(frozen=True)
class Settings:
    """What all pictures have in common; `spp` 0 and `size` None: as the scene says."""

    camera: int = 1
    size: tuple[int, int] | None = None
    spp: int = 0
    seed: int = 0


@dataclass(frozen=True)
class Row:
    """One combination, and what became of it."""

    defines: tuple[tuple[str, str], ...]
    file: str
    key: str = ""
    """Of all that the picture depends on: a file that has another one shows something else."""
    seconds: float | None = None
    mean: float | None = None
    """Of all pixels and colours."""
    error: str = ""


@dataclass(frozen=True)
class Sweep:
    """What is to be rendered."""

    path: Path
    settings: Settings
    names: tuple[str, ...]
    """The parameters."""
    rows: tuple[Row, ...]


def values(text: str) -> list[str]:
    """What `1:1000:log20` (20 numbers, evenly spaced in their logarithm), `0:1:lin5` or `0,.5,1` stands for."""
    return [value for item in text.split(",") for value in _item(item.strip(), text)]


def plan(path: Path, defines: Sequence[tuple[str, str]], settings: Settings | None = None) -> Sweep:
    """All combinations of the values of each define, the last changing fastest.

    ValueError where a define is given twice, is no list, or where no combination can be parsed: then it is the
    scene, or the name of a parameter, that is wrong.
    """
    names = [name for name, _ in defines]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"-D {name} is given twice; write its values as one list: -D {name}=1,2")
    lists = [values(text) for _, text in defines]
    if math.prod(map(len, lists)) > MOST:
        raise ValueError(f"these are {math.prod(map(len, lists))} combinations; a sweep has at most {MOST}")
    varied = {name for name, listed in zip(names, lists, strict=True) if len(listed) > 1} or set(names)
    settings, rows = settings or Settings(), []
    # Large meshes are read once.
    hashed = functools.cache(fingerprint.file_hash)
    for chosen in itertools.product(*lists):
        pairs = tuple(zip(names, chosen, strict=True))
        row = Row(pairs, file_name([pair for pair in pairs if pair[0] in varied]))
        try:
            rows.append(replace(row, key=_key(path, dict(pairs), settings, hashed)))
        except rendering.SceneError as error:
            rows.append(replace(row, error=str(error)))
    if all(row.error for row in rows):
        raise ValueError(rows[0].error)
    return Sweep(Path(path), settings, tuple(names), tuple(rows))


def file_name(pairs: Sequence[tuple[str, str]]) -> str:
    """`km=0.5,p=10.exr`; where that is long or has odd characters, with some digits that tell it from others."""
    said = ",".join(f"{name}={value}" for name, value in pairs) or "picture"
    clean = re.sub(r"[^\w.,=+-]+", "-", said)[:LONGEST_NAME].strip(".")
    return f"{clean}.exr" if clean == said else f"{clean}-{fingerprint.digest(said, 8)}.exr"


def render(path: Path, row: Row, settings: Settings, output: Path, packed: str = "") -> tuple[float, float]:
    """Render one combination into the EXR file `output`: seconds and mean. Raises `rendering.SceneError`.

    `packed`: `path` is that of a bundle, which has the defines inside, and this is the name of its scene.
    """
    defines = {} if packed else dict(row.defines)
    loaded, subject = planning.load(path, defines, camera=settings.camera, size=settings.size)
    subject = replace(subject, scene=packed or subject.scene, defines=tuple(sorted(row.defines)))
    samples = planning.samples_of(loaded, subject, settings.spp, settings.seed)
    start = time.perf_counter()
    made = rendering.render(loaded, camera=settings.camera, spp=settings.spp, seed=settings.seed)
    seconds, mean = time.perf_counter() - start, _energy(made)
    record = json.dumps({"key": row.key, "seconds": seconds, "mean": mean})
    said = {RECORD: record, **parts.metadata(subject, [samples])}
    images.write(output, made.image, channels=made.channels, metadata=said)
    return seconds, mean


def _energy(made: rendering.Rendering) -> float:
    """Mean over the pixels and the channels of the colour; of a film of bands over all of them."""
    if images.color_channels(made.channels):
        return metrics.energy(images.color(made.image, made.channels))
    return float(made.image.mean(dtype=np.float64))


def told(row: Row, folder: Path) -> Row | None:
    """The row as its file in the folder tells it; None where there is none, or it shows something else."""
    path = folder / row.file
    try:
        # Its library says aloud that a file is not there.
        record = json.loads(images.read_metadata(path)[RECORD]) if path.is_file() else {"key": None}
        return replace(row, seconds=record["seconds"], mean=record["mean"]) if record["key"] == row.key else None
    except (RuntimeError, ValueError, KeyError, TypeError):
        return None


def run(sweep: Sweep, rows: Sequence[Row], folder: Path) -> Iterator[Row]:
    """Render these rows here, one after the other. A combination that fails is a row with its error."""
    for row in rows:
        # What is alive is compiled into every later kernel.
        gc.collect()
        try:
            seconds, mean = render(sweep.path, row, sweep.settings, folder / row.file)
            yield replace(row, seconds=seconds, mean=mean)
        except (rendering.SceneError, MemoryError) as error:
            yield replace(row, error=str(error) or "the picture does not fit into memory")


def _item(text: str, whole: str) -> list[str]:
    if ":" not in text:
        if not text:
            raise ValueError(f"'{whole}' has an empty value; write values as 0,.5,1")
        return [text]
    found = RANGE.fullmatch(text)
    try:
        if not found:
            raise ValueError
        first, last, count = float(found["first"]), float(found["last"]), int(found["count"])
    except ValueError:
        raise ValueError(f"'{text}' is no range; write 0:1:lin5 or 1:1000:log20") from None
    if not 1 <= count <= MOST or not (math.isfinite(first) and math.isfinite(last)):
        raise ValueError(f"'{text}': a range goes from number to number, in 1 to {MOST} values")
    if found["kind"] == "log" and not first * last > 0:
        raise ValueError(f"'{text}': logarithms need numbers that are not 0, both of one sign")
    spaced = np.linspace if found["kind"] == "lin" else np.geomspace
    # Six digits, as a reader would write them; so 10 is 10 and not 9.999999999999998.
    return [f"{value:.6g}" for value in spaced(first, last, count)]


def _key(path: Path, defines: Mapping[str, str], settings: Settings, hashed: Callable[[Path], str]) -> str:
    state = rendering.parse(path, defines, merge=False)
    rendering.check(path, state)
    # Beside the hash, which leaves sizes and samples out, the whole text.
    said = [fingerprint.scene_hash(path, state, hashed), mi.parser.write_string(state)]
    return fingerprint.digest([*said, asdict(settings), mi.variant(), fingerprint.versions()])
