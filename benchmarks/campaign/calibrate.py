"""`python -m benchmarks.campaign.calibrate results.jsonl ...`: a and b of the calibration of probabilities.

The lines are those that `python -m benchmarks.campaign --json results.jsonl` wrote. All families on the plant of the
declared form count, as often as the campaign has them; a claim of effects is right where all that is true is in its
classes, a claim of none where nothing is missing that could be seen. Each half of the cases, by their seeds, is also
judged by the constants of the other half.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.optimize import minimize
from valve_sim.identification.diagnosis.calibration import calibrated, log_odds

from benchmarks.campaign.cases import SEEN

FAMILIES: Final = ("single", "none", "pair", "uncatalogued", "weak", "single_within", "none_within", "wrong_value")
VISIBLE: Final = 3.8
"""Standard deviations from which a wrong value stands out decisively: theory, eq. (82)."""
BINS: Final = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0)


class Claim(NamedTuple):
    """A claim with its share of the evidence, whether it is right, and the seed of its case."""

    kind: str
    share: float
    is_right: bool
    seed: int


def claims(lines: Iterator[str]) -> Iterator[Claim]:
    """The claims in a campaign's lines."""
    for line in lines:
        row: dict[str, Any] = json.loads(line)
        if row.get("case", {}).get("family") not in FAMILIES or not row["answers"]:
            continue
        answer = row["answers"][0]
        seed = row["case"]["seed"]
        # What is named beside a remainder claims no more than an even chance by rule, and is not calibrated.
        if answer["kind"] == "none":
            yield Claim("none", answer["evidence"], not _lacks_something(row["case"]), seed)
        elif answer["kind"] == "effects" and answer["is_whole"]:
            yield Claim("effects", answer["evidence"], row["label"] in ("unique", "class"), seed)


def _lacks_something(case: dict[str, Any]) -> bool:
    """Whether something is missing that the recordings could show: of ten tolerances of a mass they show nothing."""
    return bool(case["truth"]) and case["amplitudes"].get(SEEN, VISIBLE) >= VISIBLE


def platt(found: Sequence[Claim]) -> tuple[float, float]:
    """Offset and slope of greatest likelihood, with Platt's counts, which keep a flawless record from being certain."""
    odds = np.array([log_odds(claim.share) for claim in found])
    right = np.array([claim.is_right for claim in found])
    high = (right.sum() + 1.0) / (right.sum() + 2.0)
    low = 1.0 / ((~right).sum() + 2.0)
    target = np.where(right, high, low)

    def loss(ab: np.ndarray) -> float:
        z = ab[0] + ab[1] * odds
        return float(np.sum(np.logaddexp(0.0, z) - target * z))

    best = minimize(loss, np.array([0.0, 1.0]), bounds=[(None, None), (0.0, None)])
    return float(best.x[0]), float(best.x[1])


def probabilities(found: Sequence[Claim], offset: float, slope: float) -> np.ndarray:
    """Of claims, theory, eq. (58)."""
    return np.array([1.0 / (1.0 + np.exp(-(offset + slope * log_odds(claim.share)))) for claim in found])


def print_bins(found: Sequence[Claim], probability: np.ndarray) -> None:
    """How many claims of each probability are right."""
    right = np.array([claim.is_right for claim in found])
    for low, high in itertools.pairwise(BINS):
        chosen = (probability >= low) & (probability < high)
        if chosen.any():
            words = f"{np.count_nonzero(chosen):>5} claims, {right[chosen].mean():.1%} right"
            print(f"  {low:.2f} to {high:.2f} {words}, {probability[chosen].mean():.1%} claimed")


def main() -> int:
    """Print the constants, and how the calibrated probabilities do."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="+", type=Path)
    found = [claim for path in parser.parse_args().files for claim in claims(iter(path.read_text().splitlines()))]
    for kind in ("none", "effects"):
        own = [claim for claim in found if claim.kind == kind]
        if not own:
            print(f"{kind}: no claims")
            continue
        offset, slope = platt(own)
        print(f'"{kind}": Platt({offset:.3f}, {slope:.3f})   {sum(c.is_right for c in own)} of {len(own)} are right')
        print_bins(own, probabilities(own, offset, slope))
        halves = [[claim for claim in own if claim.seed % 2 == half] for half in (0, 1)]
        if all(halves):
            print("  each half by the constants of the other:")
            crossed = [probabilities(half, *platt(other)) for half, other in zip(halves, halves[::-1], strict=True)]
            print_bins([*halves[0], *halves[1]], np.concatenate(crossed))
        print("  by the constants of the package:")
        print_bins(own, np.array([calibrated(kind, claim.share) for claim in own]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
