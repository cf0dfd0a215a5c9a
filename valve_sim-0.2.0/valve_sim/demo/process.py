"""valve_node as a process of its own."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from valve_sim.model import ValveError

STOP_LIMIT: Final = 20.0
"""s within which the node must end after it was asked to; a killed one would stay on its topics for as long."""


class DemoError(ValveError):
    """The demonstration cannot go on: one line that says why and what to do."""


class ValveProcess:
    """valve_node, running.

    Args:
        command: what to run. log: takes what it prints.
    """

    def __init__(self, command: Sequence[str], log: Path) -> None:
        self._log = log
        with log.open("wb") as output:
            self._process = subprocess.Popen(
                list(command),
                stdout=output,
                stderr=subprocess.STDOUT,
                # Ctrl-C is handled by this process, which stops the node once the bag is closed.
                start_new_session=True,
            )

    def check(self) -> None:
        """Check that the node is running.

        Raises:
            DemoError: it has ended.
        """
        code = self._process.poll()
        if code is not None:
            raise DemoError(f"valve_node ended with code {code}: {self.last_words()} (all it said: {self._log})")

    def last_words(self) -> str:
        """The last line that it printed."""
        lines = self._log.read_text(errors="replace").splitlines()
        return next((line.strip() for line in reversed(lines) if line.strip()), "it said nothing")

    def stop(self) -> None:
        """Ask it to end, and see that it does."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            try:
                self._process.wait(STOP_LIMIT)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
