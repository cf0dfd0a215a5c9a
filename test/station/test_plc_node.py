"""plc_node between a PLC and a valve: commands, states, silence, and the end."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest
from nodes.ros_process import Probe, ended, free_port, own_lines, piped


@pytest.mark.ros
def test_a_plc_opens_a_valve_reads_it_falls_silent_and_the_coil_is_off(probe: Probe, tmp_path: Path) -> None:
    from nodes.ros import LATCHED, Bool, Float64, UInt8

    from .test_modbus import pymodbus_cycle

    is_open, phase = probe.talker("is_open", Bool, LATCHED), probe.talker("phase", UInt8, LATCHED)
    current, volts = probe.talker("coil_current", Float64), probe.hear("coil_voltage", Float64)
    port, file, beats = free_port(), tmp_path / "map.csv", 0
    program = ("-m", "valve_sim.station", "plc_node", "--ros-args", "-p", f"map_file:={file}")

    def obey() -> None:
        """A valve that opens at once."""
        is_on = bool(volts) and volts[-1].data > 0.0
        is_open.publish(Bool(data=is_on))
        phase.publish(UInt8(data=4 if is_on else 0))
        current.publish(Float64(data=0.9 * is_on))

    probe.node.create_timer(0.02, obey)
    with piped(tmp_path, program, port=port, address="127.0.0.1", watchdog=1.0) as process:
        assert probe.until(lambda: volts and volts[-1].data == 0.0)
        cycle, close = pymodbus_cycle(port)

        def beat(command: int) -> list[int]:
            nonlocal beats
            beats += 1
            return cycle(beats, command)

        def is_shown(command: int, *wanted: int) -> bool:
            status = beat(command)
            return not status[1] & 0b1000 and status[2:4] == list(wanted)

        assert probe.until(lambda: is_shown(0, 0, 0))
        assert probe.until(lambda: is_shown(1, 4, 1))
        assert volts[-1].data == 9.0
        assert probe.until(lambda: volts[-1].data == 0.0), "the PLC has not written for the watchdog's time"
        assert beat(1)[1] & 0b1010 == 0b1000, "it is back with an old 1"
        assert probe.until(lambda: is_shown(0, 0, 0))
        assert probe.until(lambda: is_shown(1, 4, 1))
        close()
        said = ended(process, signal.SIGINT)
        assert probe.until(lambda: volts[-1].data == 0.0), said
    lines = own_lines(said)
    assert any("/valve: de-energised, the PLC has been silent for 1 s" in line for line in lines), said
    assert file.read_text().splitlines()[1].startswith("/valve,heartbeat,0,40001,UINT16")
