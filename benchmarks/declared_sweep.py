"""Is a wrong declared value named, and an effect that is declared and has grown? `python -m benchmarks.declared_sweep`.

One case for each declared value of a valve, which its file has off by 5 to 20 %, and one for each effect, which the
file declares and which has grown by 0.2 to 3 times since. The independent plant of test/plants records eight strokes
and a held-out recording; `diagnose` gets these and the file. All of the file is said to be exact. A case and a seed
determine everything. Of each case a line:

- right: the truth is named, and nothing beside it or in its place.
- class: the truth is among the names, or among those that would do in their place.
- missed: nothing is claimed (none, unknown, insufficient), and the truth is not among what is listed.
- wrong: effects are claimed without the truth; confidently wrong: with a probability of 0.9 or more.

    python -m benchmarks.declared_sweep --seeds 3 --json sweep.jsonl
    python -m benchmarks.declared_sweep --slice 4
"""

from __future__ import annotations

import argparse
import collections
import json
import math
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.campaign.effects import CATALOGUED
from valve_sim.identification.diagnosis.run import Verdict, diagnose
from valve_sim.model import Drive, Valve, ValveError
from valve_sim.traces import Signal, Trace

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "test"))

from plants.declared import DeclaredPlant
from plants.recording import Profile, Recorder, holdout_profile, record, train_profile
from plants.tolerances import SHEET_VALVE

CONFIDENT: Final = 0.9
LEAST_OFF, MOST_OFF = 0.05, 0.2
"""Shares by which a file has a value off, either way."""
LEAST_GROWTH, MOST_GROWTH = 0.2, 3.0
"""By how many times its declared size an effect has grown."""
SAME_THING: Final[Mapping[str, tuple[str, ...]]] = {
    "stroke": ("stroke_offset",),
    "pilot_gap": ("gap_offset",),
    "coil_time_constant": ("coil_lag",),
    "reference_voltage": ("drive_gain",),
    "pickup_velocity_ratio": ("pickup_impact",),
}
"""Declared values, and the names of effects that are the same thing, which are as right."""
SHOWN_BY_CURRENT: Final = ("coil_resistance",)
"""What no position shows: a current is recorded, too."""
TRUE_VALVE: Final = {**SHEET_VALVE, "pickup_velocity_ratio": 0.9}
VALUES: Final = tuple(name for name in TRUE_VALVE if not name.endswith("_damping"))
"""Every declared value but the dampings, which are refitted anyway."""
RATE: Final = 20e3
HELD_OUT_SEED: Final = 10_000


@dataclass(frozen=True)
class Case:
    """What is wrong with which file: a declared value is off by a share, or a declared effect has grown.

    Attributes:
        kind: "value" or "effect". name: of it. amount: the share, or by how many times its size it has grown.
        names: that are right. declared: the file. valve, effects: the truth.
    """

    kind: str
    name: str
    seed: int
    amount: float
    names: tuple[str, ...]
    declared: Valve
    valve: Mapping[str, Any]
    effects: Mapping[str, Mapping[str, float]]

    @property
    def title(self) -> str:
        """Value spring_preload off by +8.1 %, seed 2."""
        off = f"off by {100.0 * self.amount:+.1f} %" if self.kind == "value" else f"grown by {self.amount:.2f} times"
        return f"{self.kind} {self.name} {off}, seed {self.seed}"


@dataclass(frozen=True)
class Line:
    """A case and what was said of it, as JSON has it."""

    kind: str
    name: str
    seed: int
    amount: float
    label: str
    verdict: str
    effects: tuple[str, ...]
    confusable_with: Mapping[str, Sequence[str]]
    probability: float
    seconds: float
    error: str = ""


def plan() -> list[tuple[str, str]]:
    """Every value and every effect, in turns, so that a slice has some of both."""
    values, effects = [("value", name) for name in VALUES], [("effect", name) for name in CATALOGUED]
    pairs = [pair for both in zip(values, effects, strict=False) for pair in both]
    return pairs + values[len(effects) :] + effects[len(values) :]


def drawn(kind: str, name: str, seed: int) -> Case:
    """A case with its amount."""
    random = np.random.default_rng([seed, *name.encode()])
    dampings = {"pilot_damping": random.uniform(0.8, 1.6), "main_damping": random.uniform(3.0, 5.0)}
    valve = {**TRUE_VALVE, **dampings}
    if kind == "value":
        share = random.uniform(LEAST_OFF, MOST_OFF) * (-1.0 if random.random() < 0.5 else 1.0)
        off = np.asarray(TRUE_VALVE[name]) * (1.0 + share)
        names = (f"valve.{name}", *SAME_THING.get(name, ()))
        return Case(kind, name, seed, share, names, _file({**TRUE_VALVE, name: off.tolist()}, {}), valve, {})
    scale = CATALOGUED[name]
    size, shape = math.sqrt(scale.guess * min(scale.largest, scale.most)), scale.middle()
    growth = math.exp(random.uniform(math.log(LEAST_GROWTH), math.log(MOST_GROWTH)))
    growth = min(growth, scale.most / size - 1.0)
    declared, grown = scale.parameters(size, shape), scale.parameters(size * (1.0 + growth), shape)
    return Case(kind, name, seed, growth, (name,), _file(TRUE_VALVE, {name: declared}), valve, {name: grown})


def _file(valve: Mapping[str, Any], effects: Mapping[str, Mapping[str, float]]) -> Valve:
    """As a parameter file would declare it; the dampings are those of the paper."""
    entries = {**valve, "attraction_polynomial": list(valve["attraction_polynomial"])}
    return Valve.from_mapping(
        {"valve": entries, "effects": {name: dict(own) for name, own in effects.items()}}, "sweep"
    )


def _recorded(case: Case, profile: Profile, seed: int, rate: float) -> Trace:
    has_current = case.name in SHOWN_BY_CURRENT
    recorder = Recorder(with_current=has_current, sample_rate=rate)
    made = record(DeclaredPlant(case.effects, case.valve), profile, recorder, seed)
    current = None if made.coil_current is None else Signal(made.times, made.coil_current)
    drive = Drive(made.command_times, made.volts)
    return Trace(f"seed {seed}", drive, made.times, made.pilot_position, made.main_position, coil_current=current)


def label_of(verdict: Verdict, names: Sequence[str]) -> str:
    """Right, class, missed, wrong or confidently wrong."""
    alike = [other for others in verdict.confusable_with.values() for other in others]
    if verdict.kind == "effects" and len(verdict.effects) == 1 and verdict.effects[0] in names and not alike:
        return "right"
    if verdict.kind != "none" and {*verdict.effects, *alike} & set(names):
        return "class"
    if verdict.kind != "effects":
        return "missed"
    return "confidently wrong" if verdict.probability >= CONFIDENT else "wrong"


def diagnosed(case: Case, rate: float = RATE) -> Line:
    """Record, diagnose and compare."""
    train = _recorded(case, train_profile(), case.seed, rate)
    held_out = _recorded(case, holdout_profile(), HELD_OUT_SEED + case.seed, rate)
    begun = time.process_time()
    about = (case.kind, case.name, case.seed, case.amount)
    try:
        verdict = diagnose([train], [held_out], case.declared).verdict
    except ValveError as error:
        return Line(*about, "error", "", (), {}, math.nan, time.process_time() - begun, str(error))
    return Line(
        *about, label_of(verdict, case.names), verdict.kind, tuple(verdict.effects),
        {name: tuple(others) for name, others in verdict.confusable_with.items()}, verdict.probability,
        time.process_time() - begun,
    )  # fmt: skip


def words(case: Case, line: Line) -> str:
    """One line for a person."""
    named = ", ".join(
        name + (f" (or {', '.join(line.confusable_with[name])})" if line.confusable_with.get(name) else "")
        for name in line.effects
    )
    said = line.error or f"{line.verdict} {named or '-'}, p {line.probability:.3f}"
    return f"{line.label:<18}{case.title:<58}{said}, {line.seconds:.0f} CPU s"


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a line for each case and the counts; 1 if anything is confidently wrong."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.declared_sweep",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--seeds", type=int, default=1, help="how many of each case (default: 1)")
    parser.add_argument("--first", type=int, default=0, help="first seed (default: 0)")
    parser.add_argument("--slice", type=int, metavar="N", help="only the first N cases of each seed")
    parser.add_argument("--only", metavar="NAMES", help="only these values and effects, with commas between")
    parser.add_argument("--rate", type=float, default=RATE, help=f"samples a second (default: {RATE:g})")
    parser.add_argument("--json", type=Path, metavar="FILE", help="a line of JSON for each case")
    chosen = parser.parse_args(arguments)
    cases = plan()[: chosen.slice]
    if chosen.only:
        wanted = {name.strip() for name in chosen.only.split(",")}
        cases = [case for case in plan() if case[1] in wanted]
    if not cases or chosen.seeds < 1:
        parser.error(f"expected at least one seed and some of {', '.join((*VALUES, *CATALOGUED))}")
    counts: dict[str, collections.Counter[str]] = {kind: collections.Counter() for kind in ("value", "effect")}
    lines = []
    for seed in range(chosen.first, chosen.first + chosen.seeds):
        for kind, name in cases:
            case = drawn(kind, name, seed)
            line = diagnosed(case, chosen.rate)
            counts[kind][line.label] += 1
            lines.append(json.dumps(asdict(line)))
            print(words(case, line), flush=True)
            if chosen.json is not None:
                chosen.json.write_text("\n".join(lines) + "\n", encoding="utf-8")
    for kind, found in counts.items():
        if found:
            print(f"{kind}s: " + ", ".join(f"{label} {count}" for label, count in found.most_common()))
    return 1 if any(found["confidently wrong"] or found["error"] for found in counts.values()) else 0


if __name__ == "__main__":
    raise SystemExit(main())
