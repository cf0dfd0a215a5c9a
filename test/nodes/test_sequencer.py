"""docs/examples/sequencer.py before real valves: all goes well, one sticks, one is missing, a signal comes."""

from __future__ import annotations

import contextlib
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import pytest

from nodes.ros import Bool, Float64, rclpy

from .ros_process import ENDS_WITHIN, PATIENCE, Diagnostics, Probe, piped, running

pytestmark = pytest.mark.ros


SEQUENCER = Path(__file__).parents[2] / "docs" / "examples" / "sequencer.py"
TANKS = ("tank_1", "tank_2", "tank_3")


class Tank:
    """A valve of the station, as the test sees it."""

    def __init__(self, name: str) -> None:
        self.probe = Probe(f"/{name}/valve")
        self.is_open = self.probe.hear("is_open", Bool, latched=True)
        self._diagnostics = Diagnostics(self.probe)

    def openings(self) -> int:
        return sum(message.data for message in self.is_open)

    def is_without_voltage(self) -> bool:
        """What it says from now on."""
        now = self.probe.node.get_clock().now().nanoseconds
        assert self.probe.until(lambda: self._diagnostics.all("command", now)), "no diagnostics"
        return self._diagnostics.values("command")["voltage (V)"] == "0"


@pytest.fixture(scope="module")
def station(in_own_domain: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[list[Tank]]:
    """Three valves that run."""
    folder = tmp_path_factory.mktemp("station")
    rclpy.init()
    with contextlib.ExitStack() as stack:
        for name in TANKS:
            arguments = ["--ros-args", "-r", f"__ns:=/{name}", "-p", "publish_rate:=100.0"]
            stack.enter_context(running(folder, arguments))
        tanks = [Tank(name) for name in TANKS]
        for tank in tanks:
            assert tank.probe.until(lambda tank=tank: tank.is_open)
        yield tanks
        for tank in tanks:
            tank.probe.close()
    rclpy.try_shutdown()


def until_said(stream: IO[str], words: str) -> Iterator[str]:
    """The lines of a stream, to the first one with these words."""
    for line in stream:
        yield line
        if words in line:
            return
    raise AssertionError(f"never said: {words}")


def sequencing(folder: Path, **parameters: object) -> contextlib.AbstractContextManager[subprocess.Popen[str]]:
    """The sequencer while inside."""
    return piped(folder, (str(SEQUENCER),), **parameters)


def run(folder: Path, **parameters: object) -> tuple[int, str]:
    """Exit code and stderr of a whole sequence."""
    with sequencing(folder, **parameters) as process:
        _, words = process.communicate(timeout=ENDS_WITHIN)
        return process.returncode, words


def refusal(folder: Path, limit: str, trouble: str, healthy: str, **parameters: object) -> str:
    """Which valve is blamed for the end of a sequence; whoever is healthy gets a longer limit if 3 s were too short."""
    for seconds in (3, 20):
        code, words = run(folder, **{limit: float(seconds)}, **parameters)
        assert code == 1
        begin, end = f"sequencer: after {seconds} s {trouble}: ", "; all valves are commanded closed"
        (line,) = (line for line in words.splitlines() if line.startswith(begin) and line.endswith(end))
        blamed = line.removeprefix(begin).removesuffix(end)
        if healthy not in blamed:
            break
    return blamed


def test_each_valve_is_opened_in_its_turn_and_closed_again(station: list[Tank], tmp_path: Path) -> None:
    before = [tank.openings() for tank in station]
    code, words = run(tmp_path, cycles=2, timeout=PATIENCE)
    assert code == 0, words
    order = [line.split()[-3] for line in words.splitlines() if line.endswith("is open")]
    assert order == 2 * [tank.probe.target for tank in station]
    for tank, count in zip(station, before, strict=True):
        assert tank.probe.until(
            lambda tank=tank, count=count: tank.openings() == count + 2 and not tank.is_open[-1].data
        )
        assert tank.is_without_voltage()


@pytest.mark.long
def test_a_valve_that_sticks_closes_all_and_is_named(station: list[Tank], tmp_path: Path) -> None:
    first, stuck, last = station
    before = [tank.openings() for tank in station]
    assert stuck.probe.set_parameters(valve__seat_load=1000.0)[0].successful
    try:
        blamed = refusal(tmp_path, "timeout", "not open", "/tank_1/valve")
    finally:
        assert stuck.probe.set_parameters(valve__seat_load=0.0)[0].successful
    assert blamed == "/tank_2/valve"
    assert first.probe.until(lambda: first.openings() > before[0])
    assert all(tank.is_without_voltage() for tank in station)
    assert [tank.openings() for tank in (stuck, last)] == before[1:], "it went on, or the valve did open"


@pytest.mark.long
def test_a_valve_that_does_not_stay_open_closes_all_and_is_named(station: list[Tank], tmp_path: Path) -> None:
    with sequencing(tmp_path, hold=1000.0, timeout=PATIENCE) as process:
        last = station[-1]
        assert process.stderr is not None
        # The sequencer must have seen it open before it closes again.
        said = list(until_said(process.stderr, "tank_3/valve is open"))
        assert last.probe.set_parameters(max_voltage=1.0)[0].successful
        _, words = process.communicate(timeout=ENDS_WITHIN)
        words = "".join(said) + words
    assert last.probe.set_parameters(max_voltage=30.0)[0].successful
    assert process.returncode == 1
    assert "sequencer: closed by itself: /tank_3/valve; all valves are commanded closed" in words.splitlines()
    assert all(tank.is_without_voltage() for tank in station)


@pytest.mark.long
def test_a_valve_that_is_missing_is_named_before_any_is_opened(station: list[Tank], tmp_path: Path) -> None:
    commands = station[0].probe.hear("coil_voltage", Float64)
    before = [tank.openings() for tank in station]
    blamed = refusal(tmp_path, "patience", "not there", "/tank_1/valve", namespaces="[tank_1, tank_4]")
    assert blamed == "/tank_4/valve"
    assert [tank.openings() for tank in station] == before
    assert station[0].is_without_voltage()
    assert {message.data for message in commands} <= {0.0}, "nothing is commanded but 0 V in the end"


def test_a_signal_closes_all_and_is_named(station: list[Tank], tmp_path: Path) -> None:
    with sequencing(tmp_path, hold=1000.0, timeout=PATIENCE) as process:
        assert process.stderr is not None
        said = list(until_said(process.stderr, "tank_3/valve is open"))
        process.send_signal(signal.SIGTERM)
        _, words = process.communicate(timeout=ENDS_WITHIN)
    assert process.returncode == 1
    assert "sequencer: interrupted; all valves are commanded closed" in ("".join(said) + words).splitlines()
    assert all(tank.is_without_voltage() for tank in station)
