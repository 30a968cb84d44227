"""XML files of scenes: read without any risk, and written.

The parser is the standard library's expat. Entities, and with them entity bombs and external files, can only be
declared in a document type: so any document type is refused, and there is nothing left to defend against.
"""

import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any
from xml.parsers import expat

from .records import ConversionError

# Scenes are about ten levels deep. Beyond this, somebody wants to see the stack overflow.
DEEPEST = 100

# As Mitsuba.
DEEPEST_INCLUDE = 15


class Node(ET.Element):
    """An XML element that knows where it was read."""

    folder = Path()
    file = ""
    line = 0
    final = False
    """Whether the file name that it holds is one of the new scene's."""

    @property
    def place(self) -> tuple[str, int]:
        """File name and line."""
        return self.file, self.line

    def error(self, message: str) -> ConversionError:
        """An error that is about this element."""
        return ConversionError(f"{self.file}, line {self.line}: {message}")

    @property
    def name(self) -> str:
        """The `name` attribute."""
        return self.get("name", "")

    @property
    def type(self) -> str:
        """The `type` attribute: the plugin."""
        return self.get("type", "")

    @property
    def nodes(self) -> list["Node"]:
        """The elements inside, without comments."""
        return [child for child in self if isinstance(child, Node)]

    def all(self) -> list["Node"]:
        """This element and all elements below it, each before those inside of it."""
        return [node for node in self.iter() if isinstance(node, Node)]

    def find_named(self, *names: str) -> "Node | None":
        """The first element inside that is called one of `names`."""
        return next((child for child in self.nodes if child.name in names), None)

    def take(self, *names: str) -> "Node | None":
        """Remove, and give, the first element inside that is called one of `names`."""
        found = self.find_named(*names)
        if found is not None:
            self.remove(found)
        return found

    def add(self, tag: str, /, **attributes: str) -> "Node":
        """A new last element inside, in the same place of the file."""
        node = self.like(tag, **attributes)
        self.append(node)
        return node

    def like(self, tag: str, /, **attributes: str) -> "Node":
        """A new element that comes from the same place of the file."""
        node = Node(tag, attributes)
        node.folder, node.file, node.line = self.folder, self.file, self.line
        return node

    def clone(self) -> "Node":
        """A deep copy, without comments."""
        made = self.like(self.tag, **self.attrib)
        made.final = self.final
        made[:] = [child.clone() for child in self.nodes]
        return made

    def become(self, other: "Node") -> None:
        """Turn into a copy of another element, but for what this one is called and its id."""
        kept = {key: self.attrib[key] for key in ("name", "id") if key in self.attrib}
        children = [child.clone() for child in other.nodes]
        self.tag, self.attrib = other.tag, {**other.attrib, **kept}
        for key in ("name", "id"):
            if key not in kept:
                self.attrib.pop(key, None)
        self[:] = children
        for node in self.all()[1:]:
            node.attrib.pop("id", None)

    def replace(self, old: "Node", new: "Node") -> None:
        """Put one element in another's place."""
        self[list(self).index(old)] = new


def read(path: Path, *, comments: bool = True) -> Node:
    """The root element of the XML file `path`, each element with its file and line.

    Without `comments` they may hold anything, as Mitsuba's parser has it, also the `--` that XML forbids.
    """
    parser = expat.ParserCreate()
    builder: Any = ET.TreeBuilder(element_factory=Node, insert_comments=True)
    depth = 0

    def start(tag, attributes):
        nonlocal depth
        depth += 1
        if depth > DEEPEST:
            raise ConversionError(f"{path}, line {parser.CurrentLineNumber}: nested more than {DEEPEST} levels deep")
        node = builder.start(tag, attributes)
        node.folder, node.file, node.line = path.parent, path.name, parser.CurrentLineNumber

    def end(tag):
        nonlocal depth
        depth -= 1
        builder.end(tag)

    def comment(text):
        if depth:  # outside of the root there is no place for it in the tree
            builder.comment(text)

    def refuse(*_):
        raise ConversionError(
            f"{path}, line {parser.CurrentLineNumber}: a document type (<!DOCTYPE ...>) can name other files and "
            "grow without bound, so it is refused; scenes need none. Delete it"
        )

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CommentHandler, parser.StartDoctypeDeclHandler = comment, refuse
    try:
        content = path.read_bytes()
        if not comments:
            content = re.sub(rb"<!--.*?-->", lambda found: b"\n" * found[0].count(b"\n"), content, flags=re.DOTALL)
        parser.Parse(content, True)
    except expat.ExpatError as error:
        raise ConversionError(f"{path}, line {error.lineno}: no XML: {expat.errors.messages[error.code]}") from None
    except (LookupError, ValueError) as error:
        if isinstance(error, ConversionError):
            raise
        raise ConversionError(f"{path}: no XML: {error}") from None
    return builder.close()


def to_text(root: ET.Element, header: str) -> str:
    """The XML text of a scene, indented, with a comment at its top."""
    ET.indent(root, "    ")
    body = ET.tostring(root, encoding="unicode", short_empty_elements=True).replace(" />", "/>")
    return f"<!--\n{header}\n-->\n{body}\n"
