"""Valves seen through their current alone, diagnosed: `python -m benchmarks.sensorless --cases 16`.

The plant is test/plants/coil_alone.py, which shares no line with the package. Every declared number is off as its
tolerance allows; the coil has 6 to 12 Ω, is shorted or clamped at release, its supply droops; current is sampled at
10 or 20 kHz with 1 to 5 mA of noise, some samples are lost, and the voltage is measured in every second case. In the
first half of the cases nothing is missing, in the others one effect. Held-out strokes are judged by the true positions.

`--measured positions` records positions with 1 µm of noise in place of the coil's current, `--measured both` beside
it; `--missing motional_emf` leaves the same effect out of the file in every case.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from plants import coil_alone, tolerances

from benchmarks.blind import Answer, Study, run
from valve_sim.identification.diagnosis.run import diagnose
from valve_sim.identification.estimation.followed_positions import followed_positions
from valve_sim.identification.estimation.result import Fit
from valve_sim.model import Drive, Valve, published_times, simulate
from valve_sim.traces import Signal, Trace

SHEET: Final[dict[str, Any]] = {
    **tolerances.SHEET_VALVE, "attraction_polynomial": (6.0, 17.096e3, -30.931e6, 24.026e9),
    "coil_time_constant": 2.2e-3,
}  # fmt: skip
"""What the data sheet says, at 9 V."""
EFFECTS: Final[Mapping[str, tuple[str, float, float]]] = {
    "coulomb_friction": ("friction", 0.2, 0.5),
    "constant_force": ("extra_force", -0.5, -0.2),
    "pressure_force": ("pressure", 2.0, 5.0),
    "quadratic_drag": ("drag", 10.0, 25.0),
    "coil_heating": ("heating", 20.0, 60.0),
    "magnetic_saturation": ("knee", 1.5, 2.5),
    "eddy_lag": ("eddy_resistance", 30.0, 80.0),
    "motional_emf": ("", 0.0, 0.0),
}
"""What may be missing: the plant's field, and its range."""
STROKES: Final = 24
LEVELS: Final = tuple(round(7.5 + 6.5 * (0.618 * stroke % 1.0), 1) for stroke in range(STROKES))
HELD_OUT: Final = (8.1, 13.4, 9.6, 11.6)
"""V."""
POSITION_NOISE: Final = 1e-6
"""m, where positions are measured."""
MEASURED: Final = ("current", "positions", "both")
PERIOD: Final = 0.070
ON: Final = 0.035
"""s."""


class Case(NamedTuple):
    """A valve, what its file says, and its recordings with the positions that nobody measured."""

    missing: str
    declared: Valve
    traces: tuple[Trace, Trace]
    positions: tuple[np.ndarray, np.ndarray]
    times: tuple[float, float]
    words: str

    def measured(self, sensors: str, seed: int) -> Case:
        """This case's strokes, recorded with these sensors."""
        if sensors == "current":
            return self
        random = np.random.default_rng([seed, 19])
        traces = []
        for trace, position in zip(self.traces, self.positions, strict=True):
            shown = position + POSITION_NOISE * random.standard_normal(len(position))
            traces.append(replace(trace, times=trace.sample_times, pilot_position=shown))
        if sensors == "positions":
            traces = [replace(trace, coil_current=None) for trace in traces]
        return self._replace(traces=(traces[0], traces[1]), words=f"{self.words}, {sensors}")


def drawn(seed: int, missing: str) -> Case:
    """A case; the same seed gives the same."""
    random = np.random.default_rng([seed, 18])
    resistance = float(random.uniform(6.0, 12.0))
    true: dict[str, Any] = tolerances.deviated(SHEET, tolerances.drawn_deviations(random))
    a0, a1, a2, a3 = true["attraction_polynomial"]
    release = float(random.choice([0.0, 24.0]))
    build = coil_alone.Build(
        pilot_mass=true["pilot_mass"], main_mass=true["moving_mass"] - true["pilot_mass"],
        pilot_damping=float(random.uniform(0.5, 2.0)), main_damping=float(random.uniform(3.0, 6.0)),
        spring_rate=true["spring_rate"], spring_preload=true["spring_preload"], seat_load=true["seat_load"],
        pilot_gap=true["pilot_gap"], stroke=true["stroke"], a0=a0, a1=a1, a2=a2, a3=a3, resistance=resistance,
        inductance=resistance * true["coil_time_constant"], clamp_voltage=release,
        supply_resistance=float(random.uniform(0.0, 0.3)), eddy_resistance=50.0,
    )  # fmt: skip
    has_voltage = seed % 2 == 0
    if not has_voltage:
        build = build._replace(supply_resistance=0.0)
    effects: dict[str, Mapping[str, float]] = {
        "motional_emf": {"share": 1.0}, "eddy_lag": {"time_constant": SHEET["coil_time_constant"] * resistance / 50.0},
    }  # fmt: skip
    if missing in ("motional_emf", "eddy_lag"):
        del effects[missing]
    if missing == "motional_emf":
        del effects["eddy_lag"]
        build = build._replace(eddy_resistance=0.0)
    elif missing:
        field, low, high = EFFECTS[missing]
        build = build._replace(**{field: float(random.uniform(low, high))})
    mapping = {
        "valve": {**SHEET, "coil_resistance": resistance, "release_voltage": release},
        "effects": effects,
        "tolerances": declared_tolerances(effects),
    }
    noise, rate = float(random.uniform(1e-3, 5e-3)), float(random.choice([10e3, 20e3]))
    recorded = [_recorded(build, levels, noise, rate, random, has_voltage=has_voltage) for levels in (LEVELS, HELD_OUT)]
    opening = coil_alone.simulate(
        build._replace(supply_resistance=0.0), np.array([0.0]), np.array([9.0]), np.array([0.04])
    )
    words = f"{resistance:.1f} Ω, {'clamp' if release else 'short'}, {1e3 * noise:.1f} mA, {1e-3 * rate:g} kHz"
    return Case(
        missing, Valve.from_mapping(mapping, f"case {seed}"), (recorded[0][0], recorded[1][0]),
        (recorded[0][1], recorded[1][1]), (float(opening.reached_gap[0]), float(opening.reached_stop[0])),
        f"{words}, {'voltage' if has_voltage else 'no voltage'}",
    )  # fmt: skip


def declared_tolerances(effects: Mapping[str, Mapping[str, float]]) -> dict[str, Any]:
    """Of the file: eddy currents are known as well as the coil's time constant, for L/R_e is declared and L is off."""
    found: dict[str, Any] = tolerances.declared_tolerances(SHEET)
    share = tolerances.SHARES["coil_time_constant"]
    for name in {"eddy_lag"} & set(effects):
        found["effects"] = {name: {"time_constant": share * effects[name]["time_constant"]}}
    return found


def _recorded(
    build: coil_alone.Build, levels: tuple[float, ...], noise: float, rate: float, random: Any, *, has_voltage: bool
) -> tuple[Trace, np.ndarray]:
    starts = 0.010 + PERIOD * np.arange(len(levels))
    drive = Drive(
        np.column_stack([starts, starts + ON]).ravel(), np.column_stack([levels, np.zeros(len(levels))]).ravel()
    )
    times = np.arange(round((0.010 + PERIOD * len(levels)) * rate)) / rate + 0.37 / rate
    times = times[random.uniform(size=len(times)) > random.choice([0.0, 0.01])]
    shown = coil_alone.simulate(build, drive.times, drive.volts, times)
    current = shown.current + noise * random.standard_normal(len(times))
    voltage = shown.voltage + 5e-3 * random.standard_normal(len(times))
    trace = Trace(
        "coil alone", drive, times[:0], times[:0], coil_current=Signal(times, current),
        coil_voltage=Signal(times, voltage) if has_voltage else None,
    )  # fmt: skip
    return trace, shown.position


class Found(NamedTuple):
    """What a diagnosis made of a case."""

    answer: Answer
    x_error: float
    opening_error: float
    covered: float
    t1_error: float
    t2_error: float
    seconds: float


def examined(case: Case) -> Found:
    """Diagnose it, and judge the corrected valve by the held-out strokes' true positions."""
    started = time.process_time()
    result = diagnose([case.traces[0]], [case.traces[1]], case.declared)
    seconds = time.process_time() - started
    error = _positions(result.after.holdout)[0] - case.positions[1]
    position, stderr = _positions(result.after.fit, [(rival.fit, rival.weight) for rival in result.rivals])
    moves, opens = (_moves(case, part) for part in (0, 1))
    opens &= case.traces[1].drive.at(case.traces[1].sample_times) > 0.0
    is_within = np.abs(position - case.positions[0])[moves] < 1.96 * stderr[moves]
    covered = np.mean(is_within) if np.all(np.isfinite(stderr)) else np.nan
    corrected = replace(result.valve, parameters=result.valve.parameters)
    t1, t2 = published_times(simulate(corrected, Drive.of([0.0], [9.0]), [0.0, 0.04]))
    return Found(
        Answer.of(result.verdict, case.missing), _rms(error), _rms(error[opens]), float(covered),
        t1 - case.times[0], t2 - case.times[1], seconds,
    )  # fmt: skip


def _moves(case: Case, part: int) -> np.ndarray:
    """Whether the plunger truly moves faster than 1 cm/s, by sample of the training or held-out recording."""
    speed: np.ndarray = np.abs(np.gradient(case.positions[part], case.traces[part].sample_times))
    return speed > 1e-2


def _rms(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean(error**2)))


def _positions(found: Fit | None, rivals: Sequence[tuple[Fit, float]] = ()) -> tuple[np.ndarray, np.ndarray]:
    """The model's positions, and their standard errors (nan where positions were measured)."""
    assert found is not None
    if followed := followed_positions(found, rivals):
        return followed[0].position, followed[0].stderr
    position = found.problem.plant.predict(found.values)[0]
    return position, np.full(len(position), np.nan)


def _options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--measured", choices=MEASURED, default="current", help="what is recorded (default: current)")


def _row(found: Found) -> tuple[str, ...]:
    return (
        f"{1e6 * found.x_error:.2f}", f"{1e6 * found.opening_error:.2f}", f"{found.covered:.2f}",
        f"{1e6 * found.t1_error:+.1f}", f"{1e6 * found.t2_error:+.1f}", f"{found.seconds:.1f}",
    )  # fmt: skip


STUDY: Final = Study(
    "Seen through the current alone, or as --measured says; independent plant",
    ("x, µm rms", "opening", "in 95 %", "t1, µs", "t2, µs", "CPU, s"),
    tuple(EFFECTS),
    lambda seed, missing, options: drawn(seed, missing).measured(options.measured, seed),
    lambda case, options: examined(case),
    _row,
    {
        "x within 10 µm": lambda found: found.x_error <= 10e-6,
        "opening within 3 µm": lambda found: found.opening_error <= 3e-6,
        "t1 within 40 µs": lambda found: abs(found.t1_error) <= 40e-6,
        "t2 within 15 µs": lambda found: abs(found.t2_error) <= 15e-6,
    },
    _options,
)


if __name__ == "__main__":
    run(STUDY, __doc__ or "", 16)
