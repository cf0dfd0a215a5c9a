"""The result of `fit-force`, as JSON and as text for the terminal."""

from __future__ import annotations

from typing import Any

import numpy as np

from valve_sim.files.json_text import plain_mapping
from valve_sim.identification.estimation.static_force import StaticForce
from valve_sim.identification.reporting.findings import remarks
from valve_sim.identification.reporting.intervals import intervals_json
from valve_sim.model import DECLARED
from valve_sim.model.tolerances import COVARIANCE_NAME


def static_force_json(result: StaticForce) -> dict[str, Any]:
    """The content of fit-force.json."""
    report = {
        "schema": "valve_sim/static_force/1",
        "source": result.source,
        "samples": len(result.force),
        "voltage": result.voltage,
        "reference_voltage": result.valve.parameters.reference_voltage,
        "parameters": intervals_json(result.intervals),
        "attraction_polynomial": list(result.valve.parameters.attraction_polynomial),
        "attraction_covariance": result.valve.tolerances.to_mapping().get(COVARIANCE_NAME, [0.0] * 16),
        "rmse_n": result.rmse,
        "maximum_n": float(np.max(np.abs(result.force - result.predicted))),
        "r_squared": result.r_squared,
        "remarks": remarks(result.findings),
    }
    return plain_mapping(report)


def static_force_text(result: StaticForce) -> str:
    """The report of a static force for the terminal."""
    lines = [f"{result.source}: {len(result.force)} points at {result.voltage:g} V"]
    lines.append(f"{'':<5}{'value':>12} {'± std. error':>14}   95 % interval")
    for name, interval in result.intervals.items():
        lines.append(
            f"{name:<5}{interval.value:>12.5g} ± {interval.stderr:<12.2g}   "
            f"[{interval.low:.5g}, {interval.high:.5g}] {DECLARED[name].unit}"
        )
    lines.append(f"residual {result.rmse:.3g} N (rms), R² {result.r_squared:.6f}")
    return "\n".join([*lines, *remarks(result.findings)])
