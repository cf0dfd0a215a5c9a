"""A machine of a plant file that is stepped, against one whole run of it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from valve_sim.files.plant_files import PlantFile, load_plant, plant_from
from valve_sim.identification.plants.own_simulation import simulate_plant
from valve_sim.model import SimulationError
from valve_sim.model.core.own.simulation import Machine
from valve_sim.model.machine_stepper import Channels, MachineStepper
from valve_sim.recordings.columns import read

PLANT = Path(__file__).parents[2] / "docs" / "examples" / "own_plants" / "single_plunger.yaml"


def numbers_of(file: PlantFile) -> dict[str, float]:
    return {name: own.value for name, own in file.parameters.items()}


def stepper_of(file: PlantFile, **delays: float) -> MachineStepper:
    start = {name: own.start or 0.0 for name, own in file.states.items()}
    delay = file.inputs["voltage"].delay
    return MachineStepper(Machine(file.equations(), ()), Channels(delays, "mode"), numbers_of(file), start, delay)


def late_valve() -> PlantFile:
    """The valve of one's own whose coil hears its commands late, and whose sensor shows positions late."""
    text = PLANT.read_text().replace("between: held", "between: held, delay: 1.3e-3")
    return plant_from(yaml.safe_load(text.replace("noise: 0.5", "noise: 0.5, delay: 2.7e-3")), "late.yaml")


@pytest.mark.parametrize("file", [load_plant(PLANT), late_valve()], ids=["prompt", "late"])
def test_it_shows_what_simulate_shows_to_the_bit_however_time_is_cut(file: PlantFile, tmp_path: Path) -> None:
    commands = [(0.0, 0.0), (1.234567e-3, 24.0), (30.000001e-3, 0.0), (50e-3, 24.0), (52e-3, 0.0)]
    times = np.unique(np.concatenate([np.random.default_rng(3).uniform(0.0, 0.08, 300), [at for at, _ in commands]]))
    levels = [next(volts for at, volts in reversed(commands) if at <= time) for time in times]
    rows = [f"{time!r},{volts}" for time, volts in zip(times.tolist(), levels, strict=True)]
    (tmp_path / "log.csv").write_text("time,voltage\n" + "\n".join(rows) + "\n")
    (tmp_path / "map.yaml").write_text("time: {column: time, unit: s}\nvoltage: {column: voltage, unit: V}\n")
    shown = simulate_plant(file, read(tmp_path / "log.csv", tmp_path / "map.yaml"))

    stepper, waiting, found, events = stepper_of(file, position=file.outputs["position"].delay), commands[1:], [], []
    for time in times.tolist():
        while waiting and waiting[0][0] <= time:
            stepper.command(*waiting.pop(0))
        reading = stepper.advance(time)
        found.append(reading.pilot_position / file.outputs["position"].unit.factor)
        events += reading.events
    assert np.array_equal(shown.columns["time"], times)
    assert np.array_equal(shown.columns["position"], found)
    assert events == [event for event in shown.events if event.time <= times[-1]]
    assert max(found) > 1000.0


def test_its_modes_are_phases_of_which_a_brief_one_is_not_left_out() -> None:
    stepper = stepper_of(load_plant(PLANT), position=0.0)
    assert (stepper.advance(0.0).phase, stepper.volts) == (0, 0.0)
    before, after = stepper.command(0.0, 24.0)
    assert (before.voltage, after.voltage) == (0.0, 24.0)
    assert math.isnan(after.current), "no output is named current"
    opened = stepper.advance(0.03)
    assert opened.entered[:2] == (1, 2), "moving, then pressed"
    assert (opened.phase, opened.modes) == (2, {"mode": "pressed"})
    assert opened.events[0].name == "unseated"
    stepper.reset(1.0)
    rested = stepper.advance(1.0)
    assert (rested.phase, rested.pilot_position, stepper.volts) == (0, 0.0, 0.0)


LAG = """
plant: equations
states: {x: {unit: m}}
inputs: {voltage: {unit: V, between: held}}
parameters: {gain: {value: 1, unit: mm/V}, tau: {value: 10, unit: ms}, limit: {value: 6, unit: mm}}
derivatives: {x: (gain*voltage - x)/tau}
outputs: {position: {value: x, unit: m}}
modes: {below: {}, above: {}}
transitions:
  - {from: below, when: x > limit, cases: [{to: above}]}
  - {from: above, when: x < limit, cases: [{to: below}]}
"""


def test_other_parameters_act_from_their_time_on_and_states_go_on() -> None:
    file = plant_from(yaml.safe_load(LAG), "lag.yaml")
    stepper, numbers = stepper_of(file, position=0.0), numbers_of(file)
    stepper.command(0.0, 10.0)
    before = stepper.advance(6e-3)
    stepper.set_numbers(6e-3, {**numbers, "tau": 2e-3})
    assert stepper.advance(6e-3).pilot_position == before.pilot_position == pytest.approx(0.01 * -np.expm1(-0.6))
    later = stepper.advance(8e-3)
    assert later.pilot_position == pytest.approx(0.01 - 0.01 * np.exp(-0.6 - 1.0), abs=1e-12)
    assert (later.phase, later.entered) == (1, (1,))
    stepper.set_numbers(8e-3, {**numbers, "limit": 9e-3})
    assert stepper.advance(8e-3).entered == (0,), "a comparison that holds at once acts at once"
    with pytest.raises(SimulationError):
        stepper.set_numbers(9e-3, {**numbers, "tau": 0.0})
    stepper.reset(1.0)
    stepper.command(1.0, 10.0)
    assert stepper.advance(1.01).pilot_position == pytest.approx(0.01 * -np.expm1(-1.0)), "the refused ones are gone"
