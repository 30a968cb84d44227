"""Scenes of Mitsuba 0.2 to 0.5 in the words of 0.6: every name that changed on the way."""

from .records import Journal
from .values import number, to_text
from .xmlfile import Node

# What 0.3 calls (tag, type) or, for any type, (tag, None).
TYPES_0_3 = {
    ("bsdf", "lambertian"): "diffuse",
    ("bsdf", "microfacet"): "roughplastic",
    ("bsdf", "roughmetal"): "roughconductor",
    ("bsdf", "roughglass"): "roughdielectric",
    ("bsdf", "composite"): "mixturebsdf",
    ("texture", "exrtexture"): "bitmap",
    ("texture", "ldrtexture"): "bitmap",
}
TYPES_0_4 = {
    ("film", "exrfilm"): "hdrfilm",
    ("film", "pngfilm"): "ldrfilm",
    ("integrator", "errctrl"): "adaptive",
    ("emitter", "background"): "constant",
}
TYPES_0_5 = {("bsdf", "bump"): "bumpmap"}

# (tag, type or None, name) -> name. Types are those after the renaming above.
NAMES_0_3 = {
    ("shape", "sphere", "inverted"): "flipNormals",
    ("shape", "cylinder", "p1"): "p0",
    ("shape", "cylinder", "p2"): "p1",
    ("texture", "checkerboard", "brightColor"): "color0",
    ("texture", "checkerboard", "darkColor"): "color1",
    ("texture", "gridtexture", "brightColor"): "color0",
    ("texture", "gridtexture", "darkColor"): "color1",
    ("bsdf", "ward", "alphaX"): "alphaU",
    ("bsdf", "ward", "alphaY"): "alphaV",
    ("bsdf", "roughplastic", "alphaB"): "alpha",
    ("bsdf", "roughconductor", "alphaB"): "alpha",
    ("bsdf", "roughconductor", "ior"): "eta",
    ("bsdf", "roughdielectric", "alphaB"): "alpha",
}
NAMES_0_4 = {
    ("emitter", "area", "intensity"): "radiance",
    ("emitter", "constant", "intensity"): "radiance",
    ("emitter", "directional", "intensity"): "irradiance",
    ("emitter", None, "intensityScale"): "scale",
    ("medium", None, "sizeMultiplier"): "scale",
    ("medium", None, "densityMultiplier"): "scale",
    ("integrator", None, "luminaireSamples"): "emitterSamples",
    ("sampler", None, "depth"): "dimension",
    ("sensor", None, "focusDepth"): "focusDistance",
}
TAGS_0_4 = {"luminaire": "emitter", "camera": "sensor", "background": "emitter"}

# BSDFs whose two lobes each had an amount besides a colour, with the default colours: specular, diffuse.
AMOUNTS = {"roughplastic": (1.0, 0.0), "phong": (0.2, 0.5), "ward": (0.2, 0.5)}


def version_of(root: Node, journal: Journal) -> tuple[int, ...]:
    """The version of Mitsuba that a scene was made for."""
    text = root.get("version")
    if text is None:
        journal.change(root.place, "<scene> without version", "taken as that of Mitsuba 0.2")
        return 0, 2, 0
    try:
        parts = tuple(int(part) for part in text.strip().split("."))
    except ValueError:
        raise root.error(f"'{text}' is no version such as 0.6.0") from None
    return (*parts, 0, 0)[:3]


def upgrade(root: Node, version: tuple[int, ...], journal: Journal) -> None:
    """Rename all that 0.6 calls otherwise than `version`. Old words are also taken in newer scenes: they mean
    nothing else there."""
    for node in root.all():
        if node.tag in TAGS_0_4:
            new = TAGS_0_4[node.tag]
            journal.change(node.place, f"<{node.tag}> is now <{new}>", "renamed in Mitsuba 0.4")
            if node.tag == "camera":
                _camera(node)
            if node.tag == "background" and not node.type:
                node.set("type", "constant")
            node.tag = new
        _look_at(node, journal)
    if version < (0, 3):
        _mirror_0_2(root, journal)
    tables = [(TYPES_0_3, NAMES_0_3, "0.3")] if version < (0, 3) else []
    for types, names, since in [*tables, (TYPES_0_4, NAMES_0_4, "0.4"), (TYPES_0_5, {}, "0.5")]:
        _rename(root, types, names, since, journal)
    for node in root.all():
        if node.tag == "bsdf" and node.type in AMOUNTS:
            _amounts(node, journal)
        if node.tag == "film":
            _film_alpha(node, journal)


def _rename(root: Node, types: dict, names: dict, since: str, journal: Journal) -> None:
    for node in root.all():
        new = types.get((node.tag, node.type))
        if new:
            journal.change(node.place, f'type="{node.type}" is now "{new}"', f"renamed in Mitsuba {since}")
            node.set("type", new)
        for child in node.nodes:
            new = names.get((node.tag, node.type, child.name)) or names.get((node.tag, None, child.name))
            if new:
                journal.change(child.place, f"'{child.name}' is now '{new}'", f"renamed in Mitsuba {since}")
                child.set("name", new)


def _camera(node: Node) -> None:
    """Until 0.3 the camera was left-handed, and its field of view belonged to the smaller side."""
    if node.type == "perspective":
        smaller = node.take("mapSmallerSide")
        larger = smaller is not None and smaller.get("value") == "false"
        if node.find_named("fovAxis") is None:
            node.add("string", name="fovAxis", value="larger" if larger else "smaller")
    transform = node.find_named("toWorld")
    if transform is None:
        transform = node.add("transform", name="toWorld")
    transform.insert(0, node.like("scale", x="-1"))


def _look_at(node: Node, journal: Journal) -> None:
    """`<lookAt ox=...>` of 0.2, whose x axis pointed the other way."""
    for child in list(node):
        if not isinstance(child, Node) or child.tag.lower() != "lookat" or "ox" not in child.attrib:
            continue
        for name, letter in (("origin", "o"), ("target", "t"), ("up", "u")):
            parts = [child.attrib.pop(letter + axis) for axis in "xyz" if letter + axis in child.attrib]
            if len(parts) == 3:
                child.set(name, ", ".join(parts))
        node.insert(list(node).index(child), child.like("scale", x="-1"))
        journal.change(child.place, "<lookAt ox=... tx=...>", "now origin, target and up, and a mirrored x axis")


def _mirror_0_2(root: Node, journal: Journal) -> None:
    """0.2's `mirror` became smooth chrome, unless it has a colour of its own."""
    for node in root.all():
        if node.tag == "bsdf" and node.type == "mirror" and node.find_named("reflectance") is None:
            node.set("type", "conductor")
            node.add("string", name="material", value="Cr")
            journal.change(node.place, "bsdf 'mirror' is now a 'conductor' of chromium", "as Mitsuba 0.3 did it")


def _amounts(node: Node, journal: Journal) -> None:
    for amount, name, default in zip(
        ("specularAmount", "diffuseAmount"),
        ("specularReflectance", "diffuseReflectance"),
        AMOUNTS[node.type],
        strict=True,
    ):
        given = node.take(amount)
        if given is None:
            continue
        factor = number(given)
        scaled = node.find_named(name)
        if scaled is None:
            node.add("spectrum", name=name, value=to_text([factor * default]))
        elif factor != 1:
            # A texture `scale`, which is rewritten in its turn.
            wrapper = scaled.like("texture", type="scale", name=name)
            node.replace(scaled, wrapper)
            scaled.set("name", "value")
            wrapper.append(scaled)
            wrapper.add("float", name="scale", value=to_text([factor]))
        journal.change(given.place, f"'{amount}' is now part of '{name}'", "as Mitsuba 0.3 did it")


def _film_alpha(node: Node, journal: Journal) -> None:
    alpha = node.take("alpha")
    if alpha is not None:
        node.add("string", name="pixelFormat", value="rgba" if alpha.get("value") == "true" else "rgb")
        journal.change(alpha.place, "'alpha' is now 'pixelFormat'", "renamed in Mitsuba 0.4")
