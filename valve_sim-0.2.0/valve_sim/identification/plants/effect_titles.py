"""What people call an effect, in the catalogue or a plant's own, and lists of such names within a sentence."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Final

from valve_sim.identification.plants.protocol import Plant
from valve_sim.identification.plants.tolerances import GROUP
from valve_sim.model import CATALOGUE

WRONG: Final = ("valve.", GROUP)
"""Begin the names of declared values that are taken for wrong."""


def title_of(effect: str) -> str:
    """The plain name of an effect in the catalogue or of a plant's own, or of a declared value that is wrong."""
    if effect.startswith(WRONG):
        return f"Wrong {effect.partition('.')[2].replace('_', ' ')}"
    plain = effect.replace("_", " ")
    fallback = plain[:1].upper() + plain[1:]
    entry = CATALOGUE.get(effect)
    return fallback if entry is None else entry.title


def titles_of(effects: Sequence[str]) -> str:
    """Plain names of several effects at once."""
    return " + ".join([title_of(effects[0]), *(inside_sentence(title_of(name)) for name in effects[1:])])


def named(effects: Sequence[str], last: str = "and") -> str:
    """Plain names of effects within a sentence: Coulomb friction, coil lag and squeeze film."""
    return listed([inside_sentence(title_of(effect)) for effect in effects], last)


def what_is_missing(effects: Sequence[str], declared: Collection[str] = ()) -> str:
    """What a model lacks, in a sentence: "lacks Coulomb friction and has a wrong spring rate"; some may be declared."""
    wrong = [effect for effect in effects if effect.startswith(WRONG)]
    grown = [effect for effect in effects if effect in declared and effect not in wrong]
    lacks = [effect for effect in effects if effect not in wrong and effect not in grown]
    parts = [f"lacks {named(lacks)}"] if lacks else []
    parts += [f"declares another size of {named(grown)}"] if grown else []
    return " and ".join([*parts, *([f"has a {named(wrong)}"] if wrong else [])])


def named_value(plant: Plant, name: str) -> tuple[str, str]:
    """What people call a parameter, and its unit: Coulomb friction, friction force."""
    effect, dot, own = name.partition(".")
    parameter = plant.parameter(name)
    if name.startswith(GROUP):
        return own.replace("_", " "), parameter.unit
    words = f"{title_of(effect)}: {parameter.description}" if dot else name.replace("_", " ")
    return words, parameter.unit


def inside_sentence(title: str) -> str:
    """A title within a sentence: small, but for a name such as Coulomb."""
    return title if title.startswith("Coulomb") or title[1:2].isupper() else title[:1].lower() + title[1:]


def capitalised(sentence: str) -> str:
    """A sentence with a capital at its beginning."""
    return sentence[:1].upper() + sentence[1:]


def listed(parts: Sequence[str], last: str = "and") -> str:
    """Parts as in a sentence: a, b and c."""
    return f" {last} ".join(part for part in (", ".join(parts[:-1]), *parts[-1:]) if part)
