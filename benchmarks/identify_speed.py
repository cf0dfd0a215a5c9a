"""How fast `identify` is, and how much faster than scipy: `python -m benchmarks.identify_speed`.

A bag of 0.5 s at 20 kHz (eight strokes, 1 µm noise, 0.1 µm steps, from the independent plant of test/plants) is
identified in new processes, their compile cache warm as after any first run; a long bag is read; and the same fit is
made by scipy: `solve_ivp` (DOP853; RK45 takes as long; the coil's current in closed form, contacts as
events) inside `least_squares`, from the same start on the same whitened residuals. Both fits run in this process, to
the end, and their answers are compared. Exits 1 when short of the wanted ratio. Needs no ROS.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from benchmarks.coverage import as_trace, true_dampings
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.recording_errors import CLOCK_SIGMA
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.model import Drive, ValveParameters
from valve_sim.traces import Trace, read_trace, write_bag

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "test"))
from plants.declared import CAMPAIGN_VALVE, DeclaredPlant
from plants.recording import Recorder, record, train_profile

Array = NDArray[np.float64]

SEED = 3
LONG_BAG = 1_000_000
"""JointStates in the bag whose reading is timed."""
RELATIVE, ABSOLUTE = 1e-8, 1e-11
"""scipy's tolerances: as the package's own while it fits."""
SAME_MODEL = 10e-9
"""m: how far the two simulations may be apart and still be the same model."""
WANTED = {
    "identify, a new process (s)": (3.0, "at most"),
    "of it fitting and intervals (s)": (1.0, "at most"),
    "reading (JointStates/s)": (400_000.0, "at least"),
    "scipy over this package, one fit": (100.0, "at least"),
}
IN_A_NEW_PROCESS = """
import json, sys, time
from valve_sim.identification.diagnosis.identify import identify
from valve_sim.files.parameter_files import default_valve
from valve_sim.traces import read_trace
trace = read_trace(sys.argv[1])
started = time.perf_counter()
identify([trace], default_valve().exact())
print(json.dumps(time.perf_counter() - started))
"""


# --- the same model by solve_ivp --------------------------------------------------------------------------------------


class Stretch(NamedTuple):
    """Constant voltage: from `start` to `stop`, s; u goes from `current` to `target`."""

    start: float
    stop: float
    current: float
    target: float


class Motion(NamedTuple):
    """Where a stretch was left: time s, position m, velocity m/s, and which equation holds."""

    time: float
    position: float
    velocity: float
    mode: str


def simulate_by_scipy(parameters: ValveParameters, drive: Drive, times: Array) -> Array:
    """Pilot position at ascending `times`, m, by eqs. (1) to (15) of the theory.

    Left out, because these strokes have neither: a contact at the pilot gap slower than 1 mm/s, and seat load.
    """
    shown = np.zeros(len(times))
    motion, current = Motion(0.0, 0.0, 0.0, "closed"), 0.0
    edges = [*drive.times.tolist(), float(times[-1]) + 1e-6]
    for start, stop, volts in zip(edges[:-1], edges[1:], drive.volts.tolist(), strict=True):
        stretch = Stretch(start, stop, current, volts / parameters.reference_voltage)
        motion = motion._replace(time=start)
        while motion.time < stop:
            if motion.mode == "closed":  # without seat load the least current lifts the pilot
                motion = motion._replace(mode="pilot")
            elif motion.mode == "open":
                motion = _rest_on_stop(parameters, stretch, motion, times, shown)
            else:
                motion = _move(parameters, stretch, motion, times, shown)
        current = _current(parameters, stretch, stop)
    return shown


def _rest_on_stop(parameters: ValveParameters, stretch: Stretch, motion: Motion, times: Array, shown: Array) -> Motion:
    """At rest until the pull has fallen to what the spring pushes, which has a closed form."""
    push = parameters.spring_preload + parameters.spring_rate * parameters.stroke
    least = math.sqrt(push / float(np.polynomial.polynomial.polyval(motion.position, parameters.attraction_polynomial)))
    left = math.inf
    if stretch.target < least:
        share = (_current(parameters, stretch, motion.time) - stretch.target) / (least - stretch.target)
        left = motion.time + parameters.coil_time_constant * max(0.0, math.log(share))
    until, mode = (left, "main") if left < stretch.stop else (stretch.stop, "open")
    first, last = np.searchsorted(times, [motion.time, until])
    shown[first:last] = motion.position
    return Motion(until, motion.position, 0.0, mode)


def _move(parameters: ValveParameters, stretch: Stretch, motion: Motion, times: Array, shown: Array) -> Motion:
    """To the next contact, or to the end of the stretch."""
    is_main = motion.mode == "main"
    low, high = (parameters.pilot_gap, parameters.stroke) if is_main else (0.0, parameters.pilot_gap)
    first, last = np.searchsorted(times, [motion.time, stretch.stop])
    found = solve_ivp(
        _equation(parameters, stretch, is_main),
        (motion.time, stretch.stop),
        (motion.position, motion.velocity),
        method="DOP853",
        t_eval=np.append(times[first:last], stretch.stop),
        events=[_contact(low, -1.0), _contact(high, 1.0)],
        rtol=RELATIVE,
        atol=ABSOLUTE,
    )
    count = min(len(found.t), last - first)
    shown[first : first + count] = found.y[0, :count]
    if found.status == 0:
        return Motion(stretch.stop, float(found.y[0, -1]), float(found.y[1, -1]), motion.mode)
    went_up = len(found.t_events[1]) > 0
    time_of, velocity = float(found.t_events[went_up][0]), float(found.y_events[went_up][0][1])
    if is_main:
        return Motion(time_of, high, 0.0, "open") if went_up else Motion(time_of, low, velocity, "pilot")
    if went_up:
        return Motion(time_of, high, parameters.pickup_velocity_ratio * velocity, "main")
    return Motion(time_of, low, 0.0, "closed")


def _current(parameters: ValveParameters, stretch: Stretch, at: float) -> float:
    decay = math.exp(-(at - stretch.start) / parameters.coil_time_constant)
    return stretch.target + (stretch.current - stretch.target) * decay


def _equation(
    parameters: ValveParameters, stretch: Stretch, is_main: bool
) -> Callable[[float, Array], tuple[float, float]]:
    a0, a1, a2, a3 = parameters.attraction_polynomial
    mass = parameters.moving_mass if is_main else parameters.pilot_mass
    damping = parameters.main_damping if is_main else parameters.pilot_damping
    rate, load = (parameters.spring_rate, parameters.spring_preload) if is_main else (0.0, parameters.seat_load)

    def derivative(time: float, state: Array) -> tuple[float, float]:
        x, v = state.tolist()
        u = _current(parameters, stretch, time)
        pull = u * u * (a0 + x * (a1 + x * (a2 + x * a3)))
        return v, (pull - load - rate * x - damping * v) / mass

    return derivative


def _contact(position: float, direction: float) -> Callable[[float, Array], float]:
    def guard(time: float, state: Array) -> float:
        return float(state[0]) - position

    guard.terminal, guard.direction = True, direction  # type: ignore[attr-defined]
    return guard


# --- the two fits -----------------------------------------------------------------------------------------------------


def fit_by_scipy(problem: Problem, trace: Trace, parameters: ValveParameters, scale: Array) -> Array:
    """SciPy's least squares on whitened residuals and the prior of the clock offset, from our start.

    Args:
        problem: for its noise.
        trace: the data.
        parameters: the declared valve.
        scale: (3,) standard errors, so that the search is well scaled.

    Returns:
        (3,) both dampings and the clock offset.
    """

    def residuals(at: Array) -> Array:
        valve = parameters._replace(pilot_damping=float(at[0]), main_damping=float(at[1]))
        shown = simulate_by_scipy(valve, trace.drive, trace.times - at[2])
        return np.append(problem.noise_of(0).whiten(trace.pilot_position - shown), at[2] / CLOCK_SIGMA)

    start = np.array([parameters.pilot_damping, parameters.main_damping, 0.0])
    bounds = (np.array([0.0, 0.0, -20.0 * CLOCK_SIGMA]), np.array([np.inf, np.inf, 20.0 * CLOCK_SIGMA]))
    found = least_squares(residuals, start, bounds=bounds, x_scale=scale, diff_step=1e-4, xtol=1e-6, ftol=1e-6)
    return np.asarray(found.x)


def compare_fits(trace: Trace) -> float:
    """How many times longer scipy takes for the same fit, from the same start.

    Raises:
        AssertionError: the two are not the same model, or find different values.
    """
    valve = default_valve().exact()
    plant = ValvePlant([trace], valve)
    problem = Problem(plant)
    apart = np.abs(simulate_by_scipy(valve.parameters, trace.drive, trace.times) - plant.predict({})[0]).max()
    assert apart < SAME_MODEL, f"the simulations are {apart:.1e} m apart"
    fits: list[Fit] = []
    ours = _shortest(lambda: fits.append(fit(problem, plant.base, {}, nuisances=plant.nuisances)), 7)
    error = np.sqrt(np.diag(fits[-1].covariance))
    found: list[Array] = []
    theirs = _shortest(lambda: found.append(fit_by_scipy(problem, trace, valve.parameters, error)), 3)
    differences = (found[-1] - np.array(list(fits[-1].values.values()))) / error
    assert np.all(np.abs(differences) < 0.1), f"the fits differ by {differences} standard errors"
    print(
        f"one fit: {1e3 * ours:.1f} ms; by scipy {1e3 * theirs:.0f} ms, {np.abs(differences).max():.3f} std. errors off"
    )
    return theirs / ours


# --- what a user waits for --------------------------------------------------------------------------------------------


def new_processes(bag: Path, folder: Path) -> tuple[float, float]:
    """Seconds of `valve-sim identify` in a new process, and of the fit with its intervals in one; medians of 3."""
    command = [sys.executable, "-m", "valve_sim", "identify", str(bag), "--output", str(folder)]
    fitting = [sys.executable, "-c", IN_A_NEW_PROCESS, str(bag)]
    subprocess.run(command, check=True, capture_output=True)  # fills the compile cache, if nobody has
    whole, part = [], []
    for _ in range(3):
        started = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True)
        whole.append(time.perf_counter() - started)
        part.append(float(json.loads(subprocess.run(fitting, check=True, capture_output=True).stdout)))
    return statistics.median(whole), statistics.median(part)


def reading_rate(trace: Trace, folder: Path) -> float:
    """JointStates a second, from file to checked arrays, of a bag that repeats the trace's samples."""
    samples = np.resize(trace.pilot_position, LONG_BAG)
    times = np.arange(LONG_BAG) / 20e3
    path = folder / "long.mcap"
    write_bag(path, dataclasses.replace(trace, times=times, pilot_position=samples, main_position=samples))
    return LONG_BAG / _shortest(lambda: read_trace(path), 3)


def _shortest(action: Callable[[], object], times: int) -> float:
    """The least time that a call took, s: what a neighbour on the machine adds is not the code's."""
    taken = []
    for _ in range(times):
        started = time.perf_counter()
        action()
        taken.append(time.perf_counter() - started)
    return min(taken)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; 1 if it is short of what is wanted."""
    argparse.ArgumentParser(prog="python -m benchmarks.identify_speed", description=__doc__).parse_args(arguments)
    plant = DeclaredPlant(parameters={**CAMPAIGN_VALVE, **true_dampings(SEED)})
    trace = as_trace(record(plant, train_profile(), Recorder(quantisation=0.1e-6), SEED), f"seed {SEED}")
    with tempfile.TemporaryDirectory(prefix="valve_sim-") as folder:
        bag = Path(folder) / "strokes.mcap"
        write_bag(bag, trace)
        whole, part = new_processes(bag, Path(folder) / "identified")
        measured = dict(zip(WANTED, (whole, part, reading_rate(trace, Path(folder)), compare_fits(trace)), strict=True))
    is_good = True
    for name, value in measured.items():
        wanted, sense = WANTED[name]
        is_met = value <= wanted if sense == "at most" else value >= wanted
        is_good = is_good and is_met
        print(f"{name:<36}{value:>12,.4g}   wanted: {sense} {wanted:,.6g}   {'good' if is_met else 'SHORT'}")
    return 0 if is_good else 1


if __name__ == "__main__":
    raise SystemExit(main())
