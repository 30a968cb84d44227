"""What the tracer asks, and of whom: each question has more than one who answers, and the tracer does not know which.

All arguments and results are Dr.Jit arrays over the lanes of a kernel, in scalar variants numbers:
`si` a `mitsuba.SurfaceInteraction3f`, `active` and other lanes masks, spectra unpolarized but for `eval`.
"""

from typing import Any, Protocol


class Reflection(Protocol):
    """What the surfaces of a scene reflect: `materials.Materials` from arrays, `dispatch.Dispatch` from the BSDFs."""

    def at(self, si, active, front=None) -> Any:
        """The material that was hit, for the other methods.

        `front`: the lanes on which the surface is seen from the front (None: where `si.wi` is above it).
        """

    def eval(self, material, si, wo, last, active) -> Any:
        """f cos(theta_o) of the smooth lobes toward `wo`, in the local frame; on the lanes `last` (None: on none)
        without the mirror of a `mirrorblend`."""

    def diffuse_reflectance(self, material, si, last, active) -> Any:
        """Diffuse reflectance; `last` as in `eval`."""

    def mirrors(self, material, si, active) -> Any:
        """The rays that go on, a list of (direction in world space, weight, lanes), one for each delta lobe."""


class Hits(Protocol):
    """What rays meet: `geometry.Geometry`."""

    def hit(self, ray, coherent, active) -> Any:
        """The first surface on `ray`, a `mitsuba.SurfaceInteraction3f`; invalid where there is none."""

    def blocked(self, ray, active) -> Any:
        """Whether anything is on `ray`."""
