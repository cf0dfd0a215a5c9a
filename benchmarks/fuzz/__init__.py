"""Inputs that nobody would send on purpose: `python -m benchmarks.fuzz` counts what becomes of them.

Bags and tables are flipped, cut, spliced and repeated; parameter files get wrong values, lines and characters; valves
get any parameters that are accepted, with gas and without; command lines get all of it, and options that make no sense;
a plant or a recording of a user's own gets one slip. Each input must be taken, or refused in one line: anything else,
and whatever takes longer than ten seconds of computing, is a finding, and makes the exit code 1. A surface and a number
give an input again. `--only topics`: messages to nodes that run, which needs ROS 2 (see `benchmarks.fuzz.topics`).
"""

from __future__ import annotations

import contextlib
import math
import re
import signal
import tempfile
import traceback
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import FrameType
from typing import Final

import numpy as np
from model.gas.cases import Case, ours

from benchmarks.fuzz.command_lines import try_command_line
from benchmarks.fuzz.slips import try_recording
from valve_sim.files.bounded import table_text
from valve_sim.files.data_tables import open_table
from valve_sim.files.parameter_files import load_valve
from valve_sim.files.recording_map import map_from
from valve_sim.model import (
    CATALOGUE,
    DECLARED,
    Drive,
    Parameter,
    Phase,
    Response,
    SimulationError,
    Stepper,
    Tag,
    Valve,
    simulate,
)
from valve_sim.model.errors import ValveError
from valve_sim.recordings import TraceError, list_valves, read_trace

ROOT: Final = Path(__file__).parents[2]
HANGS_AFTER: Final = 10
"""s of computing; waiting is given twenty times as long."""
NASTY: Final = (
    "nan", ".nan", ".inf", "-.inf", "1e308", "1e400", "-1", "0", "-0.0", "5e-324", "true", "null", "~", "text", "''",
    "[]", "{}", "[1, 2]", "[[1]]", "0x10", "1_000", "2026-01-01", "!!python/object:os.system x", "&a [*a]", "1e", "|",
    "'unclosed", "\t", "9" * 400, "é", "\x00",
)  # fmt: skip
"""Values that a parameter file may hold where a number is meant."""
MOST_SLIPS: Final = 1_000_000
"""Recordings with a slip that can be drawn."""
GENTLE: Final = 1e-9
"""m: how far beyond its contacts a valve may be."""
SECONDS: Final = 0.02
"""Of a valve's run."""
MOST_EVENTS: Final = 20_000
"""In it: a contact slower than 1 or 5 mm/s does not rebound, so there cannot be many."""
SENSORS: Final = tuple(effect.name for effect in CATALOGUE.tagged(Tag.SENSOR))
BEYOND: Final = 1e-6
"""Share by which a pressure may be beyond those between which it must stay."""

Random = np.random.Generator


class Hang(BaseException):
    """Raised by the alarm; no `except Exception` shall hide it."""


@contextlib.contextmanager
def limited() -> Iterator[None]:
    """Raise `Hang` in what computes for too long, or waits for long: a busy machine makes neither of it."""

    def ring(number: int, frame: FrameType | None) -> None:
        raise Hang(f"took more than {HANGS_AFTER} s")

    before = {number: signal.signal(number, ring) for number in (signal.SIGPROF, signal.SIGALRM)}
    signal.setitimer(signal.ITIMER_PROF, HANGS_AFTER)
    signal.setitimer(signal.ITIMER_REAL, 20 * HANGS_AFTER)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, handler in before.items():
            signal.signal(number, handler)


# --- inputs ---


def mutated(content: bytes, others: Sequence[bytes], random: Random) -> bytes:
    """One to three changes of a file."""
    for _ in range(int(random.integers(1, 4))):
        content = MUTATIONS[int(random.integers(len(MUTATIONS)))](content, others, random)
    return content


def _place(content: bytes, random: Random) -> int:
    return int(random.integers(0, max(1, len(content))))


def _flip(content: bytes, others: Sequence[bytes], random: Random) -> bytes:
    changed = bytearray(content)
    for _ in range(int(random.integers(1, 20)) if changed else 0):
        changed[_place(content, random)] ^= int(random.integers(1, 256))
    return bytes(changed)


def _cut(content: bytes, others: Sequence[bytes], random: Random) -> bytes:
    return content[: _place(content, random)]


def _drop(content: bytes, others: Sequence[bytes], random: Random) -> bytes:
    at = _place(content, random)
    return content[:at] + content[at + int(random.integers(1, 2000)) :]


def _repeat(content: bytes, others: Sequence[bytes], random: Random) -> bytes:
    start, stop = sorted((_place(content, random), _place(content, random)))
    return content[:stop] + content[start:]


def _splice(content: bytes, others: Sequence[bytes], random: Random) -> bytes:
    other = others[int(random.integers(len(others)))]
    return content[: _place(content, random)] + other[_place(other, random) :]


def _overwrite(content: bytes, others: Sequence[bytes], random: Random) -> bytes:
    at = _place(content, random)
    filler = bytes([int(random.choice([0x00, 0xFF, 0x7F]))]) * int(random.integers(1, 64))
    return content[:at] + filler + content[at + len(filler) :]


MUTATIONS: Final[tuple[Callable[[bytes, Sequence[bytes], Random], bytes], ...]] = (
    _flip, _cut, _drop, _repeat, _splice, _overwrite,
)  # fmt: skip


def bad_bag(random: Random, folder: Path) -> Path:
    """A changed copy of a shipped bag: a bare file or a rosbag2 folder."""
    names = ("one_opening.mcap", "live.mcap")
    contents = [(ROOT / "bags" / name).read_bytes() for name in names]
    if random.random() < 0.7:
        path = folder / "bag.mcap"
        path.write_bytes(mutated(contents[int(random.integers(len(contents)))], contents, random))
        return path
    bag = folder / "bag"
    bag.mkdir()
    victim = int(random.integers(2))
    for index, source in enumerate(sorted((ROOT / "bags" / "friction").iterdir())):
        content = source.read_bytes()
        (bag / source.name).write_bytes(mutated(content, contents, random) if index == victim else content)
    return bag


TABLE_MAP: Final = {
    "time": "t",
    "voltage": {"column": "u"},
    "position": {"column": "x", "unit": "mm"},
}
TABLE_HEAD: Final = ("# by a logger", "t{0}u{0}x", "s{0}V{0}mm")
TABLE_ROWS: Final = 600


def whole_table(random: Random) -> str:
    """An opening and a closing in one of four forms: commas, semicolons with decimal commas, quotes, dates."""
    times = np.arange(TABLE_ROWS) * 1e-4
    lifts = 1.23 * np.clip((times - 0.012) / 0.008, 0.0, 1.0) * (times < 0.045) + 1e-3 * random.standard_normal(
        TABLE_ROWS
    )
    volts = 9.0 * ((times > 0.01) & (times < 0.04)) + 1e-3 * random.standard_normal(TABLE_ROWS)
    form = int(random.integers(4))
    mark = ";" if form == 1 else ","
    lines = [line.format(mark) for line in TABLE_HEAD]
    for time, volt, lift in zip(times.tolist(), volts.tolist(), lifts.tolist(), strict=True):
        cells = [
            f"2024-03-02T14:37:48.{1e6 * time:06.0f}" if form == 3 else f"{time:.6f}",
            f"{volt:.5f}",
            f"{lift:.5f}",
        ]
        row = mark.join(f'"{cell}"' if form == 2 else cell for cell in cells)
        lines.append(row.replace(".", ",") if form == 1 else row)
    return "\n".join(lines) + "\n"


def bad_file(random: Random, folder: Path) -> Path:
    """A changed copy of a shipped parameter file."""
    lines = (
        (ROOT / "config" / str(random.choice(["valve.yaml", "published.yaml", "tank_1.yaml"]))).read_text().split("\n")
    )
    for _ in range(int(random.integers(1, 4))):
        at = int(random.integers(len(lines)))
        kind = int(random.integers(6))
        if kind == 0 and ":" in lines[at]:
            lines[at] = f"{lines[at].split(':')[0]}: {NASTY[int(random.integers(len(NASTY)))]}"
        elif kind == 1:
            lines[at] = lines[at] + NASTY[int(random.integers(len(NASTY)))]
        elif kind == 2:
            lines[at] = " " * int(random.integers(8)) + lines[at].lstrip()
        elif kind == 3:
            lines.insert(at, lines[int(random.integers(len(lines)))])
        elif kind == 4:
            lines[at] = lines[at].replace("_", random.choice(["-", "", "__"]))
        else:
            lines[at : at + 1] = _flip(lines[at].encode(), (), random).decode("latin-1").split("\n")
    path = folder / "valve.yaml"
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def _any_value(parameter: Parameter, random: Random) -> float:
    """Anywhere in a parameter's range, small values and large ones alike, and its ends."""
    size = abs(parameter.prior_scale) * 10.0 ** random.uniform(-4.0, 3.0)
    value = float(random.choice([-1.0, 1.0]) * size)
    if random.random() < 0.1:
        value = float(random.choice([parameter.lower, parameter.upper, 0.0]))
    value = min(max(value, parameter.lower), parameter.upper)
    return value if math.isfinite(value) else parameter.prior_scale


def any_valve(random: Random) -> Valve:
    """A valve with up to three effects.

    Raises:
        ParameterError: it is not accepted.
    """
    declared = Valve().with_values(a0=3.0336, coil_time_constant=1e-3).to_mapping()["valve"]
    for name in random.choice(list(DECLARED), int(random.integers(0, 6)), replace=False):
        if str(name) in declared:
            declared[str(name)] = _any_value(
                DECLARED[str(name)]._replace(prior_scale=declared[str(name)] or 1e-3), random
            )
    names = [name for name, effect in CATALOGUE.items() if effect.named]
    effects = {
        str(name): {entry.name: _any_value(entry, random) for entry in CATALOGUE[str(name)].parameters}
        for name in random.choice(names, int(random.integers(0, 4)), replace=False)
    }
    return Valve.from_mapping({"valve": declared, "effects": effects}, "fuzz")


# --- what must become of them ---


def try_bag(random: Random, folder: Path) -> None:
    """Read a bad bag."""
    path = bad_bag(random, folder)
    valves = list_valves(path)
    trace = read_trace(path, valves[0] if valves else None)
    assert np.isfinite(trace.pilot_position).all()
    assert np.all(np.diff(trace.times) > 0.0)
    assert np.isfinite(trace.drive.volts).all()


def try_table(random: Random, folder: Path) -> None:
    """Read a damaged table: no row may be lost without a word."""
    path = folder / "a.csv"
    whole = whole_table(random).encode()
    path.write_bytes(mutated(whole, [whole], random))
    table, trace = open_table(path), read_trace(path, None, map_from(TABLE_MAP, "map"))
    filled = sum(bool(line.strip()) for line in re.split("\r\n|\r|\n", table_text(path, TraceError)))
    said = bool(table.findings) or filled - table.rows <= len(TABLE_HEAD)
    assert said, f"{filled - table.rows} of {filled} lines are lost without a word"
    dropped = [int(found[1]) for line in trace.findings if (found := re.search(r"dropped (\d+)", line))]
    assert len(trace.times) + sum(dropped) >= table.rows, (
        f"{table.rows - len(trace.times)} rows are lost without a word"
    )
    assert np.isfinite(trace.pilot_position).all()
    assert np.all(np.diff(trace.times) > 0.0)


def try_file(random: Random, folder: Path) -> None:
    """Load a bad parameter file."""
    assert all(math.isfinite(value) for value in load_valve(bad_file(random, folder)).declared().values())


def any_commands(random: Random) -> list[tuple[float, float]]:
    """Up to six commands, s and V, of voltages that a coil gets, and of others."""
    times = np.sort(random.uniform(0.0, SECONDS, int(random.integers(1, 7))))
    volts = [float(random.choice([0.0, 9.0, -9.0, 30.0, random.uniform(-1e4, 1e4)])) for _ in times]
    return list(zip(times.tolist(), volts, strict=True))


def try_valve(random: Random, folder: Path) -> None:
    """Simulate a valve whole and in steps: all is finite, plungers stay between their contacts, events are in order."""
    valve, commands = any_valve(random), any_commands(random)
    response = simulate(valve, Drive.of(*zip(*commands, strict=True)), np.linspace(0.0, SECONDS, 200))
    for name in ("pilot_position", "main_position", "pilot_velocity", "coil_current", "attraction"):
        assert np.isfinite(getattr(response, name)).all(), name
    times = [event.time for event in response.events]
    assert times == sorted(times) and len(times) < MOST_EVENTS
    stepper, waiting = Stepper(valve), list(commands)
    for time in np.arange(step := 10.0 ** random.uniform(-5.0, -2.3), SECONDS, step).tolist():
        while waiting and waiting[0][0] <= time:
            stepper.command(*waiting.pop(0))
        assert all(math.isfinite(value) for value in stepper.advance(time)[:8])
    # A stop that gives way lets the plungers in beyond the stroke; a sensor shows another place.
    if not {"stop_compliance", *SENSORS} & valve.effects.keys():
        _are_between_contacts(valve, response)


def _are_between_contacts(valve: Valve, response: Response) -> None:
    """Plungers are between seat and stop, and where their phase says."""
    gap, stroke = valve.after_effects("pilot_gap", "stroke")
    pilot, main = response.pilot_position, response.main_position
    assert np.all((pilot >= -GENTLE) & (pilot <= stroke + GENTLE))
    assert np.all((main >= -GENTLE) & (main <= stroke - gap + GENTLE))
    for phase, place in ((Phase.CLOSED, 0.0), (Phase.GAP_HOLD, gap), (Phase.OPEN, stroke)):
        assert np.all(np.abs(pilot[response.phase == phase] - place) <= GENTLE), phase
    for event in response.events:
        assert -GENTLE <= event.position <= stroke + GENTLE and math.isfinite(event.velocity)


def any_gas(random: Random) -> Case:
    """A valve with gas of any size, that opens and closes, or does neither."""
    inlet, pilot = 10.0 ** random.uniform(5.5, 8.0), 10.0 ** random.uniform(-4.3, -2.8)
    gas = {
        "inlet_pressure": inlet,
        "outlet_pressure": inlet * random.choice([random.uniform(0.01, 1.5), 1.0, 1.0 - 1e-6]),
        "outlet_volume": 10.0 ** random.uniform(-6.5, -3.0),
        "pilot_orifice_diameter": pilot,
        "main_orifice_diameter": pilot * random.uniform(1.0, 20.0),
        "seat_diameter": pilot * random.uniform(1.0, 30.0),
        "demand_orifice_diameter": random.choice([0.0, 10.0 ** random.uniform(-5.0, -2.5)]),
        "demand_pressure": inlet * random.choice([random.uniform(0.001, 1.2), 1.0]),
    }
    drive = ((0.0, random.uniform(5.0, 16.0)), (random.uniform(0.01, 0.5), 0.0))
    return Case("any", gas, drive, 1.0, random.choice([0.0, 1e-9]), random.uniform(0.3, 1.0))


def try_gas(random: Random, folder: Path) -> None:
    """Simulate a valve with gas for a second.

    The line lies between a tank and a demand of constant pressure: its own stays between these and what it began with.
    """
    case = any_gas(random)
    run = ours(case, np.linspace(0.01, 1.0, 100))
    assert run.outlet_pressure is not None and run.mass_flow is not None
    bounds = [case.gas["inlet_pressure"], case.gas["outlet_pressure"]]
    bounds += [case.gas["demand_pressure"]] if case.gas["demand_orifice_diameter"] > 0.0 else []
    assert np.isfinite(run.mass_flow).all()
    assert np.all(run.outlet_pressure >= (1.0 - BEYOND) * min(bounds))
    assert np.all(run.outlet_pressure <= (1.0 + BEYOND) * max(bounds))


SURFACES: Final[dict[str, tuple[Callable[[Random, Path], str | None], int]]] = {
    "bags": (try_bag, 20_000),
    "parameter files": (try_file, 10_000),
    "valves": (try_valve, 100_000),
    "command lines": (lambda random, folder: try_command_line(random, folder, bad_bag, bad_file), 10_000),
    "recordings": (lambda random, folder: try_recording(int(random.integers(MOST_SLIPS))), 300),
    "valves with gas": (try_gas, 1_000),
    "tables": (try_table, 2_000),
}
"""What tries one input, and how many are tried; a new one comes last, for the place is a seed.

It raises a `ValveError` of one line where it refuses the input, of these a `SimulationError` where it gives up.
"""


def attempt(surface: str, number: int) -> tuple[str, str]:
    """What became of one input (taken, refused, given up or a finding), and the finding if it is one."""
    random = np.random.default_rng([list(SURFACES).index(surface), number])
    with tempfile.TemporaryDirectory(prefix="valve_sim-fuzz-") as folder:
        try:
            with limited():
                return SURFACES[surface][0](random, Path(folder)) or "taken", ""
        except (Exception, Hang) as error:
            if isinstance(error, ValveError) and "\n" not in str(error):
                return "given up" if isinstance(error, SimulationError) else "refused", ""
            return "finding", traceback.format_exc().strip()
