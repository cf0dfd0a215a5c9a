"""A machine with contacts from its file: simulated, refitted, and what is wrong in a file said in one line."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from click.testing import CliRunner
from numpy.typing import NDArray

from valve_sim.cli import main
from valve_sim.files.parameter_files import load_valve
from valve_sim.files.plant_entries import PlantFileError
from valve_sim.files.plant_files import load_plant, plant_from
from valve_sim.model import Drive, simulate
from valve_sim.model.core.own.simulation import Inputs, Machine

PLUNGER = Path(__file__).parents[1] / "docs" / "examples" / "own_plants" / "plunger.yaml"
Array = NDArray[np.float64]


def bounces(times: Array, preload: float, restitution: float) -> Array:
    """Position of the plunger, m, from closed forms: dropped from 2 mm, and lifted by 3 N for 4 ms at 0.3 s."""
    fall, position = preload / 0.1 + 9.81, np.zeros(len(times))

    def flies(begin: float, height: float, speed: float) -> None:
        while True:
            lasts = (speed + np.sqrt(speed**2 + 2.0 * fall * height)) / fall
            here = (times >= begin) & (times < begin + lasts)
            after = times[here] - begin
            position[here] = height + speed * after - 0.5 * fall * after**2
            arrives, begin, height = fall * lasts - speed, begin + lasts, 0.0
            if arrives <= 5e-3:
                return
            speed = restitution * arrives

    flies(0.0, 2e-3, 0.0)
    rise = (3.0 - preload) / 0.1 - 9.81
    lifted = (times >= 0.3) & (times < 0.304)
    position[lifted] = 0.5 * rise * (times[lifted] - 0.3) ** 2
    flies(0.304, 0.5 * rise * 4e-3**2, rise * 4e-3)
    return position


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    times = np.arange(0.0, 0.6, 5e-4)
    force = np.where((times >= 0.2999) & (times < 0.3039), 3.0, 0.0)
    shown = bounces(times, 0.35, 0.6) + np.random.default_rng(1).normal(0.0, 1e-6, len(times))
    rows = [f"{t:.4f},{f:g},{x:.9f}" for t, f, x in zip(times, force, shown, strict=True)]
    (tmp_path / "log.csv").write_text("time,force,position\n" + "\n".join(rows) + "\n")
    (tmp_path / "map.yaml").write_text(
        "time: {column: time, unit: s}\nforce: {column: force, unit: N}\nposition: {column: position, unit: m}\n"
    )
    (tmp_path / "plunger.yaml").write_text(PLUNGER.read_text())
    return tmp_path


def test_restitution_and_preload_are_found_through_the_impacts(folder: Path) -> None:
    given = [str(folder / "log.csv"), "--plant", str(folder / "plunger.yaml"), "--map", str(folder / "map.yaml")]
    out = CliRunner().invoke(main, ["identify", *given, "--output", str(folder / "out")], catch_exceptions=False)
    assert out.exit_code == 0, out.output
    found = yaml.safe_load((folder / "out" / "identified.yaml").read_text())
    assert found["parameters"]["restitution"]["value"] == pytest.approx(0.6, abs=2e-4)
    assert found["parameters"]["preload"]["value"] == pytest.approx(0.35, abs=2e-3)
    assert found["transitions"] == yaml.safe_load(PLUNGER.read_text())["transitions"]
    out = CliRunner().invoke(main, ["simulate", *given, "--output", str(folder / "shown.csv")], catch_exceptions=False)
    assert "300.000000 ms  lifted" in out.output
    assert out.output.count("seated") == 2
    assert out.output.splitlines()[0].split() == ["18.403696", "ms", "bounced"]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("when: x < 0", "when: x", r"transitions\[0\].when: found the end in 'x'; expected a comparison: x < 0"),
        ("when: x < 0", "when: x < v", r"transitions\[0\].when: x in m is compared with v in m/s"),
        ("from: resting", "from: restin", r"transitions\[1\].from: found 'restin', .* did you mean resting\?"),
        ("-restitution*v}", "-restitution*x}", r"cases\[0\].set.v: is in m, expected m/s, the unit of v"),
        ("set: {x: 0, v: 0}, ", "set: {y: 0}, ", r"cases\[1\].set.y: is no state and no number in held:"),
        ("if: -v > 5e-3, ", "", r"cases\[0\]: has no if:, so that the cases after it never happen; put it last"),
        ("to: resting, set", "if: v < 0, to: resting, set", r"cases\[1\]: is the last one and has if:; add a case"),
        ("resting: {x: 0, v: 0}", "resting: {x: 0, v: v}", r"modes.resting.v: is in m/s, expected m/s²"),
        ("resting: {x: 0, v: 0}", "resting: {y: 0}", r"modes.resting.y: is no state; expected one of x, v"),
        ("flying: {}", "flying: {}, stuck: {}", r"modes.stuck: is entered by no transition"),
        ("modes:", "held: {n: 0}\nmodes:", r"held.n: is set by no transition; make it a parameter"),
        ("modes:", "regions: {r: {a: {}}}\nmodes:", r"regions: stands beside modes:"),
        (
            "derivatives: {x: v",
            "derivatives: {x: 'where(mode == flyin, v, 0)'",
            r"== compares a region with one of its",
        ),
        ("to: flying", "to: [flying, resting]", r"cases\[0\].to: found .*, expected one mode of a region"),
        ("x: {unit: m", "mode: {unit: m", r"mode: is a name in states, too"),
    ],
)
def test_a_slip_is_one_line(old: str, new: str, words: str) -> None:
    text = PLUNGER.read_text()
    assert old in text
    with pytest.raises(PlantFileError, match=words) as caught:
        plant_from(yaml.safe_load(text.replace(old, new, 1)), "plunger.yaml")
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("plunger.yaml: ")


def test_a_valve_of_ones_own_lifts_and_arrives_as_that_of_its_parameter_file_does() -> None:
    """Up to its stop both are the same machine; then this one presses into the stop, and it bounces on its seat."""
    file = load_plant(PLUNGER.with_name("single_plunger.yaml"))
    valve = load_valve(Path(__file__).parents[1] / "config" / "single_plunger.yaml")
    expected = {event.kind.name: event.time for event in simulate(valve, Drive.of([0.0], [24.0]), [0.0, 0.02]).events}
    machine = Machine(file.equations(), list(file.parameters))
    times, voltage = np.linspace(0.0, 0.06, 601), np.array([[24.0], [0.0]])
    numbers = {name: own.value for name, own in file.parameters.items()}
    start = dict.fromkeys(file.states, 0.0)
    shown = machine.run(numbers, start, Inputs(np.array([0.0, 0.03]), voltage, np.array([True])), times)
    events = [event.name for event in shown.events]
    first = {event.name: event.time for event in reversed(shown.events)}
    assert first["unseated"] == pytest.approx(expected["UNSEATED"], abs=1e-9)
    assert first["touched_stop"] == pytest.approx(expected["REACHED_STOP"], abs=1e-8)
    assert np.max(shown.outputs[:, 1]) > 1.0e-3
    assert events[-2:] == ["bounced", "seated"]
    assert events.count("left_stop") == events.count("touched_stop")
    assert shown.outputs[-1, 1] == 0.0
