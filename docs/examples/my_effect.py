"""An effect of your own: eddy drag, a force that rises with speed and fades again, as a magnet's over copper does.

Run it: `python docs/examples/my_effect.py`. It registers the effect, records strokes of a valve that has it, and asks
the diagnosis what a valve declared without it lacks.
"""

from __future__ import annotations

import numpy as np

from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.diagnosis.run import Diagnosis, diagnose
from valve_sim.identification.reporting.claims import summarise
from valve_sim.model import CATALOGUE, Drive, Valve
from valve_sim.model.effects import Effect
from valve_sim.model.parameters import Parameter
from valve_sim.recordings.synthetic import Sensor, record


def eddy_drag(x: float, v: float, u: float, t: float, force: float, speed: float) -> float:
    """The force on the plunger, N, + opens; plain arithmetic, which is compiled when it is first used."""
    return -force * 2.0 * v * speed / (v * v + speed * speed)


EDDY_DRAG = Effect(
    name="eddy_drag",
    summary="drag of eddy currents in a conducting guide",
    parameters=(
        Parameter("force", "N", "largest drag", 0.0, 100.0, 0.1, 0.0),
        Parameter("speed", "m/s", "speed at which it is largest", 1e-3, 10.0, 0.1),
    ),
    source="Saslow, Am. J. Phys. 60 (1992) 693",
    term=eddy_drag,
    confused_with=("coulomb_friction",),
)

VOLTS = (9.0, 7.5, 12.0, 8.0, 14.0, 10.0, 9.0, 11.0)


def strokes() -> Drive:
    """Eight openings with their releases, 30 ms on and 30 ms off."""
    times = 0.01 + 0.03 * np.arange(2 * len(VOLTS))
    return Drive.of(times, np.column_stack([VOLTS, np.zeros(len(VOLTS))]).ravel())


def run() -> Diagnosis:
    """Diagnose a valve that has the effect, declared without it."""
    if EDDY_DRAG.name not in CATALOGUE:
        CATALOGUE.register(EDDY_DRAG)
    declared = default_valve().exact()  # as a simulated valve is known
    real = Valve(declared.parameters, {"eddy_drag": {"force": 0.15, "speed": 0.05}})
    measured = record(real, strokes(), 0.5, 20e3, Sensor(1e-6, 0.0, 1e-3, seed=1))
    return diagnose([measured.trace], [], declared)


if __name__ == "__main__":
    found = run()
    print(summarise(found))
    for name, interval in found.after.intervals.items():
        print(f"{name}: {interval.value:.4g} ± {interval.stderr:.2g}")
