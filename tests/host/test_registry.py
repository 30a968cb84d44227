"""The plugins are there in every variant, whenever and however often the package is imported."""

import inspect
import subprocess
import sys
from importlib import metadata

import mitsuba as mi
import numpy as np
import pytest

import phong_bsdf
from helpers.variants import CPU_VARIANTS

KINDS = {"phong": "bsdf", "blinnphong": "bsdf", "mirrorblend": "bsdf", "whitted": "integrator"}

SPHERE = {"type": "sphere", "center": [0, 0, 3]}
SCENE = {
    "type": "scene",
    "integrator": {"type": "whitted"},
    "camera": {
        "type": "perspective",
        "film": {"type": "hdrfilm", "width": 3, "height": 3, "rfilter": {"type": "box"}},
        "sampler": {"type": "independent", "sample_count": 1},
    },
    "light": {"type": "point", "position": [1, 1, 0]},
    "a": {**SPHERE, "bsdf": {"type": "phong", "p": 5}},
    "b": {**SPHERE, "bsdf": {"type": "blinnphong", "p": 5}},
    "c": {**SPHERE, "bsdf": {"type": "mirrorblend", "nested": {"type": "phong"}}},
}


def check():
    """Load the scene: its objects are of the classes in the plugins' modules, made for the active variant."""
    scene = mi.load_dict(SCENE)
    plugins = phong_bsdf.plugins
    used = {type(x) for x in [scene.integrator(), *(shape.bsdf() for shape in scene.shapes())]}
    bsdfs = {plugins.phong.Phong, plugins.blinnphong.BlinnPhong, plugins.mirrorblend.MirrorBlend}
    assert used == {*bsdfs, plugins.whitted.Whitted}, used
    assert all(issubclass(bsdf, mi.BSDF) for bsdf in bsdfs), mi.variant()
    return scene


MITSUBA, PACKAGE = "import mitsuba as mi\n", "import phong_bsdf\n"
RELOAD = "import importlib; importlib.reload(phong_bsdf); importlib.reload(phong_bsdf)\n"
CHECK = f"SCENE = {SCENE!r}\n{inspect.getsource(check)}\ncheck()\n"


def set_variant(name):
    return f"mi.set_variant({name!r})\n"


def run(code):
    """What a new Python prints. It takes the LLVM from the environment, where this process has put it."""
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert child.returncode == 0, child.stderr
    return child.stdout


def test_import_sets_no_variant():
    """The choice of the variant is left to the user."""
    assert run(PACKAGE + MITSUBA + "print(mi.variant())") == "None\n"


@pytest.mark.parametrize("variant", CPU_VARIANTS)
@pytest.mark.parametrize("first", ["import", "variant"])
def test_every_variant(variant, first):
    """All four plugins load in every CPU variant, be it set before or after the import."""
    steps = [PACKAGE, set_variant(variant)] if first == "import" else [set_variant(variant), PACKAGE]
    run(MITSUBA + "".join(steps) + CHECK)


def test_switching_variants_and_back():
    """After each switch the plugins are the new variant's; a scene from before renders again at the end."""
    scene = check()
    before = np.array(mi.render(scene))
    assert before.max() > 0
    for variant in ("scalar_rgb", "llvm_ad_mono", "scalar_spectral", "llvm_ad_rgb"):
        mi.set_variant(variant)
        mi.set_log_level(mi.LogLevel.Error)
        again = check()
    assert np.array_equal(np.array(mi.render(again)), before)
    assert np.array_equal(np.array(mi.render(scene)), before)


@pytest.mark.parametrize("variant", [None, "scalar_rgb", "llvm_ad_rgb"])
def test_reload(variant):
    """Reloading the package, as Mitsuba 3.10 does at each variant, keeps the plugins and their classes."""
    now = RELOAD
    if variant:
        before = "old = phong_bsdf.plugins.phong.Phong\n"
        after = "assert phong_bsdf.plugins.phong.Phong is old\n"
        now = set_variant(variant) + before + RELOAD + after + CHECK
    later = [set_variant(name) + CHECK for name in ("llvm_ad_mono", "scalar_rgb", "llvm_ad_rgb")]
    run(PACKAGE + MITSUBA + now + "".join(later))


def test_reload_adds_no_work_to_later_switches():
    """However often the package is reloaded, a switch of variants calls the registry once."""
    count = "calls, load = [], phong_bsdf.host.registry._load\n"
    count += "phong_bsdf.host.registry._load = lambda variant: (calls.append(variant), load(variant))\n"
    switch = "calls.clear()\n" + set_variant("llvm_ad_mono") + "print(calls)\n"
    code = PACKAGE + MITSUBA + set_variant("llvm_ad_rgb") + RELOAD + count + switch
    assert run(code) == "['llvm_ad_mono']\n"


def test_kinds_are_known_without_scalar_rgb():
    """Mitsuba knows what the plugins are, though it asks scalar_rgb, which may never have been set.

    Otherwise messages speak of an `unknown plugin`, and scenes cannot be written to XML.
    """
    out = run(PACKAGE + MITSUBA + set_variant("llvm_ad_rgb") + f"""
for name in {list(KINDS)}:
    print(mi.PluginManager.instance().plugin_type(name).name.lower())
for wrong in {{"type": "phong", "p": -1}}, {{"type": "whitted", "max_depth": 0}}:
    try: mi.load_dict(wrong)
    except RuntimeError as error: print(str(error).split("instantiate ")[1].split(":")[0])
print(mi.parser.write_string(mi.parser.parse_dict(mi.parser.ParserConfig(mi.variant()), {SCENE!r})))
""")  # fmt: skip
    lines = out.splitlines()
    assert lines[:4] == list(KINDS.values())
    assert lines[4:6] == ['bsdf plugin of type "phong"', 'integrator plugin of type "whitted"']
    for name, kind in KINDS.items():
        assert f'<{kind} type="{name}"' in out


@pytest.mark.parametrize(
    ("xml", "message"),
    [
        ('<integrator type="phong"/>', '"phong" is of type "bsdf"'),
        ('<shape type="sphere"><bsdf type="whitted"/></shape>', '"whitted" is of type "integrator"'),
    ],
)
def test_wrong_kind_is_a_type_error(xml, message):
    """A plugin in the wrong place is called that, not unknown."""
    with pytest.raises(RuntimeError, match=message):
        mi.load_string(f'<scene version="3.0.0">{xml}</scene>')


def test_entry_point():
    """Mitsuba 3.10 finds the package by its entry point."""
    (point,) = metadata.entry_points(group="mitsuba", name="phong_bsdf")
    assert point.load() is phong_bsdf
