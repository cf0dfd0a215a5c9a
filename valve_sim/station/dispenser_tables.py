"""The tables of dispenser_node, of topics and of parameters, and what holds between the latter. Needs no ROS.

No station publishes such sizes, so every default is assumed: a station on a bench, whose vehicle fills in ten seconds.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

from valve_sim.model import Parameter, ParameterError
from valve_sim.model.gas import FLUIDS
from valve_sim.nodes.parameters import Words, check_given, settings_of, table_of
from valve_sim.nodes.topics import Topic

_ASSUMED: Final = " (assumed)"
_FLOAT: Final = "std_msgs/msg/Float64"
_PRESSURE: Final = "sensor_msgs/msg/FluidPressure"

TOPICS: Final = (
    Topic("{valve}/outlet_pressure", _PRESSURE, "in", "behind each of `valves`", "Pa"),
    Topic("{valve}/coil_voltage", _FLOAT, "out", "opens or closes each of `valves`", "V"),
    Topic("{valve}/demand_pressure", _PRESSURE, "out", "the line's pressure, to each of `valves`", "Pa"),
    Topic("{valve}/inlet_pressure", _PRESSURE, "out", "its tank's pressure, where that has a volume", "Pa"),
    Topic("~/line_pressure", _PRESSURE, "out", "of the line that all tanks feed", "Pa"),
    Topic("~/vehicle_pressure", _PRESSURE, "out", "of the tank that is filled", "Pa"),
)


class Settings(NamedTuple):
    """Settings of the node; units as in the table."""

    valves: tuple[str, ...] = ("tank_1/valve", "tank_2/valve", "tank_3/valve")
    tank_pressures: tuple[float, ...] = (20e6, 26e6, 32e6)
    tank_volumes: tuple[float, ...] = (0.05, 0.05, 0.05)
    restrictor_diameter: float = 0.06e-3
    nozzle_diameter: float = 0.3e-3
    discharge_coefficient: float = 0.8
    line_volume: float = 2e-6
    vehicle_volume: float = 10e-6
    vehicle_pressure: float = 2e6
    target_pressure: float = 28e6
    least_difference: float = 1e6
    least_flow: float = 0.0
    least_open: float = 1.0
    pause: float = 3.0
    voltage: float = 9.0
    temperature: float = 288.15
    fluid: str = "hydrogen"
    rate: float = 20.0


PARAMETERS: Final = table_of(
    Settings,
    Words("valves", "the nodes that are commanded and heard, relative to this node's namespace; one for each tank"),
    Parameter("tank_pressures", "Pa", "of each tank at the start, as its file declares it", 1e3, 2e8),
    Parameter("tank_volumes", "m³", "of each tank" + _ASSUMED + "; 0: its pressure stays", 0.0, 1e3),
    Parameter("restrictor_diameter", "m", "of each valve's demand orifice, as its file declares it", 1e-6, 0.1),
    Parameter("nozzle_diameter", "m", "of the orifice between line and vehicle" + _ASSUMED, 1e-6, 0.1),
    Parameter("discharge_coefficient", "–", "C_d, of every orifice", 0.05, 1.0),
    Parameter("line_volume", "m³", "of the line" + _ASSUMED, 1e-9, 1e3),
    Parameter("vehicle_volume", "m³", "of the tank that is filled" + _ASSUMED, 1e-9, 1e3),
    Parameter(
        "vehicle_pressure", "Pa", "with which a vehicle comes, and to which the line is vented" + _ASSUMED, 1e3, 2e8
    ),
    Parameter("target_pressure", "Pa", "at which a vehicle is full" + _ASSUMED, 1e3, 2e8),
    Parameter(
        "least_difference", "Pa", "between a valve's outlet and the line; below, the next tank" + _ASSUMED, 0.0, 2e8
    ),
    Parameter("least_flow", "kg/s", "from a tank; below, the next one" + _ASSUMED, 0.0, 1e3),
    Parameter("least_open", "s", "that a valve stays open before the next: it opens late" + _ASSUMED, 0.0, 1e3),
    Parameter("pause", "s", "between a full vehicle and the next" + _ASSUMED, 0.0, 1e6),
    Parameter("voltage", "V", "that opens a valve", 0.0, 1e4),
    Parameter("temperature", "K", "of all gas", 50.0, 1000.0),
    Words("fluid", f"one of {', '.join(FLUIDS)}", tuple(FLUIDS)),
    Parameter("rate", "Hz", "of the pressures that are published; commands are repeated as often", 1.0, 1000.0),
)


def dispenser_settings(given: Mapping[str, object], sources: Mapping[str, str]) -> Settings:
    """The settings to start with; arguments and errors as of `check_given`."""
    settings = settings_of(Settings, check_given(given, PARAMETERS, sources, "dispenser_node"))
    count = len(settings.valves)
    for name in ("tank_pressures", "tank_volumes"):
        if len(getattr(settings, name)) != count:
            raise ParameterError(
                f"{name}: found {len(getattr(settings, name))} numbers, expected {count}, one for each of valves"
            )
    if len(set(settings.valves)) != count:
        raise ParameterError(f"valves: found {', '.join(settings.valves)}, expected each valve once")
    if settings.target_pressure <= settings.vehicle_pressure:
        raise ParameterError(
            f"target_pressure: found {settings.target_pressure:g} Pa, expected more than vehicle_pressure, "
            f"{settings.vehicle_pressure:g} Pa"
        )
    return settings
