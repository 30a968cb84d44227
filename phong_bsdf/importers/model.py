"""OBJ models with MTL materials -> a scene that renders at once."""

import contextlib
import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..pictures import images
from ..reflection.vocabulary import VOCABULARIES
from ..tracing.needs import ROBUST
from . import meshes, mtl, objfile, xmlfile
from .legacy import VERSION
from .maps import Maps
from .materials import AMBIENT, Materials
from .objfile import Triangles
from .paths import Files, check_output
from .records import Conversion, ConversionError, Journal, header
from .xmlfile import Node

CAMERAS = ("auto", "none")
WIDTH, HEIGHT, SPP = 640, 480, 4
FOV, MARGIN = 45.0, 1.06
# Everything is in view in pictures of 16:9, and in all that are less wide.
LOWEST = 9 / 16

# From the model to the camera: from the front, a little from the right and from above.
VIEW = (0.45, 0.35, 1.0)
# Directions in which light flies, in the camera's (right, up, toward the model), and its strength.
KEY_LIGHT, FILL_LIGHT = ((0.6, -0.8, 1.0), 0.8), ((-1.0, -0.2, 0.6), 0.25)
BACKGROUND = 0.2


def convert_model(
    path: Path,
    output: Path,
    *,
    vocabulary: str = "coefficients",
    camera: str = "auto",
    root: Path | None = None,
    on_progress: Callable[[str, float], None] = lambda what, share: None,
) -> Conversion:
    """Convert the OBJ model `path`, with its MTL files, and write a scene to `output`, an XML file.

    Its meshes and changed images go into a folder beside `output`. `vocabulary` says in which
    terms highlights are written (`coefficients`, the lecture's, or `reflectances`), `camera` whether the
    scene gets a camera that sees all of it (`auto` or `none`), `root` below which folder files are read
    (default: that of the model). `on_progress` hears what is done, and the share of it, 0 to 1. Raises
    `ConversionError`, also where tinyobjloader (`phong-bsdf[import]`) is missing; nothing is written then.
    """
    path, output = Path(path), Path(output)
    check_output(path, output)
    if vocabulary not in VOCABULARIES:
        raise ConversionError(f"the vocabulary must be one of {', '.join(VOCABULARIES)}, got '{vocabulary}'")
    if camera not in CAMERAS:
        raise ConversionError(f"the camera must be one of {', '.join(CAMERAS)}, got '{camera}'")
    files, journal = Files(path, output, root), Journal()
    with files.all_or_none():
        on_progress("reading", 0)
        triangles = objfile.read(path, journal, lambda share: on_progress("reading", share / 2))
        if not len(triangles.v):
            raise ConversionError(f"{path}: there are no faces in this file")
        on_progress("materials", 0.5)
        scene = _scene(path, triangles, vocabulary, camera, files, journal, on_progress)
        images.replace_file(output, xmlfile.to_text(scene, header(f"'{path.name}'", journal)))
    return Conversion(output, (output, *files.written), journal.records())


def _scene(path: Path, triangles: Triangles, vocabulary: str, camera: str, files: Files, journal: Journal, on_progress):
    """The new scene's root element; its meshes and images are written."""
    library = _library(path, triangles, files, journal)
    materials = Materials(vocabulary, Maps(files, journal), journal)
    scene = Node("scene", {"version": VERSION})
    scene.folder, scene.file = path.parent, path.name
    parts = _parts(scene, triangles, library, materials, files, journal, on_progress)
    _settings(scene, vocabulary, materials.glows)
    if camera == "auto":
        _camera(scene, triangles.positions[np.unique(triangles.v)])
    _lights(scene, math.pi if vocabulary == "reflectances" else 1.0)
    scene.extend(parts)
    return scene


def _library(path: Path, triangles: Triangles, files: Files, journal: Journal) -> dict[str, mtl.Material]:
    """All materials that the model's `mtllib` lines name; where two have the same name the first counts."""
    found: dict[str, mtl.Material] = {}
    for text, line in triangles.libraries:
        place = (path.name, line)
        # The specification has several names on a line; many programs write one, with spaces.
        whole = _find(text, path, place, files)
        words = [text] if isinstance(whole, Path) and whole.is_file() else text.split()
        for library in (_find(word, path, place, files) for word in words):
            if isinstance(library, ConversionError):
                journal.loss(place, "a material library", library.reason)
                continue
            if not library.is_file():
                journal.loss(place, f"material library '{library.name}'", "there is no such file")
                continue
            for name, material in mtl.read(library, journal).items():
                found.setdefault(name, material)
    for material in found.values():
        # Known before a new file is written, which must not take the place of one of them.
        for texture in material.maps.values():
            with contextlib.suppress(ConversionError):
                files.find(texture.file, material.library.parent, material.place())
    return found


def _find(name: str, path: Path, place, files: Files) -> Path | ConversionError:
    """The file that a model names, or why it is not read."""
    try:
        return files.find(name, path.parent, place)
    except ConversionError as error:
        return error


def _parts(
    scene: Node, triangles: Triangles, library, materials: Materials, files: Files, journal: Journal, on_progress
):
    """The BSDFs in use, and a shape for each."""
    bsdfs, shapes, names = [], [], set()
    count = len(np.unique(triangles.material))
    for index, mesh in meshes.split(triangles):
        title, line = triangles.materials[index] if index >= 0 else ("default", 0)
        name = _identifier(title, names)
        scene.line = line
        material = library.get(title) if index >= 0 else None
        if material is None:
            if index >= 0:
                journal.loss(
                    (scene.file, line), f"material '{title}'", "no MTL file defines it; now a grey diffuse surface"
                )
            bsdfs.append(materials.default(scene, name))
        else:
            bsdfs.append(materials.bsdf(material, scene, name))
        ply = files.beside_output(name, ".ply")
        meshes.write_ply(ply, mesh)
        shape = scene.like("shape", type="ply")
        shape.add("string", name="filename", value=files.relative(ply.resolve()))
        if mesh.normals is None:
            shape.add("boolean", name="face_normals", value="true")
        shape.add("ref", id=name)
        shapes.append(shape)
        on_progress("writing", 0.5 + 0.5 * len(shapes) / count)
    return bsdfs + shapes


def _identifier(title: str, taken: set[str]) -> str:
    """A name for a material that Mitsuba, XML and the parameter paths of `mitsuba.traverse` can live with."""
    stem = re.sub(r"[^\w -]", "_", title).strip()[:60] or "unnamed"
    name, number = stem, 1
    while name.lower() in taken:
        number += 1
        name = f"{stem}-{number}"
    taken.add(name.lower())
    return name


def _settings(scene: Node, vocabulary: str, glows: bool) -> None:
    """Integrator and defaults, first in the file."""
    scene.line = 0
    for name, value in (("spp", SPP), ("width", WIDTH), ("height", HEIGHT), ("max_depth", 10)):
        scene.add("default", name=name, value=str(value))
    scene.add("boolean", name=ROBUST, value="true")
    integrator = scene.add("integrator", type="whitted")
    integrator.add("integer", name="max_depth", value="$max_depth")
    if vocabulary == "reflectances":
        integrator.add("string", name="convention", value="physical")
    if glows:
        # Not a <default>: the constant colours hang on this number.
        integrator.add("float", name="ambient", value=f"{AMBIENT:g}")


def _camera(scene: Node, points: np.ndarray) -> None:
    """A camera that sees all points."""
    centre = (points.min(axis=0).astype(float) + points.max(axis=0)) / 2
    x, y, z = ((points - centre) @ _camera_frame().T).T
    slope = math.tan(math.radians(FOV / 2)) / MARGIN
    radius = float(np.linalg.norm(points - centre, axis=1).max()) or 1.0
    distance = max(float((np.maximum(np.abs(x), np.abs(y) / LOWEST) / slope - z).max()), 1.01 * radius)
    eye = centre + distance * np.array(VIEW) / np.linalg.norm(VIEW)
    sensor = scene.add("sensor", type="perspective")
    sensor.add("string", name="fov_axis", value="x")
    sensor.add("float", name="fov", value=f"{FOV:g}")
    for name, value in (("near_clip", (distance - radius) / 2), ("far_clip", (distance + radius) * 10)):
        sensor.add("float", name=name, value=f"{value:.7g}")
    transform = sensor.add("transform", name="to_world")
    transform.add("lookat", origin=_triple(eye), target=_triple(centre), up="0, 1, 0")
    sampler = sensor.add("sampler", type="independent")
    sampler.add("integer", name="sample_count", value="$spp")
    film = sensor.add("film", type="hdrfilm")
    film.add("integer", name="width", value="$width")
    film.add("integer", name="height", value="$height")
    film.add("string", name="pixel_format", value="rgb")
    film.add("rfilter", type="box")


def _lights(scene: Node, unit: float) -> None:
    """One light over the camera's left shoulder, a faint one from its right, and a grey background for the mirrors."""
    frame = _camera_frame()
    for direction, strength in (KEY_LIGHT, FILL_LIGHT):
        light = scene.add("emitter", type="directional")
        x, y, z = np.array(direction) @ frame
        light.add("vector", name="direction", x=f"{x:.6g}", y=f"{y:.6g}", z=f"{z:.6g}")
        light.add("rgb", name="irradiance", value=f"{strength * unit:.7g}")
    light = scene.add("emitter", type="constant")
    light.add("rgb", name="radiance", value=f"{BACKGROUND:g}")


def _camera_frame() -> np.ndarray:
    """The camera's unit vectors as rows: right, up, toward the model."""
    toward = -np.array(VIEW) / np.linalg.norm(VIEW)
    right = np.cross(toward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(right, toward), toward])


def _triple(v) -> str:
    return ", ".join(f"{x:.7g}" for x in v)
