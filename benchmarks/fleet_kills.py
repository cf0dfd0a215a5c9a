"""What a fleet loses when a process of it is killed: `python -m benchmarks.fleet_kills --kills 20`.

A scheduler, a worker and a client are processes of their own. One of them is killed (SIGKILL) in the middle of a run,
at a moment that the seed chooses, the three in turn; the same command is run again where it ended. Units are 30 ms of
nothing that leave a line in a log. Wanted each time: a row for every bag, each once; nothing done again of which a row
had been written; the command ends with one clear line where its scheduler was lost.

--interrupts: Ctrl-C, to the whole process group as a terminal sends it, while an embedded cluster works. Wanted: one
line, exit code 130, and the rest in the next run.

Needs the extra `fleet`, and no ROS.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from valve_sim.fleet import run as fleet_run
from valve_sim.fleet.results import PARTS, Results
from valve_sim.fleet.sources import Bag
from valve_sim.fleet.units import EXAMINED, Survey, Unit
from valve_sim.fleet.work import Examined, Surveyed

ROOT: Final = Path(__file__).resolve().parents[1]
BAGS: Final = 150
TAKES: Final = 0.03
"""s of a unit."""
SAID_TO_TAKE: Final = 0.25
"""s, so that a batch is eight units and many are on their way."""
KINDS: Final = ("worker", "scheduler", "client")
PATIENCE: Final = 300.0
"""s for whatever is waited for; then the benchmark fails."""


# --- units of nothing, in whichever process ---------------------------------------------------------------------------


def survey_nothing(bags: Sequence[Bag]) -> list[Surveyed]:
    """Every bag has content of its own, and one valve."""
    return [Surveyed(bag, Survey(hashlib.sha256(bag.source.encode()).hexdigest(), ("/valve",)), 0.0) for bag in bags]


def examine_nothing(units: Sequence[Unit], output: Path) -> list[Examined]:
    """Leave a line for each unit: which it was, and in which process."""
    found = []
    for unit in units:
        time.sleep(TAKES)
        with _log(output).open("a") as log:
            log.write(f"{Path(unit.bag.source).name} {os.getpid()}\n")
        found.append(Examined(unit.row(EXAMINED, verdict="none", start_time=1), {}, SAID_TO_TAKE))
    return found


def _log(output: Path) -> Path:
    return output.with_suffix(".log")


def _command(arguments: Sequence[str]) -> None:
    """`valve-sim fleet`, with units of nothing."""
    from valve_sim.cli import main as command

    # By the name of this module, which workers can import, and not by __main__.
    own = importlib.import_module("benchmarks.fleet_kills")
    fleet_run.survey_bags, fleet_run.examine_units = own.survey_nothing, own.examine_nothing
    command(["fleet", *arguments])


# --- processes --------------------------------------------------------------------------------------------------------


def _started(words: Sequence[str], log: Path) -> subprocess.Popen[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "60s"}
    with log.open("w") as output:
        return subprocess.Popen(
            [sys.executable, "-m", *words], cwd=log.parent, env=environment, stdout=output, stderr=output, text=True,
            start_new_session=True,
        )  # fmt: skip


def _wait_for(what: str, is_so: object, process: subprocess.Popen[str] | None = None) -> None:
    assert callable(is_so)
    begun = time.monotonic()
    while not is_so():
        assert time.monotonic() - begun < PATIENCE, f"waited {PATIENCE:g} s for {what}"
        assert process is None or process.poll() is None, f"ended before {what}"
        time.sleep(0.01)


class Machines:
    """A scheduler and a worker, as docs/how_to/fleet.md starts them."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.address = folder, ""
        self.scheduler: subprocess.Popen[str] | None = None
        self.worker: subprocess.Popen[str] | None = None

    def start(self) -> None:
        """Anew, where they do not run."""
        if self.scheduler is not None and self.scheduler.poll() is None:
            return
        self.stop()
        log = self.folder / "scheduler.log"
        self.scheduler = _started(["dask", "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"], log)
        pattern = re.compile(r"tcp://127\.0\.0\.1:\d+")
        _wait_for("a scheduler", lambda: pattern.search(log.read_text("utf-8")), self.scheduler)
        found = pattern.search(log.read_text("utf-8"))
        assert found is not None
        self.address = found[0]
        words = ["dask", "worker", self.address, "--nthreads", "1", "--no-dashboard"]
        self.worker = _started(words, self.folder / "worker.log")

    def stop(self) -> None:
        """Both, and what they have started."""
        for process in (self.worker, self.scheduler):
            if process is not None:
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        self.scheduler = self.worker = None


@contextmanager
def machines(folder: Path) -> Iterator[Machines]:
    """They are stopped in the end."""
    made = Machines(folder)
    try:
        yield made
    finally:
        made.stop()


# --- a kill -----------------------------------------------------------------------------------------------------------


class Kill(NamedTuple):
    """What became of a run in which a process was killed.

    Attributes:
        kind: which process. after: units that were done by then. written: of them, those of which there was a row.
        twice: units that were done twice.
        in_vain: of them, those whose row had been written before. missing, double: bags without a row, with several.
        words: what the command said in the end, if it failed.
    """

    kind: str
    after: int
    written: int
    twice: int
    in_vain: int
    missing: int
    double: int
    words: str

    @property
    def is_as_wanted(self) -> bool:
        """Whether nothing was lost, and no more done again than had to be."""
        return not (self.in_vain or self.missing or self.double) and "\n" not in self.words


def kill_one(kind: str, share: float, bags: Path, output: Path, cluster: Machines) -> Kill:
    """A run with a kill when this share of all is done, and the same command again where it ended."""
    cluster.start()
    log, said = _log(output), output.with_suffix(".out")
    log.touch()

    def run() -> subprocess.Popen[str]:
        words = [str(bags), "--scheduler", cluster.address, "--output", str(output)]
        return _started(["benchmarks.fleet_kills", "--command", *words], said)

    client = run()
    _wait_for("units", lambda: len(_lines(log)) >= share * BAGS, client)
    # Of the rows, a copy at this moment: to read them takes too long.
    shutil.copytree(output / PARTS, output.with_suffix(".before") / PARTS)
    before = _lines(log)
    victim = {"client": client, "scheduler": cluster.scheduler}.get(kind)
    os.kill(int(before[-1][1]) if victim is None else victim.pid, signal.SIGKILL)
    code, words = client.wait(timeout=PATIENCE), ""
    if code != 0:
        lines = [] if kind == "client" else said.read_text("utf-8").strip().splitlines()
        words = "\n".join(line for line in lines if "% done: " not in line)
        cluster.start()
        client = run()
        code = client.wait(timeout=PATIENCE)
        assert code == 0, said.read_text("utf-8")
    written = {Path(row["source"]).name for row in Results(output.with_suffix(".before")).rows()}
    times = Counter(name for name, _ in _lines(log))
    again = {name for name, _ in _lines(log)[len(before) :]}
    rows = Counter(Path(row["source"]).name for row in _table(output))
    twice, double = (sum(count > 1 for count in counts.values()) for counts in (times, rows))
    return Kill(kind, len(before), len(written), twice, len(again & written), BAGS - len(rows), double, words)


def interrupted(bags: Path, output: Path) -> tuple[int, str, int]:
    """Ctrl-C in the middle: exit code, what was said, and how many bags have no row after the next run."""
    said, log = output.with_suffix(".out"), _log(output)
    log.touch()
    words = ["benchmarks.fleet_kills", "--command", str(bags), "--workers", "1", "--output", str(output)]
    client = _started(words, said)
    _wait_for("units", lambda: len(_lines(log)) >= BAGS / 3, client)
    os.killpg(client.pid, signal.SIGINT)
    code, last = client.wait(timeout=PATIENCE), said.read_text("utf-8").strip()
    assert _started(words, said).wait(timeout=PATIENCE) == 0
    return code, last, BAGS - len({row["source"] for row in _table(output)})


def _lines(log: Path) -> list[list[str]]:
    return [line.split() for line in log.read_text("utf-8").splitlines() if line.count(" ") == 1]


def _table(output: Path) -> list[dict[str, str]]:
    import pyarrow.parquet as pq

    rows: list[dict[str, str]] = pq.read_table(output / "fleet.parquet", columns=["source", "state"]).to_pylist()
    return rows


def main() -> None:
    """Print a line for each kill."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--interrupts", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--command", nargs=argparse.REMAINDER, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.command is not None:
        _command(chosen.command)
        return
    random, kills = np.random.default_rng(chosen.seed), list[Kill]()
    with tempfile.TemporaryDirectory() as place, machines(Path(place)) as cluster:
        bags = Path(place) / "bags"
        bags.mkdir()
        for number in range(BAGS):
            (bags / f"bag_{number:04d}.mcap").write_bytes(b"nothing")
        for number in range(chosen.kills):
            share = float(random.uniform(0.1, 0.8))
            one = kill_one(KINDS[number % len(KINDS)], share, bags, Path(place) / f"out_{number}", cluster)
            kills.append(one)
            print(*(f"{name} {value}" for name, value in one._asdict().items()), sep=", ", flush=True)
        for number in range(chosen.interrupts):
            code, words, missing = interrupted(bags, Path(place) / f"ctrl_c_{number}")
            print(f"Ctrl-C: exit code {code}, {missing} missing after the next run; it said: {words!r}", flush=True)
    print(f"{sum(one.is_as_wanted for one in kills)} of {len(kills)} kills as wanted")


if __name__ == "__main__":
    main()
