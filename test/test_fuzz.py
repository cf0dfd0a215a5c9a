"""What the fuzzer once found, and a few inputs more: each is taken, or refused in one line."""

import pytest

from benchmarks.fuzz import attempt

ONCE_FOUND = {
    "bags": (242, 457, 777, 799, 935, 1266, 1644, 1942, 2009, 2504, 2643, 4323, 4357),
    "parameter files": (410, 2431, 2544),
    "command lines": (143, 447, 681, 1279, 1307, 1716),
}


@pytest.mark.long
@pytest.mark.parametrize(("surface", "number"), [(name, n) for name, found in ONCE_FOUND.items() for n in found])
def test_what_was_found_once_is_mended(surface: str, number: int) -> None:
    what, finding = attempt(surface, number)
    assert what != "finding", finding


LONGER = {"bags": 60, "parameter files": 200, "valves": 1000, "command lines": 30, "tables": 100}


@pytest.mark.parametrize(
    ("surface", "count"), [("valves", 150), *(pytest.param(*own, marks=pytest.mark.long) for own in LONGER.items())]
)
def test_bad_input_is_taken_or_refused(surface: str, count: int) -> None:
    numbers = range(1_000_000, 1_000_000 + count)
    findings = [finding for number in numbers if (finding := attempt(surface, number)[1])]
    assert findings == []
