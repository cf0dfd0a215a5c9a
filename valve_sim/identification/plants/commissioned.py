"""A commissioned valve in service: what is known of it, and its coil current, how late it is stamped, and its gain.

A live current has no stamp of its own and is timed by its arrival, and the coil's resistance is an assumption unless it
was measured. Neither matters for later changes: both are estimated from the baseline strokes, and
corrected.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from valve_sim.identification.plants.covariance_root import covariance_root
from valve_sim.identification.plants.protocol import Array, EffectChoice, Nuisance
from valve_sim.identification.plants.recording_errors import CLOCK_SIGMA
from valve_sim.identification.plants.tolerances import of_gas
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.plants.valve_model import ValveModel, dampings_of
from valve_sim.identification.plants.valve_sensors import as_it_began, with_declared_sensor
from valve_sim.model import CATALOGUE, DECLARED, Parameter, Tag, Valve, simulate
from valve_sim.model.gas import GAS
from valve_sim.recordings import Signal, Trace

LATEST: Final = 5e-3
"""s: bound of a current's lateness, either way."""
EXPLAINED: Final = 0.05
"""Residual of the current over the current, root mean square, up to which it is used at all."""
FEWEST: Final = 20
"""Samples."""
FINEST_SCATTER: Final = 1e-6
"""s: stamps are not believed any further."""

START: Final = "outlet_pressure"
START_SHARE: Final = 0.1
"""Of the tank's pressure: standard deviation of the pressure behind a valve before the first stroke of a trace."""
_VALUE: Final = "value"


class CommissionedCurrent(NamedTuple):
    """How a measured current relates to the model's.

    Attributes:
        lateness: s by which it is stamped late. gain: measured over modelled.
    """

    lateness: float
    gain: float

    def as_modelled(self, signal: Signal) -> Signal:
        """Corrected for lateness and gain."""
        return Signal(signal.times - self.lateness, signal.values / self.gain)


def commission_current(traces: Sequence[Trace], valve: Valve) -> CommissionedCurrent | None:
    """Compare the baseline strokes' currents with the model.

    Returns:
        None where a stroke has no current, or one that the model does not explain.
    """
    currents = [trace.coil_current for trace in traces]
    known = [current for current in currents if current is not None and len(current.times) >= FEWEST]
    if not known or len(known) < len(traces):
        return None
    measured = np.concatenate([current.values for current in known])

    from scipy.optimize import minimize_scalar

    def modelled(lateness: float) -> Array:
        return np.concatenate([
            simulate(began, trace.drive, current.times - lateness, start_time=_start(trace)).coil_current
            for began, trace, current in zip([as_it_began(valve, one) for one in traces], traces, known, strict=True)
        ])  # fmt: skip

    def left(lateness: float) -> float:
        shown = modelled(lateness)
        return float(np.sum(np.square(measured - _gain(measured, shown) * shown)))

    coarse = np.linspace(-LATEST, LATEST, 41)
    nearest = float(coarse[int(np.argmin([left(lateness) for lateness in coarse.tolist()]))])
    step = float(coarse[1] - coarse[0])
    lateness = float(minimize_scalar(left, bounds=(nearest - step, nearest + step), method="bounded").x)
    gain = _gain(measured, modelled(lateness))
    explains = left(lateness) <= EXPLAINED**2 * float(np.sum(np.square(measured)))
    return CommissionedCurrent(lateness, gain) if explains and gain > 0.0 else None


def _gain(measured: Array, shown: Array) -> float:
    power = float(shown @ shown)
    return float(measured @ shown) / power if power > 0.0 else 1.0


def _start(trace: Trace) -> float:
    return float(min(trace.drive.times[0], trace.times[0])) - 2.0 * LATEST


class Commissioned(NamedTuple):
    """A valve as it was commissioned.

    Attributes:
        valve: with what was estimated in place of what was declared; nothing has a tolerance beyond that.
        estimated: (k,) names of what was: the dampings, and declared values that had a tolerance.
        covariance: (k, k) of their values.
    """

    valve: Valve
    estimated: tuple[str, ...]
    covariance: Array


class CommissionedModel(ValveModel):
    """The values of a valve in service, whose dampings and clock are known: a change of a damping is an effect.

    Args:
        commissioned: the valve. scatter: s, standard deviation of the commands' times.
        starts: values from which fits of effects start, too, by the effects' names.
    """

    def __init__(
        self, commissioned: Commissioned, scatter: float, starts: Mapping[str, Mapping[str, float]] | None = None
    ) -> None:
        super().__init__(commissioned.valve)
        self.refitted, self.scatter = (), max(scatter, FINEST_SCATTER)
        self._estimated = commissioned.estimated
        self._spread = covariance_root(commissioned.covariance) / CLOCK_SIGMA
        self._errors = tuple(f"commissioning_error[{index}]" for index in range(self._spread.shape[1]))
        # In a unit in which their deviation is that of a clock, so that one difference step suits both.
        errors = (Nuisance(name, CLOCK_SIGMA, "–", number=name) for name in self._errors)
        self.nuisances = (*errors, *self._start())
        self._dampings = {name: self._damping(name) for name in dampings_of(self.valve)}
        self._changed = {f"{name}.{_VALUE}": name for name in self._dampings}
        alike = tuple(entry.name for entry in CATALOGUE.tagged(Tag.LIKE_DAMPING))
        built_in = {entry.name for entry in CATALOGUE.tagged(Tag.BUILT_IN)}
        effects = {
            **{name: EffectChoice(name, (parameter,), alike) for name, parameter in self._dampings.items()},
            **{name: choice for name, choice in self.effects.items() if name not in built_in},
        }
        self.effects = effects | {name: replace(effects[name], start=start) for name, start in (starts or {}).items()}

    def _damping(self, name: str) -> Parameter:
        value = super().declared(name)
        known = DECLARED[name]
        return known._replace(name=_VALUE, off=value, prior_scale=max(value, known.prior_scale))

    def _start(self) -> tuple[Nuisance, ...]:
        """The pressure behind a valve with gas, when the recording begins: a leak has changed it before."""
        gas = self.valve.gas
        if gas is None:
            return ()
        rule, sigma = GAS[START], START_SHARE * gas.inlet_pressure
        return (
            Nuisance(
                of_gas(START), sigma, rule.unit, step=1e-3 * sigma, mean=gas.outlet_pressure, lower=rule.lower,
                is_of_machine=True, number=of_gas(START),
            ),
        )  # fmt: skip

    def parameter(self, name: str) -> Parameter:
        """Parameter of any valve, or a damping, which is off where it was."""
        plain = self._changed.get(name, name)
        return self._dampings[plain] if plain in self._dampings else super().parameter(name)

    def declared(self, name: str) -> float:
        """The commissioned value."""
        return super().declared(self._changed.get(name, name))

    def as_declared(self, values: Mapping[str, float]) -> Mapping[str, float]:
        """Values by their plain names: changed dampings, and the errors of commissioning added."""
        plain = {name: value for name, value in values.items() if self._changed.get(name, name) not in self._dampings}
        errors = self._spread @ np.array([plain.pop(name, 0.0) for name in self._errors])
        for name, error in zip(self._estimated, errors.tolist(), strict=True):
            value = values.get(f"{name}.{_VALUE}", values.get(name, self.declared(name)))
            plain[name] = max(self.parameter(name).lower, value + error)
        return plain

    def plain_slopes(self, slopes: Mapping[str, float], values: Mapping[str, float]) -> dict[str, float]:
        """Changes of values along a direction, by their plain names; of a damping at its bound there is none."""
        plain = self.as_declared(values)
        found = {name: slope for name, slope in slopes.items() if name in plain}
        errors = self._spread @ np.array([slopes.get(name, 0.0) for name in self._errors])
        for name, error in zip(self._estimated, errors.tolist(), strict=True):
            slope = slopes.get(f"{name}.{_VALUE}", slopes.get(name, 0.0)) + error
            if slope and plain[name] > self.parameter(name).lower:
                found[name] = slope
        return found


def in_service(
    trace: Trace, commissioned: Commissioned, scatter: float, starts: Mapping[str, Mapping[str, float]] | None = None
) -> ValvePlant:
    """A commissioned valve behind some strokes, their motion put back by the lateness; arguments: see the model."""
    # A leak has changed the pressure behind the valve before its first stroke, so it is estimated along.
    began = commissioned._replace(valve=with_declared_sensor(as_it_began(commissioned.valve, trace), [trace]))
    return ValvePlant([replace(trace, outlet_start=None)], CommissionedModel(began, scatter, starts), is_watched=True)
