"""Fills simulated vehicles from the tanks of a station with hydrogen, one valve after the other.

    ros2 launch docs/examples/dispenser.launch.py                  # three valves with gas, their monitors, and this
    python3 docs/examples/dispenser.py --ros-args -p pause:=1.0    # beside valves that already run

Cascade filling, as hydrogen stations do it: an empty vehicle is filled from the tank of the lowest pressure first, and
from the next one once the pressure behind the open valve is near the line's. At the target pressure all valves close,
the line is vented, and after a pause the next empty vehicle comes. The gas in the pipe behind a valve counts as its
tank's. No station publishes sizes: all are assumed, for a station on a bench.

Parameters: the fields of `Sizes`, and voltage (V), rate (Hz). Nothing is opened before every valve has said its outlet
pressure. The last command to every valve is 0 V. The exit code is 0.
"""

from __future__ import annotations

import math
import signal
from collections.abc import Sequence
from typing import Any, NamedTuple

import rclpy
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from scipy.optimize import brentq
from sensor_msgs.msg import FluidPressure
from std_msgs.msg import Float64

GAS_CONSTANT, COVOLUME, GAMMA = 4124.5, 7.691e-3, 1.41
"""Of hydrogen as an Abel-Noble gas: J/(kg K), m³/kg, ratio of specific heats."""
TEMPERATURE = 288.15
"""K, of all gas."""
DISCHARGE = 0.8
"""Coefficient of every orifice."""
LONGEST_STEP = 0.01
"""s; the pressures behind the valves are held between messages anyway."""


class Sizes(NamedTuple):
    """Parameters and their defaults: config/gas_tank_1.yaml to _3.yaml have the same tanks and restrictors; SI."""

    valves: Sequence[str] = ("/tank_1/valve", "/tank_2/valve", "/tank_3/valve")
    tank_pressures: Sequence[float] = (20e6, 26e6, 32e6)
    tank_volume: float = 0.05
    restrictor_diameter: float = 0.06e-3
    nozzle_diameter: float = 0.3e-3
    line_volume: float = 2e-6
    vehicle_volume: float = 10e-6
    vehicle_pressure: float = 2e6
    target_pressure: float = 28e6
    least_difference: float = 1e6
    least_open: float = 1.0
    pause: float = 3.0


def density(pressure: float) -> float:
    """Of the gas, kg/m³."""
    return pressure / (GAS_CONSTANT * TEMPERATURE + COVOLUME * pressure)


def pressure_of(mass: float, volume: float) -> float:
    """Of so much gas, kg, in a volume, m³; Pa."""
    return mass * GAS_CONSTANT * TEMPERATURE / (volume - COVOLUME * mass)


def flow(diameter: float, here: float, there: float) -> float:
    """Through an orifice between two pressures, kg/s: isentropic, of an ideal gas."""
    if here < there:
        return -flow(diameter, there, here)
    ratio = max(there / here, (2.0 / (GAMMA + 1.0)) ** (GAMMA / (GAMMA - 1.0)))  # below that it is choked
    head = 2.0 * GAMMA / (GAMMA - 1.0) * (ratio ** (2.0 / GAMMA) - ratio ** ((GAMMA + 1.0) / GAMMA))
    area = DISCHARGE * math.pi / 4.0 * diameter**2
    return area * here * math.sqrt(max(0.0, head) / (GAS_CONSTANT * TEMPERATURE))


class Dispenser:
    """Tanks, line and vehicle, and which valve is open. Knows no ROS."""

    def __init__(self, sizes: Sizes) -> None:
        self.sizes = sizes
        self.tanks = [density(pressure) * sizes.tank_volume for pressure in sizes.tank_pressures]  # kg
        self.line = density(sizes.vehicle_pressure) * sizes.line_volume
        self.vehicle = density(sizes.vehicle_pressure) * sizes.vehicle_volume
        self.outlets: list[float | None] = [None] * len(self.tanks)
        self.open: int | None = None
        self.is_filling = False
        self.filled = 0
        self._waiting: list[int] = []
        self._since = -math.inf

    @property
    def line_pressure(self) -> float:
        """Pa."""
        return pressure_of(self.line, self.sizes.line_volume)

    @property
    def vehicle_pressure(self) -> float:
        """Pa."""
        return pressure_of(self.vehicle, self.sizes.vehicle_volume)

    def tank_pressure(self, tank: int) -> float:
        """Pa."""
        return pressure_of(self.tanks[tank], self.sizes.tank_volume)

    def step(self, time: float, seconds: float) -> str:
        """Go on by so many seconds to a time, s; what has happened, in words."""
        outlets = [outlet for outlet in self.outlets if outlet is not None]
        if len(outlets) < len(self.outlets):
            return ""
        steps = math.ceil(seconds / LONGEST_STEP)
        for _ in range(steps):
            self._flow(outlets, seconds / steps)
        return self._sequence(outlets, time)

    def _flow(self, outlets: Sequence[float], seconds: float) -> None:
        """One step of Euler's backward method: no pressure passes another, however long the step is."""
        sizes, vehicle_before = self.sizes, self.vehicle_pressure

        def come(pressure: float) -> list[float]:
            return [seconds * flow(sizes.restrictor_diameter, outlet, pressure) for outlet in outlets]

        def excess(pressure: float) -> float:
            """What flows on to the vehicle at the line's pressure, less what the balance of mass leaves for it, kg."""
            left = self.line + sum(come(pressure)) - density(pressure) * sizes.line_volume
            filled = self.vehicle + left
            if not self.is_filling or not 0.0 < filled * COVOLUME < sizes.vehicle_volume:
                return -left
            return seconds * flow(sizes.nozzle_diameter, pressure, pressure_of(filled, sizes.vehicle_volume)) - left

        ends = [*outlets, self.line_pressure, *([vehicle_before] if self.is_filling else [])]
        lowest, highest = min(ends) * (1.0 - 1e-9), max(ends) * (1.0 + 1e-9)
        pressure = brentq(excess, lowest, highest, xtol=1e-3)
        came = come(pressure)
        after = density(pressure) * sizes.line_volume if self.is_filling else self.line + sum(came)
        self.vehicle += self.line + sum(came) - after
        self.line = after
        self.tanks = [tank - mass for tank, mass in zip(self.tanks, came, strict=True)]
        if not self.is_filling:
            self._vent()

    def _vent(self) -> None:
        self.line = min(self.line, density(self.sizes.vehicle_pressure) * self.sizes.line_volume)

    def _sequence(self, outlets: Sequence[float], time: float) -> str:
        sizes = self.sizes
        if not self.is_filling:
            if time - self._since < sizes.pause:
                return ""
            self.vehicle = density(sizes.vehicle_pressure) * sizes.vehicle_volume
            self._waiting = sorted(range(len(self.tanks)), key=self.tank_pressure)
            self.is_filling = True
            return self._next(time)
        if self.vehicle_pressure >= sizes.target_pressure:
            self.filled += 1
            return self._end(time, f"vehicle {self.filled} is full: {1e-6 * self.vehicle_pressure:.1f} MPa")
        assert self.open is not None
        is_spent = outlets[self.open] - self.line_pressure < sizes.least_difference
        if time - self._since < sizes.least_open or not is_spent:
            return ""
        if self._waiting:
            return self._next(time)
        return self._end(time, f"no tank gives any more, at {1e-6 * self.vehicle_pressure:.1f} MPa in the vehicle")

    def _next(self, time: float) -> str:
        self.open, self._since = self._waiting.pop(0), time
        tank, vehicle = 1e-6 * self.tank_pressure(self.open), 1e-6 * self.vehicle_pressure
        return f"opens {self.sizes.valves[self.open]}, its tank at {tank:.1f} MPa, the vehicle at {vehicle:.1f} MPa"

    def _end(self, time: float, reason: str) -> str:
        self.open, self.is_filling, self._since = None, False, time
        self._vent()
        return f"{reason}; all valves close"


class DispenserNode:
    """A `Dispenser` on the topics of its valves."""

    def __init__(self, node: Node) -> None:
        self._node = node
        defaults = Sizes()._asdict()
        values = {name: node.declare_parameter(name, default).value for name, default in defaults.items()}
        self._dispenser = Dispenser(Sizes(**values))
        self._voltage = node.declare_parameter("voltage", 9.0).value
        self._publishers = {
            name: [node.create_publisher(kind, f"{valve}/{name}", 10) for valve in values["valves"]]
            for name, kind in (
                ("coil_voltage", Float64), ("demand_pressure", FluidPressure), ("inlet_pressure", FluidPressure),
            )
        }  # fmt: skip
        for number, valve in enumerate(values["valves"]):
            node.create_subscription(
                FluidPressure, f"{valve}/outlet_pressure", lambda message, k=number: self._hear(k, message), 10
            )
        self._shown = [node.create_publisher(FluidPressure, f"~/{name}_pressure", 10) for name in ("line", "vehicle")]
        self._last: float | None = None
        node.create_timer(1.0 / node.declare_parameter("rate", 20.0).value, self._step)

    def _hear(self, valve: int, message: Any) -> None:
        if 0.0 < message.fluid_pressure < math.inf:
            self._dispenser.outlets[valve] = message.fluid_pressure

    def _step(self) -> None:
        """One step to the clock's time; a timer may have left out some of its calls."""
        now = 1e-9 * self._node.get_clock().now().nanoseconds
        seconds, self._last = max(0.0, now - (now if self._last is None else self._last)), now
        if words := self._dispenser.step(now, seconds):
            self._node.get_logger().info(words)
        if missing := [k for k, outlet in enumerate(self._dispenser.outlets) if outlet is None]:
            names = ", ".join(f"{self._dispenser.sizes.valves[k]}/outlet_pressure" for k in missing)
            self._node.get_logger().warning(f"waits for {names}", throttle_duration_sec=10.0)
            return
        line = self._pressure(self._dispenser.line_pressure)
        for k in range(len(self._dispenser.tanks)):
            volts = self._voltage if k == self._dispenser.open else 0.0
            self._publishers["coil_voltage"][k].publish(Float64(data=volts))
            self._publishers["demand_pressure"][k].publish(line)
            self._publishers["inlet_pressure"][k].publish(self._pressure(self._dispenser.tank_pressure(k)))
        self._shown[0].publish(line)
        self._shown[1].publish(self._pressure(self._dispenser.vehicle_pressure))

    def _pressure(self, value: float) -> Any:
        message = FluidPressure(fluid_pressure=value)
        message.header.stamp = self._node.get_clock().now().to_msg()
        return message

    def close(self) -> None:
        """No voltage on any coil."""
        for publisher in self._publishers["coil_voltage"]:
            publisher.publish(Float64(data=0.0))
            publisher.wait_for_all_acked(Duration(seconds=1))


def main() -> None:
    """Fill vehicles until a signal comes."""
    signals: list[int] = []
    # ROS must outlive Ctrl-C here: a context that is shut down sends no 0 V.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, frame: signals.append(number))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Node("dispenser")
    dispenser = DispenserNode(node)
    try:
        while not signals:
            rclpy.spin_once(node, timeout_sec=0.1)
    finally:
        dispenser.close()
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C comes a second time, from ros2 launch
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
