"""Does a busy machine make the monitors cry wolf? `python -m benchmarks.busy_station --strokes 1000 --runs 5`.

Starts valve_node and monitor_node for each of three tanks as processes, commissions them, puts busy processes beside
them at the same priority, and commands short strokes:

- healthy ones. Wanted: no ERROR, and at most two WARN in 1000 strokes, from all monitors together;
- then stiction on the second tank. Wanted: its monitor warns within 40 strokes, and the others stay silent. Each run
  begins with new processes.

Messages are counted by stroke: a WARN is an alarm that a report raised, an ERROR a report with a fault. Exit code 1
where that falls short; needs ROS 2.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from typing import Any, NamedTuple

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from std_msgs.msg import Float64, String

from benchmarks.station import TANKS, Hand, running_station

FAULTY = "tank_2"
FORCE = 0.5
"""N of stiction, as on the station's page."""
OPEN_SECONDS, CLOSED_SECONDS = 0.1, 0.1
COMMISSIONING_STROKES = 12
"""At least; eight good ones are asked for."""
WITHIN = 40
"""Strokes of the faulty tank."""
MOST_WARNINGS = 2e-3
"""Of healthy strokes."""
COMPILING = 300.0
"""s for all nodes to be there, on a machine that compiles for all of them at once."""
LONGEST = 90.0
"""s for reports that are still to come."""
ISOLATION_SECONDS = 120.0
"""s for the cause, which needs seconds of a processor and has a tenth of one here; no figure hangs on it."""


class Tally(NamedTuple):
    """Of one phase, by tank: strokes reported, alarms, faults, states; after how many strokes the first alarm came."""

    reports: dict[str, int]
    alarms: dict[str, int]
    faults: dict[str, int]
    states: dict[str, Counter[str]]
    first_alarm: dict[str, int | None]


class Listener:
    """What the monitors report of each stroke, and say of its cause."""

    def __init__(self, hand: Hand) -> None:
        self.reports: dict[str, list[dict[str, Any]]] = {tank: [] for tank in TANKS}
        self.findings: dict[str, list[Any]] = {tank: [] for tank in TANKS}
        for tank in TANKS:
            reports, findings = self.reports[tank], self.findings[tank]
            hand.node.create_subscription(String, f"/{tank}/monitor/stroke_report", _appender(reports), 1000)
            hand.node.create_subscription(DiagnosticArray, f"/{tank}/monitor/finding", findings.append, 1000)

    def count(self, tank: str) -> int:
        """Strokes reported so far."""
        return len(self.reports[tank])

    def tally(self, since: dict[str, int]) -> Tally:
        """What was reported since so many reports."""
        new = {tank: self.reports[tank][since[tank] :] for tank in TANKS}
        alarmed = {tank: [report["alarm"]["raised"] for report in new[tank]] for tank in TANKS}
        return Tally(
            {tank: len(new[tank]) for tank in TANKS},
            {tank: sum(alarmed[tank]) for tank in TANKS},
            {tank: sum(report["fault"] is not None for report in new[tank]) for tank in TANKS},
            {tank: Counter(report["state"] for report in new[tank]) for tank in TANKS},
            {tank: alarmed[tank].index(True) + 1 if any(alarmed[tank]) else None for tank in TANKS},
        )


def _appender(found: list[dict[str, Any]]) -> Any:
    return lambda message: found.append(json.loads(message.data))


@contextlib.contextmanager
def busy(count: int) -> Iterator[None]:
    """So many processes that do nothing but compute, while inside."""
    processes = [subprocess.Popen([sys.executable, "-S", "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


class Station:
    """Three tanks, their monitors, and a hand on the valves."""

    def __init__(self) -> None:
        self.hand = Hand()
        self.listener = Listener(self.hand)

    def strokes(self, count: int) -> None:
        """So many of each valve, one valve shortly after the other."""
        apart = CLOSED_SECONDS / 10.0
        for _ in range(count):
            for voltage in self.hand.voltages:
                voltage.publish(Float64(data=9.0))
                self.hand.spin_for(apart)
            self.hand.spin_for(OPEN_SECONDS - apart * len(TANKS))
            for voltage in self.hand.voltages:
                voltage.publish(Float64(data=0.0))
                self.hand.spin_for(apart)
            self.hand.spin_for(CLOSED_SECONDS - apart * len(TANKS))

    def settle(self, since: dict[str, int], count: int) -> None:
        """Wait for the reports of so many strokes."""
        end = time.monotonic() + LONGEST
        while time.monotonic() < end and any(self.listener.count(tank) < since[tank] + count for tank in TANKS):
            self.hand.spin_for(0.5)

    def reported(self) -> dict[str, int]:
        """Strokes so far, by tank."""
        return {tank: self.listener.count(tank) for tank in TANKS}

    def commission(self) -> bool:
        """Stroke until every monitor watches; whether they do."""
        for _ in range(20):
            before = self.reported()
            self.strokes(COMMISSIONING_STROKES)
            self.settle(before, COMMISSIONING_STROKES)
            last = [self.listener.reports[tank][-1]["state"] for tank in TANKS if self.listener.reports[tank]]
            if len(last) == len(TANKS) and not {"commissioning", "not judged"} & set(last):
                return True
        return False

    def phase(self, count: int) -> Tally:
        """So many strokes of each valve, and what was said of them."""
        before = self.reported()
        self.strokes(count)
        self.settle(before, count)
        return self.listener.tally(before)

    def finding(self, tank: str) -> str:
        """What the monitor finds to be the cause, waited for; empty if it comes to none."""
        start = time.monotonic()
        while time.monotonic() < start + ISOLATION_SECONDS and not self.listener.findings[tank]:
            self.hand.spin_for(0.5)
        waited = f"{time.monotonic() - start:.0f} s after the last stroke"
        return f"{waited}: {self.listener.findings[tank][-1].status[0].message}" if self.listener.findings[tank] else ""

    def seize(self, tank: str, force: float) -> bool:
        """Put stiction on a valve; whether it took it."""
        client = self.hand.node.create_client(SetParameters, f"/{tank}/valve/set_parameters")
        if not client.wait_for_service(LONGEST):
            return False
        parameter = Parameter("effects.stiction.force", value=force)
        future = client.call_async(SetParameters.Request(parameters=[parameter.to_parameter_msg()]))
        end = time.monotonic() + LONGEST
        while time.monotonic() < end and not future.done():
            self.hand.spin_for(0.1)
        return future.done() and all(result.successful for result in future.result().results)


def show(words: str, tally: Tally) -> None:
    """One line for each tank."""
    print(f"      {words}")
    for tank in TANKS:
        states = ", ".join(f"{state} {count}" for state, count in tally.states[tank].items())
        print(
            f"      {tank}  {tally.reports[tank]:5d} strokes  {tally.alarms[tank]:3d} WARN  "
            f"{tally.faults[tank]:3d} ERROR  first alarm after {tally.first_alarm[tank]}  ({states})",
            flush=True,
        )


def say(is_good: bool, words: str) -> bool:
    """A line that says whether a figure is as wanted."""
    print(f"{'ok   ' if is_good else 'SHORT'} {words}", flush=True)
    return is_good


def run(strokes: int, faulty: int, neighbours: int) -> bool:
    """One station: healthy strokes, then a fault; whether all is as wanted."""
    with running_station():
        station = Station()
        try:
            if not station.hand.wait_for_all(COMPILING) or not station.commission():
                return say(False, "the station did not come to watch")
            with busy(neighbours):
                healthy = station.phase(-(-strokes // len(TANKS)))
                show(f"healthy, {neighbours} busy processes, load {os.getloadavg()[0]:.0f}", healthy)
                if not station.seize(FAULTY, FORCE):
                    return say(False, f"{FAULTY} did not take the parameter")
                sticking = station.phase(faulty)
                show(f"{FORCE} N of stiction on {FAULTY}", sticking)
                print(f"      {FAULTY}: {station.finding(FAULTY) or 'no cause found'}", flush=True)
        finally:
            station.hand.node.destroy_node()
    return _verdict(healthy, sticking)


def _verdict(healthy: Tally, sticking: Tally) -> bool:
    count, warnings = sum(healthy.reports.values()), sum(healthy.alarms.values())
    others = [tank for tank in TANKS if tank != FAULTY]
    first = sticking.first_alarm[FAULTY]
    silent = not any(sticking.alarms[tank] + sticking.faults[tank] for tank in others)
    most = max(1.0, MOST_WARNINGS * count)
    return all([
        say(not any(healthy.faults.values()), f"{sum(healthy.faults.values())} ERROR in {count} healthy strokes (0)"),
        say(warnings <= most, f"{warnings} WARN in {count} healthy strokes (at most {most:g})"),
        say(first is not None and first <= WITHIN, f"{FAULTY}: first alarm after {first} strokes (at most {WITHIN})"),
        say(silent, "the other tanks are silent"),
    ])  # fmt: skip


def main() -> int:
    """Run and print; 1 if anything falls short."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--strokes", type=int, default=1000, help="healthy strokes of a run, all tanks together")
    parser.add_argument("--faulty", type=int, default=WITHIN, help=f"strokes with the fault (default {WITHIN})")
    parser.add_argument("--neighbours", type=int, default=8, help="busy processes (default 8)")
    parser.add_argument("--runs", type=int, default=1)
    chosen = parser.parse_args()
    rclpy.init()
    try:
        good = []
        for number in range(chosen.runs):
            print(f"      run {number + 1} of {chosen.runs}", flush=True)
            good.append(run(chosen.strokes, chosen.faulty, chosen.neighbours))
        return 0 if say(all(good), f"{sum(good)} of {len(good)} runs") else 1
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    raise SystemExit(main())
