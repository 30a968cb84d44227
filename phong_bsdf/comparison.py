"""A scene as it is and with its `phong` and `blinnphong` surfaces swapped for physical ones -> records and pictures."""

import gc
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import mitsuba as mi
import numpy as np

from . import curves, matching, metrics, needs, rendering, surfaces

ORIGINAL = "original"
# The picture with the BSDFs that the user gave one by one.
GIVEN = "given"

UNMEASURED = "has a perfect mirror, which its curves leave out"


@dataclass(frozen=True)
class Choice:
    """A BSDF that the user gave for one surface."""

    surface: str
    plugin: str
    parameters: Mapping[str, object]
    """Numbers, colours (tuples), booleans or words."""


@dataclass(frozen=True)
class Replacement:
    """What a surface is in one of the pictures."""

    picture: str
    surface: str
    where: str
    """File and line of the surface."""
    plugin: str
    parameters: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]
    """What could not be matched."""


@dataclass(frozen=True)
class Row:
    """One picture: what it took, and how far it is from the original."""

    picture: str
    swapped: int
    """Surfaces that are not the original's."""
    mse: float | None
    """None for the original itself, as the other errors are; see `metrics.Errors`."""
    relmse: float | None
    max_error: float | None
    flip: float | None
    mean: float
    """Mean over pixels and colours."""
    nonfinite: int
    """Pixels that are not numbers; the errors are NaN then."""
    width: int
    height: int
    spp: int
    seed: int
    seconds_loading: float
    seconds_compiling: float
    seconds_rendering: float


@dataclass(frozen=True)
class Comparison:
    """All there is to report."""

    scene: str
    integrator: str
    """Name of its plugin."""
    rows: tuple[Row, ...]
    """The original first."""
    replacements: tuple[Replacement, ...]
    curves: tuple[curves.Curves, ...]
    images: Mapping[str, np.ndarray]
    """Picture name -> colours, (height, width, 1 or 3)."""


@dataclass(frozen=True)
class Plan:
    """What will be rendered: checked, but not loaded."""

    path: Path
    states: Mapping[str, object]
    """Picture name -> parsed scene."""
    replacements: tuple[Replacement, ...]
    curves: tuple[curves.Curves, ...]


def plan(
    path: Path,
    defines: Mapping[str, str] | None = None,
    *,
    against: Sequence[str] = (),
    given: Sequence[Choice] = (),
) -> Plan:
    """Parse the scene and swap its surfaces, matched and checked; ValueError where that is not possible.

    Each plugin of `against` makes one picture in which it replaces every lobe BSDF. All of
    `given` together make one more, in which only the surfaces named are replaced. With neither,
    `roughplastic` replaces them all.
    """
    for plugin in against:
        if plugin not in matching.TARGETS:
            raise ValueError(f"compare: '{plugin}' cannot be matched, only {', '.join(matching.TARGETS)}; "
                             f"give other BSDFs with all their parameters: --bsdf id={plugin},name=value")  # fmt: skip
    state = rendering.parse(path, defines)
    found = {surface.name: surface for surface in surfaces.find(state, lambda root: rendering.make(path, root))}
    if not found:
        raise ValueError(f"{path}: the scene has no phong or blinnphong BSDF to compare")
    _check_given(given, found)
    jobs = {plugin: [(surface, plugin, {}) for surface in found.values()] for plugin in dict.fromkeys(against)}
    if given:
        jobs[GIVEN] = [(found[choice.surface], choice.plugin, choice.parameters) for choice in given]
    elif not against:
        jobs["roughplastic"] = [(surface, "roughplastic", {}) for surface in found.values()]

    states, replacements, measured = {ORIGINAL: state}, [], []
    for surface in found.values():
        replacements.append(_shown(ORIGINAL, surface, _own(surface.lobe), surface.notes))
        measured.append(_measure(mi.load_dict(surfaces.original(surface.lobe)), surface, ORIGINAL, surface.lobe.plugin))
    for picture, swaps in jobs.items():
        states[picture] = state
        for surface, plugin, parameters in swaps:
            matched = _match(path, state, plugin, surface, parameters)
            states[picture] = surfaces.replaced(states[picture], surface, matched.plugin, matched.parameters)
            bsdf = rendering.make(path, surfaces.alone(states[picture], surface))
            mirror = [UNMEASURED] if bsdf.flags() & needs.DELTA else []
            replacements.append(_shown(picture, surface, matched, [*matched.notes, *mirror]))
            measured.append(_measure(bsdf, surface, picture, matched.plugin))
    return Plan(Path(path), states, tuple(replacements), tuple(measured))


def run(
    planned: Plan,
    *,
    camera: int = 1,
    spp: int = 0,
    size: tuple[int, int] | None = None,
    seed: int = 0,
    on_progress: Callable[[str, float], None] = lambda picture, share: None,
) -> Comparison:
    """Render every picture of the plan and compare it with the first."""
    rows, images = [], {}
    for picture, state in planned.states.items():
        on_progress(picture, 0)
        # A scene that lives on would slow the next one: each kernel holds every BSDF that is alive.
        gc.collect()
        loaded = rendering.load_parsed(planned.path, state)
        if size:
            rendering.resize(loaded, camera, *size)
        result = rendering.render(
            loaded, camera=camera, spp=spp, seed=seed, on_progress=lambda share, p=picture: on_progress(p, share)
        )
        swapped = sum(r.picture == picture for r in planned.replacements) if picture != ORIGINAL else 0
        rows.append(_row(picture, swapped, loaded, result, images.get(ORIGINAL)))
        images[picture] = metrics.colors(result.image)
        del loaded
    integrators = (n.props.plugin_name() for n in state.nodes if n.type == mi.ObjectType.Integrator)
    return Comparison(planned.path.name, next(integrators), tuple(rows), planned.replacements, planned.curves, images)


def _check_given(given: Sequence[Choice], found: Mapping[str, surfaces.Surface]) -> None:
    for i, choice in enumerate(given):
        if choice.surface not in found:
            known = ", ".join(f"{surface.name} ({surface.where})" for surface in found.values())
            raise ValueError(f"compare: the scene has no phong or blinnphong BSDF '{choice.surface}', only {known}")
        if choice.surface in [other.surface for other in given[:i]]:
            raise ValueError(f"compare: --bsdf {choice.surface}= is given twice; one picture shows one BSDF there")


def _row(picture, swapped, loaded, result, reference) -> Row:
    image = metrics.colors(result.image)
    errors = metrics.errors(image, reference) if reference is not None else metrics.Errors(None, None, None, None)
    height, width = image.shape[:2]
    return Row(
        picture, swapped, errors.mse, errors.relmse, errors.max_error, errors.flip, metrics.energy(image),
        metrics.nonfinite(image), width, height, result.spp, result.seed,
        loaded.seconds, result.seconds_compiling, result.seconds_rendering,
    )  # fmt: skip


def _match(path: Path, state, plugin: str, surface: surfaces.Surface, parameters: Mapping[str, object]) -> matching.Match:
    if plugin not in matching.TARGETS:
        return matching.Match(plugin, dict(parameters))
    if parameters:
        # Mistakes are found here, where the surface's line is known.
        rendering.make(path, surfaces.alone(surfaces.replaced(state, surface, plugin, parameters), surface))
    textured = bool({"ks", "specular_reflectance"} & set(surface.textured))
    return matching.match(plugin, surface.lobe, _specular_albedo, parameters, textured)


def _specular_albedo(description: dict) -> float:
    values = {k: surfaces.color(v) if isinstance(v, tuple) else v for k, v in description.items()}
    return curves.albedo(mi.load_dict(values), 0)


def _own(lobe: matching.Lobe) -> matching.Match:
    """The original's own parameters."""
    names = surfaces.REFLECTANCES if lobe.reflectances else surfaces.COEFFICIENTS
    values = (lobe.diffuse, lobe.specular, lobe.exponent)
    return matching.Match(lobe.plugin, dict(zip(names, values, strict=True)))


def _shown(picture, surface, matched: matching.Match, notes) -> Replacement:
    parameters = tuple((name, _text(value, name, surface)) for name, value in matched.parameters.items())
    return Replacement(picture, surface.name, surface.where, matched.plugin, parameters, tuple(notes))


def _text(value, name: str, surface: surfaces.Surface) -> str:
    if isinstance(value, matching.Carried):
        names = ("kd", "diffuse_reflectance") if value.scale == "diffuse" else ("ks", "specular_reflectance")
        if set(names) & set(surface.textured):
            return "the original's texture"
        value = surface.lobe.diffuse if value.scale == "diffuse" else surface.lobe.specular
    elif name in surface.textured:
        return f"texture, mean {_text(value, '', surface)}"
    if isinstance(value, tuple):
        return _text(value[0], "", surface) if len(set(value)) == 1 else " ".join(f"{x:.4g}" for x in value)
    return f"{value:.4g}" if isinstance(value, float) else str(value).lower() if isinstance(value, bool) else str(value)


def _measure(bsdf, surface, picture, plugin) -> curves.Curves:
    return curves.measure(bsdf, surface.name, picture, plugin, 2 * surface.lobe.alpha)
