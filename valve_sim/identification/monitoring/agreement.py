"""The published finding: none before two windows of strokes agree, a new one once two later windows agree on it."""

from __future__ import annotations

from valve_sim.identification.monitoring.fault_isolation import FaultFinding


class Agreement:
    """The finding that two windows of strokes agree on.

    Attributes:
        said: the last one; None before two agree.
    """

    def __init__(self) -> None:
        self.said: FaultFinding | None = None
        self._last: FaultFinding | None = None

    def add(self, finding: FaultFinding) -> FaultFinding | None:
        """Add the finding of a further window; what may be said now, None where it does not agree with the last."""
        agrees = self._last is not None and do_agree(self._last, finding)
        self._last = finding
        if agrees:
            self.said = finding
        return finding if agrees else None

    def forget(self) -> None:
        """Start again, as for another alarm."""
        self.said = self._last = None


def do_agree(first: FaultFinding, second: FaultFinding) -> bool:
    """Whether two findings say the same: one kind, and the same names, or look-alikes of these."""
    if first.verdict.kind != second.verdict.kind:
        return False
    if first.verdict.kind == "unknown":
        return True  # its nearest names are not claimed
    if len(first.verdict.effects) != len(second.verdict.effects):
        return False
    return all(
        name in _names(other) for one, other in ((first, second), (second, first)) for name in one.verdict.effects
    )


def _names(finding: FaultFinding) -> set[str]:
    """What is named, and what would explain it as well."""
    others = finding.verdict.confusable_with.values()
    return {*finding.verdict.effects, *(name for names in others for name in names)}
