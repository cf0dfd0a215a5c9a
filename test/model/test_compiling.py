"""Code that several processes compiled, and one loads."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

TWO_KINDS = """
import math
import sys

import numpy as np

from valve_sim.model.compiling import compiled, inner

SHORT = np.dtype([("wanted", "f8")], align=True)
LONG = np.dtype([("other", "f8"), ("wanted", "f8")], align=True)


@inner
def wanted(record, turns):
    total = 0.0
    for turn in range(turns):
{work}
    return record.wanted + 0.0 * total


@compiled
def found(records, turns):
    return 0.5 * wanted(records[0], turns) + 0.5 * wanted(records[0], turns + 1)


for kind in sys.argv[1:]:
    records = np.zeros(1, LONG if kind == "long" else SHORT)
    records["wanted"] = 7.0
    print(found(records, 2))
""".format(work="\n".join(f"        total += math.sin(turn + {n} + total) * math.exp(-total)" for n in range(40)))
"""A compiled function of records of two kinds, as those of valves with gas and without are.

What it calls is too long to be inlined.
"""

LOADED = """
import sys

from valve_sim.model.compiling import compiled


@compiled
def doubled(value):
    return 2.0 * value


print(doubled(3.0), "numba.typed.typedlist" in sys.modules)
"""


def shown(program: Path, *kinds: str) -> list[str]:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(program.parent / "compiled")}
    ran = subprocess.run(
        [sys.executable, str(program), *kinds], env=environment, capture_output=True, text=True, timeout=120, check=True
    )
    return ran.stdout.split()


def test_what_two_processes_compiled_for_records_of_two_kinds_stays_apart_where_both_are_loaded(tmp_path: Path) -> None:
    program = tmp_path / "two_kinds.py"
    program.write_text(TWO_KINDS)
    assert shown(program, "short") == ["7.0"]
    assert shown(program, "long") == ["7.0"]
    assert shown(program, "short", "long") == ["7.0", "7.0"]
    assert shown(program, "long", "short") == ["7.0", "7.0"]


def test_what_is_stored_is_loaded_without_what_only_compiling_needs(tmp_path: Path) -> None:
    program = tmp_path / "loaded.py"
    program.write_text(LOADED)
    assert shown(program) == ["6.0", "True"]
    assert shown(program) == ["6.0", "False"]
