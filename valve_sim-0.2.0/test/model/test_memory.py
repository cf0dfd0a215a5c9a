"""Memory of the compiled core: what a run still uses is not freed."""

from __future__ import annotations

import os
import subprocess
import sys

RUNS_IN_THREADS = """
from concurrent.futures import ThreadPoolExecutor
import numpy as np
from valve_sim.files.parameter_files import default_valve
from valve_sim.model import Drive, simulate

valve, times = default_valve(), np.linspace(0.0, 0.1, 1000)
drive = Drive.of([0.0, 0.05], [9.0, 0.0])

def run(_):
    found = simulate(valve, drive, times)
    return found.pilot_position.tobytes() + found.coil_current.tobytes()

with ThreadPoolExecutor(6) as pool:
    print(len(set(pool.map(run, range(1500)))))
"""


def test_runs_in_threads_that_share_one_heap_keep_what_they_use() -> None:
    # One heap for all threads, without a store of each thread's own: freed memory is at once another thread's.
    heap = {"GLIBC_TUNABLES": "glibc.malloc.arena_max=1:glibc.malloc.tcache_count=0"}
    run = subprocess.run(
        [sys.executable, "-c", RUNS_IN_THREADS], env=os.environ | heap, capture_output=True, text=True, timeout=300,
        check=False,
    )  # fmt: skip
    assert (run.returncode, run.stdout.strip()) == (0, "1"), run.stderr
