"""Which BSDF of Mitsuba looks like a lobe: the same roughness, the same energy, and a note where it cannot."""

import math

import mitsuba as mi
import numpy as np
import pytest
from scipy.integrate import quad

from phong_bsdf import comparison
from phong_bsdf.reflection import curves, matching
from phong_bsdf.scene import surfaces


def blinn(lobe, p, **more):
    """A lobe with scales that differ in every number."""
    return matching.Lobe(lobe, (0.6, 0.3, 0.1), (0.2, 0.3, 0.4), p, **more)


# The exponent -----------------------------------------------------------------------------------------------


def distance(p, q):
    """Squared distance of the two lobes over the hemisphere, by adaptive quadrature."""
    end = min(math.pi / 2, 9 / math.sqrt(p))
    return quad(lambda t: (math.cos(t) ** p - math.cos(t / 2) ** q) ** 2 * math.sin(t), 0, end, epsabs=0, limit=200)[0]


@pytest.mark.parametrize("p", (0.1, 1, 10, 100, 1e4))
def test_fitted_exponent_is_the_closest(p):
    """Every other exponent, near or far, gives a lobe that is further from Phong's."""
    q = matching.blinn_exponent(p)
    best = distance(p, q)
    assert all(distance(p, q * factor) > best for factor in (0.25, 0.5, 0.9, 0.999, 1.001, 1.1, 2, 4))


@pytest.mark.parametrize(("p", "ratio"), ((1, 5.443215), (10, 4.153354), (100, 4.015033), (1e4, 4.00015), (1e8, 4)))
def test_fitted_exponent_is_about_four_times_phongs(p, ratio):
    """4 p for narrow lobes; more for wide ones, whose shapes differ."""
    assert matching.blinn_exponent(p) / p == pytest.approx(ratio, rel=1e-5)


def test_exponent_of_a_constant_lobe():
    """p = 0 is the constant lobe of both models."""
    assert matching.blinn_exponent(0) == 0


def test_roughness():
    """alpha = sqrt(2 / (p' + 2)), and a Blinn-Phong exponent needs no fit."""
    assert blinn("blinnphong", 98).alpha == pytest.approx(math.sqrt(0.02))
    assert blinn("phong", 98).alpha == pytest.approx(math.sqrt(2 / (matching.blinn_exponent(98) + 2)))


# Matching ---------------------------------------------------------------------------------------------------


LOBES = {
    "phong": blinn("phong", 60),
    "blinnphong": blinn("blinnphong", 300),
    "wide": blinn("blinnphong", 60),
    "reflectances": matching.Lobe("blinnphong", (0.6, 0.3, 0.1), (0.02, 0.03, 0.03), 100, reflectances=True),
}


def built(match):
    """The BSDF of a match without its diffuse part."""
    black = {"diffuse_reflectance": 0.0, "base_color": 0.0}
    values = {k: black.get(k, surfaces.color(v) if isinstance(v, tuple) else v) for k, v in match.parameters.items()}
    return mi.load_dict({"type": match.plugin, **values})


@pytest.mark.parametrize("lobe", LOBES)
@pytest.mark.parametrize("plugin", ("roughplastic", "roughconductor", "principled"))
def test_highlight_has_the_lobes_energy(plugin, lobe):
    """The specular albedo at normal incidence is the lobe's own, whatever the target and the vocabulary."""
    lobe = LOBES[lobe]
    match = matching.match(plugin, lobe, comparison._specular_albedo)
    wanted = lobe.unit_albedo * np.mean(lobe.specular)
    assert curves.albedo(built(match), 0) == pytest.approx(wanted, rel=1e-5)
    roughness = match.parameters.get("alpha") or match.parameters["roughness"] ** 2
    assert roughness == pytest.approx(lobe.alpha)


@pytest.mark.parametrize("plugin", ("roughplastic", "roughconductor"))
def test_highlight_keeps_its_colour(plugin):
    """Where the target has a specular colour."""
    colour = matching.match(plugin, LOBES["phong"], comparison._specular_albedo).parameters["specular_reflectance"]
    assert np.array(colour) / max(colour) == pytest.approx([0.5, 0.75, 1])


def test_strong_highlights_raise_the_index_of_refraction():
    """And a note says so; beyond ior 3 the highlight is weaker, and a note says that."""
    strong, impossible = (
        matching.match(
            "roughplastic", matching.Lobe("blinnphong", (0.5,) * 3, (ks,) * 3, 30), comparison._specular_albedo
        )
        for ks in (0.6, 3)
    )
    assert 1.6 < strong.parameters["int_ior"] < 2.5 and "int_ior raised" in strong.notes[0]
    assert impossible.parameters["int_ior"] == matching.LARGEST_IOR
    assert impossible.parameters["specular_reflectance"] == (1, 1, 1)
    assert "weaker than the lobe's: albedo 0.2" in impossible.notes[1]


def test_notes_say_what_is_lost():
    """Each target names what it cannot show; what is 0 cannot be lost."""

    def notes(plugin, diffuse=(0.5,) * 3, specular=(0.2,) * 3):
        return " ".join(matching.match(plugin, matching.Lobe("phong", diffuse, specular, 60), lambda _: 0.04).notes)

    assert "no diffuse part" in notes("roughconductor") and notes("roughconductor", diffuse=(0, 0, 0)) == ""
    assert "no highlight" in notes("diffuse")
    assert "highlight is white" in notes("principled", specular=(0.1, 0.2, 0.2))
    assert "highlight is white" not in notes("principled") and "GGX" in notes("principled")
    assert "2 clamped to 1" in notes("roughplastic", diffuse=(2, 0.5, 0.5)) and notes("roughplastic") == ""


@pytest.mark.parametrize("plugin", matching.TARGETS)
def test_a_surface_without_highlight_becomes_diffuse(plugin):
    """Exactly the same surface: a physical coat would only darken it."""
    match = matching.match(plugin, matching.Lobe("phong", (0.5,) * 3, (0,) * 3, 60), comparison._specular_albedo)
    assert (match.plugin, match.parameters) == ("diffuse", {"reflectance": matching.Carried("diffuse")})


def test_given_parameters_stay_and_the_rest_is_matched():
    """The highlight's energy is that of the lobe with the index of refraction that the user gave."""
    lobe = LOBES["blinnphong"]
    match = matching.match("roughplastic", lobe, comparison._specular_albedo, {"int_ior": 2.0, "alpha": 0.2})
    assert (match.parameters["int_ior"], match.parameters["alpha"]) == (2.0, 0.2)
    assert curves.albedo(built(match), 0) == pytest.approx(lobe.unit_albedo * 0.3, rel=2e-3)
