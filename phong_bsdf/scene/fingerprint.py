"""What pictures depend on, in a few digits: the scene with every file that it names, and the versions.

Two machines, and a scene and its copy elsewhere, have the same fingerprint.
"""

import hashlib
import json
import os
from collections.abc import Callable, Iterator
from importlib import metadata
from pathlib import Path

import mitsuba as mi
import numpy as np

from .. import __version__
from . import rendering

# Said beside the scene: how many samples, how large a picture.
LEFT_OUT = {mi.ObjectType.Sampler: {"sample_count"}, mi.ObjectType.Film: {"width", "height"}}

LENGTH = 16


def versions() -> str:
    """All software that a picture depends on."""
    return f"phong_bsdf {__version__}, Mitsuba {mi.__version__}, Dr.Jit {metadata.version('drjit')}"


def scene_hash(path: Path, state, hashed: Callable[[Path], str] | None = None) -> str:
    """A hash of all that a parsed scene says, its defines put in, and of the content of every file that it names.

    Ids, numbers of samples and sizes of films are left out, and so are the names of files. `state`
    comes from `rendering.parse(path, merge=False)`. ValueError where a file cannot be read. `hashed`: `file_hash`,
    or what remembers its results.
    """
    hashed = hashed or file_hash
    files = {(index, key): hashed(file) for index, key, file in named_files(path, state)}
    lines = []
    for index, node in enumerate(state.nodes):
        said = sorted(set(node.props.keys()) - LEFT_OUT.get(node.type, set()))
        values = [[key, files.get((index, key)) or _text(node.props, key)] for key in said]
        lines.append([str(node.type), node.props.plugin_name(), values])
    return digest(lines, LENGTH)


def named_files(path: Path, state) -> Iterator[tuple[int, str, Path]]:
    """(index of the node, its parameter, file) for every file that a parsed scene names and that exists."""
    with rendering.files_beside(path):
        resolver = mi.file_resolver()  # pyright: ignore[reportCallIssue]  (not in Mitsuba's stubs)
        for index, node in enumerate(state.nodes):
            for key in node.props.keys():  # noqa: SIM118
                if "file" in key and node.props.type(key) == mi.Properties.Type.String:
                    found = str(resolver.resolve(node.props[key]))
                    # Not `Path.is_file`, which raises for names that are too long.
                    if os.path.isfile(found):
                        yield index, key, Path(found)


def digest(value: object, length: int = 12) -> str:
    """A short hash of what JSON can hold."""
    text = value if isinstance(value, str) else json.dumps(value, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:length]


def file_hash(path: Path) -> str:
    """SHA-256 of a file's content, all 64 digits."""
    total = hashlib.sha256()
    try:
        with open(path, "rb") as file:
            while block := file.read(2**20):
                total.update(block)
    except OSError as error:
        raise ValueError(f"'{path}' cannot be read: {error.strerror}") from None
    return total.hexdigest()


def _text(props, key: str) -> str:
    """A parameter's value, exactly; of transforms 12 digits, since sines differ in the last ones between machines."""
    value, kinds = props[key], mi.Properties.Type
    kind = props.type(key)
    if kind == kinds.Transform:
        matrix = np.array(value.matrix, np.float64)
        matrix[np.abs(matrix) < 1e-14 * np.abs(matrix).max()] = 0
        return " ".join(f"{x:.12g}" for x in matrix.ravel())
    if kind == kinds.ResolvedReference:
        return str(value.index())
    if kind == kinds.Spectrum:  # pyright: ignore[reportAttributeAccessIssue]  (not in Mitsuba's stubs)
        return str([value.wavelengths, value.values])
    if kind in (kinds.Vector, kinds.Color):
        return str(np.array(value, np.float64).tolist())
    return repr(value)
