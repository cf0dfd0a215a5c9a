"""What a live valve shows, written at its places in a block of bytes that is sent as it is: a process image.

After a sleep of a millisecond each function of Python costs ten times what it costs in a loop. To read a valve's row,
name its numbers and encode them then takes three times as long as the step; compiled code writes them in a fraction.
"""

from __future__ import annotations

import enum
from typing import Any, Final, TypeAlias

import numpy as np
from numba.extending import register_jitable

from valve_sim.model.core_types import MAIN

NANOSECONDS: Final = 1_000_000_000


class Number(enum.IntEnum):
    """What an image can hold."""

    SECONDS = 0
    """Whole seconds of the stamp."""
    NANOSECONDS = 1
    """The rest of the stamp."""
    PILOT_POSITION = 2
    MAIN_POSITION = 3
    PILOT_VELOCITY = 4
    MAIN_VELOCITY = 5
    ATTRACTION = 6
    MAIN_EFFORT = 7
    COIL_CURRENT = 8
    COIL_VOLTAGE = 9


_NUMBERS: Final = len(Number)
KINDS: Final = {"d": 0, "f": 1, "i": 2, "I": 2}
"""How a number is written, as `struct` names it: in double or single precision, or as a whole number of 32 bits."""
_DOUBLE: Final = KINDS["d"]
_SINGLE: Final = KINDS["f"]
_DOUBLE_BYTES: Final = 8
_BYTES: Final = 4

ProcessImage: TypeAlias = tuple[Any, Any]
"""Its content, (n,) uint8, and places, (m, 3) int64: of each number the first of its bytes, a `Number` and a kind."""
NO_IMAGE: Final[ProcessImage] = (np.empty(0, np.uint8), np.empty((0, 3), np.int64))


@register_jitable
def fill_image(content, places, p, row, u, stamp):
    """Fill an image.

    Args:
        content, places: of the image. p: record of the valve. row: of output, see `sampling.ROW`.
        u: normalised coil current. stamp: ns.
    """
    numbers = np.empty(_NUMBERS)  # in the order of `Number`
    numbers[0] = stamp // NANOSECONDS
    numbers[1] = stamp % NANOSECONDS
    numbers[2] = row[0]
    numbers[3] = row[1]
    numbers[4] = row[2]
    numbers[5] = row[2] if row[4] == MAIN else 0.0
    numbers[6] = row[3]
    numbers[7] = -(p.spring_preload + p.spring_rate * row[5]) if row[4] >= MAIN else 0.0
    numbers[8] = u * (p.reference_voltage / p.coil_resistance)
    numbers[9] = row[6]
    singles, integers = numbers.astype(np.float32), numbers[:2].astype(np.int64)
    for j in range(len(places)):
        at, which, kind = places[j]
        if kind == _DOUBLE:
            _copy(content, at, numbers.view(np.uint8), _DOUBLE_BYTES * which, _DOUBLE_BYTES)
        elif kind == _SINGLE:
            _copy(content, at, singles.view(np.uint8), _BYTES * which, _BYTES)
        else:
            _copy(content, at, integers.view(np.uint8), _DOUBLE_BYTES * which, _BYTES)


@register_jitable
def _copy(content, at, source, first, count):
    for i in range(count):
        content[at + i] = source[first + i]
