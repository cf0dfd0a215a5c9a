"""Killed while writing, a full disk, no place for a cache: a file is the old one or the new one; one line says why."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from valve_sim.recordings import read_trace

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[1]
BAG = ROOT / "bags" / "one_opening.mcap"
PARAMETERS = ROOT / "config" / "valve.yaml"
KILLS = 60
SMALL = 65536
"""Bytes of a disk that is soon full."""


def run(script: str, *arguments: object, **environment: str) -> subprocess.CompletedProcess[str]:
    """A Python process of its own."""
    return subprocess.run(
        [sys.executable, "-c", script, *map(str, arguments)],
        capture_output=True, text=True, timeout=300, check=False, cwd=ROOT, env={**os.environ, **environment},
    )  # fmt: skip


# --- killed ---

KILLED = '''
"""Children write files without end, one after the other is killed at a random moment; then each file is looked at."""
import csv, json, os, random, signal, sys, time
from dataclasses import replace
from pathlib import Path

from matplotlib.figure import Figure

from valve_sim.identification.reporting.figures import save_figure
from valve_sim.files.parameter_files import default_valve, load_valve, save_valve
from valve_sim.recordings import CSV_COLUMNS, read_trace, write_bag, write_csv
from valve_sim.files.whole_files import write_whole

folder, kills = Path(sys.argv[1]), int(sys.argv[2])
trace = read_trace(sys.argv[3])
COUNTS = (100, 200, 300, len(trace.times))
figure = Figure(figsize=(2, 2))
figure.subplots().plot(trace.times[::10], trace.pilot_position[::10])


def text(version, name):
    return f"{version}\\n" + f"{name} {version}\\n" * random.randrange(1, 20_000) + f"{version}\\n"


def is_whole_text(path):
    lines = path.read_text().splitlines()
    return lines[0] == lines[-1] and all(line.endswith(f" {lines[0]}") for line in lines[1:-1])


def is_whole_parameters(path):
    return 1.0 <= load_valve(path).parameters.main_damping < 2.0


def is_whole_bag(path):
    found = read_trace(path)
    return len(found.times) in COUNTS and all("no motion" in finding for finding in found.findings)


def is_whole_table(path):
    rows = list(csv.reader(path.open()))
    return len(rows) == 1 + int(float(rows[1][0])) and len(rows[-1]) == len(CSV_COLUMNS)


def bag(path, version):
    count = COUNTS[version % 4]
    write_bag(path, replace(trace, times=trace.times[:count], pilot_position=trace.pilot_position[:count],
                            main_position=trace.main_position[:count], coil_current=None))


def parameters(path, version):
    save_valve(path, default_valve().with_values(main_damping=1.0 + version % 997 / 1e3), "by a test")


def table(path, version):
    count = 1 + version % 3000
    write_csv(path, {name: [float(count)] * count for name in CSV_COLUMNS})


SURFACES = {
    "report.html": (lambda path, n: write_whole(path, text(n, "html")), is_whole_text),
    "corrected.yaml": (parameters, is_whole_parameters),
    "report.png": (lambda path, n: save_figure(figure, path), lambda path: path.read_bytes()[-8:-4] == b"IEND"),
    "strokes.mcap": (bag, is_whole_bag),
    "strokes.csv": (table, is_whole_table),
}


def write_for_ever():
    version = 0
    while True:
        version += 1
        name, (write, _) = random.choice(list(SURFACES.items()))
        write(folder / name, version)


random.seed(7)
for name, (write, _) in SURFACES.items():
    write(folder / name, 0)
half_written, amid = [], 0
for kill in range(kills):
    child = os.fork()
    if not child:
        random.seed(kill)
        write_for_ever()
    time.sleep(random.choice((0.01, 0.05, 0.25)) * random.random())
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    amid += any(f".{child}." in path.name for path in folder.iterdir())
    for name, (_, is_whole) in SURFACES.items():
        path = folder / name
        try:
            if path.exists() and not is_whole(path):
                half_written.append((kill, name))
        except Exception as error:
            half_written.append((kill, name, repr(error)))
written = [name for name in SURFACES if (folder / name).exists()]
print(json.dumps({"half_written": half_written, "amid": amid, "written": written}))
'''


def test_what_is_killed_while_it_writes_leaves_the_old_file_or_the_new_one(tmp_path: Path) -> None:
    ran = run(KILLED, tmp_path, KILLS, BAG)
    assert ran.returncode == 0, ran.stderr
    found = json.loads(ran.stdout)
    assert found["half_written"] == []
    assert len(found["written"]) == 5
    assert found["amid"] > 2, "too few were killed while a file was open to say anything"


# --- a full disk ---

LIMITED = """
import resource, sys
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]),) * 2)
from valve_sim.cli import main
main(sys.argv[2:], prog_name="valve-sim")
"""
WHOLE = "from valve_sim.cli import main; import sys; main(sys.argv[1:], prog_name='valve-sim')"
SIMULATE = ("simulate", "--voltage", "9", "--duration")


@contextlib.contextmanager
def small_disk(folder: Path) -> Iterator[Path]:
    """A file system of `SMALL` bytes; the test is skipped where none can be mounted."""
    folder.mkdir()
    options = ["mount", "-t", "tmpfs", "-o", f"size={SMALL}", "tmpfs", str(folder)]
    try:
        mounted = subprocess.run(options, capture_output=True, check=False).returncode == 0
    except OSError:
        mounted = False
    if not mounted:
        pytest.skip("no file system can be mounted here: that wants root")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def check_refusal(ran: subprocess.CompletedProcess[str], folder: Path) -> None:
    """Exit code 2, one line, and nothing that is not whole."""
    assert ran.returncode == 2, ran.stderr
    (line,) = ran.stderr.splitlines()
    assert "written (" in line
    for path in folder.rglob("*"):
        assert ".partial" not in path.name
        if path.suffix == ".json":
            json.loads(path.read_text())


@pytest.mark.parametrize(("output", "most"), [("x.mcap", 1000), ("x.mcap", 100_000), ("x.csv", 100_000), ("bag", 1000)])
def test_a_recording_that_finds_no_room_leaves_nothing(tmp_path: Path, output: str, most: int) -> None:
    ran = run(LIMITED, most, *SIMULATE, 1, "--output", tmp_path / output)
    check_refusal(ran, tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "arguments",
    [
        ("identify", BAG, "--output"),
        ("validate", BAG, "--params", PARAMETERS, "--plot", "{folder}/x.png", "--junit"),
        (*SIMULATE, 0.001, "--plot", "{folder}/x.png", "--output"),
    ],
    ids=lambda arguments: arguments[0],
)
def test_a_result_that_finds_no_room_is_refused(tmp_path: Path, arguments: tuple[object, ...]) -> None:
    given = [str(argument).format(folder=tmp_path) for argument in arguments]
    target = {"identify": ".", "validate": "x.xml", "simulate": "x.csv"}[given[0]]
    check_refusal(run(LIMITED, 700, *given, tmp_path / target), tmp_path)


def test_a_full_disk_is_said_and_what_was_there_stays(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk") as disk:
        bag = disk / "x.mcap"
        assert run(WHOLE, *SIMULATE, 0.001, "--output", bag).returncode == 0
        before = bag.read_bytes()
        ran = run(WHOLE, *SIMULATE, 1, "--output", bag)
        check_refusal(ran, disk)
        assert "No space left on device" in ran.stderr
        assert bag.read_bytes() == before
        check_refusal(run(WHOLE, "diagnose", BAG, "--output", disk / "results"), disk)
        assert len(read_trace(bag).times) == 20


def test_a_sqlite_recording_that_finds_no_room_leaves_nothing(tmp_path: Path) -> None:
    script = """
import resource, sys
from valve_sim.recordings import TraceError, read_trace, write_bag
trace = read_trace(sys.argv[1])
resource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000))
for compressed in (False, True):
    try:
        write_bag(sys.argv[2], trace, storage="sqlite3", compressed=compressed)
    except TraceError as error:
        print(error)
"""
    ran = run(script, BAG, tmp_path / "bag")
    assert ran.stdout.count("cannot be written (") == 2, ran.stderr
    assert list(tmp_path.iterdir()) == []


# --- no place for compiled code ---


def test_a_cache_that_fills_up_while_it_is_written_costs_time_only(tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    ran = run(LIMITED, 30_000, *SIMULATE, 0.01, "--output", tmp_path / "x.csv", VALVE_SIM_CACHE=str(cache))
    assert (ran.returncode, ran.stderr) == (0, "")
    assert all(path.suffix == ".o" for path in cache.iterdir())
    assert (tmp_path / "x.csv").exists()


def test_a_full_disk_holds_no_cache(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk") as disk:
        ran = run(WHOLE, *SIMULATE, 0.01, "--output", tmp_path / "x.csv", VALVE_SIM_CACHE=str(disk))
        assert (ran.returncode, ran.stderr) == (0, "")
        assert (tmp_path / "x.csv").exists()
