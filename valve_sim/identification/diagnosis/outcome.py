"""The result of a diagnosis: a verdict, the model before and after, and all that was tried.

Whether the corrected model may take the place of the declared one is judged by what it predicts of held-out strokes.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from valve_sim.identification.diagnosis.experiment_design import Recommendation
from valve_sim.identification.fit.correction import Correction
from valve_sim.identification.fit.curves import Unexplained
from valve_sim.identification.fit.declared_values import DeclaredValue, declared_values, estimate_of
from valve_sim.identification.fit.detection_limits import Limits
from valve_sim.identification.fit.grades import Grade
from valve_sim.identification.fit.intervals import Interval
from valve_sim.identification.fit.posterior import Grounds
from valve_sim.identification.fit.recorded_errors import RecordedError, by_recording
from valve_sim.identification.fit.residual_tests import Adequacy
from valve_sim.identification.fit.result import Fit
from valve_sim.identification.plants.protocol import Array, Channel, Plant, primary_channels
from valve_sim.identification.plants.stroke_choice import StrokeChoice
from valve_sim.model import Valve

PREDICTS_BETTER: Final = 10.0
"""Ln of how much more probable held-out strokes must be: odds of 22,000 to 1."""
AS_PREDICTED: Final = 1.2
"""Error over what the posterior predicts of it, beyond which something is left."""


class Worth(NamedTuple):
    """What one of several named effects is worth.

    Attributes:
        improvement: its share of what all named effects together explain of the squared error, 0 to 1: the mean of what
            it explains as the first and as the last of them (of two names their Shapley values), so that all sum to 1.
        remaining: of the squared error of the refitted declared model beyond noise, what is left with it alone.
    """

    improvement: float
    remaining: float


@dataclass(frozen=True)
class Verdict:
    """What is claimed; the fields but the last five are those of report.json.

    Attributes:
        kind: "none"; "effects": all that is corrected is named; "partly": a correction is applied, and its names are
            not certain or something unnamed is left; "unknown": something acts, and nothing that was tried predicts
            unseen strokes better; "insufficient": the recordings cannot tell.
        effects: what is corrected; of "unknown" and "insufficient" the nearest names, which are not claimed.
        confusable_with: of each, what would do in its place.
        probability: posterior, of what is claimed: of "effects" and "insufficient" that the set or its class acts, of
            "partly" that the least certain of its names or a look-alike does, of "none" that nothing does, of "unknown"
            that something without a name does.
        unnamed: posterior probability that something without a name acts.
        share: of the squared error of the refitted declared model beyond noise, what the named effects explain, 0 to 1.
        strokes: how many were recorded.
        worth: of each of the named effects, where what it needs was fitted.
        is_cut_short: whether the budget ended before all was tried.
    """

    kind: str
    effects: tuple[str, ...]
    confusable_with: Mapping[str, tuple[str, ...]]
    probability: float
    unnamed: float
    share: float
    strokes: int
    worth: Mapping[str, Worth] = field(default_factory=dict)
    is_cut_short: bool = False

    @property
    def is_open(self) -> bool:
        """Whether a further recording could tell more."""
        has_rivals = any(self.confusable_with.values())
        if self.kind == "insufficient" and self.is_cut_short:
            return False
        return self.kind in ("partly", "unknown", "insufficient") or (self.kind == "effects" and has_rivals)

    @property
    def is_corrected(self) -> bool:
        """Whether a correction is applied."""
        return self.kind in ("effects", "partly")


@dataclass(frozen=True)
class State:
    """A fitted model on training and held-out data.

    Attributes:
        fit: on the training data.
        holdout: its machine's values on held-out data, the errors of that recording estimated; None without hold-out.
        train_rmse, holdout_rmse: in the response's unit, m for a valve; nan where there is no hold-out.
        train_predicted, holdout_predicted: the standard deviations that the posterior predicts of these.
        bands, holdout_bands: of each channel of the training and of the held-out data, (n,) standard deviation of what
            is predicted, noise included; none without hold-out.
        adequacy: of the training residuals; it informs, and decides nothing.
        intervals: of every freed parameter.
    """

    fit: Fit
    holdout: Fit | None
    train_rmse: float
    holdout_rmse: float
    train_predicted: float
    holdout_predicted: float
    bands: Mapping[int, Array]
    holdout_bands: Mapping[int, Array]
    adequacy: Adequacy
    intervals: Mapping[str, Interval]


@dataclass(frozen=True)
class Rival:
    """A model that competes with the corrected one.

    `fit` and `holdout` are those of a `State`; `weight` is its posterior odds to the corrected model, at most 1.
    """

    fit: Fit
    holdout: Fit | None
    weight: float


@dataclass(frozen=True)
class Candidate:
    """One set that was fitted.

    Attributes:
        effects: the set. timing: whether errors of the commands' stamps were estimated along.
        probability: posterior, whatever acts beside it. unnamed: the part of that beside something unnamed.
        log_evidence: ln p(data | set), without a discrepancy.
        delta_bic: −2 ln of its evidence over that of the declared model.
        train_rmse, holdout_rmse: see `State`. intervals: of every freed parameter.
    """

    effects: tuple[str, ...]
    timing: bool
    probability: float
    unnamed: float
    log_evidence: float
    delta_bic: float
    train_rmse: float
    holdout_rmse: float
    intervals: Mapping[str, Interval]


@dataclass(frozen=True, repr=False)
class Diagnosis:
    """The outcome of `diagnose_plant`.

    Attributes:
        plant: the training data. before, after: the refitted declared model, and the corrected one.
        verdict: what is claimed. candidates: what was fitted, the most probable first.
        inclusion: of each name the posterior probability that it acts.
        unexplained: what is left without a name, as a force; None where nothing is. maps: all such forces.
        sources: what was read. recommendation: the experiment that separates the competing models best, where one does.
        held_out_gain: ln of how much more probable the corrected model makes held-out strokes, beside a discrepancy;
            nan where nothing is held out.
        untried: what was left untried when the work was used up, or cannot be simulated.
        work: simulated strokes, derivatives counted. allowed: how many were allowed; infinite without a limit.
        detection_limits: where nothing is missing, how large each effect would have to be to be named.
        rivals: of a valve that is seen through its current alone, models that leave its positions open.
        choice: which strokes of a long recording were looked at; None for all of them.
        grounds: the table of evidence from which verdict and probabilities follow.
        correction: what predicts unseen strokes best, applied or not.
        grades: of each of its names, how far to trust it.
        impossible: of what was left untried because it cannot be simulated, why.
    """

    plant: Plant
    before: State
    after: State
    verdict: Verdict
    candidates: tuple[Candidate, ...]
    inclusion: Mapping[str, float]
    unexplained: Unexplained | None
    maps: tuple[Unexplained, ...]
    sources: tuple[str, ...] = ()
    recommendation: Recommendation | None = None
    held_out_gain: float = float("nan")
    untried: tuple[str, ...] = ()
    work: float = 0.0
    allowed: float = float("inf")
    detection_limits: Limits = field(default_factory=dict)
    rivals: tuple[Rival, ...] = ()
    choice: StrokeChoice | None = None
    grounds: Grounds | None = None
    correction: Correction | None = None
    grades: tuple[Grade, ...] = ()
    impossible: Mapping[str, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        """Diagnosis(effects: coulomb_friction, probability 0.99)."""
        names = f": {', '.join(self.verdict.effects)}" if self.verdict.effects else ""
        return f"Diagnosis({self.verdict.kind}{names}, probability {self.verdict.probability:.2g})"

    @property
    def primary_channel(self) -> Channel:
        """One of the channels by which the errors are meant."""
        return self.plant.channels[primary_channels(self.plant)[0]]

    @property
    def valve(self) -> Valve:
        """The corrected valve.

        Raises:
            TypeError: the plant is not a valve.
        """
        return self.plant.estimated(estimate_of(self.after.fit))

    @functools.cached_property
    def recording(self) -> dict[str, tuple[RecordedError, ...]]:
        """The errors of each recording as the corrected model has them, by the recording's source."""
        return by_recording([self.after.fit, *([] if self.after.holdout is None else [self.after.holdout])])

    @property
    def declared(self) -> tuple[DeclaredValue, ...]:
        """Values that are known within a tolerance, as declared and as the corrected model has them."""
        return declared_values(self.after.fit)


def objection_to(diagnosis: Diagnosis) -> str:
    """Why the corrected model should not be set on a valve; empty where nothing speaks against it."""
    if diagnosis.verdict.is_corrected and not diagnosis.held_out_gain > PREDICTS_BETTER:
        if math.isnan(diagnosis.held_out_gain):
            is_confirmed = diagnosis.correction is not None and diagnosis.correction.is_refitted
            return "" if is_confirmed else "no strokes were held out that could confirm it"
        return "it does not predict held-out strokes decisively better than the declared model"
    return what_is_left(diagnosis) if diagnosis.verdict.kind == "none" else ""


def what_is_left(diagnosis: Diagnosis) -> str:
    """A clause that says how much larger the error is than the posterior predicts; empty where it is not."""
    error, expected = _compared(diagnosis.after)
    if not error > AS_PREDICTED * expected:
        return ""
    scale, unit = diagnosis.primary_channel.readable
    return f"the error is {scale * error:.3g} {unit} where {scale * expected:.3g} {unit} is predicted"


def _compared(state: State) -> tuple[float, float]:
    """The error of held-out strokes and what is predicted of it; of the training strokes where none are held out."""
    if math.isnan(state.holdout_rmse):
        return state.train_rmse, state.train_predicted
    return state.holdout_rmse, state.holdout_predicted
