"""Work in several threads: in order, and ended by what is raised."""

from __future__ import annotations

import os
import threading

import pytest

from valve_sim.identification.estimation.parallel import Memo, run_parallel, threads_limited_to


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
    assert run_parallel(work, range(5), announced.append) == [0, -1, -2, -3, -4]
    assert announced == [0, 1, 2, 3, 4]


def test_an_interrupt_leaves_the_rest_undone_and_does_not_wait_for_what_never_returns() -> None:
    never, begun = threading.Event(), []

    def work(item: int) -> None:
        begun.append(item)
        never.wait(60.0)

    def interrupt(item: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_parallel(work, range(100), interrupt)
    assert not never.is_set()
    never.set()
    assert set(begun) <= {0, 1}


def test_a_limit_holds_for_the_work_that_it_is_for() -> None:
    with threads_limited_to(1):
        assert len(set(run_parallel(lambda item: threading.get_ident(), range(4)))) == 1
    both = threading.Barrier(2)
    run_parallel(lambda item: both.wait(60.0), range(2))  # ends only where two are at work


def test_a_result_that_several_threads_ask_for_is_computed_once() -> None:
    asked, go_on = threading.Event(), threading.Event()
    computed = []

    def work(key: int) -> int:
        computed.append(key)
        asked.set()
        go_on.wait()
        return key * key

    memo = Memo(work)
    results = []
    threads = [threading.Thread(target=lambda: results.append(memo(3))) for _ in range(4)]
    threads[0].start()
    asked.wait()
    for thread in threads[1:]:
        thread.start()
    go_on.set()
    for thread in threads:
        thread.join()
    assert (results, computed) == ([9, 9, 9, 9], [3])
