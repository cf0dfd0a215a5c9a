"""valve_node as a user meets it: real processes, topics, services, parameters, signals."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from installed_effect import MAGNET_DRAG, Installed

from nodes.ros import (
    BatteryState,
    Bool,
    Clock,
    Float64,
    JointState,
    Time,
    Trigger,
    UInt8,
    parameter_dict_from_yaml_file,
    serialize_message,
)
from valve_sim.files.parameter_files import load_valve
from valve_sim.files.resources import config_path
from valve_sim.model import published_times, simulate
from valve_sim.recordings import BagRecorder, events_from_sensors, read_trace

from .dumps import TOLERATED, dump, plain_values
from .ros_process import Diagnostics, NodeProcess, Probe, beside, running

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("ros")]


SECOND = 1_000_000_000
PERIOD = 1_000_000
"""ns between samples."""
TICK = 25_000_000
"""ns of /clock at 40 Hz."""
THROTTLE = 5.0
"""s between lines of the log about the same trouble."""


@pytest.fixture(scope="module")
def valve(ros: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[NodeProcess]:
    """One node for all tests that leave it as it was."""
    with running(tmp_path_factory.mktemp("valve")) as process:
        yield process


@pytest.fixture
def rested(valve: NodeProcess, probe: Probe) -> Probe:
    """The shared node, ready, closed and without a command."""
    assert probe.until(lambda: "ready: " in valve.output)
    assert probe.call("reset", Trigger).success
    phases = probe.hear("phase", UInt8, latched=True)
    assert probe.until(lambda: phases and phases[-1].data == 0), "it is not closed"
    return probe


def connected(probe: Probe, publisher: Any) -> Any:
    assert probe.until(lambda: publisher.get_subscription_count() > 0), "nobody listens"
    return publisher


def commander(probe: Probe) -> Any:
    return connected(probe, probe.talker("coil_voltage", Float64))


def nanoseconds(message: JointState | BatteryState) -> int:
    return int(message.header.stamp.sec) * SECOND + int(message.header.stamp.nanosec)


def are_a_period_apart(joints: list[Any]) -> bool:
    """Whether samples are; a process that is held up leaves some out, which makes one longer step of whole periods."""
    steps = [nanoseconds(after) - nanoseconds(before) for before, after in itertools.pairwise(joints)]
    return min(steps) == PERIOD and not any(step % PERIOD for step in steps) and steps.count(PERIOD) > 0.9 * len(steps)


def test_a_valve_says_its_names_and_opens_and_closes_on_topics(valve: NodeProcess, rested: Probe) -> None:
    (line,) = (line for line in valve.output.splitlines() if "ready: " in line)
    assert "/valve/coil_voltage (V, ±30 at most)" in line and "/valve/phase and /valve/is_open on change" in line
    joints, current = rested.hear("joint_states", JointState), rested.hear("coil_current", Float64)
    phases, is_open = rested.hear("phase", UInt8, latched=True), rested.hear("is_open", Bool, latched=True)
    command = commander(rested)
    assert rested.until(lambda: joints and current and is_open and phases and phases[-1].data == 0)
    command.publish(Float64(data=9.0))
    assert rested.until(lambda: phases[-1].data == 4 and is_open[-1].data and len(joints) > 300)
    assert [message.data for message in phases[-3:]] == [1, 3, 4]
    assert rested.until(lambda: current[-1].data > 0.899)
    assert joints[-1].name == ["pilot_plunger", "main_plunger"]
    assert list(joints[-1].position) == pytest.approx([1.23e-3, 0.97e-3])
    assert joints[-1].effort[0] > 15.0
    assert joints[-1].effort[1] == pytest.approx(-(2.524 + 428.0 * 1.23e-3))
    assert are_a_period_apart(joints)
    command.publish(Float64(data=0.0))
    assert rested.until(lambda: not is_open[-1].data)
    assert rested.until(lambda: list(joints[-1].position)[1] == 0.0)
    answer = rested.call("self_test", Trigger)
    assert answer.success and "stop reached after 9.900 ms" in answer.message


def test_a_recording_with_the_coil_dates_a_command_that_was_recorded_late(rested: Probe, tmp_path: Path) -> None:
    joints, coil = rested.hear("joint_states", JointState), rested.hear("coil", BatteryState)
    command = commander(rested)
    assert rested.until(lambda: len(joints) > 20 and len(coil) > 20)
    # As on a busy machine, on which the recorder comes to write the command down milliseconds later.
    late = time.time_ns() + 7_000_000
    command.publish(Float64(data=9.0))
    assert rested.until(lambda: coil[-1].current > 0.899 and joints[-1].position[0] >= 1.23e-3)
    command.publish(Float64(data=0.0))
    with BagRecorder(tmp_path / "late.mcap") as recorder:
        recorder.write("/valve/coil_voltage", "std_msgs/msg/Float64", serialize_message(Float64(data=9.0)), late)
        for topic, kind, heard in (("joint_states", "JointState", joints), ("coil", "BatteryState", coil)):
            for message in heard:
                stamp = nanoseconds(message)
                recorder.write(f"/valve/{topic}", f"sensor_msgs/msg/{kind}", serialize_message(message), stamp)
    found = read_trace(tmp_path / "late.mcap")
    assert found.drive_errors is not None and found.drive_errors.times.tolist() == [0.0]
    response = simulate(load_valve(config_path("valve.yaml")), found.input(0.0), found.times)
    # t1 is when 260 µm are passed at 0.1 m/s: 0.1 µm are a microsecond of it.
    assert np.max(np.abs(response.pilot_position - found.pilot_position)) < 0.1e-6
    assert published_times(response)[0] - found.drive.times[0] == pytest.approx(5.3e-3, abs=2e-6)
    (opening, *_) = events_from_sensors(found, 260e-6)
    seen = opening.events[0]
    assert seen.after_command == pytest.approx(5.3e-3, abs=2.0 * seen.stderr), "and not 7 ms later"
    assert seen.stderr < 0.5e-3


def test_bad_commands_are_ignored_counted_and_reported(valve: NodeProcess, rested: Probe) -> None:
    heard, phases = Diagnostics(rested), rested.hear("phase", UInt8, latched=True)
    command = commander(rested)
    assert rested.until(lambda: heard.values("command"))
    before = int(heard.values("command")["rejected"])
    command.publish(Float64(data=9.0))
    assert rested.until(lambda: phases and phases[-1].data == 4)
    begin = time.monotonic()
    for volts in (math.nan, math.inf, -1000.0):
        command.publish(Float64(data=volts))
    assert rested.until(lambda: int(heard.values("command")["rejected"]) == before + 3)
    took = time.monotonic() - begin
    assert heard.values("command")["voltage (V)"] == "9"
    assert phases[-1].data == 4
    lines = [line for line in valve.output.splitlines() if "/valve/coil_voltage: " in line and "is ignored" in line]
    assert 1 <= len(lines) <= 1 + took / THROTTLE, "one line for what comes at once"
    assert "expected a number within ±30 V (parameter max_voltage)" in lines[0]
    command.publish(Float64(data=100.0))
    assert rested.until(lambda: int(heard.values("command")["rejected"]) == before + 4)
    seen = len(heard.heard)
    assert rested.until(lambda: len(heard.heard) >= seen + 2)
    assert heard.values("command")["level"] == 1, "a warning as long as no good command has come"
    command.publish(Float64(data=9.0))
    assert rested.until(lambda: heard.values("command")["level"] == 0)


def test_diagnostics_come_each_second_and_say_all(rested: Probe) -> None:
    heard = Diagnostics(rested)

    def was_a_good_second() -> bool:
        """Whether two came a second apart, and the machine had time for its samples meanwhile."""
        stamps = [message.header.stamp.sec + message.header.stamp.nanosec * 1e-9 for message in heard.heard[-2:]]
        rate = heard.values("timing").get("rate reached (Hz)", "none")
        return len(stamps) > 1 and rate != "none" and float(rate) > 900.0 and abs(stamps[1] - stamps[0] - 1.0) < 0.5

    assert rested.until(was_a_good_second)
    names = [status.name for status in heard.heard[-1].status]
    assert names == ["valve: timing", "valve: command", "valve: valve"]
    assert {status.hardware_id for status in heard.heard[-1].status} == {"valve"}
    assert heard.values("timing")["rate wanted (Hz)"] == "1000"
    assert heard.values("valve")["phase"] == "closed"


def test_parameters_are_validated_and_applied_without_a_jump(rested: Probe) -> None:
    joints = rested.hear("joint_states", JointState)
    commander(rested).publish(Float64(data=9.0))
    assert rested.until(lambda: len(joints) > 20 and {message.position[0] for message in joints[-20:]} == {1.23e-3})
    settled = len(joints)
    good = rested.set_parameters(valve__spring_rate=500, effects__stiction__force=0.3, publish_rate=500)
    assert [result.successful for result in good] == [True] * 3
    assert rested.parameters()["valve.spring_rate"] == 500.0
    assert rested.until(lambda: joints[-1].effort[1] == pytest.approx(-(2.524 + 500.0 * 1.23e-3)))
    assert {message.position[0] for message in joints[settled:]} == {1.23e-3}
    assert rested.until(lambda: nanoseconds(joints[-1]) - nanoseconds(joints[-2]) == 2_000_000)
    bad = rested.set_parameters(
        valve__pilot_mass=0, valve__pilot_gap=2e-3, valve__spring_rate="stiff", valve__attraction_polynomial=[1.0, 2.0]
    )
    assert [result.successful for result in bad] == [False] * 4
    assert "valve.pilot_mass: found 0.0, expected a number above 0 to 5 kg" in bad[0].reason
    assert "expected 0 < pilot_gap < stroke" in bad[1].reason
    assert "expected four numbers" in bad[3].reason
    assert rested.parameters()["valve.pilot_gap"] == 0.26e-3
    (long,) = rested.set_parameters(frame_id="x" * 5_000_000)
    assert not long.successful and long.reason.endswith("found 5000000 characters, expected at most 4096")
    back = rested.set_parameters(valve__spring_rate=428.0, effects__stiction__force=0.0, publish_rate=1000.0)
    assert [result.successful for result in back] == [True] * 3


def test_a_coil_without_commands_is_de_energised(valve: NodeProcess, rested: Probe) -> None:
    is_open, heard = rested.hear("is_open", Bool, latched=True), Diagnostics(rested)
    assert rested.set_parameters(command_timeout=0.2)[0].successful
    command = commander(rested)
    # Open for 0.2 s only: a test that is held up for longer hears of its closing alone.
    assert rested.insist(lambda: command.publish(Float64(data=9.0)), lambda: is_open and is_open[-1].data)
    assert rested.until(lambda: not is_open[-1].data)
    assert rested.until(lambda: heard.values("command").get("timed out") == "true")
    assert "the coil was switched off: no command for 0.2 s (command_timeout), 9 V held" in valve.output
    assert rested.set_parameters(command_timeout=0.0)[0].successful


def test_a_limit_below_what_holds_switches_the_coil_off_and_says_so(valve: NodeProcess, rested: Probe) -> None:
    is_open, heard = rested.hear("is_open", Bool, latched=True), Diagnostics(rested)
    command = commander(rested)
    assert rested.insist(lambda: command.publish(Float64(data=12.0)), lambda: is_open and is_open[-1].data)
    assert rested.set_parameters(max_voltage=10.0)[0].successful
    assert rested.until(lambda: not is_open[-1].data)
    assert "set: max_voltage 30.0 → 10.0" in valve.output
    assert rested.until(
        lambda: "the coil was switched off: max_voltage was set to 10 V, below the 12 V that held" in valve.output
    )
    assert rested.until(lambda: heard.values("command").get("level") == 1)
    assert rested.set_parameters(max_voltage=30.0)[0].successful
    command.publish(Float64(data=9.0))
    assert rested.until(lambda: heard.values("command")["level"] == 0)


def test_is_open_is_said_when_it_changes_and_not_at_each_phase(rested: Probe) -> None:
    phases, is_open = rested.hear("phase", UInt8, latched=True), rested.hear("is_open", Bool, latched=True)
    command = commander(rested)
    assert rested.until(lambda: phases and is_open)
    for volts, phase in ((9.0, 4), (0.0, 0)) * 2:
        command.publish(Float64(data=volts))
        assert rested.until(lambda phase=phase: phases[-1].data == phase)
    assert rested.until(lambda: len(is_open) >= 5)
    assert [message.data for message in is_open] == [False, True, False, True, False]
    assert len(phases) > 8


def test_dumped_parameters_can_be_loaded_again(rested: Probe, tmp_path: Path) -> None:
    changes = {
        "valve__main_damping": 3.5, "effects__magnetic_saturation__current": 2.0, "frame_id": "tank",
        "tolerances__stroke": 2.5e-6,
    }  # fmt: skip
    own = rested.parameters()
    assert own["effects.magnetic_saturation.current"] == math.inf
    path = dump(own, tmp_path / "own.yaml", "/valve")
    assert all(result.successful for result in rested.set_parameters(**changes))
    changed = rested.parameters()
    loaded = parameter_dict_from_yaml_file(str(path), target_nodes=["/valve"])
    # As `ros2 param load` does: it sends 1e-06 and inf as texts.
    results = {name: rested.set_messages([message])[0] for name, message in loaded.items()}
    refused = {name for name, result in results.items() if not result.successful}
    assert refused <= {"start_type_description_service", "plant"}, "one is ROS's own, both are read at the start"
    assert plain_values(rested.parameters()) == plain_values(own)
    path = dump(changed, tmp_path / "changed.yaml", "/tank_2/valve")
    with beside(tmp_path, "/tank_2/valve", ["--params-file", str(path)]) as (tank, _):
        joints, heard = tank.hear("joint_states", JointState), Diagnostics(tank)
        assert plain_values(tank.parameters()) == plain_values(changed)
        assert tank.until(lambda: joints and heard.all("timing"))
        assert joints[-1].header.frame_id == "tank"


def test_tolerances_are_taken_checked_and_dumped(tmp_path: Path) -> None:
    path = tmp_path / "tolerances.yaml"
    path.write_text(TOLERATED)
    declared = load_valve(path)
    with beside(tmp_path, "/known", ["--params-file", str(path)]) as (known, _):
        assert load_valve(dump(known.parameters(), tmp_path / "dump.yaml", "/known")) == declared
        refused = {
            "tolerances__stroke": -1e-6,
            "tolerances__attraction_covariance": [1.0, 2.0],
            "tolerances__effects__stiction__force": 0.1,
        }
        for name, value in refused.items():
            (result,) = known.set_parameters(**{name: value})
            assert not result.successful, name
            assert name.replace("__", ".") in result.reason
        changes: dict[str, Any] = {"tolerances__stroke": 0.0, "tolerances__pilot_gap": 2e-6}
        assert all(result.successful for result in known.set_parameters(**changes))
        assert known.set_parameters(effects__coulomb_friction__force=0.0)[0].successful
        left = load_valve(dump(known.parameters(), tmp_path / "later.yaml", "/known"))
    assert left.effects == {}
    assert left.tolerances == replace(
        declared.tolerances, declared={"spring_rate": 12.8, "pilot_gap": 2e-6}, effects={}
    )


@pytest.mark.any_distribution
def test_an_installed_effect_is_set_on_the_running_node(tmp_path: Path) -> None:
    site = Installed(tmp_path / "site", MAGNET_DRAG)
    with beside(tmp_path, "/plugged", PYTHONPATH=site.environment["PYTHONPATH"]) as (plugged, _):
        assert plugged.set_parameters(effects__magnet_drag__force=0.4)[0].successful
        assert plugged.parameters()["effects.magnet_drag.force"] == 0.4
        assert not plugged.set_parameters(effects__magnet_drag__force=-1.0)[0].successful
        joints = plugged.hear("joint_states", JointState)
        assert plugged.until(lambda: joints)


def test_simulated_time_is_followed_by_slow_ticks_without_a_warning_and_may_jump_back(tmp_path: Path) -> None:
    with beside(tmp_path, "/simulated", ["-p", "use_sim_time:=true"]) as (simulated, process):
        joints, is_open = simulated.hear("joint_states", JointState), simulated.hear("is_open", Bool, latched=True)
        heard, clock = Diagnostics(simulated), connected(simulated, simulated.talker("/clock", Clock))
        assert simulated.until(lambda: heard.is_said("timing", 1, "waiting for /clock") and "ready: " in process.output)
        assert joints == []
        now = 0

        def tick() -> None:
            clock.publish(Clock(clock=Time(sec=now // SECOND, nanosec=now % SECOND)))

        def has_caught_up() -> bool:
            return bool(joints) and 0 <= now - nanoseconds(joints[-1]) <= PERIOD

        def tick_until(first: int, condition: Callable[[], Any]) -> None:
            """Ticks of 25 ms, each when the valve has caught up with the one before, however often that is said."""
            nonlocal now
            now = first
            while not condition():
                assert simulated.insist(tick, has_caught_up)
                simulated.spin_for(0.02)
                now += TICK

        def timings() -> list[str]:
            return [status.message for status in heard.all("timing") if "waiting" not in status.message]

        tick_until(SECOND, lambda: now > SECOND + 80 * TICK and len(timings()) >= 4)
        assert nanoseconds(joints[0]) >= SECOND
        assert not [message for message in timings() if "too busy" in message]
        assert "too busy" not in process.output
        commander(simulated).publish(Float64(data=9.0))
        tick_until(now, lambda: is_open and is_open[-1].data)
        steps = [nanoseconds(after) - nanoseconds(before) for before, after in itertools.pairwise(joints)]
        assert set(steps) == {PERIOD}
        tick_until(PERIOD, lambda: not is_open[-1].data and nanoseconds(joints[-1]) < SECOND)
        assert list(joints[-1].position) == [0.0, 0.0]
        assert "the clock jumped back" in process.output
