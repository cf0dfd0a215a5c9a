"""The tables of topics and services of the nodes, which wire and document them. Needs no ROS.

A name with `{valve}` and the like is filled in with what the node's parameters say.
"""

from __future__ import annotations

from typing import Final, NamedTuple


class Qos(NamedTuple):
    """What a topic asks of the middleware, of which history is always "keep last".

    Attributes:
        depth: messages that are kept for a slow reader. is_reliable: whether a lost message is sent again.
        is_latched: whether late subscribers get the last messages ("transient local").
    """

    depth: int = 10
    is_reliable: bool = True
    is_latched: bool = False

    @property
    def words(self) -> str:
        """The quality of service in words, for the tables of the documentation."""
        reliability = "reliable" if self.is_reliable else "best effort"
        return f"{reliability}{', transient local' if self.is_latched else ''}, depth {self.depth}"


RELIABLE: Final = Qos()
LATCHED: Final = Qos(1, is_latched=True)
DEEP: Final = Qos(1000)
"""For what has more messages a second than a live valve, or may wait while the model compiles."""
SENSOR: Final = Qos(2000, is_reliable=False)
"""Best effort accepts sensors of either reliability; deep, because samples may come while the model compiles."""
LOG: Final = Qos(100, is_latched=True)
"""At least so deep: a recorder that discovers the topic late still gets it from its beginning."""
LAST_STROKES: Final = Qos(30, is_latched=True)
"""For an archive that was not there. Where somebody floods the topic, it costs so many of the largest message."""


class Topic(NamedTuple):
    """One topic or service of a node.

    Attributes:
        name: as ROS writes it, "~/" for the node's own; {words in braces} are filled in.
        type: "sensor_msgs/msg/JointState" and the like.
        direction: "in", "out" or "service".
        meaning: what it says. unit: of its numbers; empty for none.
        qos: None of a service.
    """

    name: str
    type: str
    direction: str
    meaning: str
    unit: str = ""
    qos: Qos | None = RELIABLE


_BATTERY: Final = "sensor_msgs/msg/BatteryState"
_BOOL: Final = "std_msgs/msg/Bool"
_DIAGNOSTICS: Final = "diagnostic_msgs/msg/DiagnosticArray"
_FLOAT: Final = "std_msgs/msg/Float64"
_JOINTS: Final = "sensor_msgs/msg/JointState"
_PRESSURE: Final = "sensor_msgs/msg/FluidPressure"
_TEXT: Final = "std_msgs/msg/String"
_PHASE: Final = "std_msgs/msg/UInt8"
_TRIGGER: Final = "std_srvs/srv/Trigger"
_OF_JOINTS: Final = "m, m/s, N"


def _service(name: str, meaning: str) -> Topic:
    return Topic(name, _TRIGGER, "service", meaning, qos=None)


VALVE: Final = (
    Topic("~/coil_voltage", _FLOAT, "in", "the command, held until the next", "V"),
    Topic("~/joint_states", _JOINTS, "out", "both plungers at publish_rate; the stamp is model time", _OF_JOINTS),
    Topic("~/coil", _BATTERY, "out", "current and voltage at the coil's terminals, at publish_rate", "A, V"),
    Topic("~/coil_current", _FLOAT, "out", "the coil's current, at publish_rate", "A"),
    Topic("~/phase", _PHASE, "out", "on change: 0 closed, 1 pilot, 2 gap_hold, 3 main, 4 open", qos=LATCHED),
    Topic("~/is_open", _BOOL, "out", "on change: whether the flow path is fully open", qos=LATCHED),
    Topic("/diagnostics", _DIAGNOSTICS, "out", "timing, command and valve, with gas both pressures, at 1 Hz"),
    _service("~/reset", "puts the valve to rest: closed, without current or command"),
    _service("~/self_test", "one stroke of a copy of the valve, off line"),
)
ENDS: Final = ("inlet_pressure", "demand_pressure")
"""Pressures at the ends of a valve with gas: of its tank, and behind the demand's orifice."""
GAS: Final = (
    Topic("~/inlet_pressure", _PRESSURE, "in", "the tank's pressure, held until the next", "Pa"),
    Topic("~/demand_pressure", _PRESSURE, "in", "the pressure behind the demand's orifice, held until the next", "Pa"),
    Topic("~/outlet_pressure", _PRESSURE, "out", "behind the valve, at 100 Hz", "Pa"),
    Topic("~/mass_flow", _FLOAT, "out", "from inlet to outlet, at 100 Hz", "kg/s"),
    Topic("~/obeyed/inlet_pressure", _PRESSURE, "out", "each tank pressure that is obeyed, stamped from when on", "Pa"),
    Topic("~/obeyed/demand_pressure", _PRESSURE, "out", "each demand pressure that is obeyed, likewise", "Pa"),
)
"""Of valve_node from when gas is declared."""

IDENTIFICATION: Final = (
    Topic("~/coil_voltage", _FLOAT, "out", "the recorded commands", "V", DEEP),
    Topic("~/measured/joint_states", _JOINTS, "out", "the recorded positions, with their stamps", "m", DEEP),
    Topic("~/measured/coil", _BATTERY, "out", "the recorded coil, of a recording without positions", "A, V", DEEP),
    Topic("~/predicted/joint_states", _JOINTS, "out", "what the model says at the same stamps", _OF_JOINTS, DEEP),
    Topic("~/predicted/coil", _BATTERY, "out", "likewise, of a recording without positions", "A, V", DEEP),
    Topic("~/residual", _FLOAT, "out", "measured less predicted position, or else current", "m or A", DEEP),
    Topic("~/result", _TEXT, "out", "the report in JSON, when it is known", qos=LATCHED),
    Topic("/diagnostics", _DIAGNOSTICS, "out", "replay and identification, at 1 Hz", qos=DEEP),
)
MONITOR: Final = (
    Topic("{valve}/coil_voltage", _FLOAT, "in", "the commands", "V", DEEP),
    Topic("{measured}", _JOINTS, "in", "measured positions", "m", SENSOR),
    Topic("{sensors}/coil", _BATTERY, "in", "stamped current and voltage", "A, V", SENSOR),
    Topic("{sensors}/coil_current", _FLOAT, "in", "current, heard until a stamped one comes", "A", SENSOR),
    Topic("{sensors}/outlet_pressure", _PRESSURE, "in", "behind a valve with gas", "Pa", SENSOR),
    Topic("{valve}/{end}", _PRESSURE, "in", "what is sent to the valve, until one of those below comes", "Pa", SENSOR),
    Topic("{valve}/obeyed/{end}", _PRESSURE, "in", "what a simulated valve obeys", "Pa", SENSOR),
    Topic("{sensors}/{end}", _PRESSURE, "in", "what a real valve's sensors say", "Pa", SENSOR),
    Topic("~/predicted/joint_states", _JOINTS, "out", "what the model says at each sample", _OF_JOINTS),
    Topic("~/residual", _FLOAT, "out", "measured less predicted position, or else current", "m or A"),
    Topic("~/stroke_report", _DIAGNOSTICS, "out", "the figures of each stroke", qos=LAST_STROKES),
    Topic("~/finding", _DIAGNOSTICS, "out", "what has changed, after an alarm", qos=LATCHED),
    Topic("/diagnostics", _DIAGNOSTICS, "out", "valve, model, input and fault isolation, at 1 Hz"),
    _service("~/recommission", "takes the next strokes as the new baseline"),
)
PROFILE: Final = (
    Topic("{valve}/coil_voltage", _FLOAT, "out", "the commands of the profile", "V"),
    Topic("~/commanded", _BATTERY, "out", "what was commanded and when; all else is NaN", "V", LOG),
)
