"""valve_node among neighbours that stop, stand still or run away."""

from __future__ import annotations

import contextlib
import itertools
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from nodes.ros import (
    LATCHED,
    Bool,
    Clock,
    Float64,
    JointState,
    Time,
    UInt8,
)

from .ros_process import Diagnostics, NodeProcess, Probe, running

pytestmark = [pytest.mark.ros, pytest.mark.long, pytest.mark.usefixtures("ros")]


MILLISECOND = 1_000_000
SECOND = 1_000_000_000
MOST_AT_ONCE = 500
"""Samples that are made up for at 1000 Hz: half a second of them."""
SUBSCRIBER = """
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState
rclpy.init()
node = Node("idler")
node.create_subscription(JointState, "/valve/joint_states", lambda message: print("heard", flush=True), 10)
rclpy.spin(node)
"""


@contextlib.contextmanager
def valve(folder: Path, *parameters: str) -> Iterator[NodeProcess]:
    """valve_node with these parameters, each name:=value."""
    words = [word for parameter in parameters for word in ("-p", parameter)]
    with running(folder, ["--ros-args", *words]) as process:
        yield process


class Ears:
    """What the valve says."""

    def __init__(self, probe: Probe) -> None:
        self.joints = probe.hear("joint_states", JointState)
        self.is_open = probe.hear("is_open", Bool, latched=True)
        self.phases = probe.hear("phase", UInt8, latched=True)
        self._diagnostics = Diagnostics(probe)
        self.said = self._diagnostics.all

    @property
    def stamps(self) -> list[int]:
        """Of the samples, ns."""
        return [message.header.stamp.sec * SECOND + message.header.stamp.nanosec for message in self.joints]

    def value(self, task: str, key: str) -> str:
        """The last value that diagnostics gave; empty before the first."""
        return str(self._diagnostics.values(task).get(key, ""))


def longest_streak(stamps: list[int]) -> int:
    """The most steps of a millisecond in a row."""
    steps = (after - before == MILLISECOND for before, after in itertools.pairwise(stamps))
    return max((len(list(run)) for is_one, run in itertools.groupby(steps) if is_one), default=0)


def test_a_process_that_was_stopped_makes_up_for_half_a_second_and_says_what_it_lost(
    probe: Probe, tmp_path: Path
) -> None:
    ears = Ears(probe)
    with valve(tmp_path, "command_timeout:=1.0") as process:
        command = probe.talker("coil_voltage", Float64)
        assert probe.until(lambda: command.get_subscription_count() and len(ears.joints) > 20)
        assert probe.insist(lambda: command.publish(Float64(data=9.0)), lambda: ears.is_open and ears.is_open[-1].data)
        process.process.send_signal(signal.SIGSTOP)
        probe.spin_for(5.0)
        before, lost = len(ears.joints), int(ears.value("timing", "lost steps") or 0)
        process.process.send_signal(signal.SIGCONT)
        assert probe.until(lambda: len(ears.joints) > before + 50)

        def leap() -> int:
            return max(later - earlier for earlier, later in itertools.pairwise(ears.stamps[before - 1 :]))

        # A sample that was lost before the stop is sent again after it, and those that had come since are heard then.
        assert probe.until(lambda: leap() > 4 * SECOND), "samples of five seconds came in a burst"
        stamps = ears.stamps
        first = next(at for at in range(before, len(stamps)) if stamps[at] - stamps[at - 1] > SECOND)
        assert len(stamps) - first <= MOST_AT_ONCE + (stamps[-1] - stamps[first]) // MILLISECOND
        assert probe.until(lambda: int(ears.value("timing", "lost steps") or 0) >= lost + 4000)
        assert any("samples were not published, for lack of time" in status.message for status in ears.said("timing"))
        assert probe.until(lambda: ears.value("command", "timed out") == "true"), "the command was older than 1 s"
        assert probe.until(lambda: not ears.is_open[-1].data)
        # For one second only: a test that is held up for longer hears of its closing alone.
        assert probe.insist(lambda: command.publish(Float64(data=9.0)), lambda: ears.is_open[-1].data)


def test_a_subscriber_that_stops_reading_holds_nobody_up(probe: Probe, tmp_path: Path) -> None:
    ears = Ears(probe)
    with valve(tmp_path) as process, subprocess.Popen([sys.executable, "-c", SUBSCRIBER], stdout=-1) as idler:
        try:
            assert idler.stdout is not None
            assert idler.stdout.readline() == b"heard\n"
            assert probe.until(lambda: ears.said("timing"))
            idler.send_signal(signal.SIGSTOP)
            # Twice as long as any history of ten samples, or a writer's patience with a reader, lasts.
            probe.spin_for(1.0)
            ears.joints.clear()
            # Other work on this machine makes it lose steps now and then; a reader that held it up would all the time.
            assert any(probe.spin_for(2.5) or longest_streak(ears.stamps) > 1500 for _ in range(40)), (
                "never 1500 in a row"
            )
            command = probe.talker("coil_voltage", Float64)
            assert probe.until(command.get_subscription_count)
            command.publish(Float64(data=9.0))
            assert probe.until(lambda: ears.is_open and ears.is_open[-1].data)
            assert process.process.poll() is None
        finally:
            idler.kill()


def test_a_clock_that_runs_away_or_stands_still_is_followed(probe: Probe, tmp_path: Path) -> None:
    ears = Ears(probe)
    with valve(tmp_path, "use_sim_time:=true"):
        clock, command = probe.talker("/clock", Clock), probe.talker("coil_voltage", Float64)
        assert probe.until(lambda: clock.get_subscription_count() and command.get_subscription_count())
        now = 100 * SECOND

        def tick(step: int) -> bool:
            nonlocal now
            now += step
            clock.publish(Clock(clock=Time(sec=now // SECOND, nanosec=now % SECOND)))
            probe.spin_for(0.01)
            return True

        assert probe.until(lambda: tick(10 * MILLISECOND) and ears.joints)
        command.publish(Float64(data=9.0))
        # A hundred times faster: a second each hundredth of a second.
        assert probe.until(lambda: tick(SECOND) and ears.is_open and ears.is_open[-1].data)
        assert probe.until(lambda: tick(SECOND) and int(ears.value("timing", "lost steps") or 0) > 1000)
        # Said again: a message on /clock may be lost, and nothing else would bring this time.
        assert probe.until(lambda: tick(0) and ears.stamps[-1] == now)
        # Still: nothing is published, and a command waits.
        probe.spin_for(0.1)
        count = len(ears.joints)
        command.publish(Float64(data=0.0))
        probe.spin_for(0.3)
        assert len(ears.joints) == count
        assert ears.is_open[-1].data
        assert probe.until(lambda: tick(10 * MILLISECOND) and not ears.is_open[-1].data)


def test_a_clock_before_1970_ends_nobody(probe: Probe, tmp_path: Path) -> None:
    ears = Ears(probe)
    with valve(tmp_path, "use_sim_time:=true") as process:
        clock = probe.talker("/clock", Clock)
        assert probe.until(clock.get_subscription_count)

        def tick(seconds: int) -> bool:
            clock.publish(Clock(clock=Time(sec=seconds)))
            probe.spin_for(0.01)
            return True

        assert probe.until(lambda: tick(-1) and "a message was left out that ROS cannot take" in process.output)
        later = iter(range(10, 10_000))
        assert probe.until(lambda: tick(next(later)) and ears.joints)
        assert "Traceback" not in process.output


def test_a_subscriber_of_another_quality_is_said_in_the_log(probe: Probe, tmp_path: Path) -> None:
    with valve(tmp_path) as process:
        probe.node.create_subscription(JointState, "/valve/joint_states", lambda message: None, LATCHED)
        assert probe.until(lambda: "incompatible QoS" in process.output)
        assert "'~/joint_states', requesting incompatible QoS" in process.output
