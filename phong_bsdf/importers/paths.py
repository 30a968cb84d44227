"""Which files an input may name, and how the new scene names them.

A scene or a model is data from elsewhere. What it names is read only if it lies in one folder, the root: by
default the folder of the input. Absolute paths, addresses and links that lead out of it are refused.
"""

import contextlib
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from .records import ConversionError

LARGEST_NAME = 1024


class Files:
    """The files that one input names."""

    def __init__(self, source: Path, output: Path, root: Path | None = None):
        self.source, self.output = Path(source), Path(output)
        self.root = Path(root or self.source.parent).resolve()
        if not self.root.is_dir():
            raise ConversionError(f"{self.root}: the root must be a folder")
        if not self.source.resolve().is_relative_to(self.root):
            raise ConversionError(f"{self.source}: the input is not in the root folder '{self.root}'")
        self.written: list[Path] = []
        self._staging: Path | None = None
        self._named = {self.source.resolve()}

    def find(self, name: str, beside: Path, place) -> Path:
        """The file `name` of an input in the folder `beside`; it need not exist. Raises ConversionError where it
        would lie outside the root."""
        where = f"{place[0]}, line {place[1]}"
        text = name.strip().replace("\\", "/")
        if not text or len(text) > LARGEST_NAME or "\0" in text:
            raise ConversionError(f"{where}: {name[:60]!r} is no file name")
        if PurePosixPath(text).is_absolute() or re.match(r"[A-Za-z][A-Za-z0-9+.-]*:", text):
            raise ConversionError(
                f"{where}: '{name}' is an absolute path or an address; only files below '{self.root}' are read. "
                "Put the file there and name it relative to the input"
            )
        try:
            found = (Path(beside) / text).resolve()
        except (OSError, RuntimeError, ValueError) as error:
            raise ConversionError(f"{where}: '{name}' cannot be read: {error}") from None
        if not found.is_relative_to(self.root):
            raise ConversionError(
                f"{where}: '{name}' leads out of '{self.root}'. If that is right, name a folder that holds all files: "
                f"--root {os.path.commonpath([found, self.root])}"
            )
        self._named.add(found)
        return found

    def spare(self) -> None:
        """Raise ConversionError where the new scene would take the place of a file that the input names."""
        if self.output.resolve() in self._named:
            raise ConversionError(f"'{self.output}' is a file that the input names; choose another name")

    def relative(self, path: Path) -> str:
        """`path` as the new scene names it. (A bare $ would be a parameter.)"""
        if self._staging and path.parent == self._staging:
            path = self._folder.resolve() / path.name
        return Path(os.path.relpath(path, self.output.parent.resolve())).as_posix().replace("$", "\\$")

    def beside_output(self, stem: str, suffix: str) -> Path:
        """Where to write a file that will be in the folder `NAME_files` of the new scene `NAME.xml`.

        `stem` may be any text. Two calls never give the same file, and none gives a file that the input names.
        """
        clean = re.sub(r"[^\w.-]+", "-", stem).strip("-.")[:60] or "file"
        path, number = self._folder / f"{clean}{suffix}", 1
        while str(path).lower() in {str(p).lower() for p in self.written} or path.resolve() in self._named:
            number += 1
            path = self._folder / f"{clean}-{number}{suffix}"
        self.written.append(path)
        if self._staging is None:
            self._staging = Path(tempfile.mkdtemp(prefix=f".{self.output.stem}-", dir=self.output.parent)).resolve()
        return self._staging / path.name

    def written_as(self, name: str) -> Path:
        """Where a file is, until all are in their place, that the new scene names so."""
        path = self.output.parent / name
        return self._staging / path.name if self._staging and path in self.written else path

    @contextlib.contextmanager
    def all_or_none(self) -> Iterator[None]:
        """Inside, files are written elsewhere; without an error they come to their place, in that of older ones."""
        try:
            yield
            if self._staging:
                self._folder.mkdir(exist_ok=True)
            for path in self.written:
                os.replace(self._staging / path.name, path)
        finally:
            if self._staging:
                shutil.rmtree(self._staging, ignore_errors=True)

    @property
    def _folder(self) -> Path:
        return self.output.parent / f"{self.output.stem}_files"


def check_output(source: Path, output: Path) -> None:
    """Raise ConversionError where `output` would overwrite `source`, or is no XML file, or cannot be written."""
    if not source.is_file():
        raise ConversionError(f"{source}: {'this is a folder' if source.is_dir() else 'there is no such file'}")
    if output.suffix.lower() != ".xml":
        raise ConversionError(f"'{output}': the new scene must end in .xml")
    if output.is_dir():
        raise ConversionError(f"'{output}' is a folder")
    if not output.parent.is_dir():
        raise ConversionError(f"'{output}': there is no folder '{output.parent}'")
    if output.exists() and os.path.samefile(source, output):
        raise ConversionError(f"'{output}' is the input, which is never overwritten; choose another name")
