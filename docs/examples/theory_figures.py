"""Draws the worked examples of the theory pages: `python docs/examples/theory_figures.py docs/images`.

Every figure is of a shipped bag or of a simulation with a seed, so that it is the same each time. Printed is what the
pages say of them.
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import valve_sim as vs
from valve_sim.identification.monitoring.cusum import SCORE_LIMIT, threshold_for
from valve_sim.model.core import layout
from valve_sim.model.drives import step
from valve_sim.model.live import Live
from valve_sim.model.simulation import TOLERANCE
from valve_sim.recordings import read_trace
from valve_sim.recordings.synthetic import Sensor, record

BAGS, CONFIG = (Path(__file__).parents[2] / name for name in ("bags", "config"))
BLUE, ORANGE, GREY = "#0b6fa4", "#d9730d", "#8a8f98"


def model() -> Figure:
    """Openings with and without effects."""
    valve, times = vs.default_valve(), np.arange(0.0, 0.016, 1e-5)
    figure = Figure(figsize=(8, 3.2), layout="constrained")
    axes = figure.subplots()
    effects = {
        "as declared": {},
        "Coulomb friction of 0.3 N": {"coulomb_friction": {"force": 0.3}},
        "stop that bounces, 0.3": {"stop_bounce": {"restitution_stop": 0.3, "restitution_seat": 0.0}},
    }
    for (words, added), style in zip(effects.items(), ("-", "--", ":"), strict=True):
        changed = vs.Valve.from_mapping({**valve.to_mapping(), "effects": added}, words)
        run = vs.simulate(changed, step(9.0), times)
        axes.plot(1e3 * run.time, 1e6 * run.pilot_position, style, label=words)
        print(words, *(f"{event.kind.name.lower()} {1e3 * event.time:.3f} ms" for event in run.events[:6]), sep="; ")
    for name, level in (("gap", valve.parameters.pilot_gap), ("stroke", valve.parameters.stroke)):
        axes.axhline(1e6 * level, color=GREY, linewidth=0.7, linestyle=":")
        axes.text(0.1, 1e6 * level, name, va="bottom", color=GREY)
    axes.set(xlabel="time since 9 V, ms", ylabel="pilot plunger, µm")
    axes.legend(frameon=False, loc="lower right")
    return figure


def estimation(lacking: vs.Identification, sound: vs.Identification) -> Figure:
    """Residuals of a fit that lacks an effect and of one that lacks nothing."""
    figure = Figure(figsize=(8, 4.4), layout="constrained")
    for axes, found, words in zip(
        figure.subplots(2, 1), (sound, lacking), ("bags/eight_strokes.mcap", "bags/friction"), strict=True
    ):
        left = found.residual()
        axes.axhspan(-2e6 * left.sigma, 2e6 * left.sigma, color=GREY, alpha=0.3)
        axes.plot(1e3 * left.times, 1e6 * left.values, color=BLUE, linewidth=0.6)
        axes.set(ylabel="residual, µm", title=f"{words}: {1e6 * left.rms:.2f} µm rms", ylim=(-8, 8))
        print(words, f"{1e6 * left.rms:.3f} µm rms, noise {1e6 * left.sigma:.3f} µm", found)
    axes.set_xlabel("time, ms")
    return figure


def tolerances(lacking: vs.Identification, named: vs.Diagnosis) -> Figure:
    """Declared values in tolerances, where friction is not known and where it is."""
    figure = Figure(figsize=(8, 3.4), layout="constrained")
    axes = figure.subplots()
    axes.axhspan(-3.0, 3.0, color=GREY, alpha=0.25, label="3 tolerances")
    for found, words, colour, shift in (
        (lacking.declared, "without friction", ORANGE, -0.12),
        (named.declared, "with the friction that the diagnosis names", BLUE, 0.12),
    ):
        places = np.arange(len(found)) + shift
        axes.errorbar(
            places, [own.deviation for own in found], [own.spread for own in found], fmt="o", color=colour, label=words
        )
        print(words, *(f"{own.name} {own.deviation:.1f}" for own in found), sep="; ")
    axes.set_xticks(range(len(named.declared)), [own.name for own in named.declared], rotation=45, ha="right")
    axes.set_ylabel("estimate less declared,\ntolerances")
    axes.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure


def recording() -> Figure:
    """Hum and drift that were put into a recording, and what a fit finds of them."""
    random = np.random.default_rng(1)
    starts = np.arange(8) * 0.06 + 0.005
    volts = np.tile([9.0, 12.0, 7.5, 14.0], 2)
    drive = vs.Drive.of(np.ravel([starts, starts + 0.03], "F"), np.ravel([volts, np.zeros(8)], "F"))
    trace = record(vs.default_valve(), drive, 0.485, 10e3, Sensor(position_noise=1e-6, seed=1)).trace
    knots = np.concatenate([[0.0], np.cumsum(random.normal(0.0, 1.5e-6, 16))])
    drift = np.interp(trace.times, np.linspace(0.0, trace.times[-1], 17), knots)
    hum = 1.2e-6 * np.sin(2.0 * np.pi * 50.0 * trace.times + 0.4)
    found = vs.identify(replace(trace, pilot_position=trace.pilot_position + drift + hum))
    fit = found.fit
    print(*(f"{own.title} {1e6 * own.size:.2f} ± {1e6 * own.stderr:.2f} µm, {own.probability:.2f}"
            for own in next(iter(found.recording.values())) if own.unit == "m"), sep="; ")  # fmt: skip
    print(found)
    shown = fit.added[0]
    figure = Figure(figsize=(8, 3.2), layout="constrained")
    axes = figure.subplots()
    axes.plot(1e3 * trace.times, 1e6 * (drift + hum), color=GREY, linewidth=2.4, label="put in")
    axes.plot(1e3 * trace.times, 1e6 * shown, color=BLUE, linewidth=1.0, label="found")
    axes.set(xlabel="time, ms", ylabel="error of the sensor, µm")
    axes.legend(frameon=False)
    return figure


def monitoring() -> Figure:
    """A score that changes by two standard deviations, and its cumulative sum."""
    random, changed, strokes = np.random.default_rng(4), 25, 60
    scores = random.standard_normal(strokes) + np.where(np.arange(strokes) >= changed, 2.0, 0.0)
    sums, reference = 60, 1.0 + 2.0 / math.sqrt(20.0)
    threshold = threshold_for(sums * 10_000, 1.0)
    total, course, alarm = 0.0, [], None
    for stroke, score in enumerate(scores):
        total = max(0.0, total + min(score, SCORE_LIMIT) - reference)
        course.append(total)
        if alarm is None and total > threshold:
            alarm = stroke
    print(f"threshold {threshold:.2f}, change at {changed}, alarm at {alarm}")
    figure = Figure(figsize=(8, 3.8), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    above.plot(scores, "o", color=BLUE, markersize=4)
    above.axvline(changed - 0.5, color=GREY, linestyle=":")
    above.set_ylabel("score z")
    below.step(range(strokes), course, where="post", color=ORANGE)
    below.axhline(threshold, color=GREY, linestyle="--")
    below.axvline(changed - 0.5, color=GREY, linestyle=":")
    below.set(xlabel="stroke", ylabel="sum G")
    below.text(0, threshold, "threshold H", va="bottom", color=GREY)
    return figure


def core() -> Figure:
    """The steps of one opening, and how far each one reaches."""
    figure = Figure(figsize=(8, 3.8), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    valve, times = vs.default_valve(), np.arange(0.0, 0.0101, 1e-5)
    above.plot(1e3 * times, 1e6 * vs.simulate(valve, step(9.0), times).pilot_position, color=BLUE)
    live = Live.at_rest(valve, 0.0, TOLERANCE)
    live.command(9.0)
    ends, places = [0.0], [0.0]
    for time in np.arange(0.0, 0.0101, 2e-6):
        live.advance(time)
        if live.reached > ends[-1]:
            ends.append(live.reached)
            places.append(live.block[layout.X])
    above.plot(1e3 * np.array(ends), 1e6 * np.array(places), "o", color=ORANGE, markersize=5, label="ends of steps")
    below.stairs(np.diff(ends) * 1e3, 1e3 * np.array(ends), color=ORANGE)
    above.set_ylabel("pilot plunger, µm")
    above.legend(frameon=False)
    below.set(xlabel="time since 9 V, ms", ylabel="step, ms", ylim=(0.0, None))
    print(f"{len(ends) - 1} steps end at", *(f"{1e3 * end:.3f}" for end in ends[1:]), "ms")
    return figure


def gas() -> Figure:
    """An opening at 35 MPa: the pressures become equal, then the main plunger lifts."""
    valve, times = vs.load_valve(CONFIG / "hydrogen_35mpa.yaml"), np.arange(0.0, 0.6, 2e-4)
    run = vs.simulate(valve, step(9.0), times)
    figure = Figure(figsize=(8, 3.8), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    above.plot(1e3 * times, 1e-6 * run.outlet_pressure, color=BLUE, label="behind the valve")
    above.axhline(35.0, color=GREY, linestyle=":", label="tank")
    above.set_ylabel("pressure, MPa")
    above.legend(frameon=False)
    below.plot(1e3 * times, 1e6 * run.pilot_position, color=BLUE, label="pilot plunger")
    below.plot(1e3 * times, 1e6 * run.main_position, "--", color=ORANGE, label="main plunger")
    below.set(xlabel="time since 9 V, ms", ylabel="position, µm")
    below.legend(frameon=False)
    print("gas", *(f"{event.kind.name.lower()} {1e3 * event.time:.1f} ms" for event in run.events), sep="; ")
    return figure


def coil_alone() -> Figure:
    """The current of an opening, and that of a valve that is stuck: the dip shows the motion."""
    valve, times = vs.load_valve(CONFIG / "energy_consistent.yaml"), np.arange(0.0, 0.016, 1e-5)
    run = vs.simulate(valve, step(9.0), times)
    stuck = vs.simulate(valve.with_values(seat_load=100.0), step(9.0), times)
    figure = Figure(figsize=(8, 3.8), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 3))
    above.plot(1e3 * run.time, 1e6 * run.pilot_position, color=BLUE)
    above.set_ylabel("pilot plunger,\nµm")
    below.plot(1e3 * run.time, run.coil_current, color=BLUE, label="the valve opens")
    below.plot(1e3 * stuck.time, stuck.coil_current, "--", color=GREY, label="the valve is stuck")
    below.set(xlabel="time since 9 V, ms", ylabel="current, A")
    below.legend(frameon=False, loc="lower right")
    for event in run.events[1:3]:
        for axes in (above, below):
            axes.axvline(1e3 * event.time, color=GREY, linewidth=0.7, linestyle=":")
    dip = stuck.coil_current - run.coil_current
    print(f"coil alone; largest dip {dip.max():.3f} A at {1e3 * times[np.argmax(dip)]:.2f} ms",
          *(f"{event.kind.name.lower()} {1e3 * event.time:.3f} ms" for event in run.events), sep="; ")  # fmt: skip
    return figure


def main(folder: Path) -> None:
    """Draw all."""
    friction = read_trace(BAGS / "friction")
    lacking, named = vs.identify(friction), vs.diagnose(friction)
    sound = vs.identify(read_trace(BAGS / "eight_strokes.mcap"))
    for name, figure in {
        "model_openings": model(),
        "estimation_residuals": estimation(lacking, sound),
        "tolerances_friction": tolerances(lacking, named),
        "recording_errors": recording(),
        "monitoring_sum": monitoring(),
        "core_steps": core(),
        "gas_opening": gas(),
        "coil_current_dip": coil_alone(),
    }.items():
        for axes in figure.axes:
            axes.spines[["top", "right"]].set_visible(False)
        figure.savefig(folder / f"{name}.png", dpi=110)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
