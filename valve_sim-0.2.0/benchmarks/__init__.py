"""What this package can do and what it costs: `python -m benchmarks` lists the programs."""

import sys
from pathlib import Path

# The independent plants live with the tests, and are no part of the package.
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "test"))
