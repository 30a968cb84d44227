"""What every rule of a scene's conversion needs: the tree, its ids, its defaults, the files, the journal."""

import re
from dataclasses import dataclass, field
from pathlib import Path

from .paths import Files
from .records import Journal
from .xmlfile import Node

# Elements. References to references that are copied grow like an entity bomb.
MOST_COPIES = 200_000


@dataclass
class Context:
    """One scene on its way."""

    root: Node
    files: Files
    journal: Journal
    defaults: dict[str, str] = field(default_factory=dict)
    inclusions: int = 0
    """How many files were included so far."""
    ids: dict[str, Node] = field(default_factory=dict)
    aliases: dict[str, str] = field(default_factory=dict)
    copied: int = 0
    """How many elements were copied in the place of references so far."""

    def learn_ids(self) -> None:
        """Look at all ids and aliases. Rules change elements in place, so that once is enough."""
        for node in self.root.all():
            if node.tag == "alias":
                self.aliases[node.get("as", "")] = node.get("id", "")
            elif node.tag != "ref" and "id" in node.attrib:
                self.ids.setdefault(node.attrib["id"], node)

    def inner_first(self) -> list[Node]:
        """All elements, each after those inside of it and those that it refers to: a copy of one is a finished one."""
        order, seen, stack = [], set(), [(self.root, False)]
        while stack:
            node, done = stack.pop()
            if done:
                order.append(node)
            elif node not in seen:
                seen.add(node)
                stack.append((node, True))
                # Of a reference that leads nowhere there is nothing to be done first.
                stack += [(what, False) for child in reversed(node.nodes) if (what := self.target(child)) is not None]
        return order

    def target(self, node: Node) -> Node | None:
        """What a reference stands for; the node itself if it is none; None where there is no such object."""
        seen, found = set(), node
        while found is not None and found.tag == "ref":
            name = found.get("id", "")
            while name in self.aliases and name not in seen:
                seen.add(name)
                name = self.aliases[name]
            if id(found) in seen:
                return None
            seen.add(id(found))
            found = self.ids.get(name)
        return found

    def dereference(self, node: Node) -> Node:
        """The node itself, or, of a reference, a copy of what it stands for."""
        found = self.target(node)
        if found is None:
            raise node.error(f"there is no object with the id '{node.get('id')}'")
        if found is node:
            return node
        made = found.clone()
        for inner in made.all():
            inner.attrib.pop("id", None)
            self.copied += 1
        if self.copied > MOST_COPIES:
            raise node.error("the references of this scene grow without bound")
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
