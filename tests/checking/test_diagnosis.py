"""Every usual mistake, made by the oracle and saved with 8 bits, is found; what is no mistake is not called one."""

import re
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from helpers import ROOT, mistaken, oracle
from phong_bsdf.checking import diagnosis, grading, shading, stage
from phong_bsdf.scene import rendering

WIDTH, HEIGHT = 100, 75

# The second ball is behind the camera.
HIDDEN = oracle.Scene(
    [oracle.Sphere((0, 0, -3), 1, ks=(0.6,) * 3, p=20), oracle.Sphere((0, 0, 5), 1, p=20)],
    [oracle.Light(0.7, (-3, 4, -1))],
)

SCENES = {
    "hidden": HIDDEN,
    **mistaken.CLASS,
    **{f"{name}-phong": replace(scene, lobe="phong") for name, scene in mistaken.CLASS.items()},
    **{f"course-{i}": oracle.COURSE[i] for i in range(1, 7)},
    "course-5-short": replace(oracle.COURSE[5], bounces=2),
}

# The oracle's switch -> the name of the mistake, and scenes that show it.
MISTAKES = {
    "falloff": ("falloff", ("a", "c", "course-4")),
    "view": ("view-length", ("a", "b", "course-4")),
    "light": ("light-length", ("b", "c-phong", "course-5")),
    "normal": ("normal-length", ("b", "c", "course-5")),
    "half": ("half-length", ("a", "b", "course-4")),
    "lobe": (None, ("a", "b", "course-4", "a-phong", "b-phong", "c-phong")),
    "mirror-added": ("mirror-added", ("a", "b-phong", "course-5")),
    "mirror-full": ("mirror-full", ("a", "b", "course-5")),
    "highlight-unblended": ("highlight-unblended", ("a", "b", "c")),
    "no-shadows": ("no-shadows", ("a", "b-phong", "course-4")),
    "acne": ("shadow-acne", ("a", "b", "course-4")),
    "past": ("shadow-past-light", ("a", "c", "course-4")),
    "behind": ("behind", ("a", "b-phong", "course-4")),
    "cosine": ("highlight-cosine", ("a", "c-phong", "course-4")),
    "curve": (None, ("a", "b-phong", "course-5")),
    "flipped": ("flipped", ("a", "c-phong", "course-5")),
    "half-pixel": ("half-pixel", ("a", "c-phong", "course-4")),
    "fewer": ("too-few-bounces", ("a", "b", "course-5-short")),
    "dark-end": ("dark-end", ("a", "c-phong", "course-5-short")),
    "swapped": ("materials-swapped", ("a", "b", "c-phong")),
    "light-missing": ("light-missing", ("a", "b", "course-4")),
}  # fmt: skip

QUICK = ("course-4",)


@pytest.fixture(scope="module")
def assignments(tmp_path_factory):
    """(name, sRGB or not) -> the scene as an assignment, made once."""
    folder, made = tmp_path_factory.mktemp("scenes"), {}

    def get(name, srgb=False):
        if (name, srgb) not in made:
            path = folder / f"{name}.xml"
            path.write_text(mistaken.xml(SCENES[name], WIDTH, HEIGHT))
            made[name, srgb] = grading.Assignment(path, options=grading.Options(linear=not srgb))
        return made[name, srgb]

    return get


@pytest.fixture
def check(assignments, tmp_path):
    """The grade of a picture (an array of 8 bits) of a scene."""

    def grade(name, pixels, srgb=False):
        Image.fromarray(np.ascontiguousarray(pixels)).save(tmp_path / "student.png")
        return assignments(name, srgb).check(tmp_path / "student.png").grade

    return grade


def student(name, *switches, srgb=False):
    """The picture of the oracle with these mistakes."""
    image = mistaken.render(SCENES[name], switches, WIDTH, HEIGHT)
    return mistaken.store(image, switches, srgb)


def wanted(switch, name, srgb=False):
    if switch == "lobe":
        return "blinnphong" if SCENES[name].lobe == "phong" else "phong"
    if switch == "curve":
        return "srgb-forgotten" if srgb else "srgb-applied"
    return MISTAKES[switch][0]


def cases():
    for switch, (_, names) in MISTAKES.items():
        for name in names:
            slow = [pytest.mark.slow] if name not in QUICK else []
            yield pytest.param(switch, name, id=f"{switch}-{name}", marks=slow)


@pytest.mark.parametrize(("switch", "name"), list(cases()))
def test_a_mistake_is_named(check, switch, name):
    """First, with nearly full confidence unless another looks the same, and with what to do."""
    grade = check(name, student(name, switch))
    assert grade.status == "wrong" and grade.score < 1
    assert grade.mistake.name == wanted(switch, name), [(m.name, m.explained) for m in grade.candidates]
    assert grade.mistake.explained > 0.6 and grade.mistake.advice.endswith(".")


def test_every_mistake_has_three_scenes():
    """As many as it must be found on."""
    assert all(len(names) >= 3 for _, names in MISTAKES.values())


@pytest.mark.slow
@pytest.mark.parametrize("switch", ("curve", "falloff", "lobe", "mirror-added", "flipped"))
@pytest.mark.parametrize("name", ("a", "b", "c-phong"))
def test_with_the_srgb_curve(check, switch, name):
    """Pictures that are to be sRGB, too; there the curve can be missing."""
    grade = check(name, student(name, switch, srgb=True), srgb=True)
    assert grade.mistake.name == wanted(switch, name, srgb=True)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name not in QUICK)) for name in SCENES]
)
def test_a_right_picture_passes(check, name):
    """Of every scene, and nothing is found wrong with it."""
    grade = check(name, student(name))
    assert (grade.status, grade.score, grade.mistake, grade.candidates) == ("right", 1.0, None, ())


@pytest.mark.parametrize("name", (pytest.param("a", marks=pytest.mark.slow), "course-4"))
def test_another_picture_is_none_of_these(check, name):
    """Noise, a gradient, the picture of another scene, nothing at all."""
    rng = np.random.default_rng(0)
    shape = (HEIGHT, WIDTH, 3)
    ramp = np.broadcast_to(np.linspace(0, 255, WIDTH)[None, :, None], shape).astype(np.uint8)
    others = {"noise": rng.integers(0, 256, shape, np.uint8), "ramp": ramp, "black": np.zeros(shape, np.uint8)}
    others |= {other: student(other) for other in ("course-3", "course-6")}
    for what, pixels in others.items():
        grade = check(name, pixels)
        assert grade.status == "wrong" and grade.mistake is None, (what, grade.mistake)


@pytest.mark.parametrize(("name", "srgb"), (("course-3", False), ("course-4", False), ("course-4", True)))
def test_a_gamma_of_2_2(check, name, srgb):
    """What many use for the sRGB curve; on a scene that is mostly black, no odd pair stands in its way."""
    image = np.clip(mistaken.render(SCENES[name], (), WIDTH, HEIGHT), 0, 1)
    grade = check(name, np.rint(255 * image ** (1 / 2.2)).astype(np.uint8), srgb)
    assert grade.mistake.name == ("gamma" if srgb else "srgb-applied") and grade.mistake.explained > 0.95
    assert srgb or "a gamma of 2.2" in grade.mistake.title


def test_floating_point_is_not_clamped(assignments, tmp_path):
    """Highlights beyond 1 that a student cuts off in an array or an EXR."""
    np.save(tmp_path / "a.npy", np.clip(mistaken.render(SCENES["course-4"], (), WIDTH, HEIGHT), 0, 1))
    grade = assignments("course-4").check(tmp_path / "a.npy").grade
    assert (grade.status, grade.mistake.name) == ("wrong", "clamped")


def test_bounces_are_counted_as_the_scene_asks(check):
    """A student who was to follow 8 is not told another number, however few of them matter."""
    image = mistaken.render(replace(SCENES["course-6"], bounces=1), (), WIDTH, HEIGHT)
    assert "(1 instead of 8)" in check("course-6", mistaken.store(image)).mistake.title


PAIRS = [
    ("falloff", "flipped", "a"), ("lobe", "mirror-added", "a"), ("acne", "falloff", "a"),
    ("half-pixel", "falloff", "c"), ("fewer", "light-missing", "c"),
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("one", "other", "name"), PAIRS)
def test_two_mistakes_are_the_best_pair(check, one, other, name):
    """Both are named where neither alone explains the picture."""
    grade = check(name, student(name, one, other))
    assert set(grade.mistake.name.split("+")) == {wanted(one, name), wanted(other, name)}
    assert grade.mistake.explained > 0.95


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "names", "one", "other", "told"),
    (
        ("a", ("ks",), (0,), (1,), "k_s of ball-0 and of ball-1"),
        ("b", ("ks", "p"), (1,), (3,), "k_s and exponent of ball-1 and of ball-3"),
        ("course-4", ("p",), (0, 1, 2, 3), (4,), "exponent of ball-0, ball-1, ball-2, ball-3 and of ball-4"),
    ),
)
def test_what_is_swapped_is_told(check, name, names, one, other, told):
    """k_s, the exponent or both, of two surfaces, or of all that are alike."""
    image = mistaken.render(mistaken.swap(SCENES[name], names, one, other), (), WIDTH, HEIGHT)
    grade = check(name, mistaken.store(image))
    assert grade.mistake.name == "materials-swapped" and told in grade.mistake.title


@pytest.mark.slow
def test_the_picture_of_a_mistake(assignments, check, tmp_path):
    """What is shown beside the student's is the whole picture with the mistake: the same but for rounding."""
    pixels = student("a", "mirror-added", "flipped")
    Image.fromarray(np.ascontiguousarray(pixels)).save(tmp_path / "student.png")
    checked = assignments("a").check(tmp_path / "student.png")
    shown = assignments("a").picture_of(checked, checked.explanations[0])
    # Rounding to 8 bits, and float32 at a few edges.
    assert np.mean(np.abs(shown - pixels / 255).max(axis=-1) > 1 / 255) < 1e-3


def test_mistakes_that_look_alike_are_all_told(check):
    """They share the confidence: a highlight may be missing, or a ball that nobody sees may have it."""
    without = replace(HIDDEN, spheres=[replace(ball, ks=oracle.BLACK) for ball in HIDDEN.spheres])
    grade = check("hidden", mistaken.store(mistaken.render(without, (), WIDTH, HEIGHT)))
    assert grade.mistake.explained > 0.95 and any(
        "k_s of ball-0 and of ball-1" in title for title in grade.mistake.same
    )
    assert grade.mistake.confidence == pytest.approx(grade.mistake.explained / (1 + len(grade.mistake.same)))


@pytest.mark.parametrize("path", ("course/scene-4.xml", "course/scene-5.xml", "course/mirror-box.xml",
                                  "course/textured.xml", "lecture/mirror-floor.xml", "lecture/models.xml"))  # fmt: skip
def test_the_right_recipe_is_whitted(path):
    """The renderer of the mistakes without one is the integrator, to rounding: they cannot drift apart."""

    scene = ROOT / "scenes" / path
    loaded = rendering.load(scene, {"width": "90", "height": "60"})
    image = rendering.render(loaded).image
    traced = stage.Stage(loaded.scene)
    y, x = np.mgrid[0:60, 0:90] + 0.5
    hits = traced.trace(loaded.sensor(1), np.stack([x.ravel(), y.ravel()], axis=-1))
    shaded = shading.shade(hits, shading.RIGHT, traced.most_hits, traced.materials).reshape(image.shape)
    # Two in 5400 pixels may be decided the other way at an edge.
    off = np.abs(shaded - image).max(axis=-1) > 2e-4
    assert off.sum() <= 2


def test_what_cannot_be_diagnosed_is_said(tmp_path):
    """Other BSDFs, integrators and filters: the picture is compared, and the grade says what was not done."""
    text = mistaken.xml(SCENES["course-3"], 24, 18)
    bsdf = re.search(r'<bsdf type="blinnphong">.*?</bsdf>', text)[0]
    integrator = re.search(r"<integrator.*?</integrator>", text)[0]
    changed = {
        "is a RoughPlastic": text.replace(bsdf, '<bsdf type="roughplastic"/>', 1),
        "course convention": text.replace(integrator, '<integrator type="direct"/>'),
        "box filter": text.replace('type="box"', 'type="tent"'),
    }
    Image.fromarray(np.full((18, 24, 3), 200, np.uint8)).save(tmp_path / "a.png")
    for said, scene in changed.items():
        (tmp_path / "a.xml").write_text(scene)
        grade = grading.Assignment(tmp_path / "a.xml").check(tmp_path / "a.png").grade
        assert grade.status == "wrong" and said in grade.notes[0], (said, grade.notes)


def test_recipes_of_pairs_do_not_contradict():
    """Two lengths of v, two flips, two curves cannot be at once; two different things can."""
    change = diagnosis.Change
    assert not change({"view": "distance"}).goes_with(change({"view": "ray"}))
    assert not change(flip="a").goes_with(change(flip="b")) and not change(curve="a").goes_with(change(curve="b"))
    assert change(flip="a").goes_with(change({"view": "ray"})) and change(flip="a").goes_with(change(curve="b"))


@pytest.mark.parametrize("name", shading.CHOICES)
def test_misspelt_choices_are_refused(name):
    """A mistake that is none would shade the right picture."""
    with pytest.raises(ValueError, match=f"'{name}' must be one of"):
        shading.Recipe(**{name: "distanc"})
