"""A line that several valves feed through their demand orifices, and the tank that it fills through one orifice more.

With the masses m_l of the line and m_v of the tank that is filled, isothermal as the volumes behind the valves,

    (L1)  m_l' = Σ A_i G(p_i, p_l) − A G(p_l, p_v),  m_v' = A G(p_l, p_v),  p = pressure of m/V

stepped by Euler's backward method: with h Σ A_i G at the end of the step as what has come in, m_v follows from p_l
there by the balance of mass, and (L1) leaves one equation in p_l, whose residual only grows with it. So whatever the
size of the step, no pressure passes another, and no mass is lost but to rounding.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.model.core.gas import critical_cubic, density_at, pressure_at, through
from valve_sim.model.core.machine import Library, made_once
from valve_sim.model.core.native import kernel, native
from valve_sim.model.core.plan import as_double
from valve_sim.model.core.polynomials import Block, invoke
from valve_sim.model.core.symbols import Own
from valve_sim.model.core.tracer import Trace
from valve_sim.model.gas.fluids import FLUIDS

_HALVINGS: Final = 100
"""Of the range of pressures, at most: rounding ends them after about 55."""
ADDRESS, HERE, THERE, HOLE, DENSITY, THROUGH, DENSITY_HERE, PRESSURE, FIRST_NUMBER = range(9)
"""Slots: of the kernel; two pressures, Pa, the hole between them, C_d A in m², and a density, kg/m³; and what it makes
of these: the flow from here to there, kg/s, the density here, and the pressure at that density."""
NUMBERS: Final = (
    "gas_constant", "covolume", "heat_capacity_ratio", "inlet_temperature", "critical_0", "critical_1", "critical_2",
    "critical_3",
)  # fmt: skip
"""What a fluid at one temperature is, from FIRST_NUMBER on."""
LINE, TANK, AREAS = 0, 1, 2
"""Slots of what is stepped: kg in the line, kg in the tank, C_d A of each orifice that feeds the line, then the
pressure before each, Pa; behind them as many slots for what has come through each, kg."""


class Gas:
    """A fluid at one temperature, K."""

    def __init__(self, fluid: str = "hydrogen", temperature: float = 288.15) -> None:
        known = FLUIDS[fluid]
        address, self._library = _kernel()
        numbers = (known.gas_constant, known.covolume, known.heat_capacity_ratio, temperature)
        of_gas = (*numbers, *critical_cubic(known.heat_capacity_ratio))
        self._block = np.array([as_double(address), *[0.0] * (FIRST_NUMBER - 1), *of_gas])

    def block(self) -> NDArray[np.float64]:
        """The slots above, of the caller's own."""
        return self._block.copy()

    def mass(self, pressure: float, volume: float) -> float:
        """Kg of gas in a volume, m³, at a pressure, Pa."""
        block = self.block()
        block[HERE] = pressure
        _asked()(block.ctypes.data)
        return float(volume * block[DENSITY_HERE])

    def pressure(self, mass: float, volume: float) -> float:
        """Pa of so much gas, kg, in a volume, m³."""
        block = self.block()
        block[DENSITY] = mass / volume
        _asked()(block.ctypes.data)
        return float(block[PRESSURE])


class Line(NamedTuple):
    """Sizes of a line and of what it fills.

    Attributes:
        gas: that flows. areas: C_d A of each valve's demand orifice, m². orifice: C_d A between line and tank, m².
        volume: of the line, m³. filled: volume of the tank that is filled, m³.
    """

    gas: Gas
    areas: Sequence[float]
    orifice: float
    volume: float
    filled: float

    def step(
        self, masses: tuple[float, float], pressures: Sequence[float], seconds: float, *, is_open: bool = True
    ) -> tuple[tuple[float, float], tuple[float, ...]]:
        """One step.

        Args:
            masses: kg in the line and in the tank that is filled. pressures: behind each valve, Pa, held.
            seconds: length of the step, above 0. is_open: whether gas can get from the line to the tank.

        Returns:
            the masses at the end, and what has come through each demand orifice, kg, negative where it flowed back.
        """
        count, block = len(self.areas), self.gas.block()
        state = np.array([*masses, *self.areas, *pressures, *[0.0] * count])
        _step()(
            block.ctypes.data, state.ctypes.data, count, self.orifice if is_open else 0.0, self.volume, self.filled,
            seconds,
        )  # fmt: skip
        line, tank, *rest = state.tolist()
        return (line, tank), tuple(rest[2 * count :])


@made_once
def _kernel() -> tuple[int, Library]:
    trace = Trace()
    fluid = Own(**{name: trace.number(name) for name in NUMBERS})
    here, there, hole, density = (trace.number(name) for name in ("here", "there", "hole", "density"))
    slots = {"here": HERE, "there": THERE, "hole": HOLE, "density": DENSITY}
    slots |= {name: FIRST_NUMBER + place for place, name in enumerate(NUMBERS)}
    made = {
        THROUGH: through(fluid, hole, here, there), DENSITY_HERE: density_at(fluid, here),
        PRESSURE: pressure_at(fluid, density),
    }  # fmt: skip
    return kernel(made, slots)


@made_once
def _asked() -> Any:
    return native(ask)


@made_once
def _step() -> Any:
    return native(step_line, come_in, excess_of, flow, density_of, pressure_of)


def ask(b: Block) -> None:
    """Fill in what the kernel makes of the slots before."""
    invoke(b[ADDRESS], b, b)


def flow(b: Block, hole: float, here: float, there: float) -> float:
    """Mass flow from one pressure to another, Pa, kg/s."""
    b[HOLE] = hole
    b[HERE] = here
    b[THERE] = there
    invoke(b[ADDRESS], b, b)
    return float(b[THROUGH])


def density_of(b: Block, pressure: float) -> float:
    """Of the gas at a pressure, kg/m³."""
    b[HERE] = pressure
    invoke(b[ADDRESS], b, b)
    return float(b[DENSITY_HERE])


def pressure_of(b: Block, density: float) -> float:
    """The other way round, Pa."""
    b[DENSITY] = density
    invoke(b[ADDRESS], b, b)
    return float(b[PRESSURE])


def step_line(b: Block, s: Block, count: int, orifice: float, volume: float, filled: float, seconds: float) -> None:
    """`Line.step` of a state, the slots LINE and so on, which is changed."""
    before = pressure_of(b, s[TANK] / filled)
    low = pressure_of(b, s[LINE] / volume)
    high = low
    if orifice > 0.0:
        low = min(low, before)
        high = max(high, before)
    for i in range(count):
        low = min(low, s[AREAS + count + i])
        high = max(high, s[AREAS + count + i])
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if not (low < middle < high):
            break
        left = s[LINE] + come_in(b, s, count, middle, seconds) - volume * density_of(b, middle)
        if excess_of(b, orifice, middle, s[TANK], left, filled, seconds) > 0.0:
            high = middle
        else:
            low = middle
    total = come_in(b, s, count, high, seconds)
    if orifice == 0.0:
        s[LINE] = s[LINE] + total
        return
    kept = volume * density_of(b, high)
    s[TANK] = s[TANK] + (s[LINE] + total - kept)
    s[LINE] = kept


def come_in(b: Block, s: Block, count: int, here: float, seconds: float) -> float:
    """What comes into the line at a pressure, Pa, in all, kg; fills in what comes through each orifice."""
    total = 0.0
    for i in range(count):
        came = seconds * flow(b, s[AREAS + i], s[AREAS + count + i], here)
        s[AREAS + 2 * count + i] = came
        total += came
    return total


def excess_of(
    b: Block, orifice: float, here: float, mass: float, left: float, filled: float, seconds: float
) -> float:  # fmt: skip
    """What flows to the tank at the line's pressure, less what the balance leaves for it, kg."""
    if orifice == 0.0:
        return -left
    density = (mass + left) / filled
    if not (0.0 < density * b[FIRST_NUMBER + 1] < 1.0):
        # As no gas can be: the pressure is far too low, or too high.
        return -left
    return seconds * flow(b, orifice, here, pressure_of(b, density)) - left
