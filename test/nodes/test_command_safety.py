"""docs/reference/command_safety.md, cell by cell: which voltage is on the coil after what.

Without ROS, by a clock that is moved by hand.

The page's table is what is tested: a cell that is changed there is another test, and one without a test fails.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from valve_sim.files.parameter_files import default_valve
from valve_sim.model import Drive, SimulationError, Stepper, simulate
from valve_sim.nodes.live_machine import Step
from valve_sim.nodes.live_valve import LiveValve
from valve_sim.nodes.realtime import NANOSECONDS, ClockReading, Restart, Worker

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "command_safety.md"
TIMEOUT = 0.2
LARGEST = 30.0
COMMANDED = 9.0
MILLISECOND = 1_000_000


class Bench:
    """A valve, a worker, and a clock that a script moves: each action is taken when the worker would sleep."""

    def __init__(self) -> None:
        self.live = LiveValve(default_valve(), command_timeout=TIMEOUT, max_voltage=LARGEST)
        self.reading: ClockReading | None = ClockReading(1000 * NANOSECONDS, True)
        self.steps: list[Step] = []
        self.errors: list[Exception] = []
        self.failing: list[str] = []
        self._script: list[Callable[[], object]] = []
        self._worker = Worker(
            self, 1000.0, prepare=lambda: None, restart=self._restart, step=self._step, fail=self.errors.append
        )

    def run(self, *script: Callable[[], object]) -> None:
        """The script, to its end."""
        self._script = list(script)
        self._worker.run()
        assert self.errors == []

    @property
    def state(self) -> str:
        """By the page's name; it is meant while the clock moves."""
        if self.live.timed_out:
            return "timed out"
        return "no command" if self.live.last_command is None else "holds"

    @property
    def now(self) -> int:
        return 0 if self.reading is None else self.reading.nanoseconds

    # --- a PaceClock ---

    def read(self) -> ClockReading | None:
        return self.reading

    def sleep_until(self, time: int) -> None:
        if self._script:
            self._script.pop(0)()
        else:
            self._worker.stop(0.0)

    def wake(self) -> None:
        pass

    # --- what a script is made of ---

    def move(self, seconds: float) -> None:
        """Time goes on; the first move begins it."""
        self.reading = ClockReading((self.now or 1000 * NANOSECONDS) + round(seconds * NANOSECONDS), True)

    def go_on(self) -> None:
        """Some steps more, fewer than the timeout has."""
        self.move(0.01)

    def silence_clock(self) -> None:
        self.reading = None

    def take_other_clock(self) -> None:
        self.reading = ClockReading(self.now + 1, False)

    def command(self, volts: float) -> bool:
        return self.live.command(self.now, volts)

    def _restart(self, restart: Restart) -> None:
        self.live.restart(restart.reading.nanoseconds, restart.reading.nanoseconds)

    def _step(self, deadline: int) -> None:
        self.steps.append(self.live.step(deadline))


Script = list[Callable[[], object]]


def commanded(bench: Bench) -> Script:
    return [lambda: bench.command(COMMANDED), bench.go_on]


STATES: dict[str, Callable[[Bench], Script]] = {
    "no command": lambda bench: [bench.go_on],
    "holds": commanded,
    "timed out": lambda bench: [*commanded(bench), lambda: bench.move(2 * TIMEOUT)],
    "clock still": commanded,
    "no clock": lambda bench: [bench.silence_clock],
}
"""What brings a bench into a state; between actions nothing moves, so `clock still` is `holds` without a move."""


def command_of(*values: float) -> list[tuple[str, Callable[[Bench], Script], float]]:
    return [(f"{volts:g} V", lambda bench, volts=volts: [lambda: bench.command(volts)], volts) for volts in values]


def event(name: str, make: Callable[[Bench], Script]) -> tuple[str, Callable[[Bench], Script], float]:
    return name, make, math.nan


EVENTS: dict[str, list[tuple[str, Callable[[Bench], Script], float]]] = {
    "good": command_of(5.0, -5.0, LARGEST, -LARGEST, 5e-324, 2.3e-308),
    "0 V": command_of(0.0, -0.0),
    "bad": command_of(math.nan, math.inf, -math.inf, 1e308, -1e308, math.nextafter(LARGEST, math.inf), -31.0),
    "silence": [event("silence", lambda bench: [lambda: bench.move(1.5 * TIMEOUT)])],
    "reset": [event("reset", lambda bench: [lambda: bench.live.reset(bench.now)])],
    "lower limit": [event("7 V", lambda bench: [lambda: bench.live.limit(bench.now, 7.0)])],
    "clock jumps": [
        event("back", lambda bench: [bench.go_on, lambda: bench.move(-0.5)]),
        event("ahead", lambda bench: [bench.go_on, lambda: bench.move(61.0)]),
        event("another", lambda bench: [bench.go_on, bench.take_other_clock, bench.take_other_clock]),
    ],
    "5 s lost": [event("5 s", lambda bench: [bench.go_on, lambda: bench.move(5.0)])],
    "failure": [event("failure", lambda bench: [lambda: bench.failing.append("too stiff"), bench.go_on])],
}
"""By the page's name: each kind of it, what happens, and the voltage that it brings."""


def page_table() -> dict[tuple[str, str], str]:
    """(state, event) to the cell's words."""
    section = PAGE.read_text().split("## Table")[1].split("## What else")[0]
    rows = [[cell.strip() for cell in line.strip("|\n").split("|")] for line in re.findall(r"^\|.*$", section, re.M)]
    events = [cell.strip("`") for cell in rows[0][1:]]
    return {
        (row[0].strip("`"), name): cell for row in rows[2:] for name, cell in zip(events, row[1:], strict=True)
    }  # fmt: skip


CELLS = page_table()
CASES = [
    pytest.param(state, name, number, id=f"{state}-{name}-{EVENTS[name][number][0]}")
    for state, name in CELLS
    for number in range(len(EVENTS.get(name, ())))
]


def test_the_page_lists_the_cells_that_are_tested_and_no_others() -> None:
    assert list(CELLS) == list(itertools.product(STATES, EVENTS))
    assert {(case.values[0], case.values[1]) for case in CASES} == set(CELLS)
    text = PAGE.read_text()
    explained = [re.findall(r"^\| `([^`]+)` \|", part, re.M) for part in text.split("\n## ")[1:3]]
    assert explained == [list(STATES), list(EVENTS)]


@pytest.mark.parametrize(("state", "name", "number"), CASES)
def test_cell(state: str, name: str, number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    _, make, volts = EVENTS[name][number]
    bench = Bench()
    # Once, when a script asks for it: no valve that can be declared fails on demand.
    advance = Stepper.advance

    def advance_or_fail(self: Stepper, time: float) -> object:
        if bench.failing:
            raise SimulationError(bench.failing.pop())
        return advance(self, time)

    monkeypatch.setattr(Stepper, "advance", advance_or_fail)
    seen: list[tuple[str, float]] = []

    def look() -> None:
        seen.append((bench.state, bench.live.volts))

    # While a clock stands still silence is the wall's, and no move.
    happens = [] if name == "silence" and state in ("clock still", "no clock") else make(bench)
    good_again = [lambda: bench.command(7.0), bench.go_on, look]
    bench.run(*STATES[state](bench), look, *happens, bench.go_on, look, *good_again)
    assert seen[0][0] == {"clock still": "holds", "no clock": "no command"}.get(state, state)
    after, on_coil = CELLS[state, name].split(": ")
    expected = volts if on_coil == "new" else float(on_coil.removesuffix(" V"))
    assert seen[1:] == [(after, expected), ("holds", 7.0)], "and then, the next good command is obeyed"
    assert bench.live.failures == (name == "failure")


@pytest.mark.parametrize("clock", ["still", "none"])
def test_nothing_moves_while_no_time_passes(clock: str) -> None:
    bench = Bench()
    before: list[int] = []
    script = [bench.silence_clock] if clock == "none" else [bench.go_on]
    commands = [lambda: bench.command(COMMANDED)] * 3
    bench.run(*script, lambda: before.append(len(bench.steps)), *commands, lambda: before.append(len(bench.steps)))
    assert before[0] == before[1]
    assert bench.live.volts == 0.0


def test_the_coil_was_off_since_the_deadline_and_not_since_it_was_seen() -> None:
    bench = Bench()
    bench.run(*commanded(bench), lambda: bench.move(5.0))
    expected = simulate(default_valve(), Drive.of([0.0, TIMEOUT], [COMMANDED, 0.0]), [5.01], start_time=0.0)
    assert bench.steps[-1].reading.pilot_position == pytest.approx(expected.pilot_position[0], abs=1e-12)
    assert bench.steps[-1].reading.main_position == 0.0


@pytest.mark.parametrize("what", ["timeout", "command"])
def test_what_has_been_published_is_not_taken_back(what: str) -> None:
    bench = Bench()
    bench.live.command_timeout = 0.0
    before: list[float] = []

    def late() -> None:
        before.append(bench.steps[-1].reading.pilot_position)
        if what == "timeout":
            bench.live.command_timeout = TIMEOUT
        else:
            bench.live.command(bench.now - NANOSECONDS, 0.0)

    bench.run(*commanded(bench), *[lambda: bench.move(0.4)] * 5, late, lambda: bench.move(1e-3), bench.go_on)
    at = len(bench.steps) - 11
    assert before == [1.23e-3]
    assert bench.steps[at].reading.pilot_position == pytest.approx(1.23e-3, abs=1e-9)
    assert bench.steps[at].reading.coil_current > 0.3
    assert bench.live.volts == 0.0
    assert bench.steps[-1].reading.pilot_position < 1.2e-3
