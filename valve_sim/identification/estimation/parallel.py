"""Independent work in parallel threads: the compiled core releases the interpreter lock."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Hashable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from typing import Final, Generic, TypeVar

MOST_THREADS: Final = 4
"""Between two simulations a fit holds the interpreter lock, so that more threads would wait for each other."""

_most = MOST_THREADS


@contextmanager
def threads_limited_to(most: int) -> Iterator[None]:
    """No more threads than this meanwhile, in this process: 1 where other processes use the other processors."""
    global _most  # noqa: PLW0603
    before, _most = _most, max(1, min(most, MOST_THREADS))
    try:
        yield
    finally:
        _most = before


Item = TypeVar("Item")
Result = TypeVar("Result")
Key = TypeVar("Key", bound=Hashable)


class Memo(Generic[Key, Result]):
    """Results that are computed once for each key, whichever of several threads asks first; the others wait.

    A plain dictionary would let two threads compute the same result, so that counted work would depend on their number.

    Raises:
        Exception: when called, what the work raises, each time that this key is asked for.
    """

    def __init__(self, work: Callable[[Key], Result]) -> None:
        self._work = work
        self._lock = threading.Lock()
        self._futures: dict[Key, Future[Result]] = {}

    def __call__(self, key: Key) -> Result:
        """The result of a key."""
        with self._lock:
            future = self._futures.get(key)
            is_first = future is None
            if future is None:
                future = self._futures[key] = Future()
        if is_first:
            try:
                future.set_result(self._work(key))
            except BaseException as error:
                future.set_exception(error)
        return future.result()


def run_parallel(
    work: Callable[[Item], Result],
    items: Sequence[Item],
    announce: Callable[[Item], None] = lambda item: None,
) -> list[Result]:
    """The result of `work` for each item, in order, computed in parallel threads.

    Args:
        work: is called from several threads at once.
        items: independent of each other's results, so that the order of execution does not matter.
        announce: told, in the calling thread, which item is waited for; what it raises ends all.

    Raises:
        Exception: what the work raises; what has not been begun by then is left undone.
        KeyboardInterrupt: at once, whatever the work does: it may never return.
    """
    ended, lock = threading.Event(), threading.Lock()
    futures: list[Future[Result]] = [Future() for _ in items]
    left = zip(items, futures, strict=True)

    def take_turns() -> None:
        # The calling thread may see a failure late on a busy machine: what comes after it is not begun.
        while not ended.is_set():
            with lock:
                turn = next(left, None)
            if turn is None:
                return
            item, future = turn
            try:
                future.set_result(work(item))
            except BaseException as error:
                ended.set()
                future.set_exception(error)

    count = min(os.cpu_count() or 1, _most, len(items))
    # As daemons they do not keep the process from ending at Ctrl-C.
    threads = [threading.Thread(target=take_turns, daemon=True) for _ in range(count)]
    for thread in threads:
        thread.start()
    try:
        results = []
        for item, future in zip(items, futures, strict=True):
            announce(item)
            results.append(future.result())
    except KeyboardInterrupt:
        ended.set()
        raise
    except BaseException:
        ended.set()
        _join(threads)
        raise
    _join(threads)
    return results


def _join(threads: Sequence[threading.Thread]) -> None:
    for thread in threads:
        thread.join()
