"""The catalogue of effects that the reference model lacks (MODEL section 3): one entry each.

An entry says everything about its effect: parameters with unit, range and off-value, how it enters the model, where
it is documented, and what it is easily confused with. The fit, parameter files, reports and the reference page
follow from the entry. An effect enters the model in one of two ways:

* `rewrite` changes the record of the compiled core (a declared parameter, or a mechanism that the core has), or
* `term` adds a compiled force f(x, v, u, t, *parameters) in newtons, + opens.

A package of your own can `register` an entry; it then takes part everywhere like those below.
"""

from __future__ import annotations

import dis
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numba import carray, types  # type: ignore[attr-defined]
from numba.np.unsafe.ndarray import to_fixed_tuple

from valve_sim.model.compiling import compiled, compiled_callback, compiled_once
from valve_sim.model.core_types import MAXIMUM_TERM_PARAMETERS, MAXIMUM_TERMS, VALVE_RECORD
from valve_sim.model.errors import ParameterError
from valve_sim.model.parameters import DECLARED, Parameter, closest

Rewrite = Callable[[Any, Mapping[str, float]], None]
Term = Callable[..., float]

_TERM_SIGNATURE = types.float64(
    types.float64, types.float64, types.float64, types.float64, types.CPointer(types.float64)
)


@dataclass(frozen=True)
class Effect:
    """One named effect.

    Attributes:
        name: as in YAML, reports and `effects.<name>`.
        summary: one sentence for a person.
        parameters: what it needs; all of them are given when it is on.
        source: where the form, and the size, are documented.
        rewrite: changes the core's record, given the record and the effect's values.
        term: plain Python function f(x, v, u, t, *parameters, *also_reads) in SI units, compiled when first used.
        also_reads: declared parameters that the term is handed after its own.
        phase_2_only: the term acts only while the main plunger moves along.
        confused_with: names of effects that data often cannot tell from this one, the nearest first; listed beside it
            where no form is right and scores mislead.
        named: whether a diagnosis may claim it; False for shapes without a physical name.
    """

    name: str
    summary: str
    parameters: tuple[Parameter, ...]
    source: str
    rewrite: Rewrite | None = None
    term: Term | None = None
    also_reads: tuple[str, ...] = ()
    phase_2_only: bool = False
    confused_with: tuple[str, ...] = ()
    named: bool = True
    _compiled: list[Any] = field(default_factory=list, repr=False, compare=False)

    def parameter(self, name: str) -> Parameter:
        """The parameter of that name.

        Raises:
            KeyError: there is none.
        """
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(name)

    def apply_rewrite(self, record: Any, values: Mapping[str, float]) -> None:
        """Change the core's record, if this effect does so."""
        if self.rewrite is not None:
            self.rewrite(record, values)

    def apply_term(self, record: Any, values: Mapping[str, float]) -> None:
        """Add the compiled force term to the core's record, if this effect has one."""
        if self.term is None:
            return
        numbers = [values[parameter.name] for parameter in self.parameters]
        numbers += [float(record[name]) for name in self.also_reads]
        slot = int(record["term_count"])
        if slot == MAXIMUM_TERMS:
            raise ParameterError(f"effects.{self.name}: at most {MAXIMUM_TERMS} compiled force terms can be on at once")
        record["term_address"][slot] = self.address(len(numbers))
        record["term_in_phase_2_only"][slot] = int(self.phase_2_only)
        record["term_parameters"][slot, : len(numbers)] = numbers
        record["term_count"] = slot + 1
        record["terms_read_time"] |= int(reads_time(self.term))

    def address(self, count: int) -> int:
        """Address of the compiled term that reads `count` numbers; compiled once a process and cached on disk."""
        if not self._compiled:
            assert self.term is not None
            self._compiled.append(compile_term(self.term, count))
        return int(self._compiled[0].address)


def reads_time(term: Term) -> bool:
    """Whether a term f(x, v, u, t, *parameters) makes use of t: a valve at rest is then watched more closely."""
    code = getattr(term, "__code__", None)
    return code is None or any(step.argval == code.co_varnames[3] for step in dis.get_instructions(code))


def compile_term(term: Term, count: int) -> Any:
    """Compile f(x, v, u, t, *numbers) to a C callback that reads its `count` numbers from memory.

    Raises:
        ParameterError: too many numbers.
    """
    if count > MAXIMUM_TERM_PARAMETERS:
        raise ParameterError(f"{term.__name__}: a force term reads at most {MAXIMUM_TERM_PARAMETERS} numbers")
    # Code of a script or a notebook cannot be found again by its module's name, so it is compiled anew each time.
    home = sys.modules.get(term.__module__)
    is_importable = term.__module__ != "__main__" and getattr(home, term.__name__, None) is term
    force = compiled(term) if is_importable else compiled_once(term)

    def callback(x: float, v: float, u: float, t: float, numbers: Any) -> float:
        return force(x, v, u, t, *to_fixed_tuple(carray(numbers, (count,)), count))  # type: ignore[no-any-return, call-arg]

    return compiled_callback(_TERM_SIGNATURE, callback, is_kept=is_importable)


# --- how effects enter the core -----------------------------------------------------------------------------------


def _add_to(field_name: str, parameter: str) -> Rewrite:
    def rewrite(record: Any, values: Mapping[str, float]) -> None:
        record[field_name] += values[parameter]

    return rewrite


def _set_fields(**parameter_of: str) -> Rewrite:
    def rewrite(record: Any, values: Mapping[str, float]) -> None:
        for field_name, parameter in parameter_of.items():
            record[field_name] = values[parameter]

    return rewrite


def _coulomb_friction(record: Any, values: Mapping[str, float]) -> None:
    record["friction_opening"] += values["force"]
    record["friction_closing"] += values["force"]


def _stiction(record: Any, values: Mapping[str, float]) -> None:
    _coulomb_friction(record, values)
    record["breakaway"] = values["breakaway"]
    record["stribeck_velocity"] = values["stribeck_velocity"]


def _asymmetric_friction(record: Any, values: Mapping[str, float]) -> None:
    record["friction_opening"] += values["force_opening"]
    record["friction_closing"] += values["force_closing"]
    record["damping_opening"] += values["damping_opening"]
    record["damping_closing"] += values["damping_closing"]


def _drive_gain(record: Any, values: Mapping[str, float]) -> None:
    # u = gain · V / V_ref, and i = u · V_ref / R with the declared V_ref / R: a resistance R / gain does both.
    record["reference_voltage"] /= values["gain"]
    record["coil_resistance"] /= values["gain"]


def _constant_force(x: float, v: float, u: float, t: float, force: float) -> float:
    return force


def _quadratic_drag(x: float, v: float, u: float, t: float, coefficient: float) -> float:
    return -coefficient * v * abs(v)


def _squeeze_film(
    x: float, v: float, u: float, t: float, coefficient: float, film_thickness: float, stroke: float
) -> float:
    at_seat = film_thickness / (x + film_thickness)
    at_stop = film_thickness / (stroke - x + film_thickness)
    return -coefficient * v * (at_seat**3 + at_stop**3)


def _spring_hardening(x: float, v: float, u: float, t: float, coefficient: float) -> float:
    return -coefficient * x**3


def _force_map(
    x: float,
    v: float,
    u: float,
    t: float,
    variable: float,
    low: float,
    high: float,
    f1: float,
    f2: float,
    f3: float,
    f4: float,
    f5: float,
    f6: float,
    f7: float,
    f8: float,
) -> float:
    at = x
    if variable == 1.0:
        at = v
    elif variable in (2.0, 5.0):
        at = t
    factor = 1.0
    if variable in (3.0, 5.0):
        factor = v
    elif variable == 4.0:
        factor = u * u
    knots = (f1, f2, f3, f4, f5, f6, f7, f8)
    place = min(max((at - low) / (high - low), 0.0), 1.0) * 7.0
    left = min(int(place), 6)
    s = place - left
    # Catmull–Rom: a cubic through the knots with a continuous slope.
    before, here = knots[max(left - 1, 0)], knots[left]
    there, after = knots[left + 1], knots[min(left + 2, 7)]
    slope_here, slope_there = 0.5 * (there - before), 0.5 * (after - here)
    rise = there - here
    value = here + s * (
        slope_here + s * (3.0 * rise - 2.0 * slope_here - slope_there + s * (slope_here + slope_there - 2.0 * rise))
    )
    return factor * value


# --- the entries --------------------------------------------------------------------------------------------------

_GROUP = "Appl. Sci. 2021, 11, 2329 and Appl. Sci. 2016, 6, 288 (same group's valves)"
_TRIBOLOGY = "Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083"
_FORCE = Parameter("force", "N", "friction force", 0, 1e5, 0.05, 0.0)

_ENTRIES: Final = (
    Effect(
        "coulomb_friction",
        "dry friction of one level against the motion",
        (_FORCE,),
        _TRIBOLOGY,
        rewrite=_coulomb_friction,
        confused_with=("stiction", "asymmetric_friction", "squeeze_film"),
    ),
    Effect(
        "stiction",
        "dry friction that must first be broken away and falls with speed",
        (
            _FORCE,
            Parameter("breakaway", "N", "extra force at rest", 0, 1e5, 0.05, 0.0),
            Parameter("stribeck_velocity", "m/s", "speed at which it has faded", 1e-5, 1e3, 0.02),
        ),
        _TRIBOLOGY,
        rewrite=_stiction,
        confused_with=("coulomb_friction", "asymmetric_friction", "squeeze_film"),
    ),
    Effect(
        "asymmetric_friction",
        "friction and extra damping that differ by direction",
        (
            Parameter("force_opening", "N", "dry friction while opening", 0, 1e5, 0.05, 0.0),
            Parameter("force_closing", "N", "dry friction while closing", 0, 1e5, 0.05, 0.0),
            Parameter("damping_opening", "N·s/m", "extra damping while opening", 0, 1e4, 0.5, 0.0),
            Parameter("damping_closing", "N·s/m", "extra damping while closing", 0, 1e4, 0.5, 0.0),
        ),
        "Janot, Gautier, Brunot 2019 (EMPS: friction by direction)",
        rewrite=_asymmetric_friction,
        confused_with=("coulomb_friction", "stiction", "squeeze_film"),
    ),
    Effect(
        "constant_force",
        "a constant force in both phases, + opens: gravity, zero of the load cell",
        (Parameter("force", "N", "+ opens", -1e5, 1e5, 0.05, 0.0),),
        "free-body diagram; the paper's load cell is ±0.25 %",
        term=_constant_force,
        confused_with=("rest_attraction",),
    ),
    Effect(
        "rest_attraction",
        "attraction at the largest gap that the polynomial lacks",
        (Parameter("force", "N", "added to a0", -1e5, 1e5, 0.1, 0.0),),
        _GROUP,
        rewrite=_add_to("a0", "force"),
        confused_with=("drive_gain", "constant_force"),
    ),
    Effect(
        "drive_gain",
        "harness or coil resistance not as declared",
        (Parameter("gain", "–", "u over declared u", 0.05, 20, 0.01, 1.0),),
        "Ohm's law",
        rewrite=_drive_gain,
        confused_with=("rest_attraction", "magnetic_saturation", "coil_heating"),
    ),
    Effect(
        "coil_lag",
        "the coil current itself is later than declared",
        (Parameter("time_constant", "s", "added to coil_time_constant", 0, 1.0, 1e-4, 0.0),),
        "τ = L/R of a solenoid coil",
        rewrite=_add_to("coil_time_constant", "time_constant"),
        confused_with=("eddy_lag", "residual_magnetism"),
    ),
    Effect(
        "eddy_lag",
        "eddy currents: a second pole between current and pull",
        (Parameter("time_constant", "s", "of the second pole", 0, 1.0, 1e-4, 0.0),),
        "1–10 ms are documented for solid cores; grows as the gap closes",
        rewrite=_set_fields(eddy_time_constant="time_constant"),
        confused_with=("coil_lag", "residual_magnetism"),
    ),
    Effect(
        "coil_heating",
        "the coil warms up and its resistance rises",
        (
            Parameter("temperature_rate", "K/s", "heating at u = 1", 0, 1e6, 10.0, 0.0),
            Parameter("cooling_time_constant", "s", "of the coil's temperature", 1e-3, 1e6, 1.0, may_be_endless=True),
        ),
        "IEC 60028: copper, 0.00393 1/K",
        rewrite=_set_fields(temperature_rate="temperature_rate", cooling_time_constant="cooling_time_constant"),
        confused_with=("drive_gain",),
    ),
    Effect(
        "magnetic_saturation",
        "the pull grows more slowly than u² at high current",
        (Parameter("current", "–", "u_s, the knee, in units of u", 0.05, 1e3, 5.0, math.inf),),
        "B 1.32 T closed, 0.50 T open in the paper's finite-element figure",
        rewrite=_set_fields(saturation_current="current"),
        confused_with=("drive_gain",),
    ),
    Effect(
        "residual_magnetism",
        "iron that stays magnetised keeps pulling after switch-off",
        (Parameter("current", "–", "the u that stays", 0, 1, 0.05, 0.0),),
        "0.1–1 N after switch-off are documented for such valves",
        rewrite=_set_fields(residual_current="current"),
        confused_with=("eddy_lag", "coil_lag"),
    ),
    Effect(
        "pressure_force",
        "pressure across the main plunger until the pilot orifice has equalised it",
        (
            Parameter("force", "N", "ΔP · A, holds the main plunger closed", -1e5, 1e5, 0.3, 0.0),
            Parameter(
                "equalisation_time", "s", "time constant of the equalisation", 1e-5, 1e3, 5e-3, may_be_endless=True
            ),
        ),
        "70 MPa on a 0.3 mm orifice: 4.9 N",
        rewrite=_set_fields(pressure_force="force", equalisation_time="equalisation_time"),
    ),
    Effect(
        "quadratic_drag",
        "drag that grows with the square of the speed",
        (Parameter("coefficient", "N·s²/m²", "C in −C v |v|", 0, 1e6, 2.0, 0.0),),
        "fluid displaced through a clearance at high Reynolds number",
        term=_quadratic_drag,
        confused_with=("squeeze_film",),
    ),
    Effect(
        "squeeze_film",
        "gas squeezed out of the closing gaps at seat and stop",
        (
            Parameter("coefficient", "N·s/m", "B, damping at contact", 0, 1e6, 2.0, 0.0),
            Parameter("film_thickness", "m", "h, film left at contact", 1e-6, 1e-1, 1e-4),
        ),
        "Reynolds: 3π η R⁴ v / (2 h³) for a disc",
        term=_squeeze_film,
        also_reads=("stroke",),
        confused_with=("coulomb_friction", "asymmetric_friction", "quadratic_drag", "stiction"),
    ),
    Effect(
        "stop_bounce",
        "rebound at the core and at the seat",
        (
            Parameter("restitution_stop", "–", "speed after over speed before, at x = stroke", 0, 0.95, 0.2, 0.0),
            Parameter("restitution_seat", "–", "likewise at x = 0", 0, 0.95, 0.2, 0.0),
        ),
        "restitution 0.1–0.6 of steel on steel",
        rewrite=_set_fields(restitution_stop="restitution_stop", restitution_seat="restitution_seat"),
    ),
    Effect(
        "pickup_impact",
        "velocity lost when the main plunger is picked up",
        (Parameter("velocity_ratio", "–", "in place of pickup_velocity_ratio", 0, 1, 0.1, 1.0),),
        "momentum: pilot_mass / moving_mass = 0.813 for a plastic impact",
        rewrite=_set_fields(pickup_velocity_ratio="velocity_ratio"),
    ),
    Effect(
        "spring_hardening",
        "the spring stiffens as it is compressed",
        (Parameter("coefficient", "N/m³", "K in −K x³", -1e13, 1e13, 1e8, 0.0),),
        "conical and closely wound springs",
        term=_spring_hardening,
        phase_2_only=True,
    ),
    Effect(
        "stroke_offset",
        "the core stops the plungers elsewhere than declared",
        (Parameter("offset", "m", "added to stroke", -0.1, 0.1, 5e-6, 0.0),),
        "manufacturing tolerance",
        rewrite=_add_to("stroke", "offset"),
        confused_with=("sensor_gain",),
    ),
    Effect(
        "gap_offset",
        "the main plunger is picked up elsewhere than declared",
        (Parameter("offset", "m", "added to pilot_gap", -0.1, 0.1, 5e-6, 0.0),),
        "manufacturing tolerance",
        rewrite=_add_to("pilot_gap", "offset"),
    ),
    Effect(
        "sensor_delay",
        "the measured positions are late",
        (Parameter("delay", "s", "of both joints, not of the current", 0, 1.0, 1e-4, 0.0),),
        "acquisition chains",
        rewrite=_set_fields(sensor_delay="delay"),
        confused_with=("sensor_bandwidth",),
    ),
    Effect(
        "sensor_bandwidth",
        "the measured positions pass a first-order low-pass",
        (Parameter("cutoff_frequency", "Hz", "of both joints", 1.0, 1e9, 2000.0, math.inf),),
        "laser displacement sensors average",
        rewrite=_set_fields(sensor_cutoff_frequency="cutoff_frequency"),
        confused_with=("sensor_delay",),
    ),
    Effect(
        "sensor_gain",
        "the position sensors' scale is off",
        (Parameter("gain", "–", "shown over true, both joints", 0.01, 100, 1e-3, 1.0),),
        "calibration",
        rewrite=_set_fields(sensor_gain="gain"),
        confused_with=("stroke_offset",),
    ),
)

FORCE_MAP_VARIABLES: Final = ("x", "v", "t", "x·v", "x·u²", "t·v")
"""What a force map is a function of; a second factor multiplies it."""
FORCE_MAP_KNOTS: Final = tuple(f"f{knot}" for knot in range(1, 9))
"""The knots of a force map, evenly spaced from `low` to `high`."""

_FORCE_MAP: Final = Effect(
    "force_map",
    "a force of unknown origin, as a smooth curve through eight knots",
    (
        Parameter("variable", "–", "index into x, v, t, x·v, x·u², t·v", 0, 5, 0.0),
        Parameter("low", "m, m/s or s", "where the first knot is", -1e6, 1e6, 0.0),
        Parameter("high", "m, m/s or s", "where the last knot is", -1e6, 1e6, 1.0),
        *(Parameter(name, "N or N·s/m", "force at a knot", -1e5, 1e5, 0.05, 0.0) for name in FORCE_MAP_KNOTS),
    ),
    "Catmull and Rom 1974",
    term=_force_map,
    named=False,
)


class Catalogue(Mapping[str, Effect]):
    """Effects by name: those above, and what was registered since."""

    def __init__(self, entries: Sequence[Effect]) -> None:
        self._entries = {entry.name: entry for entry in entries}

    def __getitem__(self, name: str) -> Effect:
        return self._entries[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    def register(self, effect: Effect) -> Effect:
        """Add an effect of your own.

        Raises:
            ParameterError: its name is taken, or it changes nothing.
        """
        if effect.name in self._entries:
            raise ParameterError(f"effects.{effect.name}: an effect of this name is registered already")
        if effect.rewrite is None and effect.term is None:
            raise ParameterError(f"effects.{effect.name}: has neither a term nor a rewrite, so it would change nothing")
        self._entries[effect.name] = effect
        return effect

    def unregister(self, name: str) -> None:
        """Take an effect out again (tests do)."""
        del self._entries[name]


CATALOGUE: Final = Catalogue((*_ENTRIES, _FORCE_MAP))
"""Every effect that parameter files may name and that a diagnosis tries."""


def check_effects(values: Mapping[str, object], source: str) -> dict[str, dict[str, float]]:
    """Turn a mapping of effects as found in YAML into checked values.

    Args:
        values: effect name to {parameter: value}.
        source: file or node, for messages.

    Raises:
        ParameterError: unknown effect or parameter, missing parameter, wrong type, out of range.
    """
    checked: dict[str, dict[str, float]] = {}
    for name, found in values.items():
        where = f"{source}: effects.{name}"
        if name not in CATALOGUE:
            raise ParameterError(f"{where}: no such effect; did you mean {closest(name, list(CATALOGUE))}?")
        if not isinstance(found, Mapping):
            expected = ", ".join(parameter.name for parameter in CATALOGUE[name].parameters)
            raise ParameterError(f"{where}: found {found!r}, expected {{{expected}}}")
        checked[name] = _check_effect(CATALOGUE[name], found, where)
    return checked


def _check_effect(effect: Effect, found: Mapping[str, object], where: str) -> dict[str, float]:
    names = [parameter.name for parameter in effect.parameters]
    for name in found:
        if name not in names:
            raise ParameterError(f"{where}.{name}: no such parameter; expected {', '.join(names)}")
    missing = [name for name in names if name not in found]
    if missing:
        raise ParameterError(f"{where}: {missing[0]} is missing; expected {', '.join(names)}")
    return {
        parameter.name: parameter.check(found[parameter.name], f"{where}.{parameter.name}")
        for parameter in effect.parameters
    }


def _blank_record() -> Any:
    records = np.zeros(1, VALVE_RECORD)
    for name in ("stribeck_velocity", "equalisation_time", "cooling_time_constant", "sensor_gain"):
        records[name] = 1.0
    return records


_BLANK: Final = _blank_record()
assert VALVE_RECORD.names is not None
assert VALVE_RECORD.names[: len(DECLARED)] == tuple(DECLARED), "the record begins with the declared parameters"


def new_record(declared: Mapping[str, float], effects: Mapping[str, Mapping[str, float]]) -> Any:
    """A valve as the compiled core reads it.

    Args:
        declared: every name of `DECLARED` to its value, SI.
        effects: the effects that are on.

    Returns:
        (1,) VALVE_RECORD array.
    """
    records = _BLANK.copy()
    # Written at once, as the numbers that they are: by name it takes longer than a simulation.
    records.view(np.float64)[: len(DECLARED)] = [declared[name] for name in DECLARED]
    for name, values in effects.items():
        CATALOGUE[name].apply_rewrite(records[0], values)
    for name, values in effects.items():
        CATALOGUE[name].apply_term(records[0], values)
    return records
