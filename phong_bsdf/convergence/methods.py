"""Ways to render a scene that can be compared: integrator, sampler, sampling of the lobes, other BSDFs.

A method changes the nodes of a parsed scene. Its limit is the method whose converged picture it is measured against.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import mitsuba as mi

from .. import comparison
from ..reflection import matching
from ..reflection.lobes import LOBES
from ..reflection.vocabulary import MIXTURE, SAMPLINGS
from ..scene import rendering, surfaces
from ..tracing import needs

SAMPLERS = ("independent", "stratified", "multijitter", "ldsampler")
REFERENCES = ("scene", "own")

# Its plugin; `rendering.WHITTED` is its class.
WHITTED = "whitted"

# What a scene's integrator hands on to another one, with what Mitsuba takes where the scene is silent.
HANDED_ON = {"max_depth": -1, "hide_emitters": False}
TAKES = {"path": ("max_depth", "hide_emitters"), "direct": ("hide_emitters",), WHITTED: ("max_depth", "hide_emitters")}
WHITTED_DEPTH = 10


@dataclass(frozen=True)
class Method:
    """One way to render the scene."""

    name: str
    integrator: str = ""
    """Its plugin; empty: the scene's own."""
    parameters: Mapping[str, object] = field(default_factory=dict)
    """Of the integrator."""
    sampler: str = "independent"
    sampling: str = MIXTURE
    """How `phong` and `blinnphong` draw directions."""
    bsdf: str = ""
    """What takes their place, matched; empty: nothing does."""
    reference: str = "scene"
    """`scene`: what the scene file describes, as far as the method can mean that; `own`: its own limit."""

    levels: tuple[int, ...] = ()
    """Samples per pixel to measure at; empty: as all methods."""

    def spec(self) -> dict[str, Any]:
        """All that its pictures depend on."""
        return {name: value for name, value in vars(self).items() if name not in ("name", "levels")}


@dataclass(frozen=True)
class Scene:
    """A parsed scene, and what its methods depend on."""

    path: Path
    state: "mi.parser.ParserState"
    integrator: str
    lobes: tuple[int, ...]
    """Its `phong` and `blinnphong` nodes."""
    only_delta_lights: bool
    course: bool
    """Whether it is a `whitted` scene in the course convention, which no other integrator can render."""

    @property
    def base(self) -> str:
        """The Monte Carlo integrator that the variants are made of."""
        return "path" if self.integrator == WHITTED else self.integrator


def read(path: Path, defines: Mapping[str, str] | None = None) -> Scene:
    """Parse a scene; ValueError for one that cannot be compared."""
    # Merged later: replacing a BSDF needs its id.
    state = rendering.parse(path, defines, merge=False)
    rendering.check(path, state)
    props = _integrator(path, state).props
    emitters = [node.props.plugin_name() for node in state.nodes if node.type == mi.ObjectType.Emitter]
    lobes = (i for i, node in enumerate(state.nodes) if node.props.plugin_name() in LOBES)
    integrator = props.plugin_name()
    course = integrator == WHITTED and props.get("convention", "course") == "course"
    return Scene(Path(path), state, integrator, tuple(lobes), all(e in needs.LIGHTS for e in emitters), course)


def defaults(scene: Scene) -> list[Method]:
    """The methods that the scene supports."""
    base = scene.base
    found = []
    if scene.integrator == WHITTED or scene.only_delta_lights:
        found.append(Method(WHITTED, WHITTED))
    found += [Method(name, name) for name in dict.fromkeys((base, "path", "direct"))]
    if scene.lobes:
        found += [Method(f"{base}-{sampling}", base, sampling=sampling) for sampling in SAMPLINGS[1:]]
    found += [Method(f"{base}-{sampler}", base, sampler=sampler) for sampler in SAMPLERS[1:]]
    physical = Method(f"{base}-roughplastic", base, bsdf="roughplastic")
    return [*found, physical] if scene.lobes and _can_be_applied(scene, physical) else found


def _can_be_applied(scene: Scene, method: Method) -> bool:
    try:
        applied(scene, method)
    except ValueError:
        return False
    return True


def chosen(scene: Scene, given: Sequence[tuple[str, Mapping[str, object]]]) -> list[Method]:
    """The methods that a user asked for, as (name, specification); all that the scene supports if none."""
    known = {method.name: method for method in defaults(scene)}
    if not given:
        return list(known.values())
    names = [name for name, _ in given]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"converge: there are two methods '{name}'; give each its own name")
    return [_method(scene, known, name, spec) for name, spec in given]


def _method(scene: Scene, known: Mapping[str, Method], name: str, spec: Mapping[str, object]) -> Method:
    if not re.fullmatch(r"\w[\w.+-]*", name):
        raise ValueError(f"converge: '{name}' is no name for a method; use letters, digits and . + - _")
    if not spec:
        if name not in known:
            raise ValueError(f"converge: there is no method '{name}' for this scene, only {', '.join(known)}; "
                             f"specify it: --method {name}=integrator=path,sampler=stratified")  # fmt: skip
        return known[name]
    own = {key: spec[key] for key in ("integrator", "sampler", "sampling", "bsdf", "reference") if key in spec}
    parameters = {key: value for key, value in spec.items() if key not in (*own, "spp")}
    # A new specification under a known name changes that method.
    method = replace(known.get(name, Method(name)), **own, parameters=parameters, levels=_levels(name, spec))
    allowed = {"sampling": SAMPLINGS, "reference": REFERENCES, "bsdf": ("", *matching.TARGETS)}
    for key, values in allowed.items():
        if getattr(method, key) not in values:
            words = ", ".join(filter(None, values))
            raise ValueError(f"converge: method '{name}': '{key}' must be one of {words}, got '{getattr(method, key)}'")
    if (method.bsdf or method.sampling != MIXTURE) and not scene.lobes:
        raise ValueError(f"converge: method '{name}': the scene has no phong or blinnphong BSDF")
    if method.bsdf and method.sampling != MIXTURE:
        raise ValueError(f"converge: method '{name}': 'sampling' is of the BSDFs that 'bsdf' takes away; give one")
    _check(scene, method)
    return method


def _levels(name: str, spec: Mapping[str, object]) -> tuple[int, ...]:
    """`spp`, as numbers with spaces between them."""
    texts = str(spec.get("spp", "")).split()
    if not all(text.isdigit() and int(text) > 0 for text in texts):
        raise ValueError(f"converge: method '{name}': 'spp' must be numbers of samples, 1 4 16, got '{spec['spp']}'")
    return tuple(sorted({int(text) for text in texts}))


def _check(scene: Scene, method: Method) -> None:
    """ValueError where the integrator or the sampler does not exist or does not take its parameters."""
    state = applied(scene, replace(method, bsdf="", sampling=MIXTURE))
    for kind in (mi.ObjectType.Integrator, mi.ObjectType.Sampler):
        alone = mi.parser.ParserState(state)
        alone.nodes[0] = next(node for node in state.nodes if node.type == kind)
        try:
            rendering.make(scene.path, alone)
        except ValueError as error:
            raise ValueError(f"converge: method '{method.name}': {error}") from None


def integrator_of(scene: Scene, method: Method) -> str:
    """The integrator's plugin."""
    return method.integrator or scene.integrator


def limit(scene: Scene, method: Method) -> Method:
    """The method whose converged picture `method` is compared with."""
    if method.reference == "own":
        return replace(method, name=f"{method.name}.own", sampler="independent")
    plugin = integrator_of(scene, method)
    convention = method.parameters.get("convention", "course" if scene.course else "physical")
    course = plugin == WHITTED and convention == "course"
    if course == scene.course:
        plugin, parameters = scene.integrator, {}
    elif course:
        parameters = {"convention": "course"}
    else:
        plugin, parameters = "path", {}
    return Method("-".join(filter(None, (plugin, method.bsdf))), plugin, parameters, bsdf=method.bsdf)


def applied(scene: Scene, method: Method):
    """The parsed scene as `method` renders it, with equal nodes merged as Mitsuba does on loading."""
    state = mi.parser.ParserState(scene.state)
    if method.bsdf:
        state = comparison.swapped(scene.path, state, method.bsdf)
    elif method.sampling != MIXTURE:
        for index in scene.lobes:
            _change(state, index, {"sampling": method.sampling})
    _set_integrator(scene, state, method)
    # First all of them: a sampler that is added may move the nodes in memory, and what refers to one is invalid then.
    sensors = [index for index, node in enumerate(state.nodes) if node.type == mi.ObjectType.Sensor]
    for index in sensors:
        _set_sampler(state, index, method.sampler)
    return state


def _integrator(path: Path, state):
    node = next((node for node in state.nodes if node.type == mi.ObjectType.Integrator), None)
    if node is None:
        raise rendering.SceneError(f'{path}: the scene has no integrator; add <integrator type="path"/>')
    return node


def _set_integrator(scene: Scene, state, method: Method) -> None:
    index = next(i for i, node in enumerate(state.nodes) if node.type == mi.ObjectType.Integrator)
    before, plugin = state.nodes[index].props, integrator_of(scene, method)
    if plugin == scene.integrator:
        _change(state, index, method.parameters)
        return
    node = mi.parser.SceneNode(state.nodes[index])
    node.props = mi.Properties(plugin)
    silent = {**HANDED_ON, "max_depth": WHITTED_DEPTH} if scene.integrator == WHITTED else HANDED_ON
    for name in TAKES.get(plugin, ()):
        node.props[name] = before.get(name, silent[name])
    if plugin == WHITTED:
        node.props["convention"] = "physical"
    state.nodes[index] = node
    _change(state, index, method.parameters)


def _set_sampler(state, sensor: int, plugin: str) -> None:
    """Every method has its own sampler; how many samples it takes is said when it renders."""
    props = state.nodes[sensor].props
    found = [i for i in surfaces.children(props) if state.nodes[i].type == mi.ObjectType.Sampler]
    node = mi.parser.SceneNode(state.nodes[found[0] if found else sensor])
    node.type, node.props = mi.ObjectType.Sampler, mi.Properties(plugin)
    node.props["sample_count"] = 4
    if found:
        state.nodes[found[0]] = node
    else:
        state.nodes.append(node)
        _change(state, sensor, {"sampler": mi.Properties.ResolvedReference(len(state.nodes) - 1)})


def _change(state, index: int, parameters: Mapping[str, object]) -> None:
    """Set parameters of a node; a node is changed by assigning a changed copy."""
    if parameters:
        node = mi.parser.SceneNode(state.nodes[index])
        props = mi.Properties(node.props)
        for name, value in parameters.items():
            props[name] = value
        node.props = props
        state.nodes[index] = node
