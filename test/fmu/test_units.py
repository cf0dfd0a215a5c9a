"""Units as files: fmpy, which reads and runs those of any maker, finds nothing wrong and sees what `simulate` shows."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from fmu.master import Master, fmpy
from fmu.test_cosimulation import END, MILLIMETRE, TIMES, VOLTS, expected, random_ends, shown_by, valves
from valve_sim.cli import main
from valve_sim.fmu.export import export_unit
from valve_sim.model import ValveError

pytest.importorskip("pythonfmu", reason="pythonfmu, which writes units, is not installed: pip install '.[fmi]'")


@pytest.fixture(scope="module")
def units(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A unit of each valve, by its name."""
    folder = tmp_path_factory.mktemp("units")
    for name, valve in valves().items():
        export_unit(folder / f"{name}.fmu", valve)
    return {name: folder / f"{name}.fmu" for name in valves()}


@pytest.mark.parametrize("name", valves())
def test_fmpy_finds_nothing_wrong(name: str, units: dict[str, Path]) -> None:
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(units[name])) == []
    description = fmpy.read_model_description(str(units[name]))
    ability = description.coSimulation
    assert description.fmiVersion == "2.0"
    assert ability.canHandleVariableCommunicationStepSize
    assert ability.canGetAndSetFMUstate
    shown = {variable.name: variable.unit for variable in description.modelVariables}
    assert (shown["valve.pilot_damping"], shown["coil_voltage"], shown["phase"]) == ("N.s/m", "V", None)


@pytest.mark.parametrize(("name", "start"), [("late and bouncing", 0.0), ("with gas", 0.0), ("default", 5.0)])
def test_a_unit_shows_what_simulate_shows(name: str, start: float, units: dict[str, Path]) -> None:
    random = np.random.default_rng(5)
    ends, time, shown = random_ends(random, 1e-4), 0.0, []
    with Master(units[name], start) as master:
        for end in ends:
            if time in TIMES:
                master.set("coil_voltage", VOLTS[TIMES.index(time)])
            kept = master.unit.getFMUstate()
            if random.uniform() < 0.5:  # a try that is not kept
                master.step(start + time, float(random.exponential(2e-3)))
                master.unit.setFMUstate(kept)
            master.unit.freeFMUstate(kept)
            master.step(start + time, end - time)
            time = float(end)
            shown.append(shown_by(master.get))
        assert master.log == []
    assert len(ends) > 900 and time == END
    np.testing.assert_allclose(shown, expected(valves()[name], ends), rtol=0.0, atol=1e-12 * MILLIMETRE + 1e-12 * start)


def test_a_value_out_of_range_ends_the_run_with_a_line(units: dict[str, Path]) -> None:
    master = Master(units["default"])
    try:
        master.step(0.0, 1e-3)
        master.set("valve.stroke", -1.0)
        with pytest.raises(Exception, match="failed with status"):
            master.step(1e-3, 1e-3)
        assert any("valve.stroke: found -1.0" in line for line in master.log), master.log
    finally:
        master.unit.freeInstance()


def test_a_python_without_the_package_says_so(units: dict[str, Path], tmp_path: Path) -> None:
    resources = Path(fmpy.extract(str(units["default"]), unzipdir=str(tmp_path / "unit"))) / "resources"
    script = (resources / "slavemodule.txt").read_text().strip()
    program = f"import sys; sys.modules['valve_sim'] = None; sys.path.insert(0, {str(resources)!r}); import {script}"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert "this unit runs the Python package valve_sim" in done.stderr.splitlines()[-1]


def test_the_command_writes_a_unit_and_refuses_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = list(sys.path)
    path = tmp_path / "x.fmu"
    done = CliRunner().invoke(main, ["export-fmu", "--output", str(path), "--json"])
    assert done.exit_code == 0, done.output
    names = {entry["name"] for entry in json.loads(done.stdout)["variables"]}
    assert path.is_file() and {"coil_voltage", "is_open", "valve.attraction_polynomial[4]"} <= names
    assert sys.path == before
    with pytest.raises(ValveError, match=r"x\.zip: expected a name that ends in \.fmu"):
        export_unit(tmp_path / "x.zip", valves()["default"])
    monkeypatch.setitem(sys.modules, "pythonfmu", None)
    with pytest.raises(ValveError, match=r"pythonfmu, which is not installed; pip install '\.\[fmi\]' in a"):
        export_unit(tmp_path / "y.fmu", valves()["default"])
    assert list(tmp_path.iterdir()) == [path]
