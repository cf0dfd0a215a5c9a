"""A valve seen through its current alone: what can be known of it, and a campaign on an independent plant."""

import sys
from pathlib import Path

# The plants live with the tests, and are no part of the package.
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "test"))
