"""How long a picture in passes takes on so many workers, from what a pass costs beside rendering it.

A run starts (processes, scene, kernels), then workers render passes side by side, while scheduler and client, of which
there is one each, handle every pass one after the other: the slower of the two sets the pace.
"""

import math
from dataclasses import dataclass

# A pass may cost its worker so much more than its rendering: 5 % where rounding down to a power of two halves it.
OVERHEAD = 0.025
# So much of what scheduler and client can do is planned for: what else they do, and passes that end together.
USED = 0.5
# So many passes for each worker: the last ones end at different times, and a lost one is little lost.
PASSES_PER_WORKER = 4


@dataclass(frozen=True)
class Costs:
    """What comes to the rendering, in seconds; by default about what `make bench ONLY=cluster` finds on two cores."""

    order: float = 7.5e-3
    """Of scheduler and client for each pass."""
    byte: float = 1.4e-8
    """Of the client for each byte of a pass: received, written, read, added up."""
    worker: float = 7.5e-3
    """Of the worker for each pass, beside rendering."""
    worker_byte: float = 1.4e-8
    """Of the worker for each byte of a pass: encoded."""
    start: float = 1.2
    """Until workers render: connection, import, kernels."""
    bundle_byte: float = 1.1e-8
    """Of a worker that gets the scene from another, and writes it."""


@dataclass(frozen=True)
class Job:
    """A picture in passes."""

    passes: int
    seconds: float
    """Of a pass, rendered in one process."""
    pass_bytes: int
    bundle_bytes: int = 0


@dataclass(frozen=True)
class Prediction:
    """How long a job takes on so many workers."""

    workers: int
    seconds: float
    speedup: float
    """Over one process without a cluster."""
    bottleneck: str
    """`workers`, `scheduler and client`, `too few passes` or `start`: what more workers cannot help, but the first."""

    @property
    def efficiency(self) -> float:
        """The part of the workers' time that renders."""
        return self.speedup / self.workers


def pass_bytes(pixels: int, channels: int = 3) -> int:
    """Bytes of the file of a pass: noise does not compress."""
    return 4 * pixels * channels


def predicted(job: Job, workers: int, costs: Costs | None = None) -> Prediction:
    """The time of a job on `workers` processes that are each as fast as the one that was measured."""
    costs = costs or Costs()
    # Who has the scene passes it on, so that those who have it double each time.
    start = costs.start + costs.bundle_byte * job.bundle_bytes * (1 + math.log2(workers))
    busy = _worker_seconds(job.seconds, job.pass_bytes, costs)
    rounds = math.ceil(job.passes / workers)
    parts = {
        "start": start,
        "workers": busy * job.passes / workers,
        "scheduler and client": job.passes * _serial_seconds(job.pass_bytes, costs),
        "too few passes": busy * (rounds - job.passes / workers),
    }
    seconds = start + max(busy * rounds, parts["scheduler and client"])
    return Prediction(workers, seconds, job.passes * job.seconds / seconds, max(parts, key=parts.__getitem__))


def pass_seconds(total: float, workers: int, size_bytes: int, costs: Costs | None = None) -> float:
    """How long a pass should take, of a picture of `total` seconds in one process.

    As short as gives each worker some passes, but so long that neither its own overhead counts, nor `workers` of
    them together are more than scheduler and client can handle.
    """
    costs = costs or Costs()
    own = (costs.worker + costs.worker_byte * size_bytes) / OVERHEAD
    serial = _serial_seconds(size_bytes, costs)
    # More workers than there are such passes would not help: then one pass each, as long as all of them take elsewhere.
    shared = min(workers * serial / USED, math.sqrt(total * serial))
    least = max(own, shared, total / (PASSES_PER_WORKER * workers))
    # Whole rounds, so that no worker is without work in the last one.
    rounds = math.floor(total / (least * workers) + 1e-9)
    return total / (rounds * workers) if rounds else least


def pass_spp(
    spp: int, sample_seconds: float, workers: int, size_bytes: int, most: int, costs: Costs | None = None
) -> int:
    """Samples per pixel of a pass, a power of two, at most `most`, where one takes `sample_seconds` in one process."""
    wanted = pass_seconds(spp * sample_seconds, workers, size_bytes, costs) / sample_seconds
    return 2 ** max(math.floor(math.log2(max(min(wanted, spp, most), 1))), 0)


def _worker_seconds(seconds: float, size_bytes: int, costs: Costs) -> float:
    return seconds + costs.worker + costs.worker_byte * size_bytes


def _serial_seconds(size_bytes: int, costs: Costs) -> float:
    return costs.order + costs.byte * size_bytes
