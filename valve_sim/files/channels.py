"""The channels of a recording: one row says all that is known of one.

Bags, tables, maps of foreign recordings, checks, summaries and the reference page are derived from these rows. To add a
sensor is to add a row to `Signals`; nothing else lists channels.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Annotated, Final, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from valve_sim.model.core.own.units import Unit, parse_unit

FLOAT: Final = "std_msgs/msg/Float64"
JOINT_STATE: Final = "sensor_msgs/msg/JointState"
PRESSURE: Final = "sensor_msgs/msg/FluidPressure"
COIL_STATE: Final = "sensor_msgs/msg/BatteryState"
"""Of `COIL`: `current` and `voltage` at the coil's terminals, `temperature`; NaN where it was not measured."""
COIL, LIVE_COIL = "measured/coil", "coil"
PILOT, MAIN = "pilot_plunger", "main_plunger"
CELSIUS: Final = 273.15
"""K, of 0 °C: a valve's temperatures are in °C."""

_ALLOWED: Final[Mapping[str, tuple[str, ...]]] = {
    "voltage": ("V", "mV", "kV"),
    "length": ("m", "cm", "mm", "um", "µm", "nm", "in"),
    "current": ("A", "mA", "uA", "µA"),
    "acceleration": ("m/s2", "m/s²", "mm/s2", "g"),
    "pressure": ("Pa", "hPa", "mbar", "kPa", "bar", "MPa", "psi"),
    "force": ("N", "mN", "kN", "kgf", "lbf"),
    "temperature": ("degC", "°C", "K"),
    "time": ("s", "ms", "us", "µs", "100ns", "ns", "min", "h", "d"),
}


def _unit(name: str, dimension: str) -> Unit:
    """A unit as a channel of this dimension has it: g is a mass elsewhere, and temperatures are in °C here.

    Windows and controllers count time by 100 ns.
    """
    if name == "100ns":
        return parse_unit("ns")._replace(factor=1e-7)
    unit = parse_unit("g0" if (name, dimension) == ("g", "acceleration") else name)
    return unit._replace(zero=unit.zero - CELSIUS) if dimension == "temperature" else unit


UNITS: Final[Mapping[str, Mapping[str, Unit]]] = {
    dimension: {name: _unit(name, dimension) for name in names} for dimension, names in _ALLOWED.items()
}
"""Units by dimension; the first of each is that of arrays, and the default of a map."""


def nearest_unit(dimension: str, factor: float) -> str:
    """The unit whose factor to SI is the nearest, in their ratio."""
    units = UNITS[dimension]
    return min(units, key=lambda name: abs(math.log(units[name].factor / factor)))


class Signal(NamedTuple):
    """A sampled quantity beside the positions.

    Attributes:
        times: Seconds since the trace's `epoch_ns`, ascending, shape (n,).
        values: SI values (°C for a temperature), shape (n,).
    """

    times: NDArray[np.float64]
    values: NDArray[np.float64]

    def beside(self, times: NDArray[np.float64]) -> "Signal":
        """Return this signal with these very times where they are equal, so that they are held once."""
        same = len(times) == len(self.times) and bool((times == self.times).all())
        return Signal(times, self.values) if same else self


class Place(NamedTuple):
    """A topic in which a channel may be recorded.

    Attributes:
        topic: Below the valve's name.
        message_type: Any type of which the common ROS 2 packages have a definition.
        field: Dotted path of the number in a message.
        joint: Of a JointState: the name of the joint whose number it is.
        by_node: Whether a node computes it, so that it counts only where nothing was measured.
        constants: Other numbers of each message that is written, by their path; what is not named is 0 or empty.
    """

    topic: str
    message_type: str = FLOAT
    field: str = "data"
    joint: str = ""
    by_node: bool = False
    constants: Mapping[str, tuple[float, ...]] = {}


Role = Literal["command", "input", "response", "condition"]
ROLES: Final[Mapping[Role, str]] = {
    "command": "what is commanded",
    "input": "drives the model in place of what is commanded or declared",
    "response": "what the valve does",
    "condition": "kept and shown, but not fitted",
}


@dataclass(frozen=True)
class Channel:
    """One channel.

    Attributes:
        key: What a map calls it.
        dimension: Of `UNITS`, whose first unit its values have.
        role: What it is to a model; see `ROLES`.
        title: Its name on an axis of a figure.
        meaning: What its values say, for the reference.
        places: Topics in which it may be recorded; the first that is there is read.
        bounds: Lowest and highest value that it can have.
        is_judged: Whether a valve can be judged by it: the first of these that is recorded is what is fitted first.
        hint: Words in the names of topics and columns by which `valve-sim map` guesses it; empty: it does not.
        to_check: What `valve-sim map` asks its user to check, beside the unit.
        column: In a CSV that `simulate` writes; empty: its name.
        name: Attribute of a trace. Rows of `Signals` take it from there.
    """

    key: str
    dimension: str
    role: Role
    title: str
    meaning: str
    places: tuple[Place, ...] = ()
    bounds: tuple[float, float] = (-math.inf, math.inf)
    is_judged: bool = False
    hint: str = ""
    to_check: str = ""
    column: str = ""
    name: str = ""

    @property
    def unit(self) -> str:
        """The unit of its values."""
        return next(iter(UNITS[self.dimension]))

    @property
    def own_topic(self) -> Place | None:
        """The first place that it shares with no other quantity, in which it is written; None: there is none."""
        return next((place for place in self.places if place.message_type != COIL_STATE), None)


ABSOLUTE: Final = (0.0, math.inf)
"""Pa: no pressure is below a vacuum's."""


def _pressure_of_an_end(name: str) -> tuple[Place, ...]:
    """Where a pressure at an end of the valve is: as measured, else as a node obeys it, else as a node is told it."""
    return tuple(Place(topic, PRESSURE, "fluid_pressure") for topic in (f"measured/{name}", f"obeyed/{name}", name))


@dataclass(frozen=True, kw_only=True)
class Signals:
    """What a recording may hold beside commands and positions, each with times of its own; None: not recorded."""

    coil_current: Annotated[
        Signal | None,
        Channel(
            "current", "current", "response", "coil current", "current of the coil",
            (
                Place(COIL, COIL_STATE, "current"),
                Place("measured/coil_current"),
                Place(LIVE_COIL, COIL_STATE, "current", by_node=True),
                Place("coil_current", by_node=True),
            ),
            is_judged=True,
            hint=r"curr|(^|[^a-z])amp(s|ere|$|[^a-z])|clamp|strom|effort|(^|[^a-z])i_",
        ),
    ] = None  # fmt: skip
    coil_voltage: Annotated[
        Signal | None,
        Channel(
            "voltage", "voltage", "input", "voltage at the coil",
            "measured at the coil: the input; without a command, its steps are the commands",
            (Place(COIL, COIL_STATE, "voltage"), Place(LIVE_COIL, COIL_STATE, "voltage", by_node=True)),
            hint=r"volt|(^|[^a-z])u_|spannung",
        ),
    ] = None  # fmt: skip
    acceleration: Annotated[
        Signal | None,
        Channel(
            "acceleration", "acceleration", "response", "acceleration", "along the axis; its spikes are arrivals",
            (
                Place(
                    "measured/acceleration", "sensor_msgs/msg/Imu", "linear_acceleration.x",
                    # -1 says that there is no orientation and no angular velocity (sensor_msgs/Imu).
                    constants={
                        "orientation.w": (1.0,),
                        "orientation_covariance": (-1.0, *(0.0,) * 8),
                        "angular_velocity_covariance": (-1.0, *(0.0,) * 8),
                    },
                ),
            ),
            hint=r"accel|imu", to_check="sign and offset: positive towards the core, without gravity",
        ),
    ] = None  # fmt: skip
    inlet_pressure: Annotated[
        Signal | None,
        Channel(
            "pressure", "pressure", "input", "inlet pressure", "inlet pressure, absolute",
            _pressure_of_an_end("inlet_pressure"), bounds=ABSOLUTE, hint=r"^(?!.*(outlet|demand)).*(press|druck|_bar)",
        ),
    ] = None  # fmt: skip
    outlet_pressure: Annotated[
        Signal | None,
        Channel(
            "outlet_pressure", "pressure", "response", "outlet pressure", "behind a valve with gas, absolute",
            (
                Place("measured/outlet_pressure", PRESSURE, "fluid_pressure"),
                Place("outlet_pressure", PRESSURE, "fluid_pressure", by_node=True),
            ),
            bounds=ABSOLUTE, is_judged=True, hint=r"outlet.*(press|druck|_bar)",
        ),
    ] = None  # fmt: skip
    demand_pressure: Annotated[
        Signal | None,
        Channel(
            "demand_pressure", "pressure", "input", "demand pressure",
            "behind the demand's orifice of a valve with gas, absolute; each holds until the next",
            _pressure_of_an_end("demand_pressure"), bounds=ABSOLUTE, hint=r"demand.*(press|druck|_bar)",
        ),
    ] = None  # fmt: skip
    coil_temperature: Annotated[
        Signal | None,
        Channel(
            "temperature", "temperature", "condition", "coil temperature", "of the coil",
            (
                Place("measured/coil_temperature", "sensor_msgs/msg/Temperature", "temperature"),
                Place(COIL, COIL_STATE, "temperature"),
                Place(LIVE_COIL, COIL_STATE, "temperature", by_node=True),
            ),
            bounds=(-CELSIUS, math.inf), hint=r"temp",
        ),
    ] = None  # fmt: skip

    def signals(self, role: Role | None = None) -> dict[str, Signal]:
        """What was recorded, or what of it has this role, by name."""
        names = (channel.name for channel in SIGNALS.values() if role in (None, channel.role))
        return {name: signal for name in names if (signal := getattr(self, name)) is not None}


SIGNALS: Final[Mapping[str, Channel]] = {
    channel.key: channel for channel in (replace(get_args(row.type)[1], name=row.name) for row in fields(Signals))
}
"""The rows of `Signals` by their keys."""

CHANNELS: Final[Mapping[str, Channel]] = {
    channel.key: channel
    for channel in (
        Channel(
            "command", "voltage", "command", "commanded voltage",
            "commanded voltage, held until the next message or row", (Place("coil_voltage"),),
            hint=r"command|cmd|setpoint|demand|supply|driver|volts", column="coil_voltage", name="drive",
        ),
        Channel(
            "position", "length", "response", "pilot plunger",
            "pilot plunger, 0 where the valve is closed, positive towards the core",
            (
                Place("measured/joint_states", JOINT_STATE, "position", PILOT),
                Place("joint_states", JOINT_STATE, "position", PILOT, by_node=True),
            ),
            is_judged=True, name="pilot_position",
            hint=r"pos|lift|lvdt|displ|stroke|travel|plunger|laser|range|dist|tracker|point|hub|weg",
        ),
        Channel(
            "main_position", "length", "response", "main plunger", "main plunger, at the same times",
            (
                Place("measured/joint_states", JOINT_STATE, "position", MAIN),
                Place("joint_states", JOINT_STATE, "position", MAIN, by_node=True),
            ),
            name="main_position",
        ),
        *SIGNALS.values(),
    )
}  # fmt: skip
"""Every channel by the key of a map."""

JUDGED: Final = tuple(key for key, channel in CHANNELS.items() if channel.is_judged)
"""By which of these a valve is judged: the first that is recorded."""
