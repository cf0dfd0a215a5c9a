"""What may change in a valve, each by a number of its reported limits, or by a share where none is reported.

A limit is what `diagnose` says would have shown, had it been there, in eight healthy strokes of that valve at that
rate. A limit of what does nothing at infinity, such as a sensor's bandwidth, counts by its reciprocal.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any, Final, NamedTuple

from identification.live_strokes import LEVELS, LiveValve, feed

from benchmarks.common import say
from benchmarks.monitoring.rigs import PositionRig, watch, watch_healthy
from valve_sim.files.parameter_files import load_valve
from valve_sim.files.resources import config_path
from valve_sim.identification.plants.protocol import from_internal, internal_bounds, is_two_sided, to_internal
from valve_sim.identification.plants.tolerances import SAME_AS
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.model import CATALOGUE, DECLARED, Parameter, Tag, Valve

UNREPORTED: Final = {
    "pilot_damping": (1.0, 0.3), "main_damping": (4.0, 0.3), "seat_load": (0.0, 0.05),
    "a1": (17.096e3, 0.01), "a2": (-30.931e6, 0.01), "a3": (24.026e9, 0.01),
}  # fmt: skip
"""Declared values that nothing reports a limit of: as declared, and by which share they are another, or by how much."""

Effects = Mapping[str, Mapping[str, float]]
Limits = Mapping[str, Mapping[str, float]]


class Change(NamedTuple):
    """One thing that is another than it was.

    Attributes:
        words: what. over: its size over the reported limit; nan where none is reported.
        size, limit: in the unit of the value, or as its reciprocal.
        effects: all that are on. parameters: declared values of the plant that are another.
    """

    words: str
    over: float
    size: float
    limit: float
    effects: Effects
    parameters: Mapping[str, float | tuple[float, ...]]


def changes(valve: Valve, limits: Limits, plant: ValvePlant, times: float) -> list[Change]:
    """Of a valve that declares effects, these alone; else every effect that may be named and every declared value."""
    found = list(_of_effects(valve, limits, plant, times))
    return found if valve.effects else [*found, *_of_values(valve, limits, times)]


def _of_effects(valve: Valve, limits: Limits, plant: ValvePlant, times: float) -> Iterator[Change]:
    """Each switch of each effect, at so many limits."""
    built_in = {entry.name for entry in CATALOGUE.tagged(Tag.BUILT_IN)}
    for name, choice in plant.effects.items():
        if name in built_in or choice.is_declared_value or (valve.effects and name not in valve.effects):
            continue
        shapes = {own.name: own.prior_scale for own in choice.parameters if own.off is None}
        declared = valve.effects.get(name, {**CATALOGUE[name].neutral_values(), **shapes})
        for switch in choice.parameters:
            if switch.off is None:
                continue
            limit = limits.get(name, {}).get(switch.name, math.inf)
            for value, over in _sizes(switch, limit, times):
                effects = {**valve.effects, name: {**declared, switch.name: value}}
                yield Change(f"{name}.{switch.name}", over, value, limit, effects, {})


def _sizes(switch: Parameter, limit: float, times: float) -> Iterator[tuple[float, float]]:
    """Values at so many limits from off, to each side, within what they may be, and how many limits that is."""
    assert switch.off is not None
    off, (lower, upper) = to_internal(switch, switch.off), internal_bounds(switch)
    away = 1.0 / limit if math.isinf(switch.off) else limit
    for sign in (1.0, -1.0) if is_two_sided(switch) else (1.0 if upper > off else -1.0,):
        at = min(max(off + sign * times * away, lower), upper)
        yield from_internal(switch, at), abs(at - off) / away


def _of_values(valve: Valve, limits: Limits, times: float) -> Iterator[Change]:
    """Each declared value of the valve, larger and smaller by so many limits, or by `UNREPORTED`."""
    polynomial = valve.parameters.attraction_polynomial
    reported = {name.partition(".")[2]: (name, name.partition(".")[2]) for name in limits if name.startswith("valve.")}
    same = {value: tuple(effect.split(".")) for value, effect in SAME_AS.items() if value not in reported}
    for name, (effect, parameter) in {**reported, **same, "a0": ("rest_attraction", "force")}.items():
        limit = limits.get(effect, {}).get(parameter, math.inf)
        if math.isinf(limit):
            continue
        declared = polynomial[0] if name == "a0" else float(getattr(valve.parameters, name))
        limit *= declared if name == "reference_voltage" else 1.0
        for value in (declared + times * limit, declared - times * limit):
            if name == "a0" or DECLARED[name].lower <= value <= DECLARED[name].upper:
                yield _value(name, value, declared, limit, polynomial, valve.effects)
    for name, (declared, share) in UNREPORTED.items():
        yield _value(name, declared + share * (declared or 1.0), declared, math.nan, polynomial, valve.effects)


def _value(
    name: str, value: float, declared: float, limit: float, polynomial: Sequence[float], effects: Effects
) -> Change:
    parameters: dict[str, float | tuple[float, ...]] = {name: value}
    if name in ("a0", "a1", "a2", "a3"):
        order = int(name[1])
        parameters = {"attraction_polynomial": (*polynomial[:order], value, *polynomial[order + 1 :])}
    return Change(f"valve.{name}", abs(value - declared) / limit, value, limit, effects, parameters)


# --- what the monitor sees of them ------------------------------------------------------------------------------------

TANKS, SWEPT_RATES = ("tank_1", "tank_2", "tank_3"), (500.0, 1000.0)
SWEPT_BEFORE, MOST, SOON, BEYOND = 30, 20, 5, 3.0
"""Strokes: healthy ones first, faulty ones at most, and within which an alarm is wanted beyond so many limits."""
SWEPT_HEALTHY: Final = 2000


def commissioned(tank: str, rate: float) -> PositionRig:
    """A valve of the station that has stroked without fault; the same each time."""
    rig = PositionRig(LiveValve(22, jitter=0.0, rate=rate), load_valve(config_path(f"{tank}.yaml")))
    for _ in range(SWEPT_BEFORE):
        rig.stroke()
    return rig


def sweep_one(tank: str, rate: float, options: argparse.Namespace) -> list[tuple[str, bool]]:
    """A line for each change of one valve; of those that exceed `BEYOND` limits, whether the alarm came soon."""
    rig = commissioned(tank, rate)
    limits, plant = rig.limits(len(LEVELS))
    counted = []
    for change in changes(rig.valve.exact(), limits, plant, options.limits):
        if options.only not in change.words:
            continue
        # What the compiled model holds cannot be copied, so that each change has a monitor that strokes anew.
        own = commissioned(tank, rate)
        first = own.live.strokes
        rows = iter(own.live.row(MOST, change.effects, **change.parameters))  # type: ignore[arg-type]
        own.stroke = partial(_next_of, own, rows)  # type: ignore[method-assign]
        seen = watch(own, range(MOST), first, isolates=not options.no_names, once=True)
        took = None if seen.alarmed is None else seen.alarmed - first + 1
        words = f"{tank} {rate:4.0f} Hz {change.words:36} {change.size:10.4g}, limit {change.limit:9.3g}: "
        words += f"{change.over:4.1f}; alarm after {took}"
        for one in seen.isolated[:1]:
            verdict = one.finding.verdict
            words += f"; {verdict.kind} {verdict.probability:.3f}: {one.words}; {one.seconds:.0f} CPU s"
        if change.over > BEYOND:
            is_soon = took is not None and took <= SOON
            counted.append((f"{tank} {rate:.0f} Hz {change.words} {change.size:.4g}", say(is_soon, words)))
        else:
            print(f"      {words}", flush=True)
    return counted


def _next_of(rig: PositionRig, rows: Any, fault: object = None) -> list[Any]:
    """The next of some strokes in a row: what one leaves, such as heat, the next one has."""
    return list(feed(rig.monitor, next(rows)))


def sweep(options: argparse.Namespace) -> bool:
    """What may change in a valve."""
    counted: list[tuple[str, bool]] = []
    for rate in SWEPT_RATES:
        for tank in options.tanks:
            counted += sweep_one(tank, rate, options)
    late = [words for words, is_soon in counted if not is_soon]
    good = [say(not late, f"alarm within {SOON} strokes in {len(counted) - len(late)} of {len(counted)}; late: {late}")]
    for rate in SWEPT_RATES if options.strokes else ():
        own = PositionRig(LiveValve(22, jitter=0.0, rate=rate), load_valve(config_path("tank_1.yaml")))
        alarms = watch_healthy(own, min(options.strokes, SWEPT_HEALTHY)).alarms
        good.append(say(alarms <= 1, f"{alarms} alarms in healthy strokes at {rate:.0f} Hz (at most 1)"))
    return all(good)
