"""What derivatives cost beside plain runs: `python -m benchmarks.derivatives`.

Eight strokes recorded at 20 kHz for 0.5 s. A plain run is one prediction as a fit asks for it; derivatives are the
Jacobian of that prediction to k declared numbers. Both in CPU time, medians, so that a busy machine tells nearly the
same story; and both in the compiled core alone, without what Python does around it. That they are right,
`test/model/test_sensitivities.py` shows. Exits 1 when the core is short of what is wanted.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Final

from benchmarks.coverage import as_trace, true_dampings
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.plants.protocol import Direction
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.model.core import runs

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "test"))
from plants.declared import CAMPAIGN_VALVE, DeclaredPlant
from plants.recording import Recorder, record, train_profile

SEED: Final = 3
REPEATS: Final = 61
COUNTS: Final = (1, 4, 8, 16)
"""Parameters to which derivatives are taken."""
JUDGED: Final = (4, 16)
"""Those of them for which a cost is wanted."""
WITHOUT_EFFECT: Final = ("coil_resistance", "reference_voltage", "release_voltage")
"""Declared numbers that are not differentiated here."""


def wanted(count: int) -> float:
    """Runs that derivatives to so many parameters may cost."""
    return 1.0 + 0.3 * count


class CoreTime:
    """CPU time of the compiled core alone: while it is in use, the core's entry is timed."""

    def __init__(self) -> None:
        self.spent = 0
        self._entry = runs.entry

    def __enter__(self) -> CoreTime:
        """Begin."""

        def timed(*arguments: object) -> object:
            before = time.thread_time_ns()
            found = self._entry("drive")(*arguments)
            self.spent += time.thread_time_ns() - before
            return found

        runs.entry = lambda name: timed if name == "drive" else self._entry(name)  # type: ignore[assignment]
        return self

    def __exit__(self, *_: object) -> None:
        """End."""
        runs.entry = self._entry


def cpu_times(works: Sequence[Callable[[], object]]) -> list[tuple[float, float]]:
    """Median CPU time of each call and of the compiled core in it, s; in turns, as neighbours on a machine change."""
    spent: list[list[tuple[int, int]]] = [[] for _ in works]
    with CoreTime() as timer:
        for turn in range(REPEATS + 1):
            for work, times in zip(works, spent, strict=True):
                timer.spent, before = 0, time.thread_time_ns()
                work()
                if turn > 0:  # the first is for warming up
                    times.append((time.thread_time_ns() - before, timer.spent))
    medians = ([statistics.median(part) for part in zip(*times, strict=True)] for times in spent)
    return [(1e-9 * whole, 1e-9 * core) for whole, core in medians]


def main() -> int:
    """Print the table; 1 if the core is short of what is wanted."""
    recorded = DeclaredPlant(parameters={**CAMPAIGN_VALVE, **true_dampings(SEED)})
    trace = as_trace(record(recorded, train_profile(), Recorder(quantisation=0.1e-6), SEED), f"seed {SEED}")
    valve = default_valve().exact()
    plant, declared = ValvePlant([trace], valve), valve.declared()
    ways = [
        Direction({name: 1.0}, 1e-7 * max(1e-3, abs(value)))
        for name, value in declared.items()
        if name not in WITHOUT_EFFECT
    ]
    works: list[Callable[[], object]] = [partial(plant.predict, {})]
    works += [partial(plant.sensitivities, {}, ways[:count]) for count in COUNTS]
    (run, core_run), *derived = cpu_times(works)
    print(f"a plain run of {len(trace.times)} samples: {1e6 * run:.0f} µs of CPU, {1e6 * core_run:.0f} µs in the core")
    is_good = True
    for count, (whole, core) in zip(COUNTS, derived, strict=True):
        is_judged = count in JUDGED
        is_met = core / core_run <= wanted(count)
        is_good = is_good and (is_met or not is_judged)
        judged = ("good" if is_met else "SHORT") if is_judged else ""
        print(
            f"derivatives to {count:2} numbers: {core / core_run:.2f} runs in the core, {whole / run:.2f} of a fit, "
            f"wanted at most {wanted(count):.1f}   {judged}"
        )
    return 0 if is_good else 1


if __name__ == "__main__":
    raise SystemExit(main())
