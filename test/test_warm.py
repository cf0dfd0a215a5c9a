"""The model is compiled once: by `python -m valve_sim.warm`, or by the first use, which says so."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from valve_sim.files.parameter_files import load_valve
from valve_sim.files.resources import config_path
from valve_sim.model import Stepper
from valve_sim.warm import COMPILING, warm_gas

SIMULATE = ("-m", "valve_sim", "simulate", "--voltage", "9", "--duration", "0.02", "--output")
USE_ALL = """
import sys
import numpy as np
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.diagnosis.run import begin
from valve_sim.identification.fit.problem import Problem
from valve_sim.identification.plants.protocol import Direction
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.model import CATALOGUE, Drive, Stepper, Valve, simulate
from valve_sim.recordings import Signal, Trace, read_trace
opening = Valve().with_values(a0=3.0).parameters
drag = Valve(opening, {"quadratic_drag": {"coefficient": 1.0}})
stiff = Valve(opening, {"spring_hardening": {"coefficient": 1e9}})
mapped = Valve(opening, {"force_map": {"low": 0.0, "high": 1e-3, "c3": 0.1}})
valves = (Valve(opening), drag, stiff, mapped)
shown = {simulate(valve, Drive.of([0.0], [9.0]), [8e-3]).pilot_position[0] for valve in valves}
assert len(shown) == 4, "each effect finds its own code, not another's"
times = np.arange(0.0, 0.01, 1e-4)
trace = Trace("made", Drive.of([0.0], [9.0]), times, 0.0 * times, coil_current=Signal(times, 0.0 * times))
problem = Problem(ValvePlant([trace], drag))
for count in (1, 4):
    problem.rows.linearised({"main_damping": 4.0}, count * [Direction({"main_damping": 1.0}, 1e-6)])
problem.residuals({})
begin(ValvePlant([read_trace(sys.argv[1])], default_valve()), None)
stepper = Stepper(drag)
stepper.command(1e-3, 9.0)
stepper.set_valve(Valve(), 2e-3)
stepper.advance(3e-3)
"""


def compiled_code(folder: Path) -> dict[str, int]:
    return {str(file): file.stat().st_mtime_ns for file in folder.rglob("*.o")}


@pytest.mark.long
def test_what_is_warm_compiles_nothing_and_what_is_not_says_so(tmp_path: Path) -> None:
    cache = tmp_path / "cache"

    def python(*words: str) -> subprocess.CompletedProcess[str]:
        environment = {**os.environ, "VALVE_SIM_CACHE": str(cache)}
        return subprocess.run(
            [sys.executable, *words], env=environment, capture_output=True, text=True, timeout=300, check=True
        )

    assert python(*SIMULATE, str(tmp_path / "first.csv")).stderr == "", "what a simulation needs takes a second"
    assert python("-m", "valve_sim.warm").stdout == f"{COMPILING}\n"
    warmed = compiled_code(cache)
    assert python("-m", "valve_sim.warm").stdout == ""
    assert python(*SIMULATE, str(tmp_path / "second.csv")).stderr == ""
    python("-c", USE_ALL, str(Path(__file__).parents[1] / "bags" / "friction"))
    assert compiled_code(cache) == warmed
    assert len(warmed) > 10


@pytest.mark.long
def test_gas_is_warm_once_it_is_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a live valve with gas calls is there."""
    monkeypatch.setenv("VALVE_SIM_CACHE", str(tmp_path / "cache"))
    warm_gas()
    before = compiled_code(tmp_path)
    assert before
    stepper = Stepper(load_valve(config_path("gas_tank_1.yaml")))
    stepper.command(1e-3, 9.0)
    stepper.supply(1e-3, 20e6)
    stepper.set_demand_pressure(1e-3, 14e6)
    stepper.advance(2e-3)
    assert compiled_code(tmp_path) == before
