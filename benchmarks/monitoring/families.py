"""The parts of the benchmark of the monitor: what each seed does, and which figures it must meet."""

from __future__ import annotations

import argparse
import copy
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Final, NamedTuple

from identification.live_strokes import STROKE_SECONDS, LiveValve
from scipy.stats import chi2

from benchmarks.common import mapped, say
from benchmarks.monitoring.rigs import (
    CoilRig,
    GasRig,
    Healthy,
    PositionRig,
    Watched,
    drawn_valve,
    rising,
    watch,
    watch_healthy,
)
from benchmarks.monitoring.sweep import changes as swept
from valve_sim.files.parameter_files import load_valve
from valve_sim.files.resources import config_path
from valve_sim.identification.monitoring.settings import MonitorSettings

ALARM_FORCE: Final = 7.5e-3
"""N: five detection limits with true stamps."""
NAME_FORCES: Final = {0.0: 7.5e-3, 50e-6: 38e-3}
"""N by s of jitter: five detection limits of each."""
COMMISSIONING, GROWING, STAYING, SOON = 25, 50, 20, 5
"""Strokes: healthy ones first, of growth, after it, and of it within which an alarm is wanted."""
REACHED: Final = COMMISSIONING + GROWING - 1
"""The stroke that has all of the friction."""
ROUND: Final = 8
"""Strokes, one of each voltage, of which a limit is reported."""
NAMED: Final = 0.9
"""Of seeds."""
FRICTION: Final = "coulomb_friction"

Effects = Mapping[str, Mapping[str, float]]
Options = argparse.Namespace


class Grown(NamedTuple):
    """Of friction that grew: the stroke of the first alarm, whether it was named rightly in the end, and what was said.

    `ratio`: residual over noise before, where that was looked at.
    """

    alarmed: int | None
    is_right: bool
    words: str
    ratio: float = 1.0


def grown(seen: Watched, *, alone: bool, since: int = 0) -> Grown:
    """What a monitor made of friction: its last isolation counts, if it is of stroke `since` or a later one."""
    last = seen.isolated[-1] if seen.isolated else None
    words = "nothing isolated" if last is None else f"{last.words}; {last.seconds:.0f} CPU s"
    is_right = last is not None and last.stroke >= since and last.has_named(FRICTION, alone=alone)
    return Grown(seen.alarmed, is_right, words)


def soon_enough(rows: Sequence[Grown], reached: int, strokes: int, words: str) -> bool:
    """Whether enough alarms came within so many strokes of friction's full size, which stroke `reached` had."""
    late = [None if row.alarmed is None else max(0, row.alarmed - reached) for row in rows]
    count = sum(one is not None and one <= strokes for one in late)
    return say(count >= NAMED * len(rows), f"{words}alarm within {strokes} strokes in {count} of {len(rows)}: {late}")


def named(rows: Sequence[Grown], words: str) -> bool:
    """Whether enough of them named it; prints what each said."""
    right = sum(row.is_right for row in rows)
    is_good = say(right >= NAMED * len(rows), f"{words} in {right} of {len(rows)}")
    for row in rows:
        print(f"      {row.words}")
    return is_good


def few_alarms(rows: Sequence[Healthy], words: str) -> bool:
    """Whether at most one stroke of a thousand raised an alarm."""
    total, alarms = sum(row.strokes for row in rows), sum(row.alarms for row in rows)
    most = max(1.0, 1e-3 * total)
    return say(alarms <= most, f"{words}: {alarms} alarms in {total} healthy strokes (at most {most:g})")


# --- by the position --------------------------------------------------------------------------------------------------


def healthy_of(seed: int, strokes: int) -> Healthy:
    """One seed without fault."""
    return watch_healthy(PositionRig(drawn_valve(seed, 50e-6, 0.7 * (seed % 2))), strokes)


def healthy(options: Options) -> bool:
    """Strokes without fault."""
    rows = mapped(partial(healthy_of, strokes=-(-options.strokes // options.seeds)), options)
    worst = max(abs(row.ratio - 1.0) for row in rows)
    each = sum(row.seconds for row in rows) / sum(row.strokes for row in rows)
    return all([
        few_alarms(rows, "stamps off by 50 µs"),
        say(worst < 0.1, f"residual over noise: within {worst:.1%} of 1 in each seed (10 %)"),
        say(each < STROKE_SECONDS, f"{1e3 * each:.1f} ms of computing a stroke, wanted {1e3 * STROKE_SECONDS:g}"),
    ])  # fmt: skip


def growth_of(seed: int, jitter: float, force: float, *, isolates: bool) -> Grown:
    """One seed of friction that grows."""
    forces = rising(force, COMMISSIONING, GROWING, STAYING + 1)
    seen = watch(PositionRig(drawn_valve(seed, jitter)), forces, COMMISSIONING, isolates=isolates)
    return grown(seen, alone=True)


def growth(options: Options) -> bool:
    """Friction that grows, with true stamps and with others."""
    good = []
    for jitter, force in NAME_FORCES.items():
        words = f"stamps off by {1e6 * jitter:g} µs, to"
        rows = mapped(partial(growth_of, jitter=jitter, force=force, isolates=True), options)
        alarms = rows
        if force != ALARM_FORCE:
            alarms = mapped(partial(growth_of, jitter=jitter, force=ALARM_FORCE, isolates=False), options)
        good.append(soon_enough(alarms, REACHED, SOON, f"{words} {1e3 * ALARM_FORCE:g} mN: "))
        good.append(named(rows, f"{words} {1e3 * force:g} mN: the right name"))
    return all(good)


ERRORS: Final = {"variation": 0.1, "drift": 1e-6, "hum": 0.5e-6}
"""Of a laboratory: relative, of dampings from stroke to stroke; m a stroke; m."""
LABORATORY_FORCE: Final = 0.3
"""N, to which friction grows in a laboratory, 6 mN a stroke: where it is named is measured."""
MOST_ALARMS: Final = 3.0
"""In 10,000 healthy strokes of a laboratory."""


def in_laboratory(seed: int, rate: float, strokes: int, *, is_plain: bool) -> Healthy:
    """One seed without fault at a rate, with all that a laboratory adds or without any of it."""
    errors = {} if is_plain else ERRORS
    return watch_healthy(PositionRig(drawn_valve(seed, 50e-6, rate=rate, **errors)), strokes)


def growth_in_laboratory(seed: int, rate: float) -> Grown:
    """One seed of friction that grows among errors; its words begin with the friction at the alarm and at the name."""
    rig = PositionRig(drawn_valve(seed, 50e-6, rate=rate, **ERRORS))
    for _ in range(COMMISSIONING + ROUND):
        rig.stroke(0.0)
    limit = rig.limits(ROUND)[0].get(FRICTION, {}).get("force", math.nan)
    forces = rising(LABORATORY_FORCE, 0, GROWING, STAYING + 1)
    seen, begun = watch(rig, forces, 0), COMMISSIONING + ROUND
    right = [one for one in seen.isolated if one.has_named(FRICTION, alone=True)]

    def force_at(stroke: int | None) -> float:
        return math.nan if stroke is None else 1e3 * forces[max(0, stroke - begun)]

    at = f"alarm at {force_at(seen.alarmed):.0f} mN, named at {force_at(right[0].stroke if right else None):.0f}"
    found = grown(seen, alone=True)
    return found._replace(words=f"{at}, limit {1e3 * limit:.0f}: {found.words}")


def laboratory(options: Options) -> bool:
    """What a monitor makes of a laboratory's errors."""
    good = []
    each = -(-options.strokes // (options.seeds * len(options.rates)))
    declared = MonitorSettings().strokes_between_false_alarms
    for is_plain in (False, True) if options.strokes else ():
        rows: list[Healthy] = []
        for rate in options.rates:
            own = mapped(partial(in_laboratory, rate=rate, strokes=each, is_plain=is_plain), options)
            ratio, spent = sum(row.ratio for row in own) / len(own), sum(row.seconds for row in own)
            print(
                f"      {rate:.0f} Hz: alarms {[row.alarms for row in own]}, residual over noise {ratio:.3f}, "
                f"{1e3 * spent / sum(row.strokes for row in own):.0f} ms of computing a stroke, its plant among it"
            )
            rows += own
        total, alarms = sum(row.strokes for row in rows), sum(row.alarms for row in rows)
        # Of a Poisson distribution.
        low, high = 0.5 * chi2.ppf(0.025, 2 * alarms) if alarms else 0.0, 0.5 * chi2.ppf(0.975, 2 * alarms + 2)
        is_good = low <= total / declared <= high and alarms <= max(1.0, MOST_ALARMS * total / 10_000)
        words = f"{alarms} alarms in {total} healthy strokes {'without' if is_plain else 'with'} errors"
        rates = f"{1e4 * low / total:.2g} to {1e4 * high / total:.2g} in 10,000 (95 %), declared {1e4 / declared:g}"
        good.append(say(is_good, f"{words}: {rates}"))
    for rate in options.rates:
        words = f"friction that grows to {1e3 * LABORATORY_FORCE:g} mN, {rate:.0f} Hz: the right name"
        good.append(named(mapped(partial(growth_in_laboratory, rate=rate), options), words))
    return all(good)


TANKS, SWEPT_RATES = ("tank_1", "tank_2", "tank_3"), (500.0, 1000.0)
SWEPT_BEFORE, MOST, BEYOND = 30, 20, 3.0
"""Strokes: healthy ones first, and faulty ones at most; limits beyond which an alarm is wanted soon."""
SWEPT_HEALTHY: Final = 2000


def sweep_one(tank: str, rate: float, options: Options) -> list[tuple[str, bool]]:
    """A line for each change of one valve; of those that exceed `BEYOND` limits, whether the alarm came soon."""
    rig = PositionRig(LiveValve(22, jitter=0.0, rate=rate), load_valve(config_path(f"{tank}.yaml")))
    for _ in range(SWEPT_BEFORE):
        rig.stroke()
    limits, plant = rig.limits(ROUND)
    counted = []
    for change in swept(rig.valve.exact(), limits, plant, options.limits):
        if options.only not in change.words:
            continue
        own = copy.deepcopy(rig)
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
    from identification.live_strokes import feed

    return list(feed(rig.monitor, next(rows)))


def sweep(options: Options) -> bool:
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


# --- by the current, and with gas -------------------------------------------------------------------------------------

COIL_GROWING, COIL_STAYING, COIL_SOON = 20, 40, 10
FIVE: Final = 5.0
"""Detection limits."""


def coil_healthy_of(seed: int, strokes: int) -> Healthy:
    """One seed without fault."""
    return watch_healthy(CoilRig(seed), strokes)


def coil_growth_of(seed: int) -> Grown:
    """One seed of friction that grows to five detection limits; what is isolated before does not count."""
    rig = CoilRig(seed)
    forces = rising(FIVE * rig.detection_limit(), COMMISSIONING, COIL_GROWING, COIL_STAYING)
    return grown(watch(rig, forces, COMMISSIONING), alone=False, since=COMMISSIONING + COIL_GROWING - 1)


def coil(options: Options) -> bool:
    """A valve of which only the coil is seen."""
    good = []
    if options.strokes:
        rows = mapped(partial(coil_healthy_of, strokes=-(-options.strokes // options.seeds)), options)
        good.append(few_alarms(rows, "by the current alone"))
    rows = mapped(coil_growth_of, options)
    good.append(soon_enough(rows, COMMISSIONING + COIL_GROWING - 1, COIL_SOON, ""))
    good.append(named(rows, f"its class named within {COIL_STAYING} strokes"))
    return all(good)


GAS_HEALTHY, GAS_FAULTY, GAS_COMMISSIONING = 10, 20, 8


def gas_of(seed: int) -> tuple[str, bool, bool]:
    """One seed: in words, whether the fault was named right, and whether its interval holds the truth."""
    rig = GasRig(seed, GAS_COMMISSIONING)
    for _ in range(GAS_HEALTHY):
        rig.stroke()
    words, effect = f"{seed} | {rig.words} | {rig.name} {rig.truth:.6g} | ", rig.name.partition(".")[0]
    seen = watch(rig, [True] * GAS_FAULTY, 0, once=True)
    if not seen.isolated:
        return f"{words}nothing isolated", False, False
    found = seen.isolated[0]
    names, size = found.finding.verdict.effects, found.finding.parameters.get(rig.name)
    is_right = names == (effect,)
    is_held = is_right and size is not None and size.low <= rig.truth <= size.high
    of_size = f"{size.value:.6g}, {size.low:.6g} to {size.high:.6g}" if size is not None else "–"
    words += f"after stroke {found.stroke} {' + '.join(names) or 'nothing'} | {of_size} | {found.seconds:.0f} CPU s"
    return words, is_right, is_held


def gas(options: Options) -> bool:
    """A leak or a clogged pilot orifice that begins in service."""
    rows = mapped(gas_of, options)
    for words, _, _ in rows:
        print(words)
    right, held = sum(is_right for _, is_right, _ in rows), sum(is_held for *_, is_held in rows)
    words = f"named {right} of {options.seeds}; the interval of 95 % holds the truth in {held} of these"
    return say(right >= NAMED * options.seeds, words)


PARTS: Final[Mapping[str, Callable[[Options], bool]]] = {
    "healthy": healthy, "growth": growth, "laboratory": laboratory, "coil": coil, "gas": gas,
    "sweep": sweep,
}  # fmt: skip
