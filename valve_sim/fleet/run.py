"""A whole run: list, look, plan, examine, write; and the Dask client that does the work."""

from __future__ import annotations

import functools
import logging
import signal
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeVar

from valve_sim.files.whole_files import write_whole
from valve_sim.fleet.page import write_page
from valve_sim.fleet.sources import Bag, find_bags, one_line
from valve_sim.fleet.table import locked, read_rows, write_rows
from valve_sim.fleet.units import EXAMINED, LOST, Options, ParameterChoice, Row, Survey, plan, remembered, row_of
from valve_sim.fleet.work import REPORTS, examine, look
from valve_sim.model.errors import ValveError

Progress = Callable[[str, float], None]
Client = Any
"""A client of Dask on any cluster whose workers can read the sources; or a function that gives one, which is called
if there is work; or None: the work is done in this process."""

TABLE: Final = "fleet.parquet"
PAGE: Final = "fleet.html"
SAVED_EVERY: Final = 60.0
"""s between two states of the table on disk: what a crash may cost."""
RETRIES: Final = 2
"""Times that work is tried again which failed through no fault of its bag."""
LOOKED: Final = 0.1
"""Share of the progress that is shown for a first look at all bags."""
ANSWERS_WITHIN: Final = 30.0
"""s within which a scheduler must answer."""
_SETTINGS: Final = {
    # A unit may compute for a minute without letting the event loop of its worker speak.
    "distributed.scheduler.worker-ttl": "30 minutes",
    "distributed.admin.tick.limit": "1 h",
    # Dask's profile of a worker grows by 10 MB a minute, for an hour.
    "distributed.worker.profile.enabled": False,
}
Item = TypeVar("Item")
Answer = TypeVar("Answer")


class Outcome(NamedTuple):
    """What a run did: all rows, how many it made, table and page, and the valves that drift, in words, surest first."""

    rows: list[Row]
    done: int
    files: tuple[Path, ...]
    drifting: list[str]

    @property
    def states(self) -> Counter[str]:
        """Rows of each state."""
        return Counter(row["state"] for row in self.rows)

    @property
    def verdicts(self) -> Counter[str]:
        """Examined valves of each verdict."""
        return Counter(row["verdict"] for row in self.rows if row["state"] == EXAMINED)


def examine_fleet(
    sources: Sequence[str],
    output: Path,
    client: Client = None,
    parameters: ParameterChoice | None = None,
    options: Options | None = None,
    progress: Progress | None = None,
) -> Outcome:
    """Examine every valve of every bag, as far as that is not done yet.

    Args:
        sources: bags, folders, globs, URLs.
        output: the folder of table, page and reports.
        parameters: the declared valves; default the shipped one.
        progress: told what is being done, and the fraction done.

    Raises:
        ValveError: a source, a parameter file or the output cannot be used, or the cluster was lost. What was done
            until then is written.
    """
    parameters, options = parameters or ParameterChoice(), options or Options()
    say = progress or (lambda what, fraction: None)
    parameters.check()
    with locked(output):
        say("listing bags", 0.0)
        bags = find_bags(sources)
        earlier = read_rows(output / TABLE)
        surveys = _known_surveys(bags, earlier, options)
        lost: list[Row] = []
        new = [bag for bag in bags if bag.source not in surveys]
        for done, (bag, survey) in enumerate(_done(client, look, new), start=1):
            if isinstance(survey, Exception):
                lost.append(row_of(bag, Survey("", ()), LOST, key="", error=_lost(bag, survey)))
            else:
                surveys[bag.source] = survey
            say(f"bags looked at: {done} of {len(new)}", LOOKED * done / len(new))
        units, rows = plan(
            [(bag, surveys[bag.source]) for bag in bags if bag.source in surveys], parameters, options, earlier
        )
        rows += lost
        keys, listed = {*(row["key"] for row in rows), *(unit.key for unit in units)}, {bag.source for bag in bags}
        rows += [row for row in earlier if row["source"] not in listed and row["key"] not in keys]
        of_before = {row["key"] for row in earlier}
        done = len(units) + sum(row["key"] not in of_before for row in rows)
        saved, pause = time.monotonic(), SAVED_EVERY
        try:
            for count, (unit, answer) in enumerate(_done(client, partial(examine, output=output), units), start=1):
                if isinstance(answer, Exception):
                    rows.append(unit.row(LOST, error=_lost(unit.bag, answer)))
                else:
                    for name, text in answer.report.items():
                        write_whole(output / REPORTS / Path(answer.row["report"]).parent.name / name, text)
                    rows.append(answer.row)
                say(f"valves examined: {count} of {len(units)}", LOOKED + (1.0 - LOOKED) * count / len(units))
                if (begun := time.monotonic()) > saved + pause:
                    write_rows(output / TABLE, rows)
                    saved = time.monotonic()
                    pause = max(SAVED_EVERY, 20.0 * (saved - begun))
        finally:
            say("writing", 1.0)
            write_rows(output / TABLE, rows)
        drifting = write_page(rows, output / PAGE)
    return Outcome(rows, done, (output / TABLE, output / PAGE), drifting)


def new_bags(sources: Sequence[str], output: Path, options: Options) -> tuple[list[Bag], list[Bag]]:
    """All bags of the sources, and those among them that were never read with this output or were written since.

    Raises:
        ValveError: a source or the table cannot be used.
    """
    bags = find_bags(sources)
    surveys = _known_surveys(bags, read_rows(output / TABLE), options)
    return bags, [bag for bag in bags if bag.source not in surveys]


def _known_surveys(bags: Sequence[Bag], earlier: Sequence[Row], options: Options) -> dict[str, Survey]:
    """What is known of bags that need not be opened, by source: they are too large, or in the table."""
    by_source: dict[str, list[Row]] = defaultdict(list)
    for row in earlier:
        by_source[row["source"]].append(row)
    surveys: dict[str, Survey] = {}
    for bag in bags:
        if bag.size > options.largest:
            words = f"{bag.size / 1e9:.3g} GB are more than the {options.largest / 1e9:.3g} GB of --largest-bag"
            surveys[bag.source] = Survey("", (), f"{bag.source}: {words}; cut it, or allow more")
        elif (survey := remembered(bag, by_source[bag.source])) is not None:
            surveys[bag.source] = survey
    return surveys


def _lost(bag: Bag, error: Exception) -> str:
    if type(error).__name__ == "KilledWorker":
        return f"{bag.source}: the process that worked on it was killed each time, out of memory perhaps"
    return f"{bag.source}: {type(error).__name__}: {one_line(error)}"


# --- Dask -----------------------------------------------------------------------------------------------------------


def _done(
    client: Client, work: Callable[[Item], Answer], items: Sequence[Item]
) -> Iterator[tuple[Item, Answer | Exception]]:
    """Each item with its answer, or with why there is none, in the order in which they are ready."""
    if not items:
        return
    client = client() if callable(client) else client
    if client is None:
        for item in items:
            try:
                answer: Answer | Exception = work(item)
            except Exception as error:
                answer = error
            yield item, answer
        return
    from distributed import as_completed

    asked = dict(zip(client.map(work, items, pure=False, retries=RETRIES), items, strict=True))
    for future in as_completed(list(asked), loop=client.loop):
        try:
            answer = future.result()
        except Exception as error:
            if client.status != "running":
                raise ValveError("the scheduler was lost; run the same command again") from error
            answer = error
        yield asked.pop(future), answer
        future.release()


@contextmanager
def dask_client(scheduler: str | None, workers: int | None) -> Iterator[Callable[[], Any]]:
    """A function that gives a client of Dask, connected or with a cluster of its own once it is called.

    Args:
        scheduler: such as tcp://10.0.0.1:8786; None: processes on this machine.
        workers: how many of these; None: one for each processor.
    """
    with ExitStack() as stack:
        yield functools.cache(partial(_connected, stack, scheduler, workers))


def _connected(stack: ExitStack, scheduler: str | None, workers: int | None) -> Any:
    import dask
    from distributed import Client, LocalCluster  # before the settings, which would take its defaults with them

    stack.enter_context(dask.config.set(_SETTINGS))
    for name in [name for name in logging.root.manager.loggerDict if name.partition(".")[0] == "distributed"]:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)  # what is lost is one line, of ours
    if scheduler is not None:
        try:
            return stack.enter_context(Client(scheduler, timeout=ANSWERS_WITHIN, set_as_default=False))
        except (OSError, ValueError) as error:
            raise ValveError(
                f"{scheduler}: no Dask scheduler answers ({one_line(error)}); start one with `dask scheduler`, or "
                "leave --scheduler out"
            ) from error
    from valve_sim.warm import warm

    warm()  # once, not in each worker
    with _interrupts_left_to_this_process():
        cluster = LocalCluster(
            n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs="CRITICAL",
            # What Dask serves by HTTP, without a dashboard too: for this machine, and not where another run does.
            scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
        )  # fmt: skip
        stack.enter_context(cluster)
    return stack.enter_context(Client(cluster, set_as_default=False))


@contextmanager
def _interrupts_left_to_this_process() -> Iterator[None]:
    """Processes that start here, and those that replace them, leave Ctrl-C to this one, which ends them.

    They inherit that it is blocked. One that comes meanwhile is not lost: it counts once they have started.
    """
    resource_tracker.ensure_running()  # what starts it would unblock Ctrl-C
    is_main = threading.current_thread() is threading.main_thread()
    came: list[int] = []
    # Another thread of this process may take what is blocked in this one; its handler is called here all the same.
    handler = signal.signal(signal.SIGINT, lambda number, frame: came.append(number)) if is_main else None
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if is_main:
            signal.signal(signal.SIGINT, handler)
    if came:
        signal.raise_signal(signal.SIGINT)
