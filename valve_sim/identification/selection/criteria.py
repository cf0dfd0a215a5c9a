"""What a fit is worth for choosing a name, by training data alone: S, or cross-validation where no form is right."""

from __future__ import annotations

from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.selection.cross_validation import CrossValidation, cross_validate
from valve_sim.identification.selection.residual_tests import Adequacy, adequacy


class Criteria:
    """Criteria of fits, each worked out once."""

    def __init__(self) -> None:
        self._adequacy: dict[Fit, Adequacy] = {}
        self._cross_validation: dict[Fit, CrossValidation | None] = {}
        self._evidence: dict[Fit, float] = {}

    def adequacy(self, result: Fit) -> Adequacy:
        """The tests of its residual."""
        if result not in self._adequacy:
            self._adequacy[result] = adequacy(result)
        return self._adequacy[result]

    def is_white(self, result: Fit) -> bool:
        """Whether its residual is white."""
        return self.adequacy(result).is_white

    def cross_validation(self, result: Fit) -> CrossValidation | None:
        """What it predicts of each stroke when it is fitted to the others; None where there is one stroke only."""
        if result not in self._cross_validation:
            self._cross_validation[result] = cross_validate(result)
        return self._cross_validation[result]

    def score(self, result: Fit) -> float:
        """The selection criterion, theory, eq. (45): S where the residual is white, else with strokes left out."""
        held = None if self.is_white(result) else self.cross_validation(result)
        return result.score if held is None else result.score + held.rise / result.problem.variance_inflation

    def evidence(self, result: Fit) -> float:
        """−2 ln of its evidence, theory, eq. (42)."""
        if result not in self._evidence:
            self._evidence[result] = result.evidence
        return self._evidence[result]
