"""The nodes and launch files of docs/examples that docs/how_to/integrate.md and station.md include or start."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from nodes.ros import Float64, JointState, QoSProfile, Range, ReliabilityPolicy, Time

from .launch_plan import ExecuteProcess, IncludeLaunchDescription, Node, read_launch_file
from .ros_process import Diagnostics, Probe, ended, piped, running

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "docs" / "examples"
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)


@pytest.mark.ros
@pytest.mark.any_distribution
def test_a_monitor_hears_the_driver_by_a_remap_and_names_the_topic(probe: Probe, tmp_path: Path) -> None:
    heard, laser = list[JointState](), probe.talker("/lab/laser", Range, BEST_EFFORT)
    probe.node.create_subscription(JointState, "/lab/stroke", heard.append, BEST_EFFORT)
    reading = Range(range=11.5e-3)
    remap = ["--ros-args", "-r", "valve/measured/joint_states:=/lab/stroke"]
    said = Diagnostics(probe, "monitor")

    def is_heard() -> bool:
        reading.header.stamp = probe.node.get_clock().now().to_msg()
        laser.publish(reading)
        return said.is_said("input", 1, "waiting for a command on /valve/coil_voltage")

    with (
        piped(tmp_path, [str(EXAMPLES / "sensor_driver.py")], ["-r", "measured:=/lab/stroke"]) as driver,
        running(tmp_path, remap, "monitor_node") as monitor,
    ):
        assert probe.until(is_heard)
        assert list(heard[0].position) == pytest.approx([1e-3])
        assert heard[-1].header.stamp != Time()
        assert "hears /valve/coil_voltage and /lab/stroke, " in monitor.output
        ended(driver, signal.SIGINT)


@pytest.mark.ros
@pytest.mark.any_distribution
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_commander_opens_and_closes_and_ends_with_0_volts(probe: Probe, tmp_path: Path, number: int) -> None:
    heard = probe.hear("/tank_1/valve/coil_voltage", Float64)
    remap = ["-r", "coil_voltage:=/tank_1/valve/coil_voltage"]
    with piped(tmp_path, [str(EXAMPLES / "commander.py")], remap) as process:
        assert probe.until(lambda: [message.data for message in heard[-2:]] == [0.0, 9.0])
        process.send_signal(number)
        assert probe.until(lambda: process.poll() is not None)
        assert probe.until(lambda: heard[-1].data == 0.0)
        assert process.returncode == 0


@pytest.mark.parametrize("name", ["integrated.launch.py", "dispenser.launch.py"])
def test_a_launch_file_that_includes_ours_gives_arguments_that_there_are(name: str) -> None:
    plan = read_launch_file(EXAMPLES / name)
    for entry in plan.entries:
        if isinstance(entry, IncludeLaunchDescription):
            package, *place = entry.source
            assert package == "valve_sim"
            assert dict(entry.launch_arguments).keys() <= read_launch_file(ROOT.joinpath(*place)).arguments.keys()
        elif isinstance(entry, ExecuteProcess):
            assert Path(entry.cmd[1]).parent == EXAMPLES
            assert Path(entry.cmd[1]).is_file()
    remapped = {old for node in plan.entries if isinstance(node, Node) for old, _ in node.remappings}
    assert remapped == ({"valve/measured/joint_states"} if name.startswith("integrated") else set())
