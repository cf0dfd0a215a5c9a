"""Which strokes are held out: of each condition some, of none all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from identification.fit.linear_plant import SAMPLES, LinearPlant, measured
from valve_sim.identification.plants.hold_out import held_out_strokes


class Levels(LinearPlant):
    """A plant each stroke of which was made under the level of that place."""

    def __init__(self, levels: list[float]) -> None:
        super().__init__(measured())
        self.levels = levels
        group = np.arange(SAMPLES) * len(levels) // SAMPLES
        self.channels = [replace(self.channels[0], group=group)]

    def condition_of(self, recording: int, group: int) -> tuple[float, ...]:
        return (self.levels[group],)


def held(levels: list[float]) -> list[float]:
    """The levels of the strokes that are held out."""
    return [levels[group] for _, group in sorted(held_out_strokes(Levels(levels)))]


@pytest.mark.parametrize("rounds", [1, 2, 3, 4, 6, 12])
def test_no_condition_is_held_out_that_training_never_sees(rounds: int) -> None:
    """Of voltages in turns every fourth stroke was at 11 V."""
    voltages = [7.5, 9.0, 14.0, 11.0]
    levels = voltages * rounds
    out = held(levels)
    if rounds > 1:
        assert all(0 < out.count(volts) < rounds for volts in set(out))
    if rounds >= 3:
        assert set(out) == set(voltages)
    assert len(levels) / 5 <= len(out) <= len(levels) / 3


def test_where_each_stroke_has_its_own_condition_those_between_others_are_held_out() -> None:
    levels = [9.0, 12.0, 7.5, 14.0, 10.3, 8.4, 13.0, 11.2]
    assert sorted(held(levels)) == [9.0, 13.0]
    assert 7.5 not in held([9.0, 7.5, 14.0, 11.0])


def test_a_condition_beside_ones_that_repeat_is_not_held_out() -> None:
    assert held([9.0, 9.0, 9.0, 9.0, 20.0, 1.0]) == [9.0]


def test_fewer_than_four_are_all_for_training_and_without_conditions_order_decides() -> None:
    assert held([9.0, 9.0, 9.0]) == []
    assert held_out_strokes(LinearPlant(measured())) == {(0, 2), (0, 6)}
