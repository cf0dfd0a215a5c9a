"""Where the energy of a coil's source goes, from what a simulation shows: quadrature of its samples, and no core."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.polynomial import Polynomial, legendre

from valve_sim.model import Drive, Valve, simulate

_NODES: Final = 8
_LONGEST: Final = 1e-5
"""s, of a piece of the quadrature: short, because friction has a corner where the plungers turn, which is no event."""
_WARMER: Final = 0.00393


class Coil:
    """What a declared coil makes of currents."""

    def __init__(self, valve: Valve) -> None:
        self.d, self.e = valve.declared(), valve.effects
        self.power = self.d["reference_voltage"] ** 2 / self.d["coil_resistance"]
        self.lag = self.d["coil_time_constant"] + self.of("coil_lag", "time_constant", 0.0)
        self.parallel = self.of("eddy_lag", "time_constant", 0.0) / self.lag
        self.k = self.of("magnetic_saturation", "current", math.inf) ** -2
        coefficients = [self.d[name] for name in ("a0", "a1", "a2", "a3")]
        coefficients[0] += self.of("rest_attraction", "force", 0.0)
        self.force = Polynomial(coefficients)
        self.work = self.force.integ()
        self.share = self.e["motional_emf"]["share"]

    def of(self, effect: str, parameter: str, off: float) -> float:
        return self.e[effect][parameter] if effect in self.e else off

    def squares(self, w: Any) -> Any:
        """s(w)."""
        return w * w * (1.0 + self.k) / (1.0 + self.k * w * w)

    def field(self, x: float, w: float) -> float:
        """Energy of the field, J: flux times current less the co-energy."""
        slope = 2.0 * w * (1.0 + self.k) / (1.0 + self.k * w * w) ** 2
        return self.power * self.lag * w * w / 2.0 + self.share * float(self.work(x)) * (slope * w - self.squares(w))

    def seen(self, command: float, u: Any) -> Any:
        """Terminal voltage over the reference voltage, where current flows."""
        volts = np.full_like(u, command)
        if command == 0.0 and self.d["release_voltage"] > 0.0:
            volts = -np.sign(u) * self.d["release_voltage"]
        return volts / self.d["reference_voltage"] * self.of("drive_gain", "gain", 1.0)


def breaks_of(valve: Valve, drive: Drive, end: float) -> Any:
    """Times at which something has a corner: commands and events, and `end`."""
    rough = simulate(valve, drive, [end], tolerance=1e-12)
    events = [event.time for event in rough.events]
    return np.unique([*drive.times[drive.times < end], *events, end])


def imbalance(valve: Valve, drive: Drive, end: float, tolerance: float = 1e-12) -> float:
    """Source less ohmic losses, field and mechanical work at every command and event, at most, over the source's size.

    All sources of energy that flowed either way make its size; `motional_emf` is declared.
    """
    coil = Coil(valve)
    corners = breaks_of(valve, drive, end)
    edges = np.concatenate(
        [np.linspace(a, b, 1 + math.ceil((b - a) / _LONGEST))[:-1] for a, b in pairwise(corners)] + [corners[-1:]]
    )
    places, weights = legendre.leggauss(_NODES)
    middle, half = (edges[1:] + edges[:-1]) / 2.0, np.diff(edges) / 2.0
    inner = middle[:, None] + half[:, None] * places
    times = np.unique(np.concatenate([inner.ravel(), edges]))
    shown = simulate(valve, drive, times, tolerance=tolerance)
    at = np.searchsorted(times, inner)
    ends = np.searchsorted(times, edges)
    rated = coil.d["reference_voltage"] / coil.d["coil_resistance"]
    total, flowed, worst, warmth = 0.0, 0.0, 0.0, 0.0
    for piece, (row, h) in enumerate(zip(at, half, strict=True)):
        command = float(drive.at(middle[piece]))
        u, x, v = shown.coil_current[row] / rated, shown.pilot_position[row], shown.pilot_velocity[row]
        temperature, warmth = _warm(coil, u, warmth, h)
        r, volts = 1.0 + _WARMER * temperature, coil.seen(command, u)
        is_blocked = command == 0.0 and coil.d["release_voltage"] > 0.0 and not u.any()
        w = _from_pull(coil, shown.attraction[row], x) if is_blocked else u + coil.parallel * (r * u - volts)
        eddy = (u - w) ** 2 / coil.parallel if coil.parallel else np.zeros_like(u)
        source = coil.power * volts * u
        lost = coil.power * (r * u * u + eddy) + coil.share * coil.squares(w) * coil.force(x) * v
        total += h * float(weights @ (source - lost))
        flowed += h * float(weights @ np.abs(source))
        if np.min(np.abs(corners - edges[piece + 1])) == 0.0:
            worst = max(worst, abs(total - _field_at(coil, shown, ends[piece + 1], (command, warmth), is_blocked)))
    return worst / flowed


def _field_at(coil: Coil, shown: Any, index: int, before: tuple[float, float], is_blocked: bool) -> float:
    """Energy of the field at one sample, which sees what was there before it."""
    command, warmth = before
    u = shown.coil_current[index : index + 1] * coil.d["coil_resistance"] / coil.d["reference_voltage"]
    x = shown.pilot_position[index]
    if is_blocked:
        return coil.field(x, float(_from_pull(coil, shown.attraction[index], x)))
    w = u + coil.parallel * ((1.0 + _WARMER * warmth) * u - coil.seen(command, u))
    if command == 0.0 and u[0] == 0.0 and coil.d["release_voltage"] > 0.0:
        w = _from_pull(coil, shown.attraction[index : index + 1], x)
    return coil.field(x, float(w[0]))


def _from_pull(coil: Coil, attraction: Any, x: Any) -> Any:
    """The current that pulls so where eddy currents alone do, else 0; its sign makes no difference to energies."""
    squared = attraction / coil.force(x)
    if not coil.parallel:
        return 0.0 * squared
    return np.sqrt(squared / (1.0 + coil.k - coil.k * squared))


def _warm(coil: Coil, u: Any, start: float, h: float) -> tuple[Any, float]:
    """Temperatures at the nodes of a piece of half length h, s, and at its end, K."""
    rate = coil.of("coil_heating", "temperature_rate", 0.0)
    if rate == 0.0:
        return np.zeros_like(u), 0.0
    cooling = coil.of("coil_heating", "cooling_time_constant", 1.0)
    places, _ = legendre.leggauss(_NODES)
    grown = legendre.legint(legendre.legfit(places, rate * u * u * np.exp(places * h / cooling), _NODES - 1), lbnd=-1)
    at = np.append(places, 1.0)
    warm = np.exp(-at * h / cooling) * (start * math.exp(-h / cooling) + h * legendre.legval(at, grown))
    return warm[:-1], float(warm[-1])
