"""Integrators, samplers, films, sensors, emitters, shapes and media of Mitsuba 0.6 as those of Mitsuba 3.

Each rule changes one element in place; a rule that returns False asks for the element to be removed.
BSDFs and textures have modules of their own. Names are in snake_case by now.
"""

from .context import Context
from .transforms import round_sphere
from .values import color, number, set_color, to_text
from .xmlfile import Node

# (tag, type) -> the nearest type of Mitsuba 3, and why nothing, or what, is lost.
RENAMED = {
    ("film", "tiledhdrfilm"): ("hdrfilm", None, "the same picture, in one piece"),
    ("film", "mfilm"): ("hdrfilm", "no text or MATLAB files", ""),
    ("sampler", "halton"): ("multijitter", None, "well-distributed samples of another kind"),
    ("sampler", "hammersley"): ("multijitter", None, "well-distributed samples of another kind"),
    ("sampler", "sobol"): ("multijitter", None, "well-distributed samples of another kind"),
    ("integrator", "volpath_simple"): ("volpath", None, "the same light, less noise"),
    ("integrator", "bdpt"): ("path", None, "the same light from one side only: other noise"),
    ("integrator", "pssmlt"): ("path", None, "the same light, other noise"),
    ("integrator", "mlt"): ("path", None, "the same light, other noise"),
    ("integrator", "erpt"): ("path", None, "the same light, other noise"),
    ("integrator", "photonmapper"): ("path", None, "the same light, other noise, no bias"),
    ("integrator", "ppm"): ("path", None, "the same light, other noise, no bias"),
    ("integrator", "sppm"): ("path", None, "the same light, other noise, no bias"),
    ("integrator", "vpl"): ("path", None, "the same light, no bias"),
    ("integrator", "ao"): ("direct", "Mitsuba 3 has no ambient occlusion", ""),
    ("sensor", "telecentric"): ("orthographic", "no blur out of focus", ""),
    ("sensor", "perspective_rdist"): ("perspective", "no radial distortion", ""),
    ("sensor", "spherical"): ("perspective", "no panoramas", ""),
    ("sensor", "fluencemeter"): ("perspective", "no fluence meter", ""),
    ("rfilter", "wsinc"): ("lanczos", None, "its name now"),
    ("volume", "hgridvolume"): ("gridvolume", "no hierarchical grids", ""),
    ("phase", "kkay"): ("isotropic", "no phase function for hair", ""),
    ("phase", "microflake"): ("isotropic", "its parameters are not those of 'sggx'", ""),
}

# 0.6's integrators around others that only choose where to put samples.
WRAPPERS = ("adaptive", "irrcache", "multichannel")

FIELDS = {
    "position": "position", "distance": "depth", "geonormal": "geo_normal", "shnormal": "sh_normal", "uv": "uv",
    "albedo": "albedo", "shapeindex": "shape_index", "primindex": "prim_index",
}  # fmt: skip

PIXEL_FORMATS = {
    "luminancealpha": "luminance_alpha", "spectrum": "rgb", "spectrumalpha": "rgba", "multispectrumalpha": "rgba",
}  # fmt: skip

LIGHTS = ("radiance", "irradiance", "intensity", "power")

# What has no counterpart, and is left out.
GONE = {
    ("emitter", "collimated"): "Mitsuba 3 has no beam of no width; try 'directionalarea' on a small disk",
    ("shape", "hair"): "Mitsuba 3 reads hair from other files: see 'bsplinecurve'",
    ("shape", "heightfield"): "Mitsuba 3 has no height fields; make it a mesh",
    ("shape", "deformable"): "Mitsuba 3 has no deformable meshes",
}


def rewrite(context: Context) -> None:
    """All elements of the scene, inner ones first."""
    for parent in reversed(context.root.all()):
        for node in parent.nodes:
            why = GONE.get((node.tag, node.type))
            if why or RULES.get(node.tag, _nothing)(node, context) is False:
                parent.remove(node)
            if why:
                context.journal.loss(node.place, f"{node.tag} '{node.type}'", f"left out: {why}")
            _rename(node, context)


def _nothing(node: Node, context: Context) -> None:
    pass


def _rename(node: Node, context: Context) -> None:
    if (node.tag, node.type) in RENAMED:
        old = node.type
        new, lost, why = RENAMED[node.tag, old]
        node.set("type", new)
        if lost:
            context.journal.loss(
                node.place,
                f"{node.tag} '{old}' is now '{new}'",
                f"Mitsuba 3 has {lost}" if lost.startswith("no ") else lost,
            )
        else:
            context.journal.change(node.place, f"{node.tag} '{old}' is now '{new}'", why)


def _film(node: Node, context: Context) -> None:
    if node.type == "ldrfilm":
        node.set("type", "hdrfilm")
        context.journal.change(
            node.place, "film 'ldrfilm' is now 'hdrfilm'", "PNG files are made when the picture is written"
        )
        node.take("file_format")
        method = node.take("tonemap_method")
        if method is not None and method.get("value") != "gamma":
            context.journal.loss(method.place, f"tone mapping '{method.get('value')}'", "Mitsuba 3's films are linear")
        for name, neutral in (("gamma", -1.0), ("exposure", 0.0)):
            given = node.take(name)
            if given is not None and number(given) != neutral:
                context.journal.loss(given.place, f"film {name} {given.get('value')}", "Mitsuba 3's films are linear")
        for name in ("key", "burn"):
            node.take(name)
    file_format = node.find_named("file_format")
    if file_format is not None and file_format.get("value", "").lower() not in ("openexr", "exr", "rgbe", "pfm"):
        node.remove(file_format)
    pixels = node.find_named("pixel_format")
    if pixels is not None:
        first = pixels.get("value", "").split(",")[0].strip().lower()
        new = PIXEL_FORMATS.get(first, first)
        if "spectrum" in first or "," in pixels.get("value", ""):
            context.journal.loss(pixels.place, f"pixel format '{pixels.get('value')}'", f"now '{new}'")
        pixels.set("value", new)


def _sampler(node: Node, context: Context) -> None:
    for name in ("dimension", "scramble"):
        given = node.take(name)
        if given is not None:
            context.journal.change(given.place, f"'{name}' of the sampler", "Mitsuba 3 chooses it by itself")


def _integrator(node: Node, context: Context) -> None:
    inner = [child for child in node.nodes if child.tag == "integrator"]
    if node.type in WRAPPERS and inner:
        main = next((child for child in inner if child.type != "field"), inner[0])
        left = [child.type for child in inner if child is not main]
        what = f"integrator '{node.type}'"
        if left:
            context.journal.loss(node.place, what, f"only its '{main.type}' is left, without {', '.join(left)}")
        else:
            context.journal.change(node.place, what, f"now its inner '{main.type}' alone")
        node.become(main)
        _rename(node, context)
    elif node.type == "field":
        given = node.take("field")
        name = (given.get("value", "") if given is not None else "").lower()
        channel = FIELDS.get(name, "depth")
        node[:] = []
        node.set("type", "aov")
        node.add("string", name="aovs", value=f"value:{channel}")
        note = context.journal.change if name in FIELDS else context.journal.loss
        note(node.place, f"integrator 'field' of '{name}'", f"now 'aov' of '{channel}'")
    strict = node.take("strict_normals")
    if strict is not None and strict.get("value") == "true":
        context.journal.loss(strict.place, "'strict_normals'", "Mitsuba 3 has no such mode")


def _sensor(node: Node, context: Context) -> None:
    if node.find_named("fov") is None:
        # Mitsuba 3 reads it with a field of view only.
        node.take("fov_axis")
    if node.type == "thinlens" and node.find_named("aperture_radius") is None:
        node.add("float", name="aperture_radius", value="0.01")
    if node.type in ("perspective_rdist", "telecentric"):
        for name in ("kc", "aperture_radius", "focus_distance"):
            node.take(name)
    if node.type == "telecentric":
        node.take("fov")


def _emitter(node: Node, context: Context) -> None:
    for light in node.nodes:
        given = context.substituted(light.get("value", ":"))
        if light.tag == "spectrum" and light.name in LIGHTS and ":" not in given:
            # One number was white. Mitsuba 3 takes it for a spectrum of equal energy, which is reddish.
            light.tag = "rgb"
            context.journal.change(light.place, f"<spectrum> of one number in '{node.type}'", "now <rgb>: white")
    scale = node.find_named("scale")
    if scale is not None and node.type not in ("envmap", "sky", "sun", "sunsky"):
        node.remove(scale)
        _brighter(node, scale, context)
    if node.type in ("sky", "sun", "sunsky"):
        _sky(node, context)
    if node.type == "envmap":
        gamma = node.take("gamma")
        if gamma is not None and number(gamma) not in (-1.0, 0.0):
            context.journal.loss(
                gamma.place, f"'gamma' {gamma.get('value')} of 'envmap'", "Mitsuba 3 knows the file's own"
            )
        node.take("cache")


def _brighter(node: Node, scale: Node, context: Context) -> None:
    """An emitter's factor, which only few emitters of Mitsuba 3 have."""
    light = node.find_named(*LIGHTS)
    values = color(light) if light is not None else [1.0]
    if values is None:
        context.journal.loss(
            scale.place, f"'scale' {scale.get('value')} of '{node.type}'", "its spectrum cannot be scaled"
        )
        return
    if light is None:
        names = {"directional": "irradiance", "area": "radiance", "constant": "radiance"}
        light = node.add("rgb", name=names.get(node.type, "intensity"))
    set_color(light, [number(scale) * v for v in values])
    context.journal.change(
        scale.place, f"'scale' of '{node.type}'", f"now part of '{light.name}': {light.get('value')}"
    )


def _sky(node: Node, context: Context) -> None:
    """The sky of 0.6 stands on y, that of Mitsuba 3 on z. The direction of the sun is the scene's in both."""
    old = node.type
    node.set("type", "sunsky")
    scale = node.take("scale")
    if old != "sunsky":
        off, on = ("sun_scale", "sky_scale") if old == "sky" else ("sky_scale", "sun_scale")
        node.take(off)
        node.add("float", name=off, value="0")
        if scale is not None:
            node.take(on)
            node.add("float", name=on, value=scale.attrib["value"])
    elif scale is not None:
        for name in ("sun_scale", "sky_scale"):
            own = node.take(name)
            node.add("float", name=name, value=to_text([number(scale) * (number(own) if own is not None else 1)]))
    transform = node.find_named("to_world")
    if transform is None:
        transform = node.add("transform", name="to_world")
    transform.insert(0, node.like("rotate", x="1", angle="-90"))
    context.journal.loss(
        node.place, f"emitter '{old}'",
        "now 'sunsky', of a newer model, turned from z to y as its up direction; brightness may differ",
    )  # fmt: skip


def _shape(node: Node, context: Context) -> None:
    if node.type == "sphere":
        round_sphere(node, context)
    surfaces = [
        n for n in node.nodes if n.tag == "bsdf" or (n.tag == "ref" and getattr(context.target(n), "tag", "") == "bsdf")
    ]
    for extra in surfaces[1:]:
        node.remove(extra)
    if len(surfaces) > 1:
        named = ", ".join(repr(n.name or n.get("id", n.type)) for n in surfaces[1:])
        context.journal.loss(
            node.place, f"{len(surfaces)} BSDFs of one shape", f"only the first is left, without {named}"
        )
    for child in surfaces[:1]:
        child.attrib.pop("name", None)
    if node.type == "obj" and not surfaces:
        _materials_of_model(node, context)
    media = [n for n in node.nodes if getattr(context.target(n), "tag", "") == "medium"]
    if media and not surfaces and not any(n.tag == "emitter" for n in node.nodes):
        node.add("bsdf", type="null")
        context.journal.change(
            node.place, f"'{node.type}' of a medium without BSDF", "now 'null', as Mitsuba 0.6 had it"
        )


def _materials_of_model(node: Node, context: Context) -> None:
    """An OBJ file without a BSDF in the scene had the materials of its MTL file; Mitsuba 3 reads only its shape."""
    given, wanted = node.find_named("filename"), node.find_named("load_materials")
    path = context.filename(given) if given is not None else None
    if path is None or not path.is_file() or (wanted is not None and wanted.get("value") == "false"):
        return
    with path.open("rb") as lines:
        if not any(line.lstrip().startswith(b"mtllib") for line in lines):
            return
    why = "Mitsuba 3 does not read them; the shape is grey. Of the OBJ file itself phong-bsdf convert makes BSDFs"
    context.journal.loss(node.place, f"MTL materials of '{given.get('value')}'", why)


def _medium(node: Node, context: Context) -> None:
    """sigma_s and sigma_a as sigma_t and albedo; colours above 1, which Mitsuba 3 refuses, as a scale."""
    given = [n for n in map(node.find_named, ("sigma_s", "sigma_a")) if n is not None]
    if len(given) == 2:
        scattering, absorption = (color(n) for n in given)
        if not scattering or not absorption:
            why = "they are no plain constants; write sigma_t and albedo"
            context.journal.loss(node.place, "'sigma_s' and 'sigma_a'", why)
            return
        n = max(len(scattering), len(absorption))
        s, a = (v * n if len(v) < n else v for v in (scattering, absorption))
        for child in given:
            node.remove(child)
        total = [x + y for x, y in zip(s, a, strict=True)]
        set_color(node.add("float", name="sigma_t", value=""), total)
        set_color(
            node.add("float", name="albedo", value=""), [x / t if t else 0.0 for x, t in zip(s, total, strict=True)]
        )
        context.journal.change(node.place, "'sigma_s' and 'sigma_a'", "now 'sigma_t' and 'albedo'")
    preset = node.take("material")
    if preset is not None:
        context.journal.loss(preset.place, f"medium of material '{preset.get('value')}'", "Mitsuba 3 has no presets")
    density = node.find_named("sigma_t")
    values = color(density) if density is not None else None
    if density is not None and values and density.tag == "rgb" and max(values) > 1:
        scale = node.take("scale")
        set_color(density, [v / max(values) for v in values])
        factor = max(values) * (number(scale) if scale is not None else 1.0)
        node.add("float", name="scale", value=to_text([factor]))
        context.journal.change(
            density.place, f"'sigma_t' of {to_text(values)}", "Mitsuba 3 wants colours up to 1, and a 'scale'"
        )


def _subsurface(node: Node, context: Context) -> bool:
    context.journal.loss(node.place, f"subsurface '{node.type}'", "left out: Mitsuba 3 has no subsurface plugins")
    return False


def _animation(node: Node, context: Context) -> None:
    frames = [child for child in node.nodes if child.tag == "transform"]
    name = node.name
    node.tag = "transform"
    node.attrib = {"name": name}
    node[:] = list(frames[0]) if frames else []
    context.journal.loss(node.place, f"<animation> of {len(frames)} key frames", "only the first is left")


RULES = {
    "film": _film,
    "sampler": _sampler,
    "integrator": _integrator,
    "sensor": _sensor,
    "emitter": _emitter,
    "shape": _shape,
    "medium": _medium,
    "subsurface": _subsurface,
    "animation": _animation,
}
