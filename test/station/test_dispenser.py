"""docs/examples/dispenser.py: the balance of mass, the order of the tanks, and the node among its valves."""

from __future__ import annotations

import runpy
import signal
from pathlib import Path
from typing import Any

import pytest
from nodes.ros_process import Probe, ended, piped

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "docs" / "examples" / "dispenser.py"
MEGA = 1e6
pytestmark = pytest.mark.ros


@pytest.fixture(scope="module")
def example() -> dict[str, Any]:
    return runpy.run_path(str(EXAMPLE))


def mass(dispenser: Any) -> float:
    return float(dispenser.line + dispenser.vehicle + sum(dispenser.tanks))


def test_tanks_open_in_rising_order_and_no_mass_is_lost(example: dict[str, Any]) -> None:
    """Before valves without delay: the pipe behind one has the tank's pressure while it is open."""
    dispenser = example["Dispenser"](example["Sizes"](tank_pressures=(32 * MEGA, 20 * MEGA, 26 * MEGA)))
    opened, said, before = [], [], 0.0
    for k in range(400):
        for tank in range(3):
            is_open = tank == dispenser.open
            dispenser.outlets[tank] = dispenser.tank_pressure(tank) if is_open else dispenser.line_pressure
        words = dispenser.step(0.05 * k, 0.05)
        said.append(words)
        if words.startswith("opens"):
            opened.append(dispenser.open)
            before = mass(dispenser) if len(opened) == 1 else before
        assert not dispenser.is_filling or dispenser.filled or mass(dispenser) == pytest.approx(before, rel=1e-12)
    assert opened[:4] == [1, 2, 0, 1] and dispenser.filled >= 1
    assert any("is full: 28." in words for words in said)


def test_it_fills_a_vehicle_and_ends_with_all_coils_off(probe: Probe, tmp_path: Path) -> None:
    """Two valves without delay on topics, and a vehicle of a fifth of the size."""
    from nodes.ros import Float64, FluidPressure

    valves = ("/tank_1/valve", "/tank_2/valve")
    volts = [probe.hear(f"{valve}/coil_voltage", Float64) for valve in valves]
    tanks = [probe.hear(f"{valve}/inlet_pressure", FluidPressure) for valve in valves]
    line = probe.hear("/dispenser/line_pressure", FluidPressure)
    vehicle = probe.hear("/dispenser/vehicle_pressure", FluidPressure)
    outlets = [probe.talker(f"{valve}/outlet_pressure", FluidPressure) for valve in valves]
    program = (
        str(EXAMPLE), "--ros-args", "-p", "valves:=[/tank_1/valve, /tank_2/valve]", "-p", "least_open:=0.2",
        "-p", "tank_pressures:=[20.0e+6, 32.0e+6]", "-p", "vehicle_volume:=2.0e-6", "-p", "line_volume:=0.5e-6",
    )  # fmt: skip

    def publish() -> None:
        for outlet, heard, tank in zip(outlets, volts, tanks, strict=True):
            is_open = bool(heard and tank) and heard[-1].data == 9.0
            pressure = tank[-1].fluid_pressure if is_open else line[-1].fluid_pressure if line else 2.0 * MEGA
            outlet.publish(FluidPressure(fluid_pressure=pressure))

    probe.node.create_timer(0.02, publish)
    with piped(tmp_path, program) as process:
        assert probe.until(lambda: vehicle and vehicle[-1].fluid_pressure > 27.0 * MEGA)
        assert probe.until(lambda: any(message.data == 9.0 for message in volts[1]))
        said = ended(process, signal.SIGINT)
        assert probe.until(lambda: volts[0][-1].data == volts[1][-1].data == 0.0), said
    first, second = (f"opens {valve}, its tank at {at:.1f} MPa" for valve, at in zip(valves, (20, 32), strict=True))
    assert said.index(first) < said.index(second)
