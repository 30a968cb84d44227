"""A scene file with every file it names, as bytes under the hashes of their contents: what travels to other machines.

Each name in the XML becomes the hash of the file it names, from the innermost include outwards. So the name of the
main file stands for the whole scene: two scenes with one name are the same to the last bit of the last mesh.
"""

import hashlib
import os
import re
import stat
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.sax.saxutils import quoteattr

from ..importers import xmlfile
from ..importers.xmlfile import Node
from ..pictures import images

NAME = re.compile(r"[0-9a-f]{64}(\.[A-Za-z0-9]{1,16})?")


class BundleError(ValueError):
    """A scene that cannot be packed, or a bundle that cannot be trusted."""


@dataclass(frozen=True)
class Bundle:
    """A packed scene. Defines are put in: it has none."""

    main: str
    """The file name of the scene itself, hence its hash."""
    texts: Mapping[str, bytes] = field(repr=False)
    """File name -> XML: the scene and what it includes."""
    files: Mapping[str, bytes] = field(repr=False)
    """File name -> content: meshes, images, spectra."""
    sources: Mapping[str, str]
    """File name -> what it was called, for messages."""

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return sum(map(len, [*self.texts.values(), *self.files.values()]))

    def named(self, message: str, folder: Path) -> str:
        """`message` with the names that the user knows, where it has those of the files unpacked into `folder`."""
        for name, source in self.sources.items():
            message = message.replace(str(Path(folder) / name), source).replace(name, source)
        return message


def pack(
    path: Path,
    defines: Mapping[str, str] | None = None,
    root: Path | None = None,
    contents: dict[Path, tuple[str, bytes]] | None = None,
) -> Bundle:
    """The bundle of a scene file, `defines` put in for its `<default>`s.

    Files are packed that lie in the folder `root` (default: the scene's), by whatever path the scene names them.
    BundleError where one does not exist, or lies elsewhere. `contents`, shared between calls, has each file read once.
    """
    packer = _Packer(
        Path(path), Path(root or Path(path).parent), dict(defines or {}), {} if contents is None else contents
    )
    main = packer.add_scene(Path(path), ())
    return Bundle(main, packer.texts, packer.files, packer.sources)


def unpack(bundle: Bundle, folder: Path) -> Path:
    """Write the files of a bundle into `folder`, where they are not there yet; the path of the scene.

    BundleError, and nothing is written, where a name is not the hash of what it names.
    """
    folder = Path(folder)
    everything = {**bundle.files, **bundle.texts}
    for name, content in everything.items():
        if not NAME.fullmatch(name):
            raise BundleError(
                f"the bundle holds a file {name!r}: names must be hashes, so it was not made by this package"
            )
        if _digest(content) != name[:64]:
            raise BundleError(f"the bundle holds a file '{name}' whose content has another hash: it was damaged")
    if bundle.main not in bundle.texts:
        raise BundleError("the bundle does not hold its own scene")
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in everything.items():
        if not _holds(folder / name, content):
            images.replace_file(folder / name, content)
    return folder / bundle.main


def _holds(path: Path, content: bytes) -> bool:
    return not path.is_symlink() and path.is_file() and path.read_bytes() == content


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _hashed(content: bytes, suffix: str) -> str:
    """The name of a file in a bundle."""
    name = _digest(content)
    return name + suffix if NAME.fullmatch(name + suffix) else name


@dataclass
class _Packer:
    scene: Path
    root: Path
    parameters: dict[str, str]
    contents: dict[Path, tuple[str, bytes]]
    texts: dict[str, bytes] = field(default_factory=dict)
    files: dict[str, bytes] = field(default_factory=dict)
    sources: dict[str, str] = field(default_factory=dict)

    def __post_init__(self):
        self.root = self.root.resolve()
        if not self.root.is_dir():
            raise BundleError(f"'{self.root}': the root must be a folder")

    def add_scene(self, path: Path, outer: Sequence[Path]) -> str:
        """The name of an XML file once it is packed. `outer`: the folders that Mitsuba searches for what it names."""
        if len(outer) > xmlfile.DEEPEST_INCLUDE:
            raise BundleError(f"'{path}': files include each other more than {xmlfile.DEEPEST_INCLUDE} deep")
        tree = xmlfile.read(path, comments=False)
        folders = [path.parent, *outer]
        for node in tree.all():
            for key, value in node.attrib.items():
                node.set(key, self._substituted(value, node))
            if node.tag == "default":
                self.parameters.setdefault(node.name, node.get("value", ""))
            elif node.tag == "path":
                folders.insert(0, self._folder(node.get("value", ""), folders))
            elif node.tag == "include" and "filename" in node.attrib:
                file = self._find(node.get("filename", ""), folders, node)
                node.set("filename", self.add_scene(file, folders))
            elif node.tag == "spectrum" and "filename" in node.attrib:
                node.set("filename", self._add_file(node.get("filename", ""), folders, node))
            elif node.tag == "string" and node.name == "filename":
                # The files of plugins are searched for beside the scene, wherever an include names them.
                node.set("value", self._add_file(node.get("value", ""), [self.scene.parent], node))
        text = _text(tree)
        name = _hashed(text, ".xml")
        self.texts[name] = text
        self.sources.setdefault(name, str(path))
        return name

    def _add_file(self, name: str, folders: Sequence[Path], node: Node) -> str:
        path = self._find(name, folders, node)
        if path not in self.contents:
            try:
                content = path.read_bytes()
            except OSError as error:
                raise BundleError(f"{_place(node)}: '{name}' cannot be read: {error.strerror}") from None
            self.contents[path] = _hashed(content, path.suffix), content
        packed, content = self.contents[path]
        self.files[packed] = content
        self.sources.setdefault(packed, name)
        return packed

    def _find(self, name: str, folders: Sequence[Path], node: Node) -> Path:
        """The file that Mitsuba would take; BundleError where there is none, or it is not below the root."""
        candidates = [Path(os.path.join(folder, name)) for folder in (*folders, Path.cwd())]
        found = next((path for path in candidates if name and "\0" not in name and os.path.exists(path)), None)
        if found is None:
            raise BundleError(f"{_place(node)}: there is no file '{name}' beside '{self.scene}'")
        real = found.resolve()
        if not real.is_relative_to(self.root):
            common = os.path.commonpath([real, self.root])
            raise BundleError(
                f"{_place(node)}: '{name}' lies outside of '{self.root}', and only what is inside is sent to other "
                f"machines. If that is right, name a folder that holds all: --root {common}"
            )
        if not stat.S_ISREG(real.stat().st_mode):
            raise BundleError(f"{_place(node)}: '{name}' is no file")
        return real

    @staticmethod
    def _folder(name: str, folders: Sequence[Path]) -> Path:
        found = (Path(os.path.join(folder, name)) for folder in (*folders, Path.cwd()))
        return next((folder for folder in found if folder.exists()), Path(name))

    def _substituted(self, value: str, node: Node) -> str:
        """As Mitsuba does it: long names before short ones, and \\$ is a dollar."""
        for name in sorted(self.parameters, key=len, reverse=True):
            value = re.sub(rf"(?<!\\)\${re.escape(name)}", lambda _, name=name: self.parameters[name], value)
        if unknown := re.search(r"(?<!\\)\$(\w*)", value):
            raise BundleError(f"{_place(node)}: there is no <default> for ${unknown[1]}")
        return value.replace("\\$", "$")


def _place(node: Node) -> str:
    return f"{node.folder / node.file}, line {node.line}"


def _text(root: Node) -> bytes:
    """XML with each element in the line where it was read, so that messages name the right one.

    Without what is not needed any more: comments, defaults, search paths.
    """
    return "".join(_lines(root, [1])).encode()


def _lines(node: Node, line: list[int]) -> Iterator[str]:
    if node.tag in ("default", "path"):
        return
    yield "\n" * (node.line - line[0])
    line[0] = max(line[0], node.line)
    # A dollar that is still there is one.
    attributes = "".join(f" {key}={quoteattr(value)}".replace("$", "\\$") for key, value in node.attrib.items())
    yield f"<{node.tag}{attributes}>"
    for child in node.nodes:
        yield from _lines(child, line)
    yield f"</{node.tag}>"
