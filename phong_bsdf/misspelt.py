"""Errors of Mitsuba about names, in words that say which name was meant."""

import difflib
import re

from .importers.catalogue import PLUGINS
from .registry import PLUGINS as OURS


def reworded(text: str) -> str:
    """The error with its part about an unknown plugin or parameter, one that is given twice, or a -D, put plainly."""
    text = re.sub(r'failed to instantiate (\w+) plugin of type "([^"]*)": .*Plugin "\2" not found!', _plugin, text)
    text = re.sub(r'could not parse floating point value "([^"]*)"', _number, text)
    text = re.sub(r"Found unused parameters:(.*)", _defines, text, flags=re.DOTALL)
    unread = r'Found \d+ unreferenced propert(?:y|ies) in (\w+) plugin of type "([^"]*)":(.*)'
    return re.sub(unread, _parameters, text, flags=re.DOTALL)


def _plugin(error: re.Match) -> str:
    kind, name = error.groups()
    return f"there is no {kind} '{name}'{_meant(name, PLUGINS.get(kind, ()))}"


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
    known = PLUGINS.get(kind, {}).get(plugin, "").split()
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
