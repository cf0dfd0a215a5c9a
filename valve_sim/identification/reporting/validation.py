"""The result of `validate`, as JSON, as JUnit XML and as text for the terminal."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any
from xml.etree import ElementTree

from valve_sim.files.json_text import plain_mapping
from valve_sim.identification.reporting.units import in_unit, three_digits
from valve_sim.identification.validation.replay import MICRO, Arrival, Errors, Replay, Validation


def validation_json(result: Validation) -> dict[str, Any]:
    """The whole report; lengths in µm, currents in mA, times in ms and µs, as the names say."""
    report = {
        "schema": "valve_sim/validation/1",
        "passed": result.passed,
        "recordings": [_replay_json(replay) for replay in result.replays],
    }
    return plain_mapping(report)


def validation_text(result: Validation) -> str:
    """For the terminal."""
    lines = [_replay_text(replay) for replay in result.replays]
    return "\n".join([*lines, "passed" if result.passed else "FAILED"])


def validation_junit(result: Validation) -> str:
    """JUnit XML: a suite for each recording, a test case for each stroke and one for the recording as a whole."""
    return junit([(replay.source, _cases(replay)) for replay in result.replays])


def junit(suites: Sequence[tuple[str, Sequence[tuple[str, str, bool]]]]) -> str:
    """JUnit XML.

    Args:
        suites: name, and test cases: name of each, what is said of it, and whether it failed. Several may share a name.
    """
    root = ElementTree.Element("testsuites", name="valve-sim validate")
    for name, cases in suites:
        _add_suite(root, name, cases)
    for key in ("tests", "failures", "errors"):
        root.set(key, str(sum(int(suite.get(key, "0")) for suite in root)))
    ElementTree.indent(root)
    document: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return document.decode() + "\n"


def _replay_json(replay: Replay) -> dict[str, Any]:
    """One entry of the report."""
    scale, unit = replay.readable
    return {
        "source": replay.source,
        "signal": replay.title,
        "unit": unit,
        "passed": replay.passed,
        **in_unit("noise", scale * replay.noise, unit),
        "clock_offset_us": MICRO * replay.clock_offset,
        **_errors_json(replay.errors, scale, unit),
        "strokes": [
            {
                "name": stroke.name,
                "passed": stroke.errors.is_within,
                **_errors_json(stroke.errors, scale, unit),
                "arrivals": [_arrival_json(arrival) for arrival in stroke.arrivals],
            }
            for stroke in replay.strokes
        ],
    }


def _errors_json(errors: Errors, scale: float, unit: str) -> dict[str, Any]:
    """Errors, and how large they may be, in a unit; the moving error is nan where the model does not move."""
    return {
        "samples": errors.samples,
        **in_unit("tolerance", scale * errors.tolerance, unit),
        **in_unit("rmse", scale * errors.rmse, unit),
        **in_unit("moving_rmse", scale * errors.moving_rmse, unit),
        **in_unit("maximum", scale * errors.maximum, unit),
    }


def _arrival_json(arrival: Arrival) -> dict[str, Any]:
    """An arrival in ms."""
    return {
        "kind": arrival.kind,
        "sensor": arrival.sensor,
        "measured_ms": 1e3 * arrival.measured,
        "stderr_ms": 1e3 * arrival.stderr,
        "model_ms": 1e3 * arrival.model,
    }


def _replay_text(replay: Replay) -> str:
    """For the terminal."""
    scale, unit = replay.readable
    lines = [
        f"{replay.source}: {'within' if replay.passed else 'OUTSIDE'} "
        f"{three_digits(scale * replay.tolerance)} {unit} (noise {three_digits(scale * replay.noise)} {unit}"
        f"{'' if math.isnan(replay.clock_offset) else f', clock offset {MICRO * replay.clock_offset:.1f} µs'})",
        f"  {'part of a stroke':<32}{'rmse':>9}{'moving':>9}{'maximum':>9}  {unit}",
    ]
    rows = [*((stroke.name, stroke.errors) for stroke in replay.strokes), ("in all", replay.errors)]
    for name, errors in rows:
        moving = three_digits(scale * errors.moving_rmse)
        lines.append(
            f"  {name:<32}{three_digits(scale * errors.rmse):>9}{moving:>9}{three_digits(scale * errors.maximum):>9}"
            f"  {'' if errors.is_within else 'outside'}".rstrip()
        )
    return "\n".join([*lines, *_arrival_lines(replay)])


def _arrival_lines(replay: Replay) -> Iterator[str]:
    if any(stroke.arrivals for stroke in replay.strokes):
        yield f"  {'arrival after the command':<32}{'measured':>18}{'model':>9}{'apart':>9}  ms"
    for stroke in replay.strokes:
        for arrival in stroke.arrivals:
            name = f"{arrival.kind.replace('_', ' ')} ({arrival.sensor})"
            measured = f"{1e3 * arrival.measured:.3f} ± {1e3 * arrival.stderr:.3f}"
            model, apart = 1e3 * arrival.model, 1e3 * (arrival.measured - arrival.model)
            yield f"  {name:<32}{measured:>18}{model:>9.3f}{apart:>+9.3f}  {stroke.name}"


def _cases(replay: Replay) -> list[tuple[str, str, bool]]:
    """Errors of each stroke and of the whole in words, and whether they are outside the tolerance."""
    cases = []
    scale, unit = replay.readable
    for name, errors in (*((stroke.name, stroke.errors) for stroke in replay.strokes), ("in all", replay.errors)):
        words = (
            f"rmse {three_digits(scale * errors.rmse)} {unit}, "
            f"moving {three_digits(scale * errors.moving_rmse)} {unit}, "
            f"maximum {three_digits(scale * errors.maximum)} {unit}, "
            f"tolerance {three_digits(scale * errors.tolerance)} {unit}"
        )
        cases.append((name, words, not errors.is_within))
    return cases


def _add_suite(root: ElementTree.Element, name: str, cases: Sequence[tuple[str, str, bool]]) -> None:
    """A suite of test cases, each with its words and whether it failed."""
    counts = {"failures": str(sum(is_outside for _, _, is_outside in cases)), "errors": "0", "skipped": "0"}
    suite = ElementTree.SubElement(root, "testsuite", {"name": name, "tests": str(len(cases)), **counts})
    for case_name, words, is_outside in cases:
        case = ElementTree.SubElement(suite, "testcase", classname=name, name=case_name)
        if is_outside:
            ElementTree.SubElement(case, "failure", message=words, type="outside tolerance")
        else:
            ElementTree.SubElement(case, "system-out").text = words
