"""Inputs that nobody would send on purpose: `python -m benchmarks.fuzz` counts what becomes of them."""

from __future__ import annotations

import collections
import math
import time
from collections.abc import Sequence
from typing import Final

from benchmarks.common import parser
from benchmarks.fuzz import SURFACES, attempt
from benchmarks.fuzz import __doc__ as words

TOPICS: Final = "topics"


def main(arguments: Sequence[str] | None = None) -> int:
    """Try everything and count; 1 if there is a finding."""
    known = parser("fuzz", words)
    known.add_argument("--share", type=float, default=1.0, help="of the inputs (default: 1, all of them)")
    known.add_argument("--only", choices=(*SURFACES, TOPICS), help=f"one surface; {TOPICS} is never run unasked")
    known.add_argument("--number", type=int, help="one input again, with --only")
    known.add_argument("--messages", type=int, default=200_000, help="to topics, in all (default: 200000)")
    known.add_argument("--seed", type=int, default=1, help="of these messages")
    known.add_argument("--rounds", type=int, default=4, help="of messages, after each of which all is checked")
    known.add_argument("--nodes", nargs="+", help="that get messages (default: all)")
    options = known.parse_args(arguments)
    if options.only == TOPICS:
        from benchmarks.fuzz.topics import flood_nodes

        return flood_nodes(options.messages, options.seed, options.rounds, options.nodes)
    if options.number is not None:
        if options.only is None:
            known.error("--number: needs --only")
        print(*attempt(options.only, options.number), sep="\n")
        return 0
    found = 0
    for surface, (_, count) in SURFACES.items():
        if options.only not in (None, surface):
            continue
        started, seen = time.perf_counter(), collections.Counter[str]()
        for number in range(math.ceil(options.share * count)):
            what, finding = attempt(surface, number)
            seen[what] += 1
            if finding:
                print(f"{surface} {number}: {finding.splitlines()[-1]}")
        found += seen["finding"]
        counts = ", ".join(f"{many} {what}" for what, many in sorted(seen.items()))
        print(f"{surface}: {counts}; {time.perf_counter() - started:.0f} s")
    return 1 if found else 0


if __name__ == "__main__":
    raise SystemExit(main())
