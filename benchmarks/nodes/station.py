"""Do three valves and three monitors fit on two cores? `python -m benchmarks.nodes.station --seconds 60`.

Starts valve_node and monitor_node for each of three tanks as processes, at 500 Hz, as launch/station.launch.py does;
commands one stroke a second to each valve in turn, and prints by node what it takes of a core once the monitors are
commissioned, by valve the steps that it lost, by monitor the strokes that it reported. Wanted: no step lost, at most
120 % of a core in all. Wants a quiet machine with two cores.

`--busy STROKES`: does a busy machine make the monitors cry wolf? Once commissioned, they get short healthy strokes
beside busy processes, whose number changes from none to `--neighbours` and back (wanted: no WARN, no ERROR). Then the
second tank's valve gets 0.3 N of friction at `--faults` moments, each after a new commissioning (wanted: its monitor
warns within 40 strokes, its first finding names friction or nothing, and the others stay silent). A WARN is an alarm
that a report raised, an ERROR a report with a fault.

Exit code 1 where a figure falls short; needs ROS 2.
"""

from __future__ import annotations

import contextlib
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from nodes.ros_process import Probe, cpu_seconds, report_of
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from benchmarks.common import parser, say
from benchmarks.nodes.driver import busy, program, ros, running, values_of

TANKS: Final = ("tank_1", "tank_2", "tank_3")
COMMISSIONING: Final = 8
PARAMETERS: Final = {
    "valve": ("publish_rate:=500.0",),
    "monitor": ("measured:=joint_states", "noise_um:=1.0", f"commissioning_strokes:={COMMISSIONING}"),
}
FAULTY: Final = "tank_2"
ALARM_WITHIN: Final = 40
"""Strokes of the faulty valve."""
FRICTION: Final = 0.3
"""N."""
ITS_NAMES: Final = frozenset({"coulomb_friction", "stiction", "asymmetric_friction"})
"""Effects that friction may be called."""
LOADS: Final = (0.0, 1.0, 0.3, 1.0, 0.0)
"""Shares of the busy processes, one after the other."""
MOST_SHARE: Final = 120.0
"""% of a core, of all nodes."""
PATIENCE: Final = 300.0
"""s for every node to be there, compiled; on a busy machine six of them compile for minutes."""
LONGEST: Final = 90.0
"""s for reports that are still to come, and for a parameter to be taken."""


class Rhythm(NamedTuple):
    """s from one stroke of a valve to its next, and for which it is held open."""

    period: float = 1.0
    is_open: float = 0.1


HURRIED: Final = Rhythm(0.2)


class Finding(NamedTuple):
    """What a monitor named, and in which words."""

    names: str
    words: str


class Hand:
    """Commands the valves, and hears what the nodes say of themselves.

    Attributes:
        probe: hears; its parameters are those of the faulty tank's valve. reports: of each monitor, as it sent them.
        findings: of each monitor.
    """

    def __init__(self, rhythm: Rhythm) -> None:
        self.rhythm = rhythm
        self.probe = Probe(f"/{FAULTY}/valve")
        hear = self.probe.hear
        self._diagnostics = hear("/diagnostics", DiagnosticArray)
        self.reports = {tank: hear(f"/{tank}/monitor/stroke_report", DiagnosticArray) for tank in TANKS}
        self.findings: dict[str, list[Finding]] = {tank: [] for tank in TANKS}
        self._voltages = {}
        self._recommission = [self.probe.node.create_client(Trigger, f"/{tank}/monitor/recommission") for tank in TANKS]
        for tank in TANKS:
            self.probe.node.create_subscription(DiagnosticArray, f"/{tank}/monitor/finding", self._finder(tank), 1000)
            self._voltages[tank] = self.probe.talker(f"/{tank}/valve/coil_voltage", Float64)

    def _finder(self, tank: str) -> Callable[[Any], None]:
        def note(message: Any) -> None:
            (found,) = message.status
            names = values_of(found)["effects"].replace(", ", "+")
            self.findings[tank].append(Finding(names, found.message))

        return note

    def lost(self) -> dict[str, int]:
        """Steps lost so far, by tank; of the tanks whose valve has said so."""
        return {tank: int(values_of(status)["lost steps"]) for tank, status in self._last("timing").items()}

    def is_there(self) -> bool:
        """Whether every valve steps, and every monitor gets samples."""
        inputs = [int(values_of(status)["samples"]) for status in self._last("input").values()]
        return len(self.lost()) == len([count for count in inputs if count > 0]) == len(TANKS)

    def _last(self, task: str) -> dict[str, Any]:
        """The last status of a task of each tank's nodes."""
        statuses = [status for message in self._diagnostics for status in message.status]
        return {status.name.partition("/")[0]: status for status in statuses if status.name.partition(": ")[2] == task}

    def set(self, name: str, value: float) -> bool:
        """Set a parameter of the faulty valve while it runs; whether it took it."""
        return all(one.successful for one in self.probe.set_parameters(**{name.replace(".", "__"): value}))

    def recommission(self) -> None:
        """Let every monitor take the next strokes as its baseline."""
        self.probe.answers(self._recommission, Trigger.Request())

    def strokes(self, seconds: float) -> None:
        """Strokes of each valve in turn for so long."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for voltage in self._voltages.values():
                voltage.publish(Float64(data=9.0))
                self.probe.spin_for(self.rhythm.is_open)
                voltage.publish(Float64(data=0.0))
                self.probe.spin_for(self.rhythm.period / len(TANKS) - self.rhythm.is_open)

    def strokes_together(self, count: int) -> None:
        """So many of each valve, one valve shortly after the other, and their reports as far as they come."""
        before, apart = self.reported(), 0.1 * self.rhythm.is_open
        for _ in range(count):
            for volts in (9.0, 0.0):
                for voltage in self._voltages.values():
                    voltage.publish(Float64(data=volts))
                    self.probe.spin_for(apart)
                self.probe.spin_for(0.5 * self.rhythm.period - apart * len(TANKS))
        self.probe.until(lambda: all(self.reported()[tank] >= before[tank] + count for tank in TANKS), LONGEST)

    def reported(self) -> dict[str, int]:
        """Strokes so far, by tank."""
        return {tank: len(own) for tank, own in self.reports.items()}

    def reports_since(self, before: Mapping[str, int]) -> dict[str, list[dict[str, Any]]]:
        """Reports of each monitor after so many."""
        return {tank: [report_of(one) for one in own[before[tank] :]] for tank, own in self.reports.items()}


@contextlib.contextmanager
def station() -> Iterator[dict[str, int]]:
    """Process ids by node, while inside."""
    commands = {
        f"{tank}/{name}": program(f"{name}_node", *parameters, namespace=tank)
        for tank in TANKS
        for name, parameters in PARAMETERS.items()
    }
    with running(commands) as processes:
        yield {name: process.pid for name, process in processes.items()}


# --- on a quiet machine -----------------------------------------------------------------------------------------------


def fits(hand: Hand, pids: Mapping[str, int], seconds: float) -> bool:
    """Commission, and let the station work for so long; whether all is as wanted."""
    hand.strokes((COMMISSIONING + 4) * hand.rhythm.period)
    lost, reported = hand.lost(), hand.reported()
    used, start = {name: cpu_seconds(pid) for name, pid in pids.items()}, time.monotonic()
    hand.strokes(seconds)
    elapsed = time.monotonic() - start
    shares = {name: 100.0 * (cpu_seconds(pid) - used[name]) / elapsed for name, pid in pids.items()}
    hand.probe.spin_for(1.5)  # until the last second's diagnostics are here
    for name, share in shares.items():
        print(f"      {name:16s}{share:6.1f} % of a core")
    counts = {tank: count - reported[tank] for tank, count in hand.reported().items()}
    steps = {tank: count - lost[tank] for tank, count in hand.lost().items()}
    total = sum(shares.values())
    good = [
        say(not any(steps.values()), f"{sum(steps.values())} steps lost (0): {steps}"),
        say(total <= MOST_SHARE, f"{total:.0f} % of a core in all (at most {MOST_SHARE:g} %)"),
        say(all(counts.values()), f"every monitor reported strokes: {counts}"),
    ]
    return all(good)


# --- on a busy machine ------------------------------------------------------------------------------------------------


class Tally(NamedTuple):
    """Of one phase, by tank: strokes reported, alarms, faults, and after how many strokes the first alarm came."""

    reports: dict[str, int]
    alarms: dict[str, int]
    faults: dict[str, int]
    first: dict[str, int | None]


def phase(hand: Hand, count: int, words: str) -> Tally:
    """So many strokes of each valve, and what was said of them."""
    before = hand.reported()
    hand.strokes_together(count)
    new = hand.reports_since(before)
    raised = {tank: [report["alarm.raised"] for report in own] for tank, own in new.items()}
    tally = Tally(
        {tank: len(own) for tank, own in new.items()},
        {tank: sum(own) for tank, own in raised.items()},
        {tank: sum("fault" in report for report in own) for tank, own in new.items()},
        {tank: own.index(True) + 1 if any(own) else None for tank, own in raised.items()},
    )
    for tank in TANKS:
        states = dict(Counter(report["state"] for report in new[tank]))
        print(
            f"      {words}: {tank}  {tally.reports[tank]:5d} strokes  {tally.alarms[tank]:3d} WARN  "
            f"{tally.faults[tank]:3d} ERROR  first alarm after {tally.first[tank]}  ({states})",
            flush=True,
        )
    return tally


def commission(hand: Hand) -> bool:
    """Stroke until every monitor watches; whether they do."""
    for _ in range(20):
        hand.strokes_together(COMMISSIONING + 4)
        last = [report_of(own[-1])["state"] for own in hand.reports.values() if own]
        if len(last) == len(TANKS) and not {"commissioning", "not judged"} & set(last):
            return True
    return False


def stands(hand: Hand, strokes: int, neighbours: int, faults: int) -> bool:
    """Healthy strokes while the load changes, then friction at so many moments; whether all is as wanted."""
    if not commission(hand):
        return say(False, "the monitors did not come to watch")
    tallies, each = [], -(-strokes // (len(TANKS) * len(LOADS)))
    for share in LOADS:
        count = round(share * neighbours)
        with busy(count):
            tallies.append(phase(hand, each, f"healthy beside {count:2d}"))
    count, warnings, errors = (
        sum(sum(own.values()) for own in kind)
        for kind in zip(*((one.reports, one.alarms, one.faults) for one in tallies), strict=True)
    )
    good = [
        say(not errors, f"{errors} ERROR in {count} healthy strokes (0)"),
        say(not warnings, f"{warnings} WARN in {count} healthy strokes (0)"),
    ]
    with busy(neighbours):
        good += [sticks(hand, moment) for moment in range(faults)]
    return all(good)


def sticks(hand: Hand, moment: int) -> bool:
    """Friction on one valve after a new commissioning; whether it is seen in time, and called by its name or none."""
    hand.set("effects.coulomb_friction.force", 0.0)
    hand.recommission()
    if not commission(hand):
        return say(False, f"moment {moment}: the monitors did not come to watch")
    healthy = phase(hand, 5 + 3 * moment, f"moment {moment}, healthy")
    before = {tank: len(found) for tank, found in hand.findings.items()}
    if not hand.set("effects.coulomb_friction.force", FRICTION):
        return say(False, f"{FAULTY} did not take the parameter")
    sticking = phase(hand, ALARM_WITHIN, f"moment {moment}, {FRICTION} N")
    hand.probe.until(lambda: len(hand.findings[FAULTY]) > before[FAULTY], LONGEST)
    new = hand.findings[FAULTY][before[FAULTY] :]
    for found in new:
        print(f"      {FAULTY}: {found.names or 'none'}: {found.words}", flush=True)
    first = sticking.first[FAULTY]
    others = [tank for tank in TANKS if tank != FAULTY and sticking.alarms[tank] + sticking.faults[tank]]
    wrong = [tank for tank in TANKS if healthy.alarms[tank] + healthy.faults[tank]]
    return all([
        say(first is not None, f"moment {moment}: first alarm after {first} strokes (at most {ALARM_WITHIN})"),
        say(not new or not new[0].names or set(new[0].names.split("+")) <= ITS_NAMES,
            f"moment {moment}: the first finding names friction or nothing: {new[0].names if new else 'no finding'}"),
        say(not others and not wrong, f"moment {moment}: all else is silent"),
    ])  # fmt: skip


def main() -> int:
    """Run and print; 1 if anything falls short."""
    known = parser("nodes.station", __doc__)
    known.add_argument("--seconds", type=float, default=60.0, help="how long to command strokes (default: 60)")
    known.add_argument("--busy", type=int, metavar="STROKES", help="healthy strokes, of all tanks, on a busy machine")
    known.add_argument("--neighbours", type=int, default=10, help="busy processes (default: 10)")
    known.add_argument("--faults", type=int, default=10, help="moments at which friction comes (default: 10)")
    options = known.parse_args()
    with ros(), station() as pids:
        hand = Hand(HURRIED if options.busy else Rhythm())
        if not hand.probe.until(hand.is_there, PATIENCE):
            return int(not say(False, f"not every node came to run within {PATIENCE:g} s"))
        if options.busy:
            return int(not stands(hand, options.busy, options.neighbours, options.faults))
        return int(not fits(hand, pids, options.seconds))


if __name__ == "__main__":
    raise SystemExit(main())
