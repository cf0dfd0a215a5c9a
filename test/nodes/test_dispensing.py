"""Cascade filling without ROS: the order of the tanks, when the next one opens, and where every gram of gas is."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import pytest

from valve_sim.files.parameter_files import load_valve
from valve_sim.model import EventKind, Stepper
from valve_sim.station.dispenser import Dispensed, Dispenser
from valve_sim.station.tables import DispenserSettings

CONFIG = Path(__file__).parents[2] / "config"
MEGA = 1e6


class OpenPipes:
    """Valves without delay: the pipe behind one has the tank's pressure while it is open, and else that of the line."""

    def __init__(self, **settings: object) -> None:
        self.settings = DispenserSettings.read(settings, {})
        self.dispenser = Dispenser(self.settings)
        self.said: list[str] = []
        self.shown: list[Dispensed] = []

    def run(self, start: float, end: float, period: float = 0.05) -> None:
        for k in range(round(start / period), round(end / period)):
            before = self.shown[-1] if self.shown else None
            for valve, tank in enumerate(self.dispenser.tank_pressures):
                is_open = before is not None and before.volts[valve] > 0.0
                self.dispenser.hear(valve, tank if is_open else self.dispenser.line_pressure)
            self.shown.append(self.dispenser.step(k * period))
            self.said += self.shown[-1].words

    @property
    def opened(self) -> list[int]:
        """Numbers of the valves in the order in which they were opened."""
        volts = [(0.0,) * len(self.settings.valves), *(shown.volts for shown in self.shown)]
        return [
            valve
            for before, after in itertools.pairwise(volts)
            for valve in range(len(after))
            if after[valve] > before[valve]
        ]


def balance(dispenser: Dispenser) -> float:
    """What there is and what has left, less what came, kg."""
    return dispenser.mass + dispenser.taken + dispenser.vented - dispenser.brought - dispenser.drawn


def test_tanks_open_in_rising_order_of_their_pressures_one_at_a_time() -> None:
    plant = OpenPipes(tank_pressures=[32.0 * MEGA, 20.0 * MEGA, 26.0 * MEGA])
    plant.run(0.0, 40.0)
    assert plant.opened[:6] == [1, 2, 0, 1, 2, 0]
    assert all(sum(volts > 0.0 for volts in shown.volts) <= 1 for shown in plant.shown)
    assert {volts for shown in plant.shown for volts in shown.volts} == {0.0, 9.0}
    assert plant.dispenser.filled >= 2


def test_the_next_opens_when_the_pressure_of_the_last_is_near_that_of_the_line() -> None:
    plant = OpenPipes(least_difference=3.0 * MEGA)
    plant.run(0.0, 12.0)
    for valve, tank in enumerate(plant.settings.tank_pressures[:2]):
        at_end = [shown for shown in plant.shown if shown.volts[valve] > 0.0][-1]
        assert at_end.line_pressure == pytest.approx(tank - 3.0 * MEGA, rel=0.02)


def test_the_next_opens_when_too_little_flows() -> None:
    plant = OpenPipes(least_difference=0.0, least_flow=1.5e-5)
    plant.run(0.0, 14.0)
    assert plant.opened[:3] == [0, 1, 2]
    second = next(shown for shown in plant.shown if shown.volts[1] > 0.0)
    assert 16.0 * MEGA < second.line_pressure < 20.0 * MEGA


def test_a_valve_that_does_not_open_is_passed_over() -> None:
    dispenser = Dispenser(DispenserSettings(least_open=0.5))
    for k in range(25):
        for valve in range(3):
            dispenser.hear(valve, dispenser.line_pressure)
        shown = dispenser.step(0.05 * k)
    assert shown.volts == (0.0, 0.0, 9.0)


def test_tanks_that_are_spent_end_it_below_the_target_and_it_begins_again() -> None:
    plant = OpenPipes(target_pressure=60.0 * MEGA, pause=1.0)
    plant.run(0.0, 25.0)
    assert any("no tank gives any more, at 31.0 MPa in the vehicle of 60.0 wanted" in words for words in plant.said)
    assert plant.opened[:4] == [0, 1, 2, 0]
    assert plant.dispenser.filled == 0


def test_nothing_opens_before_every_valve_has_been_heard() -> None:
    dispenser = Dispenser(DispenserSettings())
    dispenser.hear(0, 2.0 * MEGA)
    assert not dispenser.hear(1, math.nan)
    dispenser.hear(2, 2.0 * MEGA)
    assert dispenser.unheard == ["tank_2/valve"]
    assert dispenser.step(0.0).volts == (0.0, 0.0, 0.0)
    dispenser.hear(1, 2.0 * MEGA)
    assert dispenser.step(1.0).volts == (9.0, 0.0, 0.0)


def test_a_clock_that_begins_anew_closes_all_and_begins_again() -> None:
    plant = OpenPipes()
    plant.run(0.0, 2.0)
    before = balance(plant.dispenser)
    plant.dispenser.restart()
    assert not plant.dispenser.is_filling
    plant.run(0.0, 2.0)
    assert plant.shown[-1].volts[0] == 9.0
    assert balance(plant.dispenser) == pytest.approx(before, rel=1e-12)


@pytest.mark.parametrize("volumes", [(0.05, 0.05, 0.05), (2e-4, 0.0, 3e-4), (0.0, 0.0, 0.0)])
def test_the_balance_of_mass_holds(volumes: tuple[float, ...]) -> None:
    plant = OpenPipes(tank_volumes=volumes)
    before = balance(plant.dispenser)
    plant.run(0.0, 40.0)
    assert plant.dispenser.filled >= 2
    assert balance(plant.dispenser) == pytest.approx(before, abs=1e-9 * plant.dispenser.taken)
    assert [
        pressure for pressure, volume in zip(plant.shown[-1].tank_pressures, volumes, strict=True) if not volume
    ] == [pressure for pressure, volume in zip(plant.settings.tank_pressures, volumes, strict=True) if not volume]


@pytest.mark.long
def test_the_valves_of_the_station_fill_a_vehicle() -> None:
    """The models of the three valves, which obey what is published to them: all open fully, from lowest to highest."""
    dispenser, steppers = Dispenser(DispenserSettings()), []
    for number in (1, 2, 3):
        steppers.append(Stepper(load_valve(CONFIG / f"gas_tank_{number}.yaml")))
    volts, opened = (0.0, 0.0, 0.0), []
    before = balance(dispenser)
    for k in range(round(12.0 / 0.05)):
        time = 0.05 * k
        for valve, stepper in enumerate(steppers):
            reading = stepper.advance(time)
            dispenser.hear(valve, reading.outlet_pressure)
            opened += [valve for event in reading.events if event.kind is EventKind.REACHED_STOP]
        shown = dispenser.step(time)
        for valve, stepper in enumerate(steppers):
            if shown.volts[valve] != volts[valve]:
                stepper.command(time, shown.volts[valve])
            stepper.set_demand_pressure(time, shown.line_pressure)
            stepper.supply(time, shown.tank_pressures[valve])
        volts = shown.volts
    assert (opened, dispenser.filled) == ([0, 1, 2], 1)
    assert shown.vehicle_pressure == pytest.approx(28.0 * MEGA, rel=0.01)
    for pressure, start in zip(shown.tank_pressures, DispenserSettings().tank_pressures, strict=True):
        assert start - 0.02 * MEGA < pressure < start
    assert balance(dispenser) == pytest.approx(before, abs=1e-9 * dispenser.mass)
