"""Independent work in parallel threads: the compiled core releases the interpreter lock."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Final, TypeVar

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
    """
    failed = threading.Event()

    def guarded(item: Item) -> Result:
        # The calling thread may see a failure late on a busy machine: what comes after it is not begun.
        if failed.is_set():
            raise CancelledError
        try:
            return work(item)
        except BaseException:
            failed.set()
            raise

    pool = ThreadPoolExecutor(min(os.cpu_count() or 1, _most))
    try:
        results = []
        for item, future in [(item, pool.submit(guarded, item)) for item in items]:
            announce(item)
            results.append(future.result())
        return results
    finally:
        pool.shutdown(cancel_futures=True)
