"""The registers of a `PlcStation` as a Modbus TCP server, which any number of PLCs may poll."""

from __future__ import annotations

import asyncio
import struct
import time
from collections.abc import Callable
from typing import Final

from valve_sim.model.errors import ValveError
from valve_sim.station.plc import PlcStation, RefusedError, UnknownRegisterError

READ, READ_INPUT, WRITE_ONE, WRITE = 3, 4, 6, 16
"""Functions that are answered; holding and input registers are the same."""
ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE = 1, 2, 3
"""Exceptions by which others are refused; what is refused changes nothing."""
_MOST_READ, _MOST_WRITTEN, _LONGEST_FRAME = 125, 123, 254
"""Registers in one request, and bytes after its length, by the specification of Modbus."""
_HEAD: Final = struct.Struct(">HHH")
_TWO: Final = struct.Struct(">HH")
IDLE_SECONDS: Final = 120.0
"""s without a whole request, after which a connection is closed: twice the longest watchdog."""
MOST_CONNECTIONS: Final = 100
"""Beyond it the connection that has been idle for longest is closed, so that nobody keeps a PLC out."""

Clock = Callable[[], float]


class PlcServer:
    """A Modbus TCP server; every unit identifier is answered.

    Args:
        station: what is read and written. address, port: that it listens on. clock: s, does not go back.
        idle: s without a whole request, after which a connection is closed.
    """

    def __init__(
        self, station: PlcStation, address: str, port: int, clock: Clock = time.monotonic, idle: float = IDLE_SECONDS
    ) -> None:
        self._station, self._place, self._clock, self._idle = station, (address, port), clock, idle
        self._heard_at: dict[asyncio.StreamWriter, float] = {}
        """Of each connection the time of its last request, s of time.monotonic; the longest idle one comes first."""

    async def start(self) -> None:
        """Listen.

        Raises:
            ValveError: the port is taken.
        """
        address, port = self._place
        try:
            self._server = await asyncio.start_server(self._serve, address, port)
        except OSError as error:
            raise ValveError(
                f"port {port} of {address}: cannot be listened on ({error}); choose another by the parameter port"
            ) from error
        self._closing = asyncio.create_task(self._close_idle())

    async def stop(self) -> None:
        """Close all connections."""
        self._closing.cancel()
        self._server.close()
        for writer in self._heard_at:
            writer.transport.abort()
        while self._heard_at:  # each takes itself out
            await asyncio.sleep(0.01)

    def _drop(self, writer: asyncio.StreamWriter) -> None:
        del self._heard_at[writer]
        writer.transport.abort()

    async def _close_idle(self) -> None:
        while True:
            await asyncio.sleep(min(1.0, self._idle))
            limit = time.monotonic() - self._idle
            for writer in [writer for writer, at in self._heard_at.items() if at < limit]:
                self._drop(writer)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Answer one connection until it ends or sends what is no Modbus."""
        self._heard_at[writer] = time.monotonic()
        if len(self._heard_at) > MOST_CONNECTIONS:
            self._drop(next(iter(self._heard_at)))
        try:
            while True:
                number, protocol, length = _HEAD.unpack(await reader.readexactly(_HEAD.size))
                if protocol != 0 or not 2 <= length <= _LONGEST_FRAME:
                    return
                unit, *request = await reader.readexactly(length)
                del self._heard_at[writer]
                self._heard_at[writer] = time.monotonic()
                answer = bytes([unit, *self.answer(bytes(request))])
                writer.write(_HEAD.pack(number, 0, len(answer)) + answer)
                await writer.drain()
        except (OSError, asyncio.IncompleteReadError, KeyError):
            return  # it ended, was idle for too long, or had to make room for others
        finally:
            self._heard_at.pop(writer, None)
            writer.close()

    def answer(self, request: bytes) -> bytes:
        """The answer to a request, both from the function's code on."""
        try:
            return self._answered(request)
        except UnknownRegisterError:
            code = ILLEGAL_ADDRESS
        except (RefusedError, struct.error):
            code = ILLEGAL_VALUE
        except KeyError:
            code = ILLEGAL_FUNCTION
        return bytes([request[0] | 0x80, code])

    def _answered(self, request: bytes) -> bytes:
        """Raises RefusedError or struct.error for a value, UnknownRegisterError, and KeyError for a function."""
        now, function, content = self._clock(), request[0], request[1:]
        if function in (READ, READ_INPUT):
            first, count = _TWO.unpack(content)
            if not 1 <= count <= _MOST_READ:
                raise RefusedError(f"found {count} registers to be read, expected 1 to {_MOST_READ}")
            if first + count > self._station.count:
                raise UnknownRegisterError(f"register {first + count - 1}: is not in the map")
            registers = self._station.read(now)[first : first + count]
            return struct.pack(f">BB{count}H", function, 2 * count, *registers)
        if function == WRITE_ONE:
            first, value = _TWO.unpack(content)
            self._station.write(first, [value], now)
            return request
        if function == WRITE:
            first, count, length = struct.unpack(">HHB", content[:5])
            if not 1 <= count <= _MOST_WRITTEN or length != 2 * count:
                raise RefusedError(f"found {count} registers in {length} bytes, expected 1 to {_MOST_WRITTEN}")
            self._station.write(first, struct.unpack(f">{count}H", content[5:]), now)
            return request[:5]
        raise KeyError(function)
