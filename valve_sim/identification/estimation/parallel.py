"""Independent work on all processors: the compiled core lets others run Python while it computes."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Final, TypeVar

MOST_THREADS: Final = 4
"""Between two runs of the core a fit holds Python to itself, so that more would wait for each other."""

Item = TypeVar("Item")
Result = TypeVar("Result")


def run_parallel(
    work: Callable[[Item], Result],
    items: Sequence[Item],
    announce: Callable[[Item], None] = lambda item: None,
) -> list[Result]:
    """What the work makes of each item.

    Args:
        work: is called from several threads at once.
        items: none may need what is made of another, so that it does not matter which is ready first.
        announce: told, in the calling thread, which item is waited for; what it raises ends all.

    Raises:
        Exception: what the work raises; what has not been begun by then is left undone.
    """
    pool = ThreadPoolExecutor(min(os.cpu_count() or 1, MOST_THREADS))
    try:
        results = []
        for item, future in [(item, pool.submit(work, item)) for item in items]:
            announce(item)
            results.append(future.result())
        return results
    finally:
        pool.shutdown(cancel_futures=True)
