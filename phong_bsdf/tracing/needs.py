"""What a scene uses, hence what the kernels that render it can leave out.

`whitted` asks before it builds a kernel; `phong-bsdf explain` shows the answers. Everything here is known on the
host: no array is read.
"""

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from ..reflection.parameters import numbers

# Component flags of mirrors and glass, and of what lets rays straight through.
DELTA = int(mi.BSDFFlags.DeltaReflection) | int(mi.BSDFFlags.DeltaTransmission)
NULL = int(mi.BSDFFlags.Null)

# A private bit of `mirrorblend`, above all of Mitsuba's own. In a component's flags:
# this mirror can be taken away. In a context's type mask: take it away, and show what
# is under it undiminished. Adapters (`twosided`, `mask`, ...) pass both on.
MIRRORLESS = 1 << 30

# Another, in type masks only: `si.wi` says no more than from which side the surface is seen (`facing.py`).
COURSE = 1 << 29

# With it: some BSDF of the scene tilts normals.
TILTED = 1 << 28

# `BSDFContext.component` where all are meant.
ALL_COMPONENTS = 0xFFFFFFFF

# Emitters that `whitted` serves: plugin -> class.
LIGHTS = {"point": "PointLight", "spot": "SpotLight", "projector": "Projector", "directional": "DirectionalEmitter"}
BACKGROUNDS = {"constant": "ConstantBackgroundEmitter", "envmap": "EnvironmentMapEmitter"}
PLUGIN_OF = {name: plugin for plugin, name in {**LIGHTS, **BACKGROUNDS}.items()}

# Shapes without triangles. A scene of others needs the flag, or rays slip between the triangles of its meshes.
ANALYTIC = ("sphere", "rectangle", "disk", "cylinder")
ROBUST = "embree_use_robust_intersections"

# What a kernel holds only where the scene needs it, and what it lacks where not; `keep` of the functions below names
# what it holds all the same.
FEATURES = {
    "bsdf calls": "BSDF calls, texture lookups",
    "materials": "lookup of each hit's constants",
    "diffuse": "diffuse part",
    "highlights": "lobe",
    "mirrors": "loop over bounces",
    "branches": "stack of waiting rays",
    "transparency": "rays straight through",
    "last bounce": "look under the last mirror",
    "lights": "loop: each is in the kernel",
    "light calls": "light calls at each hit",
    "ambient": "ambient term",
    "film block": "weights, atomic sums",
}

# Where a feature means nothing without another.
REQUIRED = {"transparency": ("bsdf calls",), "branches": ("mirrors",), "last bounce": ("mirrors",)}

# Lengths of axes, as shares of the longest, that count as alike: exporters write six digits, and no pixel shows more.
UNLIKE = 1e-4

# Remedies for what Mitsuba or `whitted` would leave out.
ELLIPSOIDS = "use the shape 'ellipsoids' with its 'extent' = 1, or a mesh"
VOLPATH = "use the integrator 'volpath', or take the medium out"


class UnsupportedScene(ValueError):
    """The scene holds something that the `whitted` integrator cannot render."""


@dataclass(frozen=True)
class DeltaLobes:
    """The mirrors, glass and holes among the BSDFs of a scene."""

    mirrors: tuple[tuple[int, tuple], ...] = ()
    """For each component index at which some BSDF has a delta lobe: the index, and the BSDFs that have delta lobes
    but none there. Mitsuba's adapters do not all refuse a component that they lack."""

    masks: bool = False
    """Whether some surface lets rays straight through (`mask`, `null`)."""

    masked_mirrors: bool = False
    """Whether such a surface also has a mirror."""

    branches: int = 0
    """Most delta lobes that one surface can show at once: 0 no mirror, 1 a path, 2 or more a tree."""

    fading: bool = False
    """Whether some mirror is a `mirrorblend`, which the course's last bounce takes away."""


def check_lights(scene) -> None:
    """Raises `UnsupportedScene` for lights that have no single direction."""
    for emitter in scene.emitters():
        if not is_delta(emitter) and emitter.class_name() not in BACKGROUNDS.values():
            raise UnsupportedScene(refusal(emitter.id() or emitter.class_name()))


def left_out(scene) -> str | None:
    """What of a loaded scene no picture of `whitted` shows, in one sentence; None where all is shown.

    It reads the transforms of spheres: not for functions that are recorded.
    """
    shapes = {shape.ptr: shape for shape in scene.shapes()}
    if has_instances(scene):
        # The shapes inside of them are not listed, but have parameters.
        nodes = [node for _, _, node, _ in mi.traverse(scene).properties.values()]
        shapes.update((node.ptr, node) for node in nodes if isinstance(node, mi.Shape))
    spheres = [s for s in shapes.values() if s.class_name() == "Sphere"]
    round_ones = [s.id() or "sphere" for s in spheres if stretched(axes(linear_part(s)))]
    media = [s.id() or s.class_name() for s in shapes.values() if s.interior_medium() or s.exterior_medium()]
    media += [s.id() or s.class_name() for s in scene.sensors() if s.get_medium()]
    said = []
    if round_ones:
        said.append(f"Mitsuba draws {_listed('sphere', round_ones)} round, though stretched; {ELLIPSOIDS}")
    if media:
        said.append(f"the medium of {_listed('', media)} is not rendered; {VOLPATH}")
    return "whitted: " + ". ".join(said) if said else None


def axes(matrix) -> list[float]:
    """The lengths, longest first, of the axes of the ellipsoid that the 3 x 3 `matrix` makes of a unit sphere."""
    # Late: only scenes with spheres need it.
    import numpy as np

    matrix = np.asarray(matrix, np.float64)
    return [float(x) for x in np.linalg.svd(matrix, compute_uv=False)] if np.all(np.isfinite(matrix)) else [np.nan] * 3


def stretched(lengths) -> bool:
    """Whether the `axes` are not all of one length."""
    return lengths[0] - lengths[2] > UNLIKE * lengths[0]


def delta_lobes(scene, keep=frozenset()) -> DeltaLobes:
    """The delta lobes of all BSDFs of `scene`, and those that `keep` asks to be prepared for."""
    bsdfs = bsdfs_of(scene)
    for bsdf in bsdfs:
        if hasattr(bsdf, "refresh"):
            bsdf.refresh()
    return delta_lobes_of(bsdfs, keep)


def delta_lobes_of(bsdfs, keep=frozenset()) -> DeltaLobes:
    """The delta lobes of `bsdfs`."""
    components = [[bsdf.flags(i) for i in range(bsdf.component_count())] for bsdf in bsdfs]
    masked = [any(f & NULL for f in flags) for flags in components]
    mirrors = [
        set() if mask else {i for i, f in enumerate(flags) if f & DELTA}
        for flags, mask in zip(components, masked, strict=True)
    ]
    special = [bool(found) or mask for found, mask in zip(mirrors, masked, strict=True)]
    kept = [{i} for i, feature in enumerate(("mirrors", "branches")) if feature in keep]
    found = DeltaLobes(
        mirrors=tuple(
            (i, tuple(b for b, found, other in zip(bsdfs, mirrors, special, strict=True) if other and i not in found))
            for i in sorted(set().union(*mirrors, *kept))
        ),
        masks=any(masked),
        masked_mirrors=any(
            mask and any(f & DELTA for f in flags) for flags, mask in zip(components, masked, strict=True)
        ),
        branches=max((_branches(flags) for flags in components), default=0),
        fading=any(f & MIRRORLESS for flags in components for f in flags),
    )
    return prepared(found, keep)


def prepared(found: DeltaLobes, keep) -> DeltaLobes:
    """`found`, and what `keep` asks to be prepared for though no BSDF has it."""
    through = "transparency" in keep
    return replace(
        found,
        masks=found.masks or through,
        masked_mirrors=found.masked_mirrors or through,
        branches=max(found.branches, "mirrors" in keep, 2 * ("branches" in keep)),
        fading=found.fading or "last bounce" in keep,
    )


def has_instances(scene) -> bool:
    """Whether some shape is an instance: what is inside of it, Mitsuba does not list."""
    return any(shape.class_name() == "Instance" for shape in scene.shapes())


def wake(scene) -> None:
    """Tell the BSDFs of `scene` which constants are being differentiated: a 0 among them must not be left out."""
    params = mi.traverse(scene)
    for key, (_, _, node, _) in params.properties.items():
        if isinstance(node, mi.Texture) and dr.grad_enabled(params[key]) and dr.width(params[key]) == 1:
            params.set_dirty(key)
    params.update()


def bsdfs_of(scene) -> list:
    """Every BSDF that a ray can meet in `scene`."""
    found = {bsdf.ptr: bsdf for bsdf in (shape.bsdf() for shape in scene.shapes()) if bsdf is not None}
    if dr.is_jit_v(mi.Float) and has_instances(scene):
        # Ask for every BSDF alive, of other scenes too.
        missing, i = 0, 1
        while missing < 64:
            try:
                bsdf = dr.reinterpret_array(mi.BSDFPtr, mi.UInt32(i))[0]
            except RuntimeError:
                bsdf = None
            missing = missing + 1 if bsdf is None else 0
            if bsdf is not None:
                found[bsdf.ptr] = bsdf
            i += 1
    return list(found.values())


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


def _branches(components: list[int]) -> int:
    """Most delta lobes on one side; a component that names no side counts on both."""
    sides = (int(mi.BSDFFlags.FrontSide), int(mi.BSDFFlags.BackSide))
    deltas = [f for f in components if f & (DELTA | NULL)]
    return max(sum(bool(f & side or not f & sum(sides)) for f in deltas) for side in sides)


def linear_part(shape) -> list[list[float]]:
    """The 3 x 3 part of `to_world`."""
    matrix = numbers(mi.traverse(shape)["to_world"].matrix)
    return [matrix[row : row + 3] for row in (0, 4, 8)]


def _listed(kind: str, names: list[str], most: int = 3) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return f"{kind} ".lstrip() + ", ".join(f"'{name}'" for name in names[:most]) + more
