"""Work in batches on Dask: as many at a time as keep every worker busy, so that a scheduler never holds a whole fleet.

A worker that is killed takes its batch with it; Dask gives that to another one. What kills every worker is found by
halving its batch, and left out, with a word why, when it is one item alone.
"""

from __future__ import annotations

import logging
import math
import signal
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any, Final, Generic, NamedTuple, TypeVar

from valve_sim.fleet.secrets import one_line
from valve_sim.model.errors import ValveError

IN_FLIGHT: Final = 3
"""Batches for each thread of the cluster that are on their way at a time: one at work, the next ones at hand."""
BATCH_SECONDS: Final = 2.0
"""s that a batch is to take: long beside what Dask needs for it, short beside what a crash may cost."""
MOST_IN_BATCH: Final = 256
FIRST_BATCH: Final = 1
"""Items of a batch while nobody knows how long one takes."""
FORGETTING: Final = 0.2
"""Weight of the newest batch in the mean time of an item."""
CONNECTS_WITHIN: Final = 30.0
"""s within which a scheduler must answer."""
ENDS_WITHIN: Final = 20.0
"""s that a cluster is given to end; then its processes are killed."""

Item = TypeVar("Item")
Answer = TypeVar("Answer")


class ClusterError(ValveError):
    """The cluster cannot be reached, or was lost; what was written stays."""


class Done(NamedTuple, Generic[Item, Answer]):
    """A batch that is done: what was asked, and the answers; or, of one item, why there is none."""

    items: Sequence[Item]
    answers: list[Answer]
    failure: str = ""


class BatchSize:
    """How many items make a batch of some seconds, learnt from those that are done."""

    def __init__(self) -> None:
        self._seconds = math.nan

    def learn(self, seconds: float, count: int) -> None:
        """Take note of a batch: the processor's seconds, and its items."""
        each = max(seconds, 0.0) / max(1, count)
        known = math.isfinite(self._seconds)
        self._seconds = (1.0 - FORGETTING) * self._seconds + FORGETTING * each if known else each

    def next(self, left: int, threads: int) -> int:
        """Items of the next batch, of those that are left: fewer towards the end, so that all end together."""
        if not math.isfinite(self._seconds):
            return FIRST_BATCH
        wanted = BATCH_SECONDS / max(self._seconds, BATCH_SECONDS / MOST_IN_BATCH)
        return max(1, min(int(wanted), math.ceil(left / (2 * threads))))


class Cluster:
    """Where work is done: a Dask cluster that is reached, or started, when there is work, and left at the end.

    Args:
        scheduler: such as tcp://10.0.0.1:8786; None: a cluster of its own, of processes on this machine.
        workers: processes of that, with one compute thread each; default one for each processor.
        before: done once before a cluster of its own is started.
    """

    def __init__(
        self, scheduler: str | None = None, workers: int | None = None, before: Callable[[], None] = lambda: None
    ) -> None:
        self._scheduler, self._workers, self._before = scheduler, workers, before
        self._stack = ExitStack()
        self._client: Any = None

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def client(self) -> Any:
        """The Dask client, made at the first call.

        Raises:
            ClusterError: nothing answers at the scheduler's address.
        """
        if self._client is None:
            import dask
            import distributed  # noqa: F401 (before the settings, which would take its defaults with them in the end)

            self._stack.enter_context(dask.config.set(_SETTINGS))
            self._stack.enter_context(_no_logs_of_dask())
            self._client = self._started() if self._scheduler is None else self._reached(self._scheduler)
        return self._client

    def _reached(self, scheduler: str) -> Any:
        from distributed import Client

        try:
            client = Client(scheduler, timeout=CONNECTS_WITHIN, set_as_default=False)
        except (OSError, ValueError) as error:
            raise ClusterError(
                f"{scheduler}: no Dask scheduler answers ({one_line(error)}); start one with `dask scheduler`, or "
                "leave --scheduler out"
            ) from error
        self._stack.callback(client.close, timeout=ENDS_WITHIN)
        return client

    def _started(self) -> Any:
        from distributed import Client, LocalCluster

        self._before()
        # Workers end when this process tells them to; Ctrl-C in the terminal is for this process alone.
        with _interrupts_ignored():
            cluster = LocalCluster(
                n_workers=self._workers, threads_per_worker=1, processes=True, dashboard_address=None,
                silence_logs="CRITICAL", preload=["valve_sim.fleet.worker"],
                # What Dask serves by HTTP, without a dashboard too: for this machine, and not where another run does.
                scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
            )  # fmt: skip
        self._stack.callback(cluster.close, timeout=ENDS_WITHIN)
        client = Client(cluster, set_as_default=False)
        self._stack.callback(client.close, timeout=ENDS_WITHIN)
        return client


_SETTINGS: Final = {
    "distributed.worker.use-file-locking": False,
    "distributed.comm.timeouts.connect": CONNECTS_WITHIN,
    "distributed.scheduler.allowed-failures": 2,
    # A unit may compute for a minute without letting the event loop of its worker speak.
    "distributed.scheduler.worker-ttl": "30 minutes",
    "distributed.admin.tick.limit": "1 h",
    # Dask's profile of a worker grows by 10 MB a minute, for an hour.
    "distributed.worker.profile.enabled": False,
}


@contextmanager
def _interrupts_ignored() -> Iterator[None]:
    before = signal.getsignal(signal.SIGINT)
    try:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    except ValueError:  # not in the main thread, where no Ctrl-C arrives
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def _no_logs_of_dask() -> Iterator[None]:
    """A scheduler that is lost is one line, of ours, and no traceback of the client that tries to reach it again."""
    names = [name for name in logging.root.manager.loggerDict if name.partition(".")[0] == "distributed"]
    before = {name: logging.getLogger(name).level for name in names}
    for name in names:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for name, level in before.items():
            logging.getLogger(name).setLevel(level)


def run_batches(
    connect: Callable[[], Any],
    work: Callable[[Sequence[Item]], list[Answer]],
    items: Sequence[Item],
    seconds_of: Callable[[Answer], float],
) -> Iterator[Done[Item, Answer]]:
    """Do the work, batch by batch, in the order in which batches get ready.

    Args:
        connect: gives a client of Dask, or None: then the work is done here, one batch after the other. It is called
            if there is work.
        work: answers for a batch, one for each item; raises nothing but what the process does to it.
        seconds_of: an answer's time.

    Raises:
        ClusterError: the scheduler was lost.
    """
    waiting, size = deque(items), BatchSize()
    client = connect() if waiting else None
    if client is None:
        while waiting:
            batch = [waiting.popleft() for _ in range(size.next(len(waiting), 1))]
            answers = work(batch)
            size.learn(sum(map(seconds_of, answers)), len(batch))
            yield Done(batch, answers)
        return
    yield from _on_cluster(client, work, waiting, size, seconds_of)


def _on_cluster(
    client: Any,
    work: Callable[[Sequence[Item]], list[Answer]],
    waiting: deque[Item],
    size: BatchSize,
    seconds_of: Callable[[Answer], float],
) -> Iterator[Done[Item, Answer]]:
    from distributed import as_completed

    asked: dict[str, list[Item]] = {}
    halves: deque[list[Item]] = deque()
    ready = as_completed(loop=client.loop)

    def ask() -> None:
        try:
            threads = max(1, sum(client.nthreads().values()))
        except OSError as error:  # asked while nobody has noticed yet that the scheduler is gone
            raise _lost(error) from error
        while (waiting or halves) and len(asked) < IN_FLIGHT * threads:
            batch = halves.popleft() if halves else _taken(waiting, size.next(len(waiting), threads))
            future = client.submit(work, batch, pure=False)
            asked[future.key] = batch
            ready.add(future)

    ask()
    for future in ready:
        batch = asked.pop(future.key)
        try:
            answers = future.result()
        except Exception as error:
            if _is_lost(client, error):
                raise _lost(error) from error
            if len(batch) > 1:
                half = len(batch) // 2
                halves += [batch[:half], batch[half:]]
            else:
                yield Done(batch, [], f"the process that worked on it ended: {_ended(error)}")
        else:
            size.learn(sum(map(seconds_of, answers)), len(batch))
            yield Done(batch, answers)
        future.release()
        ask()


def _taken(waiting: deque[Item], count: int) -> list[Item]:
    return [waiting.popleft() for _ in range(min(count, len(waiting)))]


def _lost(error: Exception) -> ClusterError:
    return ClusterError(f"the scheduler was lost ({one_line(error)}); run the same command again")


def _is_lost(client: Any, error: Exception) -> bool:
    from concurrent.futures import CancelledError

    from distributed.client import FutureCancelledError

    return client.status != "running" or isinstance(error, CancelledError | FutureCancelledError)


def _ended(error: Exception) -> str:
    name = type(error).__name__
    return "killed each time, out of memory perhaps" if name == "KilledWorker" else f"{name}: {one_line(error)}"
