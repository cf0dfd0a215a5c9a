"""Does a monitor warn when it should, only then, and what does it name? `python -m benchmarks.monitoring PART`."""

from __future__ import annotations

import sys

from benchmarks.common import add_jobs, add_seeds, parser
from benchmarks.monitoring import __doc__ as words_of_all
from benchmarks.monitoring.families import PARTS


def main() -> int:
    """Run and print; 1 if anything falls short."""
    known = parser("monitoring", words_of_all)
    known.add_argument("parts", nargs="+", choices=list(PARTS), metavar="PART", help=", ".join(PARTS))
    known.add_argument(
        "--strokes", type=int, default=10_000, help="healthy strokes of a family; 0: none (default: 10000)"
    )
    add_seeds(known)
    add_jobs(known)
    known.add_argument("--rates", type=float, nargs="*", default=(500.0, 1000.0, 2000.0), help="Hz, of a laboratory")
    options = known.parse_args()
    return 0 if all([PARTS[name](options) for name in options.parts]) else 1


if __name__ == "__main__":
    sys.exit(main())
