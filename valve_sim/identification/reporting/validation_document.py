"""The result of `validate` as a document, each part of a stroke a test case."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from valve_sim.identification.reporting.document import (
    Chapter,
    Document,
    Line,
    Panel,
    Plot,
    Plots,
    Table,
    TableRow,
    Words,
)
from valve_sim.identification.reporting.units import error_words, in_unit, in_units, signed
from valve_sim.identification.validation.replay import MICRO, Arrival, Errors, Replay, Validation


def validation_document(result: Validation) -> Document:
    """Errors and arrivals of each recording; lengths in µm, currents in mA, times in ms and µs, as the names say."""
    replays = [_replay(replay) for replay in result.replays]
    fields = {
        "schema": "valve_sim/validation/1",
        "passed": result.passed,
        "recordings": [_replay_json(replay) for replay in result.replays],
    }
    return Document(
        "valve-sim validate", [*replays, Chapter("", [Words("passed" if result.passed else "FAILED")], fields)]
    )


def _replay(replay: Replay) -> Chapter:
    scale, unit = replay.readable

    def told(size: float) -> str:
        return error_words(size, replay.unit)

    clock = "" if math.isnan(replay.clock_offset) else f", clock offset {MICRO * replay.clock_offset:.1f} µs"
    verdict = "within" if replay.passed else "OUTSIDE"
    rows = [
        TableRow(
            (name, *map(told, (errors.rmse, errors.moving_rmse, errors.maximum, errors.tolerance)),
             "" if errors.is_within else "outside"),
            is_marked=not errors.is_within,
        )
        for name, errors in (*((stroke.name, stroke.errors) for stroke in replay.strokes), ("in all", replay.errors))
    ]  # fmt: skip
    head = ("part of a stroke", "rmse", "moving", "maximum", "tolerance", "")
    arrivals = [_arrival(stroke.name, arrival) for stroke in replay.strokes for arrival in stroke.arrivals]
    times = Table(("arrival after the command", "measured", "model", "apart", "part of a stroke"), arrivals)

    def plots() -> list[Plot]:
        measured = replay.measured.values
        limit = np.full(len(measured), scale * replay.tolerance)
        above = Panel(
            f"{replay.title}, {unit}", [Line("measured", scale * measured), Line("model", scale * replay.predicted)]
        )
        left = Line("residual", scale * (measured - replay.predicted))
        below = Panel(f"measured − model, {unit}", [left], -limit, limit)
        title = f"{replay.source}: {verdict.lower()} {told(replay.tolerance)} (band)"
        return [Plot(title, "", 1e3 * replay.measured.times, "time, ms", [above, below])]

    title = f"{replay.source}: {verdict} {told(replay.tolerance)} (noise {told(replay.noise)}{clock})"
    return Chapter(title, [Table(head, rows, suite=replay.source), times, Plots(plots)])


def _arrival(stroke: str, arrival: Arrival) -> TableRow:
    measured = f"{1e3 * arrival.measured:.3f} ± {1e3 * arrival.stderr:.3f} ms"
    model, apart = f"{1e3 * arrival.model:.3f} ms", f"{signed(1e3 * (arrival.measured - arrival.model), 3)} ms"
    return TableRow((f"{arrival.kind.replace('_', ' ')} ({arrival.sensor})", measured, model, apart, stroke))


def _replay_json(replay: Replay) -> dict[str, Any]:
    scale, unit = replay.readable

    def errors_json(errors: Errors) -> dict[str, Any]:
        sizes = {name: scale * getattr(errors, name) for name in ("tolerance", "rmse", "moving_rmse", "maximum")}
        return {"samples": errors.samples, **in_units(sizes, unit)}

    return {
        "source": replay.source,
        "signal": replay.title,
        "unit": unit,
        "passed": replay.passed,
        **in_unit("noise", scale * replay.noise, unit),
        "clock_offset_us": MICRO * replay.clock_offset,
        **errors_json(replay.errors),
        "strokes": [
            {
                "name": stroke.name,
                "passed": stroke.errors.is_within,
                **errors_json(stroke.errors),
                "arrivals": [
                    {
                        "kind": arrival.kind,
                        "sensor": arrival.sensor,
                        "measured_ms": 1e3 * arrival.measured,
                        "stderr_ms": 1e3 * arrival.stderr,
                        "model_ms": 1e3 * arrival.model,
                    }
                    for arrival in stroke.arrivals
                ],
            }
            for stroke in replay.strokes
        ],
    }
