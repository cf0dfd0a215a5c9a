"""The registers of a `PlcStation` in a PLC that is the server: polled over Modbus TCP by pymodbus."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from typing import Any, Final

from pymodbus.client import AsyncModbusTcpClient
from pymodbus.exceptions import ModbusException

from valve_sim.station.modbus import Clock
from valve_sim.station.plc import COMMANDS, SPACING, STATUS, PlcStation, RefusedError

logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # it logs each lost connection; `say` tells it once
_STATUS_COUNT: Final = 8


class PlcClient:
    """Polls a PLC that is the server: reads its commands, writes the status, and connects again if it does not answer.

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
        # asyncio.wait_for, in pymodbus, loses a cancellation that comes with an answer, before Python 3.12.
        while not self._task.done():
            self._task.cancel()
            await asyncio.wait([self._task], timeout=0.1)
        if not self._task.cancelled():
            self._task.result()

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
