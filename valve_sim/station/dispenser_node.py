"""The node `dispenser`: a `Dispenser` wired to the topics of its valves. The coils are off at its end.

Threads: one empties the inbox, steps and publishes; an `AnsweringThread` answers ROS; the main thread waits for a
signal.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Final

from rclpy.publisher import Publisher
from sensor_msgs.msg import FluidPressure
from std_msgs.msg import Float64

from valve_sim.files.parameter_sections import Section
from valve_sim.nodes.messages import ReadingMessages
from valve_sim.nodes.realtime import NANOSECONDS, Arrival, Restart, Worker
from valve_sim.nodes.receiving import Inbox
from valve_sim.nodes.starting import STOP_SECONDS
from valve_sim.nodes.wiring import CommandingNode
from valve_sim.station.dispenser import Dispensed, Dispenser
from valve_sim.station.tables import DISPENSER_TOPICS, DispenserSettings

_BETWEEN_REMINDERS: Final = 10.0
"""s between lines that say which valve is waited for."""


class DispenserNode(CommandingNode[DispenserSettings]):
    """The node `dispenser`, with the topics `tables.DISPENSER_TOPICS` for each of `valves`.

    Parameters: `tables.DispenserSettings`; they are read once, at the start.

    Raises:
        ParameterError: a parameter is unknown, of the wrong type or out of range.
    """

    def __init__(self, sections: Sequence[tuple[str, Section]]) -> None:
        super().__init__("dispenser", sections, DispenserSettings, DISPENSER_TOPICS)
        self._dispenser = Dispenser(self._settings)
        self._inbox, self._messages = Inbox(self._node, self._clock), ReadingMessages("")
        self._wire()
        self._zero = 0
        self._worker = Worker(
            self._clock,
            self._settings.rate,
            prepare=self._prepare,
            restart=self._restart,
            step=self._step,
            fail=self._fail,
        )
        self._threads.append(self._worker)  # which cannot end while it compiles

    def _work(self) -> None:
        self._worker.start()
        super()._work()
        self._worker.stop(STOP_SECONDS)

    def _wire(self) -> None:
        interface = self._interface
        self._demands: list[Publisher] = []
        self._inlets: list[Publisher | None] = []
        for k, (valve, volume) in enumerate(zip(self._full_names("valves"), self._settings.tank_volumes, strict=True)):
            self._voltages.append(interface.publisher("{valve}/coil_voltage", valve=valve))
            self._demands.append(interface.publisher("{valve}/demand_pressure", valve=valve))
            self._inlets.append(interface.publisher("{valve}/inlet_pressure", valve=valve) if volume else None)
            take = functools.partial(self._take_outlet, k)
            interface.receive(self._inbox, "{valve}/outlet_pressure", take, valve=valve)
        self._line = interface.publisher("~/line_pressure")
        self._vehicle = interface.publisher("~/vehicle_pressure")

    def _take_outlet(self, valve: int, message: FluidPressure, arrival: Arrival) -> None:
        if not self._dispenser.hear(valve, message.fluid_pressure):
            self._node.get_logger().warning(
                f"{self._settings.valves[valve]}/outlet_pressure: {message.fluid_pressure:g} Pa is ignored, expected a "
                "number above 0; the last good pressure stays",
                throttle_duration_sec=_BETWEEN_REMINDERS,
            )

    # --- the stepping thread ---

    def _prepare(self) -> None:
        """Load or compile the line's model before the first step, and say what is waited for."""
        self._dispenser.prepare()
        tanks = ", ".join(self._settings.valves)
        self._node.get_logger().info(
            f"ready: opens {tanks} in rising order of their tanks' pressures, once all have said their outlet pressure"
        )

    def _restart(self, restart: Restart) -> None:
        if restart.reason:
            self._node.get_logger().warning(f"{restart.reason}: all valves close, and filling begins anew")
        self._zero = restart.reading.nanoseconds
        self._dispenser.restart()

    def _step(self, deadline: int) -> None:
        self._inbox.deliver()
        done = self._dispenser.step((deadline - self._zero) / NANOSECONDS)
        for words in done.words:
            self._node.get_logger().info(words)
        if missing := self._dispenser.unheard:
            self._node.get_logger().warning(
                f"waits for {', '.join(f'{name}/outlet_pressure' for name in missing)}",
                throttle_duration_sec=_BETWEEN_REMINDERS,
            )
            return
        self._publish(done)

    def _publish(self, done: Dispensed) -> None:
        stamp = self._clock.stamp()
        line = self._messages.pressure(stamp, done.line_pressure)
        for demand in self._demands:
            demand.publish(line)
        for inlet, pressure in zip(self._inlets, done.tank_pressures, strict=True):
            if inlet is not None:
                inlet.publish(self._messages.pressure(stamp, pressure))
        with self._commanding:
            for voltage, volts in zip(self._voltages, done.volts, strict=True) if not self._is_off else ():
                voltage.publish(Float64(data=volts))
        self._line.publish(line)
        self._vehicle.publish(self._messages.pressure(stamp, done.vehicle_pressure))
