"""A monitor beside the independent valve with gas: what its strokes hold, and what follows from them."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pytest
from model.gas.cases import gas_valve, independent

from identification.freed import fit
from identification.live_strokes import hand_over
from valve_sim.identification.fit.intervals import Interval, covariance_interval
from valve_sim.identification.fit.noise import Noise
from valve_sim.identification.fit.problem import Problem
from valve_sim.identification.fit.result import Fit
from valve_sim.identification.monitoring.command_timing import UNINFORMATIVE, StrokeTiming
from valve_sim.identification.monitoring.commissioning import Commissioning, ScoreBaseline
from valve_sim.identification.monitoring.fault_isolation import join
from valve_sim.identification.monitoring.findings import StrokeRecord, StrokeState, Unusable, WaitsForPressure
from valve_sim.identification.monitoring.lift_times import starts_by_lift
from valve_sim.identification.monitoring.scores import SIZE, Baseline
from valve_sim.identification.monitoring.segmenter import StrokeSegmenter
from valve_sim.identification.monitoring.settings import MonitorSettings
from valve_sim.identification.monitoring.stroke_monitor import FEWEST_WITH_GAS, StrokeMonitor
from valve_sim.identification.plants.commissioned import in_service
from valve_sim.identification.plants.protocol import Direction
from valve_sim.recordings import Trace

pytestmark = pytest.mark.long

OPEN_SECONDS, CLOSED_SECONDS, LEAD = 0.1, 0.15, 0.02
"""s: with voltage, without, and of rest before the first command."""
NOISE = 2e-6
"""m."""
VALVE = gas_valve(outlet_volume=1e-6, demand_orifice_diameter=6e-5)
LEVELS = (9.0, 12.0)
"""V."""


class Strokes(NamedTuple):
    """A recording at 2 kHz: commands, s and V; positions, m, at times, s; and the outlet's pressures, Pa."""

    commands: list[tuple[float, float]]
    times: np.ndarray
    positions: np.ndarray
    pressures: np.ndarray


@functools.cache
def recorded(*, healthy: int, faulty: int, leak: float = 0.0, clogging: float = 1.0) -> Strokes:
    """Strokes of the independent plant, with a fault from the first faulty stroke on."""
    plant = independent(VALVE)
    plant.rtol = 1e-7
    period, commands, shown = OPEN_SECONDS + CLOSED_SECONDS, [], []
    for number in range(healthy + faulty):
        if number == healthy:
            plant.leak, plant.clogging = leak, clogging
        start = number * period
        times = start + np.arange(1, round(2e3 * period) + 1) / 2e3
        own = [(start + LEAD, LEVELS[number % len(LEVELS)]), (start + LEAD + OPEN_SECONDS, 0.0)]
        position, pressure, _ = plant.run(own, times)
        shown.append((times, position, pressure))
        commands += own
    times, positions, pressures = (np.concatenate(column) for column in zip(*shown, strict=True))
    return Strokes(commands, times, positions + NOISE * np.random.default_rng(1).standard_normal(len(times)), pressures)


def strokes_of(made: Strokes) -> list[StrokeRecord]:
    """As the segmenter of a valve that is as declared cuts them out."""
    segmenter = StrokeSegmenter(VALVE, MonitorSettings(settle=0.003))
    list(hand_over(segmenter, made.commands, made.times, made.positions))
    return segmenter.take_finished()


def baseline() -> Baseline:
    """Of the valve as declared, with what commissioning would leave open of its dampings."""
    noise = Noise(NOISE, NOISE, (), 0.0, 1000)
    return Baseline(VALVE, 0.0, 50e-6, 50e-6, noise, np.diag([1e-8, 1e-8]))


def sized(strokes: Sequence[Trace], name: str) -> tuple[Interval, Fit]:
    """The size of a fault, as isolation fits it to strokes since it began."""
    known = baseline()
    trace = join(strokes, known)
    plant = in_service(trace, known.commissioned, known.scatter)
    problem = Problem(plant, noises={"position": known.noise})
    start = starts_by_lift(trace, VALVE)[name.partition(".")[0]]
    result = fit(problem, (name,), start, nuisances=plant.nuisances)
    return covariance_interval(result, name), result


def test_derivatives_of_a_commissioned_valve_are_those_of_its_predictions():
    known = baseline()
    plant = in_service(
        join([record.trace for record in strokes_of(recorded(healthy=1, faulty=4, **LEAKING))[2:]], known),
        known.commissioned,
        known.scatter,
    )
    values = {own.name: own.mean for own in plant.nuisances} | {"seat_leak.area": 1e-9, "main_damping.value": 3.0}
    steps = {
        "seat_leak.area": 1e-13, "main_damping.value": 1e-4, "commissioning_error[0]": 1e-6,
        "commissioning_error[1]": 1e-6, "command_error[0,1]": 1e-8, "gas.outlet_pressure": 1.0,
    }  # fmt: skip
    (columns,), known_ones, _ = plant.sensitivities(
        values, [Direction({name: 1.0}, step) for name, step in steps.items()]
    )
    assert known_ones.all()
    for column, (name, step) in zip(columns.T, steps.items(), strict=True):
        there, back = (plant.predict({**values, name: values[name] + way * step})[0] for way in (1.0, -1.0))
        assert np.linalg.norm(column - (there - back) / (2.0 * step)) < 0.03 * np.linalg.norm(column), name
    # A damping at its lower bound does not follow an error that would take it below.
    at_bound = {**values, "pilot_damping.value": 0.0, "commissioning_error[0]": -1.0}
    (columns,), *_ = plant.sensitivities(at_bound, [Direction({"pilot_damping.value": 1.0}, 1e-6)])
    assert not columns.any()


def lift_of(times: np.ndarray, positions: np.ndarray, start: float) -> float:
    """When the main plunger is half open, s."""
    level = 0.5 * (VALVE.parameters.pilot_gap + VALVE.parameters.stroke)
    return float(times[np.argmax((times > start) & (positions > level))])


LEAKING, CLOGGED = {"leak": 1.5e-9}, {"clogging": 0.7}


@pytest.mark.parametrize("fault", [LEAKING, CLOGGED])
def test_a_stroke_holds_the_lift_of_the_main_plunger_while_its_model_waits_for_the_pressure(fault):
    made = recorded(healthy=1, faulty=4, **fault)
    record = strokes_of(made)[2]
    lift = lift_of(made.times, made.positions, record.time)
    kept = record.trace.times + record.trace.epoch_ns / 1e9
    positions = record.trace.pilot_position
    # The samples about the lift itself are there: the plunger travels for some milliseconds.
    assert np.count_nonzero(np.abs(kept - lift) < 3e-3) >= 10
    assert lift_of(kept, positions, record.time) == pytest.approx(lift, abs=1e-6)


@pytest.mark.parametrize(
    ("name", "truth", "fault"),
    [("seat_leak.area", 1.5e-9, LEAKING), ("pilot_clogging.ratio", 0.7, CLOGGED)],
)
def test_the_size_of_a_fault_of_gas_follows_from_the_times_at_which_the_main_plunger_lifts(name, truth, fault):
    made = recorded(healthy=1, faulty=4, **fault)
    # The fault began somewhere in the second stroke; with three of those after it the trace begins under it.
    strokes = [record.trace for record in strokes_of(made)[2:]]
    start = starts_by_lift(join(strokes, baseline()), VALVE)[name.partition(".")[0]]
    assert start[name] == pytest.approx(truth, rel=0.02)
    found, result = sized(strokes, name)
    assert result.chi2 < 1.2 * result.problem.effective_samples
    assert abs(found.value - truth) < 4.0 * found.stderr
    assert found.stderr < 0.01 * truth
    began = float(np.interp(strokes[0].epoch_ns / 1e9, made.times, made.pressures))
    assert result.values["gas.outlet_pressure"] == pytest.approx(began, rel=0.01)


def watching() -> StrokeMonitor:
    """A monitor that was commissioned on the valve as declared."""
    monitor = StrokeMonitor(VALVE, MonitorSettings())
    scores = {name: ScoreBaseline(0.0, 1.0, 8, is_learned=False) for name in (SIZE, "pilot_clogging", "seat_leak")}
    levels = {level: scores for level in (50e-6, 100e-6, UNINFORMATIVE)}
    monitor.use(Commissioning(baseline(), levels, tuple(StrokeTiming(9.0, (0.0, 0.0), np.nan) for _ in range(8))))
    return monitor


def test_a_clogged_valve_that_waits_in_vain_is_said_to_wait_and_is_isolated_from_these_strokes():
    made = recorded(healthy=1, faulty=8, clogging=0.3)
    monitor, reports = watching(), []
    for record in strokes_of(made):
        reports.append(monitor.assess(record, refit=False))
    in_vain = [report for report in reports if report.record.fault is not None]
    assert len(in_vain) >= 4
    assert all(isinstance(report.record.fault, WaitsForPressure) for report in in_vain)
    assert in_vain[0].record.fault.travel == pytest.approx(VALVE.parameters.pilot_gap, abs=5.0 * NOISE)
    assert all(report.state is StrokeState.WATCHING for report in in_vain)
    assert monitor.alarm is not None
    evidence = monitor.take_evidence()
    assert len(evidence) >= FEWEST_WITH_GAS
    # None from before the fault, nor the one in which it began.
    assert evidence[0].source == "stroke 2"
    # No stroke lifts the main plunger; the pressure difference that is left when the voltage ends is all that tells.
    found, _ = sized(evidence, "pilot_clogging.ratio")
    assert abs(found.value - 0.3) < 4.0 * found.stderr
    assert found.stderr < 0.05


def test_commands_of_strokes_that_could_not_be_compared_are_known_to_those_after_them():
    records = strokes_of(recorded(healthy=1, faulty=4, **CLOGGED))
    unusable = records[3]._replace(remark=Unusable.TOO_FEW_SAMPLES)
    monitor = watching()
    for record in (*records[:3], unusable, records[4]):
        monitor.assess(record, refit=False)
    (*_, before, last) = monitor.evidence()
    drive = join([before, last], baseline()).drive
    expected = [volts for record in (records[2], unusable, records[4]) for volts in record.trace.drive.volts]
    assert drive.volts.tolist() == expected
    times = before.epoch_ns / 1e9 + drive.times
    assert times.tolist() == pytest.approx([time for time, _ in recorded(healthy=1, faulty=4, **CLOGGED).commands[4:]])
