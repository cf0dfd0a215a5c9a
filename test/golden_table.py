"""What the package says of each shipped recording, as numbers and words with tolerances: test/golden/*.json.

`make golden` writes the files anew. An entry that is within its tolerance stays as it is, so the diff has what changed.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from click.testing import CliRunner
from shipped import BAGS, ROOT, diagnosed, identified, options

from valve_sim.cli import main as command_line
from valve_sim.identification.fit.intervals import Interval

FOLDER: Final = Path(__file__).parent / "golden"
PARTS: Final = ("info", "identify", "diagnose")


class Entry(NamedTuple):
    """A value, and by how much it may change; a word or a truth value has no tolerance."""

    value: Any
    tolerance: float | None = None

    def accepts(self, value: Any) -> bool:
        """Whether another value is as good."""
        if self.tolerance is None or isinstance(value, str):
            return bool(self.value == value)
        return abs(self.value - value) <= self.tolerance


Table = dict[str, Entry]


def share(value: float, of_it: float) -> Entry:
    """A number that may change by a share of itself."""
    return Entry(value, of_it * abs(value))


def residual(value: float, of_it: float = 0.005) -> Entry:
    """A residual may change by a share of itself, and by 1 nm, where nothing but rounding is left."""
    return Entry(value, max(of_it * value, 1e-9))


def estimates(intervals: Mapping[str, Interval]) -> Iterator[tuple[str, Entry]]:
    """Values may change by a fifth of their standard errors, these by a tenth."""
    for name, own in intervals.items():
        yield name, Entry(own.value, 0.2 * own.stderr)
        yield f"{name} stderr", share(own.stderr, 0.1)


def info(name: str) -> Iterator[tuple[str, Entry]]:
    """What `valve-sim info` says: rates, noise, findings, and when which plunger arrived where (t1, t2, and back)."""
    with tempfile.TemporaryDirectory() as folder:
        arguments = ["info", str(ROOT / BAGS[name]), "--json", *options(name, Path(folder))]
        ran = CliRunner().invoke(command_line, arguments)
    assert ran.exit_code == 0, ran.output
    (valve,) = json.loads(ran.stdout)["valves"]
    yield from ((key, Entry(valve[key])) for key in ("clock", "commands", "primary_signal"))
    yield "findings", Entry([finding.replace(f"{ROOT}/", "") for finding in valve["findings"]])
    yield "noise", share(valve["noise"], 0.05)
    for signal, own in valve["signals"].items():
        yield f"{signal} samples", Entry(own["samples"])
        yield f"{signal} rate", share(own["rate"], 1e-4)
    yield from ((f"voltage {place}", Entry(volts, 1e-3)) for place, volts in enumerate(valve["voltages"]))
    for stroke in valve["arrivals"]:
        for event in stroke["events"]:
            where = f"{stroke['stroke']['kind']} {stroke['stroke']['stroke']} {event['kind']}"
            yield where, Entry(event["after_command"], 0.2 * event["stderr"])
            yield f"{where} stderr", share(event["stderr"], 0.1)


def identify(name: str) -> Iterator[tuple[str, Entry]]:
    """What `valve-sim identify` says: dampings, residuals, and declared values that are off."""
    found = identified(name)
    yield from estimates(found.intervals)
    yield "residual as declared", residual(found.rmse_before, 0.01)
    yield "residual refitted", residual(found.rmse_after)
    yield "findings", Entry([type(finding).__name__ for finding in found.findings])


def diagnose(name: str) -> Iterator[tuple[str, Entry]]:
    """What `valve-sim diagnose` says: the verdict, dampings and sizes of effects, residuals."""
    found = diagnosed(name)
    verdict = found.verdict
    yield "verdict", Entry(verdict.kind)
    yield "effects", Entry(list(verdict.effects))
    yield "confusable", Entry(sorted(other for others in verdict.confusable_with.values() for other in others))
    yield "probability", Entry(verdict.probability, 0.01)
    yield "probability of something unnamed", Entry(verdict.unnamed, 0.01)
    yield from estimates(found.after.intervals)
    yield "residual before", residual(found.before.train_rmse)
    yield "residual after", residual(found.after.train_rmse)
    if found.after.holdout is not None:
        yield "residual after, held out", residual(found.after.holdout_rmse)
        yield "held-out gain", Entry(found.held_out_gain, 1.0)


def said(name: str, parts: Sequence[str] = PARTS) -> Table:
    """What the package says now."""
    makers = {"info": info, "identify": identify, "diagnose": diagnose}
    return {f"{part}: {key}": entry for part in parts for key, entry in makers[part](name)}


def read(name: str) -> Table:
    """What it said when the file was written."""
    entries = json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))
    return {key: Entry(*entry) for key, entry in entries.items()}


def changes(golden: Table, now: Table) -> list[str]:
    """Keys of which a value differs by more than the golden table's tolerance, and those that came or went."""
    return [
        key
        for key in {**golden, **now}
        if key not in golden or key not in now or not golden[key].accepts(now[key].value)
    ]


def write(name: str) -> None:
    """Write a file anew; what is within its tolerance stays."""
    now = said(name)
    path = FOLDER / f"{name}.json"
    golden = read(name) if path.exists() else {}
    kept = {
        key: golden[key] if key in golden and golden[key].accepts(entry.value) else entry for key, entry in now.items()
    }
    lines = [
        f"  {json.dumps(key, ensure_ascii=False)}: {json.dumps([_short(part) for part in entry if part is not None])}"
        for key, entry in kept.items()
    ]
    path.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


def _short(value: Any) -> Any:
    return float(f"{value:.8g}") if isinstance(value, float) else value


if __name__ == "__main__":
    for shipped in BAGS:
        write(shipped)
