"""BSDFs as NumPy can shade them: a lobe or a diffuse surface, perhaps in a `mirrorblend`, perhaps with two sides."""

import mitsuba as mi

from ..reflection import lobes
from ..tracing.facing import children
from .hits import Material, Undiagnosable


class KnownSurface:
    """One BSDF of a scene; `Undiagnosable` where it is another."""

    def __init__(self, bsdf, name: str):
        self.two_sided, self.km = False, None
        while True:
            nested = children(bsdf)
            if bsdf.class_name() == "TwoSidedBRDF" and len(nested) == 1:
                self.two_sided, bsdf = True, nested[0]
            elif type(bsdf).__name__ == "MirrorBlend" and self.km is None:
                self.km, bsdf = bsdf.km, bsdf.nested
            else:
                break
        self.bsdf, self.lobe = bsdf, getattr(bsdf, "NAME", None)
        if self.lobe is None and bsdf.class_name() != "SmoothDiffuse":
            raise Undiagnosable(f"the surface '{name}' is a {bsdf.class_name()}; diagnosis knows phong, blinnphong, "
                                "diffuse, mirrorblend and twosided")  # fmt: skip
        specular = exponent = None
        if self.lobe and not bsdf.reflectances:
            specular, exponent = bsdf.specular.constant(), bsdf.exponent.constant()
        self.material = Material(name, self.lobe or "diffuse", specular, exponent and exponent[0])

    def evaluate(self, si, active) -> dict[str, object]:
        """What `hits.Bounce` holds of the surface, on the lanes `active`; what is left out is 0."""
        km = mi.Color3f(0) if self.km is None else mi.Color3f(self.km.value(si, active))
        diffuse = mi.Color3f(self.bsdf.eval_diffuse_reflectance(si, active))
        if self.lobe is None:
            return {"diffuse": diffuse, "km": km}
        specular, exponent = mi.Color3f(self.bsdf.specular.value(si, active)), self.bsdf.exponent.value_1(si, active)
        if self.bsdf.reflectances:
            specular *= lobes.reflectance_factor(self.bsdf.lobe.normalization(exponent), 1) * self.bsdf.scale
        return {
            "diffuse": diffuse, "specular": specular, "exponent": mi.Float(exponent), "km": km,
            "cosine": mi.Float(self.bsdf.reflectances),
        }  # fmt: skip


def name_of(shape, bsdf, number: int) -> str:
    """What a user calls the surface of the `number`-th shape."""
    for name in (bsdf.id(), shape.id()):
        if name and not name.startswith(("_unnamed", "__")) and not name.endswith("]"):
            return name
    return f"{shape.class_name().lower()} {number}"
