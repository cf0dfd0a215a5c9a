"""A plant is checked once, before anything is fitted to it: one line says what is wrong and where.

Its members, channels, names and ranges are looked at, and it is asked for a prediction at the declared values and for
one where each effect starts. A prediction that goes wrong later in a search is met by `checked_prediction`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Final, get_args

import numpy as np

from valve_sim.identification.plants.protocol import (
    MACHINE_ERRORS,
    SENSOR_ERRORS,
    Array,
    Channel,
    Contacts,
    EffectChoice,
    ForceMap,
    HasSensors,
    Nuisance,
    Plant,
    Role,
    Sensor,
    perturbed,
    varying_of,
)
from valve_sim.identification.plants.variation import VARIATION, stroke_of
from valve_sim.model.errors import SimulationError, ValveError
from valve_sim.model.parameters import Parameter
from valve_sim.traces.checking import problem_of_column, problem_of_order

MEMBERS: Final = ("channels", "base", "nuisances", "timing_errors", "effects", "force_maps", "experiments")
"""Members that every plant has, beside `FUNCTIONS`."""
FUNCTIONS: Final = ("parameter", "declared", "predict")
OF_RECORDINGS: Final = ("sensors", "varying")
"""Members of a plant whose recordings have errors; it has both or none."""
COLUMNS: Final = ("times", "data")

Check = Callable[[], None]


class PlantError(ValveError):
    """A plant does not keep to what a `Plant` promises: one line with the member, what was found and the mend."""


class _NoResultError(SimulationError):
    """A prediction that is not finite, or an arithmetic error in place of one."""


def check_plant(plant: Plant, after_declared: Check = lambda: None) -> None:
    """A plant that keeps to the protocol, as far as one prediction at the declared values and one for each effect show.

    Args:
        plant: anything.
        after_declared: called after each of the first two predictions, which are of the declared machine: in between
            one is made without what only the first one takes, compiling say.

    Raises:
        PlantError: it does not.
        SimulationError: it cannot be simulated with the declared values, as it says itself.
    """
    name = name_of(plant)
    missing = [member for member in (*MEMBERS, *FUNCTIONS) if not _has(plant, member)]
    if missing:
        raise PlantError(f"{name}: has no {missing[0]}, which every plant has; see docs/how_to/your_own_plant.md")
    try:
        for check in CHECKS:
            check(name, plant)
    except ValveError:
        raise
    except Exception as error:
        # Whatever of a kind that no check has thought of: a list where a name was meant, say.
        raise PlantError(f"{name}: its members cannot be read as a Plant's: {_raised(error)}") from error
    with named_interrupts(plant):
        _check_predictions(plant, after_declared)
        if isinstance(plant, HasSensors):
            _check_sensors(name, plant, plant)


def checked_prediction(plant: Plant, values: Mapping[str, float]) -> list[Array]:
    """What a plant predicts: for each channel as many finite numbers as it has samples.

    Args:
        plant: that `check_plant` has looked at. values: as of its `predict`.

    Raises:
        PlantError: it raises something of its own, or returns something else.
        SimulationError: it says so itself; or a result that is not finite or an arithmetic error: it has none with
            these values.
    """
    where = f"{name_of(plant)}.predict({_words(values)})"
    try:
        shown = plant.predict(values)
    except ValveError:
        raise
    except ArithmeticError as error:
        raise _NoResultError(f"{where} raised {_raised(error)}") from error
    except Exception as error:
        raise PlantError(f"{where} raised {_raised(error)}") from error
    if not isinstance(shown, list | tuple) or len(shown) != len(plant.channels):
        found = f"{len(shown)} columns" if isinstance(shown, list | tuple) else type(shown).__name__
        raise PlantError(f"{where}: found {found}, expected a list of {len(plant.channels)}, one for each channel")
    for index, (column, channel) in enumerate(zip(shown, plant.channels, strict=True)):
        problem = problem_of_column(column, len(channel.data))
        if problem:
            kind = PlantError if problem_of_column(column, len(channel.data), is_finite=False) else _NoResultError
            raise kind(f"{where}[{index}]: {problem}")
    return list(shown)


@contextmanager
def named_interrupts(plant: Plant) -> Iterator[None]:
    """Within this block Ctrl-C says whose predictions it ended: those of a plant that never returns, perhaps."""
    try:
        yield
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"{name_of(plant)}: interrupted while it was asked for predictions") from None


def name_of(plant: object) -> str:
    """Name of a plant in messages: its class."""
    return type(plant).__name__


def _has(plant: object, member: str) -> bool:
    """Whether a member is there; a property that raises is.

    Raises:
        PlantError: a property raises something of its own.
    """
    try:
        return hasattr(plant, member) and (member not in FUNCTIONS or callable(getattr(plant, member)))
    except ValveError:
        raise
    except Exception as error:
        raise PlantError(f"{name_of(plant)}.{member} raised {_raised(error)}") from error


def _raised(error: BaseException) -> str:
    """KeyError: 'gian', on one line."""
    words = " ".join(str(error).split())
    return f"{type(error).__name__}: {words}" if words else type(error).__name__


def _words(values: Mapping[str, float]) -> str:
    """The values of a prediction, the first few."""
    few = [f"{name}={value:.6g}" for name, value in list(values.items())[:4]]
    return "{" + ", ".join([*few, *(["..."] if len(values) > len(few) else [])]) + "}"


def _check_channels(name: str, plant: Plant) -> None:
    channels = plant.channels
    if not isinstance(channels, Sequence) or not channels:
        raise PlantError(f"{name}.channels: found {channels!r:.60}, expected at least one Channel in a list or tuple")
    for index, channel in enumerate(channels):
        where = f"{name}.channels[{index}]"
        if not isinstance(channel, Channel):
            raise PlantError(f"{where}: found {type(channel).__name__}, expected a Channel")
        problem = _problem_of_channel(channel)
        if problem:
            raise PlantError(f"{where}.{problem}")
        problem = _problem_of_numbers(channel)
        if problem:
            raise PlantError(f"{where}.{problem}")
    if not any(len(channel.data) for channel in channels):
        raise PlantError(f"{name}.channels: found no sample in any of them")
    kinds: dict[str, str] = {}
    for index, channel in enumerate(channels):
        unit = kinds.setdefault(channel.kind, channel.unit)
        if unit != channel.unit:
            raise PlantError(
                f"{name}.channels[{index}].unit: found {channel.unit!r}, expected {unit!r} as of the other channels of "
                f"the kind {channel.kind!r}"
            )


def _problem_of_channel(channel: Channel) -> str:
    """The member of a channel that is wrong, and what is wrong with it."""
    for column in COLUMNS:
        problem = problem_of_column(getattr(channel, column))
        if problem:
            return f"{column}: {problem}"
    count = len(channel.data)
    for column, kind in (("times", np.floating), ("quiet", np.bool_), ("group", np.integer)):
        found = getattr(channel, column)
        if not isinstance(found, np.ndarray) or found.shape != (count,) or not np.issubdtype(found.dtype, kind):
            shown = f"shape {found.shape}, dtype {found.dtype}" if isinstance(found, np.ndarray) else repr(found)[:40]
            return f"{column}: found {shown}, expected ({count},) of {kind.__name__}, as long as data"
    left_out = channel.left_out
    if left_out is not None and (
        not isinstance(left_out, np.ndarray) or left_out.shape != (count,) or left_out.dtype != np.bool_
    ):
        return f"left_out: found {left_out!r:.40}, expected ({count},) of bool, as long as data, or None"
    problem = problem_of_order(channel.times, rises=False)
    return f"times: {problem}" if problem else ""


def _problem_of_numbers(channel: Channel) -> str:
    """What is wrong with the numbers of its strokes, its role or its resolution, after the name of that member."""
    if int(channel.group.min(initial=0)) < 0:
        return f"group: found {int(channel.group.min())}, expected numbers of strokes from 0 on"
    if channel.role not in get_args(Role):
        return f"role: found {channel.role!r}, expected one of {', '.join(get_args(Role))}"
    if not (_is_number(channel.resolution) and channel.resolution >= 0.0):
        return f"resolution: found {channel.resolution!r}, expected a number from 0 on"
    return ""


def _check_base(name: str, plant: Plant) -> None:
    where = f"{name}.base"
    if isinstance(plant.base, str) or not isinstance(plant.base, Sequence):
        raise PlantError(f"{where}: found {plant.base!r}, expected a tuple of names, ({plant.base!r},)")
    if len(set(plant.base)) < len(plant.base):
        raise PlantError(f"{where}: found {tuple(plant.base)!r}, expected each name once")
    for own in plant.base:
        _check_name(name, plant, own, where)


def _check_name(name: str, plant: Plant, own: str, where: str) -> Parameter:
    """What a fit frees: the plant knows its range, and a declared value within it."""
    parameter = _asked(name, plant.parameter, "parameter", own, where)
    if not isinstance(parameter, Parameter):
        raise PlantError(f"{name}.parameter({own!r}): found {type(parameter).__name__}, expected a Parameter")
    problem = _problem_of_parameter(parameter)
    if problem:
        raise PlantError(f"{name}.parameter({own!r}): {problem}")
    declared = _asked(name, plant.declared, "declared", own, where)
    if not isinstance(declared, int | float | np.floating) or math.isnan(declared):
        raise PlantError(f"{name}.declared({own!r}): found {declared!r}, expected a number")
    is_off = parameter.off is not None and declared == parameter.off
    if not (is_off or parameter.lower <= declared <= parameter.upper):
        raise PlantError(f"{name}.declared({own!r}): found {declared!r}, expected {parameter.range_words()}")
    return parameter


def _asked(name: str, function: Callable[[str], Any], what: str, own: str, where: str) -> Any:
    """The parameter that a plant has for a name."""
    try:
        return function(own)
    except ValveError:
        raise
    except Exception as error:
        found = f"found {own!r}, which {name}.{what} does not know"
        raise PlantError(f"{where}: {found}: it raised {_raised(error)}") from error


def _problem_of_parameter(parameter: Parameter) -> str:
    """The fault of a parameter's range."""
    bounds = (parameter.lower, parameter.upper)
    if not all(isinstance(one, int | float | np.floating) for one in bounds) or not bounds[0] < bounds[1]:
        return f"found the range {bounds[0]!r} to {bounds[1]!r}, expected lower < upper"
    if not (_is_number(parameter.prior_scale) and parameter.prior_scale != 0.0):
        return f"found prior_scale {parameter.prior_scale!r}, expected a number that is not 0"
    off = parameter.off
    if not (off is None or isinstance(off, int | float | np.floating)):
        return f"found off = {off!r}, expected a number or None"
    if off is not None and not math.isinf(off) and not bounds[0] <= off <= bounds[1]:
        return f"found off = {off!r}, expected {parameter.range_words()}"
    return ""


def _check_effects(name: str, plant: Plant) -> None:
    where = f"{name}.effects"
    if not isinstance(plant.effects, Mapping):
        raise PlantError(f"{where}: found {type(plant.effects).__name__}, expected a mapping of names to EffectChoice")
    for key, effect in plant.effects.items():
        own = f"{where}[{key!r}]"
        if not isinstance(effect, EffectChoice):
            raise PlantError(f"{own}: found {type(effect).__name__}, expected an EffectChoice")
        if effect.name != key:
            raise PlantError(f"{own}: found the name {effect.name!r}, expected {key!r}, by which it is listed")
        if not effect.parameters or not all(isinstance(one, Parameter) for one in effect.parameters):
            raise PlantError(f"{own}.parameters: found {effect.parameters!r:.60}, expected a tuple of Parameter")
        for free in effect.free_names():
            _check_name(name, plant, free, own)
        for started, value in effect.start.items():
            if not _is_number(value):
                raise PlantError(f"{own}.start[{started!r}]: found {value!r}, expected a finite number")


def _check_nuisances(name: str, plant: Plant) -> None:
    effects = {free: effect for effect in plant.effects.values() for free in effect.free_names()}
    seen: set[str] = set()
    found = [member for member in OF_RECORDINGS if hasattr(plant, member)]
    if len(found) == 1:
        (other,) = set(OF_RECORDINGS) - set(found)
        raise PlantError(f"{name}: has {found[0]}, but no {other}; a plant whose recordings err has both")
    of_recordings = ("varying",) if found else ()
    for member in ("nuisances", "timing_errors", *of_recordings, "force_maps", "experiments"):
        if not isinstance(getattr(plant, member), Sequence):
            raise PlantError(f"{name}.{member}: found {getattr(plant, member)!r:.60}, expected a tuple or list, or ()")
    members = {"nuisances": plant.nuisances, "timing_errors": plant.timing_errors, "varying": varying_of(plant)}
    for member, listed in members.items():
        for index, own in enumerate(listed):
            where = f"{name}.{member}[{index}]"
            if not isinstance(own, Nuisance):
                raise PlantError(f"{where}: found {type(own).__name__}, expected a Nuisance")
            problem = _problem_of_nuisance(own, len(plant.channels))
            if member == "varying":
                problem = problem or _problem_of_varying(own)
            if problem or own.name in seen:
                raise PlantError(f"{where} ({own.name}): {problem or 'found its name twice'}")
            seen.add(own.name)
            if own.same_as in effects and own.same_slope == 1.0:
                unit = plant.parameter(own.same_as).unit
                if unit != own.unit:
                    raise PlantError(
                        f"{where} ({own.name}): found same_as {own.same_as!r} in {unit!r}, but {own.unit!r} itself; "
                        "same_slope says how the one changes with the other"
                    )


def _problem_of_nuisance(own: Nuisance, channels: int) -> str:
    """What is wrong with one."""
    for member in ("sigma", "step"):
        value = getattr(own, member)
        if not (_is_number(value) and value > 0.0):
            return f"found {member} {value!r}, expected a number above 0"
    if not (_is_number(own.mean) and own.lower <= own.mean <= own.upper):
        return f"found mean {own.mean!r}, expected a number from {own.lower!r} to {own.upper!r}"
    wrong = [index for index in own.channels if not 0 <= index < channels]
    return f"found channel {wrong[0]}, expected 0 to {channels - 1}" if wrong else ""


def _problem_of_varying(own: Nuisance) -> str:
    """What is wrong with a part of an error of the machine."""
    if own.error not in MACHINE_ERRORS:
        return f"found error {own.error!r}, expected one of {', '.join(MACHINE_ERRORS)}"
    if not own.group:
        return "found no group; parts of one group share a size"
    if not own.channels:
        return "found no channels; those of its recording are needed"
    if own.error == VARIATION:
        try:
            stroke_of(own.name)
        except ValueError:
            return f"expected the name {VARIATION}[recording,stroke,what], as group_variations gives it"
    return ""


def _check_sensors(name: str, plant: Plant, of_sensors: HasSensors) -> None:
    where = f"{name}.sensors({{}})"
    try:
        sensors = of_sensors.sensors({})
    except ValveError:
        raise
    except Exception as error:
        raise PlantError(f"{where} raised {_raised(error)}") from error
    if not isinstance(sensors, Mapping):
        raise PlantError(f"{where}: found {type(sensors).__name__}, expected a mapping of channels' indices to Sensor")
    for index, sensor in sensors.items():
        if not isinstance(index, int) or not 0 <= index < len(plant.channels):
            raise PlantError(f"{where}: found the channel {index!r}, expected 0 to {len(plant.channels) - 1}")
        if not isinstance(sensor, Sensor):
            raise PlantError(f"{where}[{index}]: found {type(sensor).__name__}, expected a Sensor")
        for problem in _problems_of_sensor(sensor, sensors):
            raise PlantError(f"{where}[{index}].{problem}")


def _problems_of_sensor(sensor: Sensor, sensors: Mapping[int, Sensor]) -> Iterator[str]:
    """The members of a sensor that are wrong, and what is wrong with each."""
    if not (_is_number(sensor.span) and sensor.span > 0.0):
        yield f"span: found {sensor.span!r}, expected a number above 0"
    if not _is_number(sensor.low):
        yield f"low: found {sensor.low!r}, expected a number"
    problem = "" if sensor.knots is None else problem_of_column(sensor.knots)
    if sensor.knots is not None and (problem or problem_of_order(sensor.knots, rises=False)):
        yield f"knots: {problem or problem_of_order(sensor.knots, rises=False)}"
    contacts = sensor.contacts
    if not isinstance(contacts, Contacts):
        yield f"contacts: found {type(contacts).__name__}, expected Contacts"
    elif len({len(column) for column in contacts}) > 1:
        yield f"contacts: found {', '.join(str(len(column)) for column in contacts)} values, expected as many of each"
    if not isinstance(sensor.shares, Mapping):
        yield f"shares: found {sensor.shares!r:.40}, expected a mapping of names of errors to numbers"
    for error, share in sensor.shares.items():
        if error not in SENSOR_ERRORS:
            yield f"shares: found {error!r}, expected of {', '.join(SENSOR_ERRORS)}"
        if not (_is_number(share) and share >= 0.0):
            yield f"shares[{error!r}]: found {share!r}, expected a number from 0 on"
    if sensor.alike is not None and sensor.alike not in sensors:
        yield f"alike: found {sensor.alike!r}, expected the channel of a sensor"
    elif sensor.alike is not None and _scales(sensor) != _scales(sensors[sensor.alike]):
        yield f"alike: found a sensor of another span or other shares than that of channel {sensor.alike}"


def _scales(sensor: Sensor) -> tuple[float, dict[str, float]]:
    """The range and shares from which the priors of a sensor's errors follow."""
    return sensor.span, dict(sensor.shares)


def _check_force_maps(name: str, plant: Plant) -> None:
    for index, force in enumerate(plant.force_maps):
        where = f"{name}.force_maps[{index}]"
        if not isinstance(force, ForceMap):
            raise PlantError(f"{where}: found {type(force).__name__}, expected a ForceMap")
        for own in force.coefficients:
            _check_name(name, plant, own, where)


CHECKS: Final = (_check_channels, _check_effects, _check_base, _check_nuisances, _check_force_maps)
"""Of the members, in the order in which they rest on each other."""


def _check_predictions(plant: Plant, after_declared: Check) -> None:
    # Names that a plant's own `predict` does not know show when they are given.
    as_declared = {own: plant.declared(own) for own in plant.base}
    starts = [{free: _start_of(plant, free) for free in effect.free_names()} for effect in plant.effects.values()]
    for index, values in enumerate(({}, as_declared, *starts)):
        try:
            checked_prediction(plant, values)
        except _NoResultError as error:
            raise PlantError(str(error)) from error
        except SimulationError:
            # Not every machine can be simulated with every effect; a search leaves such an effect out and says so.
            if index < 2:
                raise
        if index < 2:
            after_declared()


def _start_of(plant: Plant, free: str) -> float:
    """Where a search would start a parameter: near off, or at its scale where it only shapes an effect."""
    parameter = plant.parameter(free)
    if parameter.off is None:
        return min(max(parameter.prior_scale, parameter.lower), parameter.upper)
    return perturbed(parameter, parameter.off)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float | np.floating | np.integer) and math.isfinite(value)
