"""The parameters of a valve as the compiled core reads them: one record, made from the entries of the catalogue."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from valve_sim.model.core_types import MAXIMUM_TERM_PARAMETERS, MAXIMUM_TERMS
from valve_sim.model.effects.catalogue import CATALOGUE, shipped
from valve_sim.model.effects.entry import Effect
from valve_sim.model.parameters import DECLARED


def neutral_fields(*, of_gas: bool) -> dict[str, float]:
    """Every field that the core has for an effect, with its neutral value; or those that it has with gas alone."""
    fields: dict[str, float] = {}
    for effect in shipped():
        for name, neutral in effect.fields.items() if bool(effect.with_gas) is of_gas else ():
            assert fields.setdefault(name, neutral) == neutral, f"{name} has one neutral value"
    return fields


_FIELDS: Final = neutral_fields(of_gas=False)

VALVE_RECORD: Final = np.dtype(
    [
        # The declared valve, after the effects that add to it or rewrite it.
        *((name, "f8") for name in DECLARED),
        # What the core's mechanisms read for the effects that need one.
        *((name, "f8") for name in _FIELDS),
        # Compiled force terms: addresses, whether they act in Phase 2 only, their forms, and the numbers they read.
        ("term_count", "i8"),
        ("terms_read_time", "i8"),  # 1 where one of them may change while nothing else does
        ("term_address", "i8", (MAXIMUM_TERMS,)),
        ("term_in_phase_2_only", "i8", (MAXIMUM_TERMS,)),
        ("term_parameters", "f8", (MAXIMUM_TERMS, MAXIMUM_TERM_PARAMETERS)),
    ],
    align=True,
)
"""The parameters of a valve, with its effects, in the compiled core."""


def _blank_record() -> Any:
    records = np.zeros(1, VALVE_RECORD)
    for name, neutral in _FIELDS.items():
        records[name] = neutral
    return records


_BLANK: Final = _blank_record().tobytes()
"""As bytes: NumPy copies a record field by field."""


def new_record(declared: Mapping[str, float], effects: Mapping[str, Mapping[str, float]]) -> Any:
    """A valve as the compiled core reads it.

    Args:
        declared: every name of `DECLARED` to its value, SI.
        effects: the effects that are on; a parameter that is not given has its neutral value.

    Returns:
        (1,) VALVE_RECORD array. What effects of gas alone rewrite is of a longer record, see `gas.record`.
    """
    memory = bytearray(_BLANK)
    records = np.frombuffer(memory, VALVE_RECORD)
    # Written at once, as one array: field by field takes longer than a simulation.
    np.frombuffer(memory, np.float64)[: len(DECLARED)] = [declared[name] for name in DECLARED]
    whole, record = whole_effects(effects), records[0]
    for effect, values in whole:
        if not effect.with_gas:
            effect.apply_rewrite(record, values)
    for effect, values in whole:
        effect.apply_term(record, values)
    return records


def whole_effects(effects: Mapping[str, Mapping[str, float]]) -> list[tuple[Effect, Mapping[str, float]]]:
    """Entries of effects that are on, each with a value of every parameter: its neutral one where none is given."""
    entries = [(CATALOGUE[name], values) for name, values in effects.items()]
    return [
        (effect, values if len(values) == len(effect.parameters) else {**effect.neutral_values(), **values})
        for effect, values in entries
    ]
