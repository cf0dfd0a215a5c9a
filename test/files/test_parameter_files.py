"""Parameter files: every form that ROS 2 reads, and one line for everything else."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, seed, settings
from hypothesis import strategies as st

from valve_sim.files.parameter_files import default_valve, load_recorded_valve, load_valve, save_valve
from valve_sim.files.parameter_sections import Section, default_parameters, read_sections, write_sections
from valve_sim.files.resources import config_path
from valve_sim.model import CATALOGUE, DECLARED, EXACT, Drive, ParameterError, Valve, published_times, simulate
from valve_sim.model.tolerances import TOLERATED


def written(folder: Path, text: str) -> Path:
    path = folder / "given.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def below_parameters(text: str) -> str:
    return "/**:\n  ros__parameters:\n" + "".join(f"    {line}\n" for line in text.splitlines())


def test_the_declared_parameters_of_the_shipped_valve_alone() -> None:
    assert default_parameters() == default_valve().parameters


@pytest.mark.parametrize(
    "text",
    [
        "/**:\n  ros__parameters:\n    valve: {pilot_mass: 0.2}",
        "/**:\n  ros__parameters:\n    valve.pilot_mass: 0.2",
        "/**:\n  ros__parameters: {valve: {pilot_mass: 2e-1}}",
        "valve:\n  ros__parameters:\n    valve: {pilot_mass: 0.2}",
        "/valve:\n  ros__parameters:\n    valve:\n      pilot_mass: 0.2",
        "/tank_1/valve:\n  ros__parameters:\n    valve: {pilot_mass: 0.2}",
        "tank_1:\n  valve:\n    ros__parameters:\n      valve: {pilot_mass: 0.2}",
        "/**/valve:\n  ros__parameters:\n    valve: {pilot_mass: .2E0}",
        "/**:\n  ros__parameters:\n    publish_rate: 100\n    empty: {}\n    valve: {pilot_mass: 0.2}\n    effects:",
        "other_node:\n  ros__parameters: {gain: 3}\n/valve:\n  ros__parameters: {valve: {pilot_mass: 0.2}}",
        "/**:\n  ros__parameters: {valve: {pilot_mass: 9}}\n/valve:\n  ros__parameters: {valve: {pilot_mass: 0.2}}",
    ],
)
def test_every_form_that_ros_reads_is_read(tmp_path: Path, text: str) -> None:
    expected = default_valve().with_values(pilot_mass=0.2).exact()
    assert load_valve(written(tmp_path, text)) == expected


def test_an_integer_may_stand_for_a_double(tmp_path: Path) -> None:
    text = below_parameters("valve: {pilot_damping: 3, attraction_polynomial: [3, 17.096e3, -30931000, 24.026e9]}")
    parameters = load_valve(written(tmp_path, text)).parameters
    assert parameters.pilot_damping == 3.0
    assert parameters.attraction_polynomial == (3.0, 17096.0, -30.931e6, 24.026e9)
    assert all(isinstance(term, float) for term in (parameters.pilot_damping, *parameters.attraction_polynomial))


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("valve: {pilot_mas: 0.125}", ["valve.pilot_mas", "0.125", "did you mean pilot_mass"]),
        ("valve: {pilot_mass: heavy}", ["valve.pilot_mass", "'heavy'", "expected a number"]),
        ("valve: {pilot_mass: true}", ["valve.pilot_mass", "True", "expected a number"]),
        ("valve: {pilot_mass: .nan}", ["valve.pilot_mass", "nan", "expected a number above 0"]),
        ("valve: {pilot_mass: 0}", ["valve.pilot_mass", "found 0", "expected a number above 0"]),
        (f"valve: {{pilot_mass: {'9' * 400}}}", ["valve.pilot_mass", "999...", "an integer of ROS 2"]),
        ("valve: {pilot_mass: }", ["valve.pilot_mass", "has no value"]),
        ("valve: {pilot_gap: 1.5e-3}", ["valve.pilot_gap", "0.0015", "0.00123", "expected 0 < pilot_gap < stroke"]),
        ("valve: {attraction_polynomial: [1.0, 2.0, 3.0]}", ["valve.attraction_polynomial", "3 terms", "four numbers"]),
        ("valve: {attraction_polynomial: [1.0, x, 3.0, 4.0]}", ["valve.attraction_polynomial[1]", "'x'", "a number"]),
        ("valve: 3", ["valve", "found 3", "pilot_mass"]),
        ("effects: {stictoin: {force: 0.1}}", ["effects.stictoin.force", "0.1", "did you mean stiction"]),
        ("effects: {stiction: {forse: 0.1}}", ["effects.stiction.forse", "0.1", "did you mean force"]),
        ("effects: {stiction: {force: -1}}", ["effects.stiction.force", "-1", "from 0 to 100000 N"]),
        ("effects: {stiction: {}}", ["effects.stiction", "{}", "force, breakaway, stribeck_velocity"]),
        ("effects: {stiction: 0.3}", ["effects.stiction", "0.3", "force, breakaway, stribeck_velocity"]),
        ("effects: {stroke_offset: {offset: -1.2e-3}}", ["with effects", "pilot_gap < stroke"]),
        ("effects: {sensor_bandwidth: {cutoff_frequency: -.inf}}", ["cutoff_frequency", "-inf", "1e+09 Hz"]),
        ("pilot_mass: 0.1", ["pilot_mass", "0.1", "valve.pilot_mass"]),
        ("stiction: {force: 0.1}", ["stiction.force", "0.1", "effects.stiction.force"]),
        ("valves: {pilot_mass: 0.1}", ["valves.pilot_mass", "0.1", "expected valve:"]),
        ("valve: {pilot_mass: 0.1, pilot_mass: 0.2}", ["line 3", "'pilot_mass'", "second time"]),
        ("valve: {pilot_mass: 0.1", ["line", "expected"]),
        ("publish_rate: 100", ["no parameters of a valve", "ros__parameters"]),
        ("tolerances: {spring_rat: 12.8}", ["tolerances.spring_rat", "12.8", "did you mean tolerances.spring_rate"]),
        ("tolerances: {valve: {stroke: 1e-6}}", ["tolerances.valve.stroke", "did you mean tolerances.stroke"]),
        ("tolerances: {stroke: -4e-6}", ["tolerances.stroke", "-4e-06", "a number from 0 to 0.1 m"]),
        ("tolerances: {stroke: .nan}", ["tolerances.stroke", "nan", "a number from 0 to 0.1 m"]),
        ("tolerances: {stroke: 4 um}", ["tolerances.stroke", "'4 um'", "expected a number in m"]),
        ("tolerances: {stroke: }", ["tolerances.stroke", "has no value"]),
        ("tolerances: 3", ["tolerances", "found 3", "names of declared values"]),
        ("tolerances: {a1: 30.0}", ["tolerances.a1", "attraction_covariance", "16 numbers"]),
        ("tolerances: {attraction_polynomial: [0, 1, 2, 3]}", ["attraction_polynomial", "attraction_covariance"]),
        ("tolerances: {attraction_covariance: [1.0, 2.0]}", ["attraction_covariance", "list of 2", "16 numbers"]),
        ("tolerances: {effects: {coulomb_friction: {force: 0.1}}}", ["coulomb_friction.force", "not declared on"]),
        ("tolerances: {effects: {coulomb_friction: 0.1}}", ["effects.coulomb_friction", "<effect>.<parameter>"]),
        ("tolerances: {effects: 0.1}", ["tolerances.effects", "0.1"]),
        ("tolerance: {stroke: 1e-6}", ["tolerance.stroke", "1e-06", "expected tolerances:"]),
        ("attraction_covariance: [1, 2]", ["attraction_covariance", "tolerances.attraction_covariance"]),
        ("valve: {attraction_covariance: [1, 2]}", ["valve.attraction_covariance", "tolerances.attraction_covariance"]),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path: Path, text: str, named: list[str]) -> None:
    path = written(tmp_path, below_parameters(text))
    with pytest.raises(ParameterError) as caught:
        load_valve(path)
    message = str(caught.value)
    assert "\n" not in message
    assert [part for part in [str(path), *named] if part not in message] == []


@pytest.mark.parametrize(
    "text", ["", "3", "[1, 2]", "valve: {pilot_mass: 0.1}", "/**: {ros__parameters: 3}", "&a [*a]", "\t"]
)
def test_what_is_no_parameter_file_is_said_in_one_line(tmp_path: Path, text: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(ParameterError, match="expected") as caught:
        load_valve(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"\xff\xfe\x00")
    for path in (tmp_path / "none.yaml", tmp_path, binary):
        with pytest.raises(ParameterError, match=str(path)):
            load_valve(path)


def test_of_several_valves_one_must_be_named(tmp_path: Path) -> None:
    each = "  ros__parameters: {{valve: {{pilot_mass: {}}}}}\n"
    path = written(tmp_path, "/a/valve:\n" + each.format(0.1) + "/b/valve:\n" + each.format(0.2))
    with pytest.raises(ParameterError, match="/a/valve, /b/valve"):
        load_valve(path)
    assert load_valve(path, "/b/valve").parameters.pilot_mass == 0.2
    with pytest.raises(ParameterError, match="/c/valve"):
        load_valve(path, "/c/valve")


@pytest.mark.parametrize(
    ("pattern", "node", "applies"),
    [
        ("/**", "/valve", True),
        ("/**", "/tank_1/valve", True),
        ("/*/valve", "/tank_1/valve", True),
        ("/*/valve", "/valve", False),
        ("/**/valve", "/valve", True),
        ("/**/valve", "/a/b/valve", True),
        ("/valve", "/tank_1/valve", False),
        ("/tank_*", "/tank_1", True),
    ],
)
def test_patterns_of_node_names_match_as_in_ros(pattern: str, node: str, applies: bool) -> None:
    assert Section(pattern, {}).applies_to(node) is applies


def test_an_effect_is_on_when_a_parameter_differs_from_its_off_value(tmp_path: Path) -> None:
    text = below_parameters(
        "effects:\n"
        "  stiction: {force: 0.3}\n"
        "  coulomb_friction: {force: 0.0}\n"
        "  drive_gain: {gain: 1}\n"
        "  sensor_bandwidth: {cutoff_frequency: .inf}\n"
        "  squeeze_film: {film_thickness: 2.0e-4}"
    )
    effects = load_valve(written(tmp_path, text)).effects
    assert effects == {"stiction": {"force": 0.3, "breakaway": 0.0, "stribeck_velocity": 0.02}}


def test_what_is_saved_is_read_back(tmp_path: Path) -> None:
    valve = Valve(
        default_valve().parameters._replace(pilot_damping=1 / 3), {"stiction": stiction(), "drive_gain": {"gain": 0.9}}
    )
    path = tmp_path / "saved.yaml"
    save_valve(path, valve, "identified from a bag\nand so on")
    assert load_valve(path) == valve
    assert path.read_text().startswith("# identified from a bag\n# and so on\n/**:\n")
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    "text",
    [
        "effects: {coulomb_friction: {force: 0.3}}\n"
        "tolerances: {stroke: 4e-6, effects: {coulomb_friction: {force: 0.05}}, pilot_mass: 0}",
        "effects.coulomb_friction.force: 0.3\n"
        "tolerances.stroke: 4.0e-6\ntolerances.effects.coulomb_friction.force: 0.05",
        "effects: {coulomb_friction.force: 0.3}\ntolerances: {stroke: 4.e-6, effects.coulomb_friction.force: 5e-2}",
    ],
)
def test_tolerances_are_read_in_every_form(tmp_path: Path, text: str) -> None:
    valve = load_valve(written(tmp_path, below_parameters(text)))
    assert dict(valve.tolerances.declared) == {"stroke": 4e-6}
    assert valve.tolerances.effects == {"coulomb_friction": {"force": 0.05}}
    assert valve.tolerances.attraction_covariance is None


def test_without_tolerances_a_file_is_exact_and_has_not_those_of_the_default(tmp_path: Path) -> None:
    path = written(tmp_path, below_parameters("valve: {pilot_damping: 2}\ntolerances:\n  effects:"))
    assert load_valve(path).tolerances == EXACT


def test_a_dump_whose_tolerances_are_zeros_is_exact(tmp_path: Path) -> None:
    zeros = [f"tolerances.{name}: 0.0" for name in TOLERATED]
    zeros += [
        f"tolerances.effects.{effect.name}.{parameter.name}: 0"
        for effect in CATALOGUE.values()
        for parameter in effect.parameters
    ]
    zeros.append(f"tolerances.attraction_covariance: {16 * [0.0]}")
    assert load_valve(written(tmp_path, below_parameters("\n".join(zeros)))).tolerances == EXACT


def sizes(upper: float) -> st.SearchStrategy[float]:
    return st.floats(0.0, upper, exclude_min=True, allow_subnormal=False)


@seed(16)
@settings(max_examples=60, suppress_health_check=list(HealthCheck))
@given(
    declared=st.fixed_dictionaries(
        {}, optional={name: sizes(DECLARED[name].upper - DECLARED[name].lower) for name in TOLERATED}
    ),
    root=st.none() | st.lists(st.lists(st.integers(-1000, 1000), min_size=4, max_size=4), max_size=4),
    friction=st.fixed_dictionaries({}, optional={"force": sizes(10.0), "stribeck_velocity": sizes(1.0)}),
)
def test_what_is_saved_with_tolerances_is_read_back(
    declared: dict[str, float], root: list[list[int]] | None, friction: dict[str, float]
) -> None:
    tolerances: dict[str, Any] = {**declared, "effects": {"stiction": friction}}
    if root is not None:
        scaled = np.array(root).reshape(-1, 4) * (1e-4, 0.1, 1e2, 1e5)
        tolerances["attraction_covariance"] = [float(value) for value in (scaled.T @ scaled).ravel()]
    valve = Valve.from_mapping({"effects": {"stiction": stiction()}, "tolerances": tolerances}, "drawn")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "saved.yaml"
        save_valve(path, valve, "drawn")
        assert load_valve(path) == valve
        copy = Path(folder) / "copy.yaml"
        write_sections(copy, read_sections(path))
        assert load_valve(copy) == valve


def stiction() -> dict[str, float]:
    return {"force": 0.25, "breakaway": 1e-5, "stribeck_velocity": 0.02}


def test_a_file_that_cannot_be_written_is_left_as_it_was(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="cannot be written"):
        save_valve(tmp_path, default_valve(), "")
    target = tmp_path / "folder"
    target.mkdir()
    with pytest.raises(ParameterError, match="cannot be written"):
        save_valve(target, default_valve(), "")
    assert list(tmp_path.iterdir()) == [target]


TWO = """
/**:
  ros__parameters: {valve: {main_damping: 5.0}}
/tank_2/valve:
  ros__parameters: {valve: {main_damping: 9.0}}
"""


@pytest.mark.parametrize(("recorded", "damping"), [("/tank_1/valve", 5.0), ("tank_2/valve/", 9.0), (None, 5.0)])
def test_a_recording_takes_the_section_of_its_own_valve(recorded: str | None, damping: float, tmp_path: Path) -> None:
    assert load_recorded_valve(written(tmp_path, TWO), recorded).parameters.main_damping == damping


def test_a_recording_does_not_take_the_only_section_of_another_valve(tmp_path: Path) -> None:
    path = written(tmp_path, TWO[TWO.index("/tank_2") :])
    assert load_recorded_valve(path, "/valve").parameters.main_damping == 9.0
    with pytest.raises(ParameterError, match=r"describes /tank_2/valve, expected /tank_1/valve, which was recorded"):
        load_recorded_valve(path, "/tank_1/valve")


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ("spring_rate: 0.9", r"spring_rate: found 0\.9 N/m, expected 0 or at least 10 N/m; 0\.9 N/mm are 900 N/m"),
        (
            "pilot_gap: 0.0, stroke: 1e-3, moving_mass: 0.01",
            r"pilot_gap: found 0, a valve with one plunger, without valve\.main_damping, valve\.spring_rate, ",
        ),
    ],
)
def test_what_means_something_else_is_refused(values: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match=words):
        load_valve(written(tmp_path, below_parameters(f"valve: {{{values}}}")))


def test_plain_copies_mean_the_same(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        below_parameters("valve: {attraction_polynomial: [0, 1.5, 2, 3], stroke: 2e-3}\neffects: {}\nname: '1'"),
    )
    copy = tmp_path / "copy.yaml"
    write_sections(copy, read_sections(path))
    assert read_sections(copy) == read_sections(path)
    assert "0.0, 1.5" in copy.read_text()


def test_the_default_opens_at_the_published_times_and_the_published_one_never() -> None:
    response = simulate(default_valve(), Drive.of([0.0], [9.0]), [0.02])
    assert published_times(response) == pytest.approx((5.3e-3, 9.9e-3), abs=1e-6)
    published = load_valve(config_path("published.yaml"))
    assert published.exact() == Valve()
    assert not published.can_open()
    assert all(math.isnan(time) for time in published_times(simulate(published, Drive.of([0.0], [9.0]), [1.0])))


def test_shipped_tolerances_are_what_their_comments_say() -> None:
    declared = default_valve().parameters
    for name in ("published.yaml", "valve.yaml"):
        tolerances = load_valve(config_path(name)).tolerances
        known = tolerances.declared
        assert known["pilot_mass"] == pytest.approx(1e-3 / math.sqrt(12), rel=0.01)
        assert known["moving_mass"] == pytest.approx(1e-3 / math.sqrt(6), rel=0.01)
        assert known["spring_rate"] == pytest.approx(0.03 * declared.spring_rate, rel=0.01)
        assert known["spring_preload"] == pytest.approx(0.03 * declared.spring_preload, rel=0.01)
        assert known["pilot_gap"] == known["stroke"] == pytest.approx(10e-6 / math.sqrt(12), rel=0.01)
        displacement = np.linspace(0.0, declared.stroke, 200)
        powers = displacement[:, None] ** np.arange(4)
        force = powers @ Valve().parameters.attraction_polynomial
        shapes = [np.polynomial.Legendre.basis(n, [0.0, declared.stroke])(displacement) for n in (1, 2, 3)]
        sizes = [0.015 * force, *(0.01 * np.trapezoid(force, displacement) / declared.stroke * s for s in shapes)]
        expected = sum(size**2 for size in sizes) + (0.18**2 if name == "valve.yaml" else 0.0)
        found = np.einsum("ij,jk,ik->i", powers, np.array(tolerances.attraction_covariance), powers)
        np.testing.assert_allclose(found, expected, rtol=2e-3)
    assert "coil_time_constant" in known
    assert "coil_time_constant" not in load_valve(config_path("published.yaml")).tolerances.declared


@pytest.mark.parametrize("tank", [1, 2, 3])
def test_every_tank_of_the_station_opens(tank: int) -> None:
    assert load_valve(config_path(f"tank_{tank}.yaml")).can_open()
