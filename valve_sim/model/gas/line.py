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

from valve_sim.model.compiling import compiled, inner
from valve_sim.model.gas.flow import density_at, pressure_at, through
from valve_sim.model.gas.fluids import FLUIDS
from valve_sim.model.gas.record import critical_cubic

_GAS: Final = np.dtype([
    (name, "f8")
    for name in (
        "gas_constant", "covolume", "heat_capacity_ratio", "inlet_temperature",
        "critical_0", "critical_1", "critical_2", "critical_3",
    )
])  # fmt: skip
"""What `flow` reads of a valve's record to know the gas."""
_HALVINGS: Final = 100
"""Of the range of pressures, at most: rounding ends them after about 55."""


class Gas:
    """A fluid at one temperature, K.

    Attributes:
        record: (1,) as the compiled functions read it.
    """

    def __init__(self, fluid: str = "hydrogen", temperature: float = 288.15) -> None:
        known = FLUIDS[fluid]
        numbers = (known.gas_constant, known.covolume, known.heat_capacity_ratio, temperature)
        self.record = np.array([(*numbers, *critical_cubic(known.heat_capacity_ratio))], _GAS)
        self._numbers = self.record.view(np.recarray)[0]

    def mass(self, pressure: float, volume: float) -> float:
        """Kg of gas in a volume, m³, at a pressure, Pa."""
        return float(volume * density_at.py_func(self._numbers, pressure))

    def pressure(self, mass: float, volume: float) -> float:
        """Pa of so much gas, kg, in a volume, m³."""
        return float(pressure_at.py_func(self._numbers, mass / volume))


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
        sizes = (self.orifice if is_open else 0.0, self.volume, self.filled)
        came = np.empty(len(self.areas))
        given = np.array(self.areas), np.array(pressures, dtype=float)
        line, tank = _step(self.gas.record, *given, sizes, (*masses, seconds), came)
        return (float(line), float(tank)), tuple(came.tolist())


@compiled
def _step(gas: Any, areas: Any, pressures: Any, sizes: Any, start: Any, came: Any) -> Any:
    """`Line.step` of masses and seconds; fills `came`."""
    p = gas[0]
    orifice, volume, filled = sizes
    line, tank, seconds = start
    before = pressure_at(p, tank / filled)
    low = high = pressure_at(p, line / volume)
    if orifice > 0.0:
        low, high = min(low, before), max(high, before)
    for i in range(len(areas)):
        low, high = min(low, pressures[i]), max(high, pressures[i])
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        left = line + _come_in(p, areas, pressures, middle, seconds, came) - volume * density_at(p, middle)
        if _excess(p, orifice, middle, (tank, left, filled), seconds) > 0.0:
            high = middle
        else:
            low = middle
    total = _come_in(p, areas, pressures, high, seconds, came)
    if orifice == 0.0:
        return line + total, tank
    kept = volume * density_at(p, high)
    return kept, tank + (line + total - kept)


@inner
def _come_in(p: Any, areas: Any, pressures: Any, here: Any, seconds: Any, came: Any) -> Any:
    """What comes into the line at a pressure, kg, in all; fills `came`."""
    total = 0.0
    for i in range(len(areas)):
        came[i] = seconds * through(p, areas[i], pressures[i], here)[0]
        total += came[i]
    return total


@inner
def _excess(p: Any, orifice: Any, here: Any, tank: Any, seconds: Any) -> Any:
    """What flows to the tank at the line's pressure, less what the balance leaves for it, kg."""
    mass, left, filled = tank
    if orifice == 0.0:
        return -left
    density = (mass + left) / filled
    if not 0.0 < density * p.covolume < 1.0:  # as no gas can be: the pressure is far too low, or too high
        return -left
    return seconds * through(p, orifice, here, pressure_at(p, density))[0] - left
