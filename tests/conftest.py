"""Every test starts in llvm_ad_rgb, and leaves no scene behind: live BSDFs slow every later kernel."""

import gc
import signal

import phong_bsdf  # noqa: F401  (before mitsuba: it chooses the LLVM)

import mitsuba as mi  # isort: skip
import pytest

from helpers import browsing, dask_processes, syntax
from helpers import messages as logged
from helpers.variants import CPU_VARIANTS

# A shell ignores Ctrl-C for what it runs in the background, and so would all processes that tests interrupt.
signal.signal(signal.SIGINT, signal.default_int_handler)

syntax.remember()

# For what test modules build when they are imported.
mi.set_variant("llvm_ad_rgb")

# Seconds that a test of processes may take on a machine that is busy with other things.
LONGEST = 300


def pytest_collection_finish(session):
    """What has been imported by now stays: without it, looking for dead scenes is ten times faster.

    They are looked for by this thread alone: those of Dask would free them while a kernel is made from them.
    """
    gc.collect()
    gc.freeze()
    gc.disable()


@pytest.fixture(autouse=True, scope="module")
def _no_scene_is_left():
    yield
    gc.collect()


@pytest.fixture(autouse=True)
def _fresh(request):
    # What the test before has made, now that pytest lets go of it. Looking through everything would take half the time.
    gc.collect(1)
    # A change of variants reloads plugins: none between tests of one.
    if "any_variant" not in request.fixturenames:
        mi.set_variant("llvm_ad_rgb")
    mi.set_log_level(mi.LogLevel.Error)


@pytest.fixture(scope="module")
def browser():
    """A Chromium of the system."""
    with browsing.launched() as browser:
        yield browser


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    """A Dask scheduler and two workers, of which tests kill one or the other: they come back."""
    with dask_processes.processes(tmp_path_factory.mktemp("two"), 2) as group:
        yield group


@pytest.fixture
def limited():
    """A test that waits for other processes fails after some minutes, whatever it waits for."""

    def fail(*_):
        pytest.fail(f"not done after {LONGEST} s")

    before = signal.signal(signal.SIGALRM, fail)
    signal.alarm(LONGEST)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture(params=CPU_VARIANTS)
def any_variant(request):
    """Each CPU variant of the wheel in turn."""
    mi.set_variant(request.param)
    mi.set_log_level(mi.LogLevel.Error)
    return request.param


@pytest.fixture
def messages():
    """Mitsuba's warnings, instead of on the terminal."""
    with logged.messages() as texts:
        yield texts
