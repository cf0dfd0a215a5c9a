"""The generated pages of docs/reference are what the code's tables say."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from valve_sim.reference import Interface, interfaces

ROOT = Path(__file__).parents[1]


def test_the_reference_pages_are_up_to_date(tmp_path: Path) -> None:
    # In a process of its own: other tests register effects.
    subprocess.run([sys.executable, "-m", "valve_sim.reference", str(tmp_path)], cwd=ROOT, check=True)
    made = {path.name: path.read_text(encoding="utf-8") for path in tmp_path.iterdir()}
    committed = {name: (ROOT / "docs" / "reference" / name).read_text(encoding="utf-8") for name in made}
    assert {"topics.md", "parameters.md", "effects.md"} <= made.keys()
    assert made == committed, "run: python -m valve_sim.reference docs/reference"


def test_interfaces_are_read_from_a_nodes_source() -> None:
    source = """
def start(node):
    node.create_service(Trigger, "~/reset", done)
    node.create_subscription(Float64, "~/in", take, 10)
    node.create_subscription(Float64, f"{self._valve}/{self._what}", take, 10)
    node.create_publisher(Bool, "~/out", 10)
    node.create_timer(1.0, tick)
"""
    assert interfaces(source) == [
        Interface("~/out", "Bool", "out"),
        Interface("~/in", "Float64", "in"),
        Interface("<valve>/<what>", "Float64", "in"),
        Interface("~/reset", "Trigger", "service"),
    ]
