"""Modbus TCP against real peers, pymodbus's client and server, and byte by byte."""

from __future__ import annotations

import asyncio
import contextlib
import os
import random
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
from valve_sim.station.modbus import MOST_CONNECTIONS, PlcServer
from valve_sim.station.modbus_client import PlcClient
from valve_sim.station.plc import STATUS, PlcStation

Answer = list[int] | int
"""Registers, or the code of an exception."""
Ask = Callable[[int, int, int, Sequence[int]], Answer]
"""Sends a request: function, first address, count, values to be written."""
WATCHDOG = 0.5
BEAT = struct.pack(">BHHB2H", 16, 0, 2, 4, 9, 0)


class Served:
    """A server of two valves that obey at once, and whose clock the test sets."""

    def __init__(self, idle: float = 120.0) -> None:
        self.now = 100.0
        self.port = free_port()
        self.station = PlcStation(("tank_1", "tank_2"), WATCHDOG, changed=self._obey)
        for valve in range(2):
            self._obey(valve)
        server = PlcServer(self.station, "127.0.0.1", self.port, clock=lambda: self.now, idle=idle)
        self.thread = LoopThread("modbus", server)
        self.thread.start()

    def _obey(self, valve: int) -> None:
        is_on = self.station.is_on(valve, self.now)
        self.station.hear(valve, self.now, phase=4 if is_on else 0, is_open=is_on, outlet_pressure=1e5)


@pytest.fixture
def served() -> Iterator[Served]:
    server = Served()
    yield server
    assert server.thread.stop(10.0)


def pymodbus_client(port: int) -> tuple[Ask, Callable[[], None]]:
    client = ModbusTcpClient("127.0.0.1", port=port, timeout=10)
    assert client.connect()

    def ask(function: int, first: int, count: int, values: Sequence[int]) -> Answer:
        bits = [value % 2 == 1 for value in values]
        send: dict[int, Callable[[], Any]] = {
            1: lambda: client.read_coils(first, count=count),
            2: lambda: client.read_discrete_inputs(first, count=count),
            3: lambda: client.read_holding_registers(first, count=count),
            4: lambda: client.read_input_registers(first, count=count),
            5: lambda: client.write_coil(first, bits[0]),
            6: lambda: client.write_register(first, values[0]),
            15: lambda: client.write_coils(first, bits),
            16: lambda: client.write_registers(first, list(values)),
            23: lambda: client.readwrite_registers(
                read_address=first, read_count=count, address=first, values=list(values)
            ),
        }
        answer = send[function]()
        return int(answer.exception_code) if answer.isError() else list(answer.registers)

    return ask, client.close


class Map:
    """What two valves' registers hold and answer, written from docs/reference/modbus.md and how_to/plc.md alone."""

    def __init__(self) -> None:
        self.registers = [0] * 40
        self._heartbeats: list[int | None] = [None, None]
        self._beat_at, self._is_armed, self._trips = [-9.0, -9.0], [False, False], [0, 0]
        self._pressure = list(struct.unpack(">2H", struct.pack(">f", 1e5)))

    def answer(self, function: int, first: int, count: int, values: Sequence[int], now: float) -> Answer:
        """The answer to a request; a write that is refused changes nothing."""
        for valve in range(2):
            self._settle(valve, now)
        if function not in (3, 4, 6, 16):
            return 1
        if function in (3, 4):
            return self.registers[first : first + count] if first + count <= 40 else 2
        places = range(first, first + len(values))
        if any(place not in (0, 1, 20, 21) for place in places):
            return 2
        if any(place % 20 == 1 and value > 1 for place, value in zip(places, values, strict=True)):
            return 3
        for place, value in zip(places, values, strict=True):
            self.registers[place] = value
            if place % 20 == 0:
                valve = place // 20
                if self._heartbeats[valve] not in (None, value):
                    self._beat_at[valve] = now
                self._heartbeats[valve] = value
        for valve in {place // 20 for place in places}:
            is_alive = now - self._beat_at[valve] <= WATCHDOG
            self._is_armed[valve] |= is_alive and self.registers[20 * valve + 1] == 0
            self._settle(valve, now)
        return list(values)

    def _settle(self, valve: int, now: float) -> None:
        """What a PLC reads of a valve, which obeys at once."""
        base, is_alive = 20 * valve, now - self._beat_at[valve] <= WATCHDOG
        command = self.registers[base + 1]
        self._trips[valve] += self._is_armed[valve] and not is_alive and command
        self._is_armed[valve] &= is_alive
        is_on = self._is_armed[valve] and command == 1
        bits = is_on | is_on << 1 | (not is_alive) << 2 | (not self._is_armed[valve]) << 3 | 1 << 4
        status = [self.registers[base], bits, 4 * is_on, int(is_on), *self._pressure, 0, self._trips[valve]]
        self.registers[base + 10 : base + 18] = status


def request(source: random.Random) -> tuple[int, int, int, list[int]]:
    """A request: one of two is a cycle of a PLC, as a whole or in part."""
    beat, command, valve = source.randrange(65536), source.choice((0, 1)), source.choice((0, 20))
    if source.random() < 0.5:
        part = source.choice(((16, 0, [beat, command]), (6, 0, [beat]), (6, 1, [command]), (16, 1, [command])))
        return part[0], valve + part[1], 1, part[2]
    function = source.choice((1, 2, 3, 4, 5, 6, 6, 6, 15, 16, 16, 16, 23))
    first = source.choice((0, 0, 0, 1, 1, 20, 20, 21, source.randrange(60), source.randrange(65000)))
    count = source.choice((1, 2, 8, 20, 40, source.randrange(1, 126)))
    if function in (1, 2):
        count = min(count, 100)
    length = 1 if function in (5, 6) else source.choice((1, 2, 2, 2, 3, 22))
    return function, first, count, [source.choice((0, 0, 1, 1, 2, source.randrange(65536))) for _ in range(length)]


@pytest.mark.parametrize("count", [500, pytest.param(10_000, marks=pytest.mark.long)])
def test_the_state_and_the_answer_to_any_request_agree(served: Served, count: int) -> None:
    ask, close = pymodbus_client(served.port)
    source, registers, energised = random.Random(count), Map(), 0
    for _ in range(count):
        served.now += source.choice((0.0, 0.01, 0.02, 0.1, 0.7))
        for valve in range(2):  # a valve says what it does whenever the watchdog may have acted
            served._obey(valve)
        sent = request(source)
        expected = registers.answer(*sent, served.now)
        found = ask(*sent)
        assert found == expected if sent[0] in (3, 4) or isinstance(expected, int) else isinstance(found, list), sent
        state = served.station.read(served.now)
        assert state == registers.registers, sent
        energised += state[11] >> 1 & 1
    assert energised > count // 50, "too few requests switch anything"
    close()


REFUSED = [
    pytest.param(struct.pack(">BHH", 1, 0, 1), 1, id="coils"),
    pytest.param(struct.pack(">BHHHHBH", 23, 0, 1, 0, 1, 2, 1), 1, id="read and write"),
    pytest.param(struct.pack(">BHHH", 22, 0, 0, 1), 1, id="mask"),
    pytest.param(b"\x63" + bytes(40), 1, id="no function"),
    pytest.param(struct.pack(">BHH", 3, 30, 11), 2, id="read beyond the map"),
    pytest.param(struct.pack(">BHH", 6, STATUS, 1), 2, id="write the status"),
    pytest.param(struct.pack(">BHH", 6, 40, 0), 2, id="write beyond the map"),
    pytest.param(struct.pack(">BHHB3H", 16, 0, 3, 6, 9, 0, 0), 2, id="write past the commands"),
    pytest.param(struct.pack(">BHHB2H", 16, 1, 2, 4, 7, 0), 2, id="a wrong value in a wrong place"),
    pytest.param(struct.pack(">BHH", 6, 1, 2), 3, id="a command that is none"),
    pytest.param(struct.pack(">BHHB2H", 16, 0, 2, 4, 9, 7), 3, id="a heartbeat and a command that is none"),
    pytest.param(struct.pack(">BHH", 3, 0, 0), 3, id="read nothing"),
    pytest.param(struct.pack(">BHH", 3, 0, 126), 3, id="read too much"),
    pytest.param(struct.pack(">BHHB2H", 16, 0, 2, 9, 9, 0), 3, id="another length than said"),
    pytest.param(struct.pack(">BHHB", 16, 0, 2, 4), 3, id="values left out"),
    pytest.param(struct.pack(">BH", 3, 0), 3, id="cut off"),
]


@pytest.mark.parametrize(("content", "code"), REFUSED)
def test_a_refused_request_is_answered_by_its_exception_and_changes_nothing(content: bytes, code: int) -> None:
    station = PlcStation(("tank_1", "tank_2"), WATCHDOG)
    station.write(0, [3, 0], 1.0)
    server = PlcServer(station, "127.0.0.1", 0, clock=lambda: 1.1)
    before = station.read(1.1)
    assert server.answer(content) == bytes([content[0] | 0x80, code])
    assert station.read(1.1) == before


def test_an_answer_is_what_the_specification_says_to_the_byte() -> None:
    server = PlcServer(PlcStation(("tank_1",), WATCHDOG), "127.0.0.1", 0, clock=lambda: 1.0)
    assert server.answer(BEAT) == BEAT[:5]
    assert server.answer(struct.pack(">BHH", 6, 0, 7)) == struct.pack(">BHH", 6, 0, 7)
    assert server.answer(struct.pack(">BHH", 4, 0, 2)) == struct.pack(">BB2H", 4, 4, 7, 0)


def test_a_plc_that_falls_silent_is_seen_by_the_clock_alone(served: Served) -> None:
    ask, close = pymodbus_client(served.port)

    def bits(*written: int) -> int:
        ask(16, 0, 2, written)
        answer = ask(4, STATUS, 8, [0])
        assert isinstance(answer, list)
        return answer[1]

    bits(1, 0), bits(2, 0)
    assert bits(3, 1) & 0b111 == 0b011
    served.now += 0.499
    assert served.station.is_on(0, served.now)
    served.now += 0.002
    assert not served.station.is_on(0, served.now)
    assert bits(3, 1) & 0b1110 == 0b1100, "silent, not energised, and a 0 has to come first"
    bits(4, 0)
    assert bits(5, 1) & 0b1110 == 0b0010
    close()


def frame(number: int, body: bytes, length: int | None = None, protocol: int = 0) -> bytes:
    return struct.pack(">HHHB", number, protocol, len(body) + 1 if length is None else length, 1) + body


def test_broken_frames_and_floods_change_nothing_and_leave_the_server_serving(served: Served) -> None:
    ask, close = pymodbus_client(served.port)
    ask(16, 0, 2, [1, 0]), ask(16, 0, 2, [2, 0]), ask(16, 0, 2, [3, 1])
    broken = (b"\x00", os.urandom(300), b"GET / HTTP/1.1\r\n\r\n", frame(1, BEAT[:5], 20), frame(2, BEAT, protocol=1),
              frame(3, b"", 1), frame(4, b"\x03" + bytes(400)), b"\xff" * 5000)  # fmt: skip
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
        ask(16, 0, 2, [4, 1])
        assert served.station.read(served.now)[:2] == [4, 1] and served.station.is_on(0, served.now)
    close()


def test_idle_connections_keep_no_plc_out(served: Served) -> None:
    """Three times as many as the server keeps: the busy one stays, a new one is served, and the oldest are closed."""
    ask, close = pymodbus_client(served.port)
    idle = []
    for number in range(3 * MOST_CONNECTIONS):
        idle.append(socket.create_connection(("127.0.0.1", served.port), timeout=10.0))
        if number % 50 == 0:
            assert isinstance(ask(16, 0, 2, [number, 0]), list)
    late, close_late = pymodbus_client(served.port)
    assert late(3, 0, 2, []) == [250, 0]
    for peer in idle[: 2 * MOST_CONNECTIONS]:
        with peer, contextlib.suppress(ConnectionError):
            assert peer.recv(1) == b""
    for peer in idle[2 * MOST_CONNECTIONS :]:
        peer.close()
    close_late(), close()


def test_an_idle_connection_is_closed_and_a_busy_one_is_not() -> None:
    served = Served(idle=0.4)
    ask, close = pymodbus_client(served.port)
    with socket.create_connection(("127.0.0.1", served.port), timeout=10.0) as idle:
        idle.sendall(frame(1, BEAT)[:6])
        end = time.monotonic() + 1.2
        while time.monotonic() < end:
            assert ask(3, 0, 2, []) == [0, 0]
            time.sleep(0.05)
        with pytest.raises(ConnectionError):
            if idle.recv(1) == b"":
                raise ConnectionResetError
    close()
    assert served.thread.stop(10.0)


def test_a_port_that_is_taken_is_one_line(served: Served) -> None:
    other = LoopThread("modbus", PlcServer(served.station, "127.0.0.1", served.port))
    with pytest.raises(ValveError, match="cannot be listened on"):
        other.start()


def plain_registers(port: int, act: Any = None, count: int = 40) -> ModbusTcpServer:
    """A PLC that is the server: pymodbus's, with so many registers from 100 on."""
    registers = SimData(100, count=count, values=0, datatype=DataType.REGISTERS)
    return ModbusTcpServer(SimDevice(0, simdata=[registers], action=act), address=("127.0.0.1", port))


def test_polling_ends_whenever_it_is_stopped() -> None:
    """While an answer comes, too, which may take the place of what cancels."""

    async def play() -> None:
        server = plain_registers(port := free_port())
        await server.serve_forever(background=True)
        for turns in range(30):
            client = PlcClient(PlcStation(("valve",), watchdog=0.5), "127.0.0.1", port, first=100, period=0.0)
            await client.start()
            while client.cycles < 2:
                await asyncio.sleep(0.0)
            for _ in range(turns):
                await asyncio.sleep(0.0)
            stopping = asyncio.create_task(client.stop())
            done, _ = await asyncio.wait([stopping], timeout=20.0)
            cycles = client.cycles
            await asyncio.sleep(0.0)
            assert done and client.cycles == cycles
        await server.shutdown()

    asyncio.run(play())


@pytest.mark.parametrize(
    ("count", "words"), [(1, "register 100 cannot be read"), (12, "register 110 cannot be written")]
)
def test_registers_that_a_plc_does_not_have_are_said_and_switch_nothing(count: int, words: str) -> None:
    async def play() -> None:
        said: list[str] = []
        server = plain_registers(port := free_port(), count=count)
        await server.serve_forever(background=True)
        client = PlcClient(PlcStation(("valve",), watchdog=0.5), "127.0.0.1", port, first=100, say=said.append)
        await client.start()
        while not said:
            await asyncio.sleep(0.005)
        assert words in said[0] and client.cycles == 0
        await client.stop()
        await server.shutdown()

    asyncio.run(asyncio.wait_for(play(), 60.0))


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
            server = plain_registers(port, act)
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
