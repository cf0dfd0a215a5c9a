"""valve_node with a machine of a plant file, in a process of its own."""

from __future__ import annotations

from pathlib import Path

import pytest

from nodes.ros import BatteryState, Clock, Float64, JointState, Trigger, UInt8

from .ros_process import Diagnostics, beside
from .simulated_plant import MICROMETRE, PLANT, SECOND, simulated

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("ros")]

START = 100 * SECOND
TICK = 10_000_000
"""ns of /clock."""


def test_a_machine_of_a_plant_file_lives_on_topics_as_simulate_shows_it(tmp_path: Path) -> None:
    arguments = ["-p", f"plant:={PLANT}", "-p", "use_sim_time:=true"]
    with beside(tmp_path, "/rig/valve", arguments) as (probe, process):
        diagnostics = Diagnostics(probe)
        joints, coil = probe.hear("joint_states", JointState), probe.hear("coil", BatteryState)
        phases = probe.hear("phase", UInt8, latched=True)
        clock, command = probe.talker("/clock", Clock), probe.talker("coil_voltage", Float64)
        now = START

        def tell_time() -> None:
            message = Clock()
            message.clock.sec, message.clock.nanosec = divmod(now, SECOND)
            clock.publish(message)

        def stamp(message: JointState | BatteryState) -> int:
            return int(message.header.stamp.sec) * SECOND + int(message.header.stamp.nanosec) - START

        def has_followed() -> bool:
            return bool(joints) and stamp(joints[-1]) >= now - START

        def go_on(seconds: float) -> None:
            nonlocal now
            for _ in range(round(seconds * SECOND / TICK)):
                now += TICK
                assert probe.insist(tell_time, has_followed)

        assert probe.until(lambda: command.get_subscription_count() and clock.get_subscription_count())
        assert probe.insist(tell_time, lambda: phases)
        go_on(0.02)
        commands = [(0, 0.0)]
        for volts in (24.0, 0.0, 12.0, 0.0):
            command.publish(Float64(data=volts))
            # An answer says that what was sent before has come, while the clock stands.
            assert probe.parameters()["plant"] == str(PLANT)
            commands.append((now - START, volts))
            go_on(0.03)

        for message in coil:
            assert message.voltage == [volts for at, volts in commands if at < stamp(message) or at == 0][-1]
        assert {message.voltage for message in coil} == {0.0, 12.0, 24.0}
        looks = [stamp(message) for message in joints]
        assert looks == sorted(set(looks)) and len(looks) > 100
        expected = simulated(PLANT, tmp_path, commands, looks)
        assert [message.position[0] / MICROMETRE for message in joints] == expected
        assert max(expected) > 1000.0
        assert [message.data for message in phases][:3] == [0, 1, 2] and phases[-1].data == 0
        assert {tuple(message.name) for message in joints} == {("pilot_plunger",)}

        names = {name for name, _ in probe.node.get_topic_names_and_types()}
        assert not {"/rig/valve/is_open", "/rig/valve/coil_current", "/rig/valve/outlet_pressure"} & names
        (line,) = (line for line in process.output.splitlines() if "ready: " in line)
        assert "publishes /rig/valve/joint_states and /rig/valve/coil at 1000 Hz, /rig/valve/phase on change" in line
        test = probe.call("self_test", Trigger)
        assert not test.success and test.message.startswith("a self-test is of the valve")

        good, far, bad, spring = probe.set_parameters(
            parameters__stroke=0.9e-3,
            parameters__stop_rate=1.0,
            parameters__coil_time_constant=0.0,
            valve__spring_rate=500.0,
        )
        assert good.successful and not far.successful and not bad.successful and not spring.successful
        assert "parameters.stop_rate out of range" in far.reason
        assert "with these parameters" in bad.reason and "not finite" in bad.reason
        command.publish(Float64(data=24.0))
        assert probe.parameters()["parameters.stroke"] == 0.9e-3
        go_on(0.05)
        assert joints[-1].position[0] == pytest.approx(0.9e-3, abs=2e-5)
        assert probe.until(lambda: diagnostics.values("valve").get("phase") == "pressed")
