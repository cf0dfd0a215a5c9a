"""What monitor_node hears: messages of its own topics, or of those that a map names, in; stamps and numbers out."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final, NamedTuple

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from sensor_msgs.msg import BatteryState, FluidPressure, JointState
from std_msgs.msg import Float64

from valve_sim.nodes.encoded_messages import EncodedReader, UnusableMessageError, coils, joint_states, pressures
from valve_sim.nodes.live_map import LiveInput
from valve_sim.nodes.node_clock import NodeClock
from valve_sim.nodes.shell_parts import IncompatiblePublishers
from valve_sim.nodes.spinning import guarded, log_left_out, received_time, waiting_messages

_MEASURED: Final = QoSProfile(depth=2000, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Best effort accepts sensors of either reliability; deep, because samples may come while the model compiles."""
_COMMANDS: Final = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
_OF_COIL: Final = ("coil", "coil_current")
"""Last part of a measured topic that is no position."""


class Takers(NamedTuple):
    """What is done with what is heard; called in the thread that spins the node.

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
    """The subscriptions of monitor_node.

    Args:
        node: which subscribes. clock: of it.
        valve: full name of the node whose commands are heard. measured: topic of positions, or of the coil.
        entries: of a map, by quantity; none where this package's own topics are heard.
        take: what is done with what is heard. has_gas: whether there is a pressure behind the valve to be heard.
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
        self._node, self._clock, self._take = node, clock, take
        self._valve, self._measured, self._has_gas = valve, measured, has_gas
        self._sensors = measured.rpartition("/")[0]
        self._voltage = f"{valve}/coil_voltage"
        self._entries: dict[Subscription, LiveInput] = {}
        self._has_stamped_current = False
        self._joints_reader, self._coil_reader, self._pressure_reader = joint_states(), coils(), pressures()
        self._pressures: list[Subscription] = []
        self._sampled: dict[Subscription, Callable[[Any, Any], None]] = {}
        if entries:
            self._subscribe_by_map(entries)
        else:
            self._subscribe_to_own_topics()

    @property
    def measured(self) -> str:
        """The topic of the samples."""
        return self._measured

    @property
    def voltage(self) -> str:
        """The topic of the commands."""
        return self._voltage

    @property
    def by_current(self) -> bool:
        """Whether no position can come, because the coil is all that is subscribed to."""
        return not hasattr(self, "_samples")

    @property
    def wanted(self) -> str:
        """Where samples are waited for, in words."""
        is_own = not self._entries and not self.by_current
        return f"{self._measured}, or a current on {self._sensors}/coil" if is_own else self._measured

    def is_simulated(self) -> bool:
        """Whether /clock counts, or is waited for."""
        return self._clock.is_simulated

    def take_waiting(self) -> bool:
        """Take all queued samples, each after what was heard before it, without an executor; whether there were any."""
        found = False
        for subscription, take in tuple(self._sampled.items()):
            if subscription in self._sampled:
                for sample, info in self._waiting_on(subscription):
                    take(sample, info)
                    found = True
        return found

    def _subscribe_to_own_topics(self) -> None:
        node = self._node
        self.incompatible = IncompatiblePublishers(node, self._voltage)
        on_command: Any = guarded(self._on_command)  # its second argument, message info, is missing in rclpy's types
        self._commands = node.create_subscription(
            Float64, f"{self._valve}/coil_voltage", on_command, _COMMANDS, event_callbacks=self.incompatible.events
        )
        if self._measured.rpartition("/")[2] not in _OF_COIL:
            on_samples: Any = guarded(self._on_samples)
            self._samples = node.create_subscription(JointState, self._measured, on_samples, _MEASURED, raw=True)
            self._sampled[self._samples] = self._on_samples
        on_currents: Any = guarded(self._on_currents)
        self._currents = node.create_subscription(Float64, f"{self._sensors}/coil_current", on_currents, _MEASURED)
        on_coil: Any = guarded(self._on_coil)
        self._coil = node.create_subscription(BatteryState, f"{self._sensors}/coil", on_coil, _MEASURED, raw=True)
        self._sampled |= {self._currents: self._on_currents, self._coil: self._on_coil}
        if self._has_gas:
            self._subscribe_to_pressures()

    def _subscribe_to_pressures(self) -> None:
        """Subscribe to the pressure behind the valve, and to those at its ends.

        A simulated valve says which pressures it obeys, and from when on; a sensor's stamps are those of its samples.
        What the valve is told counts, from its own stamp on, until one of them is heard.
        """
        node, sensors, valve = self._node, self._sensors, self._valve
        take: Any = guarded(functools.partial(self._on_pressure, self._take.pressure))
        self._pressures = [
            node.create_subscription(FluidPressure, f"{sensors}/outlet_pressure", take, _MEASURED, raw=True)
        ]
        for end in ("inlet_pressure", "demand_pressure"):
            take_end = functools.partial(self._take.end_pressure, end)
            take = guarded(functools.partial(self._on_pressure, take_end))
            told = node.create_subscription(FluidPressure, f"{valve}/{end}", take, _MEASURED, raw=True)
            take = guarded(functools.partial(self._on_pressure, functools.partial(self._take_known, told, take_end)))
            known = (
                node.create_subscription(FluidPressure, f"{valve}/obeyed/{end}", take, _MEASURED, raw=True)
                if sensors == valve
                else node.create_subscription(FluidPressure, f"{sensors}/{end}", take, _MEASURED, raw=True)
            )
            self._pressures += [told, known]

    def _take_known(self, told: Subscription, take: Callable[[int, float], None], stamp: int, pressure: float) -> None:
        """Take the pressure that there is at an end of the valve, and hear no more of what the valve is told."""
        if told in self._pressures:
            self._pressures.remove(told)
            self._node.destroy_subscription(told)
        take(stamp, pressure)

    def _subscribe_by_map(self, entries: Mapping[str, LiveInput]) -> None:
        """Subscribe to the topics that the map names; each message is converted to the type of this package."""

        def subscription_to(quantity: str, callback: Callable[..., None], qos: QoSProfile, **settings: Any) -> Any:
            entry = entries[quantity]
            subscription = subscribe(
                entry.message_class,
                entry.source.topic,
                guarded(lambda message, info: callback(*self._as_own_message(entry, message, info))),
                qos,
                **settings,
            )
            self._entries[subscription] = entry
            return subscription

        subscribe: Any = self._node.create_subscription
        samples = "position" if "position" in entries else "current"
        self._measured, self._voltage = (entries[key].source.topic for key in (samples, "command"))
        self.incompatible = IncompatiblePublishers(self._node, self._node.resolve_topic_name(self._voltage))
        self._commands = subscription_to(
            "command", self._on_command, _COMMANDS, event_callbacks=self.incompatible.events
        )
        if "position" in entries:
            self._samples = subscription_to("position", self._on_samples, _MEASURED)
            self._sampled[self._samples] = self._on_samples
        if "current" in entries:
            self._currents = subscription_to("current", self._on_currents, _MEASURED)
            self._sampled[self._currents] = self._on_currents

    def _as_own_message(self, entry: LiveInput, message: Any, info: Any) -> tuple[Any, Any]:
        """A message and its times as this package's own topics have them; of positions the stamp, ns, and metres."""
        value, stamp = entry.value(message), entry.stamp(message)
        if entry.quantity != "position":
            return Float64(data=value), {"stamp": stamp} if stamp else info
        return (stamp or self._arrival(info), value), info

    def _on_command(self, message: Float64, info: Any) -> None:
        self._take.command(self._arrival(info), message.data)

    def _on_currents(self, message: Float64, info: Any) -> None:
        for current, received in self._all_of(self._currents, message, info):
            if not self._has_stamped_current:
                self._take.coil(self._arrival(received), current.data, math.nan, 0)

    def _on_coil(self, encoded: bytes, info: Any) -> None:
        """Take the current where it is stamped, in place of the one that is not."""
        for coil, received in self._all_of(self._coil, encoded, info):
            found = self._read(self._coil_reader, self._coil.topic_name, coil)
            if found is not None and math.isfinite(found[2]):
                self._hear_no_unstamped_current()
                stamp, voltage, current = found
                self._take.coil(stamp, current, voltage, self._received(received))

    def _hear_no_unstamped_current(self) -> None:
        """Unsubscribe from what says nothing more, and costs as much as a sample to send and to take."""
        if not self._has_stamped_current:
            self._has_stamped_current = True
            del self._sampled[self._currents]
            self._node.destroy_subscription(self._currents)

    def _on_pressure(self, take: Callable[[int, float], None], encoded: bytes, info: Any) -> None:
        """Take a pressure; one without a stamp counts from when it is received."""
        found = self._read(self._pressure_reader, "a pressure", encoded)
        if found is not None:
            stamp, pressure = found
            take(stamp or self._arrival(info), pressure)

    def _take_pressures(self) -> None:
        """Take all queued pressures: a sample is compared with a model that was given those heard before it."""
        for subscription in tuple(self._pressures):
            if subscription in self._pressures:
                for encoded, info in self._waiting_on(subscription):
                    subscription.callback(encoded, info)

    def _on_samples(self, sample: bytes | tuple[int, float], info: Any) -> None:
        """Take all queued samples, encoded or as a map gave them."""
        for waiting, received in self._all_of(self._samples, sample, info):
            is_encoded = isinstance(waiting, bytes)
            found = self._read(self._joints_reader, self._measured, waiting) if is_encoded else waiting
            if found is not None:
                stamp, position = found
                self._take.position(stamp, position, self._received(received))

    def _all_of(self, subscription: Subscription, message: Any, info: Any) -> list[tuple[Any, Any]]:
        """A message and all that wait behind it; pressures and commands that were received before are taken first."""
        messages = [(message, info), *self._waiting_on(subscription)]
        self._take_pressures()
        self._take_commands()
        return messages

    def _read(self, reader: EncodedReader, topic: str, encoded: bytes) -> tuple[Any, ...] | None:
        """The stamp and the numbers of a message; None, and rejected, where it does not hold them."""
        try:
            return reader.read(encoded)
        except UnusableMessageError as error:
            self._take.reject(f"{topic}: {error}")
            return None

    def _take_commands(self) -> None:
        for command in self._waiting_on(self._commands):
            self._on_command(*command)

    def _waiting_on(self, subscription: Subscription) -> Iterator[tuple[Any, Any]]:
        """Queued messages with their times; none in simulated time, where the order with /clock must be kept."""
        if self.is_simulated():
            return
        entry = self._entries.get(subscription)
        try:
            for waiting in waiting_messages(subscription):
                yield waiting if entry is None else self._as_own_message(entry, *waiting)
        except Exception as error:  # of rclpy; callbacks of this package are not called in here
            log_left_out(self._node, error)

    def _received(self, info: Any) -> int:
        return 0 if self.is_simulated() else received_time(info)

    def _arrival(self, info: Any) -> int:
        """Receive time of a message without a stamp, ns; in simulated time, when this thread processes it.

        A message that a map names may have one.
        """
        if isinstance(info, dict) and "stamp" in info:
            return int(info["stamp"])
        received = received_time(info)
        return self._clock.stamp() if self.is_simulated() or not received else received
