"""POV-Ray and Tachyon, which know nothing of Mitsuba, render the picture that the package renders.

The float64 oracle renders it too, so that a disagreement says who is wrong. Pixels on an
edge are judged apart: there the last bit of a coordinate chooses between two colours.
"""

import dataclasses
import shutil
from unittest import mock

import numpy as np
import pytest

from helpers import oracle, peers
from helpers.peers import HALF_STEP, TACHYON_HORIZON, lecture_scene

import phong_bsdf  # noqa: F401  # isort: skip  (before mitsuba: it chooses the LLVM)
import mitsuba as mi  # isort: skip

WIDTH, HEIGHT = 128, 96

# The peers' 16-bit files, and the single precision of their colours.
PEER_ERROR = HALF_STEP + 1e-6

# What float32 loses on the way. Measured: 6.8e-6, where the floor mirrors the highlight of p = 150,
# and 8.6e-6 on an edge.
PACKAGE_ERROR = 1.1e-5

# The sum of both: what an outside check of a float32 renderer can see.
BAR = 2e-5


def povray(scene, folder):
    return peers.povray(scene, folder, WIDTH, HEIGHT).picture


def tachyon(scene, folder):
    """Tachyon's picture, and the light that it leaves out at the horizon of each surface."""
    return peers.tachyon(scene, folder, WIDTH, HEIGHT).picture + horizon_light(scene)


def oracle_with(shade, scene, width=WIDTH, height=HEIGHT):
    """The oracle's picture with another local shading than the lecture's."""
    with mock.patch.object(oracle, "unit_point", shade):
        return oracle.render(scene, width, height)


def horizon_light(scene):
    """The part of the picture that light with n.l <= TACHYON_HORIZON makes; the rest of it is black."""
    unit_point = oracle.unit_point

    def shade(material, n, l, v, lobe):  # noqa: E741
        low = oracle.dot(n, l)[:, None] <= TACHYON_HORIZON
        return np.where(low, unit_point(material, n, l, v, lobe), 0)

    return oracle_with(shade, dataclasses.replace(scene, background=oracle.BLACK))


def near_edges(scene):
    """Pixels with a silhouette or a shadow's edge within 1/9 of a pixel of their centre.

    Where all shading is one flat colour for each surface and light, the oracle's picture is
    constant between the edges, those seen in mirrors included. The horizon of a light, n.l = 0,
    is an edge too: there the highlight ends.
    """

    def flat(material, n, l, v, lobe):  # noqa: E741
        return np.broadcast_to(material.kd, n.shape)

    fine = oracle_with(flat, scene, 9 * WIDTH, 9 * HEIGHT).reshape(HEIGHT, 9, WIDTH, 9, 3)
    # Edges that many reflections have dimmed below 1e-6 change nothing that is tested here.
    return (np.ptp(fine[:, 3:6, :, 3:6], axis=(1, 3)) > 1e-6).any(axis=-1)


@pytest.fixture(scope="module", params=["phong", "blinnphong"])
def scene(request):
    return lecture_scene(request.param)


@pytest.fixture(scope="module")
def truth(scene):
    return oracle.render(scene, WIDTH, HEIGHT)


@pytest.fixture(scope="module")
def package(scene):
    mi.set_variant("llvm_ad_rgb")
    return np.array(mi.render(mi.load_string(peers.mitsuba_scene(scene, WIDTH, HEIGHT))), dtype=float)


@pytest.fixture(scope="module", params=[povray, tachyon], ids=lambda program: program.__name__)
def peer(request, scene, tmp_path_factory):
    name = request.param.__name__
    if shutil.which(name) is None:
        pytest.skip(f"{name} is not installed")
    return request.param(scene, tmp_path_factory.mktemp(name))


@pytest.fixture(scope="module")
def edges():
    # The edges of both lobes are the same.
    return near_edges(lecture_scene("phong"))


def assert_same(a, b, edges, bar):
    """`a` is `b` up to `bar` in every pixel away from edges, and in nearly all the others."""
    difference = np.abs(a - b).max(axis=-1)
    worst = np.where(edges, 0, difference).max()
    assert worst <= bar, f"differs by up to {worst:.2e} away from edges"
    # Measured: all. A pixel whose centre lies on an edge may have either colour: 6 of 12288 are let through.
    assert np.mean(difference <= bar) >= 1 - 5e-4


# The tests --------------------------------------------------------------------------------------


def test_scene_suits_the_comparison(scene, truth, edges):
    """The picture fits into the peers' files, and few pixels are edges or lack light in Tachyon's."""
    assert truth.max() < 1
    # Measured: 4.4 % and 8 pixels.
    assert edges.mean() < 0.05
    assert np.mean(horizon_light(scene).max(axis=-1) > 0) < 1e-3


def test_package_is_the_formula(package, truth, edges):
    """The package's picture is the oracle's."""
    assert_same(package, truth, edges, PACKAGE_ERROR)


def test_peer_is_the_formula(peer, truth, edges):
    """The peer's picture is the oracle's, rounded to 16 bits."""
    assert_same(peer, truth, edges, PEER_ERROR)


def test_package_is_the_peer(package, peer, edges):
    """The package's picture is the peer's."""
    assert_same(package, peer, edges, BAR)
