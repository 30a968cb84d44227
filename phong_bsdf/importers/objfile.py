"""OBJ files -> arrays: positions, normals, texture coordinates, triangles with material and smoothing group.

The numbers are parsed, and polygons cut into triangles, by tinyobjloader. What its Python interface does not tell
(smoothing groups), or reads otherwise than the specification (names with spaces, lines that go on in the next one,
comments after a face), is handled here, line by line, before it gets the text: it sees one group for each pair of
material and smoothing group, and nothing but `v`, `vt`, `vn` and `f` besides.
"""

import codecs
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .records import ConversionError, Journal

REMEDY = "pip install 'phong-bsdf[import]'"

# Not `v`, `vt`, `vn`, `f`: the lines that are read here. (Leading blanks are allowed everywhere.)
OTHER_LINE = re.compile(rb"^(?![ \t]*(?:v|vt|vn|f)[ \t])[^\n]+", re.M)
CONTINUED = re.compile(rb"(?:[^\n]*\\\n)+[^\n]*")
COMMENT = re.compile(rb"^([ \t]*(?:v|vt|vn|f)[ \t][^\n#]*)#[^\n]*", re.M)
# An index of ten digits would overflow, and name another vertex.
NO_NUMBER = re.compile(
    rb"^(?![ \t]*(?:v[tn]?[ \t][-+.\deE \t]*|f[ \t](?:[-/ \t]*\d{1,9}(?!\d))*[-/ \t]*|usemtl \d+)?$)", re.M
)
# `1/ 2/` and `1// 2//`: corners without the rest, as some programs write them.
BARE_SLASHES = re.compile(rb"/+(?=[ \t\n]|\Z)")

IGNORED = {b"g", b"o", b"vp", b"lod", b"bevel", b"c_interp", b"d_interp", b"shadow_obj", b"trace_obj", b"end", b"mg"}
LEFT_OUT = {
    b"l": "lines have no surface", b"p": "points have no surface", b"curv": "curves have no surface",
    b"surf": "free-form surfaces are not read; export triangles", b"fo": "old-style faces are not read",
    b"call": "commands are not run", b"csh": "commands are not run",
    b"usemap": "old-style texture maps are not read", b"maplib": "old-style texture maps are not read",
}  # fmt: skip


@dataclass
class Triangles:
    """The surfaces of an OBJ file. Index arrays have the shape (triangles, 3), -1 where nothing is given."""

    positions: np.ndarray
    normals: np.ndarray
    texcoords: np.ndarray
    v: np.ndarray
    vn: np.ndarray
    vt: np.ndarray
    material: np.ndarray
    """For each triangle an index into `materials`, -1: none."""
    smoothing: np.ndarray
    """For each triangle its smoothing group, 0: off."""
    materials: list[tuple[str, int]]
    """Names, each with the first line that uses it."""
    libraries: list[tuple[str, int]]
    """The texts of all `mtllib` lines, with their lines."""


def read(path: Path, journal: Journal, on_progress: Callable[[float], None] = lambda share: None) -> Triangles:
    """Read an OBJ file. Raises ConversionError. `on_progress` hears the share done, which it guesses."""
    loader = _loader()
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ConversionError(f"{path}: {error.strerror}") from None
    statements = _Statements(path.name, journal)
    on_progress(0.1)
    text = statements.strip_from(_tidy(without_mark(data)))
    del data
    on_progress(0.3)
    if b"/ " in text or b"/\n" in text:
        text = BARE_SLASHES.sub(b"", text)
    wrong = NO_NUMBER.search(text)
    if wrong:
        line = text.count(b"\n", 0, wrong.start()) + 1
        content = decoded(text[wrong.start() : wrong.start() + 200].split(b"\n")[0]).strip()
        raise ConversionError(f"{path}, line {line}: '{content[:60]}' should be numbers of a sensible size")
    on_progress(0.6)
    return _parse(loader, path, text, statements)


def _loader():
    try:
        import tinyobjloader
    except ImportError:
        raise ConversionError(f"OBJ files are read with tinyobjloader, which is not installed: {REMEDY}") from None
    return tinyobjloader


def without_mark(data: bytes) -> bytes:
    """Text without the byte order mark that some editors put first, in UTF-8 where the mark says UTF-16."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", errors="replace").encode()
    return data.removeprefix(codecs.BOM_UTF8)


def _tidy(data: bytes) -> bytes:
    """One kind of line end, no continued lines, no comments behind numbers; each line keeps its number."""
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if b"\0" in data:
        data = data.replace(b"\0", b" ")
    if b"\\\n" in data:
        data = CONTINUED.sub(lambda m: m[0].replace(b"\\\n", b" ") + b"\n" * m[0].count(b"\n"), data)
    return COMMENT.sub(rb"\1", data) if b"#" in data else data


class _Statements:
    """Follows the lines that set a state: material, smoothing group, libraries."""

    def __init__(self, file: str, journal: Journal):
        self.file, self.journal = file, journal
        self.pairs: dict[tuple[int, int], int] = {(-1, 0): 0}
        self.materials: dict[str, int] = {}
        self.libraries: list[tuple[str, int]] = []
        self._material, self._smoothing = -1, 0
        self._line, self._seen = 1, 0
        self._lines: dict[str | bytes, int] = {}

    def strip_from(self, text: bytes) -> bytes:
        """`text` with a `usemtl` for each pair of material and smoothing group, and no other statements."""
        return OTHER_LINE.sub(lambda match: self._statement(match, text), text)

    def named(self) -> list[tuple[str, int]]:
        """The materials, in the order of their first use, each with its line."""
        return [(name, self._lines[name]) for name in self.materials]

    def _statement(self, match, text: bytes) -> bytes:
        keyword, rest = (*match[0].split(None, 1), b"", b"")[:2]
        if keyword not in (b"usemtl", b"s", b"mtllib", *LEFT_OUT):
            if keyword and not keyword.startswith(b"#") and keyword not in IGNORED:
                self._loss(keyword, match, text, "not a statement that is known here")
            return b""
        line = self._line_of(match, text)
        if keyword == b"mtllib":
            self.libraries.append((decoded(rest).strip(), line))
            return b""
        if keyword in LEFT_OUT:
            self._loss(keyword, match, text, LEFT_OUT[keyword])
            return b""
        if keyword == b"usemtl":
            name = decoded(rest).strip()
            self._lines.setdefault(name, line)
            self._material = self.materials.setdefault(name, len(self.materials))
        else:
            self._smoothing = self._group(rest, line)
        number = self.pairs.setdefault((self._material, self._smoothing), len(self.pairs))
        return b"usemtl %d" % number

    def _group(self, rest: bytes, line: int) -> int:
        text = rest.partition(b"#")[0].strip().lower()
        if text in (b"off", b"null", b""):
            return 0
        try:
            return min(max(int(float(text)), 0), 2**31 - 1)
        except (ValueError, OverflowError):
            self.journal.loss(
                (self.file, line), f"'s {decoded(rest)[:40]}'", "a smoothing group is a number or off; taken as off"
            )
            return 0

    def _loss(self, keyword: bytes, match, text: bytes, why: str) -> None:
        if keyword not in self._lines:
            self._lines[keyword] = 1
            self.journal.loss(
                (self.file, self._line_of(match, text)), f"'{decoded(keyword)[:40]}' and all others like it", why
            )

    def _line_of(self, match, text: bytes) -> int:
        self._line += text.count(b"\n", self._seen, match.start())
        self._seen = match.start()
        return self._line


def _parse(loader, path: Path, text: bytes, statements: _Statements) -> Triangles:
    config, reader = loader.ObjReaderConfig(), loader.ObjReader()
    config.triangulate = True
    groups = "".join(f"newmtl {number}\n" for number in statements.pairs.values())
    fine = reader.ParseFromString(b"mtllib groups\nusemtl 0\n" + text, groups, config)
    message = f"{reader.Error()}\n{reader.Warning()}"
    if not fine or "out of bounds" in message:
        raise ConversionError(f"{path}{_place(message)}: {_reason(message)}")
    if "Degenerated face" in message:
        statements.journal.loss((path.name, 0), "faces of fewer than three corners", "left out")
    shapes = list(reader.GetShapes())
    attributes = reader.GetAttrib()

    def joined(get, kind=np.int32):
        # The lists, not the `numpy_` accessors: those return arrays of stride 0.
        return np.concatenate([np.zeros(0, kind), *(np.array(get(shape.mesh), kind) for shape in shapes)])

    pair = np.array(list(statements.pairs), np.int64).reshape(-1, 2)[joined(lambda mesh: mesh.material_ids)]
    return Triangles(
        positions=_vertices(attributes.vertices, 3, path, "vertices"),
        normals=_vertices(attributes.normals, 3, path, "normals"),
        texcoords=_vertices(attributes.texcoords, 2, path, "texture coordinates"),
        v=joined(lambda mesh: mesh.vertex_indices()).reshape(-1, 3),
        vn=joined(lambda mesh: mesh.normal_indices()).reshape(-1, 3),
        vt=joined(lambda mesh: mesh.texcoord_indices()).reshape(-1, 3),
        material=pair[:, 0],
        smoothing=pair[:, 1],
        materials=statements.named(),
        libraries=statements.libraries,
    )


def _vertices(values, n: int, path: Path, what: str) -> np.ndarray:
    with np.errstate(over="ignore"):
        array = np.array(values, np.float32).reshape(-1, n)
    if not np.isfinite(array).all() or np.abs(array, out=array.copy()).max(initial=0) > 1e18:
        raise ConversionError(f"{path}: there are {what} that are not finite, or beyond 1e18")
    return array


def _place(message: str) -> str:
    line = re.search(r"[Ll]ine (\d+)", message)
    # Two lines are put before the file's own.
    return f", line {int(line[1]) - 2}" if line else ""


def _reason(message: str) -> str:
    if "out of bounds" in message:
        return "a face names a vertex, normal or texture coordinate that does not exist"
    if "f' line" in message:
        return "this face cannot be read: an index is 0, too large, or reaches before the first vertex"
    return message.strip().splitlines()[0] if message.strip() else "the file cannot be read"


def decoded(data: bytes) -> str:
    """Text of unknown encoding: UTF-8, else Latin-1, printable."""
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    return "".join(c if c.isprintable() else " " for c in text)
