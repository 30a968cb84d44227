"""What is wrong with a scene, as one sentence that names the file and the line where Mitsuba knows them."""

import re
import shlex
from pathlib import Path

import mitsuba as mi

from . import needs


class SceneError(ValueError):
    """A scene that cannot be loaded or rendered as asked."""


def sentence(error: BaseException, path: Path) -> str:
    """One sentence for an error of Mitsuba: where, and what, without its C++ and Python frames."""
    while error.__cause__ is not None:
        error = error.__cause__
    if isinstance(error, KeyboardInterrupt):
        raise error
    text = str(error)
    # The innermost place named is that of the mistake: in an included file, not where that is included.
    places = re.findall(r'(?:At|loading|file) "?([^"\n]+?)"? ?\(line (\d+)(?:, col \d+)?\)', text)
    lines = re.findall(r"\(line (\d+)(?:, col \d+)?\)", text)
    file, line = places[-1] if places else (str(path), lines[-1] if lines else None)
    if "Traceback (most recent call last)" in text:
        text = re.sub(r"^\w+(Error|Exception): ", "", text.rstrip().rsplit("\n", 1)[-1])
    text = re.sub(r"\[[\w.]+:\d+\] ", "", text)
    text = re.sub(r"^.*\(line \d+, col \d+\): ", "", text, flags=re.DOTALL)
    text = re.sub(r'^Parsing of XML file ".*?" failed: |^Error while loading( XML file)? ".*?": ', "", text)
    text = re.sub(r" ?\(line \d+, col \d+\)$", "", text)
    text = re.sub(r"^Found unused parameters:\s*- \$", "the scene has no <default> for ", text)
    text = re.sub(r"\s*\n\s*-?\s*", " ", text).strip()
    said = f"{file}, line {line}: {text}" if line else f"{file}: {text}"
    return said + f". To make an old scene load: phong-bsdf convert {shlex.quote(str(path))} -o new.xml" * _is_old(path)


def _is_old(path: Path) -> bool:
    """Whether the scene says that it is of Mitsuba 0.x."""
    beginning = Path(path).read_bytes()[:4096] if Path(path).is_file() else b""
    return re.search(rb"""<scene\s[^>]*version=["']0\.""", beginning) is not None


def located(error: needs.UnsupportedScene, path: Path, state: "mi.parser.ParserState") -> str:
    """`error` with the line of the emitter that it is about; the loaded scene no longer knows it."""
    for node in state.nodes:
        name = node.props.plugin_name()
        if node.type == mi.ObjectType.Emitter and name not in {**needs.LIGHTS, **needs.BACKGROUNDS}:
            location = mi.parser.file_location(state, node)
            return sentence(RuntimeError(f"At {location}: {needs.refusal(name)}"), path)
    return f"{path}: {error}"
