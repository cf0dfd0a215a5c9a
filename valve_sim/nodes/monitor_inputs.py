"""What monitor_node hears: messages of its own topics, or of those that a map names, in; stamps and numbers out."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Final, NamedTuple

from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64

from valve_sim.nodes import topics
from valve_sim.nodes.live_map import LiveInput
from valve_sim.nodes.messages import EncodedReader, UnusableMessageError, coils, joint_states, pressures
from valve_sim.nodes.node_clock import NodeClock
from valve_sim.nodes.realtime import Arrival
from valve_sim.nodes.receiving import Inbox, Source
from valve_sim.nodes.wiring import Interface, profile

_OF_COIL: Final = ("coil", "coil_current")
"""Last part of a measured topic that is no position."""


class Takers(NamedTuple):
    """What is done with what is heard; called in the thread that empties the inbox.

    Attributes:
        command: stamp, ns, and volts. position: stamp, m, and the time of reception, ns, 0 where not known.
        coil: stamp, A, V or nan, and the time of reception. pressure: stamp and Pa, behind a valve with gas.
        end_pressure: name, stamp and Pa, of its tank or of what its demand's orifice leads to.
        reject: why a message cannot be used.
    """

    command: Callable[[int, float], None]
    position: Callable[[int, float, int], None]
    coil: Callable[[int, float, float, int], None]
    pressure: Callable[[int, float], None]
    end_pressure: Callable[[str, int, float], None]
    reject: Callable[[str], None]


class MonitorInputs:
    """The topics that monitor_node hears. Pressures and commands are taken before the samples that came with them.

    Args:
        node: which subscribes. clock: of it.
        valve: full name of the node whose commands are heard. measured: topic of positions, or of the coil.
        entries: of a map, by quantity; none where this package's own topics are heard.
        take: what is done with what is heard. has_gas: whether there is a pressure behind the valve to be heard.

    Attributes:
        inbox: which delivers. measured: the topic of the samples. voltage: that of the commands.
        by_current: whether no position can come, because the coil is all that is subscribed to.
        wanted: where samples are waited for, in words.
    """

    def __init__(
        self,
        node: Node,
        clock: NodeClock,
        valve: str,
        measured: str,
        entries: Mapping[str, LiveInput],
        take: Takers,
        *,
        has_gas: bool,
    ) -> None:
        self._clock, self._take = clock, take
        self.inbox = Inbox(node, clock)
        self._node = node
        self._unstamped_current: Source | None = None
        if entries:
            self._subscribe_by_map(entries)
        else:
            self._subscribe_to_own_topics(valve, measured, has_gas=has_gas)

    def incompatible_publishers(self) -> int:
        """How many publishers of commands cannot be heard, because they offer best effort."""
        return self._commands.incompatible_publishers

    def _subscribe_to_own_topics(self, valve: str, measured: str, *, has_gas: bool) -> None:
        sensors, _, kind = measured.rpartition("/")
        self.measured, self.voltage = measured, f"{valve}/coil_voltage"
        self.by_current = kind in _OF_COIL
        self.wanted = measured if self.by_current else f"{measured}, or a current on {sensors}/coil"
        inbox = self.inbox
        interface = Interface(self._node, topics.MONITOR, valve=valve, sensors=sensors, measured=measured)
        if has_gas:
            self._subscribe_to_pressures(interface, is_simulated=sensors == valve)
        self._commands = interface.receive(inbox, "{valve}/coil_voltage", self._on_command)
        if not self.by_current:
            interface.receive(inbox, "{measured}", partial(self._on_position, measured, joint_states()), raw=True)
        self._unstamped_current = interface.receive(inbox, "{sensors}/coil_current", self._on_unstamped_current)
        interface.receive(inbox, "{sensors}/coil", partial(self._on_coil, f"{sensors}/coil", coils()), raw=True)

    def _subscribe_to_pressures(self, interface: Interface, *, is_simulated: bool) -> None:
        """Subscribe to the pressure behind the valve, and to those at its ends.

        A simulated valve says which pressures it obeys, and from when on; a sensor's stamps are those of its samples.
        What the valve is told counts, from its own stamp on, until one of them is heard.
        """

        def receive(name: str, take: Callable[[int, float], None], **places: str) -> Source:
            on_pressure = partial(self._on_pressure, pressures(), take)
            return interface.receive(self.inbox, name, on_pressure, raw=True, **places)

        receive("{sensors}/outlet_pressure", self._take.pressure)
        for end in topics.ENDS:
            take_end = partial(self._take.end_pressure, end)
            told = receive("{valve}/{end}", take_end, end=end)
            known = "{valve}/obeyed/{end}" if is_simulated else "{sensors}/{end}"
            receive(known, _Superseding(self.inbox, told, take_end), end=end)

    def _subscribe_by_map(self, entries: Mapping[str, LiveInput]) -> None:
        """Subscribe to the topics that the map names."""
        self.by_current = "position" not in entries
        self.measured = self.wanted = entries["current" if self.by_current else "position"].source.topic
        self.voltage = entries["command"].source.topic
        self._commands = self._subscribe_to_entry(entries["command"], self._take_mapped_command, profile(topics.DEEP))
        if "position" in entries:
            self._subscribe_to_entry(entries["position"], self._take.position, profile(topics.SENSOR))
        if "current" in entries:
            self._subscribe_to_entry(entries["current"], self._take_mapped_current, profile(topics.SENSOR))

    def _subscribe_to_entry(self, entry: LiveInput, take: Callable[[int, float, int], None], qos: QoSProfile) -> Source:
        def on_message(message: Any, arrival: Arrival) -> None:
            stamp = entry.stamp(message) or self._clock.stamp_of(arrival)
            take(stamp, entry.value(message), self._received(arrival))

        return self.inbox.subscribe(entry.message_class, entry.source.topic, on_message, qos)

    def _take_mapped_command(self, stamp: int, volts: float, received: int) -> None:
        self._take.command(stamp, volts)

    def _take_mapped_current(self, stamp: int, current: float, received: int) -> None:
        self._take.coil(stamp, current, math.nan, 0)

    def _on_command(self, message: Float64, arrival: Arrival) -> None:
        self._take.command(self._clock.stamp_of(arrival), message.data)

    def _on_position(self, topic: str, reader: EncodedReader, encoded: bytes, arrival: Arrival) -> None:
        found = self._read(reader, topic, encoded)
        if found is not None:
            stamp, position = found
            self._take.position(stamp, position, self._received(arrival))

    def _on_unstamped_current(self, message: Float64, arrival: Arrival) -> None:
        self._take.coil(self._clock.stamp_of(arrival), message.data, math.nan, 0)

    def _on_coil(self, topic: str, reader: EncodedReader, encoded: bytes, arrival: Arrival) -> None:
        """Take the current where it is stamped, in place of the one that is not, which costs as much to receive."""
        found = self._read(reader, topic, encoded)
        if found is None or not math.isfinite(found[2]):
            return
        if self._unstamped_current is not None:
            self.inbox.unsubscribe(self._unstamped_current)
            self._unstamped_current = None
        stamp, voltage, current = found
        self._take.coil(stamp, current, voltage, self._received(arrival))

    def _on_pressure(
        self, reader: EncodedReader, take: Callable[[int, float], None], encoded: bytes, arrival: Arrival
    ) -> None:
        """Take a pressure; one without a stamp counts from when it is received."""
        found = self._read(reader, "a pressure", encoded)
        if found is not None:
            stamp, pressure = found
            take(stamp or self._clock.stamp_of(arrival), pressure)

    def _read(self, reader: EncodedReader, topic: str, encoded: bytes) -> tuple[Any, ...] | None:
        """The stamp and the numbers of a message; None, and rejected, where it does not hold them."""
        try:
            return reader.read(encoded)
        except UnusableMessageError as error:
            self._take.reject(f"{topic}: {error}")
            return None

    def _received(self, arrival: Arrival) -> int:
        """When a sample was received, ns of ROS time; 0 under simulated time, which moves by whole ticks."""
        return 0 if self._clock.is_simulated else arrival.received


class _Superseding:
    """Takes the pressure that there is at an end of the valve, and has no more heard of what the valve is told.

    Args:
        inbox: receives both. told: what the valve is told. take: called with stamp, ns, and Pa.
    """

    def __init__(self, inbox: Inbox, told: Source, take: Callable[[int, float], None]) -> None:
        self._inbox, self._take = inbox, take
        self._told: Source | None = told

    def __call__(self, stamp: int, pressure: float) -> None:
        """Take a pressure."""
        if self._told is not None:
            self._inbox.unsubscribe(self._told)
            self._told = None
        self._take(stamp, pressure)
