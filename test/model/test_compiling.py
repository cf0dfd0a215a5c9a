"""Code that several processes compiled, and one loads."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path

import numba
import pytest

from valve_sim.model import compiling

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

from valve_sim.model.compiling import announce_compiling, compiled, is_compiling


@compiled
def doubled(value):
    return 2.0 * value


announce_compiling(lambda: print("compiling", is_compiling()))
print(doubled(3.0), "numba.typed.typedlist" in sys.modules, is_compiling())
"""


MOVED = """
import itertools

from numba.core.bytecode import FunctionIdentity

numbered = FunctionIdentity.from_function.__func__


class Own(FunctionIdentity):
    _unique_ids = itertools.count(1)


FunctionIdentity.from_function = classmethod(lambda cls, function: numbered(Own, function))
"""
"""A Numba that numbers functions otherwise: what is written into the name of before is read by nobody."""
UNLIKE = {
    "not used any more": MOVED,
    "renamed": MOVED + "del FunctionIdentity._unique_ids\n",
    "newer": "import numba\nnumba.version_info = numba.version_info._replace(short=(0, 99))\n",
    "moved to another module": "import numba, sys\nsys.modules['numba.core.bytecode'] = sys.modules['math']\n",
}


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
    assert shown(program) == ["compiling", "True", "6.0", "True", "False"]
    assert shown(program) == ["6.0", "False", "False"]


@pytest.mark.parametrize("change", UNLIKE)
def test_a_numba_that_numbers_functions_otherwise_is_left_alone_and_nothing_is_kept(
    change: str, tmp_path: Path
) -> None:
    program = tmp_path / "unlike.py"
    program.write_text(UNLIKE[change] + TWO_KINDS)
    cache = tmp_path / "compiled"
    ran = subprocess.run(
        [sys.executable, str(program), "short", "long"], env={**os.environ, "NUMBA_CACHE_DIR": str(cache)},
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    assert ran.stdout.split() == ["7.0", "7.0"]
    assert "works otherwise than those that were tried, 0.58 to 0.68: every start compiles anew" in ran.stderr
    assert not list(tmp_path.rglob("*.nb?"))


def test_code_is_kept_in_our_folder_whatever_places_numba_is_told_to_look_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_LOCATOR_CLASSES", "InTreeCacheLocator")
    program = tmp_path / "loaded.py"
    program.write_text(LOADED)
    assert shown(program)
    kept = list(tmp_path.rglob("*.nbi"))
    assert kept
    assert all(file.is_relative_to(tmp_path / "compiled") for file in kept)


def test_two_threads_that_compile_leave_each_other_the_folder() -> None:
    """Numba reads it from a variable of the process; where that is empty, it writes into the working directory."""
    inside, leave, seen = threading.Event(), threading.Event(), []
    before = numba.config.CACHE_DIR

    def second() -> None:
        with compiling.cached():
            inside.set()
            leave.wait(10.0)
            seen.append(numba.config.CACHE_DIR)

    thread = threading.Thread(target=second)
    with compiling.cached() as has_folder:
        thread.start()
        inside.wait(0.1)  # without a lock the second comes in now
    leave.set()
    thread.join()
    assert has_folder
    assert seen == [str(compiling._FOLDER)]
    assert before == numba.config.CACHE_DIR
