"""Classic shading for Mitsuba 3: BSDFs `phong`, `blinnphong`, `mirrorblend`, integrator `whitted`.

Importing the package registers the plugins; it sets no variant. Import it before
`mitsuba` where the system's LLVM is one that Dr.Jit cannot use (Debian 12).
"""

from .host import llvm

llvm.prepare()

from .host import registry  # noqa: E402  (imports mitsuba, which must come after llvm.prepare)

__all__ = ["__version__"]

__version__ = "0.1.0"

registry.register()
