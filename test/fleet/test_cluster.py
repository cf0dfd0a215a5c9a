"""A scheduler and workers as processes, started by the commands of docs/how_to/fleet.md, and what is done to them."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import pyarrow.parquet as pq
import pytest
from distributed import Client, LocalCluster

from valve_sim.fleet.cluster import BATCH_SECONDS, MOST_IN_BATCH, BatchSize, Cluster, ClusterError, Done, run_batches
from valve_sim.fleet.run import examine_fleet

from . import deeds
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


def answers(done: Iterator[Done[int, float]]) -> dict[int, float | str]:
    found: dict[int, float | str] = {}
    for batch in done:
        for item, answer in zip(batch.items, batch.answers or [batch.failure] * len(batch.items), strict=True):
            assert item not in found
            found[item] = answer
    return found


def no_time(answer: float) -> float:
    return 0.0


def test_batches_are_as_long_as_they_are_to_take_and_shorter_towards_the_end() -> None:
    size = BatchSize()
    assert size.next(1000, 2) == 1
    size.learn(4.0, 1)
    assert size.next(1000, 2) == 1
    for _ in range(100):
        size.learn(0.1, 1)
    assert size.next(1000, 2) == pytest.approx(BATCH_SECONDS / 0.1, abs=1)
    assert size.next(20, 2) == 5
    for _ in range(100):
        size.learn(0.0, 10)
    assert size.next(10**6, 2) == MOST_IN_BATCH


def test_what_fails_is_found_alone_and_all_else_is_done() -> None:
    cluster = LocalCluster(n_workers=2, threads_per_worker=1, processes=False, dashboard_address=":0")
    with cluster, Client(cluster, set_as_default=False) as client:
        found = answers(run_batches(lambda: client, deeds.twice_but_for_seven, range(600), no_time))
    assert found.pop(7) == "the process that worked on it ended: RuntimeError: seven"
    assert found == {item: 2.0 * item for item in range(600) if item != 7}


def test_a_scheduler_that_is_gone_when_it_is_asked_for_its_workers_is_one_clear_line(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cluster = LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0")
    with cluster, Client(cluster, set_as_default=False) as client:
        known = [client.nthreads()]

        def asked() -> dict[str, int]:
            if not known:
                raise OSError("Timed out trying to connect to tcp://127.0.0.1:1 after 30 s")
            return known.pop()

        monkeypatch.setattr(client, "nthreads", asked)
        with pytest.raises(ClusterError, match=r"the scheduler was lost \(Timed out"):
            answers(run_batches(lambda: client, deeds.twice, range(600), no_time))


def test_a_process_may_have_one_cluster_after_another() -> None:
    """In a process of its own, to which Dask is new: its defaults must outlive the settings of the first cluster."""
    program = (
        "from valve_sim.fleet.cluster import Cluster\n"
        "Cluster._started = lambda self: __import__('distributed')\n"
        "with Cluster() as first: first.client()\n"
        "import dask; print(dask.config.get('distributed.comm.require-encryption'))"
    )
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (ran.stdout.strip(), ran.returncode) == ("None", 0), ran.stderr


def test_rows_are_the_same_from_one_process_and_from_a_scheduler_by_tcp(machines: Machines, tmp_path: Path) -> None:
    for day in range(3):
        make_bag(tmp_path / "bags" / f"day_{day}", day, seed=1 + day)
    (tmp_path / "bags" / "empty.mcap").write_bytes(b"")
    examine_fleet([str(tmp_path / "bags")], tmp_path / "here")
    with Cluster(machines.address) as cluster:
        examine_fleet([str(tmp_path / "bags")], tmp_path / "there", cluster.client())
    assert_rows_agree(tmp_path / "here", tmp_path / "there", {"seconds"})
    assert pq.read_metadata(tmp_path / "here" / "fleet.parquet").num_rows == 4


def test_a_worker_that_is_killed_costs_nothing_but_what_it_was_doing(machines: Machines, tmp_path: Path) -> None:
    marker = tmp_path / "killed"
    with Cluster(machines.address) as cluster:
        found = answers(
            run_batches(cluster.client, partial(deeds.twice_after_a_death, marker=marker), range(20), no_time)
        )
    assert marker.exists()
    assert found == {item: 2.0 * item for item in range(20)}


def test_a_scheduler_that_is_killed_is_one_clear_line(
    machines: Machines, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    work = partial(deeds.kill_it, process=machines.scheduler.pid)
    with Cluster(machines.address) as cluster, pytest.raises(ClusterError, match="scheduler was lost") as refused:
        answers(run_batches(cluster.client, work, range(5), no_time))
    assert "\n" not in str(refused.value)
    assert "Traceback" not in capfd.readouterr().err
    monkeypatch.setattr("valve_sim.fleet.cluster.CONNECTS_WITHIN", 1.0)  # s: nobody is there to be waited for
    with Cluster(machines.address) as cluster, pytest.raises(ClusterError, match="no Dask scheduler answers"):
        cluster.client()
