"""A valve with one plunger: the model's events against SciPy's, its derivatives, and what is refused beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from plants.single_plunger import SINGLE_VALVE, SinglePlungerPlant

from model.core.cases import PLANT_EVENTS
from model.derivatives import ACCURACY, Case, errors_of
from valve_sim.model import Drive, EventKind, ParameterError, Phase, Stepper, Valve, published_times, simulate
from valve_sim.model.parameters import UNUSED_BY_ONE_PLUNGER

STROKES = Drive.of([1e-3, 26e-3, 48e-3, 58e-3, 70e-3, 90e-3], [24.0, 0.0, 30.0, 0.0, 20.0, 0.0])
TIMES = np.arange(0.0, 0.12, 2e-4)
EFFECTS: tuple[dict[str, dict[str, float]], ...] = (
    {},
    {"coulomb_friction": {"force": 0.3}},
    {"pressure_force": {"force": 1.2, "equalisation_time": 4e-3}},
    {"stop_bounce": {"restitution_stop": 0.4, "restitution_seat": 0.3}},
    {
        "coulomb_friction": {"force": 0.1},
        "pressure_force": {"force": 0.8, "equalisation_time": 2e-3},
        "stop_bounce": {"restitution_stop": 0.3, "restitution_seat": 0.1},
    },
)


def one_plunger(effects: Mapping[str, Mapping[str, float]] | None = None, **values: Any) -> Valve:
    """The valve of the independent plant, with values replaced."""
    declared = {**SINGLE_VALVE, "pilot_gap": 0.0, **values}
    declared["attraction_polynomial"] = list(np.asarray(declared["attraction_polynomial"]).tolist())
    return Valve.from_mapping({"valve": declared, "effects": effects or {}}, "one_plunger.yaml")


@pytest.mark.parametrize("effects", EFFECTS, ids=lambda effects: "+".join(effects) or "plain")
def test_events_and_motion_are_those_of_an_independent_plant(effects: Mapping[str, Mapping[str, float]]) -> None:
    seat_load = 2.9 if "coulomb_friction" in effects else 0.0
    ours = simulate(one_plunger(effects, seat_load=seat_load), STROKES, TIMES, start_time=0.0)
    plant = SinglePlungerPlant({"seat_load": seat_load}, effects)
    truth = plant.simulate(STROKES.times, STROKES.volts, TIMES)
    assert [event.kind for event in ours.events] == [PLANT_EVENTS[event.kind] for event in truth.events]
    assert len(truth.events) >= 8
    for found, true in zip(ours.events, truth.events, strict=True):
        assert found.time == pytest.approx(true.time, abs=1e-9, rel=0.0)
        assert found.velocity == pytest.approx(true.velocity, abs=1e-6, rel=0.0)
    assert np.max(np.abs(ours.pilot_position - truth.pilot_position)) < 1e-9
    assert np.max(np.abs(ours.coil_current - truth.coil_current)) < 1e-9


def test_both_joints_are_the_plunger_and_t1_is_when_it_leaves_its_seat() -> None:
    found = simulate(one_plunger({"sensor_bandwidth": {"cutoff_frequency": 900.0}}), STROKES, TIMES, start_time=0.0)
    assert np.array_equal(found.pilot_position, found.main_position)
    assert set(found.phase.tolist()) == {Phase.CLOSED, Phase.MAIN, Phase.OPEN}
    assert published_times(found) == (found.first(EventKind.UNSEATED), found.first(EventKind.REACHED_STOP))


@pytest.mark.parametrize("effects", EFFECTS, ids=lambda effects: "+".join(effects) or "plain")
def test_derivatives_pass_every_event(effects: Mapping[str, Mapping[str, float]]) -> None:
    case = Case(one_plunger(effects), Drive.of([1e-3, 31e-3], [24.0, 0.0]))
    names = [name for name in case.names() if name not in UNUSED_BY_ONE_PLUNGER]
    for name, errors in errors_of(case, names).items():
        assert errors, name
        # As the bouncing plunger comes to rest, quotients have six digits.
        assert min(errors) < (1e-5 if "stop_bounce" in effects and len(effects) > 1 else ACCURACY), f"{name}: {errors}"


def test_phase_1_and_the_pick_up_change_nothing() -> None:
    plain = simulate(one_plunger(), STROKES, TIMES)
    other = simulate(one_plunger(pilot_mass=1.0, pilot_damping=50.0, pickup_velocity_ratio=0.2), STROKES, TIMES)
    assert np.array_equal(plain.pilot_position, other.pilot_position)


def test_a_running_valve_can_be_given_one_plunger_and_two() -> None:
    two = replace(Valve(), parameters=one_plunger().parameters._replace(pilot_gap=0.2e-3, pilot_mass=0.004))
    stepper = Stepper(two)
    stepper.command(0.0, 24.0)
    before = stepper.advance(0.0065)
    assert before.phase is Phase.PILOT
    stepper.set_valve(one_plunger(), 0.0065)
    after = stepper.advance(0.0065)
    assert after.phase is Phase.MAIN
    assert after.pilot_position == before.pilot_position
    assert stepper.advance(0.04).phase is Phase.OPEN
    stepper.set_valve(two, 0.04)
    stepper.command(0.04, 0.0)
    assert stepper.advance(0.1).phase is Phase.CLOSED


GAS = {
    "inlet_pressure": 35e6, "outlet_volume": 1e-5, "pilot_orifice_diameter": 2e-4, "main_orifice_diameter": 3e-3,
    "seat_diameter": 4e-3,
}  # fmt: skip
REFUSED: tuple[tuple[dict[str, Any], str], ...] = (
    ({"effects": {"gap_offset": {"offset": 1e-6}}}, "effects.gap_offset: found beside valve.pilot_gap 0"),
    ({"effects": {"pickup_impact": {"velocity_ratio": 0.9}}}, "effects.pickup_impact: found beside valve.pilot_gap 0"),
    ({"gas": GAS}, "gas: found beside valve.pilot_gap 0"),
    *(({"tolerances": {name: 0.01}}, f"tolerances.{name}: found 0.01, but") for name in UNUSED_BY_ONE_PLUNGER),
    ({"valve": {"moving_mass": 22}}, "valve.moving_mass: found 22, expected a number above 0 to 5 kg; in kg, 22 g are"),
    ({"valve": {"moving_mass": "heavy"}}, "found 'heavy', expected a number in kg"),
    ({"valve": {"pilot_gap": 1e-3}}, "or a pilot_gap of 0 for a valve with one plunger"),
)


@pytest.mark.parametrize(("values", "message"), REFUSED, ids=[message.partition(":")[0] for _, message in REFUSED])
def test_what_needs_two_plungers_or_is_in_another_unit_is_refused(values: dict[str, Any], message: str) -> None:
    mapping = one_plunger().to_mapping()
    mapping |= {**values, "valve": {**mapping["valve"], **values.get("valve", {})}}
    with pytest.raises(ParameterError) as refusal:
        Valve.from_mapping(mapping, "mine.yaml")
    assert message in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_gap_that_an_effect_makes_zero_is_not_a_valve_with_one_plunger() -> None:
    with pytest.raises(ParameterError, match=r"\(with effects\): valve\.pilot_gap: found 0 m"):
        Valve.from_mapping({"effects": {"gap_offset": {"offset": -0.26e-3}}}, "mine.yaml")
