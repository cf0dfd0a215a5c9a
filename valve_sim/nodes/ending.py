"""How a program ends: SIGINT and SIGTERM end it at once while its node is not there, and ask the node to end later."""

from __future__ import annotations

import os
import signal
from types import FrameType

from valve_sim.nodes.threads import StopRequest

_NUMBERS = (signal.SIGINT, signal.SIGTERM)


class Signals:
    """SIGINT and SIGTERM from now on; to be made in the main thread.

    Attributes:
        stop: what they ask for; None while nothing has begun: they end the process then, with this exit code.
    """

    def __init__(self, code: int) -> None:
        self.stop: StopRequest | None = None
        self._code = code
        for number in _NUMBERS:
            signal.signal(number, self._take)

    def _take(self, number: int, frame: FrameType | None) -> None:
        if self.stop is None:
            os._exit(self._code)
        self.stop.ask(f"a signal came ({signal.Signals(number).name})")

    @staticmethod
    def pass_over() -> None:
        """Pass over both from now on: Ctrl-C reaches a node of `ros2 launch` twice, and a supervisor may ask again.

        While Python ends, the second one would end the process with code −2 or −15: it takes other handlers out before.
        """
        for number in _NUMBERS:
            signal.signal(number, signal.SIG_IGN)
