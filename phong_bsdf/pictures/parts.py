"""Pictures of some of the samples of one picture: what each says about itself in its header, and their mean.

No rendering here: parts come from any machine, in any order, and their mean depends on neither.
"""

import dataclasses
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from ..tracing.camera import grid
from . import images
from .estimates import WeightedMean

SUBJECT, SAMPLES = "subject", "samples"


@dataclass(frozen=True)
class Subject:
    """What a picture shows: pictures with the same subject differ in their samples only."""

    scene: str
    """The file's name, for the reader."""
    scene_hash: str
    defines: tuple[tuple[str, str], ...]
    integrator: str
    variant: str
    camera: int
    size: tuple[int, int]
    """Width and height."""
    versions: str


@dataclass(frozen=True)
class Samples:
    """Which samples of its subject a picture is made of."""

    spp: int
    seed: int = 0
    random: bool = True
    """False where no random number is used: then the samples are those of a grid, and the seed means nothing."""
    step: int = 1
    shift: tuple[int, int] = (0, 0)
    """With `step` > 1 a part of a grid: `camera.CameraSamples`."""
    index: int = 0
    """Number of the pass, which decides in which order parts are added up."""

    def names(self) -> Iterator[object]:
        """What no other part may have: the seed, or the place of each sample in a pixel."""
        if self.random:
            yield self.seed
            return
        across = grid(self.spp)
        assert across is not None, "samples that are not random are those of a grid"
        for row in self._places(across, self.shift[1]):
            for column in self._places(across, self.shift[0]):
                yield column, row

    def __str__(self) -> str:
        if self.random:
            return f"seed {self.seed}"
        across = grid(self.spp) * self.step
        whole = f"the fixed grid of {across} x {across} samples"
        return whole if self.step == 1 else f"part {self.shift[0]}, {self.shift[1]} of {whole}"

    def _places(self, across: int, shift: int) -> list[Fraction]:
        return [Fraction(2 * (cell * self.step + shift) + 1, 2 * across * self.step) for cell in range(across)]


@dataclass(frozen=True)
class Part:
    """A file with a picture of some samples."""

    path: Path
    subject: Subject
    samples: tuple[Samples, ...]
    """One, or those of all the parts that it was merged from."""
    channels: tuple[str, ...] = tuple("RGB")
    """Names of the picture's channels."""

    @property
    def spp(self) -> int:
        """Samples per pixel of all of it."""
        return sum(samples.spp for samples in self.samples)


def metadata(subject: Subject, samples: Sequence[Samples]) -> dict[str, str]:
    """What a picture's header says about it: for people, and for `read`."""
    said = {"phong_bsdf": subject.versions.split(",")[0].removeprefix("phong_bsdf "), "scene": subject.scene,
            "variant": subject.variant, "spp": str(sum(s.spp for s in samples))}  # fmt: skip
    if len(samples) == 1:
        said["seed"] = str(samples[0].seed)
    usual = dataclasses.asdict(Samples(0))
    known = [{k: v for k, v in dataclasses.asdict(s).items() if v != usual[k]} for s in samples]
    return {**said, SUBJECT: json.dumps(dataclasses.asdict(subject)), SAMPLES: json.dumps(known)}


def subject_from(data: dict) -> Subject:
    """A subject as JSON has it. Raises TypeError, KeyError or ValueError where it is none."""
    defines = tuple((str(name), str(value)) for name, value in data["defines"])
    return Subject(**{**data, "defines": defines, "size": (int(data["size"][0]), int(data["size"][1]))})


def read(path: Path) -> Part:
    """The description in a file's header; ValueError where there is none."""
    path = Path(path)
    if not path.is_file():
        raise ValueError(f"'{path}': {'this is a folder' if path.is_dir() else 'there is no such file'}")
    try:
        header, channels = images.read_metadata(path), images.read_channels(path)
    except (RuntimeError, ValueError, OSError):
        raise ValueError(f"'{path}' cannot be read as EXR; a picture is merged from the .exr files that "
                         "`phong-bsdf render` wrote") from None  # fmt: skip
    try:
        subject = subject_from(json.loads(header[SUBJECT]))
        listed = [Samples(**{**s, "shift": tuple(s.get("shift", (0, 0)))}) for s in json.loads(header[SAMPLES])]
        if not listed or not all(s.spp > 0 and (s.random or grid(s.spp)) for s in listed):
            raise ValueError("no samples")
        return Part(path, subject, tuple(listed), channels)
    except (KeyError, IndexError, TypeError, ValueError):
        raise ValueError(f"'{path}' does not say which samples of which scene it shows; only pictures that "
                         "`phong-bsdf render` wrote can be merged") from None  # fmt: skip


def differences(a: Subject, b: Subject) -> list[str]:
    """What differs, in words, first that of `a`."""
    found = []
    if a.scene_hash != b.scene_hash:
        defines = [", ".join(f"-D {name}={value}" for name, value in s.defines) for s in (a, b)]
        scenes = [f"{s.scene} {d}".rstrip() for s, d in zip((a, b), defines, strict=True)]
        found.append(
            f"scene '{scenes[0]}', not '{scenes[1]}'"
            if scenes[0] != scenes[1]
            else f"another version of the scene '{scenes[0]}' or of a file that it names"
        )
    if a.size != b.size:
        found.append(f"size {a.size[0]} x {a.size[1]}, not {b.size[0]} x {b.size[1]}")
    for name in ("integrator", "variant", "camera", "versions"):
        if (mine := getattr(a, name)) != (other := getattr(b, name)):
            found.append(f"{name} {mine}, not {other}")
    return found


def check(parts: Sequence[Part], *, mixed_versions: bool = False) -> None:
    """ValueError where parts do not belong together, or share a sample."""
    first, owners = parts[0], {}
    for part in parts:
        subject = dataclasses.replace(part.subject, versions=first.subject.versions) if mixed_versions else part.subject
        if found := differences(subject, first.subject):
            remedy = "; --mixed-versions merges all the same" if found[0].startswith("versions") else ""
            raise ValueError(f"'{part.path}' does not belong to '{first.path}': {'; '.join(found)}{remedy}")
        if part.channels != first.channels:
            mine, others = (", ".join(p.channels) for p in (part, first))
            raise ValueError(f"'{part.path}' does not belong to '{first.path}': channels {mine}, not {others}")
        for samples in part.samples:
            for name in samples.names():
                if name in owners:
                    raise ValueError(_shared(part, samples, *owners[name]))
                owners[name] = (part, samples)


def _shared(part: Part, samples: Samples, other: Part, others: Samples) -> str:
    said = f"'{part.path}' and '{other.path}' hold the same samples: {samples}"
    if samples.random:
        return f"{said}; give each part its own --seed"
    if str(samples) != str(others):
        said += f" and {others}"
    return (f"{said}. `whitted` uses no random numbers here, so --seed changes nothing; "
            "render the picture once, with as many --spp as you want")  # fmt: skip


def ordered(parts: Iterable[Part]) -> list[Part]:
    """Parts in the order in which they are added up, whatever order they come in."""
    return sorted(parts, key=lambda part: min(map(_order, part.samples)))


def merged(parts: Sequence[Part], on_progress: Callable[[float], None] = lambda share: None) -> WeightedMean:
    """The mean of parts, `ordered`, that `check` let pass; ValueError for one that is broken."""
    mean = WeightedMean(images.judged(parts[0].channels))
    for part in parts:
        image = images.read_checked(part.path)
        if image.shape[1::-1] != part.subject.size:
            raise ValueError(f"'{part.path}' is {image.shape[1]} x {image.shape[0]}, but its header says "
                             f"{part.subject.size[0]} x {part.subject.size[1]}")  # fmt: skip
        mean.add(image, part.spp)
        on_progress(mean.count / len(parts))
    return mean


def merged_metadata(parts: Sequence[Part]) -> dict[str, str]:
    """What the header of the mean says: it is a part like others, of all their samples."""
    versions = "; ".join(sorted({part.subject.versions for part in parts}))
    subject = dataclasses.replace(parts[0].subject, versions=versions)
    return metadata(subject, sorted((s for part in parts for s in part.samples), key=_order))


def _order(samples: Samples) -> tuple:
    return samples.index, samples.random, samples.seed, samples.spp, samples.step, samples.shift
