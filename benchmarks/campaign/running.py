"""Runs cases: record, diagnose blindly, compare with the truth."""

from __future__ import annotations

import math
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np
from plants.laboratory import drift_over_strokes, true_sizes
from plants.recording import Recording

from benchmarks.campaign.bench import Bench, Measured
from benchmarks.campaign.cases import Case, draw_case
from benchmarks.campaign.declared import as_trace
from benchmarks.campaign.effects import UNCATALOGUED
from benchmarks.common import in_processes
from valve_sim.identification.diagnosis.run import Diagnosis, diagnose
from valve_sim.identification.fit.posterior import Evidence, Grounds, Rivals
from valve_sim.identification.plants.tolerances import SAME_AS, principal_axes
from valve_sim.identification.reporting.claims import recording_advice
from valve_sim.model.parameters import POLYNOMIAL_NAMES

LARGEST_CLASS: Final = 4
"""A class of more names is no answer."""
DECLARED: Final = "declared "
"""Begins the name of an interval of a declared value with a tolerance."""
RECORDED: Final = "recorded "
"""Begins the name of an interval of the size of an error of the recording."""
NORMAL_95: Final = 1.96
"""Standard errors on either side of an estimate in 95 % of cases."""
CONFIDENT: Final = 0.9
"""Probability from which a claim must be right."""
SAME_THING: Final = {
    "valve.stroke": "stroke_offset",
    "valve.pilot_gap": "gap_offset",
    "valve.coil_time_constant": "coil_lag",
    "valve.moving_mass": "valve.main_mass",
    "valve.reference_voltage": "drive_gain",
    "valve.pickup_velocity_ratio": "pickup_impact",
}
"""Declared values that are wrong, by the name of the effect that is the same thing."""


@dataclass(frozen=True)
class Answer:
    """What one diagnosis said.

    Errors are in µm RMS, None without a hold-out; so is `predicted_holdout`, what the corrected model says of its own.
    `unnamed` is the probability that something without a name acts. `seconds` are of the wall clock, `cpu_seconds` of
    this process on all its threads, `work` in simulated strokes. `declared` is what the data say of values with a
    tolerance. `grounds` is the table of evidence behind the verdict, as `grounds_of` reads it. `in_bands` are shares of
    the held-out samples, taken while the valve moves, that lie within 1.96 predicted standard deviations: as measured,
    and the true positions within the band less the sensor's noise.
    """

    kind: str
    effects: tuple[str, ...]
    confusable_with: Mapping[str, tuple[str, ...]]
    probability: float
    before_train: float
    before_holdout: float | None
    after_train: float
    after_holdout: float | None
    seconds: float
    unnamed: float | None = None
    predicted_holdout: float | None = None
    work: float | None = None
    cpu_seconds: float = math.nan
    declared: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    grounds: Mapping[str, Any] = field(default_factory=dict)
    in_bands: tuple[float, float | None] | None = None

    @property
    def classes(self) -> list[set[str]]:
        """For each named effect, its name and those that would do in its place."""
        return [{_plain(name), *map(_plain, self.confusable_with.get(name, ()))} for name in self.effects]


@dataclass(frozen=True)
class Outcome:
    """A case with its answers: one, for an opening a second one to the advised recording; none where it failed.

    Attributes:
        noise_floor: µm RMS of the true noise of the held-out recording.
        is_covered: whether the 95 % interval of each parameter holds its truth, for what was named rightly.
        advice: what to record next, as the first answer says.
        error: last line of the traceback, or empty.
        measured: other figures of the first answer by name: what a bench judges, and of a valve that lacks nothing the
            friction and the constant force that would have been seen, mN.
    """

    case: Case
    answers: tuple[Answer, ...] = ()
    noise_floor: float = math.nan
    is_covered: Mapping[str, bool] | None = None
    advice: str = ""
    error: str = ""
    measured: Mapping[str, float | None] = field(default_factory=dict)

    @property
    def is_named(self) -> bool:
        """Whether the first answer names what is true and nothing else, without a doubt between names."""
        return bool(self.answers) and is_named(self.case, self.answers[0])

    @property
    def is_in_class(self) -> bool:
        """Whether everything true is among the names of the first answer."""
        return bool(self.answers) and is_in_class(self.case, self.answers[0])

    @property
    def is_confident(self) -> bool:
        """Whether the first answer claims to be right."""
        return bool(self.answers) and self.answers[0].probability >= CONFIDENT

    @property
    def label(self) -> str:
        """Column of the confusion table."""
        if not self.answers:
            return "error"
        if self.is_named:
            return "unique"
        # What is named beside an unknown remainder is the nearest name, which only the mismatched plant asks for.
        if self.is_in_class and (self.answers[0].kind != "unknown" or self.case.family == "mismatched"):
            return "class"
        return "wrong" if self.answers[0].kind == "effects" else self.answers[0].kind

    def to_json(self) -> dict[str, Any]:
        """Everything, and the label."""
        document = asdict(self)
        document["noise_floor"] = self.noise_floor if math.isfinite(self.noise_floor) else None
        return {"name": self.case.name, "label": self.label, **document}

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> Outcome:
        """What `to_json` made, also by earlier versions: what they had besides is left out."""
        known = {one.name for one in fields(Answer)}
        answers = tuple(
            Answer(**{key: value for key, value in answer.items() if key in known}) for answer in document["answers"]
        )
        noise = document["noise_floor"]
        return cls(
            Case(**document["case"]), answers, math.nan if noise is None else noise, document["is_covered"],
            document["advice"], document["error"], document.get("measured", {}),
        )  # fmt: skip


def is_named(case: Case, answer: Answer) -> bool:
    """Whether an answer claims exactly what is true, and no other name would do."""
    named = {_plain(name) for name in answer.effects}
    return answer.kind == "effects" and named == true_names(case) and all(len(names) == 1 for names in answer.classes)


def is_right(case: Case, answer: Answer) -> bool:
    """Whether an answer claims exactly what is true, or nothing where nothing is missing."""
    return is_named(case, answer) if case.truth else answer.kind == "none"


def is_in_class(case: Case, answer: Answer) -> bool:
    """Whether every true effect is in a class that is small enough to be an answer."""
    usable = [names for names in answer.classes if len(names) <= LARGEST_CLASS]
    true = true_names(case)
    return bool(true) and all(any(name in names for names in usable) for name in true)


def is_unnamed(case: Case) -> bool:
    """Whether something acts that has no name: an uncatalogued effect, or a form that is not the declared one."""
    return not case.origin.sheet or any(name in UNCATALOGUED for name in case.truth)


def _plain(name: str) -> str:
    """One name for what has two: a value that is wrong, and the effect that makes up for it."""
    return SAME_THING.get(name, name)


def true_names(case: Case) -> set[str]:
    """What is to be named."""
    return {_plain(name) for name in case.truth if name not in UNCATALOGUED}


def run_case(place: tuple[str, int]) -> Outcome:
    """Draw, record and diagnose the case of a family and a seed; an exception becomes its error."""
    case = draw_case(*place)
    try:
        return examine(case)[0]
    except Exception:
        return Outcome(case, error=traceback.format_exc().strip().splitlines()[-1])


def examine(case: Case) -> tuple[Outcome, tuple[Diagnosis, ...]]:
    """The outcome of a case, and the diagnoses themselves."""
    if (bench := case.bench) is not None:
        return _on_bench(case, bench)
    recordings = case.recordings()
    traces = [as_trace(recording, f"bag {number}") for number, recording in enumerate(recordings, 1)]
    noise = _noise(recordings[-1])
    if case.family == "opening":
        opening, advised = (_timed(partial(diagnose, [trace], [], case.declared)) for trace in traces)
        answers = (_answer(opening), _answer(advised))
        advice = recording_advice(opening.diagnosis)
        return Outcome(case, answers, noise, None, advice), (opening.diagnosis, advised.diagnosis)
    timed = _timed(partial(diagnose, traces[:-1], traces[-1:], case.declared))
    answer = replace(_answer(timed), in_bands=_in_bands(case, timed.diagnosis, recordings[-1]))
    covered = None
    if is_right(case, answer):
        covered = _coverage(case, answer, timed.diagnosis) | _sizes_held(case, recordings[0], timed.diagnosis)
    advice, limits = recording_advice(timed.diagnosis), _limits(timed.diagnosis)
    return Outcome(case, (answer,), noise, covered, advice, measured=limits), (timed.diagnosis,)


def _on_bench(case: Case, bench: Bench) -> tuple[Outcome, tuple[Diagnosis, ...]]:
    timed = _timed(bench.diagnose)
    measured = {name: _finite(value) for name, value in bench.judge(timed.diagnosis).items()}
    advice = recording_advice(timed.diagnosis)
    return Outcome(case, (_answer(timed),), advice=advice, measured=measured), (timed.diagnosis,)


def _limits(diagnosis: Diagnosis) -> Measured:
    """Of a valve that lacks nothing: the dry friction and the constant force that would have been named, mN."""
    known = diagnosis.detection_limits if diagnosis.verdict.kind == "none" else {}
    named = {name: known[name]["force"] for name in ("coulomb_friction", "constant_force") if name in known}
    return {f"{name} that would be named, mN": 1e3 * force for name, force in named.items()}


class _Timed(NamedTuple):
    """A diagnosis with what it took, s of wall clock and of this process's threads."""

    diagnosis: Diagnosis
    seconds: float
    cpu_seconds: float


def _timed(work: Callable[[], Diagnosis]) -> _Timed:
    started, computed = time.perf_counter(), time.process_time()
    diagnosis = work()
    return _Timed(diagnosis, time.perf_counter() - started, time.process_time() - computed)


def _answer(timed: _Timed) -> Answer:
    diagnosis = timed.diagnosis
    verdict, before, after = diagnosis.verdict, diagnosis.before, diagnosis.after
    return Answer(
        verdict.kind,
        verdict.effects,
        dict(verdict.confusable_with),
        verdict.probability,
        1e6 * before.train_rmse,
        _micrometres(before.holdout_rmse),
        1e6 * after.train_rmse,
        _micrometres(after.holdout_rmse),
        timed.seconds,
        verdict.unnamed,
        _micrometres(after.holdout_predicted),
        diagnosis.work,
        timed.cpu_seconds,
        {
            found.name: {"estimate": found.estimate, "stderr": found.stderr, "deviation": found.deviation}
            for found in diagnosis.declared
        },
        written_grounds(diagnosis.grounds) if diagnosis.grounds is not None else {},
    )


def _in_bands(case: Case, diagnosis: Diagnosis, held_out: Recording) -> tuple[float, float | None] | None:
    """What an `Answer` has of held-out positions; None where the corrected model predicts none of them.

    The band is that of what the sensor shows, its errors among it; of true positions only where it has none.
    """
    there = diagnosis.after.holdout
    if there is None:
        return None
    plant = there.problem.plant
    channel = plant.channels[0]
    moves = ~channel.quiet & (there.problem.weight(0) > 0.0)
    band, shown = diagnosis.after.holdout_bands[0][moves], plant.predict(there.values)[0][moves]
    noise = there.problem.noise_of(0).sigma
    own = np.sqrt(np.maximum(np.square(band) - noise**2, 0.0))
    # What rounding leaves of a true position is no error of the model.
    own = np.hypot(own, channel.resolution)
    truth = held_out.truth.pilot_position[moves] if len(held_out.times) == len(channel.times) else None
    measured = float(np.mean(np.abs(channel.data - there.shown()[0])[moves] <= NORMAL_95 * band))
    if truth is None or case.laboratory:
        return measured, None
    return measured, float(np.mean(np.abs(truth - shown) <= NORMAL_95 * own))


def written_grounds(grounds: Grounds) -> dict[str, Any]:
    """A table of evidence as JSON; impossible sets without a number."""
    return {
        "effects": sorted(grounds.rivals.effects),
        "declared": sorted(grounds.rivals.declared),
        "table": [
            [list(names), _finite(one.plain), _finite(one.unnamed), one.is_fitted, one.is_untried, _finite(one.forced)]
            for names, one in grounds.table.items()
        ],
        "odds_of_unnamed": [[list(names), min(odds, 1e9)] for names, odds in grounds.odds_of_unnamed.items()],
        "sizes": dict(grounds.sizes),
    }


def _finite(number: float) -> float | None:
    return number if math.isfinite(number) else None


def _number(written: float | None) -> float:
    return -math.inf if written is None else written


def grounds_of(answer: Answer) -> Grounds:
    """The table of evidence of an answer that was written with it."""
    known = answer.grounds
    table = {
        tuple(names): Evidence(_number(plain), _number(unnamed), is_fitted, is_untried, _number(forced))
        for names, plain, unnamed, is_fitted, is_untried, forced in known["table"]
    }
    return Grounds(
        Rivals(frozenset(known["effects"]), frozenset(known["declared"])), table,
        {tuple(names): odds for names, odds in known["odds_of_unnamed"]}, known["sizes"],
    )  # fmt: skip


def _micrometres(error: float) -> float | None:
    return None if math.isnan(error) else 1e6 * error


def _noise(recording: Recording) -> float:
    """µm RMS of what measuring added to the truth."""
    return 1e6 * float(np.sqrt(np.mean(np.square(recording.pilot_position - recording.truth.pilot_position))))


def _coverage(case: Case, answer: Answer, diagnosis: Diagnosis) -> dict[str, bool]:
    true = true_effects(case)
    intervals = diagnosis.after.intervals
    found = {
        name: intervals[name].low <= value <= intervals[name].high
        for name, value in {**case.dampings, **true}.items()
        if name in intervals
    }
    for name, value in true_declared(case).items():
        if name in answer.declared:
            estimate, error = answer.declared[name]["estimate"], answer.declared[name]["stderr"]
            found[f"{DECLARED}{name}"] = abs(estimate - value) <= NORMAL_95 * error
        elif name in intervals and name not in case.dampings:
            found[f"{DECLARED}{name}"] = intervals[name].low <= value <= intervals[name].high
    return found


def _sizes_held(case: Case, recording: Recording, diagnosis: Diagnosis) -> dict[str, bool]:
    """Whether the 95 % interval of each error of the training recording holds its true size; where it has any."""
    if not case.laboratory:
        return {}
    laboratory = case.laboratory_of(0)
    true = true_sizes(laboratory)
    if laboratory.drift:
        true["drift"] = drift_over_strokes(laboratory, recording, case.record_seeds[0])
    # What varies in the dampings' own group is what the laboratory says; loads vary by a third of it.
    entries = [entry for entry in diagnosis.recording["bag 1"] if entry.detail not in ("seat load", "spring preload")]
    found = {entry.error: entry.low <= true[entry.error] <= entry.high for entry in entries if true.get(entry.error)}
    return {f"{RECORDED}{name}": is_held for name, is_held in found.items()}


def true_effects(case: Case) -> dict[str, float]:
    """True values of the effects' parameters, by the names of a diagnosis.

    Of a declared value that is off within its tolerance, the effect that is the same thing takes up that, too; where a
    plant of another form does not say by how much, that effect is left out.
    """
    true = {f"{effect}.{name}": value for effect, values in case.effects.items() for name, value in values.items()}
    declared, is_off = case.declared.declared(), case.declared.tolerances.declared
    for name, same in SAME_AS.items():
        if same not in true or name not in is_off:
            continue
        if name in case.true_scalars:
            true[same] += case.true_scalars[name] - declared[name]
        else:
            del true[same]
    return true


def true_declared(case: Case) -> dict[str, float]:
    """True values by the names of a diagnosis, the polynomial along the axes of its covariance."""
    declared = case.declared
    axes = principal_axes(declared.tolerances)
    true = case.true_scalars
    if not true:
        return {}
    coefficients = np.array([true[name] for name in POLYNOMIAL_NAMES])
    at = np.linalg.pinv(axes) @ (coefficients - declared.parameters.attraction_polynomial)
    return true | {f"attraction[{axis}]": value for axis, value in enumerate(at.tolist())}


def run_cases(plan: Sequence[tuple[str, int]], jobs: int) -> Iterator[Outcome]:
    """Outcomes of families and seeds as they come, from so many processes; one that was killed is an error."""
    for (family, seed), future in in_processes(run_case, plan, jobs):
        error = future.exception()
        if error is None:
            yield future.result()
        else:
            yield Outcome(draw_case(family, seed), error=f"{type(error).__name__}: {error}")
