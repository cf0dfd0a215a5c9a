"""Do three valves and three monitors fit on two cores? `python -m benchmarks.nodes.station --seconds 60`.

Starts valve_node and monitor_node for each of three tanks as processes, at 500 Hz, as launch/station.launch.py does;
commands one stroke a second to each valve in turn, and prints by node what it takes of a core once the monitors are
commissioned, by valve the steps that it lost, by monitor the strokes that it reported. Wanted: no step lost, at most
120 % of a core in all. Wants a quiet machine with two cores.

`--gas` takes the tanks of hydrogen and the dispenser, as the launch file does with gas:=true. It commands the valves:
each makes one stroke for each vehicle, every fifteen seconds. In the middle a leak is put into one of them by
parameter. Wanted besides: vehicles are filled, and its monitor, and no other, names the leak within 10 strokes.

`--busy STROKES`: does a busy machine make the monitors cry wolf? Once commissioned, they get `--neighbours` busy
processes beside them and short strokes: healthy ones (wanted: no ERROR, at most two WARN in 1000), then stiction on the
second tank (wanted: its monitor warns within 40 strokes, and the others stay silent). A WARN is an alarm that a report
raised, an ERROR a report with a fault.

Exit code 1 where a figure falls short; needs ROS 2.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import FluidPressure
from std_msgs.msg import Float64, String

from benchmarks.nodes.driver import busy, processor_seconds, program, ros, running, say, values_of
from valve_sim.files.resources import config_path

TANKS: Final = ("tank_1", "tank_2", "tank_3")
COMMISSIONING: Final = 8
PARAMETERS: Final = {
    "valve": ("publish_rate:=500.0",),
    "monitor": ("measured:=joint_states", "noise_um:=1.0", f"commissioning_strokes:={COMMISSIONING}"),
}
FAULTY: Final = "tank_2"
LEAK: Final = 2e-9
"""m², 6 % of the pilot's orifice."""
LEAK_NAMED_WITHIN, ALARM_WITHIN = 10, 40
"""Strokes of the faulty valve."""
STICTION: Final = 0.5
"""N, as on the station's page."""
MOST_SHARE: Final = 120.0
"""% of a core, of all nodes."""
MOST_WARNINGS: Final = 2e-3
"""Of healthy strokes."""
PATIENCE: Final = 300.0
"""s for every node to be there, compiled; on a busy machine six of them compile for minutes."""
LONGEST: Final = 90.0
"""s for reports that are still to come, and for a parameter to be taken."""


class Rhythm(NamedTuple):
    """s from one stroke of a valve to its next, and for which it is held open."""

    period: float = 1.0
    is_open: float = 0.1


WITH_GAS: Final = Rhythm(15.0)
HURRIED: Final = Rhythm(0.2)


class Finding(NamedTuple):
    """What a monitor named, after how many strokes of its valve, and in which words."""

    strokes: int
    names: str
    words: str


class Hand:
    """Commands the valves, unless a dispenser does, and hears what the nodes say of themselves.

    Attributes:
        lost: steps lost so far, by tank. made: strokes of each valve. reports: of each monitor, as it sent them.
        findings: of each monitor. filled: vehicles.
    """

    def __init__(self, rhythm: Rhythm, *, has_dispenser: bool = False) -> None:
        self.rhythm, self.has_dispenser = rhythm, has_dispenser
        self.node = Node("station_benchmark")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.lost: dict[str, int] = {}
        self.arriving: set[str] = set()
        self.made = dict.fromkeys(TANKS, 0)
        self.reports: dict[str, list[dict[str, Any]]] = {tank: [] for tank in TANKS}
        self.findings: dict[str, list[Finding]] = {tank: [] for tank in TANKS}
        self.filled, self._vehicle_pressure = 0, math.nan
        self.voltages = {}
        hear = self.node.create_subscription
        hear(DiagnosticArray, "/diagnostics", self._hear_diagnostics, 100)
        hear(FluidPressure, "/dispenser/vehicle_pressure", self._hear_vehicle, 10)
        for tank in TANKS:
            hear(String, f"/{tank}/monitor/stroke_report", self._keeper(tank), 1000)
            hear(DiagnosticArray, f"/{tank}/monitor/finding", self._finder(tank), 1000)
            if has_dispenser:
                hear(Float64, f"/{tank}/valve/coil_voltage", self._counter(tank), 10)
            else:
                self.voltages[tank] = self.node.create_publisher(Float64, f"/{tank}/valve/coil_voltage", 10)

    def _counter(self, tank: str) -> Callable[[Any], None]:
        before = 0.0

        def count(message: Any) -> None:
            nonlocal before
            self.made[tank] += before == 0.0 and message.data != 0.0
            before = message.data

        return count

    def _hear_vehicle(self, message: Any) -> None:
        # Another, empty one has come: the last was full, or no tank gave any more.
        self.filled += message.fluid_pressure < 0.5 * self._vehicle_pressure
        self._vehicle_pressure = message.fluid_pressure

    def _keeper(self, tank: str) -> Callable[[Any], None]:
        return lambda message: self.reports[tank].append(json.loads(message.data))

    def _finder(self, tank: str) -> Callable[[Any], None]:
        def note(message: Any) -> None:
            (found,) = message.status
            names = values_of(found)["effects"].replace(", ", "+")
            self.findings[tank].append(Finding(self.made[tank], names, found.message))

        return note

    def _hear_diagnostics(self, message: Any) -> None:
        for status in message.status:
            name, _, task = status.name.partition(": ")
            tank = name.partition("/")[0]
            if task == "timing":
                self.lost[tank] = int(values_of(status)["lost steps"])
            elif task == "input" and int(values_of(status)["samples"]) > 0:
                self.arriving.add(tank)

    def until(self, is_so: Callable[[], bool], patience: float) -> bool:
        """Whether something came to be so within so many seconds."""
        end = time.monotonic() + patience
        while not is_so():
            if time.monotonic() > end:
                return False
            self.spin_for(0.5)
        return True

    def spin_for(self, seconds: float) -> None:
        """Hear what comes."""
        end = time.monotonic() + seconds
        while (remaining := end - time.monotonic()) > 0.0:
            self.executor.spin_once(timeout_sec=remaining)

    def set(self, tank: str, name: str, value: float) -> bool:
        """Set a parameter while the valve runs; whether it took it."""
        client = self.node.create_client(SetParameters, f"/{tank}/valve/set_parameters")
        if not client.wait_for_service(LONGEST):
            return False
        parameter = Parameter(name, value=value).to_parameter_msg()
        future = client.call_async(SetParameters.Request(parameters=[parameter]))
        return self.until(future.done, LONGEST) and all(one.successful for one in future.result().results)

    def strokes(self, seconds: float) -> None:
        """Strokes of each valve in turn for so long; with a dispenser it makes them."""
        if self.has_dispenser:
            self.spin_for(seconds)
            return
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for tank, voltage in self.voltages.items():
                self.made[tank] += 1
                voltage.publish(Float64(data=9.0))
                self.spin_for(self.rhythm.is_open)
                voltage.publish(Float64(data=0.0))
                self.spin_for(self.rhythm.period / len(TANKS) - self.rhythm.is_open)

    def strokes_together(self, count: int) -> None:
        """So many of each valve, one valve shortly after the other, and their reports as far as they come."""
        before, apart = self.reported(), 0.1 * self.rhythm.is_open
        for _ in range(count):
            for volts in (9.0, 0.0):
                for voltage in self.voltages.values():
                    voltage.publish(Float64(data=volts))
                    self.spin_for(apart)
                self.spin_for(0.5 * self.rhythm.period - apart * len(TANKS))
        self.until(lambda: all(self.reported()[tank] >= before[tank] + count for tank in TANKS), LONGEST)

    def reported(self) -> dict[str, int]:
        """Strokes so far, by tank."""
        return {tank: len(own) for tank, own in self.reports.items()}


@contextlib.contextmanager
def station(*, gas: bool = False) -> Iterator[dict[str, int]]:
    """Process ids by node, while inside."""
    commands = {
        f"{tank}/{name}": program(
            f"{name}_node", *parameters, namespace=tank, file=config_path(f"gas_{tank}.yaml") if gas else None
        )
        for tank in TANKS
        for name, parameters in PARAMETERS.items()
    }
    if gas:
        commands["dispenser"] = program("dispenser_node", package="station", file=config_path("gas_dispenser.yaml"))
    with running(commands) as processes:
        yield {name: process.pid for name, process in processes.items()}


# --- on a quiet machine -----------------------------------------------------------------------------------------------


def fits(hand: Hand, pids: Mapping[str, int], seconds: float, leak: float) -> bool:
    """Commission, let the station work for so long, after half of it with a leak, m²; whether all is as wanted."""
    hand.strokes((COMMISSIONING + 4) * hand.rhythm.period)
    lost, reported = dict(hand.lost), hand.reported()
    used, start = {name: processor_seconds(pid) for name, pid in pids.items()}, time.monotonic()
    if leak:
        hand.strokes(0.5 * seconds)
    since = dict(hand.made)
    if leak:
        hand.set(FAULTY, "effects.seat_leak.area", leak)
        seconds *= 0.5
    hand.strokes(seconds)
    elapsed = time.monotonic() - start
    shares = {name: 100.0 * (processor_seconds(pid) - used[name]) / elapsed for name, pid in pids.items()}
    hand.spin_for(1.5)  # until the last second's diagnostics are here
    for name, share in shares.items():
        print(f"      {name:16s}{share:6.1f} % of a core")
    counts = {tank: count - reported[tank] for tank, count in hand.reported().items()}
    steps = {tank: hand.lost[tank] - lost[tank] for tank in TANKS}
    total = sum(shares.values())
    good = [
        say(not any(steps.values()), f"{sum(steps.values())} steps lost (0): {steps}"),
        say(total <= MOST_SHARE, f"{total:.0f} % of a core in all (at most {MOST_SHARE:g} %)"),
        say(all(counts.values()), f"every monitor reported strokes: {counts}"),
    ]
    if leak:
        good += [say(hand.filled > 0, f"{hand.filled} vehicles filled"), *_leak_is_named(hand, since)]
    return all(good)


def _leak_is_named(hand: Hand, since: Mapping[str, int]) -> list[bool]:
    """Whether the leak was named in time, and by its own monitor alone."""
    for tank, found in hand.findings.items():
        for one in found:
            print(
                f"      {tank}, {one.strokes - since[tank]} strokes after the leak: {one.names or 'none'}: {one.words}"
            )
    named = [one.strokes - since[FAULTY] for one in hand.findings[FAULTY] if one.names == "seat_leak"]
    others = [tank for tank, found in hand.findings.items() if found and tank != FAULTY]
    after = named[0] if named else math.inf
    return [
        say(after <= LEAK_NAMED_WITHIN, f"the leak is named after {after} strokes (at most {LEAK_NAMED_WITHIN})"),
        say(not others, f"other monitors that found something (none): {others}"),
    ]


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
    new = {tank: hand.reports[tank][before[tank] :] for tank in TANKS}
    raised = {tank: [report["alarm"]["raised"] for report in own] for tank, own in new.items()}
    tally = Tally(
        {tank: len(own) for tank, own in new.items()},
        {tank: sum(own) for tank, own in raised.items()},
        {tank: sum(report["fault"] is not None for report in own) for tank, own in new.items()},
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
        last = [own[-1]["state"] for own in hand.reports.values() if own]
        if len(last) == len(TANKS) and not {"commissioning", "not judged"} & set(last):
            return True
    return False


def stands(hand: Hand, strokes: int, neighbours: int) -> bool:
    """Healthy strokes, then stiction, beside busy processes; whether all is as wanted."""
    if not commission(hand):
        return say(False, "the monitors did not come to watch")
    with busy(neighbours):
        healthy = phase(hand, -(-strokes // len(TANKS)), "healthy")
        if not hand.set(FAULTY, "effects.stiction.force", STICTION):
            return say(False, f"{FAULTY} did not take the parameter")
        sticking = phase(hand, ALARM_WITHIN, f"{STICTION} N of stiction")
        hand.until(lambda: bool(hand.findings[FAULTY]), LONGEST)
    for found in hand.findings[FAULTY]:
        print(f"      {FAULTY}: {found.words}")
    count, warnings, faults = (sum(own.values()) for own in (healthy.reports, healthy.alarms, healthy.faults))
    most, first = max(1.0, MOST_WARNINGS * count), sticking.first[FAULTY]
    silent = not any(sticking.alarms[tank] + sticking.faults[tank] for tank in TANKS if tank != FAULTY)
    return all([
        say(not faults, f"{faults} ERROR in {count} healthy strokes (0)"),
        say(warnings <= most, f"{warnings} WARN in {count} healthy strokes (at most {most:g})"),
        say(first is not None, f"{FAULTY}: first alarm after {first} strokes (at most {ALARM_WITHIN})"),
        say(silent, "the other tanks are silent"),
    ])  # fmt: skip


def main() -> int:
    """Run and print; 1 if anything falls short."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="how long to command strokes (default: 60)")
    parser.add_argument("--gas", action="store_true", help="with tanks of hydrogen, and a leak in the middle")
    parser.add_argument("--leak", type=float, default=LEAK, help=f"its area, m² (default: {LEAK:g})")
    parser.add_argument("--busy", type=int, metavar="STROKES", help="healthy strokes, of all tanks, on a busy machine")
    parser.add_argument("--neighbours", type=int, default=8, help="busy processes (default: 8)")
    options = parser.parse_args()
    rhythm = HURRIED if options.busy else WITH_GAS if options.gas else Rhythm()
    with ros(), station(gas=options.gas) as pids:
        hand = Hand(rhythm, has_dispenser=options.gas)
        if not hand.until(lambda: len(hand.lost) == len(hand.arriving) == len(TANKS), PATIENCE):
            return int(not say(False, f"not every node came to run within {PATIENCE:g} s"))
        if options.busy:
            return int(not stands(hand, options.busy, options.neighbours))
        return int(not fits(hand, pids, options.seconds, options.leak if options.gas else 0.0))


if __name__ == "__main__":
    raise SystemExit(main())
