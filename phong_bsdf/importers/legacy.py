"""Scenes of Mitsuba 0.2 to 0.6 -> a scene that Mitsuba 3 loads, and what was done to it."""

import os
import re
from collections.abc import Callable
from pathlib import Path

from ..pictures import images
from ..tracing.needs import ANALYTIC, ROBUST
from . import bsdfs, catalogue, plugins, textures, transforms, values, xmlfile
from .context import Context
from .paths import Files, check_output
from .records import Conversion, ConversionError, Journal, header
from .upgrade import upgrade, version_of
from .xmlfile import Node

VERSION = "3.0.0"
MOST_INCLUSIONS = 1000

TRANSFORMS = ("lookAt", "lookat", "translate", "rotate", "scale", "matrix")


def convert_scene(
    path: Path,
    output: Path,
    *,
    root: Path | None = None,
    on_progress: Callable[[str, float], None] = lambda what, share: None,
) -> Conversion:
    """Convert the Mitsuba 0.x scene `path` and write it to `output`, an XML file.

    Files that the scene names are looked for beside it, and only below the folder `root`
    (default: that of the scene); they stay where they are, but for images that Mitsuba 3
    would read otherwise, which are copied into a folder beside `output`. `on_progress` hears what is
    done, and the share of it, 0 to 1. Raises `ConversionError`; nothing is written then.
    """
    path, output = Path(path), Path(output)
    check_output(path, output)
    files, journal = Files(path, output, root), Journal()
    with files.all_or_none():
        on_progress("reading", 0)
        tree = xmlfile.read(path)
        version = _version(tree, path, journal)
        context = Context(tree, files, journal)
        _inline(tree, context, [path.resolve()])
        context.learn_ids()
        _learn_files(context)
        files.spare()
        on_progress("converting", 0.3)
        upgrade(tree, version, journal)
        for rewrite in PASSES:
            rewrite(context)
        on_progress("writing", 0.9)
        tree.attrib = {"version": VERSION}
        images.replace_file(
            output, xmlfile.to_text(tree, header(f"'{path.name}' of Mitsuba {version[0]}.{version[1]}", journal))
        )
    return Conversion(output, (output, *files.written), journal.records())


def _version(tree: Node, path: Path, journal: Journal) -> tuple[int, ...]:
    if tree.tag != "scene":
        raise ConversionError(f"{path}, line {tree.line}: the root element should be <scene>, not <{tree.tag}>")
    version = version_of(tree, journal)
    if version >= (2, 0, 0):
        raise ConversionError(f"{path}: this is a scene of Mitsuba {version[0]} already; render it as it is")
    return version


def _inline(node: Node, context: Context, open_files: list[Path]) -> None:
    """Put the content of included files in the place of each `<include>`, and learn the `<default>`s on the way."""
    for child in list(node.nodes):
        if child.tag == "default":
            context.defaults.setdefault(child.name, child.get("value", ""))
        elif child.tag == "include":
            path = context.filename(child)
            if path is None:
                raise child.error("which file is included depends on a parameter; write its name")
            if path in open_files or len(open_files) > xmlfile.DEEPEST_INCLUDE:
                raise child.error(f"'{child.get('filename')}' includes itself, or is included too deeply")
            if not path.is_file():
                raise child.error(f"there is no file '{child.get('filename')}'")
            context.inclusions += 1
            if context.inclusions > MOST_INCLUSIONS:
                raise child.error(f"more than {MOST_INCLUSIONS} files are included")
            included = xmlfile.read(path)
            _inline(included, context, [*open_files, path])
            parts = list(included) if included.tag == "scene" else [included]
            index = list(node).index(child)
            node[index : index + 1] = parts
            context.journal.change(child.place, f"<include> of '{child.get('filename')}'", "its content is now here")
        else:
            _inline(child, context, open_files)


def _learn_files(context: Context) -> None:
    """Look at all file names before a new file is written, which must not take the place of one of them."""
    for node in context.root.all():
        if _is_file(node):
            context.filename(node)


def _is_file(node: Node) -> bool:
    return (node.tag == "string" and node.name == "filename") or (node.tag == "spectrum" and "filename" in node.attrib)


def _names(context: Context) -> None:
    """camelCase -> snake_case, the spelling of Mitsuba 3."""
    changed = {}
    for node in context.root.all():
        name = node.name
        if node.tag in ("default", "alias") or not name:
            continue
        new = re.sub(r"(?<=[a-z])([A-Z]+)", lambda m: "_" + m[1].lower(), name)
        if new != name:
            changed[name] = new
            node.set("name", new)
    if changed:
        listed = ", ".join(f"{old} -> {new}" for old, new in sorted(changed.items()))
        context.journal.change((context.root.file, 0), "parameters in snake_case", listed)


def _transforms(context: Context) -> None:
    """`<lookAt>`; separators that Mitsuba 3 does not take."""
    for node in context.root.all():
        if node.tag == "lookAt":
            node.tag = "lookat"
            context.journal.change(node.place, "<lookAt> is now <lookat>", "the spelling of Mitsuba 3")
        if node.tag in TRANSFORMS:
            for key, text in node.attrib.items():
                if ";" in text:
                    node.set(key, text.replace(";", ","))
        if node.tag == "rotate":
            transforms.unit_axis(node, context)


def _filenames(context: Context) -> None:
    """Files that stay where they are, named as the new scene must name them."""
    for node in context.root.all():
        if not _is_file(node) or node.final:
            continue
        attribute = "value" if node.tag == "string" else "filename"
        path = context.filename(node)
        if path is None:
            context.journal.loss(
                node.place, f"file '{node.get(attribute)}'", "depends on a parameter; it is not checked"
            )
            continue
        if not path.is_file():
            context.journal.loss(node.place, f"file '{node.get(attribute)}'", "there is no such file")
        new = context.files.relative(path)
        if new != node.get(attribute):
            if os.path.normpath(node.get(attribute, "").replace("\\", "/")) != new:
                context.journal.change(node.place, f"file '{node.get(attribute)}'", f"seen from the new scene: '{new}'")
            node.set(attribute, new)


def _parameters(context: Context) -> None:
    """Parameters that Mitsuba 0.6 had from its command line."""
    for node in context.root.all():
        for name in re.findall(r"(?<!\\)\$(\w+)", " ".join(node.attrib.values())):
            if name not in context.defaults:
                context.journal.loss(node.place, f"${name}", f"has no <default>: add one, or render with -D {name}=...")


def _settings(context: Context) -> None:
    """An integrator where there is none; samples and size as `<default>`s, so that the command line can change them."""
    root = context.root
    if not any(node.tag == "integrator" for node in root.nodes):
        root.insert(0, root.like("integrator", type="direct"))
        context.journal.change(root.place, "no integrator", "now 'direct', as Mitsuba 0.6 chose it")
    if not all(node.type in ANALYTIC for node in root.all() if node.tag == "shape"):
        root.insert(0, root.like("boolean", name=ROBUST, value="true"))
    sensors = [node for node in root.all() if node.tag == "sensor"]
    if not sensors:
        why = "Mitsuba 0.6 would choose a camera, Mitsuba 3 does not; add a <sensor>"
        context.journal.loss((root.file, root.line), "no sensor", why)
    if len(sensors) != 1:
        return
    names = {"spp": ("sampler", "sample_count"), "width": ("film", "width"), "height": ("film", "height")}
    for default, (tag, name) in reversed(names.items()):
        node = next((n.find_named(name) for n in sensors[0].nodes if n.tag == tag), None)
        if node is None or "$" in node.get("value", "$") or default in context.defaults:
            continue
        root.insert(0, root.like("default", name=default, value=node.attrib["value"]))
        node.set("value", f"${default}")


# Each takes the Context. Names come first, what Mitsuba would refuse comes last.
PASSES = (
    _names,
    values.rewrite_colors,
    _transforms,
    textures.rewrite,
    bsdfs.rewrite,
    plugins.rewrite,
    catalogue.sift,
    _filenames,
    _parameters,
    _settings,
)
