"""A scheduler and a worker as processes, started by the commands of docs/how_to/fleet.md, and what is done to them."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple, NoReturn

import psutil
import pytest

from valve_sim.fleet import run as fleet_run
from valve_sim.fleet.run import RETRIES, dask_client, examine_fleet
from valve_sim.fleet.units import Options, Unit
from valve_sim.fleet.work import examine
from valve_sim.model.errors import ValveError

from .bags import assert_rows_agree, make_bag

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[2]
GUIDE = (ROOT / "docs" / "how_to" / "fleet.md").read_text("utf-8")


class Machines(NamedTuple):
    """A cluster by hand: its address, and its scheduler's process."""

    address: str
    scheduler: subprocess.Popen[str]


@pytest.fixture(scope="module")
def machines(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machines]:
    """`dask scheduler` and one `dask worker`, on free ports of this machine."""
    folder = tmp_path_factory.mktemp("machines")
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "test"), "DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "60s"}
    dask = [sys.executable, "-m", "dask"]
    typed = [line.strip().split() for line in GUIDE.splitlines() if line.startswith("    dask ")]
    assert [words[1] for words in typed] == ["scheduler", "worker"]

    def start(words: list[str], log: str) -> subprocess.Popen[str]:
        with (folder / log).open("w") as output:
            return subprocess.Popen(
                [*dask, *words], cwd=folder, env=environment, stdout=output, stderr=output, text=True,
                start_new_session=True,
            )  # fmt: skip

    scheduler = start([*_local(typed[0][1:]), "--no-dashboard"], "scheduler.log")
    worker = None
    try:
        address = _address(folder / "scheduler.log", scheduler)
        words = [address if word.startswith("tcp://") else word for word in typed[1][1:]]
        worker = start([*words, "--no-dashboard"], "worker.log")
        yield Machines(address, scheduler)
    finally:
        for process in filter(None, (worker, scheduler)):
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def _local(words: list[str]) -> list[str]:
    """A scheduler's command with a free port of this machine alone."""
    return ["127.0.0.1" if word == "10.0.0.1" else "0" if word == "8786" else word for word in words]


def _address(log: Path, scheduler: subprocess.Popen[str]) -> str:
    """What the scheduler says that its address is, as soon as it does."""
    while True:
        found = re.search(r"tcp://127\.0\.0\.1:\d+", log.read_text("utf-8"))
        if found:
            return found[0]
        assert scheduler.poll() is None, log.read_text("utf-8")


def twice(item: int, marker: Path, scheduler: int) -> int:
    """Twice the item; 3 kills its process the first time, 7 fails, and 9 kills the scheduler."""
    if item == 3 and not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    if item == 7:
        with marker.open("a") as stream:
            stream.write("x")
        raise OSError("seven")
    if item == 9:
        os.kill(scheduler, signal.SIGKILL)
    return 2 * item


def test_rows_are_the_same_from_one_process_and_from_a_scheduler_by_tcp(machines: Machines, tmp_path: Path) -> None:
    for day in range(3):
        make_bag(tmp_path / "bags" / f"day_{day}", day, seed=1 + day)
    (tmp_path / "bags" / "empty.mcap").write_bytes(b"")
    options = Options(search=False)
    examine_fleet([str(tmp_path / "bags")], tmp_path / "here", options=options)
    with dask_client(machines.address, None) as client:
        outcome = examine_fleet([str(tmp_path / "bags")], tmp_path / "there", client, options=options)
    assert_rows_agree(tmp_path / "here", tmp_path / "there", {"seconds"})
    assert len(outcome.rows) == 4


def test_killed_workers_failures_and_a_killed_scheduler(
    machines: Machines, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    work = partial(twice, marker=tmp_path / "marker", scheduler=machines.scheduler.pid)
    with dask_client(machines.address, None) as client:
        answers = dict(fleet_run._done(client, work, range(9)))
    assert str(answers.pop(7)) == "seven"
    assert answers == {item: 2 * item for item in range(9) if item != 7}
    assert (tmp_path / "marker").read_text() == "x" * (1 + RETRIES)
    with (
        dask_client(machines.address, None) as client,
        pytest.raises(ValveError, match="was lost") as refused,
    ):
        list(fleet_run._done(client, work, [1, 9, 2]))
    assert "\n" not in str(refused.value)
    monkeypatch.setattr(fleet_run, "ANSWERS_WITHIN", 1.0)  # s: nobody is there to be waited for
    with dask_client(machines.address, None) as client, pytest.raises(ValveError, match="no Dask scheduler answers"):
        client()
    assert "Traceback" not in capfd.readouterr().err


BUSY: Final = """
from fleet.test_cluster import examined_for_ever
from valve_sim.__main__ import main
from valve_sim.fleet import run

run.examine = examined_for_ever
main()
"""
"""valve-sim whose fleet is never done."""


def examined_for_ever(unit: Unit, output: Path) -> NoReturn:
    """The work of a valve, over and over, so that it is not over before Ctrl-C."""
    while True:
        (output / f"{os.getpid()}.busy").touch()
        examine(unit, output)


@pytest.mark.parametrize("when", ["workers start", "valves are examined"])
def test_ctrl_c_ends_the_command_and_its_workers_with_one_line(tmp_path: Path, when: str) -> None:
    for day in range(2):
        make_bag(tmp_path / "bags" / f"day_{day}", day, seed=1 + day)
    output = tmp_path / "out"
    words = ["fleet", str(tmp_path / "bags"), "--output", str(output), "--full", "--workers", "2"]
    process = subprocess.Popen(
        [sys.executable, "-c", BUSY, *words],
        env={**os.environ, "PYTHONPATH": str(ROOT / "test")}, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip
    while not (_started(process.pid) if when == "workers start" else len([*output.glob("*.busy")]) == 2):
        assert process.poll() is None, process.communicate()
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does, to workers, too
    try:
        told = process.communicate(timeout=120.0)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
    deadline = time.monotonic() + 20.0
    while _is_alive(process.pid) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert process.returncode == 130
    lines = [line for line in told[1].splitlines() if line and " done: " not in line]
    assert (told[0], lines) == ("", ["valve-sim: stopped"])
    assert not _is_alive(process.pid)


def _started(command: int) -> bool:
    """Whether a worker of this process has begun to start."""
    with contextlib.suppress(psutil.Error):
        return any("spawn_main" in " ".join(process.cmdline()) for process in psutil.Process(command).children())
    return False


def _is_alive(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True
