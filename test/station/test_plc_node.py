"""plc_node between a PLC and a valve: commands, states, silence, and the end."""

from __future__ import annotations

import contextlib
import signal
import socket
from collections.abc import Callable
from pathlib import Path

import pytest
from nodes.ros_process import Probe, ended, free_port, own_lines, piped

from valve_sim.station.plc import STATUS

from .test_modbus import Ask, pymodbus_client


@pytest.mark.ros
def test_a_plc_opens_a_valve_reads_it_falls_silent_and_the_coil_is_off(probe: Probe, tmp_path: Path) -> None:
    from nodes.ros import LATCHED, Bool, Float64, UInt8

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
        ask, close = connected_when_it_listens(probe, port)
        probe.spin_for(0.5)
        assert not volts, "nothing is commanded before the PLC has written"
        other = probe.talker("coil_voltage", Float64)

        def beat(command: int) -> list[int]:
            nonlocal beats
            beats += 1
            ask(16, 0, 2, [beats, command])
            status = ask(4, STATUS, 8, [])
            assert isinstance(status, list)
            return status

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
        assert probe.node.destroy_publisher(other)
        close()
        said = ended(process, signal.SIGINT)
        assert probe.until(lambda: volts[-1].data == 0.0), said
    lines = own_lines(said)
    assert any("/valve/coil_voltage: another node commands this valve, too" in line for line in lines), said
    assert any("/valve: de-energised, the PLC has been silent for 1 s" in line for line in lines), said
    assert file.read_text().splitlines()[1].startswith("/valve,heartbeat,0,40001,UINT16")


def connected_when_it_listens(probe: Probe, port: int) -> tuple[Ask, Callable[[], None]]:
    found: list[tuple[Ask, Callable[[], None]]] = []

    def try_it() -> bool:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1.0):
            found.append(pymodbus_client(port))
        return bool(found)

    assert probe.until(try_it)
    return found[0]


@pytest.mark.ros
def test_without_a_plc_it_commands_nothing_to_its_end(probe: Probe, tmp_path: Path) -> None:
    from nodes.ros import Float64

    volts, port = probe.hear("coil_voltage", Float64), free_port()
    program = ("-m", "valve_sim.station", "plc_node")
    with piped(tmp_path, program, port=port, address="127.0.0.1") as process:
        _, close = connected_when_it_listens(probe, port)
        assert probe.until(lambda: probe.node.count_publishers("/valve/coil_voltage"))
        close()
        ended(process, signal.SIGINT)
    probe.spin_for(0.5)
    assert not volts
