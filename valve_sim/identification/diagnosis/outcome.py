"""The result of a diagnosis: a verdict, the model before and after, and all that was tried."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from valve_sim.identification.diagnosis.experiment_design import Recommendation
from valve_sim.identification.estimation.declared_values import DeclaredValue, declared_values, estimated_valve
from valve_sim.identification.estimation.intervals import Interval
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.plants.protocol import Plant
from valve_sim.identification.plants.stroke_choice import StrokeChoice
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.selection.bootstrap import FalseAlarm
from valve_sim.identification.selection.detection_limits import Limits
from valve_sim.identification.selection.force_maps import Unexplained
from valve_sim.identification.selection.residual_tests import Adequacy
from valve_sim.model import Valve


@dataclass(frozen=True)
class Grounds:
    """What a verdict is drawn from, beside its evidence.

    Attributes:
        best: effects of the hypothesis that stands, whether they are claimed or not.
        has_remainder: whether something is left that no effect explains.
        share: of the squared residual of the refitted declared model, what `best` explains, 0 to 1.
        places: where a force at that place alone would explain the data about as well, e.g. "x 0 to 0.146 mm".
        strokes: how many were recorded.
        singles_untried: whether the time was too short to try even each effect by itself.
    """

    best: tuple[str, ...]
    has_remainder: bool
    share: float
    places: tuple[str, ...]
    strokes: int
    singles_untried: bool


@dataclass(frozen=True)
class Verdict:
    """What is claimed; the fields but `grounds` are those of report.json.

    `evidence` is the share of the claim in the evidence of all that was tried; `probability` is how often a claim with
    such a share was right on the campaign.
    """

    kind: str
    effects: tuple[str, ...]
    confusable_with: Mapping[str, tuple[str, ...]]
    evidence: float
    probability: float
    grounds: Grounds

    @property
    def is_open(self) -> bool:
        """Whether a further recording could tell more."""
        has_rivals = self.grounds.has_remainder or any(self.confusable_with.values())
        return self.kind in ("unknown", "insufficient") or (self.kind == "effects" and has_rivals)


@dataclass(frozen=True)
class State:
    """A fitted model on training and held-out data.

    Attributes:
        fit: on the training data. holdout: the same values on held-out data, nuisances estimated; or None.
        train_rmse, holdout_rmse: in the response's unit, m for a valve; nan where there is no hold-out.
        adequacy: of the training residuals. intervals: of every freed parameter.
    """

    fit: Fit
    holdout: Fit | None
    train_rmse: float
    holdout_rmse: float
    adequacy: Adequacy
    intervals: Mapping[str, Interval]


@dataclass(frozen=True)
class Rival:
    """A model that competes with the corrected one.

    `fit` and `holdout` are as of a `State`; `weight` is its likelihood over that of the corrected model, with the price
    of its parameters, and at most 1.
    """

    fit: Fit
    holdout: Fit | None
    weight: float


@dataclass(frozen=True)
class Candidate:
    """One hypothesis that was tried."""

    effects: tuple[str, ...]
    timing: bool
    delta_score: float
    train_rmse: float
    holdout_rmse: float
    intervals: Mapping[str, Interval]


@dataclass(frozen=True, repr=False)
class Diagnosis:
    """The outcome of `diagnose_plant`.

    `recommendation` is the experiment that separates the competing models best, where one does; `untried` is what was
    left untried when the time was used up, or could not be simulated; `looks` is how often held-out data were opened to
    judge a choice; `detection_limits` is, where nothing is missing, how large each effect would have to be to show;
    `choice` is which strokes of a long recording were looked at, None for all of them;
    `rivals` are named of a valve that is seen through its current alone, whose positions they leave open.
    """

    plant: Plant
    before: State
    after: State
    verdict: Verdict
    candidates: tuple[Candidate, ...]
    unexplained: Unexplained | None
    maps: tuple[Unexplained, ...]
    false_alarm: FalseAlarm
    sources: tuple[str, ...] = ()
    recommendation: Recommendation | None = None
    untried: tuple[str, ...] = ()
    looks: int = 0
    detection_limits: Limits = field(default_factory=dict)
    rivals: tuple[Rival, ...] = ()
    choice: StrokeChoice | None = None

    def __repr__(self) -> str:
        """Diagnosis(effects: coulomb_friction, probability 0.99)."""
        names = f": {', '.join(self.verdict.effects)}" if self.verdict.effects else ""
        return f"Diagnosis({self.verdict.kind}{names}, probability {self.verdict.probability:.2g})"

    @property
    def valve(self) -> Valve:
        """The corrected valve.

        Raises:
            TypeError: the plant is not a valve.
        """
        if not isinstance(self.plant, ValvePlant):
            raise TypeError("only a diagnosis of a valve has a corrected valve")
        return estimated_valve(self.after.fit, self.plant)

    @property
    def declared(self) -> tuple[DeclaredValue, ...]:
        """Values that are known within a tolerance, as declared and as the corrected model has them."""
        return declared_values(self.after.fit)
