"""Registers of a PLC and the watchdog, at times that the test says: nothing here waits."""

from __future__ import annotations

import csv
import math
import random
import struct

import pytest

from valve_sim.station.plc import (
    MAP,
    SPACING,
    UNKNOWN_PHASE,
    Coil,
    PlcStation,
    RefusedError,
    map_csv,
)

WATCHDOG = 0.5
VALVES = ("tank_1/valve", "tank_2/valve")


def living(start: float = 0.0) -> Coil:
    """A coil whose PLC lives and has written 0."""
    coil = Coil(WATCHDOG)
    coil.write(1, 0, start)
    coil.write(2, 0, start + 0.1)
    return coil


def test_a_living_plc_switches_the_coil() -> None:
    coil = living()
    assert not coil.is_on(0.1)
    coil.write(3, 1, 0.2)
    assert coil.is_on(0.2) and coil.is_on(0.2 + WATCHDOG)
    coil.write(None, 0, 0.3)
    assert not coil.is_on(0.3) and coil.trips == 0


def test_a_silent_plc_is_de_energised_within_the_watchdogs_time_and_not_before() -> None:
    coil = living()
    coil.write(3, 1, 0.2)
    coil.write(4, None, 0.4)
    assert coil.is_on(0.4 + WATCHDOG - 1e-6)
    assert not coil.is_on(0.4 + WATCHDOG + 1e-6)
    assert coil.trips == 1
    assert not coil.is_on(5.0) and coil.trips == 1, "one silence is one trip"


def test_a_heartbeat_that_stands_still_is_silence_however_often_it_is_written() -> None:
    coil = living()
    for k in range(200):
        coil.write(3, 1, 0.2 + 0.01 * k)
    assert not coil.is_on(0.2 + 2.0) and coil.trips == 1


@pytest.mark.parametrize("heartbeat", [5, 6])
def test_a_plc_that_comes_back_with_an_old_1_opens_nothing_before_it_has_written_0(heartbeat: int) -> None:
    coil = living()
    coil.write(5, 1, 0.2)
    for k in range(20):  # it comes back after a silence and beats again, its command still 1
        coil.write(heartbeat + k, 1, 10.0 + 0.1 * k)
        assert not coil.is_on(10.0 + 0.1 * k)
    coil.write(100, 0, 12.0)
    coil.write(101, 1, 12.1)
    assert coil.is_on(12.1)


def test_a_1_at_the_very_start_opens_nothing() -> None:
    coil = Coil(WATCHDOG)
    for k in range(10):
        coil.write(k, 1, 0.1 * k)
    assert not coil.is_on(1.0) and coil.trips == 0


def test_a_clock_that_stands_still_or_goes_back_neither_trips_nor_revives() -> None:
    coil = living(10.0)
    coil.write(3, 1, 10.2)
    assert coil.is_on(10.2) and coil.is_on(9.0)
    coil.write(4, None, 9.5)
    assert coil.is_on(10.2 + WATCHDOG) and not coil.is_on(10.2 + WATCHDOG + 1e-6)


def test_no_coil_is_energised_against_the_rules_whatever_is_written_when() -> None:
    source = random.Random(7)
    for _ in range(200):
        coil, now, beat_at, last, command, is_armed = Coil(WATCHDOG), 0.0, -math.inf, None, 0, False
        for _ in range(200):
            now += source.choice((0.0, 0.01, 0.1, 0.4, 0.49, 0.51, 2.0))
            is_armed = is_armed and now - beat_at <= WATCHDOG
            heartbeat = source.choice((None, last, (last or 0) + 1, source.randrange(65536)))
            written = source.choice((None, 0, 1))
            coil.write(heartbeat, written, now)
            if heartbeat is not None:
                beat_at = now if last is not None and heartbeat != last else beat_at
                last = heartbeat
            command = command if written is None else written
            is_alive = now - beat_at <= WATCHDOG
            is_armed = is_alive and (is_armed or command == 0)
            assert coil.is_on(now) == (is_armed and command == 1)


def test_registers_show_what_was_heard_and_nothing_that_is_stale() -> None:
    station = PlcStation(VALVES, WATCHDOG, stale=1.0)
    names = {register.name: register for register in MAP}

    def value(name: str, now: float, valve: int = 1) -> int:
        return station.read(now)[SPACING * valve + names[name].offset]

    assert value("phase", 0.0) == UNKNOWN_PHASE and value("status", 0.0) == 0b01100
    station.hear(1, 5.0, phase=4, is_open=True, outlet_pressure=35e6)
    assert (value("phase", 5.0), value("is_open", 5.0), value("status", 5.0)) == (4, 1, 0b11101)
    first = SPACING + names["outlet_pressure"].offset
    assert pressure_of(station.read(5.0)[first : first + 2]) == 35e6
    assert (value("phase", 6.1), value("is_open", 6.1), value("status", 6.1)) == (UNKNOWN_PHASE, 0, 0b01100)
    assert math.isnan(pressure_of(station.read(6.1)[first : first + 2]))
    assert value("phase", 5.0, valve=0) == UNKNOWN_PHASE, "the other valve was not heard"
    swapped = PlcStation(VALVES, WATCHDOG, low_word_first=True)
    swapped.hear(1, 5.0, outlet_pressure=35e6)
    assert swapped.read(5.0)[first : first + 2] == station_words(35e6)[::-1]


def pressure_of(registers: list[int]) -> float:
    """A FLOAT32 of two registers, the high word first."""
    return float(struct.unpack(">f", struct.pack(">2H", *registers))[0])


def station_words(value: float) -> list[int]:
    station = PlcStation(("v",), WATCHDOG)
    station.hear(0, 0.0, outlet_pressure=value)
    return station.read(0.0)[14:16]


def test_a_write_counts_whole_or_not_at_all() -> None:
    switched: list[int] = []
    station = PlcStation(VALVES, WATCHDOG, changed=switched.append)
    for heartbeat, now in ((1, 0.0), (2, 0.1)):
        station.write(SPACING, [heartbeat, 0], now)
    station.write(SPACING, [3, 1], 0.2)
    assert switched == [1] and station.is_on(1, 0.2) and not station.is_on(0, 0.2)
    for address, values in (
        (SPACING, [4, 2]),
        (SPACING + 1, [0, 7]),
        (10, [1]),
        (-1, [0, 0]),
        (40, [0]),
        (1, [0xFFFF]),
    ):
        with pytest.raises(RefusedError):
            station.write(address, values, 0.3)
    assert station.read(0.3)[SPACING : SPACING + 2] == [3, 1]
    assert not station.is_on(1, 0.8) and station.read(0.8)[SPACING + 17] == 1
    for _ in range(70):
        station.beat()
    assert station.read(0.8)[16] == 70


def test_the_map_for_the_plc_is_that_of_the_code() -> None:
    lines = list(csv.DictReader(map_csv(VALVES).splitlines()))
    assert len(lines) == 2 * len(MAP)
    assert [line["address"] for line in lines if line["name"] == "is_open"] == ["13", "33"]
    assert lines[0]["holding_register"] == "40001"
    taken = [register.offset + k for register in MAP for k in range(register.width)]
    assert len(taken) == len(set(taken)) and max(taken) < SPACING
