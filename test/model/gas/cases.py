"""Valves with gas for tests: the default valve with sizes and pressures that can be changed by name, and runs of it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from plants.gas import GasValve

from valve_sim.files.parameter_files import default_valve
from valve_sim.model import TOLERANCE, Drive, Response, Valve, simulate
from valve_sim.model.gas import GasParameters

BASE = GasParameters(
    inlet_pressure=35e6,
    outlet_volume=1e-5,
    pilot_orifice_diameter=0.2e-3,
    main_orifice_diameter=3e-3,
    seat_diameter=4e-3,
)


def gas_valve(**gas: Any) -> Valve:
    """The default valve with a seat load of 0.3 N and this gas."""
    return replace(default_valve().exact().with_values(seat_load=0.3), gas=BASE._replace(**gas))


def independent(valve: Valve) -> GasValve:
    """The same valve, as the independent plant has it."""
    assert valve.gas is not None
    declared = {**valve.parameters._asdict()}
    return GasValve(declared, {name: value for name, value in valve.gas._asdict().items() if name != "fluid"})


OPENING: Final = ((0.0, 9.0),)
STROKE: Final = ((0.0, 9.0), (0.1, 0.0))


class Case(NamedTuple):
    """One run: a name, what differs from `gas_valve()`, commands (s, V), how long (s), leak (m²), and clogging."""

    name: str
    gas: dict[str, float]
    drive: tuple[tuple[float, float], ...] = OPENING
    end: float = 0.6
    leak: float = 0.0
    clogging: float = 1.0

    @property
    def valve(self) -> Valve:
        effects = {"seat_leak": {"area": self.leak}, "pilot_clogging": {"ratio": self.clogging}}
        return replace(gas_valve(**self.gas), effects=effects)


CASES: Final = (
    Case("2 MPa, 10 cm³, dead end", {"inlet_pressure": 2e6}),
    Case("10 MPa, 10 cm³, dead end", {"inlet_pressure": 10e6}),
    Case("35 MPa, 10 cm³, dead end", {}),
    Case("50 MPa, 10 cm³, dead end", {"inlet_pressure": 50e6}),
    Case("70 MPa, 10 cm³, dead end", {"inlet_pressure": 70e6}),
    Case("87.5 MPa, 0.18 mm, dead end", {"inlet_pressure": 87.5e6, "pilot_orifice_diameter": 0.18e-3}),
    Case("35 MPa, 50 cm³, 0.25 mm", {"outlet_volume": 5e-5, "pilot_orifice_diameter": 0.25e-3}, end=1.8),
    Case("35 MPa, 200 cm³", {"outlet_volume": 2e-4}, end=2.0),
    Case("2 MPa, demand 0.1 mm", {"inlet_pressure": 2e6, "demand_orifice_diameter": 0.1e-3}),
    Case("35 MPa, demand 0.05 mm", {"demand_orifice_diameter": 0.05e-3}, end=0.8),
    Case("35 MPa, demand too large to lift", {"demand_orifice_diameter": 0.2e-3}),
    Case("70 MPa, too weak to leave the seat", {"inlet_pressure": 70e6, "pilot_orifice_diameter": 0.23e-3}, end=0.1),
    Case("too weak to lift: spring and gas win at 5.5 V", {"inlet_pressure": 5e6}, ((0.0, 5.5),), 0.4),
    Case("released while it waits", {}, STROKE, 0.3),
    Case("released while it flows", {
        "inlet_pressure": 2e6, "demand_orifice_diameter": 0.5e-3, "pilot_orifice_diameter": 1e-3}, STROKE, 0.3),
    Case("flows back, 2 to 3 MPa", {"inlet_pressure": 2e6, "outlet_pressure": 3e6}, end=0.2),
    Case("flows back choked, 2 to 20 MPa", {"inlet_pressure": 2e6, "outlet_pressure": 20e6}, end=0.3),
    Case("nearly equal from the start", {"outlet_pressure": 35e6 - 100.0}, end=0.1),
    Case("leak of 0.1 mm", {"inlet_pressure": 10e6}, end=0.3, leak=7.85e-9),
    Case("pilot clogged to 60 %", {}, end=0.9, clogging=0.6),
)  # fmt: skip


def ours(case: Case, times: Any, tolerance: float = TOLERANCE) -> Response:
    """By the core; SimulationError where it comes to no end."""
    return simulate(case.valve, Drive.of(*zip(*case.drive, strict=True)), times, start_time=0.0, tolerance=tolerance)


class Compared(NamedTuple):
    """A run beside the independent plant's.

    Attributes:
        times: s, of the samples. run: the core's. events: the plant's, s and kind. is_same: whether the kinds agree.
        late: largest difference of a time, s. off: largest relative difference of pressure. is_good: within 5 µs and
            0.1 % of each time, and 0.2 % of pressure.
    """

    times: Any
    run: Response
    events: list[tuple[float, str]]
    is_same: bool
    late: float
    off: float
    is_good: bool


def compared(case: Case) -> Compared:
    times = np.linspace(case.end / 400, case.end, 400)
    run, plant = ours(case, times), independent(case.valve)
    plant.leak, plant.clogging = case.leak, case.clogging
    pressure = plant.run(case.drive, times)[1]
    assert run.outlet_pressure is not None
    found, expected = sorted((event.time, event.kind.name) for event in run.events), sorted(plant.events)
    pairs = [(a, b) for (a, _), (b, _) in zip(found, expected, strict=False)]
    is_same = [kind for _, kind in found] == [kind for _, kind in expected]
    off = float(np.abs(run.outlet_pressure / pressure - 1.0).max())
    is_good = is_same and off <= 2e-3 and all(abs(a - b) <= 5e-6 + 1e-3 * b for a, b in pairs)
    return Compared(times, run, expected, is_same, max((abs(a - b) for a, b in pairs), default=0.0), off, is_good)
