"""BSDFs with a highlight: 0.6's `phong` and `ward`, and those of a course's dialect, as this package has them.

The dialect (`phong`, `blinn`, `blinn_microfacet` and `mirror`, each with a single `reflectance`) is that of small
course renderers that read 0.6's format. Each rule changes one `<bsdf>` in place.
"""

import math

from ..reflection import matching
from ..reflection.vocabulary import DEFAULTS, REFLECTANCES
from . import bake
from .context import Context
from .values import color, number, refraction, set_color, to_text
from .xmlfile import Node

# The scales of 0.6's `phong`.
OF_0_6 = REFLECTANCES[:2]


def phong(node: Node, context: Context) -> None:
    """0.6's `phong` is this package's. A course's has a single `reflectance`, that of the highlight."""
    reflectance = node.find_named("reflectance")
    if reflectance is not None and node.find_named(*OF_0_6) is None:
        p = _exponent(node)
        _dialect(node, reflectance, context, (p + 1) / 2, "R (p+1)/2, so that the values are the same")


def blinn(node: Node, context: Context) -> None:
    """A course's `blinn`; with two reflectances, Blinn-Phong in the words of 0.6's `phong`."""
    node.set("type", "blinnphong")
    reflectance = node.find_named("reflectance")
    if reflectance is None or node.find_named(*OF_0_6) is not None:
        context.journal.change(node.place, "'blinn' is now 'blinnphong'", "the name here")
        return
    p = _exponent(node)
    factor = (p + 2) / (4 * (2 - 2 ** (-p / 2)))
    _dialect(node, reflectance, context, factor, "R (p+2) / (4 (2 - 2^(-p/2))), so that the values are the same")
    context.journal.loss(
        node.place, "a course's 'blinn'", "its rise toward white at grazing angles (Schlick) is left out"
    )


def _exponent(node: Node) -> float:
    given = node.find_named("exponent")
    return max(number(given), 0.0) if given is not None else DEFAULTS[2]


def _dialect(node: Node, reflectance: Node, context: Context, factor: float, why: str) -> None:
    """R c lobe^p, cosine included, in the lecture's coefficients: kd = 0, ks = pi c R."""
    node.remove(reflectance)
    exponent = node.take("exponent")
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
    node.add("float", name="p", value=exponent.get("value", "") if exponent is not None else to_text(DEFAULTS[2:]))
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


def blinn_microfacet(node: Node, context: Context) -> None:
    """A course's metal, whose microfacets have a Blinn-Phong distribution."""
    p = _exponent(node)
    reflectance = node.take("reflectance")
    values = (color(reflectance) if reflectance is not None else None) or [0.5]
    node[:] = []
    node.set("type", "roughconductor")
    _metal(node, values)
    node.add("float", name="alpha", value=to_text([matching.roughness(p)]))
    context.journal.loss(
        node.place, "a course's 'blinn_microfacet'", "approximated by 'roughconductor' of the same reflectance"
    )


def mirror(node: Node, context: Context) -> None:
    """A course's mirror: Schlick's approximation from a colour."""
    reflectance = node.take("reflectance")
    values = (color(reflectance) if reflectance is not None else None) or [1.0]
    node[:] = []
    node.set("type", "conductor")
    _metal(node, values)
    context.journal.change(node.place, "'mirror' is now a 'conductor'", "of that reflectance at normal incidence")


def _metal(node: Node, values: list[float]) -> None:
    """The index of refraction, without absorption, of a reflectance at normal incidence."""
    set_color(node.add("float", name="eta", value=""), [refraction(v) for v in values])
    node.add("float", name="k", value="0")


def ward(node: Node, context: Context) -> None:
    """Ward's Gaussian of the half vector is near (n.h)^(2/alpha^2)."""
    taken = [node.take(name) for name in ("alpha_u", "alpha_v", "alpha", "variant")]
    alphas = [(color(n) or [0.1])[0] for n in taken[:3] if n is not None] or [0.1]
    power = 2 / max(math.prod(alphas) ** (2 / len(alphas)), 1e-8)
    node.set("type", "blinnphong")
    node.add("float", name="exponent", value=to_text([power]))
    why = f"approximated by 'blinnphong', exponent 2/alpha^2 = {power:.4g}"
    context.journal.loss(node.place, "'ward'", why + (", isotropic" if len(set(alphas)) > 1 else ""))
