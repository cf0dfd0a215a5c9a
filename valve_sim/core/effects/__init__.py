"""Effects that the reference model lacks: one file each, with everything about its effect.

Parameter files, checks, equations and derivatives follow from the entry; `valve_sim.core.effects.entry` says what it
holds. The `EFFECT` of every module here takes part, and so does what a program registers in a catalogue of its own.
"""

from __future__ import annotations

import functools
import importlib
import pkgutil
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Final

from valve_sim.core.effects.entry import Effect, Motion, Own, added, replaced
from valve_sim.model.errors import ParameterError
from valve_sim.model.parameters import closest

_NO_EFFECTS: Final = ("entry",)


@functools.cache
def shipped() -> Mapping[str, Effect]:
    """The effects of this package by name."""
    names = [found.name for found in pkgutil.iter_modules([str(Path(__file__).parent)])]
    entries = [importlib.import_module(f"{__name__}.{name}").EFFECT for name in names if name not in _NO_EFFECTS]
    return MappingProxyType({entry.name: entry for entry in entries})


def check_effects(
    values: Mapping[str, Mapping[str, object]], source: str, catalogue: Mapping[str, Effect]
) -> dict[str, dict[str, float]]:
    """Turn a mapping of effects as found in a file into checked values.

    Args:
        values: effect name to {parameter: value}.
        source: the file or node, for messages.
        catalogue: the effects that there are.

    Raises:
        ParameterError: unknown effect or parameter, missing parameter, wrong type, out of range, or two effects of
            which one takes the place of the other.
    """
    checked = {}
    for name, found in values.items():
        where = f"{source}: effects.{name}"
        if name not in catalogue:
            raise ParameterError(f"{where}: no such effect; did you mean {closest(name, list(catalogue))}?")
        checked[name] = _check_effect(catalogue[name], found, where)
        for other in catalogue[name].stands_alone:
            if other in values:
                raise ParameterError(
                    f"{where}: found beside effects.{other}, whose place it takes; take one of the two out"
                )
    return checked


def _check_effect(effect: Effect, found: object, where: str) -> dict[str, float]:
    expected = ", ".join(effect.names)
    if not isinstance(found, Mapping):
        raise ParameterError(f"{where}: found {found!r}, expected {{{expected}}}")
    if effect.unpack is not None:
        found = effect.unpack(found, where)
    for name in found:
        if name not in effect.names:
            raise ParameterError(f"{where}.{name}: no such parameter; expected {expected}")
    for name in effect.names:
        if name not in found:
            raise ParameterError(f"{where}: {name} is missing; expected {expected}")
    return {p.name: p.check(found[p.name], f"{where}.{p.name}") for p in effect.parameters}


__all__ = ["Effect", "Motion", "Own", "added", "check_effects", "replaced", "shipped"]
