"""One search at a time, without ROS: the latest request counts, and what is no longer wanted is not told."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import pytest

from valve_sim.identification.diagnosis.outcome import Verdict
from valve_sim.identification.monitoring.fault_isolation import FaultFinding
from valve_sim.identification.monitoring.findings import Occasion
from valve_sim.nodes import monitor_work
from valve_sim.nodes.monitor_work import FaultIsolation, Found

Progress = Callable[[str, float], None]
PATIENCE = 120.0
"""s."""


class Search:
    """Stands for `isolate_fault`: begins, waits to be let go, reports progress, and finds one name for all strokes."""

    def __init__(self) -> None:
        self.name = "coulomb_friction"
        self.begun, self.let_go = threading.Semaphore(0), threading.Semaphore(0)
        self.running = self.most_running = 0

    def __call__(self, strokes: Any, baseline: Any, progress: Progress) -> Any:
        self.running += 1
        self.most_running = max(self.most_running, self.running)
        self.begun.release()
        assert self.let_go.acquire(timeout=PATIENCE)
        self.running -= 1
        progress("searched", 1.0)
        verdict = Verdict("effects", (self.name,), {self.name: ()}, 0.99, 0.0, 1.0, 6)
        return FaultFinding(verdict, {}, {}, {}, strokes[0])


@pytest.fixture
def search(monkeypatch: pytest.MonkeyPatch) -> Search:
    search = Search()
    monkeypatch.setattr(monitor_work, "isolate_fault", search)
    return search


def begin(isolation: FaultIsolation, number: int) -> None:
    isolation.begin([number], None, Occasion("/valve", number, 0))  # type: ignore[list-item,arg-type]


def end(isolation: FaultIsolation) -> None:
    while isolation._thread is not None and isolation._thread.is_alive():
        isolation._thread.join(PATIENCE)


def test_of_requests_during_a_search_only_the_latest_is_kept_and_each_finding_has_its_stroke(search: Search) -> None:
    told: list[Found] = []
    isolation = FaultIsolation(lambda found, is_new: told.append(found))
    begin(isolation, 1)
    assert search.begun.acquire(timeout=PATIENCE)
    for number in range(2, 100):
        begin(isolation, number)
    search.let_go.release(2)
    end(isolation)
    # The first alone may be wrong; the second one agrees with it.
    assert [(found.finding.strokes, found.occasion.stroke) for found in told] == [(99, 99)]
    assert isolation.found == told[-1]
    assert search.most_running == 1


def test_a_finding_is_new_where_it_names_something_else_or_the_valve_was_commissioned_anew(search: Search) -> None:
    told: list[bool] = []
    isolation = FaultIsolation(lambda found, is_new: told.append(is_new))

    def found(name: str) -> None:
        search.name = name
        begin(isolation, 1)
        search.let_go.release()
        end(isolation)

    for name in ("coulomb_friction",) * 3 + ("stiction",) * 2:
        found(name)
    isolation.forget()
    for _ in range(2):
        found("stiction")
    assert told == [True, False, True, True]


def test_a_valve_that_is_commissioned_anew_is_not_told_what_the_search_before_has_found(search: Search) -> None:
    told: list[Found] = []
    isolation = FaultIsolation(lambda found, is_new: told.append(found))
    begin(isolation, 1)
    assert search.begun.acquire(timeout=PATIENCE)
    isolation.forget()
    search.let_go.release()
    end(isolation)
    assert (told, isolation.found, isolation.failure) == ([], None, "")
    for number in (6, 7):
        begin(isolation, number)
        search.let_go.release()
        end(isolation)
    assert [found.occasion.stroke for found in told] == [7], "and the next search is wanted again"


def test_a_search_that_fails_is_told_and_the_next_one_begins(search: Search, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*arguments: Any) -> Any:
        raise IndexError("of nothing")

    isolation = FaultIsolation(lambda found, is_new: None)
    monkeypatch.setattr(monitor_work, "isolate_fault", fails)
    begin(isolation, 1)
    end(isolation)
    assert isolation.failure == "the fault could not be isolated: IndexError: of nothing"
    monkeypatch.setattr(monitor_work, "isolate_fault", search)
    for number in (2, 3):
        begin(isolation, number)
        search.let_go.release()
        end(isolation)
    assert isolation.failure == "" and isolation.found is not None
