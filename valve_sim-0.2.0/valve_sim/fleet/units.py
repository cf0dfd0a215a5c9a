"""What there is to do: one unit of work for each valve of each bag, known by what its result depends on."""

from __future__ import annotations

import fnmatch
import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

from valve_sim import __version__
from valve_sim.files.parameter_files import default_valve, load_valve
from valve_sim.fleet.sources import Bag
from valve_sim.model import ParameterError, Valve

Row = dict[str, Any]
"""One row of the table, by column; what is not known is left out."""

EXAMINED: Final = "examined"
UNREADABLE: Final = "unreadable"
DUPLICATE: Final = "duplicate"
FAILED: Final = "failed"
LOST: Final = "lost"
"""States of a row. What was lost, to no fault of the bag, is done again by the next run."""
STATES: Final = (EXAMINED, UNREADABLE, DUPLICATE, FAILED, LOST)


@dataclass(frozen=True)
class Options:
    """What results depend on, beside bag and parameters.

    Attributes:
        full: whether missing effects are searched for where the declared valve leaves nothing, too.
        budget: s for one unit, each as much work as `Budget.of_seconds` makes of it, on any machine.
        largest: bytes of a bag that is still read.
        search: whether missing effects are searched for at all.
    """

    full: bool = False
    budget: float = 120.0
    largest: int = 4 << 30
    search: bool = True


class Survey(NamedTuple):
    """What a first look at a bag finds.

    Attributes:
        content: its hash, 64 digits. valves: in it. error: why it cannot be used, or empty.
        is_lost: whether that is to no fault of the bag.
    """

    content: str
    valves: tuple[str, ...]
    error: str = ""
    is_lost: bool = False


class Unit(NamedTuple):
    """One valve of one bag. `key` changes with everything that its result depends on."""

    key: str
    bag: Bag
    survey: Survey
    valve: str
    declared: Valve
    options: Options

    def row(self, state: str, **values: Any) -> Row:
        """A row of it."""
        return row_of(self.bag, self.survey, state, key=self.key, valve=self.valve, **values)


@dataclass(frozen=True)
class ParameterChoice:
    """Which parameter file belongs to which valve.

    Args:
        default: of all others; None: the shipped one.
        patterns: of valves' names, such as "/tank_1/*", each with its file; the first that fits counts.
    """

    default: Path | None = None
    patterns: tuple[tuple[str, Path], ...] = ()
    _known: dict[tuple[Path | None, str], Valve] = field(default_factory=dict, repr=False, compare=False)

    def declared(self, valve: str) -> Valve:
        """The declared valve of this name.

        Raises:
            ParameterError: its file cannot be used.
        """
        path = next((file for pattern, file in self.patterns if fnmatch.fnmatchcase(valve, pattern)), self.default)
        if (path, valve) not in self._known:
            self._known[path, valve] = default_valve() if path is None else _load(path, valve)
        return self._known[path, valve]

    def check(self) -> None:
        """Every file can be read.

        Raises:
            ParameterError: one cannot.
        """
        for path in (self.default, *(file for _, file in self.patterns)):
            if path is not None and not path.is_file():
                raise ParameterError(f"{path}: no such parameter file; give one that exists")


def _load(path: Path, valve: str) -> Valve:
    """The section of this valve where a file describes several; else what it describes."""
    try:
        return load_valve(path, valve)
    except ParameterError:
        return load_valve(path)


class Plan(NamedTuple):
    """What a run has to do.

    Attributes:
        units: to be examined, in the order of their bags. rows: known without: unreadable, duplicate or moved.
        kept: of earlier runs, still true.
    """

    units: list[Unit]
    rows: list[Row]
    kept: list[Row]


def plan(
    surveys: Sequence[tuple[Bag, Survey]], parameters: ParameterChoice, options: Options, known: Iterable[Row]
) -> Plan:
    """What is left to do of what was listed.

    Args:
        surveys: every bag, in the order of their names: of equal ones, the first is examined.
        known: rows of earlier runs.

    Raises:
        ParameterError: a parameter file cannot be used.
    """
    by_key = {row["key"]: row for row in known if row["state"] != LOST}
    found, first_of = Plan([], [], []), dict[str, Bag]()
    for bag, survey in surveys:
        if survey.error:
            state = LOST if survey.is_lost else UNREADABLE
            row = row_of(bag, survey, state, key=_digest(state, bag.source, bag.stamp), error=survey.error)
            _settle(row, by_key, found)
        elif survey.content in first_of:
            words = f"the same content as {first_of[survey.content].source}"
            key = _digest(DUPLICATE, bag.source, survey.content, words)
            _settle(row_of(bag, survey, DUPLICATE, key=key, error=words), by_key, found)
        else:
            first_of[survey.content] = bag
            for valve in survey.valves:
                declared = parameters.declared(valve)
                unit = Unit(_key(survey.content, valve, declared, options), bag, survey, valve, declared, options)
                if unit.key not in by_key:
                    found.units.append(unit)
                else:
                    # It may have been moved since.
                    _settle({**by_key[unit.key], **_place(bag, survey)}, by_key, found)
    return found


def _settle(row: Row, by_key: Mapping[str, Row], into: Plan) -> None:
    before = by_key.get(row["key"])
    is_same = before is not None and all(before.get(name) == value for name, value in row.items() if value is not None)
    (into.kept if is_same else into.rows).append(row)


def row_of(bag: Bag, survey: Survey, state: str, **values: Any) -> Row:
    """What every row has, and these values."""
    return {"valve": "", "error": "", **_place(bag, survey), "state": state, "version": __version__, **values}


def _place(bag: Bag, survey: Survey) -> Row:
    return {
        "source": bag.source,
        "stamp": bag.stamp,
        "size": bag.size,
        "content": survey.content,
        "bag_valves": list(survey.valves),
    }


def remembered(bag: Bag, rows: Sequence[Row]) -> Survey | None:
    """What the rows of a bag say of it, if it has not been written since; None where it must be looked at again."""
    for row in rows:
        if row["stamp"] == bag.stamp and row["content"]:
            is_unreadable = row["state"] == UNREADABLE and not row["bag_valves"]
            return Survey(row["content"], tuple(row["bag_valves"]), row["error"] if is_unreadable else "")
    return None


def _key(content: str, valve: str, declared: Valve, options: Options) -> str:
    return _digest(content, valve, declared.to_mapping(), __version__, options.full, options.budget, options.search)


def _digest(*parts: Any) -> str:
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:32]
