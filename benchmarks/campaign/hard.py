"""Fifty recordings that are hard on a search: how each is made, and which verdicts on it are right.

Noise-free, coarse, jittered, with rests of seconds, of one opening, with a force without a name, in several bags; half
by the independent plant, half by this package's own simulator through a bag. A fault is an error that is larger after
the diagnosis than before, fitted or held out, work beyond the budget by more than a tenth, or a wrong kind of verdict.
"""

from __future__ import annotations

import itertools
import math
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from plants.declared import CAMPAIGN_VALVE, DeclaredPlant
from plants.recording import LEVELS, Profile, Recorder, single_opening, train_profile
from plants.recording import record as measured

from benchmarks.campaign.bench import Bench, Measured
from benchmarks.campaign.declared import as_trace, declared_valve
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.diagnosis.run import Diagnosis, diagnose
from valve_sim.identification.fit.budget import Budget
from valve_sim.model import Drive, Valve
from valve_sim.recordings import Trace, read_trace, write_bag
from valve_sim.recordings.synthetic import Sensor, record

CAMPAIGN: Final = declared_valve(CAMPAIGN_VALVE)

FAULTS: Final = ("larger error, fitted", "larger error, held-out", "beyond its budget", "wrong kind of verdict")
"""What must not be."""
BUDGET: Final = 60.0
"""s of a processor, which stand for the work of a diagnosis."""
OVERSHOOT: Final = 1.1
"""Of the work that is allowed, at most."""
SAME: Final = 1e-9
"""Share by which equal errors differ for rounding."""

Effects = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True)
class Case:
    """One set of recordings of one valve.

    Attributes:
        kind: of difficulty. seed: of everything drawn. make: the recordings. declared: the valve without the effect.
        allowed: kinds of verdict that are right; the others are wrong. effects: what the file does not say.
    """

    kind: str
    seed: int
    make: Callable[[int], list[Trace]]
    declared: Valve
    allowed: tuple[str, ...]
    effects: Effects

    def bench(self) -> Bench:
        """Its recordings, for the campaign."""
        traces, budget = self.make(self.seed), Budget.of_seconds(BUDGET)
        return Bench(
            f"{self.kind} {self.seed}", lambda: diagnose(traces, [], self.declared, budget=budget), self.faults
        )

    def faults(self, found: Diagnosis) -> Measured:
        """What must not be; 1 for each that is."""
        is_so = (
            _has_risen(found.before.train_rmse, found.after.train_rmse),
            _has_risen(found.before.holdout_rmse, found.after.holdout_rmse),
            found.work > OVERSHOOT * found.allowed,
            found.verdict.kind not in self.allowed,
        )
        return {name: float(one) for name, one in zip(FAULTS, is_so, strict=True)}


def _has_risen(before: float, after: float) -> bool:
    return after > before * (1.0 + SAME) or math.isnan(after) != math.isnan(before)


def cases() -> list[Case]:
    """All fifty, in the order of the table."""
    clear, named = ("none",), ("effects", "unknown", "insufficient")
    friction = {"coulomb_friction": {"force": 0.2}}
    ripple = {"force_ripple": {"amplitude": 0.1, "wavelength": 0.2e-3, "phase": 1.0}}
    drift = {"damping_drift": {"rate": 4.0}}
    ours, theirs, declared = _simulated, _measured, default_valve().exact()
    exact, coarse = Recorder(position_noise=0.0), Recorder(quantisation=5e-6)
    plans: list[tuple[str, int, Callable[[int], list[Trace]], Valve, tuple[str, ...], Effects]] = [
        ("noise-free, own", 10, ours(Sensor()), declared, clear, {}),
        ("noise-free, plant", 6, theirs(exact), CAMPAIGN, clear, {}),
        ("noise-free, plant, with current", 2, theirs(_with_current(exact)), CAMPAIGN, clear, {}),
        ("noise-free, long rests", 2, ours(Sensor(), _long_rests), declared, clear, {}),
        ("noise-free, friction", 2, ours(Sensor(), effects=friction), declared, ("effects",), friction),
        (
            "noise-free, friction, long rests", 2, ours(Sensor(), _long_rests, friction), declared, ("effects",),
            friction,
        ),
        (
            "noise-free, long rests, late stamps", 2, _late(ours(Sensor(), _long_rests, friction)), declared, named,
            friction,
        ),
        ("coarse, no noise", 3, theirs(Recorder(position_noise=0.0, quantisation=1e-6)), CAMPAIGN, clear, {}),
        ("coarse", 3, theirs(coarse), CAMPAIGN, clear, {}),
        ("coarse, friction", 2, theirs(coarse, friction), CAMPAIGN, named, friction),
        ("jittered", 3, theirs(Recorder(command_jitter=50e-6)), CAMPAIGN, clear, {}),
        ("jittered, friction", 2, theirs(Recorder(command_jitter=200e-6), friction), CAMPAIGN, named, friction),
        (
            "one opening", 2, theirs(Recorder(), friction, single_opening), CAMPAIGN, ("insufficient", "unknown"),
            friction,
        ),
        ("one opening, noise-free", 1, theirs(exact, {}, single_opening), CAMPAIGN, ("insufficient",), {}),
        ("no name: ripple", 3, theirs(Recorder(), ripple), CAMPAIGN, named, ripple),
        ("no name: drift", 2, theirs(_with_current(Recorder()), drift), CAMPAIGN, named, drift),
        ("four bags of two strokes", 3, _in_bags(theirs(Recorder(), friction)), CAMPAIGN, named, friction),
    ]  # fmt: skip
    return [
        Case(kind, seed, make, valve, allowed, effects)
        for kind, count, make, valve, allowed, effects in plans
        for seed in range(1, count + 1)
    ]


def _strokes() -> tuple[Profile, float]:
    return train_profile(), 10e3


def _long_rests() -> tuple[Profile, float]:
    """Eight strokes in 21 s, one second open and more than one closed, at the 1 kHz of a live valve."""
    begins = 2.0 + 2.3 * np.arange(len(LEVELS))
    times = np.column_stack([begins, begins + 1.0]).ravel()
    return Profile(times, np.column_stack([LEVELS, np.zeros(len(LEVELS))]).ravel(), 21.0), 1e3


def _simulated(
    sensor: Sensor, strokes: Callable[[], tuple[Profile, float]] = _strokes, effects: Effects | None = None
) -> Callable[[int], list[Trace]]:
    """By this package, through a bag: dampings are drawn, stamps are whole nanoseconds."""

    def make(seed: int) -> list[Trace]:
        random = np.random.default_rng(seed)
        dampings = {"pilot_damping": random.uniform(0.7, 1.5), "main_damping": random.uniform(2.8, 6.0)}
        valve = Valve(default_valve().with_values(**dampings).parameters, effects or {})
        profile, rate = strokes()
        made = record(valve, Drive(profile.times, profile.volts), profile.duration, rate, sensor)
        with tempfile.TemporaryDirectory() as folder:
            bag = Path(folder) / "made.mcap"
            write_bag(bag, made.trace)
            return [read_trace(bag)]

    return make


def _measured(
    recorder: Recorder, effects: Effects | None = None, profile: Callable[[], Profile] = train_profile
) -> Callable[[int], list[Trace]]:
    """By an independent plant whose dampings are drawn."""

    def make(seed: int) -> list[Trace]:
        random = np.random.default_rng(seed)
        dampings = {"pilot_damping": random.uniform(0.7, 1.5), "main_damping": random.uniform(2.8, 6.0)}
        plant = DeclaredPlant(effects or {}, {**CAMPAIGN_VALVE, **dampings})
        return [as_trace(measured(plant, profile(), recorder, seed), f"seed {seed}")]

    return make


def _with_current(recorder: Recorder) -> Recorder:
    return Recorder(
        recorder.position_noise, with_current=True, current_noise=1e-3 if recorder.position_noise > 0.0 else 0.0
    )


def _late(make: Callable[[int], list[Trace]]) -> Callable[[int], list[Trace]]:
    """Commands that are stamped up to a millisecond before they act, as a live node's are."""

    def made(seed: int) -> list[Trace]:
        (trace,) = make(seed)
        late = np.random.default_rng(seed).uniform(0.0, 1e-3, len(trace.drive.times))
        return [replace(trace, drive=Drive(trace.drive.times - late, trace.drive.volts))]

    return made


def _in_bags(make: Callable[[int], list[Trace]]) -> Callable[[int], list[Trace]]:
    """The strokes of a maker, in bags of two each."""

    def made(seed: int) -> list[Trace]:
        (trace,) = make(seed)
        return list(_parts(trace))

    return made


def _parts(trace: Trace) -> Iterator[Trace]:
    starts = trace.drive.times[trace.drive.volts > 0.0] - 5e-3
    edges = [-math.inf, *starts[2::2].tolist(), math.inf]
    for number, (begin, end) in enumerate(itertools.pairwise(edges), start=1):
        samples = (trace.times >= begin) & (trace.times < end)
        commands = (trace.drive.times >= begin) & (trace.drive.times < end)
        yield Trace(
            f"{trace.source}, bag {number}",
            Drive(trace.drive.times[commands], trace.drive.volts[commands]),
            trace.times[samples],
            trace.pilot_position[samples],
        )
