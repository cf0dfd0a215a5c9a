"""`python -m benchmarks`: what can be measured, by which command, and what each takes.

What each takes is an order of magnitude on two cores, with the options that are printed.
"""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Final

HERE: Final = Path(__file__).parent
COMMANDS: Final[dict[str, dict[str, str]]] = {
    "Model": {
        "speed": "ten minutes",
        "accuracy --sets 100": "minutes",
    },
    "Fit and diagnosis, by independent plants": {
        "coverage --seeds 200": "minutes",
        "campaign --slice": "ten minutes",
        "campaign --only hard --seeds 1": "up to 60 s a case, 50 cases",
        "campaign --only coil_none,coil_single": "up to 2 minutes a case, 6 a seed",
        "campaign --only outlet_none,outlet_single": "up to 2 minutes a case, 4 a seed",
        "campaign --only mistake --seeds 1": "minutes",
        "campaign --only actuator --seeds 1": "up to 10 s a case, 200 a seed: machines of plant files",
    },
    "Monitor": {
        "monitoring healthy growth --strokes 10000 --seeds 10": "hours",
        "monitoring laboratory --strokes 3340": "hours",
        "monitoring coil gas --seeds 12": "half an hour",
    },
    "Nodes, which need ROS 2": {
        "nodes.timing": "minutes, on a quiet machine",
        "nodes.station --seconds 60": "minutes, on a quiet machine",
        "nodes.station --busy 1000": "ten minutes",
    },
    "Hard use": {"fuzz --share 0.01": "minutes", "fuzz --only topics": "minutes, needs ROS 2"},
    "Tests": {"mutation identification/fit": "ten minutes"},
}
"""What is typed behind `python -m benchmarks.`, and what it takes; `test_benchmarks.py` holds that none is missing."""


def question(command: str) -> str:
    """What a command answers: the first words of its module's docstring."""
    path = HERE / command.partition(" ")[0].replace(".", "/")
    text = (path / "__init__.py" if path.is_dir() else path.with_suffix(".py")).read_text(encoding="utf-8")
    return (ast.get_docstring(ast.parse(text)) or "").partition("`python -m")[0].rstrip(" :")


if __name__ == "__main__":
    for group, commands in COMMANDS.items():
        print(f"\n{group}")
        for command, cost in commands.items():
            print(f"  python -m benchmarks.{command}\n      {question(command)} ({cost})")
