"""Whether a current is believed, on plants that share no code with the package."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from plants.common import Plant
from plants.declared import CAMPAIGN_VALVE, DeclaredPlant
from plants.mismatched import BENCH_VALVE, MismatchedPlant
from plants.recording import Recorder, record, train_profile
from valve_sim.identification.selection.current_check import (
    MOVES_NOTHING,
    UNEXPLAINED,
    current_left,
    current_noise_inflation,
)
from valve_sim.identification.selection.table import DECISIVE

from benchmarks.campaign.cases import declared_valve
from identification.selection.made_up_fits import World, switches
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.model import Drive
from valve_sim.traces import Signal, Trace

Entries = Mapping[str, float | tuple[float, ...]]
Effects = dict[str, dict[str, float]]


def problem(plant: Plant, declared: Entries, recorder: Recorder, effects: Effects | None = None) -> Problem:
    made = record(plant, train_profile(), recorder, 3)
    current = None if made.coil_current is None else Signal(made.times, made.coil_current)
    drive = Drive(made.command_times, made.volts)
    trace = Trace("made", drive, made.times, made.pilot_position, coil_current=current)
    return Problem(ValvePlant([trace], replace(declared_valve(declared), effects=effects or {})))


@pytest.mark.parametrize(
    ("effects", "jitter"),
    [({}, 0.0), ({}, 50e-6), ({"drive_gain": {"gain": 0.95}, "coil_lag": {"time_constant": 2e-4}}, 50e-6)],
)
def test_a_current_that_effects_explain_is_believed(effects: dict[str, dict[str, float]], jitter: float) -> None:
    recorder = Recorder(with_current=True, command_jitter=jitter)
    made = problem(DeclaredPlant(effects), CAMPAIGN_VALVE, recorder)
    assert current_noise_inflation(made) == 1.0
    assert 0.9 < current_left(made) < 1.1


def test_a_current_that_dips_while_the_plungers_move_is_believed() -> None:
    """The plant's inductance grows with lift, and nobody declared it."""
    made = problem(MismatchedPlant(), BENCH_VALVE, Recorder(with_current=True))
    assert current_noise_inflation(made) == 1.0
    assert 0.9 < current_left(made) < 1.2


def test_a_current_of_another_form_is_believed_to_what_is_missed_of_it() -> None:
    """The file says that no motion shows in the current, and it does."""
    recorder = Recorder(with_current=True)
    made = problem(MismatchedPlant(), BENCH_VALVE, recorder, {"motional_emf": {"share": 0.0}})
    inflation = current_noise_inflation(made)
    assert inflation > 2.0
    inflated = made.with_inflated_noise("current", inflation)
    assert inflated.noises["current"].innovation == inflation * made.noises["current"].innovation
    assert inflated.noises["position"] == made.noises["position"]


def test_without_a_current_there_is_nothing_to_doubt() -> None:
    made = problem(DeclaredPlant({}), CAMPAIGN_VALVE, Recorder())
    assert current_left(made) == 0.0
    assert current_noise_inflation(made) == 1.0


# -- the search for effects of the current, on fits that are written down ----------------------------------------------


class Searched:
    """A current that the declared model misses by 5 standard deviations, and what was fitted to it."""

    def __init__(
        self,
        patch: pytest.MonkeyPatch,
        scores: Mapping[str, float],
        misses: Mapping[str, float],
        names: str = "abc",
        **more: Any,
    ) -> None:
        world = World(scores, switches(names), misses={"": 5.0, "'": 4.0, **misses}, timing=True, **more).use(patch)
        # All effects but z move the current just enough to be effects of the coil.
        world.missed = lambda values: (
            5.0 + sum(MOVES_NOTHING * (1.01 if name < "z" else 0.99) for name in names if values.get(f"{name}.size"))
        )
        channels = [SimpleNamespace(role=role) for role in ("response", "actuation")]
        world.problem.plant.channels = channels
        world.problem.weight = lambda index: np.ones(3)
        world.problem.restricted = self.restricted
        self.problem = world.problem
        self.left = current_left(self.problem)
        self.tried = {key for key, *_ in world.starts}

    def restricted(self, takes_part: Callable[[int, Any], Any]) -> Any:
        assert [list(takes_part(index, None)) for index in (0, 1)] == [[False] * 3, [True] * 3]
        return self.problem


def test_a_current_that_is_hardly_missed_needs_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    found = Searched(monkeypatch, {"": 900.0}, {"": UNEXPLAINED})
    assert (found.left, found.tried) == (UNEXPLAINED, {""})
    assert current_noise_inflation(found.problem) == 1.0
    assert current_noise_inflation(Searched(monkeypatch, {"": 900.0}, {"": 1.6}, "").problem) == 1.6


def test_late_stamps_are_tried_before_any_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    found = Searched(monkeypatch, {"": 900.0}, {"'": UNEXPLAINED})
    assert (found.left, found.tried) == (UNEXPLAINED, {"", "'"})


@pytest.mark.parametrize(("third", "left"), [(300.0 - DECISIVE + 0.1, 2.0), (300.0 - DECISIVE, 1.8)])
def test_effects_are_added_while_they_are_decisive(monkeypatch: pytest.MonkeyPatch, third: float, left: float) -> None:
    scores = {"": 900.0, "a": 500.0, "b": 600.0, "ab": 300.0, "abc": third}
    found = Searched(monkeypatch, scores, {"a": 3.0, "ab": 2.0, "abc": 1.8, "ab'": 1.9, "abc'": 1.7})
    assert found.left == pytest.approx(left)
    assert {"a", "b", "c", "ab", "ac", "abc"} <= found.tried
    assert "bc" not in found.tried
    # Errors of the stamps beside them count where they explain the rest.
    timed = Searched(monkeypatch, scores, {"ab": 2.0, "abc": 1.8, "ab'": 1.4, "abc'": 1.4})
    assert timed.left == 1.4


def test_no_more_than_four_effects_explain_a_current(monkeypatch: pytest.MonkeyPatch) -> None:
    names = "abcde"
    scores = {names[:count]: 900.0 - 100.0 * count for count in range(6)}
    found = Searched(monkeypatch, scores, {"abcd": 2.5, "abcde": 1.0}, names)
    assert found.left == 2.5
    assert max(map(len, found.tried)) == len("abcd'")


def test_what_does_not_move_the_current_is_no_effect_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    found = Searched(monkeypatch, {"": 900.0, "z": 100.0}, {"z": 1.0}, "az")
    assert found.left == 5.0
    assert "z" not in found.tried
    # Where none does, stamps are all there is.
    assert Searched(monkeypatch, {"": 900.0}, {}, "z").left == 5.0


def test_without_time_it_is_inflated_by_what_the_declared_model_misses(monkeypatch: pytest.MonkeyPatch) -> None:
    found = Searched(monkeypatch, {"": 900.0, "a": 100.0}, {"a": 1.0}, out_of_time=("b",))
    assert found.left == 5.0
