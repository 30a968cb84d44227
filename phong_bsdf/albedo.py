"""Where `phong_bsdf.reflection.albedo` was: kept for programs that import it from here."""

import warnings

from .reflection.albedo import Table, directional_albedo

__all__ = ["Table", "directional_albedo"]

warnings.warn("phong_bsdf.albedo is phong_bsdf.reflection.albedo now", DeprecationWarning, stacklevel=2)
