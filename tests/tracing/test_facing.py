"""The course convention asks for n.l, n.h and r.v, never for n.v: a surface is black from behind only where both its
normals, geometric and shading, face away from the viewer."""

import itertools
from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from helpers import SCENES, oracle
from helpers.small_scenes import look, rgb
from phong_bsdf.checking import shading, stage
from phong_bsdf.tracing.facing import interpolates

CORNERS = ((-1.0, -1.0, 0.0), (1.0, -1.0, 0.0), (0.0, 1.0, 0.0))
KD, KS, P = (0.8, 0.5, 0.2), (0.3, 0.6, 0.9), 7.0
TURNED = oracle.normalize(np.array((0.8, 0.0, -0.6)))
LIGHT = oracle.normalize(np.array((1.0, 0.1, 0.2)))


def triangle(folder, normal=TURNED, reverse=False, scale=1.0):
    """A triangle in the plane z = 0, whose three normals are `normal`; in space its front is toward +z."""
    order = (1, 3, 2) if reverse else (1, 2, 3)
    lines = ["v " + " ".join(map(str, scale * np.array(corner))) for corner in CORNERS]
    lines += ["vn " + " ".join(map(str, normal))] * 3 + ["f " + " ".join(f"{i}//{i}" for i in order)]
    path = folder / "triangle.obj"
    path.write_text("\n".join(lines))
    return {"type": "obj", "filename": str(path)}


def scene(shape, bsdf, eye=(0.0, 0.0, 5.0), scale=1.0, up=(0.0, 1.0, 0.0), **options):
    camera = look([0, 0, 0], [0, 0, 1], width=1, fov=1e-3, near_clip=1e-3 * scale, far_clip=100 * scale)
    camera["to_world"] = mi.ScalarTransform4f().look_at([scale * x for x in eye], [0, 0, 0], list(up))
    return {
        "type": "scene", "integrator": {"type": "whitted", **options}, "sensor": camera,
        "sun": {"type": "directional", "direction": list(-LIGHT), "irradiance": 1.0},
        "shape": {**shape, "bsdf": bsdf},
    }  # fmt: skip


def pixel(description, **options):
    loaded = mi.load_dict(description) if isinstance(description, dict) else description
    return np.array(mi.render(loaded, **options))[0, 0]


def own(lobe="blinnphong", **more):
    return {"type": lobe, "kd": rgb(*KD), "ks": rgb(*KS), "p": P, **more}


DIFFUSE = {"type": "diffuse", "reflectance": rgb(*KD)}


def lectures(n, v, lobe="blinnphong", ks=KS, p=P):
    """k_d max(0, n.l) + k_s lobe^p, where n.l > 0."""
    sphere = oracle.Sphere((0, 0, 0), 1, KD, ks, p)
    lit = oracle.unit_point(sphere, n[None], LIGHT[None], np.array(v)[None], lobe)[0]
    return lit if n @ LIGHT > 0 else 0 * lit


SURFACES = {
    "phong": (own("phong"), lambda n, v: lectures(n, v, "phong")),
    "blinnphong": (own(), lectures),
    "p = 0": (own(p=0), lambda n, v: lectures(n, v, p=0.0)),
    "small p": (own(p=0.01), lambda n, v: lectures(n, v, p=0.01)),
    "no highlight": (own(ks=0), lambda n, v: lectures(n, v, ks=(0, 0, 0))),
    "diffuse": (DIFFUSE, lambda n, v: lectures(n, v, ks=(0, 0, 0))),
    "mirrorblend": ({"type": "mirrorblend", "km": 0.25, "nested": own()}, lambda n, v: 0.75 * lectures(n, v)),
    "mirrored diffuse": ({"type": "mirrorblend", "km": 0.25, "nested": DIFFUSE},
                         lambda n, v: 0.75 * lectures(n, v, ks=(0, 0, 0))),
    "mask": ({"type": "mask", "opacity": 0.4, "nested": own()}, lambda n, v: 0.4 * lectures(n, v)),
    "blend": ({"type": "blendbsdf", "weight": 0.25, "a": own(), "b": DIFFUSE},
              lambda n, v: 0.75 * lectures(n, v) + 0.25 * lectures(n, v, ks=(0, 0, 0))),
}  # fmt: skip
TWO_SIDES = {
    "twosided": lambda bsdf: {"type": "twosided", "nested": bsdf},
    "twosided in a mask": lambda bsdf: {
        "type": "mask", "opacity": 1.0, "nested": {"type": "twosided", "nested": bsdf}
    },
}  # fmt: skip


@pytest.mark.parametrize("name", SURFACES)
@pytest.mark.parametrize("specialize", (True, False))
def test_lit_where_the_shading_normal_faces_away(tmp_path, name, specialize):
    """From the front the geometric normal faces the viewer; the shading normal, at 127 degrees, does not."""
    bsdf, expected = SURFACES[name]
    image = pixel(scene(triangle(tmp_path), bsdf, specialize=specialize))
    assert expected(TURNED, (0, 0, 1)).max() > 0.1
    assert image == pytest.approx(expected(TURNED, (0, 0, 1)), abs=1e-5)


@pytest.mark.parametrize("name", ("phong", "diffuse", "mirrorblend", "blend"))
@pytest.mark.parametrize("sides", TWO_SIDES)
@pytest.mark.parametrize(("eye", "front"), [((0, 0, 5), True), ((0, 0, -5), True), ((-5, 0, -1), False)])
def test_two_sides(tmp_path, name, sides, eye, front):
    """The front is what is seen if either normal faces the viewer; else it is the back, lit by the mirrored rule."""
    bsdf, expected = SURFACES[name]
    v = oracle.normalize(np.array(eye, float))
    description = scene(triangle(tmp_path), TWO_SIDES[sides](bsdf), eye=eye)
    if front:
        assert pixel(description) == pytest.approx(expected(TURNED, v), abs=1e-5)
    else:
        # Normal, viewer and light mirrored through the origin make the same angles.
        description["sun"]["direction"] = list(LIGHT)
        assert pixel(description) == pytest.approx(expected(TURNED, -v), abs=1e-5)


@pytest.mark.parametrize("bsdf", (own(), DIFFUSE, {"type": "mirrorblend", "km": 0.25, "nested": own()}))
def test_black_where_both_normals_face_away(tmp_path, bsdf):
    """One-sided surfaces have no back."""
    assert pixel(scene(triangle(tmp_path), bsdf, eye=(-5, 0, -1))) == pytest.approx([0, 0, 0], abs=0)


def test_wrong_winding(tmp_path):
    """A triangle of the wrong winding whose normals are right is lit from where these are seen."""
    n = oracle.normalize(np.array((0.3, 0.2, 1.0)))
    right, wrong = (pixel(scene(triangle(tmp_path, n, reverse), own())) for reverse in (False, True))
    assert right == pytest.approx(lectures(n, (0, 0, 1)), abs=1e-5) and np.array_equal(right, wrong)


def test_flipped_normals(tmp_path):
    """`flip_normals` turns both normals."""
    shape = {**triangle(tmp_path, -TURNED, True), "flip_normals": True}
    assert pixel(scene(shape, own())) == pytest.approx(lectures(TURNED, (0, 0, 1)), abs=1e-5)


@pytest.mark.parametrize("scale", (1e-3, 1e4))
def test_size_does_not_matter(tmp_path, scale):
    """As at size 1."""
    image = pixel(scene(triangle(tmp_path, scale=scale), own(), scale=scale))
    assert image == pytest.approx(lectures(TURNED, (0, 0, 1)), abs=1e-5)


def test_instances(tmp_path):
    """What an instance shows is not listed among the scene's shapes, and is lit as well."""
    description = scene(triangle(tmp_path), own())
    group = {"type": "shapegroup", "shape": description.pop("shape")}
    description |= {"group": group, "shape": {"type": "instance", "shapegroup": {"type": "ref", "id": "group"}}}
    assert pixel(description) == pytest.approx(lectures(TURNED, (0, 0, 1)), abs=1e-5)


NORMAL = oracle.normalize(np.array((0.8, 0.0, 0.6)))


@pytest.mark.parametrize("flip", (True, False))
@pytest.mark.parametrize("name", ("phong", "blinnphong", "diffuse", "mirrorblend"))
def test_normal_maps_turn_past_the_viewer(name, flip):
    """A normal map is not flipped toward the viewer, and hides nothing from it."""
    bsdf, expected = SURFACES[name]
    mapped = {"type": "normalmap", "normalmap": {"type": "rgb", "value": list((NORMAL + 1) / 2)}, "nested": bsdf,
              "flip_invalid_normals": flip, "use_shadowing_function": False}  # fmt: skip
    eye = (-4.0, 0.0, 1.5)
    v = oracle.normalize(np.array(eye))
    assert NORMAL @ v < -0.3
    got = pixel(scene({"type": "rectangle"}, mapped, eye=eye))
    assert got == pytest.approx(expected(NORMAL, v), abs=1e-5)


def test_bump_maps_turn_past_the_viewer():
    """A slope of 45 degrees, seen from beyond its horizon."""
    ramp = np.linspace(0, 4, 64, dtype=np.float32)[None, :, None].repeat(64, 0)
    height = {"type": "bitmap", "bitmap": mi.Bitmap(np.ascontiguousarray(ramp)), "raw": True}
    eye = (4.0, 0.0, 0.6)
    v = oracle.normalize(np.array(eye))
    values = []
    for bsdf in (own(ks=0), DIFFUSE):
        bump = {"type": "bumpmap", "height": height, "nested": bsdf, "use_shadowing_function": False,
                "flip_invalid_normals": False, "scale": 1.0}  # fmt: skip
        description = scene({"type": "rectangle"}, bump, eye=eye)
        description["sun"]["direction"] = [0.5, 0.0, -1.0]
        values.append(pixel(description))
    # The surface rises by 4 over a width of 2.
    n = oracle.normalize(np.array((-2.0, 0.0, 1.0)))
    assert n @ v < 0
    expected = n @ oracle.normalize(np.array((-0.5, 0.0, 1.0))) * np.array(KD)
    assert np.array(values) == pytest.approx(np.array([expected, expected]), abs=0.01)


@pytest.mark.parametrize("mapped", ("normalmap", "bumpmap"))
@pytest.mark.parametrize("inside", (True, False))
@pytest.mark.parametrize("mirrored", (True, False))
def test_maps_around_two_sides_and_inside_of_them(mapped, inside, mirrored):
    """Where no normal turns away, the course convention is pi times the physical one, from both sides of a surface."""
    ramp = np.linspace(0, 0.7, 64, dtype=np.float32)[None, :, None].repeat(64, 0)

    def tilted(bsdf):
        if mapped == "bumpmap":
            height = {"type": "bitmap", "bitmap": mi.Bitmap(np.ascontiguousarray(ramp)), "raw": True}
            return {"type": "bumpmap", "height": height, "nested": bsdf}
        return {"type": "normalmap", "normalmap": rgb(0.68, 0.59, 0.95), "nested": bsdf}

    surface = own("phong") if not mirrored else {"type": "mirrorblend", "km": 0.5, "nested": own()}
    two = {"type": "twosided", "nested": tilted(surface)} if inside else tilted({"type": "twosided", "nested": surface})
    for side in (1, -1):
        description = scene({"type": "rectangle"}, two, eye=(1.0, 0.5, 3.0 * side))
        description["sun"]["direction"] = [-0.3, 0.2, -1.0 * side]
        # What the mirror sees tells its direction.
        description["sky"] = {"type": "envmap", "bitmap": mi.Bitmap(sky_of_one_gradient())}
        course = pixel(description)
        physical = pixel({**description, "integrator": {"type": "whitted", "convention": "physical"}})
        dark = {**description, "sun": {**description["sun"], "irradiance": 0.0}}
        seen = pixel({**dark, "integrator": {"type": "whitted", "convention": "physical"}})
        assert course.max() > 0.1
        assert course - seen == pytest.approx(np.pi * (physical - seen), abs=2e-4)
        assert pixel(dark) == pytest.approx(seen, abs=2e-4)


def sky_of_one_gradient():
    """A sky whose colour tells the direction."""
    v, u = np.mgrid[0:32, 0:64].astype(np.float32)
    return np.stack([v / 32, 0.5 + 0.5 * np.sin(u / 64 * 2 * np.pi), 0.3 + 0 * u], axis=-1).astype(np.float32)


RED, BLUE = ({"type": "phong", "kd": rgb(*kd), "ks": 0} for kd in ((0.8, 0.1, 0.1), (0.1, 0.1, 0.8)))


@pytest.mark.parametrize("max_depth", (2, 3))
@pytest.mark.parametrize("specialize", (True, False))
@pytest.mark.parametrize("bsdf", (
    RED, {"type": "twosided", "a": RED, "b": BLUE}, {"type": "mask", "opacity": 1.0, "n": RED},
    {"type": "mirrorblend", "km": 0.5, "n": {"type": "twosided", "a": RED, "b": BLUE}},
    {"type": "twosided", "a": {"type": "mirrorblend", "km": 0.5, "n": RED}, "b": BLUE},
), ids=str)  # fmt: skip
def test_ambient_light_comes_from_the_side_that_is_seen(tmp_path, bsdf, specialize, max_depth):
    """That of the front, though the shading normal faces away; of the last mirror all."""
    description = scene(triangle(tmp_path), bsdf, specialize=specialize, ambient=1.0, max_depth=max_depth)
    description["sun"]["irradiance"] = 0.0
    mirrored = 0.5 if "mirrorblend" in str(bsdf) and max_depth > 2 else 1.0
    assert pixel(description) == pytest.approx(mirrored * np.array((0.8, 0.1, 0.1)), abs=1e-5)


@pytest.mark.parametrize("variant", ("scalar_rgb", "llvm_ad_spectral", "llvm_ad_mono"))
def test_all_variants(tmp_path, variant):
    """Grey surfaces are as bright in every variant."""
    before = mi.variant()
    mi.set_variant(variant)
    try:
        grey = {"type": "blinnphong", "kd": 0.8, "ks": 0.3, "p": P}
        for bsdf in (grey, {"type": "twosided", "nested": grey}):
            # Relative to a triangle that faces the viewer: a spectral sample is of random wavelengths.
            values = [pixel(scene(triangle(tmp_path, n), bsdf), spp=1)[0] for n in (TURNED, NORMAL)]
            sphere = oracle.Sphere((0, 0, 0), 1, (0.8,) * 3, (0.3,) * 3, P)
            turned, facing = (
                oracle.unit_point(sphere, n[None], LIGHT[None], np.array([[0, 0, 1.0]]), "blinnphong")[0, 0]
                for n in (TURNED, NORMAL)
            )
            assert values[0] / values[1] == pytest.approx(turned / facing, rel=1e-4)
    finally:
        mi.set_variant(before)


def test_physical_convention_stays_mitsubas(tmp_path):
    """There a surface is black where its shading normal faces away, as for `direct`."""
    for eye in ((0, 0, 5), (0.0, 3.0, -5.0)):
        physical = scene(triangle(tmp_path), own(), eye=eye, convention="physical")
        direct = {**physical, "integrator": {"type": "direct"}}
        # `direct` has another sample of the pixel, which is small.
        assert pixel(physical) == pytest.approx(pixel(direct), abs=1e-5)


@pytest.mark.parametrize("name", ("phong", "mirrorblend", "blend"))
def test_derivatives(tmp_path, name):
    """By a BSDF's parameters they are those of the formula also where the shading normal faces away."""
    bsdf, _ = SURFACES[name]
    loaded = mi.load_dict(scene(triangle(tmp_path), bsdf))
    params = mi.traverse(loaded)
    key = next(key for key in params.keys() if key.endswith("kd.value"))  # noqa: SIM118
    dr.enable_grad(params[key])
    params.update()
    dr.backward(dr.sum(mi.render(loaded, params).array))
    share = {"phong": 1, "mirrorblend": 0.75, "blend": 0.75}[name]
    assert np.array(dr.grad(params[key])).ravel() == pytest.approx([share * (TURNED @ LIGHT)] * 3, rel=1e-4)


def pebble():
    """The mesh of `scenes/course/smooth-mesh.xml`."""
    rows = [line.split() for line in (SCENES / "course/models/pebble.obj").read_text().splitlines()]
    positions, normals = (np.array([row[1:] for row in rows if row[0] == kind], float) for kind in ("v", "vn"))
    faces = np.array([[int(corner.split("/")[0]) - 1 for corner in row[1:]] for row in rows if row[0] == "f"])
    return oracle.Mesh(positions + np.array((-0.6, 0.1, -4.0)), normals, faces, (0.8, 0.4, 0.2), (0.5,) * 3, 40)


SMOOTH_MESH = oracle.Scene(
    [
        oracle.Sphere((1.1, -0.3, -4.5), 0.7, (0.2, 0.3, 0.7), (0.4,) * 3, 100, km=0.6),
        oracle.Sphere((0, -5001, 0), 5000, (0.7,) * 3, km=0.3),
    ],
    [oracle.Light(0.7, (2, 5, -1)), oracle.Light(0.4, toward=(-2, 1, 0.5))],
)


@pytest.fixture(scope="module")
def smooth_mesh():
    """The oracle's picture."""
    return oracle.render(replace(SMOOTH_MESH, meshes=[pebble()]), 160, 160)


@pytest.mark.parametrize("specialize", ("true", "false"))
def test_smooth_mesh(smooth_mesh, specialize):
    """Off edges every pixel is the oracle's; 0.1 % may be on another side of one."""
    text = (SCENES / "course/smooth-mesh.xml").read_text().replace("models/", f"{SCENES}/course/models/")
    text = text.replace('"whitted">', f'"whitted"><boolean name="specialize" value="{specialize}"/>')
    image = np.array(mi.render(mi.load_string(text, width="160", height="160")))
    error = np.abs(image - smooth_mesh).max(axis=2)
    assert np.mean(error > 1e-2) <= 1e-3
    assert np.mean(error > 3e-4) <= 2e-3


def test_what_cannot_turn_is_not_asked():
    """Spheres, rectangles, disks, cylinders, cubes: the two normals are one, and kernels compare none."""
    names = ("lecture/mirror-floor", "course/scene-6", "lecture/models")
    assert not any(interpolates(mi.load_file(str(SCENES / f"{name}.xml"))) for name in names)
    shapes = ({"type": kind} for kind in ("cube", "sphere", "rectangle", "disk", "cylinder"))
    assert not any(interpolates(mi.load_dict({"type": "scene", "shape": shape})) for shape in shapes)


def test_checker_shades_as_whitted():
    """The picture that the checker starts from is that of `whitted`, also where normals turn away."""
    text = (SCENES / "course/smooth-mesh.xml").read_text().replace("models/", f"{SCENES}/course/models/")
    loaded = mi.load_string(text, width="48", height="48")
    made = stage.Stage(loaded)
    positions = np.array([(x + 0.5, y + 0.5) for y, x in itertools.product(range(48), range(48))])
    hits = made.trace(loaded.sensors()[0], positions)
    shaded = shading.shade(hits, shading.RIGHT, made.most_hits, made.materials).reshape(48, 48, 3)
    error = np.abs(shaded - np.array(mi.render(loaded))).max(axis=2)
    # Bounces that are no longer one kernel may round another way at an edge.
    assert np.mean(error > 1e-4) <= 2e-3
