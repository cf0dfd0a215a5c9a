"""Valves of which the coil's current is measured, and no position; by test/plants/coil_alone.py.

Every declared number is off as its tolerance allows; the coil has 6 to 12 Ω, is shorted or clamped at release, its
supply droops; current is sampled at 10 or 20 kHz with 1 to 5 mA of noise, some samples are lost, and the voltage is
measured in every second case. Held-out strokes are judged by the true positions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from plants import coil_alone, tolerances

from benchmarks.campaign.bench import Bench, Measured
from valve_sim.identification.diagnosis.followed_positions import followed_positions
from valve_sim.identification.diagnosis.run import Diagnosis, diagnose
from valve_sim.identification.fit.result import Fit
from valve_sim.model import Drive, Valve, published_times, simulate
from valve_sim.recordings import Signal, Trace

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
PERIOD, ON = 0.070, 0.035
"""s."""
VOLTAGE_NOISE: Final = 5e-3
"""V."""
POSITION_NOISE: Final = 1e-6
"""m, where positions are measured in place of the current."""
WANTED: Final[Measured] = {
    "position, µm rms": 10.0,
    "position while opening, µm rms": 3.0,
    "t1, µs": 40.0,
    "t2, µs": 15.0,
}
"""What figures may be at most, without their sign."""


class _Strokes(NamedTuple):
    """A recording, and the positions that nobody measured, m."""

    trace: Trace
    position: np.ndarray

    @property
    def moves(self) -> np.ndarray:
        """Whether the plunger truly moves faster than 1 cm/s, by sample."""
        speed: np.ndarray = np.abs(np.gradient(self.position, self.trace.sample_times))
        return speed > 1e-2

    def by_position(self, random: np.random.Generator) -> _Strokes:
        """With the positions measured, and without the current."""
        shown = self.position + POSITION_NOISE * random.standard_normal(len(self.position))
        times = self.trace.sample_times
        return self._replace(trace=replace(self.trace, times=times, pilot_position=shown, coil_current=None))


def bench(seed: int, missing: str, *, by_position: bool = False) -> Bench:
    """A valve whose file lacks one of `EFFECTS` or, where `missing` is empty, nothing."""
    random = np.random.default_rng([seed, 18])
    build, mapping = _drawn(random, seed, missing)
    noise, rate = float(random.uniform(1e-3, 5e-3)), float(random.choice([10e3, 20e3]))
    has_voltage = seed % 2 == 0
    parts = [_recorded(build, levels, noise, rate, random, has_voltage=has_voltage) for levels in (LEVELS, HELD_OUT)]
    if by_position:
        sensor = np.random.default_rng([seed, 19])
        parts = [part.by_position(sensor) for part in parts]
    opening = coil_alone.simulate(
        build._replace(supply_resistance=0.0), np.array([0.0]), np.array([9.0]), np.array([0.04])
    )
    true_times = float(opening.reached_gap[0]), float(opening.reached_stop[0])
    words = f"{build.resistance:.1f} Ω, {'clamp' if build.clamp_voltage else 'short'}, {1e3 * noise:.1f} mA"
    return Bench(
        f"{words}, {1e-3 * rate:g} kHz, {'voltage' if has_voltage else 'no voltage'}",
        lambda: diagnose([parts[0].trace], [parts[1].trace], Valve.from_mapping(mapping, f"case {seed}")),
        lambda found: _judged(found, parts, true_times),
    )


def _drawn(random: np.random.Generator, seed: int, missing: str) -> tuple[coil_alone.Build, dict[str, Any]]:
    """What is built, and what its file says."""
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
    if seed % 2:
        build = build._replace(supply_resistance=0.0)  # only a measured voltage shows a droop
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
    known: dict[str, Any] = tolerances.declared_tolerances(SHEET)
    if "eddy_lag" in effects:
        # Known as well as the coil's time constant is, for L/R_e is declared and L is off.
        share = tolerances.SHARES["coil_time_constant"]
        known["effects"] = {"eddy_lag": {"time_constant": share * effects["eddy_lag"]["time_constant"]}}
    valve = {**SHEET, "coil_resistance": resistance, "release_voltage": release}
    return build, {"valve": valve, "effects": effects, "tolerances": known}


def _recorded(
    build: coil_alone.Build, levels: Sequence[float], noise: float, rate: float, random: Any, *, has_voltage: bool
) -> _Strokes:
    starts = 0.010 + PERIOD * np.arange(len(levels))
    drive = Drive(
        np.column_stack([starts, starts + ON]).ravel(), np.column_stack([levels, np.zeros(len(levels))]).ravel()
    )
    times = np.arange(round((0.010 + PERIOD * len(levels)) * rate)) / rate + 0.37 / rate
    times = times[random.uniform(size=len(times)) > random.choice([0.0, 0.01])]
    shown = coil_alone.simulate(build, drive.times, drive.volts, times)
    current = shown.current + noise * random.standard_normal(len(times))
    voltage = shown.voltage + VOLTAGE_NOISE * random.standard_normal(len(times))
    trace = Trace(
        "coil alone", drive, times[:0], times[:0], coil_current=Signal(times, current),
        coil_voltage=Signal(times, voltage) if has_voltage else None,
    )  # fmt: skip
    return _Strokes(trace, shown.position)


def _judged(found: Diagnosis, parts: Sequence[_Strokes], true_times: tuple[float, float]) -> Measured:
    """The corrected valve by the true positions of the held-out strokes, and by its published times."""
    fitted, held_out = parts
    error = _positions(found.after.holdout)[0] - held_out.position
    position, stderr = _positions(found.after.fit, [(rival.fit, rival.weight) for rival in found.rivals])
    opens = held_out.moves & (held_out.trace.drive.at(held_out.trace.sample_times) > 0.0)
    is_within = np.abs(position - fitted.position)[fitted.moves] < 1.96 * stderr[fitted.moves]
    t1, t2 = published_times(simulate(found.valve, Drive.of([0.0], [9.0]), [0.0, 0.04]))
    return {
        "position, µm rms": 1e6 * _rms(error),
        "position while opening, µm rms": 1e6 * _rms(error[opens]),
        "in 95 % bands": float(np.mean(is_within)) if np.all(np.isfinite(stderr)) else np.nan,
        "t1, µs": 1e6 * (t1 - true_times[0]),
        "t2, µs": 1e6 * (t2 - true_times[1]),
    }


def _rms(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean(error**2)))


def _positions(found: Fit | None, rivals: Sequence[tuple[Fit, float]] = ()) -> tuple[np.ndarray, np.ndarray]:
    """The model's positions, and their standard errors (nan where positions were measured)."""
    assert found is not None
    if followed := followed_positions(found, rivals):
        return followed[0].position, followed[0].stderr
    position = found.problem.plant.predict(found.values)[0]
    return position, np.full(len(position), np.nan)
