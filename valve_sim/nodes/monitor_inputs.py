"""What monitor_node hears: messages in; stamps and numbers out."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any, Final

from rclpy.node import Node

from valve_sim.nodes import topics
from valve_sim.nodes.heard import UnusableMessageError
from valve_sim.nodes.live_monitor import LiveMonitor
from valve_sim.nodes.messages import pilot_position, stamp_of
from valve_sim.nodes.node_clock import NodeClock
from valve_sim.nodes.realtime import Arrival
from valve_sim.nodes.receiving import Inbox, Source
from valve_sim.nodes.wiring import Interface

_OF_COIL: Final = ("coil", "coil_current")
"""Last part of a measured topic that is no position."""


class MonitorInputs:
    """The topics that monitor_node hears. Pressures and commands are taken before the samples that came with them.

    Args:
        node: which subscribes. clock: of it.
        valve: full name of the node whose commands are heard. measured: topic of positions, or of the coil.

    Attributes:
        inbox: which delivers. measured: the topic of the samples. voltage: that of the commands.
        by_current: whether no position can come, because the coil is all that is subscribed to.
        wanted: where samples are waited for, in words.
    """

    def __init__(self, node: Node, clock: NodeClock, valve: str, measured: str) -> None:
        self._clock = clock
        self.inbox = Inbox(node, clock)
        sensors, _, kind = measured.rpartition("/")
        # As remapped, for the log.
        self.measured, self.voltage, self._coil = map(
            node.resolve_topic_name, (measured, f"{valve}/coil_voltage", f"{sensors}/coil")
        )
        self.by_current = kind in _OF_COIL
        self.wanted = self.measured if self.by_current else f"{self.measured}, or a current on {self._coil}"
        self._interface = Interface(node, topics.MONITOR, valve=valve, sensors=sensors, measured=measured)
        self._is_simulated = sensors == valve

    def hear(self, live: LiveMonitor, *, has_gas: bool) -> None:
        """Hand on what is heard from now on; `has_gas`: whether pressures around the valve are heard, too."""
        self._live = live
        if has_gas:
            self._subscribe_to_pressures()
        self._commands = self._receive("{valve}/coil_voltage", self._on_command)
        if not self.by_current:
            self._receive("{measured}", self._on_position)
        self._unstamped_current = self._receive("{sensors}/coil_current", self._on_unstamped_current)
        self._receive("{sensors}/coil", self._on_coil)

    def incompatible_publishers(self) -> int:
        """How many publishers of commands cannot be heard, because they offer best effort."""
        return self._commands.incompatible_publishers

    def _receive(self, name: str, take: Callable[[Any, Arrival], None], **places: str) -> Source:
        return self._interface.receive(self.inbox, name, take, **places)

    def _subscribe_to_pressures(self) -> None:
        """Subscribe to the pressure behind the valve, and to those at its ends.

        A simulated valve says which pressures it obeys, and from when on; a sensor's stamps are those of its samples.
        What the valve is told counts, from its own stamp on, until one of them is heard.
        """
        self._receive("{sensors}/outlet_pressure", partial(self._on_pressure, self._live.outlet_pressure))
        for end in topics.ENDS:
            take = partial(self._on_pressure, partial(self._live.end_pressure, end))
            told = self._receive("{valve}/{end}", take, end=end)
            known = "{valve}/obeyed/{end}" if self._is_simulated else "{sensors}/{end}"
            self._receive(known, partial(self._on_known_pressure, told, take), end=end)

    def _on_command(self, message: Any, arrival: Arrival) -> None:
        self._live.command(self.voltage, self._clock.stamp_of(arrival), message.data)

    def _on_position(self, message: Any, arrival: Arrival) -> None:
        try:
            position = pilot_position(message)
        except UnusableMessageError as error:
            self._live.input.reject(f"{self.measured}: {error}")
        else:
            stamp = self._stamp(self.measured, message, arrival)
            self._live.position(self.measured, stamp, position, self._received(arrival))

    def _on_unstamped_current(self, message: Any, arrival: Arrival) -> None:
        self._live.coil(self._coil, self._clock.stamp_of(arrival), message.data, math.nan, 0)

    def _on_coil(self, message: Any, arrival: Arrival) -> None:
        """Take the current where it is stamped, in place of the one that is not, which costs as much to receive."""
        if not math.isfinite(message.current):
            return
        self.inbox.unsubscribe(self._unstamped_current)
        stamp = self._stamp(self._coil, message, arrival)
        self._live.coil(self._coil, stamp, message.current, message.voltage, self._received(arrival))

    def _on_pressure(self, take: Callable[[int, float], None], message: Any, arrival: Arrival) -> None:
        """Take a pressure; one without a stamp counts from when it is received."""
        take(stamp_of(message) or self._clock.stamp_of(arrival), message.fluid_pressure)

    def _on_known_pressure(
        self, told: Source, take: Callable[[Any, Arrival], None], message: Any, arrival: Arrival
    ) -> None:
        """Take the pressure that there is at an end of the valve; what the valve is told is heard no more."""
        self.inbox.unsubscribe(told)
        take(message, arrival)

    def _stamp(self, topic: str, message: Any, arrival: Arrival) -> int:
        stamp = stamp_of(message)
        self._live.stamps.note(topic, stamp, self._clock.stamp_of(arrival))
        return stamp

    def _received(self, arrival: Arrival) -> int:
        """When a sample was received, ns of ROS time; 0 under simulated time, which moves by whole ticks."""
        return 0 if self._clock.is_simulated else arrival.received
