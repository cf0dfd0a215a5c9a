"""Valves as registers of a PLC, and the watchdog that de-energises a coil when the PLC falls silent.

Independent of Modbus, ROS and clocks: each call gives the time, in s of one clock that never goes back.
"""

from __future__ import annotations

import csv
import io
import math
import struct
import threading
from collections.abc import Callable, Sequence
from typing import Any, Final, Literal, NamedTuple

from valve_sim.model.errors import ValveError

Access = Literal["written by the PLC", "read by the PLC"]
Kind = Literal["UINT16", "FLOAT32"]


class Register(NamedTuple):
    """One value of a valve in the map.

    Attributes:
        offset: of its first register from the valve's first one. name, kind, unit, description: what it is.
        access: who writes it.
    """

    offset: int
    name: str
    kind: Kind
    access: Access
    unit: str
    description: str

    @property
    def width(self) -> int:
        """Number of registers that it takes."""
        return 2 if self.kind == "FLOAT32" else 1


SPACING: Final = 20
"""Registers from one valve to the next."""
COMMANDS: Final = 2
"""Registers that the PLC writes, from a valve's first one on."""
STATUS: Final = 10
"""Offset of the first register that the PLC reads."""
UNKNOWN_PHASE: Final = 0xFFFF
_LARGEST: Final = 0xFFFF

MAP: Final = (
    Register(0, "heartbeat", "UINT16", "written by the PLC", "", "a new number within each watchdog time"),
    Register(1, "coil_command", "UINT16", "written by the PLC", "", "1: energise, 0: de-energise; others are refused"),
    Register(10, "heartbeat_echo", "UINT16", "read by the PLC", "", "last heartbeat that was received"),
    Register(
        11, "status", "UINT16", "read by the PLC", "",
        "bits: 0 is_open, 1 coil energised, 2 PLC silent, 3 a 0 has to be written before a 1 counts, 4 valve heard",
    ),
    Register(
        12, "phase", "UINT16", "read by the PLC", "", "0 closed, 1 pilot, 2 gap_hold, 3 main, 4 open, 65535: unknown"
    ),
    Register(13, "is_open", "UINT16", "read by the PLC", "", "1: the flow path is fully open"),
    Register(14, "outlet_pressure", "FLOAT32", "read by the PLC", "Pa", "absolute; NaN where it is not known"),
    Register(16, "own_heartbeat", "UINT16", "read by the PLC", "", "a new number at each cycle of plc_node"),
    Register(17, "trips", "UINT16", "read by the PLC", "", "times that the watchdog has de-energised the coil"),
)  # fmt: skip
"""The register map of one valve; holding registers, which are read by functions 3 and 4 and written by 6 and 16."""


class Coil:
    """The command of one coil as a PLC gives it.

    The coil is energised only while the heartbeat changes. It takes a 0 from a living PLC before a 1 counts, at the
    start and after each silence: a PLC that comes back with an old 1 in its memory opens nothing.

    Args:
        watchdog: s without another heartbeat, after which the coil is de-energised.
    """

    def __init__(self, watchdog: float) -> None:
        self._watchdog = watchdog
        self.heartbeat: int | None = None
        self._beat_at = -math.inf
        self.command = 0
        """The last one, obeyed or not."""
        self.is_armed = False
        """Whether a 1 counts."""
        self.is_heard = False
        """Whether the PLC has written to it."""
        self.trips = 0

    def write(self, heartbeat: int | None, command: int | None, now: float) -> None:
        """Take what the PLC wrote; None for what it did not write."""
        self.is_on(now)  # what ended before this write has ended, even if the PLC lives again
        self.is_heard = True
        if heartbeat is not None:
            if self.heartbeat is not None and heartbeat != self.heartbeat:
                self._beat_at = max(now, self._beat_at)
            self.heartbeat = heartbeat
        if command is not None:
            self.command = command
        if self.command == 0 and self.is_alive(now):
            self.is_armed = True

    def is_alive(self, now: float) -> bool:
        """Whether the heartbeat has changed within the watchdog's time."""
        return now - self._beat_at <= self._watchdog

    def is_on(self, now: float) -> bool:
        """Whether to energise the coil."""
        if not self.is_alive(now):
            if self.is_armed and self.command:
                self.trips += 1
            self.is_armed = False
        return self.is_armed and self.command == 1


class _Heard(NamedTuple):
    """What was heard of a valve last, and when, s."""

    phase: int | None = None
    is_open: bool = False
    outlet_pressure: float = math.nan
    at: float = -math.inf


class RefusedError(ValveError):
    """The PLC wrote what cannot be obeyed; nothing of it counts."""


class UnknownRegisterError(RefusedError):
    """The PLC asked for a register that is not in the map, or wrote one that a PLC does not write."""


class PlcStation:
    """The registers of some valves, written by a PLC and by what is heard of the valves. Any thread may call.

    Args:
        valves: their names, in the order of the map.
        watchdog: s without another heartbeat, after which a coil is de-energised.
        stale: s after which what was heard of a valve is no longer passed on as known.
        changed: told the place of a valve whose coil the PLC has switched, in the thread that wrote.
        low_word_first: whether the second half of a FLOAT32 is in the first register.
    """

    def __init__(
        self, valves: Sequence[str], watchdog: float, *, stale: float = 1.0,
        changed: Callable[[int], None] | None = None, low_word_first: bool = False,
    ) -> None:  # fmt: skip
        self.valves = tuple(valves)
        self._coils = [Coil(watchdog) for _ in valves]
        self._heard = [_Heard() for _ in valves]
        self._stale, self._changed, self._low_first = stale, changed, low_word_first
        self._own_heartbeat = 0
        self._lock = threading.Lock()

    @property
    def count(self) -> int:
        """Number of registers of the map."""
        return SPACING * len(self.valves)

    def hear(self, valve: int, now: float, **values: Any) -> None:
        """Take what was heard of a valve: phase, is_open or outlet_pressure; what was not heard stays."""
        with self._lock:
            self._heard[valve] = self._heard[valve]._replace(at=now, **values)

    def is_on(self, valve: int, now: float) -> bool:
        """Whether to energise a valve's coil."""
        with self._lock:
            return self._coils[valve].is_on(now)

    def is_heard(self, valve: int) -> bool:
        """Whether the PLC has written to a valve's registers."""
        with self._lock:
            return self._coils[valve].is_heard

    def is_silent(self, valve: int, now: float) -> bool:
        """Whether the PLC has shown no other heartbeat within the watchdog's time."""
        with self._lock:
            return not self._coils[valve].is_alive(now)

    def beat(self) -> None:
        """Count one cycle of this side."""
        with self._lock:
            self._own_heartbeat = (self._own_heartbeat + 1) & _LARGEST

    def write(self, address: int, values: Sequence[int], now: float) -> None:
        """Take registers that a PLC wrote, all or none.

        Raises:
            UnknownRegisterError: a PLC does not write such a register. RefusedError: a register cannot hold the value.
        """
        written: dict[int, dict[int, int]] = {}
        for place, value in enumerate(values, start=address):
            valve, offset = divmod(place, SPACING)
            if not 0 <= valve < len(self.valves) or offset >= COMMANDS:
                raise UnknownRegisterError(f"register {place}: is not written by a PLC")
            written.setdefault(valve, {})[offset] = value
        for valve, found in written.items():
            if found.get(1, 0) not in (0, 1):
                raise RefusedError(f"register {SPACING * valve + 1}: found {found[1]}, expected 0 or 1")
        switched = []
        with self._lock:
            for valve, found in written.items():
                before = self._coils[valve].is_on(now)
                self._coils[valve].write(found.get(0), found.get(1), now)
                if self._coils[valve].is_on(now) != before:
                    switched.append(valve)
        if self._changed is not None:
            for valve in switched:
                self._changed(valve)

    def read(self, now: float) -> list[int]:
        """All registers now."""
        with self._lock:
            registers = [0] * self.count
            for valve, (coil, heard) in enumerate(zip(self._coils, self._heard, strict=True)):
                base = SPACING * valve
                registers[base : base + COMMANDS] = [coil.heartbeat or 0, coil.command]
                for register, values in self._status(coil, heard, now):
                    first = base + register.offset
                    registers[first : first + register.width] = values
            return registers

    def _status(self, coil: Coil, heard: _Heard, now: float) -> list[tuple[Register, list[int]]]:
        is_on, is_heard = coil.is_on(now), now - heard.at <= self._stale
        bits = (heard.is_open and is_heard, is_on, not coil.is_alive(now), not coil.is_armed, is_heard)
        pressure = struct.unpack(">2H", struct.pack(">f", heard.outlet_pressure if is_heard else math.nan))
        values: dict[str, list[int]] = {
            "heartbeat_echo": [coil.heartbeat or 0],
            "status": [sum(1 << place for place, is_so in enumerate(bits) if is_so)],
            "phase": [heard.phase if is_heard and heard.phase is not None else UNKNOWN_PHASE],
            "is_open": [int(heard.is_open and is_heard)],
            "outlet_pressure": list(reversed(pressure) if self._low_first else pressure),
            "own_heartbeat": [self._own_heartbeat],
            "trips": [min(coil.trips, _LARGEST)],
        }
        return [(register, values[register.name]) for register in MAP if register.name in values]


def map_csv(valves: Sequence[str]) -> str:
    """The register map of some valves for the programs of a PLC: one line for each value."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["valve", "name", "address", "holding_register", "type", "access", "unit", "description"])
    for place, valve in enumerate(valves):
        for register in MAP:
            address = SPACING * place + register.offset
            where = valve, register.name, address, 40001 + address
            writer.writerow([*where, register.kind, register.access, register.unit, register.description])
    return text.getvalue()
