"""What a scene uses, hence what the kernels that render it can leave out.

`whitted` asks before it builds a kernel. Everything here is known on the host: no
array is read.
"""

from dataclasses import dataclass

import mitsuba as mi

# A private bit of `mirrorblend`, above all of Mitsuba's own. In a component's flags:
# this mirror can be taken away. In a context's type mask: take it away, and show what
# is under it undiminished. Adapters (`twosided`, `mask`, ...) pass both on.
MIRRORLESS = 1 << 30


# Emitters that `whitted` serves, by the names of their plugins.
LIGHTS = ("point", "spot", "projector", "directional")
BACKGROUNDS = ("constant", "envmap")


class UnsupportedScene(ValueError):
    """The scene holds something that the `whitted` integrator cannot render."""


@dataclass(frozen=True)
class Needs:
    """What one scene needs of the Whitted integrator."""

    lights: int
    """Number of delta lights."""

    background: bool
    """Whether rays that leave the scene see something."""

    delta_components: tuple[int, ...]
    """Indices of BSDF components that are delta lobes, over all BSDFs."""

    branches: int
    """Most delta lobes that one surface can show at once: 0 no mirror, 1 a path, 2 or more a tree."""

    fading_mirrors: bool
    """Whether some mirror is a `mirrorblend`, which the course's last bounce takes away."""


def analyse(scene) -> Needs:
    """The needs of `scene`; raises `UnsupportedScene` for lights that have no single direction."""
    background = scene.environment()
    lights = 0
    for emitter in scene.emitters():
        if is_delta(emitter):
            lights += 1
        elif background is None or emitter.ptr != background.ptr:
            name = emitter.id() or emitter.class_name()
            raise UnsupportedScene(refusal(name))
    bsdfs = {bsdf.ptr: bsdf for bsdf in (shape.bsdf() for shape in scene.shapes()) if bsdf is not None}
    components = [[bsdf.flags(i) for i in range(bsdf.component_count())] for bsdf in bsdfs.values()]
    return Needs(
        lights=lights,
        background=background is not None,
        delta_components=tuple(sorted({i for flags in components for i, f in enumerate(flags) if _is_mirror(f)})),
        branches=max((_branches(flags) for flags in components), default=0),
        fading_mirrors=any(f & MIRRORLESS for flags in components for f in flags),
    )


def refusal(emitter: str) -> str:
    """Why `whitted` cannot render the scene, and what can."""
    return (
        f"whitted: cannot render with the emitter '{emitter}', only with {', '.join(LIGHTS)} and, as a background, "
        f"{' or '.join(BACKGROUNDS)}; use the integrator 'path' for other lights"
    )


def is_delta(emitter) -> bool:
    """Whether a light arrives from one direction only."""
    flags = emitter.flags()
    return mi.has_flag(flags, mi.EmitterFlags.DeltaPosition) or mi.has_flag(flags, mi.EmitterFlags.DeltaDirection)


def _is_mirror(flags: int) -> bool:
    return bool(flags & int(mi.BSDFFlags.Delta))


def _branches(components: list[int]) -> int:
    """Most delta lobes on one side; a component that names no side counts on both."""
    sides = (int(mi.BSDFFlags.FrontSide), int(mi.BSDFFlags.BackSide))
    return max(sum(_is_mirror(f) and bool(f & side or not f & sum(sides)) for f in components) for side in sides)
