"""No ray slips between two triangles of a mesh: not the camera's, not a mirror's, not a shadow's."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from helpers.messages import messages
from helpers.small_scenes import film, look
from phong_bsdf.importers import convert_model
from phong_bsdf.scene import rendering
from phong_bsdf.tracing import geometry as tracing_geometry
from phong_bsdf.tracing.gaps import has_gaps
from phong_bsdf.tracing.geometry import Geometry, Tight, has_triangles
from phong_bsdf.tracing.needs import ROBUST

WHITE = {"type": "phong", "kd": 1.0, "ks": 0.0}
T = mi.ScalarTransform4f


def grid(n, bump=0.0):
    """Vertices of an n x n grid from -1 to 1 in the plane z = 0, pushed up and down by `bump`, and its triangles."""
    u = np.linspace(-1, 1, n)
    x, y = np.meshgrid(u, u)
    positions = np.stack([x, y, bump * np.sin(3 * x) * np.cos(2 * y)], axis=-1).reshape(-1, 3).astype(np.float32)
    i = np.arange(n * n).reshape(n, n)
    a, b, c, d = i[:-1, :-1], i[:-1, 1:], i[1:, :-1], i[1:, 1:]
    faces = [np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, b, d), (a, d, c))]
    return positions, np.concatenate(faces)


def write_obj(path, positions, faces):
    lines = ["v " + " ".join(map(str, p)) for p in positions.tolist()]
    lines += ["f " + " ".join(str(i + 1) for i in f) for f in faces.tolist()]
    path.write_text("\n".join(lines))
    return {"type": "obj", "filename": str(path), "face_normals": True}


def write_ply(path, positions, faces):
    numbers = "property float x\nproperty float y\nproperty float z\n"
    head = f"ply\nformat ascii 1.0\nelement vertex {len(positions)}\n{numbers}element face {len(faces)}\n"
    head += "property list uchar int vertex_index\nend_header\n"
    rows = [" ".join(map(str, row)) for row in (*positions.tolist(), *([3, *face] for face in faces.tolist()))]
    path.write_text(head + "\n".join(rows) + "\n")
    return {"type": "ply", "filename": str(path), "face_normals": True}


def shape_of(kind, folder, n=9):
    if kind == "cube":
        return {"type": "cube"}
    if kind == "instance":
        return {"type": "instance", "shapegroup": {"type": "ref", "id": "group"}}
    return {"obj": write_obj, "ply": write_ply}[kind](folder / f"grid.{kind}", *grid(n))


def scene(shape, size=64, spp=1, eye=(0, 0, 5), **more):
    camera = {**look(list(eye), [0, 0, 0], width=size, fov=45.0, spp=spp), "film": film(size)}
    group = {}
    if shape["type"] == "instance":
        group = {"group": {"type": "shapegroup", "mesh": shape.pop("mesh")}}
    else:
        shape = {**shape, "bsdf": WHITE}
    return {
        "type": "scene", "integrator": {"type": "whitted"}, "sensor": camera, **group, "shape": shape,
        "sun": {"type": "directional", "direction": [0, 0, -1]}, **more,
    }  # fmt: skip


def inside(image):
    """The middle of the picture, where the front face of the shape is."""
    a = image.shape[0] // 3
    return image[a:-a, a:-a]


@pytest.mark.parametrize("kind", ("cube", "obj", "ply"))
@pytest.mark.parametrize("size", (64, 100, 256, 512, 1000, 1024))
def test_no_holes(kind, size, tmp_path):
    """Every pixel of a front face is lit, however the scene was loaded."""
    loaded = mi.load_dict(scene(shape_of(kind, tmp_path), size))
    assert inside(np.array(mi.render(loaded))).min() > 0.99


@pytest.mark.parametrize("spp", (4, 16))
def test_no_holes_at_more_samples(spp, tmp_path):
    """The regular grids of samples meet edges, too."""
    for kind in ("cube", "obj"):
        loaded = mi.load_dict(scene(shape_of(kind, tmp_path), 256))
        assert inside(np.array(mi.render(loaded, spp=spp))).min() > 0.999


def test_no_holes_in_scalar_variants(tmp_path):
    """Scalar variants trace through the same library."""
    before = mi.variant()
    mi.set_variant("scalar_rgb")
    try:
        for kind in ("cube", "ply"):
            assert inside(np.array(mi.render(mi.load_dict(scene(shape_of(kind, tmp_path), 64))))).min() > 0.99
    finally:
        mi.set_variant(before)


def aimed(positions, faces, count, seed=1, vertices=False):
    """Rays that meet a mesh at the middle parts of edges which two of its triangles share, or at vertices."""
    rng = np.random.default_rng(seed)
    edges = np.sort(np.concatenate([faces[:, pair] for pair in ([0, 1], [1, 2], [2, 0])]), axis=1)
    edges, times = np.unique(edges, axis=0, return_counts=True)
    edges = edges[times == 2]
    chosen = edges[rng.integers(len(edges), size=count)]
    share = rng.uniform(0.05, 0.95, (count, 1))
    target = positions[chosen[:, 0]] * (1 - share) + positions[chosen[:, 1]] * share
    if vertices:
        within = positions[np.abs(positions[:, :2]).max(axis=1) < 1]
        target = within[rng.integers(len(within), size=count)]
    d = rng.normal(size=(count, 3))
    d[:, 2] = -np.abs(d[:, 2]) - 1
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    o = target - d * rng.uniform(0.5, 5, (count, 1))
    return mi.Ray3f(mi.Point3f(o.T.astype(np.float32)), mi.Vector3f(d.T.astype(np.float32)))


@pytest.mark.slow
def test_ten_million_rays_at_edges_and_vertices(tmp_path):
    """No ray aimed at an edge or at a vertex passes, closest hit and shadow test alike."""
    positions, faces = grid(33)
    geometry = Geometry(mi.load_dict(scene(write_ply(tmp_path / "grid.ply", positions, faces))))
    for seed in range(10):
        for vertices in (True, False):
            ray = aimed(positions, faces, 2**20, seed, vertices)
            assert dr.all(geometry.hit(ray, False, True).is_valid()) and dr.all(geometry.blocked(ray, True))


@pytest.mark.parametrize("variant", ("llvm_ad_rgb", "scalar_rgb"))
def test_what_is_traced_again_is_the_same_surface(variant, tmp_path):
    """A ray that a scene without the flag lets through meets, beside the gap, what it was aimed at."""
    before = mi.variant()
    mi.set_variant(variant)
    try:
        positions, faces = grid(33)
        geometry = Geometry(mi.load_dict({"type": "scene", "mesh": write_ply(tmp_path / "g.ply", positions, faces)}))
        geometry.scene = mi.load_dict({"type": "scene", "mesh": write_ply(tmp_path / "g.ply", positions, faces)})
        rng = np.random.default_rng(3)
        within = positions[np.abs(positions[:, :2]).max(axis=1) < 1]
        through = 0
        for target in within[rng.integers(len(within), size=60)]:
            d = rng.normal(size=3)
            d[2] = -abs(d[2]) - 1
            d /= np.linalg.norm(d)
            ray = mi.Ray3f(mi.Point3f(*map(float, target - 2 * d)), mi.Vector3f(*map(float, d)))
            through += not geometry.scene.ray_intersect(ray).is_valid()
            si = geometry.hit(ray, False, True)
            assert np.ravel(np.array(si.p)) == pytest.approx(target, abs=1e-5) and np.ravel(si.t)[0] == pytest.approx(
                2, abs=1e-5
            )
        assert through > 2
    finally:
        mi.set_variant(before)


@pytest.mark.parametrize("bump", (0.0, 0.05))
@pytest.mark.parametrize("scale", (1e-3, 1.0, 1e4))
def test_rays_at_edges(tmp_path, bump, scale):
    """Also at other sizes, and where the mesh is not flat."""
    positions, faces = grid(17, bump)
    positions *= np.float32(scale)
    geometry = Geometry(mi.load_dict(scene(write_obj(tmp_path / "grid.obj", positions, faces))))
    ray = aimed(positions / scale, faces, 2**18)
    ray.o *= scale
    assert dr.all(geometry.hit(ray, False, True).is_valid()) and dr.all(geometry.blocked(ray, True))


def test_groups(tmp_path):
    """Meshes inside of instances, which Mitsuba never traces without gaps, are traced so all the same."""
    positions, faces = grid(33)
    mesh = {**write_ply(tmp_path / "grid.ply", positions, faces), "bsdf": WHITE}
    shape = {**shape_of("instance", tmp_path), "mesh": mesh}
    geometry = Geometry(mi.load_dict(scene(shape)))
    ray = aimed(positions, faces, 2**20)
    assert dr.count(~geometry.scene.ray_intersect(ray).is_valid())[0] > 10_000
    assert dr.all(geometry.hit(ray, False, True).is_valid()) and dr.all(geometry.blocked(ray, True))


def radiance(description, origin, targets):
    """What `whitted` sees along rays from one point toward `targets`, (n, 3)."""
    loaded = mi.load_dict(description)
    d = targets - origin
    d = mi.Vector3f((d / np.linalg.norm(d, axis=1, keepdims=True)).T.astype(np.float32))
    return loaded.integrator().sample(loaded, loaded.sensors()[0].sampler(), mi.Ray3f(mi.Point3f(origin), d))[0]


def edge_points(positions, faces, count=2**19):
    """Points on the edges of triangles that are not at the border of a grid."""
    rng = np.random.default_rng(1)
    within = faces[(np.abs(positions[faces][:, :, :2]) < 1).all(axis=(1, 2))]
    chosen = positions[within[rng.integers(len(within), size=count)]]
    return chosen[:, 0] + rng.uniform(0.05, 0.95, (count, 1)) * (chosen[:, 2] - chosen[:, 0])


def test_mirrors(tmp_path):
    """Mirrored rays that meet edges see the mesh, not what is behind it."""
    positions, faces = grid(33)
    # The mirror is the plane z = 0, the grid at z = 2 faces it.
    mesh = {**write_ply(tmp_path / "grid.ply", positions, faces[:, ::-1]), "to_world": T().translate([0, 0, 2])}
    mirror = {
        "type": "rectangle",
        "to_world": T().scale(9),
        "bsdf": {"type": "mirrorblend", "km": 1.0, "nested": WHITE},
    }
    lamp = {"type": "point", "position": [0, 0, 1]}
    targets = edge_points(positions, faces) - np.array([0, 0, 2.0])
    seen = radiance(scene(mesh, mirror=mirror, lamp=lamp), np.array([0.3, 0.1, 1.5]), targets)
    assert dr.min(seen.x)[0] > 0.1


def test_shadows(tmp_path):
    """Shadow rays that meet edges are blocked."""
    positions, faces = grid(33)
    mesh = write_ply(tmp_path / "grid.ply", positions, faces)
    floor = {"type": "rectangle", "to_world": T().translate([0, 0, -1]).scale(9), "bsdf": WHITE}
    lamp = np.array([0.2, -0.1, 1.0])
    description = scene(mesh, floor=floor, lamp={"type": "point", "position": lamp.tolist()})
    description.pop("sun")
    targets = edge_points(positions, faces)
    # Where the lamp's rays through them would meet the floor.
    onto = lamp + (targets - lamp) * 2
    assert dr.max(radiance(description, np.array([0.1, 0.3, -0.5]), onto).x)[0] == 0


def box(inwards=False):
    """A closed box of eight vertices."""
    positions = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([part for a, b, c, d in quads for part in ((a, b, c), (a, c, d))])
    return positions, faces[:, ::-1] if inwards else faces


def alternating(n=9):
    """A grid of which every second triangle is wound the wrong way."""
    positions, faces = grid(n)
    faces = faces.copy()
    faces[::2] = faces[::2, ::-1]
    return positions, faces


@pytest.mark.parametrize("kind", ("room", "any winding", "close to another", "in a sphere", "after a triangle"))
def test_gaps_are_found_where_rays_have_little_room(kind, tmp_path):
    """Inside of a room, under any winding, between other surfaces, whichever mesh comes first."""
    meshes = {
        "room": {"a": box(inwards=True)},
        "any winding": {"a": alternating()},
        "close to another": {"a": (grid(9)[0] + np.array([0, 0, 0.02], np.float32), grid(9)[1]), "b": grid(9)},
        "in a sphere": {"a": grid(9)},
        "after a triangle": {"a": (grid(2)[0], grid(2)[1][:1]), "b": grid(9)},
    }[kind]
    shapes = {name: write_ply(tmp_path / f"{name}.ply", *mesh) for name, mesh in meshes.items()}
    if kind == "in a sphere":
        shapes["ball"] = {"type": "sphere", "radius": 3.0}
    for flag in (False, True):
        loaded = mi.load_dict({"type": "scene", ROBUST: flag, **shapes})
        assert has_gaps(loaded, [shape for shape in loaded.shapes() if has_triangles(shape)]) != flag


@pytest.mark.parametrize("variant", ("llvm_ad_spectral", "scalar_spectral", "llvm_ad_mono_polarized"))
def test_every_kind_of_light(variant):
    """Rays are tried in all variants."""
    before = mi.variant()
    mi.set_variant(variant)
    try:
        loaded = mi.load_dict(scene({"type": "cube"}, 16))
        assert np.array(mi.render(loaded)).max() > 0
        assert Geometry(loaded).scene is not loaded
    finally:
        mi.set_variant(before)


def test_sampled_in_a_loop(tmp_path):
    """An integrator that is asked while a loop is recorded tries nothing, and traces the scene as it was loaded."""
    loaded = mi.load_dict(scene(shape_of("ply", tmp_path), 4))

    @dr.syntax
    def twice(integrator, loaded, sampler):
        i, total = mi.UInt32(0), mi.Float(0)
        while i < 2:
            ray = mi.Ray3f(mi.Point3f(0.1, 0.2, 5), mi.Vector3f(0, 0, -1))
            total += integrator.sample(loaded, sampler, ray)[0].x
            i += 1
        return total

    assert twice(loaded.integrator(), loaded, loaded.sensors()[0].sampler())[0] == pytest.approx(2, rel=1e-5)


def test_first_picture_launches_few_kernels(tmp_path):
    """What is looked at before is no kernel for each shape."""
    spheres = {f"ball {i}": {"type": "sphere", "center": [i, 0, 0], "radius": 0.4, "bsdf": WHITE} for i in range(40)}
    for more, kernels in (({}, 1), ({"cube": {"type": "cube", "bsdf": WHITE}}, 2)):
        description = scene({"type": "sphere"}, 8, **spheres, **more)
        loaded = mi.load_dict(description)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            dr.eval(mi.render(loaded))
            launched = [kernel for kernel in dr.kernel_history() if kernel["type"] == dr.KernelType.JIT]
        assert len(launched) <= kernels


def test_scenes_that_have_the_flag_are_left_alone(tmp_path):
    """Scenes without gaps, or meshes, are traced as they are; others by another scene of the same shapes."""
    for description, same in (
        ({**scene({"type": "cube"}), ROBUST: True}, True),
        (scene({"type": "sphere"}), True),
        (scene({"type": "cube"}), False),
    ):
        loaded = mi.load_dict(description)
        traced = Geometry(loaded).scene
        assert (traced is loaded) == same
        assert [shape.ptr for shape in traced.shapes()] == [shape.ptr for shape in loaded.shapes()]
        assert loaded.shapes()[0].id() == "shape"


def test_tried_once_and_kept(tmp_path):
    """The second picture of a scene tries nothing and builds nothing; moved vertices are followed."""
    loaded, tight = mi.load_dict(scene(shape_of("ply", tmp_path), 64)), Tight()
    assert tight.of(loaded) is tight.of(loaded)
    params = mi.traverse(loaded)
    before, image = tight.of(loaded), np.array(mi.render(loaded))
    params["shape.vertex_positions"] = params["shape.vertex_positions"] * 0.5
    params.update()
    smaller = np.array(mi.render(loaded))
    assert tight.of(loaded) is not before
    assert (smaller > 0).sum() == pytest.approx((image > 0).sum() / 4, rel=0.2)


def test_vertices_of_soups(tmp_path):
    """Triangles that share places, not vertices, have edges in common as well."""
    positions, faces = grid(9)
    soup = write_ply(tmp_path / "soup.ply", positions[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3))
    loaded = mi.load_dict(scene(soup))
    assert has_gaps(loaded, [shape for shape in loaded.shapes() if has_triangles(shape)])


def test_no_edges_no_gaps(tmp_path):
    """A single triangle, and two of no area, are nothing to try."""
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0]], np.float32)
    for faces in ([[0, 1, 2]], [[0, 1, 3], [1, 0, 3]]):
        loaded = mi.load_dict(scene(write_ply(tmp_path / "one.ply", positions, np.array(faces))))
        assert not has_gaps(loaded, loaded.shapes())


def test_all_that_is_loaded_and_converted_has_the_flag(tmp_path):
    """Scenes that commands load, and files that they write, have no gaps for any integrator; scenes without meshes keep
    the faster way."""
    write_obj(tmp_path / "grid.obj", *grid(9))
    convert_model(tmp_path / "grid.obj", tmp_path / "model.xml")
    assert f'<boolean name="{ROBUST}" value="true"/>' in (tmp_path / "model.xml").read_text()
    loaded = mi.load_file(str(tmp_path / "model.xml"))
    assert not has_gaps(loaded, loaded.shapes())

    bare = '<scene version="3.0.0"><integrator type="path"/><bsdf type="diffuse" id="b"/>{}</scene>'
    shape = '<shape type="{}"><transform name="to_world"><translate x="{}"/></transform><ref id="b"/></shape>'
    for shapes in (("cube",), ("sphere", "cube"), ("rectangle", "cube")):
        (tmp_path / "bare.xml").write_text(bare.format("".join(map(shape.format, shapes, (0, 3)))))
        loaded = mi.load_file(str(tmp_path / "bare.xml"))
        assert has_gaps(loaded, [found for found in loaded.shapes() if has_triangles(found)])
        loaded = rendering.load(tmp_path / "bare.xml").scene
        assert not has_gaps(loaded, [found for found in loaded.shapes() if has_triangles(found)])


def test_what_has_no_triangles_is_traced_as_ever(tmp_path):
    """A rectangle by itself, spheres: the same bits as Mitsuba's own loading gives."""
    text = (
        '<scene version="3.0.0"><integrator type="whitted"/><shape type="rectangle"/><shape type="disk"/>'
        '<shape type="sphere"/><sensor type="perspective"/></scene>'
    )
    (tmp_path / "bare.xml").write_text(text)
    ray = aimed(*grid(9), 10_000)
    by_mitsuba, by_us = mi.load_file(str(tmp_path / "bare.xml")), rendering.load(tmp_path / "bare.xml").scene
    assert dr.all(by_mitsuba.ray_intersect(ray).p == by_us.ray_intersect(ray).p, axis=None)


def test_derivatives_by_vertices(tmp_path):
    """Those of the shading are seen through the other scene as through this one."""
    gradients = []
    for flag in (True, False):
        loaded = mi.load_dict({**scene(shape_of("ply", tmp_path), 32), ROBUST: flag, "lamp": {
            "type": "point", "position": [0.3, 0.2, 2.0]}})  # fmt: skip
        params = mi.traverse(loaded)
        dr.enable_grad(params["shape.vertex_positions"])
        params.update()
        dr.backward(dr.sum(mi.render(loaded, params).array))
        gradients.append(np.array(dr.grad(params["shape.vertex_positions"])))
    assert np.abs(gradients[0]).max() > 0.1 and gradients[1] == pytest.approx(gradients[0], abs=1e-3)


def test_recorded_functions_say_what_they_cannot_help(tmp_path, monkeypatch):
    """A recording traces the scene as it was loaded, and says so once; not of a scene that is known to have no gaps."""
    monkeypatch.setattr(tracing_geometry, "_warned", False)
    for flag, times in ((True, 0), (False, 1)):
        loaded = mi.load_dict({**scene(shape_of("ply", tmp_path), 16), ROBUST: flag})
        mi.render(loaded)
        frozen = dr.freeze(lambda scene, seed: mi.render(scene, seed=seed).array)
        with messages() as said:
            for seed in range(3):
                dr.eval(frozen(loaded, mi.UInt32(seed)))
        assert sum("slip between the triangles" in text for text in said) == times
