"""MTL files -> materials: every statement with its options, as it stands. What they mean is the matter of `materials`.

tinyobjloader reads MTL files too, but its Python interface does not tell the options of the maps, takes a material
without `illum` for one of constant colour, and words for 0.
"""

import math
import re
from dataclasses import dataclass, field
from pathlib import Path

from .objfile import decoded, without_mark
from .records import ConversionError, Journal

COLORS = ("ka", "kd", "ks", "ke", "tf")
NUMBERS = ("ns", "ni", "d", "tr", "illum")
MAPS = {
    "map_ka": "ka", "map_kd": "kd", "map_ks": "ks", "map_ke": "ke", "map_ns": "ns", "map_d": "d", "map_tr": "tr",
    "map_bump": "bump", "bump": "bump", "norm": "norm", "map_kn": "norm",
}  # fmt: skip
LEFT_OUT = {
    "disp": "displacement is not rendered", "decal": "decals are not rendered",
    "refl": "reflection maps are not rendered: mirrors show the scene", "sharpness": "it is about reflection maps",
    "map_aat": "anti-aliasing is the sampler's matter",
    "aniso": "anisotropy is not rendered", "anisor": "anisotropy is not rendered",
}  # fmt: skip
PHYSICAL = ("pr", "pm", "ps", "pc", "pcr", "map_pr", "map_pm", "map_ps", "map_pc", "map_pcr", "map_refl")

# Options of a map: how many values each takes at least, and at most.
OPTIONS = {
    "-s": (1, 3), "-o": (1, 3), "-t": (1, 3), "-mm": (2, 2), "-bm": (1, 1), "-clamp": (1, 1), "-imfchan": (1, 1),
    "-blendu": (1, 1), "-blendv": (1, 1), "-cc": (1, 1), "-texres": (1, 1), "-boost": (1, 1), "-type": (1, 1),
}  # fmt: skip
WORDS = ("-clamp", "-imfchan", "-blendu", "-blendv", "-cc", "-type")
UNUSED = ("-t", "-blendu", "-blendv", "-cc", "-texres", "-boost", "-type")


@dataclass
class Map:
    """A texture of a material."""

    file: str
    line: int
    options: dict[str, list] = field(default_factory=dict)

    def numbers(self, option: str, default: tuple[float, ...]) -> tuple[float, ...]:
        """The values of an option, those that are not given from `default`."""
        given = self.options.get(option, [])
        return (*given, *default[len(given) :])


@dataclass
class Material:
    """One `newmtl`: its numbers, colours and maps by their names in lower case."""

    name: str
    library: Path
    line: int
    values: dict[str, tuple[float, ...]] = field(default_factory=dict)
    maps: dict[str, Map] = field(default_factory=dict)
    lines: dict[str, int] = field(default_factory=dict)

    def place(self, name: str = "") -> tuple[str, int]:
        """File and line of one of its statements, or of `newmtl`."""
        return self.library.name, self.lines.get(name, self.line)


def read(path: Path, journal: Journal) -> dict[str, Material]:
    """The materials of an MTL file by their names."""
    try:
        text = decoded_lines(without_mark(path.read_bytes()))
    except OSError as error:
        raise ConversionError(f"{path}: {error.strerror}") from None
    materials: dict[str, Material] = {}
    current = None
    for number, line in enumerate(text, 1):
        keyword, _, rest = line.partition(" ")
        keyword, rest, place = keyword.lower(), rest.strip(), (path.name, number)
        if keyword == "newmtl":
            current = Material(rest, path, number)
            if rest in materials:
                journal.loss(place, f"material '{rest}'", "defined twice in this file; the first counts")
            materials.setdefault(rest, current)
        elif keyword and not keyword.startswith("#"):
            if current is None:
                journal.loss(place, f"'{keyword[:40]}'", "stands before any newmtl")
            else:
                _statement(current, keyword, rest, place, journal)
    return materials


def decoded_lines(data: bytes) -> list[str]:
    """Lines of text, tabs as spaces, continued lines joined; each keeps its number."""
    data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    lines, pending, held = [], b"", 0
    for raw in data.split(b"\n"):
        if raw.endswith(b"\\"):
            pending, held = pending + raw[:-1] + b" ", held + 1
            continue
        lines += [decoded(pending + raw).strip(), *[""] * held]
        pending, held = b"", 0
    return [*lines, decoded(pending).strip()]


def _statement(material: Material, keyword: str, rest: str, place, journal: Journal) -> None:
    material.lines[keyword] = place[1]
    if keyword in MAPS:
        found = _map(rest, place, journal)
        if found:
            material.maps[MAPS[keyword]] = found
            material.lines[f"map {MAPS[keyword]}"] = place[1]
        return
    if keyword in PHYSICAL:
        journal.loss(place, f"'{keyword}'", "part of a physically based extension of MTL, which is not read")
        return
    if keyword in LEFT_OUT or keyword not in (*COLORS, *NUMBERS):
        journal.loss(place, f"'{keyword[:40]}'", LEFT_OUT.get(keyword, "no statement of MTL that is known here"))
        return
    words = rest.split()
    if keyword == "d" and words[:1] == ["-halo"]:
        journal.loss(place, "'d -halo'", "opacity that depends on the angle; now the same at all angles")
        words = words[1:]
    values = _color(words, place, journal) if keyword in COLORS else _numbers(words[:1])
    if values is None:
        journal.loss(
            place,
            f"'{keyword} {rest[:40]}'",
            "left out: this should be " + ("a colour" if keyword in COLORS else "a number"),
        )
    else:
        material.values[keyword] = values


def _color(words: list[str], place, journal: Journal) -> tuple[float, ...] | None:
    kind = words[0].lower() if words else ""
    if kind == "spectral":
        return None
    values = _numbers(words[1:4] if kind == "xyz" else words[:3])
    if not values:
        return None
    values = values if len(values) == 3 else (values[0],) * 3
    if kind == "xyz":
        # CIE XYZ to linear sRGB (IEC 61966-2-1).
        x, y, z = values
        values = (
            3.2406 * x - 1.5372 * y - 0.4986 * z,
            -0.9689 * x + 1.8758 * y + 0.0415 * z,
            0.0557 * x - 0.204 * y + 1.057 * z,
        )
    if min(values) < 0:
        journal.loss(place, "a colour below 0", "its negative channels are taken as 0")
    return tuple(max(v, 0.0) for v in values)


def _numbers(words: list[str]) -> tuple[float, ...] | None:
    try:
        values = tuple(float(word) for word in words)
    except ValueError:
        return None
    return values if values and all(math.isfinite(v) and abs(v) < 1e30 for v in values) else None


def _map(rest: str, place, journal: Journal) -> Map | None:
    """Options, then a file name, which may hold spaces."""
    words, at, options = list(re.finditer(r"\S+", rest)), 0, {}
    while at < len(words) and words[at][0].lower() in OPTIONS:
        option = words[at][0].lower()
        least, most = OPTIONS[option]
        following = [word[0] for word in words[at + 1 : at + 1 + most]]
        values = [word.lower() for word in following] if option in WORDS else _leading_numbers(following)
        at += 1 + len(values)
        if len(values) < least:
            journal.loss(place, f"option {option}", f"left out: it needs {least} value{'s' * (least > 1)}")
        elif option in UNUSED:
            journal.loss(place, f"option {option}", "Mitsuba's textures have nothing like it")
        else:
            options[option] = values
    if at == len(words):
        journal.loss(place, "a map without a file name", "left out")
        return None
    return Map(rest[words[at].start() :].strip(), place[1], options)


def _leading_numbers(words: list[str]) -> list[float]:
    values = []
    for word in words:
        found = _numbers([word])
        if not found:
            break
        values += found
    return values
