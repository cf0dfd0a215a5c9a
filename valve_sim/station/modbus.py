"""The registers of a `PlcStation` over Modbus TCP: as a server that a PLC polls, or as a client that polls a PLC."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from typing import Any, Final

from pymodbus.client import AsyncModbusTcpClient
from pymodbus.constants import ExcCodes
from pymodbus.exceptions import ModbusException
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from valve_sim.model.errors import ValveError
from valve_sim.station.plc import COMMANDS, SPACING, STATUS, PlcStation, RefusedError

# pymodbus logs each broken frame, which anybody on the network can send by the thousand.
logging.getLogger("pymodbus").setLevel(logging.CRITICAL)

_READS, _WRITES = (3, 4), (6, 16)
_STATUS_COUNT: Final = 8
Clock = Callable[[], float]


class PlcServer:
    """A Modbus TCP server, which any number of PLCs may poll; every unit identifier is answered.

    Args:
        station: what is read and written. address, port: that it listens on. clock: s, does not go back.
    """

    def __init__(self, station: PlcStation, address: str, port: int, clock: Clock = time.monotonic) -> None:
        self._station, self._place, self._clock = station, (address, port), clock
        self._server: Any = None

    async def start(self) -> None:
        """Listen.

        Raises:
            ValveError: the port is taken.
        """
        block = SimData(0, count=self._station.count, values=0, datatype=DataType.REGISTERS)
        device = SimDevice(0, simdata=[block], action=self._act)
        self._server = ModbusTcpServer(device, address=self._place)
        address, port = self._place
        try:
            await self._server.serve_forever(background=True)
        except (OSError, RuntimeError) as error:
            raise ValveError(
                f"port {port} of {address}: cannot be listened on ({error}); choose another by the parameter port"
            ) from error

    async def stop(self) -> None:
        """Close all connections."""
        await self._server.shutdown()

    async def _act(self, function: int, first: int, address: int, count: int, registers: list[int], values: Any) -> Any:
        """Answer one request: registers are the station's, whatever pymodbus keeps of them."""
        now = self._clock()
        if function in _WRITES:
            try:
                self._station.write(address, values, now)
            except RefusedError:
                return ExcCodes.ILLEGAL_VALUE
        elif function not in _READS:
            return ExcCodes.ILLEGAL_FUNCTION
        registers[:] = self._station.read(now)
        return None


class PlcClient:
    """Polls a PLC that is the server: reads its commands, writes the status, and begins anew where it does not answer.

    The PLC has the map's registers from an address of its own on.

    Args:
        station: what is read and written. host, port: of the PLC. first: address of the map's first register there.
        unit: identifier of the PLC. period: s from cycle to cycle. say: told when the PLC is lost and found.
        clock: s, does not go back.
    """

    def __init__(
        self, station: PlcStation, host: str, port: int, *, first: int = 0, unit: int = 1, period: float = 0.01,
        say: Callable[[str], None] = lambda words: None, clock: Clock = time.monotonic,
    ) -> None:  # fmt: skip
        self._station, self._host, self._port = station, host, port
        self._first, self._unit, self._period = first, unit, period
        self._say, self._clock = say, clock
        self._task: Any = None
        self.cycles = 0

    async def start(self) -> None:
        """Begin to poll."""
        self._task = asyncio.create_task(self._poll())

    async def stop(self) -> None:
        """Stop polling."""
        self._task.cancel()
        try:
            await self._task
        except asyncio.CancelledError:
            return

    async def _poll(self) -> None:
        client = AsyncModbusTcpClient(self._host, port=self._port, timeout=1.0, retries=0, reconnect_delay=0.1)
        is_lost, place = False, f"the PLC at {self._host}:{self._port}"
        due = self._clock()
        try:
            while True:
                try:
                    if not client.connected and not await client.connect():
                        raise ModbusException("no connection")
                    await self._cycle(client)
                except (ModbusException, OSError, asyncio.TimeoutError) as error:
                    if not is_lost:
                        self._say(f"{place} does not answer ({error}); its coils are de-energised by their watchdogs")
                    is_lost = True
                    client.close()
                    await asyncio.sleep(0.1)
                    continue
                if is_lost:
                    self._say(f"{place} answers again")
                is_lost = False
                self.cycles += 1
                due = max(due + self._period, self._clock())
                await asyncio.sleep(max(0.0, due - self._clock()))
        finally:
            client.close()

    async def _cycle(self, client: Any) -> None:
        for valve in range(len(self._station.valves)):
            base = SPACING * valve
            found = await client.read_holding_registers(self._first + base, count=COMMANDS, device_id=self._unit)
            if found.isError() or len(found.registers) != COMMANDS:
                raise ModbusException(f"register {self._first + base} cannot be read: {found}")
            try:
                self._station.write(base, found.registers, self._clock())
            except RefusedError as error:
                self._say(f"a command of the PLC is left out: {error}")
            status = self._station.read(self._clock())[base + STATUS : base + STATUS + _STATUS_COUNT]
            done = await client.write_registers(self._first + base + STATUS, status, device_id=self._unit)
            if done.isError():
                raise ModbusException(f"register {self._first + base + STATUS} cannot be written: {done}")
