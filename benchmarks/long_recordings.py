"""What long recordings cost: `python -m benchmarks.long_recordings`, or with `--strokes 100 1000 10000`.

Strokes of 80 ms at 20 kHz, 1 µm noise and 0.1 µm steps, written by `simulate`; then `info`, `identify` and `validate`
as new processes. Printed are the CPU time of a process (user and system), what each stroke of it takes beyond what
starting takes, and the most memory that it held, less what is allowed for starting, by sample. Exits 1 where time grows
faster than the recording, or memory is above what is allowed. The bag of 10,000 strokes takes 4 GB among the temporary
files.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

ROOT: Final = Path(__file__).resolve().parents[1]
PERIOD: Final = 0.08
"""s, of a stroke."""
POWERED: Final = 0.04
"""s, of it under voltage."""
RATE: Final = 20_000
"""Samples a second."""
STROKES: Final = (100, 300, 1_000)
FLAT: Final = 1.2
"""The time of one stroke in a longer recording, over that in the shortest, at most."""
START_BYTES: Final = 250e6
"""Memory that a process may hold whatever the recording."""
BYTES_PER_SAMPLE: Final = 40.0
"""Memory that it may hold besides, for each sample of the recording."""
KIB: Final = 1024


class Cost(NamedTuple):
    """Of a process: CPU time, s, user and system, and the most memory it held, bytes."""

    seconds: float
    memory: float


def run(command: Sequence[str], log: Path) -> Cost:
    """Run `valve-sim` in a new process.

    Raises:
        SystemExit: it failed; its words are passed on.
    """
    with log.open("w") as words:
        process = os.posix_spawn(
            sys.executable,
            [sys.executable, "-m", "valve_sim", *command],
            os.environ,
            file_actions=[(os.POSIX_SPAWN_DUP2, words.fileno(), number) for number in (1, 2)],
        )
    _, status, usage = os.wait4(process, 0)
    if status != 0:
        raise SystemExit(f"valve-sim {' '.join(command)} failed:\n{log.read_text()[-2000:]}")
    return Cost(usage.ru_utime + usage.ru_stime, usage.ru_maxrss * KIB)


def write_recording(folder: Path, strokes: int) -> tuple[Path, Cost]:
    """A recording of so many strokes, and what writing it cost."""
    profile, bag = folder / "profile.csv", folder / f"{strokes}.mcap"
    rows = ["time,volts"]
    for stroke in range(strokes):
        on = 0.01 + PERIOD * stroke
        rows += [f"{on:.3f},9.0", f"{on + POWERED:.3f},0.0"]
    profile.write_text("\n".join(rows) + "\n")
    cost = run(
        [
            "simulate", "--profile", str(profile), "--duration", f"{PERIOD * strokes:.3f}", "--rate", str(RATE),
            "--noise-um", "1", "--quantisation-um", "0.1", "--output", str(bag),
        ],
        folder / "simulate.log",
    )  # fmt: skip
    return bag, cost


def measured(folder: Path, strokes: int, commands: Sequence[str]) -> dict[str, Cost]:
    """What writing a recording and each command on it cost."""
    bag, writing = write_recording(folder, strokes)
    costs = {"simulate": writing}
    arguments = {
        "info": ["info", str(bag)],
        "identify": ["identify", str(bag), "--output", str(folder / "fit")],
        "validate": ["validate", str(bag), "--params", str(ROOT / "config" / "valve.yaml"), "--tolerance-um", "17"],
    }
    for name in commands:
        costs[name] = run(arguments[name], folder / f"{name}.log")
    bag.unlink()
    return costs


def main() -> int:
    """Measure and print; 1 if time or memory grow faster than they may."""
    parser = argparse.ArgumentParser(description="What long recordings cost.")
    parser.add_argument("--strokes", type=int, nargs="+", default=list(STROKES))
    parser.add_argument("--commands", nargs="+", default=["info", "identify", "validate"])
    chosen = parser.parse_args()
    shortest: dict[str, float] = {}
    is_good = True
    print(
        "strokes  command   CPU, s  a stroke, ms  over the shortest  memory, MB  beyond 250 MB, B a sample", flush=True
    )
    with tempfile.TemporaryDirectory() as folder:
        # What a process takes to start, on a recording that is hardly one; the very first may compile.
        measured(Path(folder), 2, chosen.commands)
        start = measured(Path(folder), 2, chosen.commands)
        for strokes in sorted(chosen.strokes):
            samples = strokes * PERIOD * RATE
            for name, cost in measured(Path(folder), strokes, chosen.commands).items():
                stroke = (cost.seconds - start[name].seconds) / strokes
                growth = stroke / shortest.setdefault(name, stroke)
                per_sample = max((cost.memory - START_BYTES) / samples, 0.0)
                is_met = name == "simulate" or (growth <= FLAT and per_sample <= BYTES_PER_SAMPLE)
                is_good = is_good and is_met
                print(
                    f"{strokes:7}  {name:8} {cost.seconds:7.2f} {1e3 * stroke:13.2f} {growth:18.2f} "
                    f"{cost.memory / 1e6:11.0f} {per_sample:27.0f}  {'good' if is_met else 'SHORT'}",
                    flush=True,
                )
    return 0 if is_good else 1


if __name__ == "__main__":
    raise SystemExit(main())
