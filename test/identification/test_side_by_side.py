"""Work in several threads: in order, ended by what is raised, and of the same outcome as in one."""

from __future__ import annotations

import os
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
from plants.declared import DeclaredPlant
from plants.recording import Profile, Recorder, holdout_profile, record, train_profile

from valve_sim.identification import side_by_side as module
from valve_sim.identification.diagnosis import diagnose
from valve_sim.identification.report_json import to_json
from valve_sim.identification.side_by_side import side_by_side
from valve_sim.model import Drive, Valve
from valve_sim.traces import Trace


@pytest.fixture(autouse=True)
def two_processors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 2)


def test_the_order_is_that_of_the_items() -> None:
    later_is_done = threading.Event()

    def work(item: int) -> int:
        if item == 0:
            assert later_is_done.wait(60.0)
        else:
            later_is_done.set()
        return -item

    announced: list[int] = []
    assert side_by_side(work, range(5), announced.append) == [0, -1, -2, -3, -4]
    assert announced == [0, 1, 2, 3, 4]


def test_what_is_raised_meanwhile_leaves_the_rest_undone(monkeypatch: pytest.MonkeyPatch) -> None:
    rest_is_cancelled, begun = threading.Event(), []

    class Pool(ThreadPoolExecutor):
        def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
            super().shutdown(wait=False, cancel_futures=cancel_futures)
            rest_is_cancelled.set()
            super().shutdown(wait=wait)

    def work(item: int) -> None:
        begun.append(item)
        assert rest_is_cancelled.wait(60.0)

    def interrupt(item: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "ThreadPoolExecutor", Pool)
    with pytest.raises(KeyboardInterrupt):
        side_by_side(work, range(100), interrupt)
    assert set(begun) <= {0, 1}


def test_what_the_work_raises_is_raised() -> None:
    with pytest.raises(ZeroDivisionError):
        side_by_side(lambda item: 1 // item, [1, 0])


def test_a_diagnosis_does_not_depend_on_the_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    plant = DeclaredPlant({"squeeze_film": {"coefficient": 5.0, "film_thickness": 3e-5}}, {})

    def trace(profile: Profile, seed: int) -> Trace:
        recording = record(plant, profile, Recorder(), seed)
        return Trace("", Drive(recording.command_times, recording.volts), recording.times, recording.pilot_position)

    bags = [trace(train_profile(), 1)], [trace(holdout_profile(), 2)]
    valve = Valve().with_values(a0=3.0336, coil_time_constant=0.9934e-3, coil_resistance=10.0)
    with_two = to_json(diagnose(*bags, valve))
    monkeypatch.setattr(module, "MOST_THREADS", 1)
    assert to_json(diagnose(*bags, valve)) == with_two
