"""Compiled code is kept by its content, in a place that is the user's own, and works where nothing can be kept."""

from __future__ import annotations

import ctypes
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from model.core.cases import DRAWN
from valve_sim.model import simulate
from valve_sim.model.core import layout, machine, plan
from valve_sim.model.core.machine import made_once
from valve_sim.model.runs import WIDTHS, Directions, Run
from valve_sim.model.simulation import commands_of

TEXT = "define double @twice(double %x) {\n  %y = fadd double %x, %x\n  ret double %y\n}\n"


def call(library: machine.Library) -> float:
    return float(ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)(library.address("twice"))(21.0))


def test_code_is_compiled_once_and_loaded_thereafter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VALVE_SIM_CACHE", str(tmp_path / "new"))
    made: list[int] = []

    def text() -> str:
        made.append(1)
        return TEXT

    for _ in range(3):
        assert call(machine.library("twice", text)) == 42.0
    assert len(made) == 1 and len(list((tmp_path / "new").iterdir())) == 1
    assert call(machine.library("another key", text)) == 42.0
    assert len(made) == 2


@pytest.mark.parametrize("kind", DRAWN)
def test_better_code_gives_the_same_numbers_to_the_last_bit(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    draw, times = DRAWN[kind]
    for seed in range(4, 6):
        monkeypatch.setenv("VALVE_SIM_CACHE", str(tmp_path / str(seed)))  # where nothing is that was compiled well
        plan._kept_plan.cache_clear()
        valve, drive = draw(seed)
        directions = Directions.of(valve, drive, ["main_damping", "a0", "moving_mass", "stroke", "spring_preload"])
        found, code = [], set()
        for runs in (1, plan.OFTEN):
            code.add(valve.plan(WIDTHS[-1], runs).blank[layout.LOOK])
            whole, run = simulate(valve, drive, times), Run(valve, 0.0, directions=directions)
            sloped = run.piece(commands_of(drive), times[-1], times)
            found.append([own.tobytes() for own in (whole.pilot_velocity, whole.coil_current, sloped.of_positions)])
            valve.plan(0, plan.OFTEN)
        assert found[0] == found[1] and len(code) == 2


def test_without_any_folder_code_is_held_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VALVE_SIM_CACHE", "relative")
    assert call(machine.library("twice", lambda: TEXT)) == 42.0


def test_what_threads_ask_for_at_once_is_made_once_and_kept() -> None:
    """A second one would take the first one's place, whose code is then freed while a thread runs it."""
    made, together = [], threading.Barrier(8)

    @made_once
    def slow(number: int) -> object:
        made.append(number)
        time.sleep(0.02)  # not to be right: so that threads which do not wait for each other would be seen
        return object()

    def ask(number: int) -> object:
        together.wait()
        return slow(number % 2)

    with ThreadPoolExecutor(8) as threads:
        found = list(threads.map(ask, range(8)))
    assert sorted(made) == [0, 1]
    assert len({id(one) for one in found}) == 2
