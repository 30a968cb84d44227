"""One scene, many pictures of it: each is compared with the rendering, and what is wrong with it is diagnosed."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import mitsuba as mi
import numpy as np

from ..pictures import metrics
from ..scene import rendering
from . import pictures
from .defaults import EDGES, RIGHT, TOLERANCE, UNREADABLE, WRONG
from .diagnosis import Diagnostician, Explanation
from .hits import Undiagnosable
from .pictures import Encoding, Picture, PictureError
from .verdict import compare

__all__ = ["Assignment", "Checked", "Finding", "Grade", "Options"]

# So many explanations are kept.
MOST_EXPLANATIONS = 5


@dataclass(frozen=True)
class Options:
    """How pictures are read and compared."""

    linear: bool = False
    """PNG and JPEG hold 255 times the linear value, not its sRGB encoding."""
    tolerance: float = TOLERANCE
    """How far a value may be off beyond its own rounding, in steps of 8 bits (1)."""
    edges: float = EDGES
    """The part of the pixels that may be off at edges, 0 to 1 (0.002)."""
    diagnose: bool = True
    """Whether mistakes are looked for."""


@dataclass(frozen=True)
class Finding:
    """An explanation, as it is told."""

    name: str
    """Of the mistake, as in the table of docs/lecturers.md; of a pair both, with + between them."""
    title: str
    """The mistake, as a student reads it."""
    advice: str
    """What to do about it."""
    confidence: float
    """0 to 1: `explained`, divided among the mistakes that look alike."""
    explained: float
    """The part of what is wrong that the mistake explains, 0 to 1."""
    same: tuple[str, ...]
    """What cannot be told from it in this scene."""


@dataclass(frozen=True)
class Grade:
    """What there is to say about one picture."""

    picture: str
    """What it is called."""
    status: str
    """`right`, `wrong` or `unreadable`."""
    score: float
    """1 where it is right; else the part of the pixels, of those that show more than background, that are."""
    words: str
    """One or two sentences for whoever made the picture."""
    pixels_off: float | None
    """Part of all pixels, 0 to 1; None where it could not be read."""
    mistake: Finding | None
    """The mistake to tell; None: it is right, or none of the usual ones explains it."""
    candidates: tuple[Finding, ...]
    """All explanations, the best first, told or not."""
    diagnosed: bool
    """Whether mistakes were looked for; the notes say why not."""
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Checked:
    """A grade with what it was formed from, encoded as the picture's file is; None where it could not be read.

    `picture` and `explanations` are for `Assignment.picture_of`; what they hold is internal.
    """

    grade: Grade
    picture: Picture | None = None
    expected: np.ndarray | None = None
    """The right picture, (height, width, 3), float64."""
    excess: np.ndarray | None = None
    """How far each pixel is off, in multiples of what is allowed, (height, width)."""
    explanations: tuple[Explanation, ...] = field(default=())


class Assignment:
    """A scene that was to be rendered, with the right picture."""

    def __init__(
        self, path: Path, defines: Mapping[str, str] | None = None, *, camera: int = 1, spp: int = 0,
        size: tuple[int, int] | None = None, seed: int = 0, options: Options | None = None,
    ):  # fmt: skip
        """Load the scene in the active variant, with `defines` for its `<default>`s, and render camera number `camera`
        (from 1) with `spp` samples per pixel (0: as the scene says) at `size` (width, height).

        `rendering.SceneError` where that is not possible, or shows pixels that are not finite.
        """
        self.options = options or Options()
        self.settings = {"camera": camera, "spp": spp, "size": size, "seed": seed}
        # Surfaces keep their names.
        state = rendering.parse(path, defines, merge=False)
        self.directions = [tuple(node.props["direction"]) for node in state.nodes if _is_directional(node)]
        self.loaded = rendering.load_parsed(path, state)
        if size:
            rendering.resize(self.loaded, camera, *size)
        self.sensor = self.loaded.sensor(camera)
        self.rendering = rendering.render(self.loaded, camera=camera, spp=spp, seed=seed, color=True)
        image = metrics.colors(self.rendering.image)
        bad = metrics.nonfinite(image)
        if bad:
            raise rendering.SceneError(f"{path}: {bad} pixels of the rendering are not finite: nothing can be compared")
        self.image = np.broadcast_to(image, (*image.shape[:2], 3)).astype(np.float64)
        self._diagnosticians: dict[Encoding, Diagnostician | Undiagnosable] = {}

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        return self.image.shape[1], self.image.shape[0]

    def check(self, file: Path, name: str | None = None) -> Checked:
        """Compare one file, called `name`, with the rendering, and explain what is wrong; a bad file is graded, too.

        PNG, JPEG, PPM, BMP, EXR or NumPy (height, width, channels); PNG and the like need `phong-bsdf[check]`.
        """
        name = name or Path(file).name
        try:
            picture = pictures.read(file, linear=self.options.linear, size=self.size)
        except (PictureError, OSError, MemoryError) as error:
            words = str(error).removeprefix(f"{Path(file).name}: ").removeprefix(f"{file}: ")
            words = f"{words or 'the picture does not fit into memory'}."
            return Checked(Grade(name, UNREADABLE, 0.0, words, None, None, (), False, ()))
        if picture.weighted is not None:
            # Some programs store colours that were multiplied with alpha already. What fits better was meant.
            readings = (picture.weighted, picture)
            picture = min(readings, key=lambda reading: self._compared(reading)[0].wrong.sum())
        return self._check_picture(name, picture)

    def _check_picture(self, name: str, picture: Picture) -> Checked:
        """Compare a picture that has been read, called `name`, with the rendering, and explain what is wrong."""
        encoding = picture.encoding
        verdict, expected, allowed, relative = self._compared(picture)
        notes, diagnosis = list(picture.notes), None
        if not verdict.passed and self.options.diagnose:
            try:
                if not np.isfinite(picture.values).all():
                    raise Undiagnosable("pixels that are not finite come first")
                diagnostician = self._diagnostician(encoding)
                diagnosis = diagnostician.explain(picture, allowed + relative * np.abs(expected))
            except Undiagnosable as error:
                notes.append(f"not diagnosed: {error}")
        named = diagnosis.named if diagnosis else None
        candidates = diagnosis.ranked[:MOST_EXPLANATIONS] if diagnosis else ()
        grade = Grade(
            name, RIGHT if verdict.passed else WRONG,
            1.0 if verdict.passed else _score(expected, allowed, verdict.wrong), verdict.words, verdict.share,
            named and _told(named), tuple(map(_told, candidates)), diagnosis is not None, tuple(notes),
        )  # fmt: skip
        return Checked(grade, picture, expected, verdict.excess, candidates)

    def _compared(self, picture: Picture):
        """The verdict on a picture, what was expected, and what was allowed: absolutely, and as part of the value."""
        encoding = picture.encoding
        expected = encoding.encode(self.image)
        step = self.options.tolerance / 255
        allowed = step + encoding.loss(expected)
        # Floating point goes beyond 1, where the same part of the value is allowed.
        relative = 0.0 if encoding.step else step
        # Told in the numbers that the file holds: of 8 bits, 0 to 255.
        unit = round(1 / encoding.step) if encoding.step else 1
        verdict = compare(
            picture.values * unit, expected * unit, absolute=allowed * unit, relative=relative,
            edges=self.options.edges,
        )  # fmt: skip
        return verdict, expected, allowed, relative

    def picture_of(self, checked: Checked, explanation: Explanation) -> np.ndarray:
        """The whole picture as one of `checked.explanations` makes it, (height, width, 3).

        It is encoded as the picture that was checked.
        """
        return self._diagnostician(checked.picture.encoding).picture(explanation, checked.picture.values)

    def _diagnostician(self, encoding: Encoding) -> Diagnostician:
        # Depth and tables of a file do not matter, only whether it is clamped, and its curve.
        key = Encoding(1 / 255 if encoding.step else 0.0, encoding.srgb)
        if key not in self._diagnosticians:
            try:
                self._diagnosticians[key] = Diagnostician(
                    self.loaded.scene, self.sensor, self.image, spp=self.rendering.spp, encoding=key,
                    directions=self.directions,
                )  # fmt: skip
            except Undiagnosable as error:
                self._diagnosticians[key] = error
        found = self._diagnosticians[key]
        if isinstance(found, Undiagnosable):
            raise found
        return found

    @cached_property
    def name(self) -> str:
        """The name of the scene's file."""
        return self.loaded.path.name


def _told(explanation: Explanation) -> Finding:
    return Finding(
        explanation.name, explanation.title, explanation.advice, explanation.confidence, explanation.explained,
        explanation.same,
    )  # fmt: skip


def _is_directional(node) -> bool:
    return (
        node.type == mi.ObjectType.Emitter
        and node.props.plugin_name() == "directional"
        and "direction" in node.props
    )  # fmt: skip


def _score(expected: np.ndarray, allowed: np.ndarray, wrong: np.ndarray) -> float:
    """The part that is right of the pixels that show more than the most common colour, or are wrong."""
    colours, counts = np.unique(expected.reshape(-1, 3).round(6), axis=0, return_counts=True)
    counted = (np.abs(expected - colours[np.argmax(counts)]) > allowed).any(axis=-1) | wrong
    return float(1 - wrong.sum() / max(counted.sum(), 1))
