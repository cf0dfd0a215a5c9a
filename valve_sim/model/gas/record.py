"""What a valve with gas is, and where, to the compiled core: longer records than those of a valve without.

The type of its record tells the compiler which valve it is. What only gas needs is compiled for the longer records
alone, so that a valve without gas runs the code that it would run if there were no gas at all.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
from numba import types
from numba.extending import overload
from numpy.polynomial import Chebyshev, Polynomial

from valve_sim.model.compiling import inner
from valve_sim.model.core_types import STATE_RECORD
from valve_sim.model.effects.record import VALVE_RECORD, neutral_fields, new_record, whole_effects
from valve_sim.model.gas.parameters import GAS, GasParameters, orifice_area

_OF_EFFECTS: Final = neutral_fields(of_gas=True)
GAS_FIELDS: Final = (
    *GAS, "gas_constant", "covolume", "heat_capacity_ratio", *_OF_EFFECTS, "demand_area", "critical_0", "critical_1",
    "critical_2", "critical_3",
)  # fmt: skip
"""Numbers of a valve with gas beside those of every valve."""
_AT: Final = list(VALVE_RECORD.fields or ()).index("term_count")


def _longer(record: Any, names: tuple[str, ...], at: int) -> Any:
    fields = [(name, record.fields[name][0]) for name in record.names]
    return np.dtype([*fields[:at], *((name, "f8") for name in names), *fields[at:]], align=True)


_LARGEST_BETA: Final = 2.0
_ITERATIONS: Final = 5
"""Of Newton's method, which comes to rounding in four."""

GAS_VALVE_RECORD: Final = _longer(VALVE_RECORD, GAS_FIELDS, _AT)
"""What a valve with gas is; the numbers of terms stay the last."""

GAS_STATE_FIELDS: Final = (
    "density",  # kg/m³, of the gas in the outlet volume
    "mass_in",  # kg, that came through the valve since the start
    "mass_out",  # kg, that the demand took since the start
    "tank_pressure",  # Pa, of the inlet at tank_time
    "tank_rate",  # Pa/s, at which it changes from then on
    "tank_time",  # s
    "demand_pressure",  # Pa, behind the demand's orifice, held until it is set anew
    "flow_regime",  # 2 choked, 1 subsonic, negative from the outlet to the inlet
)
GAS_STATE_RECORD: Final = _longer(STATE_RECORD, GAS_STATE_FIELDS, 0)
"""Where a valve with gas is. What is new comes first: a record that began with all of another would count as its
subtype to Numba, and code compiled for the one would be given the other."""
GAS_NUMBERS: Final = (
    "inlet_pressure", "inlet_temperature", "outlet_volume", "pilot_orifice_diameter", "main_orifice_diameter",
    "seat_diameter", "demand_pressure", "discharge_coefficient", "clogging_ratio", "leak_area", "demand_area",
)  # fmt: skip
"""Those of `GAS_FIELDS` that flow and forces change with; the outlet's first pressure acts at the start only."""
SLOPES_OF_GAS: Final = {
    **dict.fromkeys(
        ("flow", "flow_by_density", "flow_by_x", "flow_by_gap", "force_by_density", "force_by_gap", "force_by_inlet"),
        "f8",
    ),
    "flow_by": ("f8", (len(GAS_NUMBERS),)),
    "force_by": ("f8", (len(GAS_NUMBERS),)),
}
"""Derivatives of the rate of the outlet's density, kg/(m³ s), and of the net force, N, to state and `GAS_NUMBERS`."""
GAS_COLUMNS: Final = 2
"""Of gas in a row of output, after those of every valve: outlet pressure, Pa, and mass flow, kg/s."""


def is_of_gas(records: Any) -> bool:
    """Whether an array of records is of valves with gas."""
    return bool(records.dtype == GAS_VALVE_RECORD)


def record_of(
    declared: Mapping[str, float], effects: Mapping[str, Mapping[str, float]], gas: GasParameters | None
) -> Any:
    """A valve as the compiled core reads it: a (1,) VALVE_RECORD, or with gas a (1,) GAS_VALVE_RECORD."""
    record = new_record(declared, effects)
    return record if gas is None else _with_gas(record, effects, gas)


def _with_gas(records: Any, effects: Mapping[str, Mapping[str, float]], gas: GasParameters) -> Any:
    """Turn a (1,) VALVE_RECORD into the (1,) GAS_VALVE_RECORD of the same valve with gas, and with effects of gas."""
    longer = np.zeros(1, GAS_VALVE_RECORD)
    for name in VALVE_RECORD.names or ():
        longer[name] = records[name]
    for name in GAS:
        longer[name] = getattr(gas, name)
    fluid = gas.properties
    longer["gas_constant"], longer["covolume"] = fluid.gas_constant, fluid.covolume
    longer["heat_capacity_ratio"] = fluid.heat_capacity_ratio
    longer["demand_area"] = gas.discharge_coefficient * orifice_area(gas.demand_orifice_diameter)
    for name, neutral in _OF_EFFECTS.items():
        longer[name] = neutral
    for power, coefficient in enumerate(critical_cubic(fluid.heat_capacity_ratio)):
        longer[f"critical_{power}"] = coefficient
    for effect, values in whole_effects(effects):
        if effect.with_gas:
            effect.apply_rewrite(longer[0], values)
    return longer


@functools.cache
def critical_cubic(gamma: float) -> list[float]:
    """Coefficients of the critical ratio in ln(1 + β), rising: `flow`'s (G2) solved at Chebyshev's points.

    There N' = −D makes Newton's step r ← (r + 2 N r^{−1/γ}/D²)/(γ + 1). Up to β = 2, which hydrogen at 15 °C has at
    309 MPa, the ratio is within 1e-5, and the flux there within 1e-10.
    """
    k = 1.0 - 1.0 / gamma

    def critical(logarithm: Any) -> Any:
        beta = np.expm1(logarithm)
        ratio = np.full_like(beta, (2.0 / (gamma + 1.0)) ** (1.0 / k))
        for _ in range(_ITERATIONS):
            volume = ratio ** (-1.0 / gamma)
            n = (1.0 - ratio**k) / k + beta * (1.0 - ratio)
            ratio = (ratio + 2.0 * n * volume / (volume + beta) ** 2) / (gamma + 1.0)
        return ratio

    cubic = Chebyshev.interpolate(critical, 3, domain=[0.0, math.log1p(_LARGEST_BETA)])
    return [float(coefficient) for coefficient in cubic.convert(kind=Polynomial).coef]


def _of_gas(record: Any) -> bool:
    """Whether a type of Numba's is the record of a valve with gas."""
    return isinstance(record, types.Record) and GAS_FIELDS[0] in record.fields


def has_gas(p: Any) -> bool:
    """Whether a valve has gas, known when code is compiled."""
    raise NotImplementedError("compiled code only")


@overload(has_gas, strict=False)
def _has_gas(p: Any) -> Any:
    return (lambda p: True) if _of_gas(p) else (lambda p: False)


def for_gas(otherwise: Callable[..., Any]) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function of (p, ...) for valves with gas; for all others it is another function.

    Args:
        otherwise: compiled function for valves without gas, of the same arguments.
    """

    def choose_by_record(function: Callable[..., Any]) -> Any:
        of_gas = inner(function)

        def chosen(p: Any, *arguments: Any) -> Any:
            raise NotImplementedError("compiled code only")

        @overload(chosen, strict=False)
        def choose(p: Any, *arguments: Any) -> Any:
            called = of_gas if _of_gas(p) else otherwise

            def call(p: Any, *arguments: Any) -> Any:
                return called(p, *arguments)

            return call

        chosen.__doc__ = function.__doc__
        return chosen

    return choose_by_record
