"""The independent reference with a coil by its flux linkage: theory, "The coil as energy conservation gives it".

The flux itself is integrated, and the current solved from it; the core integrates the current. No line is shared.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial

from .reference import _T, _U, _W, ReferenceValve

_FLUX = _U
"""Where the flux is kept: u follows from it."""


class FluxReference(ReferenceValve):
    """One valve with `motional_emf`, or without it one whose coil freewheels."""

    def __init__(
        self, declared: Mapping[str, float], effects: Mapping[str, Mapping[str, float]], start: float, **how: Any
    ) -> None:
        super().__init__(declared, effects, start, **how)
        self.share = self.of("motional_emf", "share", 0.0)
        self.has_flux = "motional_emf" in effects
        power = declared["reference_voltage"] ** 2 / declared["coil_resistance"]
        pull = Polynomial([declared[name] for name in ("a0", "a1", "a2", "a3")])
        self.pull = pull + self.of("rest_attraction", "force", 0.0)
        self.energy = self.pull.integ() * (self.share / power)
        self.knee = self.of("magnetic_saturation", "current", math.inf)
        self.peaked = -math.inf
        self.diode = 0  # +1 and -1 while it carries such a current, 2 while it blocks

    @property
    def applied(self) -> float:
        """What the coil sees, over the reference voltage."""
        volts = self.volts if self.diode == 0 else -self.diode * self.d["release_voltage"] if self.diode != 2 else 0.0
        return volts / self.d["reference_voltage"] * self.of("drive_gain", "gain", 1.0)

    def flux_of(self, x: float, w: float) -> float:
        """What flux links the coil: the derivative of the co-energy to the current."""
        k = self.knee**-2
        return self.lag * w + float(self.energy(x)) * 2.0 * w * (1.0 + k) / (1.0 + k * w * w) ** 2

    def current_of(self, x: float, flux: float) -> float:
        """The w that makes a flux: a bracket that halves until Newton's method is safe in it."""
        if self.knee == math.inf:
            return flux / (self.lag + 2.0 * float(self.energy(x)))
        low, high = -1.0, 1.0
        while self.flux_of(x, high) < flux:
            high *= 2.0
        while self.flux_of(x, low) > flux:
            low *= 2.0
        for _ in range(8):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.flux_of(x, middle) < flux else (low, middle)
        w, k = 0.5 * (low + high), self.knee**-2
        for _ in range(50):
            squared = k * w * w
            slope = self.lag + 2.0 * float(self.energy(x)) * (1 + k) * (1 - 3 * squared) / (1 + squared) ** 3
            step = (flux - self.flux_of(x, w)) / slope
            w += step
            if abs(step) < 1e-16 * max(1.0, abs(w)):
                break
        return w

    def coil(self, y: Any) -> tuple[float, float]:
        r = 1 + 0.00393 * y[_T]
        if not self.has_flux:
            u = 0.0 if self.diode == 2 else y[_U] if self.lag > 0 else self.applied / r
            return u, y[_W] if self.eddy > 0 else u
        w = self.current_of(y[0], y[_FLUX])
        if self.diode == 2:
            return 0.0, w
        # The eddy currents' resistance carries (V - r u), and the coil w beside it.
        parallel = self.eddy / self.lag
        return (w + parallel * self.applied) / (1 + parallel * r), w

    def strength(self, y: Any) -> float:
        """Of the current that pulls; beyond the end of a freewheeling current, where a step may look, there is none."""
        w = self.coil(y)[1]
        return max(0.0, self.diode * w) if self.diode in (1, -1) else abs(w)

    def rates(self, t: float, y: Any) -> Any:
        rate = super().rates(t, y)
        u, w = self.coil(y)
        r = 1 + 0.00393 * y[_T]
        rate[_U] = 0.0
        if not self.has_flux:
            rate[_W] = (u - w) / self.eddy if self.eddy > 0 else 0.0
            if self.lag > 0 and self.diode != 2:
                rate[_U] = (self.applied - r * u) / self.lag
            return rate
        rate[_W] = 0.0
        if self.diode != 2:
            rate[_FLUX] = self.applied - r * u
        elif self.eddy > 0:
            rate[_FLUX] = -w * self.lag / self.eddy
        return rate

    def guards(self) -> list[tuple[str, Callable[[float, Any], float]]]:
        found = super().guards()
        if self.diode in (1, -1):
            way = self.diode
            found.append(("gone", lambda t, y: -way * self.coil(y)[0]))
        has_current = self.volts != 0 or abs(self.y[_FLUX]) > 1e-9
        if (
            self.has_flux
            and "residual_magnetism" in self.e
            and self.diode == 0
            and has_current
            and self.t != self.peaked
        ):
            # Where the current stops growing: the largest one is remembered.
            found.append(("peak", lambda t, y: -self.growth(t, y)))
        return found

    def growth(self, t: float, y: Any) -> float:
        """How fast |w| grows."""
        rate, x = self.rates(t, y), y[0]
        w = self.current_of(x, y[_FLUX])
        k = self.knee**-2
        by_x = float(self.energy.deriv()(x)) * 2.0 * w * (1.0 + k) / (1.0 + k * w * w) ** 2
        return math.copysign(1.0, w) * (rate[_FLUX] - by_x * rate[0])

    def note(self, inside: Any, y: Any) -> None:
        self.currents[inside] = [self.coil(state)[0] for state in y.T]

    def follow(self, drive: Any, times: Any) -> tuple[Any, Any, Any]:
        """Positions of pilot and main plunger, m, and coil current, A, under a drive."""
        pilot, main, self.currents = np.zeros(len(times)), np.zeros(len(times)), np.zeros(len(times))
        for moment, volts in zip(drive.times, drive.volts, strict=True):
            self.go(moment, times, pilot, main)
            self.command(volts)
        self.go(times[-1], times, pilot, main)
        return pilot, main, self.currents * self.d["reference_voltage"] / self.d["coil_resistance"]

    def handle(self, name: str) -> None:
        if name == "gone":
            self.log("CURRENT_GONE")
            self.let_go()
        elif name == "peak":
            self.peaked = self.t
        else:
            super().handle(name)

    def let_go(self) -> None:
        self.diode = 2
        if not self.has_flux or self.eddy == 0:
            self.y[_U] = 0.0

    def command(self, volts: float) -> None:
        u, w = self.coil(self.y)
        self.volts = volts
        if volts != 0 or self.d["release_voltage"] == 0:
            self.diode = 0
        elif self.diode != 2:
            self.diode = int(np.sign(w if self.has_flux else u)) or 2
            if self.diode == 2 or self.diode * self.coil(self.y)[0] <= 0 or self.lag == 0:
                self.let_go()
        super().command(volts)
