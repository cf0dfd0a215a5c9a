"""Valves with gas of which the pressure behind them is measured, and nothing else; by test/plants/gas.py.

Every declared number is off as its tolerance allows, and the dampings are not known. Recorded are the command and the
pressure at 1 kHz with a noise of 0.1 % of the tank's: before a demand four openings in one recording, before a dead end
three recordings of one opening each; two more openings are held out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from plants import tolerances
from plants.gas import GasValve

from benchmarks.campaign.bench import Bench, Measured
from valve_sim.identification.diagnosis.run import Diagnosis, diagnose
from valve_sim.identification.fit.budget import Budget
from valve_sim.identification.fit.search import Search
from valve_sim.identification.fit.starts import starts_of
from valve_sim.model import Drive, Valve, simulate
from valve_sim.recordings import Signal, Trace

SHARES: Final = {
    "inlet_pressure": 0.002, "inlet_temperature": 0.004, "outlet_volume": 0.02, "pilot_orifice_diameter": 0.01,
    "main_orifice_diameter": 0.01, "seat_diameter": 0.005, "discharge_coefficient": 0.02,
}  # fmt: skip
"""One standard deviation of the declared numbers of gas, as a share of each."""
DEMAND_SHARE: Final = 0.01
"""Of the demand's orifice, which is known where the demand is."""
EFFECTS: Final = {"seat_leak": (1e-10, 2e-9), "pilot_clogging": (0.4, 0.85), "coulomb_friction": (0.2, 0.5)}
"""What may be missing, m², – and N, and its range; that of a leak is logarithmic."""
FIELDS: Final = {"seat_leak": "leak", "pilot_clogging": "clogging", "coulomb_friction": "friction"}
"""Of the plant."""
LEVELS: Final = (9.0, 12.0, 8.0, 13.5)
HELD_OUT: Final = (10.0, 8.5)
"""V."""
NOISE: Final = 1e-3
"""Of the tank's pressure."""
REST, BLEEDS = 0.05, 2.0
"""s before the first command, and for which a demand empties the line between two openings."""
EQUAL: Final = 0.01
"""Share of the tank's pressure, a difference below which counts as equalised."""
SECONDS: Final = 120.0
"""That stand for the work of a diagnosis, as of `valve-sim diagnose`."""
WANTED: Final[Measured] = {"equalises, %": 2.0}
"""What figures may be at most, without their sign."""

Plant = Callable[[], GasValve]


class Drawn(NamedTuple):
    """A valve, its recordings, and the seconds that its pressure takes to equalise at 9 V."""

    declared: Valve
    training: tuple[Trace, ...]
    held_out: tuple[Trace, ...]
    equalises: float
    words: str


def bench(seed: int, missing: str) -> Bench:
    """A valve whose file lacks one of `EFFECTS` or, where `missing` is empty, nothing."""
    case = drawn(seed, missing)
    return Bench(
        case.words,
        lambda: diagnose(case.training, case.held_out, case.declared, budget=Budget.of_seconds(SECONDS)),
        lambda found: _judged(found, case, missing),
    )


def drawn(seed: int, missing: str) -> Drawn:
    """A case; the same seed gives the same."""
    random = np.random.default_rng([seed, 20])
    has_demand = seed % 2 == 0
    gas = {
        "inlet_pressure": float(random.choice([20e6, 35e6, 70e6])), "inlet_temperature": 288.15,
        "outlet_volume": float(random.uniform(5e-6, 15e-6)), "outlet_pressure": 1e5,
        "pilot_orifice_diameter": float(random.uniform(0.16e-3, 0.2e-3)), "main_orifice_diameter": 3e-3,
        "seat_diameter": 4e-3, "demand_orifice_diameter": 0.04e-3 if has_demand else 0.0, "demand_pressure": 1e5,
        "discharge_coefficient": 0.8,
    }  # fmt: skip
    sigmas = {name: share * gas[name] for name, share in SHARES.items()}
    if has_demand:
        sigmas["demand_orifice_diameter"] = DEMAND_SHARE * gas["demand_orifice_diameter"]
    true_gas = {name: value + sigmas.get(name, 0.0) * float(random.standard_normal()) for name, value in gas.items()}
    sheet: Any = {
        **tolerances.SHEET_VALVE,
        "attraction_polynomial": [*np.asarray(tolerances.SHEET_VALVE["attraction_polynomial"]).tolist()],
    }
    true: dict[str, Any] = dict(tolerances.deviated(tolerances.SHEET_VALVE, tolerances.drawn_deviations(random)))
    true |= {"pilot_damping": float(random.uniform(0.5, 2.0)), "main_damping": float(random.uniform(3.0, 6.0))}
    size = _size(missing, random)
    known = {**tolerances.declared_tolerances(tolerances.SHEET_VALVE), "gas": sigmas}
    declared = Valve.from_mapping({"valve": sheet, "gas": gas, "tolerances": known}, f"case {seed}")

    def plant() -> GasValve:
        return GasValve(true, true_gas, rtol=1e-7, **({FIELDS[missing]: size} if missing else {}))

    opening = 1.4 * _equalises(plant, 9.0, gas["inlet_pressure"])
    noise = NOISE * gas["inlet_pressure"]
    sets = [_recorded(plant, levels, opening, noise, random, has_demand=has_demand) for levels in (LEVELS, HELD_OUT)]
    words = f"{1e-6 * gas['inlet_pressure']:g} MPa, {1e6 * gas['outlet_volume']:.0f} cm³, "
    words += "demand" if has_demand else "dead end"
    return Drawn(declared, sets[0], sets[1], opening / 1.4, f"{words}, {size:.3g}" if missing else words)


def _size(missing: str, random: np.random.Generator) -> float:
    if not missing:
        return 0.0
    low, high = EFFECTS[missing]
    if missing == "seat_leak":
        return float(math.exp(random.uniform(math.log(low), math.log(high))))
    return float(random.uniform(low, high))


def _equalises(plant: Plant, volts: float, inlet: float) -> float:
    """Seconds from a command until the pressures are equal, or as near as they come."""
    times = np.arange(3000) * 1e-3
    _, pressures, _ = plant().run([(0.0, volts)], times)
    return _first_near(times, pressures, inlet)


def _first_near(times: Any, pressures: Any, inlet: float) -> float:
    return float(times[np.argmax(pressures >= (1.0 - EQUAL) * min(inlet, float(pressures[-1])))])


def _recorded(
    plant: Plant, levels: Sequence[float], opening: float, noise: float, random: Any, *, has_demand: bool
) -> tuple[Trace, ...]:
    """One recording of all openings, where a demand empties the line between them; else one of each."""
    rows = [levels] if has_demand else [(level,) for level in levels[:3]]
    found = []
    for row in rows:
        starts = REST + (opening + BLEEDS) * np.arange(len(row))
        commands = [
            pair for start, level in zip(starts, row, strict=True) for pair in ((start, level), (start + opening, 0.0))
        ]
        drive = commands if has_demand else commands[:1]
        times = np.arange(round(1e3 * (REST + len(row) * (opening + (BLEEDS if has_demand else 0.0))))) * 1e-3
        _, pressures, _ = plant().run(drive, times)
        shown = Signal(times, pressures + noise * random.standard_normal(len(times)))
        found.append(Trace("outlet", Drive.of(*zip(*drive, strict=True)), times[:0], times[:0], outlet_pressure=shown))
    return tuple(found)


def _judged(found: Diagnosis, case: Drawn, missing: str) -> Measured:
    """When the corrected valve equalises, and by how much χ² falls where what is missing is freed and nothing else.

    Where χ² falls by less than some 15, no search can tell what is missing: the evidence charges 8 to 10 for a
    parameter of so many samples.
    """
    times = np.arange(3000) * 1e-3
    shown = simulate(found.valve, Drive.of([0.0], [9.0]), times, start_time=0.0).outlet_pressure
    assert shown is not None and case.declared.gas is not None
    equalises = _first_near(times, shown, case.declared.gas.inlet_pressure)
    measured = {"equalises, %": 100.0 * (equalises / case.equalises - 1.0)}
    if missing:
        search = Search(found.before.fit.problem)
        search.fit_declared()
        fitter, declared = search.fitter, search.tried[()]
        starts = starts_of(fitter, (missing,), (), declared)
        fits = [fitter.descended(fitter.model((missing,)), start.values) for start in starts]
        measured["χ² falls by"] = declared.fit.cost - min(one.cost for one in fits if one is not None)
    return measured
