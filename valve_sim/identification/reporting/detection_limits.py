"""What would have shown, where nothing is missing: detection limits as people read them."""

from __future__ import annotations

import math

from valve_sim.identification.diagnosis.run import Diagnosis
from valve_sim.identification.plants.effect_titles import title_of
from valve_sim.identification.reporting.units import quantity


def limit_rows(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    """Each effect that has a limit, and how much of it would have shown; of several parameters each."""
    rows = []
    for name, limits in diagnosis.detection_limits.items():
        switches = {switch.name: switch.unit for switch in diagnosis.plant.effects[name].parameters}
        known = {parameter: limit for parameter, limit in limits.items() if math.isfinite(limit)}
        if known:
            words = ", ".join(
                (f"{parameter.replace('_', ' ')} " if len(known) > 1 else "") + quantity(limit, switches[parameter])
                for parameter, limit in known.items()
            )
            rows.append((title_of(name), words))
    return rows
