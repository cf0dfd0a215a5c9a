"""Modbus TCP against real peers: pymodbus's own client and server, and libmodbus where it is installed."""

from __future__ import annotations

import asyncio
import ctypes
import os
import socket
import struct
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import pytest
from nodes.ros_process import free_port

pytest.importorskip("pymodbus", reason="pymodbus is not installed: pip install '.[modbus]'")

from pymodbus.client import ModbusTcpClient
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from valve_sim.model import ValveError
from valve_sim.station.loop_thread import LoopThread
from valve_sim.station.modbus import PlcClient, PlcServer
from valve_sim.station.plc import STATUS, PlcStation

Cycle = Callable[[int, int], list[int]]
"""Writes heartbeat and command, and reads the eight registers of the status."""


class Served:
    """A server of one valve that obeys at once, and whose clock the test sets."""

    def __init__(self) -> None:
        self.now = 100.0
        self.port = free_port()
        self.station = PlcStation(("valve",), watchdog=0.5, changed=self._obey)
        self._obey(0)
        self.thread = LoopThread("modbus", PlcServer(self.station, "127.0.0.1", self.port, clock=lambda: self.now))
        self.thread.start()

    def _obey(self, valve: int) -> None:
        is_on = self.station.is_on(valve, self.now)
        self.station.hear(valve, self.now, phase=4 if is_on else 0, is_open=is_on, outlet_pressure=1e5)


@pytest.fixture
def served() -> Iterator[Served]:
    server = Served()
    yield server
    assert server.thread.stop(10.0)


def pymodbus_cycle(port: int) -> tuple[Cycle, Callable[[], None]]:
    client = ModbusTcpClient("127.0.0.1", port=port, timeout=10)
    assert client.connect()

    def cycle(heartbeat: int, command: int) -> list[int]:
        assert not client.write_registers(0, [heartbeat, command]).isError()
        return list(client.read_input_registers(STATUS, count=8).registers)

    return cycle, client.close


def libmodbus_cycle(port: int) -> tuple[Cycle, Callable[[], None]]:
    try:
        library = ctypes.CDLL("libmodbus.so.5")
    except OSError:
        pytest.skip("libmodbus, a client of another make, is not installed: apt install libmodbus5")
    library.modbus_new_tcp.restype = ctypes.c_void_p
    context = ctypes.c_void_p(library.modbus_new_tcp(b"127.0.0.1", port))
    library.modbus_set_response_timeout(context, 10, 0)
    assert library.modbus_connect(context) == 0

    def cycle(heartbeat: int, command: int) -> list[int]:
        written = (ctypes.c_uint16 * 2)(heartbeat, command)
        assert library.modbus_write_registers(context, 0, 2, written) == 2
        read = (ctypes.c_uint16 * 8)()
        assert library.modbus_read_registers(context, STATUS, 8, read) == 8
        return list(read)

    def close() -> None:
        library.modbus_close(context)
        library.modbus_free(context)

    return cycle, close


CLIENTS = pytest.mark.parametrize("make", [pymodbus_cycle, libmodbus_cycle], ids=["pymodbus", "libmodbus"])


@CLIENTS
@pytest.mark.parametrize("cycles", [500, pytest.param(10_000, marks=pytest.mark.long)])
def test_no_cycle_shows_a_wrong_state(served: Served, make: Callable[[int], Any], cycles: int) -> None:
    cycle, close = make(served.port)
    cycle(0, 0)
    for number in range(1, cycles):
        served.now += 0.01
        heartbeat, command = number & 0xFFFF, number // 3 % 2
        echo, status, phase, is_open, *_ = cycle(heartbeat, command)
        assert (echo, status & 0b111, phase, is_open) == (heartbeat, 0b011 * command, 4 * command, command), number
    assert served.station.read(served.now)[17] == 0
    close()


@CLIENTS
def test_a_plc_that_falls_silent_is_seen_by_the_clock_alone(served: Served, make: Callable[[int], Any]) -> None:
    cycle, close = make(served.port)
    cycle(1, 0), cycle(2, 0)
    assert cycle(3, 1)[1] & 0b111 == 0b011
    served.now += 0.499
    assert served.station.is_on(0, served.now)
    served.now += 0.002
    assert not served.station.is_on(0, served.now)
    assert cycle(3, 1)[1] & 0b1110 == 0b1100, "silent, not energised, and a 0 has to come first"
    cycle(4, 0)
    assert cycle(5, 1)[1] & 0b1110 == 0b0010
    close()


def test_what_is_not_in_the_map_is_refused_and_changes_nothing(served: Served) -> None:
    client = ModbusTcpClient("127.0.0.1", port=served.port, timeout=10)
    assert client.connect()
    before = served.station.read(served.now)
    for refused in (
        client.write_registers(0, [7, 2]),
        client.write_register(STATUS, 1),
        client.write_registers(1, [0, 0, 0]),
        client.write_register(500, 1),
        client.read_holding_registers(0, count=100),
        client.write_coil(0, True),
        client.read_coils(0, count=1),
    ):
        assert refused.isError()
    assert served.station.read(served.now) == before
    client.close()


def frame(number: int, body: bytes, length: int | None = None, protocol: int = 0) -> bytes:
    return struct.pack(">HHHB", number, protocol, len(body) + 1 if length is None else length, 1) + body


def test_broken_frames_and_floods_change_nothing_and_leave_the_server_serving(served: Served) -> None:
    cycle, close = pymodbus_cycle(served.port)
    cycle(1, 0), cycle(2, 0), cycle(3, 1)
    write = struct.pack(">BHHB2H", 16, 0, 2, 4, 9, 0)
    broken: Sequence[bytes] = (
        b"\x00",
        os.urandom(300),
        b"GET / HTTP/1.1\r\n\r\n",
        frame(1, write[:5], 20),  # cut off
        frame(2, struct.pack(">BHHB2H", 16, 0, 2, 9, 9, 0)),  # a count that is not so
        frame(3, struct.pack(">BHH", 16, 0, 0xFFFF)),
        frame(4, b"\x63" + bytes(40)),  # no such function
        frame(5, struct.pack(">BHHB2H", 16, 0, 2, 4, 9, 7)),  # a command that is none
        frame(6, struct.pack(">BHH", 3, 0, 0xFFFF)),
        b"\xff" * 5000,
    )
    for content in broken:
        with socket.create_connection(("127.0.0.1", served.port)) as peer:
            peer.sendall(content)
            peer.shutdown(socket.SHUT_WR)
            peer.settimeout(10.0)
            try:
                while peer.recv(4096):
                    pass
            except OSError:
                pass
        assert served.station.read(served.now)[:2] == [3, 1], content[:20]
    with socket.create_connection(("127.0.0.1", served.port)) as flood:
        flood.settimeout(0.2)
        try:
            for number in range(20_000):
                flood.send(frame(number & 0xFFFF, struct.pack(">BHH", 3, 0, 10)))
        except OSError:
            pass  # it takes no more before its answers are read
        echo, status, *_ = cycle(4, 1)
        assert (echo, status & 0b11) == (4, 0b11)
    close()


def test_a_port_that_is_taken_is_one_line(served: Served) -> None:
    other = LoopThread("modbus", PlcServer(served.station, "127.0.0.1", served.port))
    with pytest.raises(ValveError, match="cannot be listened on"):
        other.start()


def test_a_plc_that_is_the_server_is_polled_lost_and_found() -> None:
    """The PLC is pymodbus's server with plain registers; it beats whenever its command is read."""

    async def play() -> None:
        said: list[str] = []
        station = PlcStation(("valve",), watchdog=0.5)
        port, plc = free_port(), {"command": 0, "beat": 0, "status": [0] * 8}

        async def act(function: int, first: int, address: int, count: int, registers: list[int], values: Any) -> None:
            if function == 3:
                plc["beat"] = (int(plc["beat"]) + 1) & 0xFFFF  # type: ignore[call-overload]
                registers[:2] = [plc["beat"], plc["command"]]
            elif values:
                plc["status"] = list(values)

        async def begin() -> Any:
            device = SimDevice(0, simdata=[SimData(100, count=40, values=0, datatype=DataType.REGISTERS)], action=act)
            server = ModbusTcpServer(device, address=("127.0.0.1", port))
            await server.serve_forever(background=True)
            return server

        async def until(holds: Callable[[], bool]) -> None:
            limit = time.monotonic() + 60.0
            while not holds():
                assert time.monotonic() < limit
                await asyncio.sleep(0.005)

        server = await begin()
        client = PlcClient(station, "127.0.0.1", port, first=100, period=0.005, say=said.append)
        await client.start()
        await until(lambda: client.cycles > 5)
        plc["command"] = 1
        await until(lambda: station.is_on(0, time.monotonic()))
        await until(lambda: plc["status"][1] & 0b10)
        await server.shutdown()
        await until(lambda: not station.is_on(0, time.monotonic()))
        await until(lambda: bool(said))
        assert "does not answer" in said[0]
        server = await begin()
        cycles = client.cycles
        await until(lambda: client.cycles > cycles + 5)
        assert not station.is_on(0, time.monotonic()), "it came back with an old 1"
        plc["command"] = 0
        await until(lambda: plc["status"][1] & 0b1000 == 0)
        plc["command"] = 1
        await until(lambda: station.is_on(0, time.monotonic()))
        assert "answers again" in said[-1]
        await client.stop()
        await server.shutdown()

    asyncio.run(play())
