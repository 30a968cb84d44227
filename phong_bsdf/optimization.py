"""Parameters of a scene as an optimiser should see them: exponents by their logarithm, all within their legal range.

    opt = mi.ad.Adam(lr=0.05)
    unknown = Unknown(opt, mi.traverse(scene), ["ball.bsdf.kd.value", "ball.bsdf.p.value"])
    for _ in range(200):
        params = unknown.apply(scene)
        dr.backward(loss(mi.render(scene, params)))
        opt.step()

An exponent spans decades: a step from 10 to 20 changes a picture as much as one from 1000 to 2000. By its logarithm
one learning rate serves all exponents, and the reflectances beside them.
"""

import math
from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
from drjit.opt import Optimizer

__all__ = ["Unknown"]

# Legal ranges by what `mi.traverse` calls a parameter, without `.value` or `.data`. Of an exponent, those beyond which
# a picture of the usual size shows no difference: a lobe of the whole hemisphere, and one of less than a pixel.
EXPONENTS = {"p": (1e-2, 1e7), "exponent": (1e-2, 1e7)}
FRACTIONS = ("km", "diffuse_reflectance", "specular_reflectance")
POSITIVE = ("kd", "ks", "intensity", "irradiance", "radiance", "ambient")

# How the keys of those end that a function recorded by `dr.freeze` cannot change: Mitsuba 3.9 reads positions when they
# change, and ends the process where a change of a texture is replayed.
NOT_FROZEN = ("data", "position", "vertex_positions")


class Unknown:
    """The parameters `keys` of a scene, held by the optimiser `opt` in the form in which they are optimised.

    `opt`: one of Mitsuba's (`mi.ad.Adam`, `mi.ad.SGD`); it gets an entry for each key, which starts at the value in
    `params`, of `mi.traverse`. Exponents (`p`, `exponent`) are held as their natural logarithm, within 1e-2 to 1e7.
    Raises KeyError for keys that the scene does not have; `keys` may be a single one.
    """

    def __init__(self, opt: Optimizer, params: "mi.SceneParameters", keys: str | Sequence[str]):
        self.opt, self.keys = opt, [keys] if isinstance(keys, str) else list(keys)
        missing = [key for key in self.keys if key not in params]
        if missing:
            raise KeyError(
                f"optimization: no parameter '{missing[0]}' in this scene; it has {', '.join(params.keys())}"
            )
        for key in self.keys:
            given: Any = params[key]
            value = type(given)(dr.detach(given))
            opt[key] = dr.log(dr.clip(value, *EXPONENTS[_name(key)])) if _name(key) in EXPONENTS else value

    def value(self, key: str) -> Any:
        """What the optimiser has found for the parameter `key`, within its legal range, in the scene's type."""
        return self._shown(key, dr.clip(dr.detach(self.opt[key]), *bounds(key)))

    def apply(self, scene: "mi.Scene") -> "mi.SceneParameters":
        """Brings what the optimiser holds into the legal range and into `scene`; returns the scene's parameters.

        Call it at the start of each step, and once in the end. Raises ValueError for textures and positions in a
        function that `dr.freeze` records.
        """
        params = mi.traverse(scene)
        for key in self.keys:
            if key.split(".")[-1] in NOT_FROZEN and dr.flag(dr.JitFlag.FreezingScope):
                raise ValueError(f"optimization: dr.freeze cannot change '{key}'; call the step without it")
            self.opt[key] = dr.clip(dr.detach(self.opt[key]), *bounds(key))
            params[key] = self._shown(key, self.opt[key])
        params.update()
        return params

    @staticmethod
    def _shown(key, held):
        return dr.exp(held) if _name(key) in EXPONENTS else held


def bounds(key: str) -> tuple[float, float]:
    """The range of what an optimiser holds for the parameter `key`; infinite where anything is legal."""
    name = _name(key)
    if name in EXPONENTS:
        low, high = EXPONENTS[name]
        return math.log(low), math.log(high)
    return (0.0, 1.0) if name in FRACTIONS else (0.0, math.inf) if name in POSITIVE else (-math.inf, math.inf)


def _name(key: str) -> str:
    parts = key.split(".")
    return parts[-2] if parts[-1] in ("value", "data") and len(parts) > 1 else parts[-1]
