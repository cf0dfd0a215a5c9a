"""Does the monitor see whatever may change in a valve? `python -m benchmarks.monitoring_sweep`.

The independent plant of test/plants strokes at 7.5 to 14 V, sampled at 500 Hz and at 1 kHz with 1 µm of noise, its
commands stamped exactly; `Monitor` stands beside it. From one stroke to the next one thing is another than it was:

- of tank_1: each parameter that switches an effect on, of every effect that may be named, and each declared value, to
  either side where it has two;
- of tank_2 and tank_3: the effect that each declares, larger and smaller.

Each is a multiple (`--limits`) of its reported limit: of what `diagnose` says would have shown, had it been there, of
eight healthy strokes of that valve at that rate. A limit of what does nothing at infinity, such as a sensor's
bandwidth, counts by its reciprocal. What is reported no limit of is off by `UNREPORTED` and is counted nowhere.

Wanted: an alarm within 5 strokes of whatever exceeds three reported limits, and at most one in 2,000 healthy strokes
(`--healthy`). What the first isolation of each fault names is printed (`--no-names`: not), and is not judged here.

Needs no ROS.
"""

from __future__ import annotations

import argparse
import copy
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from benchmarks.monitoring import LiveValve, feed, say
from valve_sim.files.parameter_files import load_valve
from valve_sim.identification.diagnosis.run import diagnose_plant
from valve_sim.identification.monitoring.fault_isolation import isolate_fault, join
from valve_sim.identification.monitoring.monitor import Monitor
from valve_sim.identification.plants.protocol import from_internal, internal_bounds, is_two_sided, to_internal
from valve_sim.identification.plants.tolerances import SAME_AS
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.reporting.monitoring_words import finding_words
from valve_sim.model import CATALOGUE, DECLARED, Parameter, Tag, Valve

CONFIG = Path(__file__).resolve().parents[1] / "config"
TANKS = ("tank_1", "tank_2", "tank_3")
RATES = (500.0, 1000.0)
"""Hz."""
SEED = 22
BEFORE, ROUND, MOST = 30, 8, 20
"""Strokes: healthy ones first; one of each voltage, of which a limit is reported; faulty ones at most."""
SOON, BEYOND = 5, 3.0
"""Strokes within which an alarm is wanted of what exceeds so many limits."""
HEALTHY_STROKES = 2000
UNREPORTED = {
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


class Seen(NamedTuple):
    """What a monitor makes of a change: strokes until the alarm, None for never; what was named, and CPU s for that."""

    alarmed_after: int | None
    alarm: str
    named: str
    seconds: float


class Beside:
    """A commissioned monitor beside a healthy valve, to begin from as often as is wanted."""

    def __init__(self, tank: str, rate: float) -> None:
        self.valve = load_valve(CONFIG / f"{tank}.yaml")
        self.live = LiveValve(SEED, jitter=0.0, rate=rate)
        self.monitor = Monitor(self.valve.exact(), refit=False)
        for _ in range(BEFORE):
            list(feed(self.monitor, self.live.stroke(self.valve.effects)))

    def limits(self) -> tuple[Limits, ValvePlant]:
        """What would have shown in the last `ROUND` of the healthy strokes, and the plant that says so."""
        strokes = self.monitor.stroke_monitor.evidence()[-ROUND:]
        baseline = self.monitor.stroke_monitor.baseline
        assert baseline is not None
        recording = join(strokes, replace(baseline, lateness=0.0))
        plant = ValvePlant([recording], self.valve.exact())
        return diagnose_plant(plant, None).detection_limits, plant

    def seen(self, change: Change, *, names: bool) -> Seen:
        """Strokes of the changed valve until there is something to isolate, or `MOST`."""
        live, monitor = copy.deepcopy((self.live, self.monitor))
        first, after, cause = live.strokes, None, ""
        for stroke in live.row(MOST, change.effects, **change.parameters):
            for report in feed(monitor, stroke):
                told = report.alarm.cause if report.alarm is not None else "fault" if report.record.fault else ""
                if told and after is None and report.record.number >= first:
                    after, cause = report.record.number - first + 1, told
            evidence = monitor.stroke_monitor.take_evidence()
            if evidence and names:
                begin = time.process_time()
                found = isolate_fault(evidence, monitor.stroke_monitor.with_present_scatter())
                verdict = found.verdict
                words = f"{verdict.kind} {verdict.probability:.3f}: {finding_words(found)}"
                return Seen(after, cause, words, time.process_time() - begin)
            if after is not None and not names:
                break
        return Seen(after, cause, "", 0.0)


def effect_changes(valve: Valve, limits: Limits, plant: ValvePlant, times: float) -> Iterator[Change]:
    """Each switch of each effect that may be named, at so many limits; of a valve that declares effects, of these."""
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


def value_changes(valve: Valve, limits: Limits, times: float) -> Iterator[Change]:
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


def report_tank(tank: str, rate: float, times: float, only: str, *, names: bool) -> list[tuple[str, bool]]:
    """Print a line for each change of one valve; of those that exceed `BEYOND` limits, whether the alarm came soon."""
    beside = Beside(tank, rate)
    limits, plant = beside.limits()
    valve = beside.valve.exact()
    changes = list(effect_changes(valve, limits, plant, times))
    changes += [] if valve.effects else value_changes(valve, limits, times)
    counted = []
    for change in changes:
        if only not in change.words:
            continue
        seen = beside.seen(change, names=names)
        soon = seen.alarmed_after is not None and seen.alarmed_after <= SOON
        words = f"{tank} {rate:4.0f} Hz {change.words:36} {change.size:10.4g}, limit {change.limit:9.3g}: "
        words += f"{change.over:4.1f}; alarm {seen.alarmed_after} ({seen.alarm}); {seen.named}"
        words += f"; {seen.seconds:.0f} CPU s" if seen.named else ""
        if change.over > BEYOND:
            counted.append((f"{tank} {rate:.0f} Hz {change.words} {change.size:.4g}", soon))
            say(soon, words)
        else:
            print(f"      {words}", flush=True)
    return counted


def report_healthy(strokes: int, rate: float) -> bool:
    """Print the alarms of a healthy valve; whether there is at most one."""
    beside, begin = Beside("tank_1", rate), time.process_time()
    for _ in range(strokes):
        list(feed(beside.monitor, beside.live.stroke()))
    alarms = beside.monitor.stroke_monitor.alarms
    words = f"{alarms} alarms in {strokes} healthy strokes at {rate:.0f} Hz (at most 1)"
    say(alarms <= 1, f"{words}; {time.process_time() - begin:.0f} CPU s with the plant's")
    return alarms <= 1


def main() -> int:
    """Run and print; 1 if anything falls short."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--limits", type=float, default=3.3, help="size of each change, in reported limits")
    parser.add_argument("--rates", type=float, nargs="*", default=RATES, help="Hz")
    parser.add_argument("--tanks", nargs="*", default=TANKS)
    parser.add_argument("--only", default="", help="changes whose name has this in it")
    parser.add_argument("--healthy", type=int, default=HEALTHY_STROKES, help="healthy strokes at each rate; 0: none")
    parser.add_argument("--no-names", action="store_true", help="alarms only")
    chosen = parser.parse_args()
    counted: list[tuple[str, bool]] = []
    for rate in chosen.rates:
        for tank in chosen.tanks:
            counted += report_tank(tank, rate, chosen.limits, chosen.only, names=not chosen.no_names)
    late = [words for words, soon in counted if not soon]
    say(not late, f"alarm within {SOON} strokes in {len(counted) - len(late)} of {len(counted)}")
    for words in late:
        print(f"      {words}")
    good = [report_healthy(chosen.healthy, rate) for rate in chosen.rates] if chosen.healthy else []
    return 0 if not late and all(good) else 1


if __name__ == "__main__":
    raise SystemExit(main())
