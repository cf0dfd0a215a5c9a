"""What others send, read within bounds: whatever it is, a value or one line that says why not."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from valve_sim.nodes.heard import UnusableMessageError, count_of, moment_of, number_of, text_of


def test_a_number_is_what_was_sent() -> None:
    found = {"time": "1.7e9", "stroke": "3", "valve": "/valve", "t1": None, "p": "0.25"}
    assert (moment_of(found), count_of(found, "stroke"), text_of(found, "valve")) == (1.7e9, 3, "/valve")
    assert (number_of(found, "t1"), number_of(found, "none"), number_of(found, "p", 0.0, 1.0)) == (None, None, 0.25)


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
