"""Every test starts in llvm_ad_rgb, and leaves no scene behind: live BSDFs slow every later kernel."""

import gc

import phong_bsdf  # noqa: F401  (before mitsuba: it chooses the LLVM)

import mitsuba as mi  # isort: skip
import browsing
import pytest

# For what test modules build when they are imported.
mi.set_variant("llvm_ad_rgb")

CPU_VARIANTS = [name for name in mi.variants() if name.startswith(("scalar", "llvm"))]


def pytest_collection_finish(session):
    """What has been imported by now stays: without it, looking for dead scenes after each test is ten times faster."""
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True)
def _fresh(request):
    # A change of variants reloads plugins: none between tests of one.
    if "any_variant" not in request.fixturenames:
        mi.set_variant("llvm_ad_rgb")
    mi.set_log_level(mi.LogLevel.Error)
    yield
    gc.collect()


@pytest.fixture(scope="module")
def browser():
    """A Chromium of the system."""
    with browsing.launched() as browser:
        yield browser


@pytest.fixture(params=CPU_VARIANTS)
def any_variant(request):
    """Each CPU variant of the wheel in turn."""
    mi.set_variant(request.param)
    mi.set_log_level(mi.LogLevel.Error)
    return request.param
