"""What others send, read within bounds: whatever it is, a value or one line that says why not."""

from __future__ import annotations

import json
import random
import string
from collections.abc import Callable

import pytest

from valve_sim.nodes.heard import UnusableMessageError, count_of, moment_of, number_of, read_report, text_of

SCHEMA = "valve_sim/stroke/1"
GOOD = {"schema": SCHEMA, "time": 1.7e9, "stroke": 3, "valve": "/valve", "t1": None, "scores": {"a": -1.5}}


def text(**changes: object) -> str:
    return json.dumps({**GOOD, **changes})


def test_a_report_is_what_was_sent() -> None:
    found = read_report(text(), SCHEMA)
    assert found == GOOD
    assert (moment_of(found), count_of(found, "stroke"), text_of(found, "valve")) == (1.7e9, 3, "/valve")
    assert (number_of(found, "t1"), number_of(found["scores"], "a"), number_of(found, "none")) == (None, -1.5, None)
    assert number_of({"p": "0.25"}, "p", 0.0, 1.0) == 0.25, "values of diagnostics are texts"


@pytest.mark.parametrize(
    ("sent", "says"),
    [
        ("[" * 200_000, "found 200000 characters, expected 100000 at most"),
        ("[" * 90_000, "expected JSON"),
        ("{" + '"a":{' * 500 + "}" * 501, "expected JSON: nested deeper than 10"),
        ("", "expected JSON"),
        ('{"schema": Infinity}', "Infinity is no number"),
        (text().replace("-1.5", "NaN"), "NaN is no number"),
        (text().replace("-1.5", "1e999"), "not finite"),
        (text().replace("-1.5", "9" * 400), "too large"),
        (text().replace("-1.5", "9" * 20_000), "expected JSON"),
        (text(schema="valve_sim/stroke/2"), "expected a report of schema valve_sim/stroke/1: use one version"),
        (text(schema=["x"] * 10_000), "expected a report of schema"),
        ("[1, 2]", "expected a report of schema"),
    ],
)
def test_what_is_no_report_is_one_line(sent: str, says: str) -> None:
    with pytest.raises(UnusableMessageError, match=says) as refused:
        read_report(sent, SCHEMA)
    assert len(str(refused.value)) < 300
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("read", "value"),
    [
        *((moment_of, value) for value in (1e308, -1.0, "soon", True, None, [1.0], 2.0**31)),
        *((lambda found: count_of(found, "time"), value) for value in (-1, 1.5, 1e300, "two", None)),
        *((lambda found: number_of(found, "time"), value) for value in ("nan", "-inf", "1" * 5000, {}, True)),
        *((lambda found: text_of(found, "time"), value) for value in (3, ["a"], "x" * 1001)),
    ],
)
def test_a_value_of_another_kind_or_out_of_bounds_is_named(
    read: Callable[[dict[str, object]], object], value: object
) -> None:
    with pytest.raises(UnusableMessageError, match=r"^time: (found|is missing)") as refused:
        read({"time": value})
    assert len(str(refused.value)) < 300


def test_no_text_brings_another_exception() -> None:
    draw = random.Random(5)
    for _ in range(2000):
        changed = list(text())
        for _ in range(draw.randint(1, 6)):
            changed[draw.randrange(len(changed))] = draw.choice(string.printable)
        try:
            found = read_report("".join(changed), SCHEMA)
            moment_of(found), count_of(found, "stroke"), text_of(found, "valve")
        except UnusableMessageError:
            continue
