"""The families of the benchmark of the monitor, as data: how a seed's valve is seen, what befalls it, what is wanted.

A `Quiet` family is strokes without fault, of which few may raise an alarm. In a `Growth` family friction grows to a
size and stays: wanted are an alarm soon after it has got there, and its name, alone or among look-alikes.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Final, NamedTuple

from identification.live_strokes import STROKE_SECONDS
from scipy.stats import chi2

from benchmarks.common import mapped, say
from benchmarks.monitoring.rigs import CoilRig, GasRig, Healthy, Isolated, Rig, drawn_rig, rising, watch, watch_healthy
from valve_sim.identification.monitoring.settings import MonitorSettings

NAMED: Final = 0.9
"""Of seeds."""
RATIO: Final = 0.1
"""By which the residual may differ from the noise."""
FRICTION: Final = "coulomb_friction"
FIVE: Final = 5.0
"""Detection limits."""
COMMISSIONING: Final = 25
"""Strokes: healthy ones, before anything happens."""
ERRORS: Final = {"variation": 0.1, "drift": 1e-6, "hum": 0.5e-6}
"""Of a laboratory: relative, of dampings from stroke to stroke; m a stroke; m."""

Options = argparse.Namespace
MakeRig = Callable[[int], Rig]
Part = Callable[[Options], bool]


class Quiet(NamedTuple):
    """Strokes without fault.

    Attributes:
        words: how they are seen. rig: of a seed. most: share of them that may raise an alarm.
        is_close: whether the residual must be the noise, within `RATIO`, and a stroke be computed within its duration.
        as_declared: whether the rate of false alarms that the monitor declares must be in the 95 % interval of theirs.
    """

    words: str
    rig: MakeRig
    most: float = 1e-3
    is_close: bool = False
    as_declared: bool = False

    def holds(self, options: Options) -> bool:
        """Whether few of the strokes that are asked for raise an alarm."""
        if not options.strokes:
            return True
        strokes = -(-options.strokes // options.seeds)
        rows: list[Healthy] = mapped(partial(quiet_of, family=self, strokes=strokes), options)
        total, alarms = sum(row.strokes for row in rows), sum(row.alarms for row in rows)
        ratios, each = [row.ratio for row in rows], sum(row.seconds for row in rows) / total
        # Of a Poisson distribution.
        low, high = 0.5 * chi2.ppf(0.025, 2 * alarms) if alarms else 0.0, 0.5 * chi2.ppf(0.975, 2 * alarms + 2)
        declared = MonitorSettings().strokes_between_false_alarms
        is_good = alarms <= max(1.0, self.most * total)
        is_good &= not self.as_declared or low <= total / declared <= high
        say(
            is_good,
            f"{self.words}: {alarms} alarms in {total} healthy strokes (at most {1e4 * self.most:g} in 10,000; 95 %: "
            f"{1e4 * low / total:.2g} to {1e4 * high / total:.2g}; declared {1e4 / declared:g}), residual over noise "
            f"{min(ratios):.3f} to {max(ratios):.3f}, {1e3 * each:.0f} ms of computing a stroke, its plant among it",
        )
        is_near = max(abs(ratio - 1.0) for ratio in ratios) < RATIO and each < STROKE_SECONDS
        return is_good and (not self.is_close or say(is_near, f"residual within {RATIO:.0%} of the noise, in time"))


class Growth(NamedTuple):
    """Friction that grows from stroke to stroke and then stays.

    Attributes:
        words: how it is seen. rig: of a seed. size: to which it grows, N; None: to five detection limits of the rig.
        growing, staying: strokes. before: healthy strokes.
        soon: strokes of the full size within which an alarm is wanted; None: none is.
        name: "alone", if the monitor's last word must be friction and nothing else; "in class", if friction must be
            among the names of a word that came once it had its size; "" if no name is looked for.
    """

    words: str
    rig: MakeRig
    size: float | None
    growing: int
    staying: int
    soon: int | None
    name: str
    before: int = COMMISSIONING

    def holds(self, options: Options) -> bool:
        """Whether enough seeds raise an alarm and name friction."""
        rows: list[Grown] = mapped(partial(grown_of, family=self), options)
        good, wanted = [True], NAMED * len(rows)
        if self.soon is not None:
            late = [row.late for row in rows]
            count = sum(one is not None and one <= self.soon for one in late)
            words = f"{self.words}: alarm within {self.soon} strokes in {count} of {len(rows)}: {late}"
            good.append(say(count >= wanted, words))
        if self.name:
            right = sum(row.is_named for row in rows)
            good.append(say(right >= wanted, f"{self.words}: named, {self.name}, in {right} of {len(rows)}"))
            print(*(f"      {row.words}" for row in rows), sep="\n")
        return all(good)


class Grown(NamedTuple):
    """Of friction that grew: strokes from its full size to the first alarm, whether it was named, and what was said."""

    late: int | None
    is_named: bool
    words: str


def quiet_of(seed: int, family: Quiet, strokes: int) -> Healthy:
    """One seed without fault."""
    return watch_healthy(family.rig(seed), strokes)


def grown_of(seed: int, family: Growth) -> Grown:
    """One seed of friction that grows."""
    rig = family.rig(seed)
    size = family.size if family.size is not None else FIVE * rig.detection_limit()  # type: ignore[attr-defined]
    forces = rising(size, family.before, family.growing, family.staying)
    seen = watch(rig, forces, family.before, isolates=bool(family.name))
    reached = family.before + family.growing - 1

    def counts(one: Isolated) -> bool:
        return one.has_named(FRICTION, alone=family.name == "alone")

    def force_at(stroke: int | None) -> str:
        return "never" if stroke is None else f"{1e3 * forces[min(stroke, len(forces) - 1)]:.3g} mN"

    last = seen.isolated[-1] if seen.isolated else None
    is_named = last is not None and counts(last) and (family.name == "alone" or last.stroke >= reached)
    first = next((one.stroke for one in seen.isolated if counts(one)), None)
    said = "nothing isolated" if last is None else f"{last.words}; {last.seconds:.0f} CPU s"
    late = None if seen.alarmed is None else max(0, seen.alarmed - reached)
    return Grown(late, is_named, f"alarm at {force_at(seen.alarmed)}, named at {force_at(first)}: {said}")


# --- the families -----------------------------------------------------------------------------------------------------

LATE: Final = 50e-6
"""s, of each command's stamp."""
GROWTH: Final = (
    Growth("true stamps, to 7.5 mN", partial(drawn_rig, jitter=0.0), 7.5e-3, 50, 21, 5, "alone"),
    Growth("stamps off by 50 µs, to 7.5 mN", partial(drawn_rig, jitter=LATE), 7.5e-3, 50, 21, 5, ""),
    Growth("stamps off by 50 µs, to 38 mN", partial(drawn_rig, jitter=LATE), 38e-3, 50, 21, None, "alone"),
)
"""7.5 mN are five detection limits with true stamps, 38 mN with others."""
COIL: Final = (
    Quiet("by the current alone", CoilRig),
    Growth("by the current alone", CoilRig, None, 20, 40, 10, "in class"),
)


def in_laboratory(rate: float) -> tuple[Quiet | Growth, ...]:
    """At a rate, Hz: without a laboratory's errors, with them, and friction that grows among them."""
    plain, erring = (partial(drawn_rig, jitter=LATE, rate=rate, **errors) for errors in ({}, ERRORS))
    # Friction begins after one more round of all voltages, of which a detection limit would be reported.
    return (
        Quiet(f"{rate:.0f} Hz without errors", plain, 3e-4, as_declared=True),
        Quiet(f"{rate:.0f} Hz with errors", erring, 3e-4, as_declared=True),
        Growth(f"{rate:.0f} Hz, to 300 mN", erring, 0.3, 50, 21, None, "alone", COMMISSIONING + 8),
    )


# --- with gas ---------------------------------------------------------------------------------------------------------

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
    rows: Sequence[Any] = mapped(gas_of, options)
    print(*(words for words, _, _ in rows), sep="\n")
    right, held = sum(is_right for _, is_right, _ in rows), sum(is_held for *_, is_held in rows)
    words = f"named {right} of {options.seeds}; the interval of 95 % holds the truth in {held} of these"
    return say(right >= NAMED * options.seeds, words)


def each_of(families: Sequence[Quiet | Growth]) -> Part:
    """A part that is these families, each of which must hold."""
    return lambda options: all([family.holds(options) for family in families])


PARTS: Final[Mapping[str, Part]] = {
    "healthy": each_of([Quiet("stamps off by 50 µs", partial(drawn_rig, jitter=LATE, colours=True), is_close=True)]),
    "growth": each_of(GROWTH),
    "laboratory": lambda options: each_of([own for rate in options.rates for own in in_laboratory(rate)])(options),
    "coil": each_of(COIL),
    "gas": gas,
}
