"""Scenes load whatever their size and number of threads: no constructor waits for Dr.Jit, what it cannot know is looked
at before it is used."""

import gc
import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from helpers import ROOT
from helpers.bsdfs import material, mirror, pixels, row
from helpers.small_scenes import render
from helpers.variants import CPU_VARIANTS
from phong_bsdf.host import registry
from phong_bsdf.pictures import images
from phong_bsdf.scene import rendering
from phong_bsdf.scene.errors import SceneError

STOPPED = ROOT / "tests/helpers/stopped_pool.py"


def stopped(*words):
    return subprocess.run([sys.executable, STOPPED, *words], capture_output=True, text=True, timeout=300)


@pytest.mark.parametrize("variant", [v for v in CPU_VARIANTS if v.startswith("llvm") or v == "scalar_rgb"])
def test_no_constructor_waits_for_the_pool(variant):
    """All plugins, all kinds of values, while the pool stands still: `stopped_pool.py`."""
    child = stopped(variant)
    assert child.returncode == 0 and child.stdout.endswith(f" made in {variant}\n"), child.stderr


def test_a_stopped_pool_shows_who_waits():
    """The test above can fail: to read an array is to wait."""
    child = stopped("llvm_ad_rgb", "read")
    assert child.returncode == 1 and "Timeout" in child.stderr


def test_constructors_launch_no_kernel():
    """Of values that arrive as objects; numbers Mitsuba itself puts into arrays."""
    objects = {"uniform": {"type": "uniform", "value": 0.7}, "bitmap": pixels(np.full((2, 2, 3), 0.7))}
    objects |= {"checkerboard": {"type": "checkerboard"}, "mesh": {"type": "mesh_attribute", "name": "vertex_color"}}
    nested = mi.load_dict({"type": "diffuse"})
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for value in [mi.load_dict(description) for description in objects.values()]:
            dr.kernel_history_clear()
            made = [mi.load_dict(material(kind, vocabulary, value, value, value))
                    for kind in ("phong", "blinnphong") for vocabulary in ("coefficients", "reflectances")]  # fmt: skip
            made += [mi.load_dict(mirror(nested, value)), mi.load_dict({"type": "whitted", "ambient": value})]
            assert dr.kernel_history() == []


def test_nothing_is_looked_at_while_a_scene_loads():
    """Not by Mitsuba's adapters, shapes and scenes either, but at the first `traverse` of our loading functions."""
    bsdf = material("phong", "reflectances", pixels(np.full((2, 2, 3), 0.7)), 0.6)
    scene = mi.load_dict(row([bsdf, {"type": "twosided", "b": mirror(bsdf)}], {"type": "whitted"}))
    assert scene.shapes()[0].bsdf().unsettled or scene.shapes()[1].bsdf().unsettled
    mi.traverse(scene)
    assert not any(getattr(shape.bsdf(), "unsettled", False) for shape in scene.shapes())


# What was not looked at is, before it is used -----------------------------------------------------------------


def unknown():
    """BSDFs with all that a constructor does not know: textures, constants that are objects, sums beyond 1."""
    rng = np.random.default_rng(1)
    texture, constant = (lambda: pixels(rng.random((4, 4, 3)))), (lambda x: {"type": "uniform", "value": x})
    return [
        material("phong", "reflectances", texture(), 0.6),
        mirror(material("blinnphong", "reflectances", texture(), constant(0.6)), constant(0.3)),
        {"type": "twosided", "b": material("phong", "reflectances", texture(), 0.6)},
        {"type": "phong", "kd": 0.3, "ks": constant(0.0)},
    ]


@pytest.mark.parametrize("integrator", ("path", "direct", "prb", "whitted"))
def test_first_use_is_a_rendering(integrator):
    """It may be recorded, and frozen: bit by bit the picture of a scene that was looked at before, and so after an
    update."""
    pictures = []
    for way in ("looked at", "plain", "frozen"):
        scene = mi.load_dict(row(unknown(), {"type": integrator}))
        if way == "looked at":
            mi.traverse(scene)
        draw = dr.freeze(lambda scene, seed: mi.render(scene, seed=seed)) if way == "frozen" else mi.render
        found = [np.array(draw(scene, seed=mi.UInt32(seed)) if way == "frozen" else draw(scene, seed=seed))
                 for seed in range(3)]  # fmt: skip
        params = mi.traverse(scene)
        key = next(key for key in params.keys() if key.endswith("specular_reflectance.value"))  # noqa: SIM118
        params[key] = 0.9
        params.update()
        found.append(np.array(draw(scene, seed=mi.UInt32(3)) if way == "frozen" else draw(scene, seed=3)))
        pictures.append(np.array(found))
    assert np.array_equal(pictures[0], pictures[1]) and np.array_equal(pictures[0], pictures[2])
    # The energy rule is among what was looked at.
    for bsdf in (bright := unknown())[:2]:
        bsdf.get("nested", bsdf)["ensure_energy_conservation"] = False
    assert not np.array_equal(pictures[1][0], render(row(bright, {"type": integrator}), seed=0))


@pytest.mark.parametrize("first", ("traverse", "eval", "pdf", "albedo", "path", "whitted", "load"))
@pytest.mark.parametrize("variant", ("llvm_ad_rgb", "scalar_rgb"))
def test_the_warning_comes_once_and_before_the_first_picture(variant, first, messages, tmp_path):
    """At the first look, with our loading functions at once."""
    mi.set_variant(variant)
    bsdf = material("phong", "reflectances", 0.9, 0.6)
    if first == "load":
        xml = tmp_path / "a.xml"
        xml.write_text('<scene version="3.0.0"><integrator type="whitted"/><shape type="sphere"><bsdf type="phong">'
                       '<float name="diffuse_reflectance" value="0.9"/><float name="specular_reflectance" value="0.6"/>'
                       "</bsdf></shape></scene>")  # fmt: skip
        scene = rendering.load(xml).scene
    else:
        scene = mi.load_dict(row([bsdf], {"type": first if first in ("path", "whitted") else "direct"}))
        if first == "traverse":
            mi.traverse(scene)
        elif first in ("eval", "pdf", "albedo"):
            bsdf, si = scene.shapes()[0].bsdf(), dr.zeros(mi.SurfaceInteraction3f)
            if first == "albedo":
                bsdf.eval_diffuse_reflectance(si, True)
            else:
                getattr(bsdf, first)(mi.BSDFContext(), si, mi.Vector3f(0, 0, 1), True)
        else:
            np.array(mi.render(scene, spp=1))
    warned = [text for text in messages if "multiplied by" in text]
    assert len(warned) == 1 and "0.66" in warned[0]
    mi.traverse(scene)
    assert len([text for text in messages if "multiplied by" in text]) == 1


@pytest.mark.parametrize("first", ("path", "whitted"))
def test_one_bad_scene_does_not_spoil_others(first):
    """The first picture of a bad constant is an error; that it is alive, Dr.Jit then asks it, none of another scene."""
    bad = mi.load_dict(row([{"type": "phong", "kd": {"type": "uniform", "value": -2.0}}], {"type": first}))
    with pytest.raises((ValueError, RuntimeError)) as error:
        render(bad)
    cause = error.value
    while cause.__cause__ is not None:
        cause = cause.__cause__
    assert "phong: 'kd' must be finite and >= 0, got -2" in str(cause)
    good = mi.load_dict(row([{"type": "phong"}], {"type": "path"}))
    assert render(good).mean() > 0
    with pytest.raises(ValueError, match="'kd' must be"):
        mi.traverse(bad)


def test_ambient_light_that_is_an_object():
    """Looked at before the first picture: none is left out of the kernel, and a negative one is refused."""
    for value, bad in ((0.0, False), (0.5, False), (-1.0, True)):
        ambient = {"type": "uniform", "value": value}
        scene = mi.load_dict(row([{"type": "phong"}], {"type": "whitted", "ambient": ambient}))
        if bad:
            with pytest.raises(RuntimeError) as error:
                render(scene)
            assert "whitted: 'ambient' must be finite and >= 0, got -1" in str(error.value.__cause__)
        else:
            assert ("ambient" in scene.integrator().features(scene, scene.sensors()[0], 1)) == (value > 0)


def test_our_loading_functions_look_at_once(tmp_path):
    """A bad constant that arrives as an object is a sentence when the scene is loaded."""
    xml = tmp_path / "bad.xml"
    xml.write_text('<scene version="3.0.0"><integrator type="whitted"/><shape type="sphere"><bsdf type="mirrorblend">'
                   '<texture name="km" type="uniform"><float name="value" value="3"/></texture><bsdf type="phong"/>'
                   "</bsdf></shape></scene>")  # fmt: skip
    with pytest.raises(SceneError, match=r"bad\.xml: mirrorblend: 'km' must be in \[0, 1\], got 3"):
        rendering.load(xml)


# Loads that hung ---------------------------------------------------------------------------------------------


def scene_with_textures(folder):
    """Eight small EXR files under some of ten BSDFs of the package; the others are constant, and need not wait for a
    file."""
    rng = np.random.default_rng(0)
    for i in range(8):
        images.write(folder / f"{i}.exr", rng.random((8, 8, 3), dtype=np.float32), linear=True)
    images.write(folder / "t.png", rng.random((8, 8, 3), dtype=np.float32), linear=True)

    def texture(name, file):
        file = f'<string name="filename" value="{file}"/>'
        return f'<texture type="bitmap" name="{name}">{file}<boolean name="raw" value="true"/></texture>'

    def constant(i):
        return f'<bsdf type="blinnphong"><rgb name="kd" value="0.{i + 1}, 0.5, 0.2"/><rgb name="ks" value="1"/></bsdf>'

    def textured(i):
        lobe = f'<bsdf type="phong">{texture("ks", f"{i}.exr")}{texture("p", f"{i + 1}.exr")}</bsdf>'
        return f'<bsdf type="mirrorblend">{texture("km", f"{i + 2}.exr")}{lobe}</bsdf>' if i < 6 else lobe

    def blend(i):
        bumps = f'<bsdf type="normalmap"><rgb name="normalmap" value="0.5, 0.5, 0"/>{constant(i + 1)}</bsdf>'
        return f'<bsdf type="blendbsdf"><float name="weight" value="0.5"/>{constant(i)}{bumps}</bsdf>'

    bsdfs = [
        f'<bsdf type="mask">{texture("opacity", "t.png")}<bsdf type="twosided"><bsdf type="bumpmap">'
        f'{texture("bumps", "t.png")}{blend(0)}</bsdf></bsdf></bsdf>',
        *(f'<bsdf type="twosided"><bsdf type="normalmap">{texture("normalmap", "t.png")}{textured(i)}</bsdf></bsdf>'
          for i in (0, 3, 6)),
        *(f'<bsdf type="twosided">{constant(i)}</bsdf>' for i in (2, 3, 4)),
    ]  # fmt: skip
    shapes = [f'<shape type="sphere"><point name="center" x="{3 * i}" y="0" z="0"/>{b}</shape>'
              for i, b in enumerate(bsdfs)]  # fmt: skip
    xml = folder / "textures.xml"
    whitted = '<integrator type="whitted"><float name="ambient" value="0.1"/></integrator>'
    lines = f'{whitted}<emitter type="point"/><sensor type="perspective"/>{"".join(shapes)}'
    xml.write_text(f'<scene version="3.0.0">{lines}</scene>')
    return xml


LOAD = """
import sys
import phong_bsdf, mitsuba as mi, drjit as dr
mi.set_variant("llvm_ad_rgb")
dr.set_thread_count(int(sys.argv[1]))
mi.load_file(sys.argv[2])
"""

# Seconds that a load may take, which takes one on a machine that is busy: one that hangs, hangs for ever.
LONGEST = 90


@pytest.mark.slow
@pytest.mark.parametrize("threads", (2, 3))
def test_no_load_hangs(threads, tmp_path):
    """Thirty, six of them beside each other, each in a process of its own. Before, most of them hung."""
    xml = scene_with_textures(tmp_path)

    def load(_):
        subprocess.run([sys.executable, "-c", LOAD, str(threads), xml], check=True, timeout=LONGEST)

    with ThreadPoolExecutor(6) as several:
        assert len(list(several.map(load, range(30)))) == 30


def test_garbage_waits_while_a_scene_loads(tmp_path):
    """To free a dead scene is to wait for the pool, so our loading functions do not; what was set before, stays."""
    xml = scene_with_textures(tmp_path)
    collected, seen = [], []

    def watch(phase, _):
        seen.append(phase)
        collected.append(threading.current_thread())

    before, enabled = gc.get_threshold(), gc.isenabled()
    try:
        for state in (True, False):
            (gc.enable if state else gc.disable)()
            parsed = rendering.parse(xml)
            gc.set_threshold(1, 1000, 1000)
            gc.callbacks.append(watch)
            with rendering.undisturbed():
                seen.clear()
                kept = [[] for _ in range(1000)]
                assert seen == [] and len(kept) == 1000
            gc.callbacks.remove(watch)
            gc.set_threshold(*before)
            assert gc.isenabled() == state
            rendering.make(xml, parsed)
            assert gc.isenabled() == state
    finally:
        gc.set_threshold(*before)
        (gc.enable if enabled else gc.disable)()


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="this system does not choose cores")
def test_one_core_has_two_threads():
    """With one thread Mitsuba waits for ever where it reads an EXR file, its own scenes' too."""
    code = "import os; os.sched_setaffinity(0, [min(os.sched_getaffinity(0))]); import phong_bsdf, drjit as dr"
    child = subprocess.run([sys.executable, "-c", f"{code}; print(dr.thread_count())"], capture_output=True, text=True)
    assert child.stdout == "2\n", child.stderr
    assert dr.thread_count() >= 2 and registry.PLUGINS
