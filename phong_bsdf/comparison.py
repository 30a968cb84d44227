"""A scene as it is and with its `phong` and `blinnphong` surfaces swapped for physical ones -> records and pictures."""

import gc
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path

import mitsuba as mi
import numpy as np

from .pictures import metrics
from .reflection import curves, matching
from .scene import rendering, surfaces
from .tracing import needs

__all__ = ["Choice", "Comparison", "Plan", "Replacement", "Row", "plan", "run"]

ORIGINAL = "original"
# The picture with the BSDFs that the user gave one by one.
GIVEN = "given"


@dataclass(frozen=True)
class Choice:
    """A BSDF that the user gave for one surface."""

    surface: str
    """Its name in the scene."""
    plugin: str
    parameters: Mapping[str, object]
    """Numbers, colours (tuples), booleans or words."""


@dataclass(frozen=True)
class Replacement:
    """What a surface is in one of the pictures."""

    picture: str
    """`original`, the plugin of `against`, or `given`."""
    surface: str
    """Its name in the scene."""
    where: str
    """File and line of the surface."""
    plugin: str
    parameters: tuple[tuple[str, str], ...]
    """Names and values, as a user reads them."""
    notes: tuple[str, ...]
    """What could not be matched."""


@dataclass(frozen=True)
class Row:
    """One picture: what it took, and how far it is from the original."""

    picture: str
    """`original`, the plugin of `against`, or `given`."""
    swapped: int
    """Surfaces that are not the original's."""
    mse: float | None
    """None for the original itself, as the other errors are; see `metrics.Errors`."""
    relmse: float | None
    max_error: float | None
    flip: float | None
    mean: float
    """Mean over pixels and colours, linear."""
    nonfinite: int
    """Pixels that are not numbers; the errors are NaN then."""
    width: int
    """Pixels, as the height."""
    height: int
    spp: int
    """Samples per pixel."""
    seed: int
    seconds_loading: float
    seconds_compiling: float
    seconds_rendering: float


@dataclass(frozen=True)
class Comparison:
    """All there is to report."""

    scene: str
    """Name of its file."""
    integrator: str
    """Name of its plugin."""
    rows: tuple[Row, ...]
    """The original first."""
    replacements: tuple[Replacement, ...]
    curves: tuple[curves.Curves, ...]
    """Of each surface in each picture."""
    images: Mapping[str, np.ndarray]
    """Picture name -> colours, linear, (height, width, 1 or 3), float32."""


@dataclass(frozen=True)
class Plan:
    """What will be rendered: checked, but not loaded."""

    path: Path
    states: Mapping[str, "mi.parser.ParserState"]
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
    """Parse the scene in the active variant and swap its surfaces, matched and checked.

    `defines` gives values for its `<default>`s. ValueError (SceneError where the scene is at fault) where that is not
    possible. Each plugin of `against` makes one picture in which it replaces every lobe BSDF. All of
    `given` together make one more, in which only the surfaces named are replaced. With neither,
    `roughplastic` replaces them all.
    """
    for plugin in against:
        if plugin not in matching.TARGETS:
            raise ValueError(f"compare: '{plugin}' cannot be matched, only {', '.join(matching.TARGETS)}; "
                             f"give other BSDFs with all their parameters: --bsdf id={plugin},name=value")  # fmt: skip
    state = rendering.parse(path, defines, merge=False)
    rendering.check(path, state)
    found = {surface.name: surface for surface in surfaces.find(state, lambda root: rendering.make(path, root))}
    if not found:
        raise ValueError(f"{path}: the scene has no phong or blinnphong BSDF to compare")
    _check_given(given, found)

    jobs = {plugin: [Choice(name, plugin, {}) for name in found] for plugin in against}
    if given:
        jobs[GIVEN] = list(given)
    elif not against:
        jobs["roughplastic"] = [Choice(name, "roughplastic", {}) for name in found]
    states, measured = {ORIGINAL: state}, [_original(path, state, surface) for surface in found.values()]
    for picture, choices in jobs.items():
        states[picture] = state
        for choice in choices:
            states[picture], shown, curve = _swap(path, states[picture], picture, found[choice.surface], choice)
            measured.append((shown, curve))
    replacements, curved = zip(*measured, strict=True)
    return Plan(Path(path), states, replacements, curved)


def run(
    planned: Plan,
    *,
    camera: int = 1,
    spp: int = 0,
    size: tuple[int, int] | None = None,
    seed: int = 0,
    on_progress: Callable[[str, float], None] = lambda picture, share: None,
) -> Comparison:
    """Render every picture of the plan and compare it with the first.

    `camera` counts from 1; `spp` samples per pixel (0: as the scene says); `size` (width, height) in pixels.
    `on_progress` hears the name of a picture and the share of it that is done. SceneError where one cannot be rendered.
    """
    rows, images = [], {}
    for picture, state in planned.states.items():
        on_progress(picture, 0)
        # A scene that lives on would slow the next one: each kernel holds every BSDF that is alive.
        gc.collect()
        loaded = rendering.load_parsed(planned.path, state)
        if size:
            rendering.resize(loaded, camera, *size)
        result = rendering.render(
            loaded, camera=camera, spp=spp, seed=seed, color=True,
            on_progress=lambda share, p=picture: on_progress(p, share),
        )  # fmt: skip
        swapped = sum(r.picture == picture for r in planned.replacements) if picture != ORIGINAL else 0
        rows.append(_row(picture, swapped, loaded, result, images.get(ORIGINAL)))
        images[picture] = metrics.colors(result.image)
        del loaded
    integrators = (n.props.plugin_name() for n in state.nodes if n.type == mi.ObjectType.Integrator)
    return Comparison(planned.path.name, next(integrators), tuple(rows), planned.replacements, planned.curves, images)


def swapped(path: Path, state, plugin: str):
    """The parsed scene with `plugin`, matched, in place of each lobe BSDF; ValueError where one cannot be matched."""
    for surface in surfaces.find(state, lambda root: rendering.make(path, root)):
        matched = matching.match(plugin, surface.lobe, _specular_albedo, {}, surface.is_textured("specular"))
        state = surfaces.replaced(state, surface, matched.plugin, matched.parameters)
    return state


def _check_given(given: Sequence[Choice], found: Mapping[str, surfaces.Surface]) -> None:
    for i, choice in enumerate(given):
        if choice.surface not in found:
            known = ", ".join(f"{surface.name} ({surface.where})" for surface in found.values())
            raise ValueError(f"compare: the scene has no phong or blinnphong BSDF '{choice.surface}', only {known}")
        if choice.surface in [other.surface for other in given[:i]]:
            raise ValueError(f"compare: --bsdf {choice.surface}= is given twice; one picture shows one BSDF there")


def _row(picture, swapped, loaded, result, reference) -> Row:
    image = metrics.colors(result.image)
    errors = (None,) * 4 if reference is None else astuple(metrics.errors(image, reference))
    mse, relmse, max_error, flip = errors
    height, width = image.shape[:2]
    return Row(
        picture, swapped, mse, relmse, max_error, flip, metrics.energy(image),
        metrics.nonfinite(image), width, height, result.spp, result.seed,
        loaded.seconds, result.seconds_compiling, result.seconds_rendering,
    )  # fmt: skip


def _original(path: Path, state, surface: surfaces.Surface) -> tuple[Replacement, curves.Curves]:
    """What a surface is, and its curves; those of a textured one are for its means."""
    lobe = surface.lobe
    bsdf = rendering.make(path, surfaces.alone(state, surface))
    means = surfaces.parameters(lobe)
    if surface.textured:
        bsdf = _load({"type": lobe.plugin, **means})
    texts = tuple(
        (name, ("texture, mean " if name in surface.textured else "") + _text(value)) for name, value in means.items()
    )
    shown = Replacement(ORIGINAL, surface.name, surface.where, lobe.plugin, texts, surface.notes)
    return shown, curves.measure(bsdf, surface.name, ORIGINAL, lobe.plugin, 2 * lobe.alpha)


def _swap(path: Path, state, picture: str, surface: surfaces.Surface, choice: Choice):
    """The scene with `choice` in place of a surface; what that is, and its curves."""
    plugin, parameters, notes = choice.plugin, choice.parameters, []
    if parameters or plugin not in matching.TARGETS:
        # Mistakes are found here, where the surface's line is known.
        rendering.make(path, surfaces.alone(surfaces.replaced(state, surface, plugin, parameters), surface))
    if plugin in matching.TARGETS:
        textured = surface.is_textured("specular")
        matched = matching.match(plugin, surface.lobe, _specular_albedo, parameters, textured)
        plugin, parameters, notes = matched.plugin, matched.parameters, list(matched.notes)
    state = surfaces.replaced(state, surface, plugin, parameters)
    bsdf = rendering.make(path, surfaces.alone(state, surface))
    if surface.textured:
        bsdf = _load({"type": plugin, **{name: _mean(value, surface) for name, value in parameters.items()}})
    if bsdf.flags() & needs.DELTA:
        notes.append("has a perfect mirror, which its curves leave out")
    texts = tuple(
        (name, "the original's texture" if _is_texture(value, surface) else _text(_mean(value, surface)))
        for name, value in parameters.items()
    )
    shown = Replacement(picture, surface.name, surface.where, plugin, texts, tuple(notes))
    return state, shown, curves.measure(bsdf, surface.name, picture, plugin, 2 * surface.lobe.alpha)


def _specular_albedo(description: Mapping[str, object]) -> float:
    """The albedo at normal incidence of a BSDF, described as `mitsuba.load_dict` takes it, but for its colours."""
    return curves.albedo(_load(description), 0)


def _load(description: Mapping[str, object]):
    return mi.load_dict({k: surfaces.color(v) if isinstance(v, tuple) else v for k, v in description.items()})


def _mean(value, surface: surfaces.Surface):
    """A parameter's value; of one carried over from the original, its mean."""
    return getattr(surface.lobe, value.scale) if isinstance(value, matching.Carried) else value


def _is_texture(value, surface: surfaces.Surface) -> bool:
    return isinstance(value, matching.Carried) and surface.is_textured(value.scale)


def _text(value) -> str:
    """A parameter as a user reads it."""
    if isinstance(value, tuple):
        return " ".join(f"{x:.4g}" for x in (value if len(set(value)) > 1 else value[:1]))
    return f"{value:.4g}" if isinstance(value, float) else str(value).lower() if isinstance(value, bool) else str(value)
