"""The model of a cluster: its ends, its bends, and that the passes that are chosen keep what is promised."""

import itertools

import pytest

from phong_bsdf.cluster import scaling
from phong_bsdf.cluster.scaling import Costs, Job, predicted

FREE = Costs(order=0, byte=0, worker=0, worker_byte=0, start=0, bundle_byte=0)
COSTS = Costs(order=0.01, byte=1e-8, worker=0.02, worker_byte=2e-8, start=5, bundle_byte=1e-9)


def test_without_costs_workers_add_up():
    """As many times as fast as there are workers, as long as each has passes."""
    job = Job(passes=1000, seconds=1.0, pass_bytes=10**6)
    for workers in (1, 10, 1000):
        found = predicted(job, workers, FREE)
        assert found.speedup == pytest.approx(workers) and found.efficiency == pytest.approx(1)
        assert found.bottleneck == "workers"


def test_too_few_passes():
    """The last round has as many passes as are left: 1000 passes on 999 workers take two rounds."""
    found = predicted(Job(1000, 1.0, 0), 999, FREE)
    assert found.seconds == 2.0 and predicted(Job(10, 1.0, 0), 1000, FREE).bottleneck == "too few passes"


def test_scheduler_is_the_limit():
    """However many workers: passes of a second that take a hundredth of it elsewhere are done a hundred a second."""
    costs = Costs(order=0.01, byte=0, worker=0, worker_byte=0, start=0, bundle_byte=0)
    job = Job(10_000, 1.0, 0)
    assert predicted(job, 50, costs).bottleneck == "workers"
    for workers in (200, 1000, 10_000):
        found = predicted(job, workers, costs)
        assert found.speedup == pytest.approx(100) and found.bottleneck == "scheduler and client"


def test_start_counts_for_short_jobs():
    """A picture of a second is not worth a cluster."""
    found = predicted(Job(10, 0.1, 1000), 10, COSTS)
    assert found.bottleneck == "start" and found.speedup < 1


def test_scene_is_passed_on():
    """Who has the scene passes it on: a thousand workers wait for eleven transfers, not for a thousand."""
    costs = Costs(order=0, byte=0, worker=0, worker_byte=0, start=0, bundle_byte=1e-9)
    seconds = [predicted(Job(1, 0.0, 0, 10**9), workers, costs).seconds for workers in (1, 1024)]
    assert seconds == pytest.approx([1, 11])


@pytest.mark.parametrize("workers", [1, 2, 16, 128, 1000])
@pytest.mark.parametrize("size_bytes", [10**5, 10**7])
def test_chosen_passes_keep_what_is_promised(workers, size_bytes):
    """The worker's overhead is 2.5 % at most (twice that after rounding), scheduler and client are half busy."""
    serial = COSTS.order + COSTS.byte * size_bytes
    # The shortest picture that so many workers can share so.
    seconds = scaling.pass_seconds(serial * (workers / scaling.USED) ** 2, workers, size_bytes, COSTS)
    assert (COSTS.worker + COSTS.worker_byte * size_bytes) / seconds <= scaling.OVERHEAD * (1 + 1e-9)
    assert workers * serial / seconds <= scaling.USED * (1 + 1e-9)
    # Of a long picture all but that overhead, the start and the last round is rendering.
    job = Job(max(int(3.6e6 * workers / seconds), 1), seconds, size_bytes)
    assert predicted(job, workers, COSTS).efficiency > 0.9


def test_more_workers_do_not_harm():
    """An hour's picture, in the passes that are chosen for each number of workers."""
    speedups = []
    for workers in (1, 10, 100, 300, 1000, 3000, 10_000):
        seconds = scaling.pass_seconds(3600, workers, 600_000, COSTS)
        speedups.append(predicted(Job(round(3600 / seconds), seconds, 600_000), workers, COSTS).speedup)
    assert speedups[:3] == pytest.approx([1, 10, 100], rel=0.2)
    assert all(more > 0.9 * fewer for fewer, more in itertools.pairwise(speedups))


def test_pass_of_a_slow_scene():
    """Where a sample takes long, a pass has few: each worker gets four passes."""
    assert scaling.pass_spp(1024, 1.0, 16, 10**6, most=10**6, costs=COSTS) == 16
    assert scaling.pass_spp(4, 1.0, 1000, 10**6, most=10**6, costs=COSTS) == 1


def test_pass_of_a_fast_scene():
    """A power of two, at most all samples, at most `most`."""
    assert scaling.pass_spp(4096, 1e-3, 2, 10**6, most=10**6, costs=COSTS) == 2048
    assert scaling.pass_spp(100, 1e-6, 2, 10**6, most=10**6, costs=COSTS) == 64
    assert scaling.pass_spp(1024, 1e-6, 2, 10**6, most=16, costs=COSTS) == 16
    assert scaling.pass_spp(1, 1.0, 2, 10**6, most=16, costs=COSTS) == 1


def test_bytes_of_a_pass():
    """As many as an EXR file of noise has, which hardly compresses."""
    assert scaling.pass_bytes(100 * 100) == 120_000
