"""Results as JSON: what is not finite becomes null, wherever it stands."""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from valve_sim.files.json_text import finite_or_none, json_text, plain


class Point(NamedTuple):
    at: float
    names: tuple[str, ...]


@dataclass(frozen=True)
class Record:
    point: Point
    file: Path


def test_what_is_not_finite_becomes_null_wherever_it_stands() -> None:
    report = {"a": math.nan, "b": [1.0, -math.inf], "c": {"d": (np.float64("inf"), 2)}, "e": True}
    assert json.loads(json_text(report)) == {"a": None, "b": [1.0, None], "c": {"d": [None, 2]}, "e": True}


def test_records_become_mappings_and_paths_words() -> None:
    found = plain(Record(Point(math.inf, ("x", "y")), Path("a") / "b"))
    assert found == {"point": {"at": None, "names": ["x", "y"]}, "file": "a/b"}


def test_a_number_of_numpy_is_printed_as_one() -> None:
    value = finite_or_none(np.float64(0.1))
    assert type(value) is float
    assert json_text({"µ": value}) == '{\n  "µ": 0.1\n}\n'
