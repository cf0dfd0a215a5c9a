"""Derivatives by parameters, commands and clocks against quotients of the core's own runs."""

from __future__ import annotations

import numpy as np
import pytest

from model.core.cases import CALIBRATED, STROKE, drawn
from model.derivatives import Case
from valve_sim.model import Valve, simulate
from valve_sim.model.errors import ParameterError
from valve_sim.model.runs import Directions, run_sloped

ACCURATE = 1e-7
"""Of the largest derivative, or of a stroke for a parameter as large again: how far one may be off the quotient."""
DOUBT = 0.1
"""Of how far the quotients of two differences are apart: the error of what is extrapolated from them."""
MANY = 20


def quotient(case: Case, name: str, value: float) -> list[tuple[np.ndarray, np.ndarray]] | None:
    """Derivatives of positions and of normalised currents by central differences, each with its own error.

    None where events change.
    """
    found = []
    for step in (1e-5 * value, 5e-6 * value):
        above, below = (case.moved(name, by).shown() for by in (step, -step))
        if [event.kind for event in above[2]] != [event.kind for event in below[2]]:
            return None
        found.append([(above[of] - below[of]) / (2.0 * step) for of in (0, 1)])
    return [((4.0 * fine - rough) / 3.0, DOUBT * np.abs(fine - rough)) for rough, fine in zip(*found, strict=True)]


@pytest.mark.parametrize("kind", ["random", "flux", "release"])
@pytest.mark.parametrize("seed", [*range(4), *(pytest.param(seed, marks=pytest.mark.long) for seed in range(4, MANY))])
def test_derivatives_are_those_of_central_differences(kind: str, seed: int) -> None:
    valve, drive, times = drawn(kind, seed)
    # A force may move a valve from the start of its run on, which is that of both.
    times = np.concatenate([[0.0], times])
    values = dict(zip(valve.plan().parameters, valve.numbers().tolist(), strict=True))
    values = {name: value for name, value in values.items() if "." not in name or name.split(".")[0] in valve.effects}
    names = [name for name, value in values.items() if value != 0.0]
    if seed < 4:
        names = [str(name) for name in np.random.default_rng(seed).choice(names, 6, replace=False)]
    base = simulate(valve, drive, times, tolerance=1e-10)
    sloped = run_sloped(valve, drive, times, Directions.of(valve, drive, names), tolerance=1e-10, with_currents=True)
    # Steps follow the current that tangents feel, too, and are others than those of a run without derivatives.
    assert sloped.positions == pytest.approx(base.pilot_position, abs=1e-9)
    edges = np.array([*(event.time for event in base.events), *drive.times])
    away = np.abs(times[:, None] - edges[None, :]).min(axis=1) > 2e-6
    for column, name in enumerate(names):
        expected = quotient(Case(valve, drive, times), name, values[name])
        if expected is None:
            continue
        shown = (sloped.of_positions[:, column], sloped.of_currents[:, column])
        for found, (quotients, doubt), size in zip(shown, expected, (1e-3, 1.0), strict=True):
            allowed = ACCURATE * max(np.abs(quotients).max(), size / abs(values[name])) + doubt
            assert (np.abs(found - quotients) < allowed)[away].all(), name


def test_a_parameter_that_the_valve_lacks_is_refused() -> None:
    with pytest.raises(ParameterError, match="did you mean coulomb_friction"):
        valve = Valve(CALIBRATED.parameters, {"coulomb_friction": {"force": 0.1}})
        Directions.of(valve, STROKE, ["coulomb_friction.fors"])
