"""The parts of a model description that the libraries leave out: units, and which outputs are known at the start."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Final
from xml.etree.ElementTree import Element, SubElement

from valve_sim.fmu.variables import Variable

_SUPERSCRIPTS: Final = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹", "0123456789")
_BASES: Final[dict[str, dict[str, int]]] = {
    "kg": {"kg": 1},
    "m": {"m": 1},
    "s": {"s": 1},
    "A": {"A": 1},
    "K": {"K": 1},
    "Hz": {"s": -1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
    "W": {"kg": 1, "m": 2, "s": -3},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
    "Ohm": {"kg": 1, "m": 2, "s": -3, "A": -2},
    "Wb": {"kg": 1, "m": 2, "s": -2, "A": -1},
    "H": {"kg": 1, "m": 2, "s": -2, "A": -2},
}
"""Units as powers of the base units of FMI."""
_TIME: Final = ("time", "s")
"""The variable that FMI 3.0 has beside those of the valve, and its unit."""


def unit_name(unit: str) -> str:
    """A unit as FMI writes it: N·s²/m² is N.s2/m2. A pure number has none, nor has what may be of several units."""
    name = unit.replace("–", "").replace("·", ".").replace("Ω", "Ohm").translate(_SUPERSCRIPTS)
    return "" if " or " in name else name


def base_powers(name: str) -> dict[str, int] | None:
    """Powers of the base units of a unit as FMI writes it, such as {"kg": 1, "s": -1}; None where it has others."""
    powers: Counter[str] = Counter()
    above, *below = name.split("/")
    for sign, part in ((1, above), *((-1, part) for part in below)):
        for factor in part.strip("()").split("."):
            found = re.fullmatch(r"([A-Za-z]+)(\d*)", factor)
            if factor == "1":
                continue
            if found is None or found[1] not in _BASES:
                return None
            for base, power in _BASES[found[1]].items():
                powers[base] += sign * power * int(found[2] or 1)
    return {base: power for base, power in powers.items() if power}


def unit_definitions(variables: Sequence[Variable]) -> Element:
    """The element UnitDefinitions of both versions, with each unit once."""
    definitions = Element("UnitDefinitions")
    for name in sorted({_TIME[1], *(unit_name(entry.unit) for entry in variables)} - {""}):
        unit = SubElement(definitions, "Unit", {"name": name})
        powers = base_powers(name)
        if powers is not None:
            SubElement(unit, "BaseUnit", {base: str(power) for base, power in powers.items()})
    return definitions


def complete(root: Element, variables: Sequence[Variable], references: Mapping[str, int]) -> Element:
    """Complete a model description as a library makes it, of either version.

    Args:
        root: changed. variables: all of them. references: name to the library's value reference.
    """
    is_second = root.attrib["fmiVersion"].startswith("2")
    before = next(place for place, found in enumerate(root) if found.tag in ("LogCategories", "ModelVariables"))
    root.insert(before, unit_definitions(variables))
    units = dict((_TIME, *((entry.name, unit_name(entry.unit)) for entry in variables)))
    for found in root.iterfind("ModelVariables/*"):
        holder = found[0] if is_second else found
        if unit := units[found.attrib["name"]]:
            holder.set("unit", unit)
    if is_second:
        structure = root.find("ModelStructure")
        assert structure is not None
        unknowns = SubElement(structure, "InitialUnknowns")
        for entry in variables:
            if entry.causality == "output":
                SubElement(unknowns, "Unknown", {"index": str(references[entry.name] + 1)})
    return root
