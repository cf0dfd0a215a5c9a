"""Diagnoses of fifty recordings that are hard on a diagnosis, each within a budget.

Noise-free, coarse, jittered, with rests of seconds, of one opening only, with a force that no catalogued effect is, and
in several bags: none may end with a larger error than it began with, fitted or held out, none may take longer than its
budget by more than a tenth, and a recording without noise of a valve that lacks nothing must give `none`. Half are made
by the independent plants of test/plants, half by this package's own simulator, written as bags and read again.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "test"))
