"""What the package says of the shipped recordings is what the golden table has; `make golden` writes it anew."""

from __future__ import annotations

from typing import Any

import pytest
from golden_table import PARTS, Entry, changes, read, said
from shipped import BAGS

SHORT = {"friction", "one_opening"}
"""Of these the diagnosis is made in the short tests, too."""


def changed(entry: Entry) -> Any:
    """A value that is wrong: a number by twice its tolerance, anything else in any way."""
    if entry.tolerance is not None:
        return entry.value + 2.0 * entry.tolerance
    return entry.value + 1 if isinstance(entry.value, int) else [*entry.value, "another"]


@pytest.mark.parametrize(
    ("name", "part"),
    [
        pytest.param(name, part, marks=[pytest.mark.long] if part == "diagnose" and name not in SHORT else [])
        for name in BAGS
        for part in PARTS
    ],
)
def test_a_shipped_recording_is_told_as_before(name: str, part: str) -> None:
    golden = {key: entry for key, entry in read(name).items() if key.startswith(part)}
    now = said(name, [part])
    assert {key: (now.get(key), golden.get(key)) for key in changes(golden, now)} == {}


@pytest.mark.parametrize("name", BAGS)
def test_every_change_beyond_tolerance_is_noticed(name: str) -> None:
    golden = read(name)
    for key, entry in golden.items():
        assert entry.tolerance is None or entry.tolerance > 0.0
        assert changes(golden, {**golden, key: Entry(changed(entry))}) == [key]
        assert changes(golden, {other: own for other, own in golden.items() if other != key}) == [key]
