"""Modes of a plant's file: regions of them, what makes them change, and numbers that only this changes.

    modes: {flying: {}, resting: {x: 0, v: 0}}
    transitions:
      - from: flying
        when: x < 0
        cases: [{if: -v > 5e-3, set: {x: 0, v: -e*v}}, {to: resting, set: {x: 0, v: 0}, event: seated}]
    held: {bounces: 0}

`regions: {plunger: {...}, circuit: {...}}` in place of `modes:` names several sets of modes side by side.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from valve_sim.files.entries import alternatives, short
from valve_sim.files.plant_entries import PlantEntries, a_second
from valve_sim.model.core.hybrid import layout as at
from valve_sim.model.core.hybrid.description import Case, Region, Transition
from valve_sim.model.core.own.grammar import Expr, Modes
from valve_sim.model.core.own.units import Dimension, Unit

SECTIONS: Final = ("modes", "regions", "transitions", "held")
ONLY: Final = "mode"
"""The name of the region that `modes:` is."""


@dataclass(frozen=True)
class HeldEntry:
    """A number that only transitions change: its unit, and its start in SI."""

    unit: Unit
    start: float


@dataclass(frozen=True)
class Automaton:
    """The modes of a plant, by the name of their region, what makes them change, and what transitions hold."""

    regions: Mapping[str, Region[Expr]] = field(default_factory=dict)
    transitions: tuple[Transition[Expr], ...] = ()
    held: Mapping[str, HeldEntry] = field(default_factory=dict)

    def mapped(self, change: Callable[[Expr], Expr]) -> Automaton:
        """The same of other expressions."""
        regions = {
            name: {mode: {state: change(rate) for state, rate in flow.items()} for mode, flow in region.items()}
            for name, region in self.regions.items()
        }
        return Automaton(regions, tuple(own.mapped(change) for own in self.transitions), self.held)

    def expressions(self) -> list[Expr]:
        """All expressions in it."""
        found: list[Expr] = []

        def seen(expression: Expr) -> Expr:
            found.append(expression)
            return expression

        self.mapped(seen)
        return found


def held_numbers(entries: PlantEntries) -> dict[str, HeldEntry]:
    """The numbers that transitions change."""
    found = {}
    for name, own in entries.section("held").items():
        key = f"held.{name}"
        entry = entries.entry(key, own if isinstance(own, Mapping) else {"start": own}, ("unit", "start"))
        unit = entries.plant_unit(key, entry)
        found[name] = HeldEntry(unit, entries.si(f"{key}.start", entry.get("start", 0.0), unit))
    entries.at_most("held", found, at.MOST_HELD)
    return found


def mode_names(entries: PlantEntries) -> Modes:
    """The modes of all regions: of each its region, and its number there."""
    found: dict[str, tuple[str, int]] = {}
    for region, modes in _regions(entries).items():
        key = _key_of(region)
        entries.check_name(key, region)
        for number, mode in enumerate(entries.filled(key, modes, "at least one mode: {flying: {}, resting: {v: 0}}")):
            entries.check_name(f"{key}.{mode}", mode)
            if mode in found:
                raise entries.fail(f"{key}.{mode}", f"is a mode of {found[mode][0]}, too; choose another name")
            found[mode] = region, number
        entries.at_most(key, modes, at.MOST_MODES)
    return found


def _regions(entries: PlantEntries) -> Mapping[str, Any]:
    if "modes" in entries.found and "regions" in entries.found:
        raise entries.fail("regions", "stands beside modes:, which is the one region of a plant; write all in regions:")
    regions = {ONLY: entries.found["modes"]} if "modes" in entries.found else entries.section("regions")
    entries.at_most("regions", regions, at.MOST_REGIONS)
    return regions


def _key_of(region: str) -> str:
    return "modes" if region == ONLY else f"regions.{region}"


class ModesReader:
    """Reads modes and transitions.

    Args:
        entries: of the file, with its modes. units: of states and held numbers. states: names of the states.
        dimensions: of all names.
    """

    def __init__(
        self, entries: PlantEntries, units: Mapping[str, Unit], states: Mapping[str, object],
        dimensions: Mapping[str, Dimension],
    ) -> None:  # fmt: skip
        self._entries, self._units, self._states, self._dimensions = entries, units, states, dimensions

    def whole(self, held: Mapping[str, HeldEntry]) -> Automaton:
        """All of them."""
        entries = self._entries
        regions = {name: self._region(name, modes) for name, modes in _regions(entries).items()}
        found = entries.found.get("transitions", [])
        if not isinstance(found, list):
            raise entries.fail("transitions", f"found {short(found)}, expected a list: - {{from: ..., when: ...}}")
        entries.at_most("transitions", found, at.MOST_TRANSITIONS)
        transitions = tuple(self._transition(f"transitions[{i}]", own) for i, own in enumerate(found))
        self._used(transitions, held)
        return Automaton(regions, transitions, held)

    def _used(self, transitions: tuple[Transition[Expr], ...], held: Mapping[str, object]) -> None:
        """Every held number is set, and every mode but those at the start entered."""
        cases = [case for transition in transitions for case in transition.cases]
        for name in held:
            if not any(name in case.sets for case in cases):
                raise self._entries.fail(f"held.{name}", "is set by no transition; make it a parameter")
        for mode, (region, number) in self._entries.modes.items():
            if number and not any(case.to.get(region) == mode for case in cases):
                raise self._entries.fail(
                    f"{_key_of(region)}.{mode}", "is entered by no transition; add to: or take it out"
                )

    def _region(self, name: str, modes: Mapping[str, Any]) -> Region[Expr]:
        return {mode: self._flow(f"{_key_of(name)}.{mode}", flow) for mode, flow in modes.items()}

    def _flow(self, key: str, found: object) -> dict[str, Expr]:
        entries = self._entries
        flow = {}
        for name, rate in entries.mapping(key, {} if found is None else found, "rates of states: {x: 0, v: 0}").items():
            where = f"{key}.{name}"
            if name not in self._states:
                raise entries.fail(where, f"is no state; {alternatives(name, self._states)}")
            flow[name] = self._fitting(where, rate, a_second(self._units[name]), f"the unit of {name} a second")
        return flow

    def _fitting(self, key: str, found: object, expected: Dimension, what: str) -> Expr:
        expression = self._entries.expression(key, found, self._dimensions)
        self._entries.fits(key, self._entries.dimension(key, expression, self._dimensions), expected, what)
        return expression

    def _transition(self, key: str, found: object) -> Transition[Expr]:
        entries = self._entries
        entry = entries.entry(key, found, ("from", "when", "cases", "event"))
        region, modes = self._from(f"{key}.from", entry.get("from"))
        if "when" not in entry:
            raise entries.fail(f"{key}.when", "is missing; write the comparison that makes it happen: when: x < 0")
        guard = entries.comparison(f"{key}.when", entry["when"], self._dimensions)
        cases = entry.get("cases")
        if not isinstance(cases, list) or not cases:
            raise entries.fail(
                f"{key}.cases", f"found {short(cases)}, expected a list: [{{to: resting, set: {{v: 0}}}}]"
            )
        event = self._event(f"{key}.event", entry)
        read = tuple(self._case(f"{key}.cases[{i}]", own, event) for i, own in enumerate(cases))
        for number, case in enumerate(read):
            if (case.when is None) != (number == len(read) - 1):
                raise entries.fail(
                    f"{key}.cases[{number}]",
                    "has no if:, so that the cases after it never happen; put it last" if case.when is None
                    else "is the last one and has if:; add a case without if:, for what happens else",
                )  # fmt: skip
        return Transition(guard, read, region, modes)

    def _from(self, key: str, found: object) -> tuple[str | None, tuple[str, ...]]:
        """The region whose modes matter, and these."""
        if found is None:
            return None, ()
        modes = found if isinstance(found, list) else [found]
        regions = {self._mode(key, mode) for mode in modes}
        if len(regions) != 1:
            raise self._entries.fail(key, f"found {short(found)}, expected modes of one region")
        return regions.pop(), tuple(modes)

    def _mode(self, key: str, found: object) -> str:
        """The region of a mode."""
        known = self._entries.modes
        if not isinstance(found, str) or found not in known:
            raise self._entries.fail(key, f"found {short(found)}, which is no mode; {alternatives(found, known)}")
        return known[found][0]

    def _event(self, key: str, entry: Mapping[str, Any], default: str = "") -> str:
        if "event" in entry:
            self._entries.check_name(key, entry["event"])
        return str(entry.get("event", default))

    def _case(self, key: str, found: object, event: str) -> Case[Expr]:
        entries = self._entries
        entry = entries.entry(key, found, ("if", "to", "set", "event"))
        when = entries.comparison(f"{key}.if", entry["if"], self._dimensions) if "if" in entry else None
        to = entry.get("to", [])
        modes = to if isinstance(to, list) else [to]
        regions = {self._mode(f"{key}.to", mode): mode for mode in modes}
        if len(regions) < len(modes):
            raise entries.fail(f"{key}.to", f"found {short(to)}, expected one mode of a region")
        sets = {}
        for name, own in entries.mapping(f"{key}.set", entry.get("set", {}), "values of states: {x: 0}").items():
            where = f"{key}.set.{name}"
            if name not in self._units:
                raise entries.fail(where, f"is no state and no number in held:; {alternatives(name, self._units)}")
            sets[name] = self._fitting(where, own, self._units[name].dimension, f"the unit of {name}")
        if not regions and not sets:
            raise entries.fail(key, "changes nothing; write to: or set:")
        return Case(when, regions, sets, self._event(f"{key}.event", entry, event))
