"""What there is to do: one unit of work for each valve of each bag, known by what its result depends on."""

from __future__ import annotations

import fnmatch
import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

from valve_sim import __version__
from valve_sim.files.parameter_files import default_valve, load_recorded_valve
from valve_sim.fleet.columns import columns
from valve_sim.fleet.sources import Bag
from valve_sim.model import ParameterError, Valve

Row = dict[str, Any]
"""One row of the table, by column; what is not known is None."""

EXAMINED: Final = "examined"
UNREADABLE: Final = "unreadable"
DUPLICATE: Final = "duplicate"
FAILED: Final = "failed"
LOST: Final = "lost"
"""States of a row. What was lost, through no fault of the bag, is done again by the next run."""

_UNKNOWN: Final[Row] = {column.name: None for column in columns()}


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
    """What a first look at a bag finds: its bytes' hash, its valves, and why it cannot be used, or empty."""

    content: str
    valves: tuple[str, ...]
    error: str = ""


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
    _loaded: dict[tuple[Path | None, str], Valve] = field(default_factory=dict, repr=False, compare=False)

    def declared(self, valve: str) -> Valve:
        """The declared valve of this name.

        Raises:
            ParameterError: its file cannot be used.
        """
        path = next((file for pattern, file in self.patterns if fnmatch.fnmatchcase(valve, pattern)), self.default)
        if (path, valve) not in self._loaded:
            self._loaded[path, valve] = default_valve() if path is None else load_recorded_valve(path, valve)
        return self._loaded[path, valve]

    def check(self) -> None:
        """Every file can be read.

        Raises:
            ParameterError: one cannot.
        """
        for path in (self.default, *(file for _, file in self.patterns)):
            if path is not None and not path.is_file():
                raise ParameterError(f"{path}: no such parameter file; give one that exists")


def row_of(bag: Bag, survey: Survey, state: str, **values: Any) -> Row:
    """What every row has, and these values."""
    return {
        **_UNKNOWN,
        "valve": "",
        "error": "",
        "version": __version__,
        "state": state,
        **place(bag, survey),
        **values,
    }


def place(bag: Bag, survey: Survey) -> Row:
    """The columns of a bag itself, which change if it is moved."""
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


def plan(
    surveys: Sequence[tuple[Bag, Survey]], parameters: ParameterChoice, options: Options, earlier: Iterable[Row]
) -> tuple[list[Unit], list[Row]]:
    """What is left to do, and the rows of all else: unreadable bags, duplicates, and results of earlier runs.

    Args:
        surveys: in the order of their names; of bags with equal content, the first is examined.

    Raises:
        ParameterError: a parameter file cannot be used.
    """
    by_key = {row["key"]: row for row in earlier if row["state"] != LOST}
    units, rows, first_of = list[Unit](), list[Row](), dict[str, Bag]()
    for bag, survey in surveys:
        if survey.error:
            key = _digest(UNREADABLE, bag.source, bag.stamp)
            rows.append(row_of(bag, survey, UNREADABLE, key=key, error=survey.error))
        elif survey.content in first_of:
            words = f"the same content as {first_of[survey.content].source}"
            key = _digest(DUPLICATE, bag.source, survey.content)
            rows.append(row_of(bag, survey, DUPLICATE, key=key, error=words))
        else:
            first_of[survey.content] = bag
            for valve in survey.valves:
                declared = parameters.declared(valve)
                depends = (survey.content, valve, declared.to_mapping(), __version__)
                key = _digest(*depends, options.full, options.budget, options.search)
                if key in by_key:
                    rows.append({**by_key[key], **place(bag, survey)})  # it may have been moved since
                else:
                    units.append(Unit(key, bag, survey, valve, declared, options))
    return units, rows


def _digest(*parts: Any) -> str:
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:32]
