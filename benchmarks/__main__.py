"""`python -m benchmarks`: what can be measured, by which command, and what each takes.

What each takes is an order of magnitude on two cores, with the options that are printed.
"""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import Final, NamedTuple

HERE: Final = Path(__file__).parent
ROS: Final = "ROS 2"


class Benchmark(NamedTuple):
    """One command: its module and options, what it needs beside the package, and what it costs on two cores."""

    module: str
    needs: str
    cost: str
    options: str = ""

    @property
    def command(self) -> str:
        """What is typed."""
        return f"python -m benchmarks.{self.module} {self.options}".rstrip()

    @property
    def question(self) -> str:
        """The first line of the module's docstring, without its command."""
        path = HERE / self.module.replace(".", "/")
        text = (path / "__main__.py" if path.is_dir() else path.with_suffix(".py")).read_text(encoding="utf-8")
        words = (ast.get_docstring(ast.parse(text)) or "").split("\n\n")[0].replace("\n", " ")
        without_command = re.sub(r"`python -m[^`]*`", "", words).replace("`", "").strip(" :.,")
        return re.split(r"(?<=\?) |\. |, or with|:  ", without_command)[0].rstrip(" :")


GROUPS: Final[dict[str, tuple[Benchmark, ...]]] = {
    "Model": (
        Benchmark("speed", "", "ten minutes"),
        Benchmark("speed", "4 GB of temporary files", "minutes", "long --strokes 100 1000 10000"),
        Benchmark("accuracy", "", "minutes", "--sets 100"),
    ),
    "Fit and diagnosis, by independent plants": (
        Benchmark("coverage", "", "minutes", "--seeds 200"),
        Benchmark("campaign", "", "ten minutes", "--slice"),
        Benchmark("campaign", "", "up to 60 s a case, 50 cases", "--only hard --seeds 1"),
        Benchmark("campaign", "", "up to 2 minutes a case, 6 a seed", "--only coil_none,coil_single"),
        Benchmark("campaign", "", "up to 2 minutes a case, 4 a seed", "--only outlet_none,outlet_single"),
        Benchmark("campaign", "", "minutes", "--only mistake --seeds 1"),
    ),
    "Machines of plant files": (
        Benchmark("campaign", "", "up to 10 s a case, 200 a seed", "--only actuator --seeds 1"),
    ),
    "Monitor": (
        Benchmark("monitoring", "", "hours", "healthy growth --strokes 10000 --seeds 10"),
        Benchmark("monitoring", "", "hours", "laboratory --strokes 3340"),
        Benchmark("monitoring", "", "half an hour", "coil gas --seeds 12"),
    ),
    "Nodes": (
        Benchmark("nodes.timing", f"{ROS}, a quiet machine", "minutes"),
        Benchmark("nodes.station", f"{ROS}, a quiet machine", "minutes", "--seconds 60"),
        Benchmark("nodes.station", ROS, "ten minutes", "--busy 1000"),
    ),
    "Hard use": (
        Benchmark("fuzz", "", "minutes for each --share 0.01", "--share 0.01"),
        Benchmark("fuzz", ROS, "minutes", "--only topics"),
    ),
    "Tests": (Benchmark("mutation", "", "ten minutes", "identification/fit"),),
}
"""What can be run; `test_benchmarks.py` holds that no program is left out."""


def main() -> None:
    """Print the list."""
    for group, members in GROUPS.items():
        print(f"\n{group}")
        for own in members:
            needs = f"; needs {own.needs}" if own.needs else ""
            print(f"  {own.command}\n      {own.question} ({own.cost}{needs})")


if __name__ == "__main__":
    main()
