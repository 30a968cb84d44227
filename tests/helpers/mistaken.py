"""The oracle with a switch for each usual mistake, and its scenes as files: what students hand in.

Written from the formulas, like `oracle.py`; nothing of the package.
"""

import math
from dataclasses import replace

import numpy as np

from helpers.oracle import Camera, Light, Scene, Sphere, dot, intersect, normalize

# Spheres of radius other than 1, highlights under mirrors, lights of different lengths: every mistake shows.
CLASS = {
    "a": Scene(
        [
            Sphere((-1.2, -0.2, -5), 0.8, (0.7, 0.2, 0.1), (0.6,) * 3, 20),
            Sphere((1.1, -0.3, -4.5), 0.7, (0.1, 0.3, 0.7), (0.3,) * 3, 60, km=0.3),
            Sphere((0, -101, -5), 100, (0.5,) * 3, (0.2,) * 3, 8, km=0.4),
        ],
        [Light(0.7, (-3, 4, -1)), Light(0.4, (0.4, -0.6, -2.5)), Light(0.3, (-0.6, 1.5, -9))], bounces=2,
    ),
    "b": Scene(
        [
            Sphere((0, 0.2, -6), 1.3, (0.2, 0.6, 0.3), (0.5, 0.4, 0.3), 15, km=0.25),
            Sphere((-1.4, -0.5, -3.8), 0.5, (0.8, 0.7, 0.1), (0.7,) * 3, 40),
            Sphere((1.5, -0.4, -4.2), 0.6, (0.6, 0.2, 0.6), (0.2,) * 3, 10, km=0.5),
            Sphere((0, -51, -4), 50, (0.4, 0.4, 0.5), (0.3,) * 3, 25, km=0.2),
        ],
        [Light(0.6, toward=(2, 3, 1)), Light(0.5, (-0.5, -0.6, -2.4)), Light(0.3, toward=(0.2, 0.3, -1))], bounces=3,
    ),
    "c": Scene(
        [
            Sphere((-0.8, 0.1, -4), 0.9, (0.3, 0.3, 0.8), (0.4,) * 3, 30, km=0.35),
            Sphere((0.9, -0.5, -3.5), 0.5, (0.9, 0.4, 0.2), (0.8, 0.7, 0.6), 12),
            Sphere((0.2, 1.1, -5), 0.4, (0.7,) * 3, (0.5,) * 3, 100),
            Sphere((0, -31, -4), 30, (0.5, 0.6, 0.5), (0.25,) * 3, 5, km=0.3),
        ],
        [Light(0.5, (2.5, 2.5, 0.5)), Light(0.35, (-1.5, -0.6, -2.2)), Light(0.3, toward=(-0.2, 0.3, -2))],
        background=(0.05, 0.08, 0.15), ambient=0.06, bounces=2,
    ),
}  # fmt: skip


def render(scene, mistakes=(), width=120, height=90):
    """Linear picture with some of the mistakes, (height, width, 3)."""
    if "swapped" in mistakes:
        scene = swap(scene, ("p",))
    if "fewer" in mistakes:
        scene = replace(scene, bounces=scene.bounces - 1)
    if "lobe" in mistakes:
        scene = replace(scene, lobe="phong" if scene.lobe == "blinnphong" else "blinnphong")
    camera = scene.camera
    back = -normalize(np.array(camera.view, float))
    right = normalize(np.cross(camera.up, back))
    up = np.cross(back, right)
    center = 0.0 if "half-pixel" in mistakes else 0.5
    x = (np.arange(width) + center) / width - 0.5
    y = (0.5 - (np.arange(height) + center) / height) * height / width
    plane = (x[None, :, None] * right + y[:, None, None] * up - camera.focal * back).reshape(-1, 3)
    eye = np.broadcast_to(np.array(camera.eye, float), plane.shape)
    image = trace(scene, mistakes, eye, normalize(plane), scene.bounces, np.linalg.norm(plane, axis=-1))
    return image.reshape(height, width, 3)


def store(image, mistakes=(), srgb=False):
    """What a file of 8 bits holds."""
    image = np.clip(image, 0, 1)
    if srgb != ("curve" in mistakes):
        image = np.where(image <= 0.0031308, 12.92 * image, 1.055 * image ** (1 / 2.4) - 0.055)
    image = np.rint(255 * image).astype(np.uint8)
    return image[::-1] if "flipped" in mistakes else image


def swap(scene, names, one=(0,), other=(1,)):
    """The scene in which two groups of spheres have each other's values."""
    spheres = list(scene.spheres)
    for mine, others in ((one, other), (other, one)):
        for i in mine:
            spheres[i] = replace(spheres[i], **{name: getattr(scene.spheres[others[0]], name) for name in names})
    return replace(scene, spheres=spheres)


def trace(scene, mistakes, o, d, bounces, start):
    image = np.tile(np.array(scene.background, float), (len(o), 1))
    if len(o) == 0:
        return image
    t, index = intersect(scene, o, d, start)
    for i, sphere in enumerate(scene.spheres):
        hit = index == i
        p = o[hit] + t[hit, None] * d[hit]
        n, v = (p - np.array(sphere.center)) / sphere.radius, -d[hit]
        diffuse, highlight = local(scene, mistakes, i, p, n, v, t[hit])
        color = diffuse + highlight
        if sphere.km > 0 and (bounces > 0 or "dark-end" in mistakes):
            mirrored = 0
            if bounces > 0:
                m = n * sphere.radius if "normal" in mistakes else n
                r = normalize(2 * dot(m, v)[:, None] * m - v)
                mirrored = trace(scene, mistakes, p + 1e-9 * sphere.radius * n, r, bounces - 1, 0.0)
            color = blend(mistakes, sphere.km, mirrored, diffuse, highlight)
        image[hit] = color
    return image


def blend(mistakes, km, mirrored, diffuse, highlight):
    if "mirror-added" in mistakes:
        return km * mirrored + diffuse + highlight
    if "mirror-full" in mistakes:
        return mirrored + diffuse + highlight
    if "highlight-unblended" in mistakes:
        return km * mirrored + (1 - km) * diffuse + highlight
    return km * mirrored + (1 - km) * (diffuse + highlight)


def local(scene, mistakes, index, p, n, v, distance):
    """Diffuse light, ambient included, and highlight at the points `p` of one sphere."""
    sphere = scene.spheres[index]
    diffuse = np.tile(scene.ambient * np.array(sphere.kd, float), (len(p), 1))
    highlight = np.zeros_like(diffuse)
    front = dot(n, v) > 0
    v = v * distance[:, None] if "view" in mistakes else v
    for number, light in enumerate(scene.lights):
        if number == 1 and "light-missing" in mistakes:
            continue
        if light.position is not None:
            l = np.array(light.position, float) - p  # noqa: E741
            away = np.linalg.norm(l, axis=-1)
        else:
            l, away = np.broadcast_to(np.array(light.toward, float), p.shape), np.full(len(p), np.inf)  # noqa: E741
        lit = front & visible(scene, mistakes, index, p, n, normalize(l), away)
        strength = light.intensity / away**2 if "falloff" in mistakes and light.position else light.intensity
        a, b = reflected(scene, mistakes, sphere, n, l if "light" in mistakes else normalize(l), v)
        diffuse += np.where(lit, strength, 0)[:, None] * a
        highlight += np.where(lit, strength, 0)[:, None] * b
    return diffuse, highlight


def visible(scene, mistakes, index, p, n, l, away):  # noqa: E741
    above = dot(n, l) > 0
    others = scene
    if "behind" in mistakes:
        # A common cure for acne: a sphere never shadows itself.
        others = replace(scene, spheres=scene.spheres[:index] + scene.spheres[index + 1 :])
        above = np.ones_like(above)
    if "no-shadows" in mistakes:
        return above
    start = p if "acne" in mistakes else p + 1e-9 * scene.spheres[index].radius * n
    t, _ = intersect(others, start, l, 0.0)
    return above & (np.isinf(t) if "past" in mistakes else t >= away)


def reflected(scene, mistakes, sphere, n, l, v):  # noqa: E741
    n = n * sphere.radius if "normal" in mistakes else n
    if scene.lobe == "phong":
        cos = dot(2 * dot(n, l)[:, None] * n - l, v)
    elif "half" in mistakes:
        cos = dot(n, v + l)
    else:
        cos = dot(n, normalize(v + l))
    lobe = np.maximum(cos, 0) ** sphere.p
    if "cosine" in mistakes:
        lobe = lobe * np.maximum(dot(n, l), 0)
    return np.maximum(dot(n, l), 0)[:, None] * np.array(sphere.kd), lobe[:, None] * np.array(sphere.ks)


# The same scenes for the package -----------------------------------------------------------------------------


def xml(scene, width=120, height=90):
    """The scene as a file for Mitsuba."""

    def numbers(values):
        return ", ".join(repr(float(x)) for x in values)

    def point(tag, name, values):
        x, y, z = values
        return f'<{tag} name="{name}" x="{x}" y="{y}" z="{z}"/>'

    parts = [
        f'<integrator type="whitted"><integer name="max_depth" value="{scene.bounces + 2}"/>'
        f'<float name="ambient" value="{scene.ambient}"/></integrator>',
        _sensor(scene.camera, width, height),
    ]
    if any(scene.background):
        parts.append(f'<emitter type="constant"><rgb name="radiance" value="{numbers(scene.background)}"/></emitter>')
    for light in scene.lights:
        if light.position is not None:
            parts.append(f'<emitter type="point">{point("point", "position", light.position)}'
                         f'<float name="intensity" value="{light.intensity}"/></emitter>')  # fmt: skip
        else:
            parts.append(f'<emitter type="directional">{point("vector", "direction", [-x for x in light.toward])}'
                         f'<float name="irradiance" value="{light.intensity}"/></emitter>')  # fmt: skip
    for i, sphere in enumerate(scene.spheres):
        bsdf = (
            f'<bsdf type="{scene.lobe}"><rgb name="kd" value="{numbers(sphere.kd)}"/>'
            f'<rgb name="ks" value="{numbers(sphere.ks)}"/><float name="p" value="{sphere.p}"/></bsdf>'
        )
        if sphere.km:
            bsdf = f'<bsdf type="mirrorblend"><float name="km" value="{sphere.km}"/>{bsdf}</bsdf>'
        parts.append(f'<shape type="sphere" id="ball-{i}">{point("point", "center", sphere.center)}'
                     f'<float name="radius" value="{sphere.radius}"/>{bsdf}</shape>')  # fmt: skip
    return '<scene version="3.0.0">\n' + "\n".join(parts) + "\n</scene>\n"


def _sensor(camera: Camera, width, height):
    def text(values):
        return ", ".join(str(x) for x in values)

    target = np.add(camera.eye, camera.view)
    return (
        f'<sensor type="perspective"><string name="fov_axis" value="x"/>'
        f'<float name="fov" value="{2 * math.degrees(math.atan(0.5 / camera.focal))}"/>'
        f'<float name="near_clip" value="{camera.focal}"/><transform name="to_world">'
        f'<lookat origin="{text(camera.eye)}" target="{text(target)}" up="{text(camera.up)}"/></transform>'
        f'<sampler type="independent"><integer name="sample_count" value="1"/></sampler>'
        f'<film type="hdrfilm"><integer name="width" value="{width}"/><integer name="height" value="{height}"/>'
        f'<string name="pixel_format" value="rgb"/><rfilter type="box"/></film></sensor>'
    )
