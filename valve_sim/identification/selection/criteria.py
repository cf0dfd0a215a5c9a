"""What a fit is worth for choosing a name, by training data alone: S, or cross-validation where no form is right."""

from __future__ import annotations

from valve_sim.identification.estimation.result import Fit, is_relief
from valve_sim.identification.selection.cross_validation import CrossValidation, cross_validate, predicts_better
from valve_sim.identification.selection.residual_tests import Adequacy, adequacy


class Criteria:
    """Criteria of fits, each worked out once."""

    def __init__(self) -> None:
        self._adequacy: dict[Fit, Adequacy] = {}
        self._cross_validation: dict[Fit, CrossValidation | None] = {}

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
        return self.score_as(result, residual_is_white=self.is_white(result))

    def score_as(self, result: Fit, *, residual_is_white: bool) -> float:
        """The same where it is said whether a form is right, so that fits are compared by one criterion."""
        held = None if residual_is_white else self.cross_validation(result)
        return result.score if held is None else result.score + held.rise / result.problem.variance_inflation

    def improves(self, smaller: Fit, larger: Fit) -> bool:
        """Whether the larger model predicts strokes that are left out better by 2 standard errors.

        What only brings declared values back within their tolerances is not asked to: theory, below eq. (83).
        """
        if is_relief(smaller, larger):
            return True
        one, other = self.cross_validation(smaller), self.cross_validation(larger)
        return one is None or other is None or predicts_better(one, other, larger.problem.variance_inflation)
