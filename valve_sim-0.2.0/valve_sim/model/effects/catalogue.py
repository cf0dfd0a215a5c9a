"""The catalogue: every effect of this package, of installed packages, and those that a program registered."""

from __future__ import annotations

import functools
import importlib
import pkgutil
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Final

from valve_sim.model.effects.entry import Effect, Tag
from valve_sim.model.errors import ParameterError
from valve_sim.model.parameters import closest

ENTRY_POINTS: Final = "valve_sim.effects"
"""Entry-point group in which an installed package names its effects: an `Effect`, or several in a tuple or list."""


_OTHER_MODULES: Final = ("catalogue", "entry")


@functools.cache
def shipped() -> tuple[Effect, ...]:
    """The `EFFECT` of every module beside this one, by main tag and name; shapes without a physical name last."""
    package, folder = __name__.rpartition(".")[0], str(Path(__file__).parent)
    names = [found.name for found in pkgutil.iter_modules([folder]) if found.name not in _OTHER_MODULES]
    entries = [importlib.import_module(f"{package}.{name}").EFFECT for name in names]
    tags = list(Tag)
    return tuple(sorted(entries, key=lambda entry: (not entry.named, tags.index(entry.tags[0]), entry.name)))


def installed() -> Iterator[tuple[str, Effect]]:
    """The effects that installed packages name, each with where from, for messages.

    Raises:
        ParameterError: one cannot be loaded, or is no effect; the message names the entry point.
    """
    for point in sorted(metadata.entry_points(group=ENTRY_POINTS), key=lambda point: (point.name, point.value)):
        distribution = f" of {point.dist.name}" if point.dist is not None else ""
        where = f"entry point {point.name} = {point.value} in {ENTRY_POINTS}{distribution}"
        try:
            found = point.load()
        except Exception as error:
            words = str(error).splitlines() or [""]
            why = f"{type(error).__name__}: {words[0]}"
            raise ParameterError(f"{where}: cannot be loaded, {why}; mend or uninstall it") from error
        for effect in found if isinstance(found, tuple | list) else (found,):
            if not isinstance(effect, Effect):
                raise ParameterError(
                    f"{where}: found {type(effect).__name__}, expected an Effect; mend or uninstall it"
                )
            yield where, replace(effect, origin=where)


class Catalogue(Mapping[str, Effect]):
    """Effects by name. Those of installed packages are looked for when it is first asked.

    Args:
        entries: the effects that it has from the start.
        finds_installed: whether it has those of installed packages, too.
    """

    def __init__(self, entries: Iterable[Effect], *, finds_installed: bool = False) -> None:
        self._declared = {entry.name: entry for entry in entries}
        self._entries = _mutual(self._declared)
        self._is_whole = not finds_installed

    def __getitem__(self, name: str) -> Effect:
        return self._found()[name]

    def __contains__(self, name: object) -> bool:
        return name in self._found()

    def __iter__(self) -> Iterator[str]:
        return iter(self._found())

    def __len__(self) -> int:
        return len(self._found())

    def tagged(self, *tags: Tag) -> tuple[Effect, ...]:
        """The named effects that bear all of these tags."""
        return tuple(effect for effect in self._found().values() if effect.named and set(tags) <= set(effect.tags))

    def register(self, effect: Effect) -> Effect:
        """Add an effect of your own.

        Raises:
            ParameterError: its name is taken, or it changes nothing.
        """
        self._found()
        self._add(effect, f"effects.{effect.name}")
        self._entries = _mutual(self._declared)
        return self._entries[effect.name]

    def unregister(self, name: str) -> None:
        """Take an effect out again (tests do)."""
        del self._declared[name]
        self._entries = _mutual(self._declared)

    def _found(self) -> dict[str, Effect]:
        """All entries, those of installed packages among them.

        Raises:
            ParameterError: an installed package's effect is broken.
        """
        if not self._is_whole:
            before = dict(self._declared)
            try:
                for where, effect in installed():
                    self._add(effect, where)
            except ParameterError:
                self._declared = before
                raise
            self._entries = _mutual(self._declared)
            self._is_whole = True
        return self._entries

    def _add(self, effect: Effect, where: str) -> None:
        if effect.name in self._declared:
            raise ParameterError(f"{where}: an effect named {effect.name} is registered already")
        if effect.changes_nothing:
            raise ParameterError(
                f"{where}: has no expression (force, friction, square, changes, adds_to or a term), so it would change "
                "nothing"
            )
        self._declared[effect.name] = effect


def _mutual(declared: Mapping[str, Effect]) -> dict[str, Effect]:
    """Entries that are confused with each other both ways: those that say so of it, then those it says so of."""
    entries = {}
    for name, entry in declared.items():
        others = [other for other, its in declared.items() if name in its.confused_with]
        alike = dict.fromkeys([*others, *(other for other in entry.confused_with if other in declared)])
        entries[name] = replace(entry, confused_with=tuple(alike))
    return entries


CATALOGUE: Final = Catalogue(shipped(), finds_installed=True)
"""Every effect that parameter files may name and that a diagnosis tries."""


def check_effects(values: Mapping[str, object], source: str) -> dict[str, dict[str, float]]:
    """Turn a mapping of effects as found in YAML into checked values.

    Args:
        values: effect name to {parameter: value}.
        source: file or node, for messages.

    Raises:
        ParameterError: unknown effect or parameter, missing parameter, wrong type, out of range.
    """
    checked: dict[str, dict[str, float]] = {}
    for name, found in values.items():
        where = f"{source}: effects.{name}"
        if name not in CATALOGUE:
            raise ParameterError(f"{where}: no such effect; did you mean {closest(name, list(CATALOGUE))}?")
        if not isinstance(found, Mapping):
            expected = ", ".join(CATALOGUE[name].given_names)
            raise ParameterError(f"{where}: found {found!r}, expected {{{expected}}}")
        checked[name] = _check_effect(CATALOGUE[name], found, where)
        for other in CATALOGUE[name].stands_alone:
            if other in values:
                raise ParameterError(
                    f"{where}: found beside effects.{other}, whose place it takes; take one of the two out"
                )
    return checked


def _check_effect(effect: Effect, found: Mapping[str, object], where: str) -> dict[str, float]:
    given = effect.unpacked(found, where)
    names = [parameter.name for parameter in effect.parameters]
    expected = ", ".join(effect.given_names)
    for name in given:
        if name not in names:
            raise ParameterError(f"{where}.{name}: no such parameter; expected {expected}")
    missing = [name for name in names if name not in given]
    if missing:
        raise ParameterError(f"{where}: {missing[0]} is missing; expected {expected}")
    values = {
        parameter.name: parameter.check(given[parameter.name], f"{where}.{parameter.name}")
        for parameter in effect.parameters
    }
    if effect.expected is not None and (wrong := effect.expected(values)):
        raise ParameterError(f"{where}: {wrong}")
    return values
