"""What every rule of a scene's conversion needs: the tree, its ids, its defaults, the files, the journal."""

import re
from dataclasses import dataclass, field
from pathlib import Path

from .paths import Files
from .records import ConversionError, Journal
from .xmlfile import Node


@dataclass
class Context:
    """One scene on its way."""

    root: Node
    files: Files
    journal: Journal
    defaults: dict[str, str] = field(default_factory=dict)

    def target(self, node: Node) -> Node | None:
        """What a reference stands for; the node itself if it is none; None where there is no such object."""
        for _ in range(100):
            if node is None or node.tag != "ref":
                return node
            wanted = self._real(node.get("id", ""))
            node = next((n for n in self.root.all() if n.get("id") == wanted and n.tag not in ("ref", "alias")), None)
        return None

    def _real(self, name: str) -> str:
        """An id without its aliases."""
        aliases = {n.get("as"): n.get("id") for n in self.root.all() if n.tag == "alias"}
        for _ in range(len(aliases)):
            name = aliases.get(name, name)
        return name

    def dereference(self, node: Node) -> Node:
        """The node itself, or, of a reference, a copy of what it stands for."""
        found = self.target(node)
        if found is None:
            raise ConversionError(f"{node.file}, line {node.line}: there is no object with the id '{node.get('id')}'")
        if found is node:
            return node
        made = found.clone()
        for inner in made.all():
            inner.attrib.pop("id", None)
        if node.name:
            made.set("name", node.name)
        else:
            made.attrib.pop("name", None)
        return made

    def substituted(self, text: str) -> str:
        """`text` with each $name replaced by its default, where it has one."""
        return re.sub(r"\$(\w+)", lambda m: self.defaults.get(m[1], m[0]), text)

    def filename(self, node: Node) -> Path | None:
        """The file that a property names, None where it depends on a parameter without default."""
        attribute = "filename" if node.tag in ("spectrum", "include") else "value"
        text = self.substituted(node.get(attribute, ""))
        return None if "$" in text else self.files.find(text, node.folder, node.place)
