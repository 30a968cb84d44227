"""BSDFs of Mitsuba 0.6, and of a course's dialect, as those of Mitsuba 3 and of this package.

Each rule changes one `<bsdf>` in place. Names are in snake_case by now.
"""

from ..reflection import matching
from ..reflection.energy import CONSERVED
from ..reflection.lobes import LOBES
from . import highlights, textures
from .context import Context
from .values import color, number, numbers, set_color, to_text
from .xmlfile import Node

# Indices of refraction by the names that 0.6 knows, where a number is needed.
INDICES = {
    "vacuum": 1.0, "air": 1.000277, "water": 1.333, "water ice": 1.31, "ethanol": 1.361, "acetone": 1.36,
    "acrylic glass": 1.49, "fused quartz": 1.458, "pyrex": 1.47, "polypropylene": 1.49, "bk7": 1.5046,
    "diamond": 2.419, "amber": 1.55, "pet": 1.575,
}  # fmt: skip

# Roughness where none is given.
ALPHA = 0.1

# Parameters that 0.6 scales where they exceed 1.
SCALED_DOWN = ("reflectance", "diffuse_reflectance", "specular_reflectance", "specular_transmittance")


def rewrite(context: Context) -> None:
    """All BSDFs of the scene, inner ones and those that are referred to first."""
    for node in context.inner_first():
        if node.tag == "bsdf":
            rule = RULES.get(node.type)
            if rule:
                rule(node, context)
            if node.type not in LOBES:
                _conserve(node, context)


def nested(node: Node, context: Context) -> list[Node]:
    """The BSDFs, and references to them, inside of a BSDF."""
    return [
        child for child in node.nodes if child.tag == "bsdf" or (child.tag == "ref" and not _is_texture(child, context))
    ]


def _textures(node: Node, context: Context) -> list[Node]:
    """The textures, and references to them, inside of a BSDF."""
    return [
        child for child in node.nodes if child.tag == "texture" or (child.tag == "ref" and _is_texture(child, context))
    ]


def _is_texture(ref: Node, context: Context) -> bool:
    """Whether a reference is to a texture."""
    return context.dereference(ref).tag != "bsdf"


# Plastics, coatings, metals ------------------------------------------------------------------------------


def _rough(node: Node, context: Context) -> None:
    """`distribution` phong and as: the Beckmann distribution of the same alpha (Walter et al., 2007)."""
    kind = node.find_named("distribution")
    for name in ("exponent", "exponent_u", "exponent_v"):
        given = node.take(name)
        if given is not None:
            alpha = matching.roughness(max(number(given), 0))
            node.add("float", name=name.replace("exponent", "alpha"), value=to_text([alpha]))
            context.journal.change(
                given.place, f"'{name}' {given.get('value')}", f"now alpha = sqrt(2/(p+2)) = {alpha:.4g}"
            )
    alpha = node.find_named("alpha")
    if node.type == "roughplastic" and alpha is not None and context.dereference(alpha).tag == "texture":
        _mean_roughness(node, alpha, context)
    if kind is None or kind.get("value") not in ("phong", "as"):
        return
    old = kind.get("value")
    kind.set("value", "beckmann")
    alpha = node.find_named("alpha")
    value = color(alpha) if alpha is not None else [ALPHA]
    power = f", whose exponent is about 2/alpha^2 - 2 = {2 / value[0] ** 2 - 2:.4g}" if value and value[0] > 0 else ""
    context.journal.loss(
        kind.place, f"{node.type} with distribution '{old}'", f"now 'beckmann' of the same alpha{power}"
    )
    if old == "as" and node.type == "roughplastic":
        for name in ("alpha_u", "alpha_v"):
            given = node.take(name)
            if given is not None and node.find_named("alpha") is None:
                given.set("name", "alpha")
                node.append(given)


def _mean_roughness(node: Node, alpha: Node, context: Context) -> None:
    mean = textures.mean(context.dereference(alpha), context)
    node.replace(alpha, node.like("float", name="alpha", value=to_text([ALPHA if mean is None else mean])))
    now = f"the default, {ALPHA}" if mean is None else f"the image's mean, {mean:.3g}"
    context.journal.loss(alpha.place, f"texture for 'alpha' of '{node.type}'", f"Mitsuba 3 wants a number; now {now}")


def _course_plastic(node: Node, context: Context) -> None:
    """A course's `plastic`: its single `reflectance` is the diffuse one, `eta` the index of refraction."""
    for old, new in (("reflectance", "diffuse_reflectance"), ("eta", "int_ior")):
        found = node.find_named(old)
        if found is not None:
            found.set("name", new)
            context.journal.change(found.place, f"'{old}' of 'plastic' is now '{new}'", "a course's dialect")


def _coating(node: Node, context: Context) -> None:
    """A layer of glass over another BSDF: only `plastic` and `roughplastic` know one."""
    rough = node.type == "roughcoating"
    inside = nested(node, context)
    if len(inside) != 1:
        raise node.error(f"'{node.type}' needs one BSDF inside, has {len(inside)}")
    base = context.dereference(inside[0])
    node.remove(inside[0])
    absorption = node.take("sigma_a")
    if absorption is not None:
        context.journal.loss(absorption.place, f"'sigma_a' of '{node.type}'", "no layer of Mitsuba 3 absorbs")
    node.take("thickness")
    if base.type in ("diffuse", "roughdiffuse"):
        _coated_diffuse(node, base, rough, context)
    elif rough:
        context.journal.loss(node.place, f"'roughcoating' over '{base.type}'", "left out; what is under it stays")
        node.become(base)
    else:
        _coated(node, base, context)


def _coated_diffuse(node: Node, base: Node, rough: bool, context: Context) -> None:
    what, node.attrib["type"] = node.type, "roughplastic" if rough else "plastic"
    reflectance = base.find_named("reflectance", "diffuse_reflectance")
    if reflectance is not None:
        reflectance.set("name", "diffuse_reflectance")
        node.append(reflectance)
    node.add("boolean", name="nonlinear", value="true")
    context.journal.loss(node.place, f"'{what}' over 'diffuse'", f"approximated by '{node.type}'")
    _rough(node, context)


def _coated(node: Node, base: Node, context: Context) -> None:
    inner, outer = (_index(node.take(name), default) for name, default in (("int_ior", 1.5046), ("ext_ior", 1.000277)))
    share = ((inner - outer) / (inner + outer)) ** 2
    tint = node.take("specular_reflectance")
    values = (color(tint) if tint is not None else None) or [1.0]
    node[:] = []
    node.set("type", "mirrorblend")
    set_color(node.add("float", name="km", value=""), [min(share * v, 1.0) for v in values])
    node.append(base)
    why = f"km = {share:.3g} as at normal incidence, without the rise at grazing angles"
    context.journal.loss(node.place, f"'coating' over '{base.type}'", f"approximated by 'mirrorblend', {why}")


def _index(node: Node | None, default: float) -> float:
    if node is None:
        return default
    if node.tag == "string":
        return INDICES.get(node.get("value", "").lower(), default)
    return number(node)


def _metal_of_0_6(node: Node, context: Context) -> None:
    """0.6's metals are copper unless they say otherwise; Mitsuba 3's are perfect mirrors."""
    if not any(node.find_named(name) is not None for name in ("material", "eta", "k")):
        node.add("string", name="material", value="Cu")
        context.journal.change(node.place, f"'{node.type}' without material", "now copper, the default of Mitsuba 0.6")
    if node.type == "roughconductor":
        _rough(node, context)


# Mixtures ------------------------------------------------------------------------------------------------


def _mixture(node: Node, context: Context) -> None:
    """A weighted sum of any number of BSDFs: nested pairs of `blendbsdf`."""
    weights_node, parts = node.take("weights"), nested(node, context)
    weights = numbers(weights_node.get("value", ""), weights_node) if weights_node is not None else []
    if len(weights) != len(parts) or not parts or min(weights) < 0 or sum(weights) <= 0:
        raise node.error(
            f"'mixturebsdf' needs one weight >= 0 for each of its {len(parts)} BSDFs, "
            f"got '{weights_node.get('value') if weights_node is not None else ''}'"
        )
    conserve = node.take("ensure_energy_conservation")
    total = sum(weights)
    if total > 1 + 1e-6:
        why = "they exceed 1, so they are divided by their sum"
        if conserve is not None and conserve.get("value") == "false":
            context.journal.loss(weights_node.place, f"weights that sum to {total:g}", why)
    elif total < 1 - 1e-6:
        black = node.like("bsdf", type="diffuse")
        black.add("rgb", name="reflectance", value="0")
        weights.append(1 - total)
        parts.append(black)
    what = f"'mixturebsdf' of {len(parts)}"
    node[:] = []
    _chain(node, weights, parts)
    context.journal.change(
        node.place, what, "now nested 'blendbsdf'" + (", the rest black" if total < 1 - 1e-6 else "")
    )


def _chain(node: Node, weights: list[float], parts: list[Node]) -> None:
    """Make `node` the blend of `parts`, each of which is a `<bsdf>` or a `<ref>`."""
    node.set("type", "blendbsdf")
    if len(parts) == 1:
        weights, parts = [*weights, 0.0], [*parts, parts[0].clone()]
        parts[1].attrib.pop("id", None) if parts[1].tag == "bsdf" else None
    rest = sum(weights[1:])
    node.add("float", name="weight", value=to_text([rest / (weights[0] + rest)]))
    node.append(parts[0])
    if len(parts) == 2:
        node.append(parts[1])
    elif rest > 0:
        _chain(node.add("bsdf"), weights[1:], parts[1:])
    else:
        node.append(parts[1])


def _blend(node: Node, context: Context) -> None:
    if node.find_named("weight") is None:
        node.insert(0, node.like("float", name="weight", value="0.5"))
        context.journal.change(node.place, "'blendbsdf' without weight", "now 0.5, the default of Mitsuba 0.6")


# The rest ------------------------------------------------------------------------------------------------


def _diffuse(node: Node, context: Context) -> None:
    old = node.find_named("diffuse_reflectance")
    if old is not None:
        old.set("name", "reflectance")
    if node.type == "roughdiffuse":
        node.set("type", "diffuse")
        alpha = node.take("alpha")
        node.take("use_fast_approx")
        roughness = f"alpha {alpha.get('value')}" if alpha is not None else "the default roughness"
        context.journal.loss(node.place, "'roughdiffuse'", f"now 'diffuse': {roughness} is left out")


def _only_diffuse(node: Node, context: Context) -> None:
    found = node.find_named("reflectance", "transmittance")
    what = node.type
    constant = found if found is not None else node.like("rgb", name="reflectance", value="0.5")
    constant.set("name", "reflectance")
    node[:] = [constant]
    node.set("type", "diffuse")
    context.journal.loss(node.place, f"'{what}'", "Mitsuba 3 has nothing like it; now 'diffuse'")


def _normalmap(node: Node, context: Context) -> None:
    for child in _textures(node, context):
        child.set("name", "normalmap")
        if child.tag == "texture" and child.type == "bitmap" and child.find_named("raw") is None:
            child.add("boolean", name="raw", value="true")


def _bumpmap(node: Node, context: Context) -> None:
    """Mitsuba 3 knows the slopes of images only."""
    given = _textures(node, context)
    if any(context.dereference(texture).type == "bitmap" for texture in given):
        return
    inside = nested(node, context)
    if len(inside) == 1:
        what = f"bumps of a '{context.dereference(given[0]).type}'" if given else "'bumpmap' without a texture"
        context.journal.loss(node.place, what, "left out: Mitsuba 3 bends surfaces by images only")
        node.become(context.dereference(inside[0]))


def _conserve(node: Node, context: Context) -> None:
    """Constants above 1, which Mitsuba 0.6 scaled with a warning and Mitsuba 3 refuses."""
    for child in node.nodes:
        values = color(child) if child.name in SCALED_DOWN and "$" not in child.get("value", "") else None
        if values and max(values) > 1:
            scale = CONSERVED / max(values)
            set_color(child, [v * scale for v in values])
            context.journal.change(
                child.place, f"'{child.name}' of {to_text(values)}", f"times {scale:.3g}, as Mitsuba 0.6 did it"
            )


RULES = {
    "diffuse": _diffuse,
    "roughdiffuse": _diffuse,
    "roughplastic": _rough,
    "conductor": _metal_of_0_6,
    "roughconductor": _metal_of_0_6,
    "roughdielectric": _rough,
    "plastic": _course_plastic,
    "coating": _coating,
    "roughcoating": _coating,
    "mixturebsdf": _mixture,
    "blendbsdf": _blend,
    "phong": highlights.phong,
    "blinn": highlights.blinn,
    "blinn_microfacet": highlights.blinn_microfacet,
    "mirror": highlights.mirror,
    "ward": highlights.ward,
    "difftrans": _only_diffuse,
    "hk": _only_diffuse,
    "irawan": _only_diffuse,
    "bumpmap": _bumpmap,
    "normalmap": _normalmap,
}
