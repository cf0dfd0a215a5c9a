# ruff: noqa: E501 -- YAML, command lines and messages as they are
"""A stranger's hour: a machine of one's own from a data sheet and a logger's file, by the command line alone."""

import functools
import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from click.testing import CliRunner, Result
from plants.rubbing import Array, rubbing_axis
from scipy.integrate import solve_ivp

import valve_sim as vs
from valve_sim.cli import main
from valve_sim.identification.plants.own import OwnPlant
from valve_sim.recordings.columns import read

EXAMPLES = Path(__file__).parents[1] / "docs" / "examples" / "own_plants"

# What a data sheet says of a slide: 4.0 kg within 20 g; damping from a table of oils; nothing of friction.
PLANT = """
plant: equations
states: {x: {unit: m, start: 0}, v: {unit: m/s, start: 0}}
inputs: {force: {unit: N, between: straight}}
parameters:
  mass: {value: 4.0, unit: kg, tolerance: 0.02}
  viscous: {value: 12, unit: N*s/m, free: true, range: [0, 2000]}
derivatives: {x: v, v: (force - viscous*v)/mass}
outputs: {position: {value: x, unit: mm, noise: 0.02}}
effects:
  coulomb_friction: {add: {v: -level*sign(v)/mass}, parameters: {level: {unit: N, neutral: 0, scale: 2, range: [0, 50]}}}
  offset: {add: {v: load/mass}, parameters: {load: {unit: N, neutral: 0, scale: 2}}}
  stiffness: {add: {v: -rate*x/mass}, parameters: {rate: {unit: N/m, neutral: 0, scale: 20}}}
"""
MAP = """
time: {column: Zeit, unit: ms}
force: {column: Kraft, unit: kN}
position: {column: Weg, unit: cm}
"""


@functools.cache
def motion() -> tuple[Array, Array, Array]:
    """Time, force and position of the slide, which is 10 g heavier than declared and rubs."""
    times = np.arange(0.0, 4.0, 2e-3)
    force = 9.0 * np.sin(2.0 * np.pi * 0.8 * times) + 5.0 * np.sin(2.0 * np.pi * 2.1 * times)
    position, _ = rubbing_axis(times, force, 4.01, 15.0, 2.5)
    return times, force, position


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Plant, map, and a logger's file with decimal commas, as a German scope writes it."""
    times, force, position = motion()
    shown = position + np.random.default_rng(3).normal(0.0, 2e-5, len(times))
    rows = [
        f"{1e3 * t:.3f};{1e-3 * f:.9f};{1e2 * x:.7f}".replace(".", ",")
        for t, f, x in zip(times, force, shown, strict=True)
    ]
    (tmp_path / "log.csv").write_text("Kanal A;B;C\nZeit;Kraft;Weg\nms;kN;cm\n" + "\n".join(rows) + "\n")
    (tmp_path / "plant.yaml").write_text(PLANT)
    (tmp_path / "map.yaml").write_text(MAP)
    return tmp_path


def ran(folder: Path, *words: str) -> Result:
    places = [
        str(folder / word) if re.search(r"\.(csv|yaml|xml)$", word) or word.startswith("out") else word
        for word in words
    ]
    return CliRunner().invoke(main, places, catch_exceptions=False)


def test_from_a_data_sheet_to_a_checked_model(folder: Path) -> None:
    given = ("log.csv", "--plant", "plant.yaml", "--map", "map.yaml")
    found = ran(folder, "validate", *given)
    assert found.exit_code == 1, found.output
    assert re.search(r"position: OUTSIDE .*FAILED", found.output, re.DOTALL), found.output

    found = ran(folder, "diagnose", *given, "--output", "out")
    assert found.exit_code == 0, found.output
    assert found.stdout.startswith("effects: The model lacks Coulomb friction"), found.output
    report = json.loads((folder / "out" / "report.json").read_text())
    level = report["after"]["effects"]["coulomb_friction"]["level"]
    assert level["value"] == pytest.approx(2.5, abs=3.0 * level["stderr"] + 0.005)
    assert report["after"]["parameters"]["viscous"]["value"] == pytest.approx(15.0, rel=0.01)
    assert (folder / "out" / "report.html").stat().st_size > 10_000

    corrected = yaml.safe_load((folder / "out" / "corrected.yaml").read_text())
    assert "coulomb_friction" not in corrected["effects"]
    found = ran(
        folder, "validate", "log.csv", "--plant", "out/corrected.yaml", "--map", "map.yaml", "--junit", "out/j.xml"
    )
    assert found.exit_code == 0, found.output
    assert "<testcase" in (folder / "out" / "j.xml").read_text()

    found = ran(
        folder, "simulate", "log.csv", "--plant", "out/corrected.yaml", "--map", "map.yaml", "--output", "out/s.csv"
    )
    assert found.exit_code == 0, found.output
    shown, measured = vs.read(folder / "out" / "s.csv"), vs.read(folder / "log.csv", folder / "map.yaml")
    assert np.std(shown["position"].readings - 10.0 * measured["position"].readings) < 0.03  # mm

    found = ran(folder, "identify", "log.csv", "--plant", "out/corrected.yaml", "--map", "map.yaml", "--free",
                "viscous,coulomb_friction_level", "--output", "out/refit")  # fmt: skip
    assert found.exit_code == 0, found.output
    refitted = yaml.safe_load((folder / "out" / "refit" / "identified.yaml").read_text())["parameters"]
    assert refitted["coulomb_friction_level"]["value"] == pytest.approx(level["value"], rel=1e-3)


@pytest.mark.parametrize(
    ("file", "old", "new", "words"),
    [
        ("plant.yaml", "viscous*v)/mass", "viscous*v)/mas", r"plant\.yaml: derivatives\.v: uses mas, .*did you mean mass"),
        ("map.yaml", "unit: kN", "unit: V", r"force: column Kraft is in .*, expected kg·m/s²; correct its unit"),
        ("map.yaml", "Weg", "Wege", r"map\.yaml: position\.column: column Wege is not in .*log\.csv; it has Zeit, Kraft, Weg"),
        ("map.yaml", "force:", "farce:", r"farce: is no input and no output of .*plant\.yaml; expected one of force, position"),
        ("map.yaml", "time:", "use: 5 < time < 9\ntime:", r"map\.yaml: force: no sample is left; widen use:"),
        ("plant.yaml", "plant: equations", "plant: valve", r"plant"),
    ],
)  # fmt: skip
def test_a_slip_ends_in_one_line(folder: Path, file: str, old: str, new: str, words: str) -> None:
    text = (folder / file).read_text()
    assert old in text
    (folder / file).write_text(text.replace(old, new))
    found = ran(folder, "identify", "log.csv", "--plant", "plant.yaml", "--map", "map.yaml", "--output", "out")
    assert found.exit_code == 2
    assert len(found.stderr.strip().splitlines()) == 1
    assert re.search(words, found.stderr), found.stderr


def test_a_map_of_a_machine_that_is_no_valve_asks_for_its_plant(folder: Path) -> None:
    found = ran(folder, "info", "log.csv", "--map", "map.yaml")
    assert found.exit_code == 2
    assert len(found.stderr.strip().splitlines()) == 1
    assert "map.yaml: force: unknown key" in found.stderr
    assert "give --plant to identify, diagnose, validate or simulate" in found.stderr


def test_a_plant_without_inputs_needs_no_log(tmp_path: Path) -> None:
    (tmp_path / "decay.yaml").write_text(
        "plant: equations\nstates: {T: {unit: K, start: 10}}\nparameters: {tau: {value: 2, unit: s}}\n"
        "derivatives: {T: -T/tau}\noutputs: {shown: {value: T, unit: K, noise: 0.1}}\n"
    )
    found = ran(tmp_path, "simulate", "--plant", "decay.yaml", "--duration", "4", "--rate", "10", "--output", "out.csv")
    assert found.exit_code == 0, found.output
    shown = vs.read(tmp_path / "out.csv")["shown"]
    assert np.allclose(shown.readings, 10.0 * np.exp(-shown.times / 2.0), atol=1e-6)


@pytest.mark.long
def test_a_small_motor_by_the_template_with_all_its_effects(tmp_path: Path) -> None:
    """One that sticks and slips, a hundred times smaller than others, and is never still for long."""
    times = np.arange(0.0, 4.0, 1e-3)
    torque = 0.1 * np.sin(2.0 * np.pi * 0.7 * times) + 0.04 * np.sin(2.0 * np.pi * 2.3 * times)
    angle, _ = rubbing_axis(times, torque, 2.0e-3, 1.0e-3, 0.02)
    shown = angle + np.random.default_rng(4).normal(0.0, 2e-4, len(times))
    np.savetxt(
        tmp_path / "log.csv", np.c_[times, torque, shown], delimiter=",", header="t,torque,position", comments=""
    )
    (tmp_path / "map.yaml").write_text(
        "time: {column: t}\ntorque: {column: torque, unit: N*m}\nposition: {column: position, unit: rad}\n"
    )
    (tmp_path / "motor.yaml").write_text(
        "plant: axis\nrotary: true\nparameters: {inertia: {value: 2.1e-3, tolerance: 1.0e-4}, viscous: 1.0e-3}\n"
    )
    found = ran(tmp_path, "diagnose", "log.csv", "--plant", "motor.yaml", "--map", "map.yaml", "--output", "out")
    assert found.exit_code == 0, found.output
    assert found.stdout.startswith("effects: The model lacks Coulomb friction"), found.output
    assert "Warning" not in found.stderr
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["after"]["effects"]["coulomb_friction"]["level"]["value"] == pytest.approx(0.02, rel=2e-3)


@pytest.mark.long
def test_the_backlash_of_a_gear(tmp_path: Path) -> None:
    """Two inertias and a spring with a dead zone of ± 0.02 rad, by SciPy."""
    times = np.arange(0.0, 2.0, 2e-3)
    torque = np.where(np.sin(2.0 * np.pi * 2.0 * times) > 0.0, 0.03, -0.03)
    at = np.zeros(4)
    shown = np.zeros((len(times), 2))
    for i, drive in enumerate(torque):
        shown[i] = at[0], at[2]

        def rates(_: float, y: Array, drive: float = drive) -> list[float]:
            twist = y[0] / 10.0 - y[2]
            shaft = 50.0 * (twist - np.clip(twist, -0.02, 0.02)) + 0.2 * (y[1] / 10.0 - y[3])
            return [y[1], (drive - 2e-3 * y[1] - shaft / 10.0) / 1e-4, y[3], shaft / 2e-2]

        at = solve_ivp(rates, (0.0, 2e-3), at, rtol=1e-8, atol=1e-10, max_step=5e-4).y[:, -1]
    shown += np.random.default_rng(6).normal(0.0, 1e-3, shown.shape)
    head = "t,torque,motor_angle,load_angle"
    np.savetxt(tmp_path / "log.csv", np.c_[times, torque, shown], delimiter=",", header=head, comments="")
    (tmp_path / "map.yaml").write_text(
        "time: {column: t}\ntorque: {column: torque, unit: N*m}\n"
        "motor_angle: {column: motor_angle, unit: rad}\nload_angle: {column: load_angle, unit: rad}\n"
    )
    (tmp_path / "gear.yaml").write_text((EXAMPLES / "geared_axis.yaml").read_text())
    found = ran(tmp_path, "diagnose", "log.csv", "--plant", "gear.yaml", "--map", "map.yaml", "--output", "out")
    assert found.exit_code == 0, found.output
    assert found.stdout.startswith("effects: The model lacks backlash"), found.output
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["after"]["effects"]["backlash"]["gap"]["value"] == pytest.approx(0.02, rel=0.05)


# -- the reader --------------------------------------------------------------------------------------------------------


def written(tmp_path: Path) -> Path:
    times = np.arange(0.0, 2.0, 1e-3)
    moves = (times > 0.5) & (times < 1.5)
    angle = np.where(moves, np.sin(2.0 * np.pi * (times - 0.5)), 0.0)
    np.savetxt(tmp_path / "t.csv", np.c_[times, angle], delimiter=",", header="t,q", comments="")
    return tmp_path / "t.csv"


def test_masks_derivatives_and_units_of_columns(tmp_path: Path) -> None:
    path = written(tmp_path)
    read = vs.read(path, {
        "time": {"column": "t"}, "use": "0.2 < time < 1.8",
        "q": {"column": "q", "unit": "deg", "scale": 2, "at_rest": "exclude", "use": "q > -1 or time > 1"},
        "w": {"column": "q", "unit": "deg", "derivative": 1, "low_pass": 50},
    })  # fmt: skip
    times = read["q"].times
    assert not read["q"].used[(times < 0.4) | (times > 1.7)].any()
    assert read["q"].used[(times > 0.6) & (times < 1.4)].all()
    assert read["w"].unit is not None
    speed = read["w"].readings * read["w"].unit.factor
    inside = (times > 0.7) & (times < 1.3)
    expected = np.deg2rad(2.0 * np.pi * np.cos(2.0 * np.pi * (times - 0.5)))
    assert np.max(np.abs(speed - expected)[inside]) < 1e-3
    assert "q" in repr(read)


def test_where_a_measured_velocity_passes_through_0_the_force_of_a_plant_without_states_is_not_compared(
    tmp_path: Path,
) -> None:
    times = np.arange(0.0, 4.0, 1e-3)
    np.savetxt(
        tmp_path / "t.csv", np.c_[times, np.cos(np.pi * times), np.sign(np.sin(np.pi * times))], delimiter=",",
        header="t,q,f", comments="",
    )  # fmt: skip
    plant = vs.load_plant(
        plant_file(tmp_path, "{add: {f: level*sign(v)}, parameters: {level: {unit: N, neutral: 0, scale: 1}}}")
    )
    steady = vs.load_plant(
        plant_file(tmp_path, "{add: {f: level*v}, parameters: {level: {unit: N*s/m, neutral: 0, scale: 1}}}")
    )
    recording = read(tmp_path / "t.csv", {
        "time": "t", "v": {"column": "q", "unit": "m", "derivative": 1, "low_pass": 50}, "f": {"column": "f", "unit": "N"},
    })  # fmt: skip
    rubbing = OwnPlant(plant, [recording])
    left_out = rubbing.channels[0].left_out
    assert left_out is not None
    from_turn = np.abs(times - np.round(times))
    inside = (times > 0.5) & (times < 3.5)
    assert left_out[inside & (from_turn < 0.008)].all()
    assert not left_out[inside & (from_turn > 0.013)].any()
    assert "v passes through 0" in rubbing.findings[0]
    assert OwnPlant(steady, [recording]).channels[0].left_out is None


def plant_file(folder: Path, effect: str) -> Path:
    """A plant without states: the force that a motion requires, and one effect."""
    text = f"""
plant: equations
inputs: {{v: {{unit: m/s}}}}
parameters: {{viscous: {{value: 1, unit: N*s/m, free: true, range: [0, 10]}}}}
outputs: {{f: {{value: viscous*v, unit: N, noise: 0.1}}}}
effects: {{one: {effect}}}
"""
    (folder / "plant.yaml").write_text(text)
    return folder / "plant.yaml"
