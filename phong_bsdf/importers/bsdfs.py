"""BSDFs of Mitsuba 0.6, and of a course's dialect, as those of Mitsuba 3 and of this package.

Each rule changes one `<bsdf>` in place. Names are in snake_case by now.
"""

import math

from . import bake
from .context import Context
from .records import ConversionError
from .values import color, number, numbers, set_color, to_text
from .xmlfile import Node

# Indices of refraction by the names that 0.6 knows, where a number is needed.
INDICES = {
    "vacuum": 1.0, "air": 1.000277, "water": 1.333, "water ice": 1.31, "ethanol": 1.361, "acetone": 1.36,
    "acrylic glass": 1.49, "fused quartz": 1.458, "pyrex": 1.47, "polypropylene": 1.49, "bk7": 1.5046,
    "diamond": 2.419, "amber": 1.55, "pet": 1.575,
}  # fmt: skip

# Energy rule of 0.6 where a reflectance exceeds 1.
CONSERVED = 0.99
REFLECTANCES = ("reflectance", "diffuse_reflectance", "specular_reflectance", "specular_transmittance")
LOBES = ("phong", "blinnphong")


def rewrite(context: Context) -> None:
    """All BSDFs of the scene, inner ones first."""
    for node in reversed(context.root.all()):
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
            alpha = math.sqrt(2 / (max(number(given), 0) + 2))
            node.add("float", name=name.replace("exponent", "alpha"), value=to_text([alpha]))
            context.journal.change(
                given.place, f"'{name}' {given.get('value')}", f"now alpha = sqrt(2/(p+2)) = {alpha:.4g}"
            )
    if kind is None or kind.get("value") not in ("phong", "as"):
        return
    old = kind.get("value")
    kind.set("value", "beckmann")
    alpha = node.find_named("alpha")
    value = color(alpha) if alpha is not None else [0.1]
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


def _torrey_plastic(node: Node, context: Context) -> None:
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
        raise ConversionError(f"{node.file}, line {node.line}: '{node.type}' needs one BSDF inside, has {len(inside)}")
    base = context.dereference(inside[0])
    node.remove(inside[0])
    absorption = node.take("sigma_a")
    if absorption is not None:
        context.journal.loss(absorption.place, f"'sigma_a' of '{node.type}'", "no layer of Mitsuba 3 absorbs")
    node.take("thickness")
    if base.type in ("diffuse", "roughdiffuse"):
        what, node.attrib["type"] = node.type, "roughplastic" if rough else "plastic"
        reflectance = base.find_named("reflectance", "diffuse_reflectance")
        if reflectance is not None:
            reflectance.set("name", "diffuse_reflectance")
            node.append(reflectance)
        node.add("boolean", name="nonlinear", value="true")
        context.journal.loss(node.place, f"'{what}' over 'diffuse'", f"approximated by '{node.type}'")
        _rough(node, context)
        return
    if rough:
        context.journal.loss(node.place, f"'roughcoating' over '{base.type}'", "left out; what is under it stays")
        node.become(base)
        return
    inner, outer = (_index(node.take(name), default) for name, default in (("int_ior", 1.5046), ("ext_ior", 1.000277)))
    share = ((inner - outer) / (inner + outer)) ** 2
    tint = node.take("specular_reflectance")
    values = (color(tint) if tint is not None else None) or [1.0]
    node[:] = []
    node.set("type", "mirrorblend")
    set_color(node.add("float", name="km", value=""), [min(share * v, 1.0) for v in values])
    node.append(base)
    context.journal.loss(
        node.place, f"'coating' over '{base.type}'",
        f"approximated by 'mirrorblend', km = {share:.3g} as at normal incidence, without the rise at grazing angles",
    )  # fmt: skip


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
        raise ConversionError(
            f"{node.file}, line {node.line}: 'mixturebsdf' needs one weight >= 0 for each of its {len(parts)} BSDFs, "
            f"got '{weights_node.get('value') if weights_node is not None else ''}'"
        )
    conserve = node.take("ensure_energy_conservation")
    total = sum(weights)
    if total > 1 + 1e-6:
        why = "they exceed 1, so they are divided by their sum"
        if conserve is not None and conserve.get("value") == "false":
            context.journal.loss(weights_node.place, f"weights that sum to {total:g}", why)
        weights = [w / total for w in weights]
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


# Highlights ----------------------------------------------------------------------------------------------


def _phong(node: Node, context: Context) -> None:
    """0.6's `phong` is this package's. A course's has a single `reflectance`, that of the highlight."""
    if node.find_named("reflectance") is not None:
        p = _exponent(node)
        _dialect(node, context, (p + 1) / 2, "R (p+1)/2, so that the values are the same")


def _blinn(node: Node, context: Context) -> None:
    """A course's `blinn`; with two reflectances, Blinn-Phong in the words of 0.6's `phong`."""
    node.set("type", "blinnphong")
    if node.find_named("reflectance") is None:
        context.journal.change(node.place, "'blinn' is now 'blinnphong'", "the name here")
        return
    p = _exponent(node)
    factor = (p + 2) / (4 * (2 - 2 ** (-p / 2)))
    _dialect(node, context, factor, "R (p+2) / (4 (2 - 2^(-p/2))), so that the values are the same")
    context.journal.loss(
        node.place, "a course's 'blinn'", "its rise toward white at grazing angles (Schlick) is left out"
    )


def _exponent(node: Node) -> float:
    given = node.find_named("exponent")
    return max(number(given), 0.0) if given is not None else 30.0


def _dialect(node: Node, context: Context, factor: float, why: str) -> None:
    """R c lobe^p, cosine included, in the lecture's coefficients: kd = 0, ks = pi c R."""
    reflectance, exponent = node.take("reflectance"), node.take("exponent")
    node.add("rgb", name="kd", value="0")
    constant = color(reflectance)
    if constant is not None:
        ks = node.add("float", name="ks", value="")
        set_color(ks, [factor * v for v in constant])
    else:
        ks = context.dereference(reflectance)
        ks.set("name", "ks")
        _scale_texture(ks, factor, context)
        node.append(ks)
    node.add("float", name="p", value=exponent.get("value") if exponent is not None else "30")
    context.journal.change(
        reflectance.place, f"'reflectance' of '{node.type}' is now 'ks'", f"a course's dialect; ks = {why}"
    )


def _scale_texture(node: Node, factor: float, context: Context) -> None:
    name = node.find_named("filename")
    path = context.filename(name) if name is not None and not name.final else None
    if node.type != "bitmap" or path is None or not path.is_file():
        context.journal.loss(node.place, f"texture '{node.type}' times {factor:.4g}", "it cannot be scaled")
        return
    new = bake.copy(context.files, path, lambda x: bake.scaled(x, [factor]), "scaled")
    name.final = True
    name.set("value", context.files.relative(new.resolve()))


def _blinn_microfacet(node: Node, context: Context) -> None:
    p = _exponent(node)
    reflectance = node.take("reflectance")
    values = (color(reflectance) if reflectance is not None else None) or [0.5]
    node[:] = []
    node.set("type", "roughconductor")
    _metal(node, values)
    node.add("float", name="alpha", value=to_text([math.sqrt(2 / (p + 2))]))
    context.journal.loss(
        node.place, "a course's 'blinn_microfacet'", "approximated by 'roughconductor' of the same reflectance"
    )


def _mirror(node: Node, context: Context) -> None:
    """A course's mirror: Schlick's approximation from a colour."""
    reflectance = node.take("reflectance")
    values = (color(reflectance) if reflectance is not None else None) or [1.0]
    node[:] = []
    node.set("type", "conductor")
    _metal(node, values)
    context.journal.change(node.place, "'mirror' is now a 'conductor'", "of that reflectance at normal incidence")


def _metal(node: Node, values: list[float]) -> None:
    """The index of refraction, without absorption, of a reflectance at normal incidence."""
    roots = [math.sqrt(min(max(v, 0.0), 0.999)) for v in values]
    set_color(node.add("float", name="eta", value=""), [(1 + r) / (1 - r) for r in roots])
    node.add("float", name="k", value="0")


def _ward(node: Node, context: Context) -> None:
    """Ward's Gaussian of the half vector is near (n.h)^(2/alpha^2)."""
    taken = [node.take(name) for name in ("alpha_u", "alpha_v", "alpha", "variant")]
    alphas = [(color(n) or [0.1])[0] for n in taken[:3] if n is not None] or [0.1]
    power = 2 / max(math.prod(alphas) ** (2 / len(alphas)), 1e-8)
    node.set("type", "blinnphong")
    node.add("float", name="exponent", value=to_text([power]))
    why = f"approximated by 'blinnphong', exponent 2/alpha^2 = {power:.4g}"
    context.journal.loss(node.place, "'ward'", why + (", isotropic" if len(set(alphas)) > 1 else ""))


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
    for child in node.nodes:
        if child.tag == "texture" or (child.tag == "ref" and _is_texture(child, context)):
            child.set("name", "normalmap")
            if child.tag == "texture" and child.type == "bitmap" and child.find_named("raw") is None:
                child.add("boolean", name="raw", value="true")


def _bumpmap(node: Node, context: Context) -> None:
    """Mitsuba 3 knows the slopes of images only."""
    textures = [
        child for child in node.nodes if child.tag == "texture" or (child.tag == "ref" and _is_texture(child, context))
    ]
    if any(context.dereference(texture).type == "bitmap" for texture in textures):
        return
    inside = nested(node, context)
    if len(inside) == 1:
        what = f"bumps of a '{context.dereference(textures[0]).type}'" if textures else "'bumpmap' without a texture"
        context.journal.loss(node.place, what, "left out: Mitsuba 3 bends surfaces by images only")
        node.become(context.dereference(inside[0]))


def _conserve(node: Node, context: Context) -> None:
    """Constants above 1, which Mitsuba 0.6 scaled with a warning and Mitsuba 3 refuses."""
    for child in node.nodes:
        values = color(child) if child.name in REFLECTANCES and "$" not in child.get("value", "") else None
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
    "plastic": _torrey_plastic,
    "coating": _coating,
    "roughcoating": _coating,
    "mixturebsdf": _mixture,
    "blendbsdf": _blend,
    "phong": _phong,
    "blinn": _blinn,
    "blinn_microfacet": _blinn_microfacet,
    "mirror": _mirror,
    "ward": _ward,
    "difftrans": _only_diffuse,
    "hk": _only_diffuse,
    "irawan": _only_diffuse,
    "bumpmap": _bumpmap,
    "normalmap": _normalmap,
}
