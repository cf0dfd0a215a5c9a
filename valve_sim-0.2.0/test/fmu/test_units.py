"""Units as files: fmpy, which reads and runs those of any maker, finds nothing wrong and sees what `simulate` shows."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from fmu.master import LIBRARIES, Master, fmpy
from fmu.test_cosimulation import END, MILLIMETRE, TIMES, VOLTS, expected, random_ends, shown_by, valves
from valve_sim.cli import main
from valve_sim.fmu import export
from valve_sim.model import Valve, ValveError

VERSIONS = pytest.mark.parametrize("version", LIBRARIES)


@pytest.fixture
def unit(tmp_path: Path) -> Callable[[str, Valve], Path]:
    """Writes a unit, and says where."""

    def write(version: str, valve: Valve) -> Path:
        pytest.importorskip(LIBRARIES[version], reason=f"{LIBRARIES[version]}, which writes units, is not installed")
        export.export_unit(tmp_path / "valve.fmu", valve, version)
        return tmp_path / "valve.fmu"

    return write


@VERSIONS
@pytest.mark.parametrize("name", valves())
def test_fmpy_finds_nothing_wrong(version: str, name: str, unit: Callable[[str, Valve], Path]) -> None:
    from fmpy.validation import validate_fmu

    path = unit(version, valves()[name])
    assert validate_fmu(str(path)) == []
    description = fmpy.read_model_description(str(path))
    ability = description.coSimulation
    assert description.fmiVersion == version
    assert "valve_sim" in description.description
    assert ability.canHandleVariableCommunicationStepSize
    assert ability.canGetAndSetFMUstate
    units = {found.name: found.unit for found in description.modelVariables}
    assert (units["valve.pilot_damping"], units["coil_voltage"], units["phase"]) == ("N.s/m", "V", None)


@VERSIONS
@pytest.mark.parametrize("name", ["late and bouncing", "with gas"])
def test_a_unit_shows_what_simulate_shows(version: str, name: str, unit: Callable[[str, Valve], Path]) -> None:
    valve = valves()[name]
    random = np.random.default_rng(5)
    ends, time, shown = random_ends(random, 1e-4), 0.0, []
    with Master(unit(version, valve)) as master:
        for end in ends:
            if time in TIMES:
                master.set("coil_voltage", VOLTS[TIMES.index(time)])
            kept = master.keep()
            if random.uniform() < 0.5:  # a try that is not kept
                master.step(time, float(random.exponential(2e-3)))
                master.restore(kept)
            master.drop(kept)
            master.step(time, end - time)
            time = float(end)
            shown.append(shown_by(master.get))
        assert master.log == []
    assert len(ends) > 900 and time == END
    np.testing.assert_allclose(shown, expected(valve, ends), rtol=0.0, atol=1e-12 * MILLIMETRE)


@VERSIONS
def test_a_value_out_of_range_ends_the_run_with_a_line(version: str, unit: Callable[[str, Valve], Path]) -> None:
    master = Master(unit(version, valves()["default"]))
    try:
        master.step(0.0, 1e-3)
        master.set("valve.stroke", -1.0)
        with pytest.raises(Exception, match="failed with status"):
            master.step(1e-3, 1e-3)
        assert any("valve.stroke: found -1.0" in line for line in master.log), master.log
    finally:
        master.unit.freeInstance()


@VERSIONS
def test_a_python_without_the_package_says_so(version: str, unit: Callable[[str, Valve], Path], tmp_path: Path) -> None:
    folder = fmpy.extract(str(unit(version, valves()["default"])), unzipdir=str(tmp_path / "unit"))
    resources = Path(folder) / "resources"
    script = (resources / "slavemodule.txt").read_text().strip()
    program = f"import sys; sys.modules['valve_sim'] = None; sys.path.insert(0, {str(resources)!r}); import {script}"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert "this unit runs the Python package valve_sim" in done.stderr.splitlines()[-1]


def test_the_command_writes_a_unit_and_says_what_it_needs(tmp_path: Path) -> None:
    pytest.importorskip("pythonfmu", reason="pythonfmu, which writes units, is not installed")
    before = list(sys.path)
    path = tmp_path / "x.fmu"
    done = CliRunner().invoke(main, ["export-fmu", "--output", str(path), "--json"])
    assert done.exit_code == 0, done.output
    names = {entry["name"] for entry in json.loads(done.stdout)["variables"]}
    assert path.is_file() and {"coil_voltage", "is_open", "valve.attraction_polynomial[4]"} <= names
    assert sys.path == before
    told = CliRunner().invoke(main, ["export-fmu", "--output", str(path)])
    assert "Needs Linux on x86-64 and a Python with the package valve_sim" in told.stdout


def test_what_cannot_be_written_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValveError, match=r"x\.zip: expected a name that ends in \.fmu"):
        export.export_unit(tmp_path / "x.zip", valves()["default"], "2.0")
    with pytest.raises(ValveError, match=r"\.: expected a name that ends in \.fmu"):
        export.export_unit(Path(), valves()["default"], "2.0")
    monkeypatch.setitem(sys.modules, "pythonfmu3", None)
    with pytest.raises(ValveError, match=r"pythonfmu3, which is not installed; pip install '\.\[fmi\]' in a"):
        export.export_unit(tmp_path / "x.fmu", valves()["default"], "3.0")
    assert list(tmp_path.iterdir()) == []
