"""An event loop in a thread of its own, for what asyncio serves beside ROS."""

from __future__ import annotations

import asyncio
import concurrent.futures
import threading
from collections.abc import Coroutine
from typing import Any, Final, Protocol

from valve_sim.nodes.threads import Fail

_FAREWELL: Final = 1.5
"""s that what is served may take to say goodbye to its clients."""


class Served(Protocol):
    """A server, or a client that polls, in the event loop that started it."""

    async def start(self) -> None:
        """Begin."""

    async def stop(self) -> None:
        """End."""


class LoopThread:
    """Serves something in a thread of its own; `fail` is told, there, what went wrong after the start."""

    def __init__(self, name: str, served: Served, fail: Fail = lambda error: None) -> None:
        self._served, self._fail = served, fail
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name=name, daemon=True)

    def start(self) -> None:
        """Start it, and wait until it has begun.

        Raises:
            ValveError: it cannot begin.
        """
        self._thread.start()
        self._run(self._served.start()).result()

    def do(self, work: Coroutine[Any, Any, None]) -> None:
        """Have something done in the thread, soon."""

        async def watched() -> None:
            try:
                await work
            except Exception as error:
                self._fail(error)

        self._run(watched())

    def _run(self, work: Coroutine[Any, Any, None]) -> concurrent.futures.Future[None]:
        return asyncio.run_coroutine_threadsafe(work, self._loop)

    def stop(self, timeout: float) -> bool:
        """End it; whether it has ended within a time in s, or soon after its clients were told."""
        if not self._thread.is_alive():
            return True
        try:
            self._run(self._served.stop()).result(max(timeout, _FAREWELL))
        except concurrent.futures.TimeoutError:
            return False
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(timeout)
        return not self._thread.is_alive()
