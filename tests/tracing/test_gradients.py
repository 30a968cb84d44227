"""Derivatives of pictures: those of the float64 oracle, for all that a scene has."""

import gc
import math
import sys
from dataclasses import replace
from unittest import mock

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from helpers import oracle
from helpers.oracle import Light, Scene, Sphere
from helpers.small_scenes import film, look, point, rgb
from phong_bsdf.tracing import camera

# Each of them is quick, all of them are not.
pytestmark = pytest.mark.slow

N = 32

# Three mirrors that see each other, a point light too many for the kernel without a loop in `LAMPS`.
SCENE = Scene(
    [
        Sphere((-0.8, 0, -4), 1, (0.8, 0.3, 0.2), (0.5, 0.6, 0.7), 20, km=0.3),
        Sphere((1.1, -0.2, -3.5), 0.8, (0.2, 0.5, 0.8), (0.4, 0.4, 0.4), 5, km=0.5),
        Sphere((0, -41, -4), 40, (0.7, 0.7, 0.6), (0.3, 0.3, 0.3), 8, km=0.4),
    ],
    [Light(0.7, (2, 4, 1)), Light(0.5, (-3, 2, 0)), Light(0.3, toward=(0.3, 1, 0.4))],
    oracle.Camera((0, 0.3, 0), (0.05, -0.1, -1)),
    background=(0.2, 0.3, 0.4),
    ambient=0.1,
    bounces=3,
)
LAMPS = replace(SCENE, lights=[*SCENE.lights, *(Light(0.1, (x, 5, 2)) for x in (-2, 0, 1))])
NAMES = {False: ("kd", "ks", "p"), True: ("diffuse_reflectance", "specular_reflectance", "exponent")}


def reflectances(material, n, l, v, lobe):  # noqa: E741
    """`oracle.unit_point` for the physical vocabulary."""
    p = material.p
    c = (p + 2) / 2 if lobe == "phong" else (p + 2) * (p + 4) / (8 * (2 ** (-p / 2) + p))
    bare = oracle.Sphere((0, 0, 0), 1, oracle.BLACK, material.ks, p)
    cos = np.maximum(oracle.dot(n, l), 0)[..., None]
    return (np.array(material.kd) + c * UNIT_POINT(bare, n, l, v, lobe)) * cos


UNIT_POINT = oracle.unit_point


def load(scene, physical_names=False, *, sampler=None, other=None, **integrator):
    """The oracle's scene in Mitsuba, objects named `ball0`, `light0`, ...; with the integrator `other`."""
    eye = scene.camera.eye
    target = [float(a + b) for a, b in zip(eye, scene.camera.view, strict=True)]
    sky = {"type": "constant", "radiance": rgb(*map(float, scene.background))}
    objects = {} if scene.background == oracle.BLACK else {"sky": sky}
    for i, light in enumerate(scene.lights):
        if light.position is None:
            direction = [-x for x in light.toward]
            objects[f"light{i}"] = {"type": "directional", "direction": direction, "irradiance": light.intensity}
        else:
            objects[f"light{i}"] = point(light.position, light.intensity)
    for i, ball in enumerate(scene.spheres):
        values = (rgb(*map(float, ball.kd)), rgb(*map(float, ball.ks)), ball.p)
        nested = {"type": scene.lobe, **dict(zip(NAMES[physical_names], values, strict=True))}
        if physical_names:
            nested["ensure_energy_conservation"] = False
        bsdf = {"type": "mirrorblend", "km": ball.km, "nested": nested}
        objects[f"ball{i}"] = {"type": "sphere", "center": list(ball.center), "radius": ball.radius, "bsdf": bsdf}
    sensor = {
        "type": "perspective", "fov": 2 * math.degrees(math.atan(0.5)), "near_clip": 1.0, "film": film(N),
        "to_world": mi.ScalarTransform4f().look_at(list(eye), target, [0, 1, 0]),
        "sampler": sampler or {"type": "independent", "sample_count": 1},
    }  # fmt: skip
    options = {"ambient": rgb(*[scene.ambient] * 3), "convention": "physical" if scene.physical else "course"}
    whitted = {"type": "whitted", "max_depth": scene.bounces + 2, **options, **integrator}
    return mi.load_dict({"type": "scene", "integrator": other or whitted, "sensor": sensor, **objects}, optimize=False)


# One move for each kind of parameter: key, how a scene of Mitsuba moves by h, how the oracle's does ----------------


def ball(i, **changes):
    def move(scene, h):
        balls = list(scene.spheres)
        balls[i] = replace(balls[i], **{name: change(getattr(balls[i], name), h) for name, change in changes.items()})
        return replace(scene, spheres=balls)

    return move


def light(i, **changes):
    def move(scene, h):
        lights = list(scene.lights)
        lights[i] = replace(lights[i], **{name: f(getattr(lights[i], name), h) for name, f in changes.items()})
        return replace(scene, lights=lights)

    return move


def more(value, h):
    return tuple(x + h for x in value) if isinstance(value, tuple) else value + h


def along(axis):
    return lambda value, h: tuple(x + h * (i == axis) for i, x in enumerate(value))


def turned(value, h, axis):
    value, k = np.array(value, float), np.eye(3)[axis]
    return tuple(value * np.cos(h) + np.cross(k, value) * np.sin(h) + k * k.dot(value) * (1 - np.cos(h)))


def axis_vector(axis, length=1.0):
    return mi.Vector3f(*(length if i == axis else 0 for i in range(3)))


def shift(axis):
    return lambda old, h: mi.AffineTransform4f().translate(axis_vector(axis) * h) @ old


def turn(axis):
    return lambda old, h: mi.AffineTransform4f().rotate(axis_vector(axis), h * 180 / math.pi) @ old


def turned_camera(axis):
    def move(scene, h):
        c = scene.camera
        return replace(scene, camera=replace(c, **{n: turned(getattr(c, n), h, axis) for n in ("eye", "view", "up")}))

    return move


def moves(physical_names=False, lamps=False):
    add = lambda old, h: old + h  # noqa: E731
    kd, ks, p = NAMES[physical_names]
    found = {}
    for i in range(3):
        nested = f"ball{i}.bsdf.nested_bsdf"
        found[f"kd {i}"] = f"{nested}.{kd}.value", add, ball(i, kd=more)
        found[f"ks {i}"] = f"{nested}.{ks}.value", add, ball(i, ks=more)
        found[f"p {i}"] = f"{nested}.{p}.value", add, ball(i, p=more)
        found[f"km {i}"] = f"ball{i}.bsdf.km.value", add, ball(i, km=more)
        for axis in range(3):
            found[f"center {i}{axis}"] = f"ball{i}.to_world", shift(axis), ball(i, center=along(axis))
        grow = lambda old, h: old @ mi.AffineTransform4f().scale(1 + h)  # noqa: E731
        found[f"radius {i}"] = f"ball{i}.to_world", grow, ball(i, radius=lambda r, h: r * (1 + h))
    for i in (0, 1, 2, *((3, 5) if lamps else ())):
        quantity = "irradiance" if i == 2 else "intensity"
        found[f"intensity {i}"] = f"light{i}.{quantity}.value", add, light(i, intensity=more)
    for axis in range(3):
        at = lambda old, h, axis=axis: old + axis_vector(axis) * h  # noqa: E731
        for i in (0, 1, *((4,) if lamps else ())):
            found[f"position {i}{axis}"] = f"light{i}.position", at, light(i, position=along(axis))
        aim = lambda value, h, axis=axis: turned(value, h, axis)  # noqa: E731
        found[f"direction {axis}"] = "light2.to_world", turn(axis), light(2, toward=aim)
        eye = lambda s, h, axis=axis: replace(s, camera=replace(s.camera, eye=along(axis)(s.camera.eye, h)))  # noqa: E731
        found[f"eye {axis}"] = "sensor.to_world", shift(axis), eye
        found[f"view {axis}"] = "sensor.to_world", turn(axis), turned_camera(axis)
    found["ambient"] = "integrator.ambient.value", add, lambda s, h: replace(s, ambient=s.ambient + h)
    found["background"] = "sky.radiance.value", add, lambda s, h: replace(s, background=more(s.background, h))
    return found


def truth(scene, move, picture=None, h=1e-6):
    """Central differences in float64, and the pixels away from silhouettes and the edges of shadows.

    There the differences to both sides of `picture`, that of `scene`, are not the same.
    """
    picture = oracle.render(scene, N, N) if picture is None else picture
    after, before = (oracle.render(move(scene, step), N, N) for step in (h, -h))
    difference = (after - before) / (2 * h)
    bend = np.abs(after - 2 * picture + before) / h
    return difference, bend.max(axis=2) <= 1e-3 * np.abs(difference).max()


def moved(scene, key, move):
    """Parameters of `scene`, that of `key` moved by an h = 0, and this h."""
    params, h = mi.traverse(scene), mi.Float(0)
    dr.enable_grad(h)
    old = params[key]
    params[key] = move(type(old)(old), h)
    params.update()
    return params, h


def forward(scene, key, move, **options):
    """The derivative of the picture, (height, width, 3), by h."""
    params, h = moved(scene, key, move)
    dr.forward(h, dr.ADFlag.ClearEdges)
    return np.array(dr.forward_to(mi.render(scene, params, **options)))


# Exactness -----------------------------------------------------------------------------------------------

CASES = {
    "course": (SCENE, False),
    "physical convention": (replace(SCENE, physical=True), False),
    "phong": (replace(SCENE, lobe="phong"), False),
    "reflectances": (SCENE, True),
    "phong reflectances": (replace(SCENE, lobe="phong"), True),
    "many lights": (LAMPS, False),
    "no mirrors": (replace(SCENE, spheres=[replace(s, km=0.0) for s in SCENE.spheres]), False),
    "mirrors alone": (replace(SCENE, spheres=[replace(s, km=1.0) for s in SCENE.spheres]), False),
    "direct light": (replace(SCENE, bounces=0, physical=True), False),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_backward(case):
    """All kinds of parameters at once, in reverse mode, agree with float64 differences within 1e-3."""
    scene, physical_names = CASES[case]
    found = moves(physical_names, lamps=len(scene.lights) > 4)
    # Room for a step to both sides of 0.
    near = replace(scene, spheres=[replace(s, km=max(s.km, 2e-5)) for s in scene.spheres])
    with mock.patch.object(oracle, "unit_point", reflectances if physical_names else UNIT_POINT):
        picture = oracle.render(near, N, N)
        truths = {name: truth(near, move, picture) for name, (_, _, move) in found.items()}
    kept = np.all([smooth for _, smooth in truths.values()], axis=0)
    assert kept.mean() > 0.95
    weights = np.random.default_rng(1).uniform(-1, 1, (N, N, 3)) * kept[..., None]

    loaded = load(scene, physical_names)
    params = mi.traverse(loaded)
    steps = {name: mi.Float(0) for name in found}
    for h in steps.values():
        dr.enable_grad(h)
    for name, (key, move, _) in found.items():
        params[key] = move(params[key], steps[name])
    params.update()
    image = mi.render(loaded, params)
    dr.backward(dr.sum(image * mi.TensorXf(weights), axis=None))
    for name, h in steps.items():
        derivative = truths[name][0] * weights
        # Positive and negative pixels may cancel.
        scale = max(np.sqrt(np.sum(derivative**2)), abs(derivative.sum()))
        assert dr.grad(h)[0] == pytest.approx(derivative.sum(), abs=1e-3 * scale), name


@pytest.mark.slow
@pytest.mark.parametrize("name", ("ks 1", "p 2", "center 00", "intensity 1", "position 01", "eye 1", "background"))
def test_forward(name):
    """Forward derivatives are right pixel by pixel, whichever object is differentiated."""
    key, move, oracle_move = moves()[name]
    expected, smooth = truth(SCENE, oracle_move)
    error = (forward(load(SCENE), key, move) - expected)[smooth]
    assert np.sqrt(np.mean(error**2)) < 1e-3 * np.sqrt(np.mean(expected[smooth] ** 2))


@pytest.mark.parametrize("mode", ("forward", "backward"))
def test_no_effect_no_gradient(mode):
    """Exactly 0 for what no pixel shows: a hidden ball, a light behind everything, an exponent without lobe."""
    hidden = Sphere((0, 0, 9), 0.5, (0.5, 0.5, 0.5), (0.3, 0.3, 0.3), 10)
    matte = Sphere((0, 0, -3), 1, (0.5, 0.5, 0.5), oracle.BLACK, 10)
    scene = Scene([hidden, matte], [Light(1, (1, 2, 0)), Light(1, (0, 0.5, -8))])
    keys = ["ball0.bsdf.nested_bsdf.kd.value", "ball0.bsdf.nested_bsdf.p.value", "ball0.to_world",
            "ball1.bsdf.nested_bsdf.p.value", "light1.intensity.value", "light1.position"]  # fmt: skip
    for key in keys:
        move = shift(0) if key.endswith("to_world") else (lambda old, h: old + h)
        loaded = load(scene)
        if mode == "forward":
            assert np.all(forward(loaded, key, move) == 0), key
        else:
            params, h = moved(loaded, key, move)
            dr.backward(dr.sum(mi.render(loaded, params), axis=None))
            assert dr.grad(h)[0] == 0, key


@pytest.mark.parametrize("convention", ("course", "physical"))
@pytest.mark.parametrize("lobe", ("phong", "blinnphong"))
@pytest.mark.parametrize("p", (0.0, 1e-3, 1.0, 1e3, 1e6))
def test_always_finite(p, lobe, convention):
    """All gradients, at all exponents, at grazing angles and silhouettes too."""
    spheres = [replace(s, p=p) for s in SCENE.spheres]
    scene = load(replace(SCENE, spheres=spheres, lobe=lobe, physical=convention == "physical"))
    params = mi.traverse(scene)
    keys = [k for k, (*_, flags) in params.properties.items() if not int(flags) & int(mi.ParamFlags.NonDifferentiable)]
    keys += ["light0.position", "sensor.to_world"]
    assert len(keys) > 20
    for key in keys:
        dr.enable_grad(params[key])
    params.update()
    dr.backward(dr.sum(mi.render(scene, params), axis=None))
    for key in keys:
        assert np.all(
            np.isfinite(np.array(dr.grad(params[key].matrix if key.endswith("to_world") else params[key])))
        ), key


# All kinds of pictures ------------------------------------------------------------------------------------------


def gradients(scene, keys, seed=0, **options):
    """Of the sum of a picture with weights, with respect to `keys`, as arrays."""
    params = mi.traverse(scene)
    for key in keys:
        dr.enable_grad(params[key])
    params.update()
    image = mi.render(scene, params, seed=seed, **options)
    weights = np.random.default_rng(2).uniform(0, 1, dr.shape(image))
    dr.backward(dr.sum(image * mi.TensorXf(weights), axis=None))
    return np.concatenate([np.array(dr.grad(params[key])).ravel() for key in keys])


KEYS = [
    *(f"ball{i}.bsdf.nested_bsdf.{name}.value" for i in range(3) for name in ("kd", "ks", "p")),
    *(f"ball{i}.bsdf.km.value" for i in range(3)),
    "light0.position", "light0.intensity.value", "light2.irradiance.value",
    "integrator.ambient.value", "sky.radiance.value",
]  # fmt: skip


def through_the_film(monkeypatch, scene):
    """Makes `whitted` take the way of other pictures than those of the box filter."""
    monkeypatch.setattr(sys.modules[type(scene.integrator()).__module__], "is_plain", lambda film: False)


@pytest.mark.parametrize("spp", (1, 4, 5))
def test_pixels_are_means_of_their_samples(spp, monkeypatch):
    """Gradients that skip the film are those that Mitsuba's film has."""
    skipped = gradients(load(SCENE), KEYS, spp=spp)
    scene = load(SCENE)
    through_the_film(monkeypatch, scene)
    assert skipped == pytest.approx(gradients(scene, KEYS, spp=spp), rel=1e-4)


def test_forward_through_the_film(monkeypatch):
    """So are forward derivatives; alpha has none."""
    key, move, _ = moves()["eye 1"]
    skipped = forward(load(SCENE), key, move, spp=4)
    scene = load(SCENE)
    through_the_film(monkeypatch, scene)
    assert skipped == pytest.approx(forward(scene, key, move, spp=4), rel=1e-4, abs=1e-5)


@pytest.mark.parametrize("mode", ("forward", "backward"))
def test_passes_have_the_gradient_of_one(mode, monkeypatch):
    """More samples than are rendered at once: the same derivative, in parts."""
    key, move, _ = moves()["kd 2"]

    def derivative():
        return forward(load(SCENE), key, move, spp=4) if mode == "forward" else gradients(load(SCENE), KEYS, spp=4)

    whole = derivative()
    monkeypatch.setattr(camera, "LANES", 1000)
    assert derivative() == pytest.approx(whole, rel=1e-4, abs=1e-6)


@pytest.mark.parametrize("case", ("course", "no mirrors"))
@pytest.mark.parametrize("mode", ("forward", "backward"))
def test_unlimited_depth(mode, case):
    """`max_depth` = -1 has the derivatives of as many bounces as are followed, those of a mirror of weight 0 too."""
    key, move, _ = moves()["km 2"]
    parts = []
    for depth in (-1, 30):
        scene = load(CASES[case][0], max_depth=depth)
        parts.append(forward(scene, key, move) if mode == "forward" else gradients(scene, KEYS))
    assert parts[0] == pytest.approx(parts[1], rel=1e-4, abs=1e-5)


def test_glass_is_refused():
    """Two rays from one hit: no derivative; the error says so, and what has one."""
    scene = mi.load_dict(
        {
            "type": "scene", "integrator": {"type": "whitted"}, "sensor": {"type": "perspective", "film": film(4)},
            "ball": {"type": "sphere", "center": [0, 0, 5], "bsdf": {"type": "dielectric"}},
            "floor": {"type": "sphere", "center": [0, 0, 9], "bsdf": {"type": "phong"}},
            "light": point([0, 3, 0]),
        }
    )  # fmt: skip
    params = mi.traverse(scene)
    dr.enable_grad(params["floor.bsdf.kd.value"])
    image = mi.render(scene, params)
    with pytest.raises(ValueError, match=r"whitted: no derivatives where .* refracts \(dielectric"):
        dr.backward(dr.sum(image, axis=None))


# Textures, meshes, other integrators ----------------------------------------------------------------------------


def textured(name, values):
    """A wall with a texture of `values`, (rows, columns, channels), for the parameter `name`."""
    bitmap = {"type": "bitmap", "raw": True, "filter_type": "nearest", "data": mi.TensorXf(values)}
    bsdf = {"type": "blinnphong", "kd": 0.3, "ks": 0.4, "p": 10, name: bitmap}
    return mi.load_dict(
        {
            "type": "scene", "integrator": {"type": "whitted"}, "light": point([0.5, 0.5, 2]),
            "sensor": look([0, 0, 2], [0, 0, 0], width=N, fov=45), "wall": {"type": "rectangle", "bsdf": bsdf},
        }
    )  # fmt: skip


@pytest.mark.parametrize(("name", "low", "high"), [("kd", 0.2, 0.8), ("ks", 0.1, 0.6), ("p", 5, 40)])
def test_textures(name, low, high):
    """Each texel has the gradient of the pixels that show it; their sum is that of the constant."""
    values = np.random.default_rng(3).uniform(low, high, (3, 4, 1 if name == "p" else 3)).astype(np.float32)
    key = f"wall.bsdf.{name}.data"
    found = gradients(textured(name, values), [key]).reshape(values.shape)
    step = 1e-2 * high
    weights = np.random.default_rng(2).uniform(0, 1, (N, N, 3))
    for texel in ((0, 0, 0), (1, 2, 0), (2, 3, values.shape[2] - 1)):
        pictures = []
        for sign in (-1, 1):
            other = values.copy()
            other[texel] += sign * step
            pictures.append(np.array(mi.render(textured(name, other)), np.float64))
        difference = np.sum(weights * (pictures[1] - pictures[0])) / (2 * step)
        # Differences of float32 pictures; that of p is not linear.
        assert found[texel] == pytest.approx(difference, rel=1e-3)


@pytest.mark.parametrize("mode", ("forward", "backward"))
@pytest.mark.parametrize(("name", "end", "near"), [("kd", 0, 1e-3), ("ks", 0, 1e-3), ("p", 0, 1e-4)])
def test_textures_at_the_end_of_their_range(name, end, near, mode):
    """Texels of the value 0 have derivatives, too: those of values close by."""
    found, key = [], f"wall.bsdf.{name}.data"
    for value in (end, near):
        scene = textured(name, np.full((2, 2, 1 if name == "p" else 3), value, np.float32))
        add = lambda old, h: old + h  # noqa: E731
        found.append(forward(scene, key, add) if mode == "forward" else gradients(scene, [key]))
    assert found[0] == pytest.approx(found[1], rel=3e-3, abs=1e-5) and np.any(found[0] != 0)


def test_mirror_textures_at_both_ends():
    """The picture is linear in `km`, and so is what a texture of it has from 0 to 1."""
    found = []
    for km in (0.0, 0.5, 1.0):
        texture = {"type": "bitmap", "raw": True, "data": mi.TensorXf(np.full((2, 2, 1), km, np.float32))}
        spheres = [replace(s, km=texture if i == 1 else 0.0) for i, s in enumerate(SCENE.spheres)]
        found.append(gradients(load(replace(SCENE, spheres=spheres)), ["ball1.bsdf.km.data"]).sum())
    assert found == pytest.approx([found[1]] * 3, rel=1e-3) and found[1] != 0


def triangle(vertices):
    """One triangle that fills the picture, lit from two sides."""
    mesh = mi.Mesh("wall", 3, 1, props=mesh_properties())
    params = mi.traverse(mesh)
    params["vertex_positions"] = mi.Float(np.ravel(vertices))
    params["faces"] = mi.UInt32([0, 1, 2])
    params.update()
    return mi.load_dict(
        {
            "type": "scene", "integrator": {"type": "whitted"}, "wall": mesh,
            "sensor": {"type": "perspective", "film": film(8), "fov": 2 * math.degrees(math.atan(0.5))},
            "light0": point([1, 2, 0]), "light1": point([-2, 0, 1], 0.5),
        }
    )  # fmt: skip


def mesh_properties():
    props = mi.Properties()
    props["bsdf"] = mi.load_dict({"type": "blinnphong", "kd": 0.6, "ks": 0.5, "p": 12})
    return props


def flat(vertices):
    """The same picture in float64."""
    a, b, c = vertices
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal)
    x = 0.5 - (np.arange(8) + 0.5) / 8
    d = oracle.normalize(np.stack([*np.meshgrid(x, x), np.ones((8, 8))], axis=-1)).reshape(-1, 3)
    p = d * (normal.dot(a) / d.dot(normal))[:, None]
    n = np.broadcast_to(-normal if normal[2] > 0 else normal, p.shape)
    surface = Sphere((0, 0, 0), 1, (0.6,) * 3, (0.5,) * 3, 12)
    color = 0
    for intensity, position in ((1, (1, 2, 0)), (0.5, (-2, 0, 1))):
        color = color + intensity * oracle.unit_point(
            surface, n, oracle.normalize(np.array(position) - p), -d, "blinnphong"
        )
    return color.reshape(8, 8, 3)


def test_vertices():
    """Vertices of a triangle, all nine coordinates, against float64."""
    vertices = np.array([[-20, -20, 6], [0, 30, 4], [25, -18, 5]], float)
    scene = triangle(vertices)
    assert np.array(mi.render(scene, spp=1)) == pytest.approx(flat(vertices), abs=1e-5)
    found = gradients(scene, ["wall.vertex_positions"], spp=1)
    weights = np.random.default_rng(2).uniform(0, 1, (8, 8, 3))
    for i in range(9):
        h = np.zeros(9)
        h[i] = 1e-5
        difference = flat(vertices + h.reshape(3, 3)) - flat(vertices - h.reshape(3, 3))
        scale = np.abs(difference * weights).sum() / 2e-5
        assert found[i] == pytest.approx(np.sum(difference * weights) / 2e-5, abs=1e-3 * scale)


@pytest.mark.parametrize("physical_names", (False, True))
@pytest.mark.parametrize("integrator", ("direct", "path", "prb"))
def test_integrators_of_mitsuba(integrator, physical_names):
    """Without mirrors they have the gradients of `whitted`, for all parameters of both vocabularies."""
    spheres = [replace(s, km=0.0) for s in SCENE.spheres]
    scene = replace(SCENE, spheres=spheres, lights=SCENE.lights[:1], bounces=0, physical=True)
    scene = replace(scene, ambient=0.0, background=oracle.BLACK)
    names = NAMES[physical_names]
    keys = [f"ball{i}.bsdf.nested_bsdf.{name}.value" for i in range(3) for name in names] + ["light0.intensity.value"]
    loaded = load(scene, physical_names)
    expected = gradients(loaded, keys)
    other = {"type": integrator, **({} if integrator == "direct" else {"max_depth": 2})}
    # Through the centres of the pixels, as `whitted` does.
    sampler = mi.load_dict({"type": "stratified", "sample_count": 1, "jitter": False})
    centred = load(scene, physical_names, sampler=sampler, other=other)
    assert gradients(centred, keys) == pytest.approx(expected, rel=1e-3, abs=1e-4 * float(np.abs(expected).max()))


# What it costs --------------------------------------------------------------------------------------------------


def most_bytes(scene, keys, **options):
    """Most bytes that arrays hold while gradients are computed; nothing is compiled then."""
    gradients(scene, keys, **options)
    dr.sync_thread()
    gc.collect()
    dr.flush_malloc_cache()
    dr.detail.malloc_clear_statistics()
    gradients(scene, keys, **options)
    dr.sync_thread()
    return dr.detail.malloc_watermark(dr.JitBackend.LLVM)


@pytest.mark.slow
def test_memory_does_not_grow():
    """Neither with the depth nor with the number of lights does a reverse pass need more memory for a sample."""
    keys = [key for key in KEYS if "ball" in key]
    shallow = most_bytes(load(LAMPS, max_depth=3), keys)
    # What a busy machine has not freed yet is an array or two of a number for each pixel, 3 % each.
    assert most_bytes(load(LAMPS, max_depth=16), keys) < 1.1 * shallow
    lights = [Light(0.02, (x / 8, 5, 2)) for x in range(100)]
    many = load(replace(LAMPS, lights=lights), max_depth=3)
    # A light has some kilobytes of its own, however many samples there are.
    assert most_bytes(many, keys) < shallow + 8000 * len(lights)
    samples = 16 * N * N
    per_sample = [
        (most_bytes(s, keys, spp=16) - most_bytes(s, keys)) / samples for s in (load(LAMPS, max_depth=3), many)
    ]
    assert per_sample[1] == pytest.approx(per_sample[0], rel=0.05)


def test_freed_scenes_do_no_harm():
    """A scene that goes away after its gradients leaves nothing behind that the next one falls over."""
    for _ in range(5):
        scene = load(SCENE)
        params = mi.traverse(scene)
        dr.enable_grad(params["ball0.bsdf.nested_bsdf.kd.value"])
        dr.backward(dr.sum(mi.render(scene, params), axis=None))
        del scene, params
        gc.collect()


def test_frozen_steps_are_plain_steps():
    """Whole steps of an optimisation, frozen and not, bit by bit. On one thread: more add gradients up in any order."""
    keys = [key for key in KEYS if "position" not in key]

    def step(scene, opt, target):
        params = mi.traverse(scene)
        params.update(opt)
        dr.backward(dr.mean(dr.square(mi.render(scene, params) - target), axis=None))
        opt.step()

    def run(step):
        scene = load(SCENE)
        target = dr.detach(mi.render(scene))
        opt, params = mi.ad.Adam(lr=0.01), mi.traverse(scene)
        for key in keys:
            opt[key] = type(params[key])(params[key] * 0.9)
        found = []
        for _ in range(5):
            step(scene, opt, target)
            found.append({key: np.array(opt[key]) for key in keys})
        return found

    threads = dr.thread_count()
    dr.set_thread_count(1)
    try:
        frozen = dr.freeze(step)
        for a, b in zip(run(step), run(frozen), strict=True):
            assert all(np.array_equal(a[key], b[key]) for key in keys)
        assert frozen.n_recordings <= 3
    finally:
        dr.set_thread_count(threads)
