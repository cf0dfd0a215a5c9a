"""Opens the valves of a station one by one, holds them open, closes them all; and closes them at once if one sticks.

    python3 docs/examples/sequencer.py --ros-args -p "namespaces:=[tank_1, tank_2, tank_3]" -p timeout:=1.0

Parameters: namespaces, voltage (V), patience (s for the valves to be there), timeout (s to open or close), hold (s,
open and between cycles), cycles.
Exit code 0: every valve opened and closed. 1: one did not, was not there, or a signal came; one line says which.

Nothing is commanded before every valve is there, and whatever happens, the last command to every valve is 0 V. Commands
are repeated ten times a second, so that the valves' own command_timeout closes them even if this process is killed.
"""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable, Sequence
from types import FrameType
from typing import Any, NamedTuple

import rclpy
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Bool, Float64

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
REPEAT_SECONDS = 0.1


class SequenceError(Exception):
    """The sequence cannot go on; the message says which valve does not do what."""


class StopSignals:
    """Ctrl-C and SIGTERM only leave a note: an exception could come up anywhere, also within ROS, which may lose it."""

    def __init__(self) -> None:
        self.has_come = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._note)

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.has_come = True


class Settings(NamedTuple):
    """The node's parameters and their defaults; seconds of the wall's clock, since a stuck valve is real."""

    namespaces: list[str] = ["tank_1", "tank_2", "tank_3"]  # noqa: RUF012 -- a ROS parameter is a list
    voltage: float = 9.0
    patience: float = 300.0
    timeout: float = 2.0
    hold: float = 0.2
    cycles: int = 1


class RemoteValve:
    """One valve_node, by its topics: ~/coil_voltage and the latched ~/is_open."""

    def __init__(self, node: Node, name: str) -> None:
        self.name = name
        self.volts = 0.0
        self.is_open: bool | None = None
        self._voltage = node.create_publisher(Float64, f"{name}/coil_voltage", 10)
        node.create_subscription(Bool, f"{name}/is_open", self._hear, LATCHED)

    def _hear(self, message: Any) -> None:
        self.is_open = message.data

    @property
    def is_there(self) -> bool:
        """Whether it hears commands and has said whether it is open."""
        return self.is_open is not None and self._voltage.get_subscription_count() > 0

    def command(self, volts: float) -> None:
        """Put a voltage on the coil."""
        self.volts = volts
        self.repeat()

    def repeat(self) -> None:
        """Say it again, for a command_timeout."""
        self._voltage.publish(Float64(data=self.volts))

    def wait_until_heard(self) -> None:
        """Until the last command has got there: a process that ends at once takes its unsent messages along."""
        self._voltage.wait_for_all_acked(Duration(seconds=1))


class Sequencer:
    """Opens one after the other; each step waits for the valve to say that it is done."""

    def __init__(self, node: Node, signals: StopSignals) -> None:
        self._node = node
        self._signals = signals
        values = [node.declare_parameter(name, default).value for name, default in Settings()._asdict().items()]
        self._settings = Settings(*values)
        self._valves = [RemoteValve(node, f"/{name.strip('/')}/valve") for name in self._settings.namespaces]

    def run(self) -> None:
        """All cycles.

        Raises:
            SequenceError: a valve is not there, does not open, does not stay open or does not close, or a signal came.
        """
        self._wait_for(self._valves, lambda valve: valve.is_there, self._settings.patience, "not there")
        self._node.create_timer(REPEAT_SECONDS, self._repeat)
        for cycle in range(self._settings.cycles):
            for valve in self._valves:
                valve.command(self._settings.voltage)
                self._wait_for([valve], lambda valve: valve.is_open is True, self._settings.timeout, "not open")
                self._node.get_logger().info(f"cycle {cycle + 1}: {valve.name} is open")
            self._hold_open()
            for valve in self._valves:
                valve.command(0.0)
            self._wait_for(self._valves, lambda valve: valve.is_open is False, self._settings.timeout, "not closed")
            self._spin_until(lambda: False, self._settings.hold)

    def close_all(self) -> None:
        """The safe state: no voltage on any coil. Nothing is waited for before all have been told."""
        for valve in self._valves:
            valve.command(0.0)
        for valve in self._valves:
            valve.wait_until_heard()

    def _hold_open(self) -> None:
        if self._spin_until(lambda: not all(valve.is_open for valve in self._valves), self._settings.hold):
            closed = ", ".join(valve.name for valve in self._valves if not valve.is_open)
            raise SequenceError(f"closed by itself: {closed}")

    def _repeat(self) -> None:
        for valve in self._valves:
            valve.repeat()

    def _wait_for(
        self, valves: Sequence[RemoteValve], is_done: Callable[[RemoteValve], bool], seconds: float, words: str
    ) -> None:
        if not self._spin_until(lambda: all(is_done(valve) for valve in valves), seconds):
            late = ", ".join(valve.name for valve in valves if not is_done(valve))
            raise SequenceError(f"after {seconds:g} s {words}: {late}")

    def _spin_until(self, condition: Callable[[], bool], seconds: float) -> bool:
        end = time.monotonic() + seconds
        while not condition():
            remaining = end - time.monotonic()
            if remaining <= 0.0:
                return False
            rclpy.spin_once(self._node, timeout_sec=min(remaining, REPEAT_SECONDS))
            if self._signals.has_come:
                raise SequenceError("interrupted")
        return True


def main() -> int:
    """Run the sequence; 0 if it went well, 1 if not."""
    signals = StopSignals()
    # ROS must outlive Ctrl-C here: a context that is shut down sends no 0 V.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    sequencer = Sequencer(Node("sequencer"), signals)
    try:
        sequencer.run()
    except SequenceError as failure:
        print(f"sequencer: {failure}; all valves are commanded closed", file=sys.stderr)
        return 1
    finally:
        sequencer.close_all()
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C comes a second time, from ros2 launch
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
