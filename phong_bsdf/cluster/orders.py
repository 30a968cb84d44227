"""Hands orders to a cluster and gives back what becomes of them, whatever happens to workers and scheduler.

Nothing here is bound to a worker: a few orders for each are under way, and who is free takes the next one. So
late workers join in, and the loss of one costs what it was doing.
"""

import asyncio
import contextlib
import queue
import statistics
import time
import uuid
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from . import work
from .connection import TIMEOUTS, Cluster, ClusterError, mismatch
from .work import Order, Result

# Orders that are under way for each worker: the one that it does and the one that it can begin at once.
AHEAD = 2

# A worker hangs if it takes so many times as long as others, and at least so many seconds.
PATIENCE, LEAST_SECONDS = 10.0, 30.0
# Before anything is known.
FIRST_SECONDS = 1800.0

# After so many workers that died or hung on one order, it is the order's fault.
MOST_LOSSES = 5

# A result that is there must come in so many seconds.
RESULT_SECONDS = 300.0

# A local cluster is not without workers for longer.
LOCAL_SECONDS = 60.0

# Seconds between two looks at clocks and workers.
GLANCE = 0.25
COUNT = 2.0


@dataclass
class _Attempt:
    """One handing out of an order."""

    order: Order
    number: int
    future: Any
    started: float | None = None
    worker: str = ""


class Orders:
    """A run of orders."""

    def __init__(
        self, cluster: Cluster, orders: Sequence[Order], *, variant: str, seconds: float | None = None,
        on_wait: Callable[[str], None] = lambda what: None,
    ):  # fmt: skip
        """`seconds`: the longest that an order may take; by default told from those that are done."""
        self.cluster = cluster
        # Others may use the same scheduler.
        self.token = uuid.uuid4().hex
        self.around = work.Surroundings(f"phong_bsdf-{self.token}", variant, work.environment(), {})
        self.waiting, self.running, self.losses = deque(), {}, {}
        for order in orders:
            self.add(order)
        self.seconds, self.on_wait = seconds, on_wait
        self.pace: deque[float] = deque(maxlen=1000)
        self.number, self.sent, self.counted, self.without = 0, {}, 0.0, None
        self.finished, self.begun = queue.SimpleQueue(), queue.SimpleQueue()

    def add(self, order: Order) -> None:
        """One more; also while results come, as long as there are any."""
        if any(
            other.name == order.name for other in (*self.waiting, *(attempt.order for attempt in self.running.values()))
        ):
            raise ValueError(f"two orders have the name '{order.name}'")
        self.losses[order.name] = 0
        self.waiting.append(order)

    def results(self) -> Iterator[Result]:
        """One result for each order, as they finish. ClusterError where the cluster cannot go on."""
        self._listen()
        try:
            while self.waiting or self.running:
                if self.cluster.ensure(self.on_wait):
                    self._begin_again()
                try:
                    self._hand_out()
                except OSError:
                    if self.cluster.client.status == "running":
                        raise
                yield from self._collect()
                self._look_at_clocks()
        finally:
            self._give_up()

    def _listen(self) -> None:
        # A handler must be quick and is called in another thread.
        self.cluster.client.subscribe_topic(
            self.around.topic, lambda event: self.begun.put((event[1], time.monotonic()))
        )

    def _begin_again(self) -> None:
        """After a new connection: nothing that was under way is known there."""
        self.waiting.extendleft(attempt.order for attempt in reversed(self.running.values()))
        self.running, self.sent, self.counted = {}, {}, 0.0
        self._listen()

    def _hand_out(self) -> None:
        if time.monotonic() - self.counted > COUNT:
            self.around = replace(self.around, workers=self.cluster.workers())
            self.counted = time.monotonic()
        workers = sum(self.around.workers.values())
        if not workers:
            self._wait_for_workers()
            return
        self.without = None
        while self.waiting and len(self.running) < AHEAD * workers:
            order = self.waiting.popleft()
            self.number += 1
            number = self.number
            future = self.cluster.client.submit(
                work.carry_out, replace(order, scene=replace(order.scene, files={})), self.around, self._files(order),
                number, pure=False, key=f"{order.name}-{number}-{self.token}",
            )  # fmt: skip
            self.running[number] = _Attempt(order, number, future)
            future.add_done_callback(lambda _, number=number: self.finished.put(number))

    def _wait_for_workers(self) -> None:
        self.on_wait("waiting for workers")
        self.without = self.without or time.monotonic()
        if self.cluster.local is not None and time.monotonic() - self.without > LOCAL_SECONDS:
            raise ClusterError("the processes of the local cluster have all ended, and none began again")

    def _files(self, order: Order):
        """The files of its scene as the result of a task: who needs them gets them from whom has them, and Dask, which
        still knows the task, makes them again where they were lost with their last holder. (What is scattered would be
        gone.)"""
        names = tuple(order.scene.files)
        known = self.sent.get(names)
        if known is None or known.status in ("cancelled", "lost", "error"):
            with warnings.catch_warnings():
                # Dask would rather have them scattered.
                warnings.filterwarnings("ignore", "Sending large graph", UserWarning)
                key = f"files-{self.number}-{self.token}"
                known = self.sent[names] = self.cluster.client.submit(dict, order.scene.files, pure=False, key=key)
        return known

    def _collect(self) -> Iterator[Result]:
        """What has finished by now; waits a moment where nothing has."""
        with contextlib.suppress(queue.Empty):
            number = self.finished.get(timeout=GLANCE)
            while True:
                attempt = self.running.pop(number, None)
                if attempt and (result := self._result(attempt)):
                    yield result
                number = self.finished.get_nowait()

    def _result(self, attempt: _Attempt) -> Result | None:
        """None where the attempt failed by the cluster's fault; the order then waits again."""
        try:
            result = attempt.future.result(timeout=RESULT_SECONDS)
        except TIMEOUTS:
            self._lost(attempt, "its result did not come")
            self._end_worker(attempt.worker)
            return None
        except (Exception, asyncio.CancelledError) as error:
            self._lost(attempt, error)
            return None
        finally:
            attempt.future.release()
        if result.different:
            raise mismatch(f"worker {result.worker}", result.different)
        if result.elsewhere:
            self._lost(attempt, f"{result.error} ({result.worker})")
            return None
        self.pace.append(result.seconds / attempt.order.work)
        return result

    def _lost(self, attempt: _Attempt, error: BaseException | str) -> None:
        """Let the order wait again, in front; ClusterError where that is of no use."""
        name = attempt.order.name
        if type(error).__name__ in ("KilledWorker", "str"):
            self.losses[name] += 1
        elif self.cluster.client.status == "running" and isinstance(error, ImportError | AttributeError | TypeError):
            raise ClusterError(f"the cluster cannot read what it is sent: {error}. Install the same versions there")
        if self.losses[name] >= MOST_LOSSES:
            # Dask's own text is long, and about itself.
            reason = error if isinstance(error, str) else "the process died"
            raise ClusterError(f"{name}: workers failed, died or hung over it again and again, the last time: {reason}")
        # Perhaps by another scheduler than before, which has to be asked again.
        self._listen()
        self.waiting.appendleft(attempt.order)

    def _look_at_clocks(self) -> None:
        with contextlib.suppress(queue.Empty):
            while True:
                event, now = self.begun.get_nowait()
                if attempt := self.running.get(event["attempt"]):
                    attempt.started, attempt.worker = now, event["worker"]
        pace = self._pace()
        for attempt in list(self.running.values()):
            # Twice as long each time that the order was lost, for it may be the slow one.
            limit = pace(attempt.order) * 2 ** self.losses[attempt.order.name]
            if attempt.started and time.monotonic() - attempt.started > limit:
                del self.running[attempt.number]
                self._lost(attempt, f"nothing for {limit:.0f} s (--task-timeout)")
                self._end_worker(attempt.worker)

    def _pace(self) -> Callable[[Order], float]:
        """How many seconds an order may take."""
        if self.seconds or not self.pace:
            return lambda order: self.seconds or FIRST_SECONDS
        usual = PATIENCE * statistics.median(self.pace)
        return lambda order: max(LEAST_SECONDS, usual * order.work)

    def _end_worker(self, worker: str) -> None:
        """A task that hangs cannot be cancelled: its process is replaced, or forgotten where nobody minds it."""
        client = self.cluster.client
        said = {}
        with contextlib.suppress(Exception):
            said = client.restart_workers([worker], timeout=LEAST_SECONDS, raise_for_error=False)
        if said.get(worker) != "OK":
            with contextlib.suppress(Exception):
                client.run_on_scheduler(_forget, worker=worker)

    def _give_up(self) -> None:
        """Leave nothing on the cluster."""
        with contextlib.suppress(Exception):
            self.cluster.client.unsubscribe_topic(self.around.topic)
            self.cluster.client.cancel([attempt.future for attempt in self.running.values()], force=True)
        self.running, self.sent = {}, {}


async def _forget(worker: str, dask_scheduler) -> None:
    await dask_scheduler.remove_worker(worker, stimulus_id="phong_bsdf-hanging")
