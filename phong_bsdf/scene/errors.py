"""What is wrong with a scene, as one sentence that names the file and the line where Mitsuba knows them.

Where Mitsuba does not know a name, plain words say which one was meant.
"""

import difflib
import re
import shlex
from collections.abc import Mapping
from pathlib import Path

import mitsuba as mi

from ..host.registry import PLUGINS as OURS
from ..tracing import needs


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
    text = re.sub(r"\s*\n\s*-?\s*", " ", _reworded(text)).strip()
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


# Names that Mitsuba does not know ---------------------------------------------------------------------


def _reworded(text: str) -> str:
    """The error with its part about an unknown plugin or parameter, one that is given twice, or a -D, put plainly."""
    text = re.sub(r'failed to instantiate (\w+) plugin of type "([^"]*)": .*Plugin "\2" not found!', _plugin, text)
    text = re.sub(r'could not parse floating point value "([^"]*)"', _number, text)
    text = re.sub(r"Found unused parameters:(.*)", _defines, text, flags=re.DOTALL)
    unread = r'Found \d+ unreferenced propert(?:y|ies) in (\w+) plugin of type "([^"]*)":(.*)'
    return re.sub(unread, _parameters, text, flags=re.DOTALL)


def _catalogue(kind: str) -> Mapping[str, str]:
    """The plugins of a kind, and their parameters."""
    # Late: the importers take longer to import than most scenes to parse, and most scenes have no mistake.
    from ..importers.catalogue import PLUGINS

    return PLUGINS.get(kind, {})


def _plugin(error: re.Match) -> str:
    kind, name = error.groups()
    return f"there is no {kind} '{name}'{_meant(name, _catalogue(kind))}"


def _number(error: re.Match) -> str:
    try:
        float(error[1].replace("_", "?"))
    except ValueError:
        return error[0]
    # Mitsuba says so whatever is wrong with a <float>. (1_0 is a number in Python only.)
    return f"the parameter of value {error[1]} has a name that stands there already"


def _defines(error: re.Match) -> str:
    given = ", ".join(re.findall(r"^\s*- \$(.*)$", error[1], re.M))
    return f'the scene has no <default> for {given}; add <default name="..." value="..."/>, and use it as $name'


def _parameters(error: re.Match) -> str:
    kind, plugin, listed = error.groups()
    known = _catalogue(kind).get(plugin, "").split()
    # What has no name in the scene is called _arg_0, _arg_1, ...
    objects = re.findall(r'^  - object "_arg_\d+": (\w+)', listed, re.M)
    if objects:
        return f"'{plugin}' takes no {objects[0]}"
    names = re.findall(r'^  - \S+ "(.+?)":', listed, re.M)
    meant = [_meant(name, known) for name in names]
    said = ", ".join(f"'{name}'{guess}" for name, guess in zip(names, meant, strict=True))
    # This package's plugins are known in full.
    rest = f"; it has {', '.join(known)}" if plugin in OURS and not all(meant) else ""
    return f"'{plugin}' has no parameter{'s' * (len(names) > 1)} {said}{rest}"


def _meant(name: str, known) -> str:
    """In brackets, the known name that is most like this one; nothing where none is."""
    near = difflib.get_close_matches(name.lower(), known, n=1)
    return f" (did you mean '{near[0]}'?)" if near else ""
