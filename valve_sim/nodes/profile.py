"""The node `command_profile`: a profile of voltages wired to a valve's topic. The coil is off at every end of it.

The main thread commands.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from std_msgs.msg import Float64

from valve_sim.files.parameter_sections import Section
from valve_sim.files.whole_files import write_whole
from valve_sim.model import ValveError
from valve_sim.nodes import topics
from valve_sim.nodes.messages import blank_battery
from valve_sim.nodes.profile_playing import (
    Commanded,
    ProfileBrokenOffError,
    ProfileSettings,
    as_csv,
    checked_profile,
    play,
)
from valve_sim.nodes.realtime import LISTENERS_SECONDS, NANOSECONDS
from valve_sim.nodes.spinning import every, wait_until_heard
from valve_sim.nodes.wiring import RosNode, full_name

_LOOK_SECONDS: Final = 0.05
_UNKNOWN_NODE: Final = "_NODE_NAME_UNKNOWN_"
"""The name that rmw gives to a node whose subscription it has discovered before the node itself."""
_NAMELESS: Final = "a node without a name so far"
_PROGRESS_SECONDS: Final = 5.0


class ProfileNode(RosNode[ProfileSettings]):
    """The node `command_profile`, with the topics `topics.PROFILE`.

    Parameters: `profile_playing.ProfileSettings`; they are read once, at the start.

    Raises:
        ValveError: a parameter or the profile cannot be used; nothing has been commanded then.
    """

    def __init__(self, sections: Sequence[tuple[str, Section]]) -> None:
        super().__init__("command_profile", sections, ProfileSettings, topics.PROFILE)
        self._drive = checked_profile(self._settings)
        valve, listener = self._settings.valve, self._settings.listener
        self._listener = full_name(self._node, listener or valve, "listener" if listener else "valve")
        self._voltage = self._interface.publisher("{valve}/coil_voltage", valve=full_name(self._node, valve, "valve"))
        # A recorder that discovers the topic late still gets the log from its beginning.
        self._log = self._interface.publisher("~/commanded", depth=len(self._drive.times) + 1)
        self._is_watching = False
        every(self._node, _LOOK_SECONDS, self._look)
        self._commanded: list[Commanded] = []
        self.exit_code = 1
        self._next_progress = math.inf

    def _work(self) -> None:
        """Command the profile."""
        logger = self._node.get_logger()
        try:
            self._wait_for_valve()
            rows, end = len(self._drive.times), self._drive.times[-1]
            most = max(abs(self._drive.volts))
            logger.info(
                f"ready: {self._voltage.topic_name} gets {rows} commands in {end:g} s, {most:g} V at most, "
                f"from {self._settings.profile}"
            )
            self._next_progress = self._clock.elapsed() + _PROGRESS_SECONDS
            play(self._drive, self._clock, self._command, lambda: self.stop.why, self._note)
            self.exit_code = 0
        except ProfileBrokenOffError as reason:
            logger.error(f"broken off after {len(self._commanded)} of {len(self._drive.times)} commands: {reason}")

    def _listeners(self) -> list[str]:
        """Full names of the nodes that subscribe to the commands: the valve, and recorders."""
        found = self._node.get_subscriptions_info_by_topic(self._voltage.topic_name)
        return [
            _NAMELESS if entry.node_name == _UNKNOWN_NODE else f"{entry.node_namespace.rstrip('/')}/{entry.node_name}"
            for entry in found
        ]

    def _wait_for_valve(self) -> None:
        """Wait until the valve and all other known subscribers are connected.

        Patience is counted in looks, not by the clock: a process that was held up has found nobody meanwhile.
        """
        for _ in range(1 + math.ceil(self._settings.patience / _LOOK_SECONDS)):
            listeners = self._listeners()
            if self._listener in listeners and self._voltage.get_subscription_count() >= len(listeners):
                break
            self._pause(_LOOK_SECONDS)
        else:
            others = f" ({', '.join(listeners)} does)" if listeners else ""
            raise ProfileBrokenOffError(
                f"{self._listener} does not hear {self._voltage.topic_name} after {self._settings.patience:g} s"
                f"{others}; start it, or name the valve by -p valve:=/its/name and the coil's driver by "
                "-p listener:=/its/name"
            )
        # They must have discovered this node too, which cannot be seen from here.
        self._pause(LISTENERS_SECONDS)
        self._is_watching = True

    def _pause(self, seconds: float) -> None:
        if self.stop.wait(seconds):
            raise ProfileBrokenOffError(self.stop.why)

    def _look(self) -> None:
        """Whether the valve is still there; in the spinning thread, because the query takes a while."""
        if self._is_watching and not self.stop.why and self._listener not in self._listeners():
            self.stop.ask(f"{self._listener} does not hear {self._voltage.topic_name} any more")

    def _command(self, volts: float) -> int:
        stamp = self._clock.stamp()
        self._voltage.publish(Float64(data=volts))
        message = blank_battery()
        message.voltage = volts
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, NANOSECONDS)
        self._log.publish(message)
        return stamp

    def _note(self, commanded: Commanded) -> None:
        self._commanded.append(commanded)
        if self._clock.elapsed() > self._next_progress:
            self._next_progress = self._clock.elapsed() + _PROGRESS_SECONDS
            left = self._drive.times[-1] - self._drive.times[len(self._commanded) - 1]
            self._node.get_logger().info(
                f"{len(self._commanded)} of {len(self._drive.times)} commands, {left:.1f} s left"
            )

    def _finish(self) -> None:
        """Send 0 V, wait until it and its log are received, and write what was commanded."""
        if not self._commanded:
            return
        if self._commanded[-1].volts != 0.0:
            self._commanded.append(Commanded(self._command(0.0), 0.0, 0.0))
        wait_until_heard((self._voltage, self._log))
        self._write()

    def _write(self) -> None:
        path = Path(self._settings.output).expanduser()
        logger = self._node.get_logger()
        try:
            write_whole(path, as_csv(self._commanded))
        except ValveError as error:
            self.exit_code = 1
            logger.error(str(error))
            return
        latest = max(entry.lateness for entry in self._commanded)
        words = "done" if self.exit_code == 0 else "the coil is off"
        logger.info(f"{words}: {len(self._commanded)} commands, the latest {1e3 * latest:.2f} ms late; wrote {path}")
