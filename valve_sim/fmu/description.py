"""The parts of a model description that the library leaves out: units, and which outputs are known at the start."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final
from xml.etree.ElementTree import Element, SubElement

from valve_sim.fmu.variables import Variable
from valve_sim.model.core.own.units import UnitError, parse_unit

_SUPERSCRIPTS: Final = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹", "0123456789")
_BASES: Final = ("m", "kg", "s", "A", "K")
"""Base units of FMI, in the order of a `Dimension`."""


def unit_name(unit: str) -> str:
    """A unit as FMI writes it: N·s²/m² is N.s2/m2. Empty for a pure number and for several units."""
    name = unit.replace("–", "").replace("·", ".").replace("Ω", "Ohm").translate(_SUPERSCRIPTS)
    return "" if " or " in name else name


def base_powers(unit: str) -> dict[str, int] | None:
    """Powers of the base units of a unit of the model, such as {"kg": 1, "s": -1}; None where it is no unit."""
    try:
        dimension = parse_unit(unit).dimension
    except UnitError:
        return None
    return {base: round(power) for base, power in zip(_BASES, dimension, strict=True) if power}


def unit_definitions(variables: Sequence[Variable]) -> Element:
    """The element UnitDefinitions, with each unit once."""
    definitions = Element("UnitDefinitions")
    for name, own in sorted({unit_name(own): own for own in (entry.unit for entry in variables)}.items()):
        if not name:
            continue
        unit = SubElement(definitions, "Unit", {"name": name})
        powers = base_powers(own)
        if powers is not None:
            SubElement(unit, "BaseUnit", {base: str(power) for base, power in powers.items()})
    return definitions


def complete(root: Element, variables: Sequence[Variable], references: Mapping[str, int]) -> Element:
    """Complete a model description as the library makes it.

    Args:
        root: changed. variables: all of them. references: name to the library's value reference.
    """
    before = next(place for place, found in enumerate(root) if found.tag in ("LogCategories", "ModelVariables"))
    root.insert(before, unit_definitions(variables))
    units = {entry.name: unit_name(entry.unit) for entry in variables}
    for found in root.iterfind("ModelVariables/*"):
        if unit := units[found.attrib["name"]]:
            found[0].set("unit", unit)
    structure = root.find("ModelStructure")
    assert structure is not None
    unknowns = SubElement(structure, "InitialUnknowns")
    for entry in variables:
        if entry.causality == "output":
            SubElement(unknowns, "Unknown", {"index": str(references[entry.name] + 1)})
    return root
