"""The command line: what it writes, prints and returns, in one process and as a real one."""

import csv
import html
import json
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from click.testing import CliRunner, Result

from valve_sim.cli import main
from valve_sim.files.parameter_files import default_valve, load_valve, save_valve
from valve_sim.recordings import CSV_COLUMNS, read_trace, write_bag

BAGS = Path(__file__).parents[1] / "bags"
LONG = pytest.mark.long
STROKES = "time,volts\n0.010,9.0\n0.040,0.0\n0.070,12.0\n0.100,0.0\n"
COMMANDS = (
    "simulate",
    "info",
    "map",
    "identify",
    "diagnose",
    "validate",
    "fit-force",
    "fleet",
    "export-fmu",
    "history",
)


def run(*arguments: object) -> Result:
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


def run_well(*arguments: object) -> Result:
    result = run(*arguments)
    assert result.exit_code == 0, result.output
    return result


def run_process(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "valve_sim", *arguments], capture_output=True, text=True, timeout=300, check=False
    )


@pytest.fixture(scope="module")
def strokes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag of two noisy strokes of the default valve."""
    folder = tmp_path_factory.mktemp("strokes")
    (folder / "strokes.csv").write_text(STROKES)
    bag = folder / "strokes.mcap"
    settings = ("--duration", 0.14, "--noise-um", 1, "--quantisation-um", 0.1, "--seed", 5, "--output", bag)
    run_well("simulate", "--profile", folder / "strokes.csv", *settings)
    return bag


@pytest.fixture(scope="module")
def more_damped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A parameter file with 20 % more main damping, and no tolerances in which that could hide."""
    path = tmp_path_factory.mktemp("parameters") / "more_damped.yaml"
    save_valve(path, default_valve().exact().with_values(main_damping=4.8), "a test")
    return path


@pytest.fixture
def exact(tmp_path: Path) -> Path:
    """A parameter file of the shipped valve without its tolerances."""
    path = tmp_path / "exact.yaml"
    save_valve(path, default_valve().exact(), "a test")
    return path


# --- help ---


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_help_has_an_example_and_a_page_and_fits_a_terminal(command: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("COLUMNS", "80")
    output = run_well(*([command] if command else []), "--help").output
    assert f"\n    valve-sim {command}" in output
    assert [line for line in output.splitlines() if len(line) > 80] == []
    pages = re.findall(r"docs/\S+\.md", output.split("Read on:")[1])
    assert pages and all((Path(__file__).parents[1] / page).is_file() for page in pages)


def test_help_and_info_wait_for_no_heavy_import():
    script = (
        "import sys; from valve_sim.cli.program import main; heavy = {'numpy', 'scipy', 'llvmlite', 'rich'}\n"
        "print(heavy & sys.modules.keys())\n"
        "try: main(['info', sys.argv[1]])\n"
        "except SystemExit as end: print(end.code, (heavy - {'numpy'}) & sys.modules.keys())"
    )
    command = [sys.executable, "-c", script, str(BAGS / "one_opening.mcap")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=True)
    assert (done.stdout.splitlines()[0], done.stdout.splitlines()[-1]) == ("set()", "0 set()")


# --- simulate ---


def test_simulate_writes_an_opening_and_says_the_event_times(tmp_path: Path):
    path = tmp_path / "opening.csv"
    arguments = ("simulate", "--voltage", 9, "--duration", 0.02, "--rate", 1e5, "--output", path)
    picture = tmp_path / "opening.png"
    assert "9.899964 ms  reached stop" in run_well(*arguments, "--plot", picture).output
    assert picture.read_bytes().startswith(b"\x89PNG")
    with path.open() as stream:
        rows = list(csv.DictReader(stream))
    assert tuple(rows[0]) == CSV_COLUMNS
    assert len(rows) == 2000
    phase = np.array([int(row["phase"]) for row in rows])
    # Phase 3 begins at the first sample after 5.300 ms, phase 4 after 9.900 ms.
    assert [int(np.argmax(phase == number)) for number in (3, 4)] == [530, 990]
    assert (float(rows[-1]["pilot_position"]), float(rows[-1]["coil_voltage"])) == (1.23e-3, 9.0)
    report = json.loads(run_well(*arguments, "--json").stdout)
    assert (report["t1_ms"], report["t2_ms"]) == (pytest.approx(5.3, abs=1e-3), pytest.approx(9.9, abs=1e-3))
    assert [event["kind"] for event in report["events"]] == ["unseated", "picked_up", "reached_stop"]
    closed = ("simulate", "--voltage", 0, "--duration", 0.02, "--output", path)
    assert "stays closed" in run_well(*closed).output
    assert json.loads(run_well(*closed, "--json").stdout)["t1_ms"] is None


def test_noise_is_seeded_quantised_and_of_its_size(tmp_path: Path):
    def positions(seed: int, name: str) -> np.ndarray:
        settings = ("--noise-um", 2, "--quantisation-um", 0.5, "--seed", seed, "--output", tmp_path / name)
        run_well("simulate", "--voltage", 9, "--duration", 0.2, *settings)
        return read_trace(tmp_path / name).pilot_position

    first, again, other = positions(1, "a.mcap"), positions(1, "b.mcap"), positions(2, "c.mcap")
    assert (first == again).all()
    assert not (first == other).all()
    assert np.allclose(first / 0.5e-6, np.round(first / 0.5e-6), atol=1e-6)
    # 2 µm and the 0.14 µm of rounding; 3800 samples hold it to 1.2 %.
    assert np.std(first[300:]) == pytest.approx(np.hypot(2e-6, 0.5e-6 / np.sqrt(12)), rel=0.05)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("strokes.csv", STROKES),
        ("bare.csv", "0.010 9.0\n0.040 0.0\n0.070 12.0\n0.100 0.0\n"),
        ("strokes.yaml", "[[0.010, 9.0], [0.040, 0.0], [0.070, 12.0], [1e-1, 0]]"),
        (
            "named.yml",
            "- {time: 0.01, volts: 9}\n- {time: 0.04, volts: 0}\n- {time: 0.07, volts: 12}\n- {time: 0.1, volts: 0}",
        ),
    ],
)
def test_profiles_in_every_form_give_the_same_commands(tmp_path: Path, name: str, text: str):
    (tmp_path / name).write_text(text)
    run_well("simulate", "--profile", tmp_path / name, "--duration", 0.14, "--output", tmp_path / "x.mcap")
    drive = read_trace(tmp_path / "x.mcap").drive
    # Times in a bag count from the first stamp, here the first sample at 0.
    assert drive.times.tolist() == [0.01, 0.04, 0.07, 0.1]
    assert drive.volts.tolist() == [9.0, 0.0, 12.0, 0.0]


def test_a_table_that_simulate_wrote_is_a_profile_and_a_name_without_ending_a_folder(tmp_path: Path):
    (tmp_path / "strokes.csv").write_text(STROKES)
    run_well("simulate", "--profile", tmp_path / "strokes.csv", "--duration", 0.14, "--output", tmp_path / "a.csv")
    run_well("simulate", "--profile", tmp_path / "a.csv", "--duration", 0.14, "--output", tmp_path / "b.csv")
    assert (tmp_path / "a.csv").read_text() == (tmp_path / "b.csv").read_text()
    run_well("simulate", "--profile", tmp_path / "a.csv", "--duration", 0.14, "--output", tmp_path / "bag")
    assert (tmp_path / "bag" / "metadata.yaml").is_file()
    assert len(read_trace(tmp_path / "bag").times) == 2800


# --- info ---


def test_info_shows_each_recording_with_its_strokes_rates_and_arrivals(strokes: Path):
    output = run_well("info", strokes, BAGS / "one_opening.mcap").output
    assert "2800 samples       20000 Hz" in output
    assert "opening at 0.070 s, 12.0 V" in output
    assert "reaches stop (position)" in output
    assert [line.split(":")[0] for line in output.splitlines() if not line.startswith(" ")] == [
        f"{strokes} (/valve)", f"{BAGS / 'one_opening.mcap'} (/valve)",
    ]  # fmt: skip
    valve, other = json.loads(run_well("info", strokes, BAGS / "one_opening.mcap", "--json").stdout)["valves"]
    assert other["source"].startswith(str(BAGS))
    assert valve["signals"]["position"] == {"samples": 2800, "rate": pytest.approx(20000), "in_bursts": False}
    assert [stroke["kind"] for stroke in valve["strokes"]] == ["opening", "closing", "opening", "closing"]
    first = {event["kind"]: event["after_command"] for event in valve["arrivals"][0]["events"]}
    assert first["pilot_reaches_main"] == pytest.approx(5.3e-3, abs=3e-5)
    assert first["reaches_stop"] == pytest.approx(9.9e-3, abs=3e-5)


@pytest.mark.long
def test_info_tells_the_state_of_a_recording(strokes: Path):
    (valve,) = json.loads(run_well("info", strokes, "--state", "--json").stdout)["valves"]
    assert {"drift", "hum"} <= {entry["error"] for entry in valve["state"]["recording"]}
    assert valve["state"]["detection_limits"]["coulomb_friction"]["force"] > 0.0


@pytest.fixture(scope="module")
def spoilt(strokes: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Strokes with three spikes, a code, a reading that is held for nine samples, and a range that ends too early.

    The third spike is in motion, where it is told from one only above six moves between samples.
    """
    trace = read_trace(strokes)
    position = np.minimum(trace.pilot_position, 1.2e-3)
    position[[40, 110, 1500]] += [60e-6, 60e-6, 200e-6]
    position[1300] = 32.767e-3
    position[1250:1259] = position[1250]
    bag = tmp_path_factory.mktemp("spoilt") / "spoilt.mcap"
    write_bag(bag, replace(trace, pilot_position=position))
    return bag


def test_info_counts_readings_that_are_no_measurements(strokes: Path, spoilt: Path):
    clipped = np.count_nonzero(read_trace(spoilt).pilot_position == 1.2e-3)
    assert clipped > 500
    (line,) = (line for line in run_well("info", spoilt).stdout.splitlines() if "left out" in line)
    (valve,) = json.loads(run_well("info", spoilt, "--json").stdout)["valves"]
    beside = valve["left_out"]["clipped"] - clipped
    assert 0 <= beside < 30  # what is next to the end of the range in motion
    assert valve["left_out"] == {"codes": 1, "repeated": 8, "spikes": 3, "clipped": clipped + beside}
    assert line == f"  left out: 3 spikes, 8 repeated readings, 1 code, {clipped + beside} clipped readings"
    assert valve["position_range"][1] == pytest.approx(1.2e-3, abs=40e-6)
    assert valve["noise"] == pytest.approx(1e-6, rel=0.05)
    assert valve["findings"] == []
    assert "left out" not in run_well("info", strokes).stdout
    (valve,) = json.loads(run_well("info", strokes, "--json").stdout)["valves"]
    assert valve["left_out"] == {"codes": 0, "repeated": 0, "spikes": 0, "clipped": 0}


def test_identify_says_what_it_leaves_out_and_finds_the_same(strokes: Path, spoilt: Path, tmp_path: Path):
    results = [run_well("identify", bag, "--output", tmp_path / bag.stem) for bag in (strokes, spoilt)]
    said = "(pilot_plunger): left out of all that follows: 3 spikes, 8 repeated readings, 1 code, "
    assert [said in result.stderr for result in results] == [False, True]
    sound, found = (
        json.loads((tmp_path / bag.stem / "identify.json").read_text())["parameters"] for bag in (strokes, spoilt)
    )
    for name, own in sound.items():
        assert abs(found[name]["value"] - own["value"]) < 3 * found[name]["stderr"]


# --- identify, diagnose, validate ---


def test_identify_writes_what_validate_and_the_node_load(tmp_path: Path, strokes: Path):
    output = run_well("identify", strokes, "--output", tmp_path / "results").output
    report = json.loads((tmp_path / "results" / "identify.json").read_text())
    identified = load_valve(tmp_path / "results" / "identified.yaml").parameters
    for name, truth in (("pilot_damping", 1.0), ("main_damping", 4.0)):
        found = report["parameters"][name]
        assert abs(found["value"] - truth) < 4 * found["stderr"]
        assert getattr(identified, name) == found["value"]
        assert name in output
    run_well("validate", strokes, "--params", tmp_path / "results" / "identified.yaml")


def test_identify_frees_what_it_is_told_to(tmp_path: Path, strokes: Path):
    result = run_well("identify", strokes, "--free", "a0, main_damping", "--free", "a1", "--output", tmp_path, "--json")
    assert set(json.loads(result.stdout)["parameters"]) == {"a0", "a1", "main_damping"}


@pytest.mark.long
def test_diagnose_within_a_small_budget_claims_nothing_and_says_what_it_left(tmp_path: Path):
    output = run_well("diagnose", BAGS / "friction", "--budget", 1, "--output", tmp_path).output
    report = json.loads((tmp_path / "report.json").read_text())
    untried = report["untried"]
    assert untried
    assert report["work"]["allowed"] == 4000.0
    told = " ".join(output.split())
    assert f"{len(untried)} sets were not tried" in told
    assert f": {untried[0]}" in told
    page = html.unescape((tmp_path / "report.html").read_text())
    assert all(f"<li>{what}</li>" in page for what in untried)
    assert report["verdict"]["kind"] in ("none", "insufficient")
    load_valve(tmp_path / "corrected.yaml")


def test_validate_exits_0_within_and_1_outside(tmp_path: Path, strokes: Path, more_damped: Path):
    declared = tmp_path / "declared.yaml"
    save_valve(declared, default_valve(), "a test")
    assert run("validate", strokes, "--params", declared, "--plot", tmp_path / "replay.png").exit_code == 0
    assert (tmp_path / "replay.png").read_bytes().startswith(b"\x89PNG")
    outside = run("validate", strokes, strokes, "--params", more_damped, "--junit", tmp_path / "replay.xml", "--json")
    assert outside.exit_code == 1
    assert [recording["passed"] for recording in json.loads(outside.stdout)["recordings"]] == [False, False]
    root = ElementTree.parse(tmp_path / "replay.xml").getroot()
    assert len(root.findall(".//failure")) == int(root.attrib["failures"]) > 0
    assert run("validate", strokes, "--params", more_damped, "--tolerance-um", 50).exit_code == 0


def test_fit_force_writes_parameters_report_and_picture(tmp_path: Path):
    x = np.linspace(0, 1.23e-3, 80)
    polynomial = default_valve().parameters.attraction_polynomial
    force = np.polynomial.polynomial.polyval(x, np.array(polynomial))
    force += 0.02 * np.random.default_rng(0).standard_normal(80)
    np.savetxt(
        tmp_path / "force.csv", np.column_stack([x, force]), delimiter=",", header="displacement,force", comments=""
    )
    output = run_well("fit-force", tmp_path / "force.csv", "--output", tmp_path / "results").output
    assert "starts the motion" in output
    fitted = load_valve(tmp_path / "results" / "attraction.yaml").parameters.attraction_polynomial
    report = json.loads((tmp_path / "results" / "fit-force.json").read_text())
    assert list(fitted) == report["attraction_polynomial"]
    assert fitted[0] == pytest.approx(polynomial[0], abs=4 * report["parameters"]["a0"]["stderr"])
    assert (tmp_path / "results" / "fit-force.png").read_bytes().startswith(b"\x89PNG")


def test_fit_force_takes_a_map(tmp_path: Path):
    rows = [f"{x};{3000 + 10 * x}".replace(".", ",") for x in np.linspace(0.0, 1230.0, 20)]
    (tmp_path / "cell.csv").write_text("\n".join(["Weg;Kraft", "um;mN", *rows]) + "\n")
    (tmp_path / "cell.yaml").write_text("displacement: {column: Weg, unit: um}\nforce: {column: Kraft, unit: mN}\n")
    files = (tmp_path / "cell.csv", "--map", tmp_path / "cell.yaml", "--output", tmp_path)
    run_well("fit-force", *files, "--degree", "1")
    found = load_valve(tmp_path / "attraction.yaml").parameters.attraction_polynomial
    assert found == pytest.approx((3.0, 1e4, 0.0, 0.0), rel=1e-9)


# --- unusable input ---

SIMULATE = ("simulate", "--duration", "0.02", "--output", "{folder}/x.csv")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "Missing command"),
        (("frobnicate",), "frobnicate"),
        (SIMULATE, "--voltage or --profile"),
        ((*SIMULATE, "--voltage", "nine"), "found 'nine', expected a finite number"),
        ((*SIMULATE, "--voltage", "nan"), "found 'nan'"),
        ((*SIMULATE, "--voltage", "9", "--rate", "0"), "above 0"),
        ((*SIMULATE, "--voltage", "9", "--rate", "1e300"), "change duration or rate"),
        ((*SIMULATE, "--voltage", "9", "--params", "{folder}/none.yaml"), "none.yaml: cannot be read"),
        ((*SIMULATE, "--profile", "{folder}/none.csv"), "none.csv: cannot be read"),
        ((*SIMULATE, "--profile", "{folder}/backward.csv"), "row 2: found time 0.01 s, expected one after 0.02 s"),
        ((*SIMULATE, "--profile", "{folder}/negative.csv"), "expected times from 0 on"),
        ((*SIMULATE, "--profile", "{folder}/late.csv"), "first command comes at 5 s"),
        ((*SIMULATE, "--profile", "{folder}/words.yaml"), "row 1: found"),
        (("simulate", "--voltage", "9", "--duration", "0.02", "--output", "{folder}/x.txt"), "expected x.mcap, x.csv"),
        (
            ("simulate", "--voltage", "9", "--duration", "0.02", "--output", "{folder}/late.csv/x.mcap"),
            "cannot be written",
        ),
        (("info", "{folder}/none.mcap"), "none.mcap: does not exist"),
        (("info", "{folder}/late.csv"), "is not a recording"),
        (("identify", "{folder}/none.mcap", "--output", "{folder}/results"), "none.mcap: does not exist"),
        (("identify", "{strokes}"), "--output"),
        (
            ("identify", "{strokes}", "--free", "pilot_dampin", "--output", "{folder}/results"),
            "did you mean pilot_damping?",
        ),
        (("identify", "{strokes}", "--free", " , ", "--output", "{folder}/results"), "found no name"),
        (("identify", "{strokes}", "--valve", "/pump", "--output", "{folder}/results"), "holds no valve /pump"),
        (("identify", "{strokes}", "--output", "{folder}/late.csv/results"), "cannot be written"),
        (
            ("diagnose", "{strokes}", "--holdout", "{folder}/none.mcap", "--output", "{folder}/results"),
            "does not exist",
        ),
        (("validate", "{strokes}"), "--params"),
        (("validate", "{strokes}", "--params", "{folder}/late.csv"), "late.csv"),
        (("validate", "{strokes}", "{strokes}", "--params", "{folder}/late.csv", "--plot", "x.png"), "one BAG"),
        (("fit-force", "{folder}/late.csv", "--output", "{folder}/results"), "expected one named displacement"),
    ],
)
def test_unusable_input_is_one_line_and_exit_2(tmp_path: Path, strokes: Path, arguments: tuple[str, ...], words: str):
    (tmp_path / "backward.csv").write_text("0.02,9\n0.01,0\n")
    (tmp_path / "negative.csv").write_text("-0.02,9\n0.01,0\n")
    (tmp_path / "late.csv").write_text("time,volts\n5,9\n6,0\n")
    (tmp_path / "words.yaml").write_text("[open, shut]")
    before = sorted(tmp_path.rglob("*"))
    result = run(*(argument.format(folder=tmp_path, strokes=strokes) for argument in arguments))
    assert result.exit_code == 2
    assert words in result.stderr
    assert result.stderr.count("\n") == 1
    assert result.stderr.startswith("valve-sim: ")
    assert result.stdout == ""
    assert sorted(tmp_path.rglob("*")) == before


def test_a_mistake_in_the_program_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch, strokes: Path):
    def fails(*arguments: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("valve_sim.recordings.describe", fails)
    assert isinstance(CliRunner().invoke(main, ["info", str(strokes)]).exception, ZeroDivisionError)


@pytest.mark.parametrize(
    ("command", "option"),
    [
        (("identify", "{bag}"), "--output"),
        (("diagnose", "{bag}"), "--output"),
        (("fit-force", "{bag}"), "--output"),
        (("map", "{bag}"), "--output"),
        (("simulate", "--voltage", "9", "--duration", "1"), "--output"),
        (("simulate", "--voltage", "9", "--duration", "1", "--output", "{ok}"), "--plot"),
        (("validate", "{bag}", "--params", "config/valve.yaml"), "--junit"),
    ],
)
@pytest.mark.parametrize("place", ["/proc/none/it", "{ok}/file/it"])
def test_what_cannot_be_written_is_refused_before_anything_is_read(
    command: tuple[str, ...], option: str, place: str, strokes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Root may write to all but what the system keeps for itself."""

    def reads(*arguments: object, **settings: object) -> None:
        raise AssertionError("read before it was known that nothing can be written")

    monkeypatch.setattr("valve_sim.recordings.read_trace", reads)
    (tmp_path / "file").touch()
    given = [own.format(bag=strokes, ok=tmp_path) for own in (*command, option, place)]
    result = run(*given)
    assert result.exit_code == 2
    assert re.fullmatch(rf"valve-sim: {given[-1]}: cannot be written \(.*\); choose another place\n", result.stderr)


# --- hostile input ---

PARAMETERS = [
    ("info", "{bag}", "--params", "{hostile}"),
    ("identify", "{bag}", "--params", "{hostile}", "--output", "{folder}/o"),
    ("diagnose", "{bag}", "--params", "{hostile}", "--output", "{folder}/o"),
    ("validate", "{bag}", "--params", "{hostile}"),
    ("simulate", "--voltage", "9", "--duration", "0.02", "--params", "{hostile}", "--output", "{folder}/x.csv"),
    ("map", "{bag}", "--params", "{hostile}"),
    ("fit-force", "{folder}/force.csv", "--params", "{hostile}", "--output", "{folder}/o"),
    ("export-fmu", "--params", "{hostile}", "--output", "{folder}/x.fmu"),
]
"""Commands with a parameter file."""
OTHERS = [
    ("info", "{bag}", "--map", "{hostile}"),
    ("validate", "{bag}", "--plant", "{hostile}"),
    ("simulate", "--plant", "{hostile}", "--duration", "1", "--output", "{folder}/x.csv"),
    ("simulate", "--profile", "{hostile}", "--duration", "1", "--output", "{folder}/x.csv"),
    ("fit-force", "{folder}/force.csv", "--map", "{hostile}", "--output", "{folder}/o"),
]


@pytest.mark.parametrize("command", [*PARAMETERS, *OTHERS])
def test_a_hostile_file_is_refused_at_once_in_one_line(command: tuple[str, ...], tmp_path: Path) -> None:
    """One without end; other kinds of them, which one reader refuses for every command, are in files/test_limits.py."""
    (tmp_path / "force.csv").write_text("displacement,force\n0,1\n1e-3,2\n")
    (tmp_path / "hostile.yaml").symlink_to("/dev/zero")
    places = {"bag": BAGS / "one_opening.mcap", "hostile": tmp_path / "hostile.yaml", "folder": tmp_path}
    before = sorted(tmp_path.iterdir())
    started = time.process_time()
    result = run(*(word.format(**places) for word in command))
    assert time.process_time() - started < 2.0
    assert result.exit_code == 2
    assert result.stderr.count("\n") == 1 and "hostile.yaml" in result.stderr
    assert len(result.stderr) < 1000
    assert sorted(tmp_path.iterdir()) == before


# --- as a real process ---


def test_process_answers_on_stdout_and_refuses_on_stderr(strokes: Path, tmp_path: Path):
    written = run_process("identify", str(strokes), "--output", str(tmp_path))
    assert written.returncode == 0
    header = (tmp_path / "identified.yaml").read_text().splitlines()[:3]
    assert header[0] == f"# Written by: valve-sim identify {strokes} --output {tmp_path}"
    bad = run_process("info", str(tmp_path / "none.mcap"))
    assert (bad.returncode, bad.stdout) == (2, "")
    assert bad.stderr.count("\n") == 1
    command = f"{sys.executable} -m valve_sim info {strokes} --json | head -c 1"
    done = subprocess.run(
        ["bash", "-o", "pipefail", "-c", command], capture_output=True, text=True, timeout=300, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "{", "")


SAYS_WHEN_IT_LOADS = """
import sys
from valve_sim.__main__ import main
class Says:
    def find_spec(self, name, *rest):
        if name == "valve_sim.cli": print("loading", file=sys.stderr, flush=True)
sys.meta_path.insert(0, Says())
main()
"""


@pytest.mark.parametrize("after", [0.0, 0.1, pytest.param(1.0, marks=LONG), pytest.param(5.0, marks=LONG)])
def test_ctrl_c_at_any_time_is_one_line_and_exit_130(tmp_path: Path, after: float):
    """While modules load, and while a fit runs; the folder of the results has nothing half written."""
    command = ["diagnose", str(BAGS / "friction"), "--output", str(tmp_path / "results")]
    program = [sys.executable, "-c", SAYS_WHEN_IT_LOADS, *command]
    process = subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None and process.stderr.readline() == "loading\n"
    time.sleep(after)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out) == (130, ""), err
    assert err.splitlines()[-1] == "valve-sim: stopped"
    assert "Traceback" not in err
    assert not (tmp_path / "results").exists()


# --- the README ---


def readme_blocks(language: str) -> list[str]:
    readme = Path(__file__).parents[1] / "README.md"
    return re.findall(rf"```{language}\n(.*?)```", readme.read_text(), flags=re.DOTALL)


def test_the_python_and_the_parameter_file_of_the_readme_work(tmp_path: Path):
    names: dict[str, Any] = {}
    (python,) = readme_blocks("python")
    exec(python, names)
    assert (names["t1"], names["t2"]) == (pytest.approx(5.3e-3, abs=1e-6), pytest.approx(9.9e-3, abs=1e-6))
    (parameters,) = readme_blocks("yaml")
    (tmp_path / "readme.yaml").write_text(parameters)
    assert load_valve(tmp_path / "readme.yaml").effects == {"coulomb_friction": {"force": 0.3}}


# --- recordings of others ---


def test_positions_in_millimetres_are_refused_and_a_map_reads_them(
    strokes: Path, more_damped: Path, tmp_path: Path
) -> None:
    trace = read_trace(strokes)
    write_bag(tmp_path / "mm.mcap", replace(trace, pilot_position=1e3 * trace.pilot_position, main_position=None))
    for command in ("identify", "diagnose", "validate"):
        output = ("--params", more_damped) if command == "validate" else ("--output", tmp_path / "results")
        result = run(command, tmp_path / "mm.mcap", *output)
        assert result.exit_code == 2
        assert re.search(r"/valve/measured/joint_states .*travels 1\.23\d m, expected about 0\.00123 m", result.stderr)
        assert result.stderr.count("\n") == 1
        assert not (tmp_path / "results").exists()
    said = run_well("info", tmp_path / "mm.mcap").stdout
    assert "note: topic /valve/measured/joint_states (pilot_plunger): pilot_plunger travels" in said
    (tmp_path / "lab.yaml").write_text(
        "command: {topic: /valve/coil_voltage}\n"
        "position: {topic: /valve/measured/joint_states, joint: pilot_plunger, unit: mm}\n"
        "current: {topic: /valve/measured/coil_current}\n"
    )
    run_well("identify", tmp_path / "mm.mcap", "--map", tmp_path / "lab.yaml", "--output", tmp_path / "mapped")
    mapped = json.loads((tmp_path / "mapped" / "identify.json").read_text())["parameters"]["main_damping"]
    assert abs(mapped["value"] - 4.0) < 4.0 * mapped["stderr"] < 0.5


def test_a_table_of_a_logger_from_first_map_to_fit(strokes: Path, exact: Path, tmp_path: Path) -> None:
    trace, table, lab = read_trace(strokes), tmp_path / "logger.csv", tmp_path / "lab.yaml"
    places = np.searchsorted(trace.drive.times, trace.times, side="right") - 1
    volts = np.where(places < 0, 0.0, trace.drive.volts[np.maximum(places, 0)])
    rows = np.column_stack([1e3 * trace.times, volts, 12.5 - 1e3 * trace.pilot_position])
    np.savetxt(table, rows, delimiter=";", header="t [ms];U;LVDT [mm]", fmt="%.9g")
    assert "wrote" in run_well("map", table, "--output", lab).stdout
    assert run("map", table, "--output", lab).exit_code == 2, "what was corrected by hand must not be lost"
    run_well("identify", table, "--map", lab, "--params", exact, "--output", tmp_path / "results")
    report = json.loads((tmp_path / "results" / "identify.json").read_text())
    for name, truth in (("pilot_damping", 1.0), ("main_damping", 4.0)):
        low, high = report["parameters"][name]["ci95"]
        assert low < truth < high, name
    low, high = report["parameters"]["main_damping"]["ci95"]
    assert high - low < 0.05
