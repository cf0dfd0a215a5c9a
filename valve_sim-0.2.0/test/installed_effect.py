"""An effect of one file, installed in a folder of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

MAGNET_DRAG = """
from valve_sim.model import Effect, Parameter


def drag(x: float, v: float, u: float, t: float, force: float, speed: float) -> float:
    return -force * 2.0 * v * speed / (v * v + speed * speed)


EFFECT = Effect(
    "magnet_drag",
    "drag of eddy currents in a conducting guide",
    (
        Parameter("force", "N", "largest drag", 0.0, 100.0, 0.1, 0.0),
        Parameter("speed", "m/s", "speed at which it is largest", 1e-3, 10.0, 0.1),
    ),
    "Saslow, Am. J. Phys. 60 (1992) 693",
    term=drag,
    confused_with=("coulomb_friction",),
)
"""
PARAMETERS = "/**:\n  ros__parameters:\n    effects:\n      magnet_drag: {force: 0.4, speed: 0.05}\n"


class Installed:
    """A folder on PYTHONPATH as pip leaves it: one module, and the metadata that name its entry point."""

    def __init__(self, folder: Path, source: str, target: str = "magnet_drag:EFFECT") -> None:
        metadata = folder / "magnet_drag-1.0.dist-info"
        metadata.mkdir(parents=True)
        (folder / "magnet_drag.py").write_text(source)
        (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: magnet-drag\nVersion: 1.0\n")
        (metadata / "entry_points.txt").write_text(f"[valve_sim.effects]\nmagnet_drag = {target}\n")
        known = filter(None, [os.environ.get("PYTHONPATH")])
        self.environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), *known])}

    def run(self, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, *map(str, arguments)]
        return subprocess.run(command, env=self.environment, capture_output=True, text=True, timeout=300, check=False)

    def valve_sim(self, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
        return self.run("-m", "valve_sim", *arguments)
