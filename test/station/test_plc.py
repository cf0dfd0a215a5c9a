"""Registers of a PLC and the watchdog, at times that the test says: nothing here waits."""

from __future__ import annotations

import csv
import math
import struct

import pytest

from valve_sim.station.plc import MAP, SPACING, UNKNOWN_PHASE, Coil, PlcStation, map_csv

WATCHDOG = 0.5
VALVES = ("tank_1/valve", "tank_2/valve")
Written = tuple[float, int | None, int | None, bool, int]
"""Time, s; heartbeat and command as written, None: not; whether the coil is then on, and trips so far."""
LIVING = [(0.0, 1, 0, False, 0), (0.1, 2, 0, False, 0), (0.2, 3, 1, True, 0)]


@pytest.mark.parametrize(
    "story",
    [
        pytest.param([*LIVING, (0.7, None, None, True, 0), (0.8, None, 0, False, 1)], id="a living PLC switches it"),
        pytest.param([*LIVING, (0.4, 4, None, True, 0), (0.8999, None, None, True, 0), (0.9001, None, None, False, 1),
                      (5.0, None, None, False, 1)], id="silence trips it once, within the watchdog's time"),
        pytest.param([*LIVING, *((0.2 + 0.1 * k, 3, 1, k <= 5, int(k > 5)) for k in range(9))],
                     id="a heartbeat that stands still is silence"),
        pytest.param([*LIVING, *((10.0 + 0.1 * k, 4 + k, 1, False, 1) for k in range(9)), (11.0, 20, 0, False, 1),
                      (11.1, 21, 1, True, 1)], id="an old 1 opens nothing before a 0"),
        pytest.param([(0.1 * k, k, 1, False, 0) for k in range(9)], id="a 1 at the very start opens nothing"),
        pytest.param([*LIVING, (-1.0, 4, None, True, 0), (0.7, None, None, True, 0), (0.71, None, None, False, 1)],
                     id="a clock that goes back neither trips nor revives"),
    ],
)  # fmt: skip
def test_a_coil_obeys_a_living_plc_only(story: list[Written]) -> None:
    coil = Coil(WATCHDOG)
    for now, heartbeat, command, is_on, trips in story:
        if (heartbeat, command) != (None, None):
            coil.write(heartbeat, command, now)
        assert (coil.is_on(now), coil.trips) == (is_on, trips), now


def test_registers_show_what_was_heard_and_nothing_that_is_stale() -> None:
    station = PlcStation(VALVES, WATCHDOG, stale=1.0)
    names = {register.name: register for register in MAP}

    def value(name: str, now: float, valve: int = 1) -> int:
        return station.read(now)[SPACING * valve + names[name].offset]

    assert value("phase", 0.0) == UNKNOWN_PHASE and value("status", 0.0) == 0b01100
    station.hear(1, 5.0, phase=4, is_open=True, outlet_pressure=35e6)
    assert (value("phase", 5.0), value("is_open", 5.0), value("status", 5.0)) == (4, 1, 0b11101)
    first = SPACING + names["outlet_pressure"].offset
    words = station.read(5.0)[first : first + 2]
    assert pressure_of(words) == 35e6
    assert (value("phase", 6.1), value("is_open", 6.1), value("status", 6.1)) == (UNKNOWN_PHASE, 0, 0b01100)
    assert math.isnan(pressure_of(station.read(6.1)[first : first + 2]))
    assert value("phase", 5.0, valve=0) == UNKNOWN_PHASE, "the other valve was not heard"
    swapped = PlcStation(VALVES, WATCHDOG, low_word_first=True)
    swapped.hear(1, 5.0, outlet_pressure=35e6)
    assert swapped.read(5.0)[first : first + 2] == words[::-1]
    for _ in range(70):
        station.beat()
    assert value("own_heartbeat", 6.1) == 70


def pressure_of(registers: list[int]) -> float:
    """A FLOAT32 of two registers, the high word first."""
    return float(struct.unpack(">f", struct.pack(">2H", *registers))[0])


def test_the_valve_that_was_switched_is_told() -> None:
    switched: list[int] = []
    station = PlcStation(VALVES, WATCHDOG, changed=switched.append)
    for heartbeat, command, now in ((1, 0, 0.0), (2, 0, 0.1), (3, 1, 0.2), (4, 1, 0.3)):
        station.write(SPACING, [heartbeat, command], now)
    assert switched == [1] and station.is_on(1, 0.3) and not station.is_on(0, 0.3)
    assert station.is_heard(1) and not station.is_heard(0)


def test_the_map_for_the_plc_is_that_of_the_code() -> None:
    lines = list(csv.DictReader(map_csv(VALVES).splitlines()))
    assert len(lines) == 2 * len(MAP)
    assert [line["address"] for line in lines if line["name"] == "is_open"] == ["13", "33"]
    assert lines[0]["holding_register"] == "40001"
    taken = [register.offset + k for register in MAP for k in range(register.width)]
    assert len(taken) == len(set(taken)) and max(taken) < SPACING
