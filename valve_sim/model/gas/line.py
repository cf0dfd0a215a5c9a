"""A line that several valves feed through their demand orifices, and the tank that it fills through one orifice more.

With the masses m_l of the line and m_v of the tank that is filled, isothermal as the volumes behind the valves,

    (L1)  m_l' = Σ A_i G(p_i, p_l) − A G(p_l, p_v),  m_v' = A G(p_l, p_v),  p = pressure of m/V

stepped by Euler's backward method: with h Σ A_i G at the end of the step as what has come in, m_v follows from p_l
there by the balance of mass, and (L1) leaves one equation in p_l, whose residual only grows with it. So whatever the
size of the step, no pressure passes another, and no mass is lost but to rounding. G is that of `core.gas`, in plain
numbers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from valve_sim.model.core.gas import SAME, critical_cubic
from valve_sim.model.gas.fluids import FLUIDS

_HALVINGS: Final = 100
"""Of the range of pressures, at most: rounding ends them after about 55."""


class Gas:
    """A fluid at one temperature, K."""

    def __init__(self, fluid: str = "hydrogen", temperature: float = 288.15) -> None:
        known = FLUIDS[fluid]
        self._heat, self._covolume = known.gas_constant * temperature, known.covolume
        self._root, self._k = math.sqrt(self._heat), 1.0 - 1.0 / known.heat_capacity_ratio
        self._cubic = critical_cubic(known.heat_capacity_ratio)

    def mass(self, pressure: float, volume: float) -> float:
        """Kg of gas in a volume, m³, at a pressure, Pa."""
        return volume * pressure / (self._heat + self._covolume * pressure)

    def pressure(self, mass: float, volume: float) -> float:
        """Pa of so much gas, kg, in a volume, m³; infinite where no gas is so dense."""
        left = volume - self._covolume * mass
        return mass * self._heat / left if left > 0.0 else math.inf

    def flow(self, hole: float, here: float, there: float) -> float:
        """Mass flow through C_d A, m², from one pressure to another, Pa; kg/s."""
        up = max(here, there)
        drop = (here - there) / up
        size = max(abs(drop), SAME)
        beta = up * self._covolume / self._heat
        grown, (c0, c1, c2, c3) = math.log1p(beta), self._cubic
        critical = c0 + grown * (c1 + grown * (c2 + grown * c3))
        r, shortfall = (critical, 1.0 - critical) if critical > 1.0 - size else (1.0 - size, size)
        fall = -math.expm1(self._k * math.log1p(-shortfall))
        flux = up / self._root * math.sqrt(2.0 * (fall / self._k + beta * shortfall)) / ((1.0 - fall) / r + beta)
        return hole * flux * drop / size


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
        line, tank = masses
        gas, orifice = self.gas, self.orifice if is_open else 0.0
        ends = [*pressures, gas.pressure(line, self.volume)]
        if orifice:
            ends.append(gas.pressure(tank, self.filled))
        low, high = min(ends), max(ends)
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            if not low < middle < high:
                break
            if self._excess(middle, masses, pressures, seconds, orifice) > 0.0:
                high = middle
            else:
                low = middle
        came = self._came(pressures, high, seconds)
        total = line + sum(came)
        if not orifice:
            return (total, tank), came
        kept = gas.mass(high, self.volume)
        return (kept, tank + (total - kept)), came

    def _came(self, pressures: Sequence[float], here: float, seconds: float) -> tuple[float, ...]:
        """What comes into the line at a pressure, Pa, through each orifice, kg."""
        return tuple(
            seconds * self.gas.flow(area, there, here) for area, there in zip(self.areas, pressures, strict=True)
        )

    def _excess(
        self, here: float, masses: tuple[float, float], pressures: Sequence[float], seconds: float, orifice: float
    ) -> float:
        """What flows to the tank at the line's pressure, Pa, less what the balance leaves for it, kg."""
        line, tank = masses
        left = line + sum(self._came(pressures, here, seconds)) - self.gas.mass(here, self.volume)
        there = self.gas.pressure(tank + left, self.filled)
        if not orifice or not 0.0 < there < math.inf:
            # No gas is so thin or so dense: the pressure is far too low, or too high.
            return -left
        return seconds * self.gas.flow(orifice, here, there) - left
