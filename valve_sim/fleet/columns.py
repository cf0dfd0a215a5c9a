"""The columns of the table: name, type, unit and meaning. What the file says of itself follows from them."""

from __future__ import annotations

from typing import Final, NamedTuple

from valve_sim.model import CATALOGUE, DECLARED

SCHEMA: Final = "valve_sim/fleet/2"
"""Name of the table's form, in its metadata."""

TEXT, NUMBER, COUNT, TIME, LIST, TRUTH = "text", "number", "count", "time", "list of texts", "truth"
"""Types of columns, which `table` gives to Parquet."""


class Column(NamedTuple):
    """One column: its type is one of those above; `unit` is empty where it has none."""

    name: str
    type: str
    unit: str
    meaning: str


_OF_A_BAG: Final = (
    Column("source", TEXT, "", "the bag; absolute where it is local"),
    Column("valve", TEXT, "", "its name in the bag; empty where the bag could not be read or is a duplicate"),
    Column("state", TEXT, "", "examined, unreadable, duplicate, failed, or lost: that is done again by the next run"),
    Column("error", TEXT, "", "why there is no result, in one line; else empty"),
    Column("start_time", TIME, "", "first stamp of commands or samples, UTC"),
    Column("duration", NUMBER, "s", "from the first to the last sample"),
    Column("strokes", COUNT, "", "strokes in the bag"),
    Column("samples", COUNT, "", "samples of the position or, without any, of the current"),
    Column("findings", LIST, "", "what was dropped or repaired on reading"),
)
_OF_A_DIAGNOSIS: Final = (
    Column("verdict", TEXT, "", "none, effects, partly, unknown or insufficient, as in report.json"),
    Column("effects", LIST, "", "effects that are named"),
    Column("out_of_tolerance", LIST, "", "declared values beyond 3 of their tolerances"),
    Column("probability", NUMBER, "", "posterior, of what the verdict claims"),
    Column("summary", TEXT, "", "the verdict in one sentence"),
    Column("white", TRUTH, "", "whether what the refitted declared valve leaves is noise"),
    Column("p_value", NUMBER, "", "of that test"),
    Column("noise", NUMBER, "m", "of the position sensor; null, as errors are, where no position was recorded"),
    Column("rmse_before", NUMBER, "m", "rms error of the declared valve, refitted, on fitted strokes"),
    Column("rmse_before_holdout", NUMBER, "m", "the same on held-out strokes; null where none were held out"),
    Column("rmse_after", NUMBER, "m", "rms error of the corrected valve on fitted strokes"),
    Column("rmse_after_holdout", NUMBER, "m", "the same on held-out strokes"),
    Column("report", TEXT, "", "the report of what was found, below the folder of the table; else null"),
)
_LAST: Final = (
    Column("seconds", NUMBER, "s", "of a processor"),
    Column("size", COUNT, "", "bytes of the bag"),
    Column("content", TEXT, "", "SHA-256 of the bag's bytes"),
    Column("stamp", TEXT, "", "changes when the bag is written again"),
    Column("bag_valves", LIST, "", "all valves of the bag"),
    Column("version", TEXT, "", "of valve_sim"),
    Column("key", TEXT, "", "what is done again when it changes: content, valve, parameters, version and options"),
)


class Quantity(NamedTuple):
    """What is estimated of every valve: the column of its value; that of its standard error ends with `_stderr`."""

    name: str
    unit: str
    meaning: str

    @property
    def stderr(self) -> str:
        """Column of the standard error."""
        return f"{self.name}_stderr"


MOTION: Final = (
    Quantity("opening_delay", "s", "from reference voltage until the pilot plunger leaves its seat"),
    Quantity("t1", "s", "from reference voltage until the pilot plunger reaches the main plunger"),
    Quantity("t2", "s", "from reference voltage until the stop"),
    Quantity("closing_time", "s", "from 0 V, held open before, until the pilot plunger is back on its seat"),
)
"""Of the valve as it was identified, at one voltage, so that bags of any strokes can be compared."""


BEFORE: Final = "_before"
"""Ends the name of a column of the declared valve as it was refitted to each bag, in the same way: bags compare."""


def effect_column(name: str) -> str:
    """The column of `<effect>.<parameter>`: without a dot, which stands for nesting in Parquet."""
    return name.replace(".", "_")


def declared_quantities() -> tuple[Quantity, ...]:
    """Every declared value of a valve."""
    return tuple(Quantity(own.name, own.unit, own.description) for own in DECLARED.values())


def effect_quantities() -> tuple[Quantity, ...]:
    """Every parameter of every effect."""
    return tuple(
        Quantity(effect_column(f"{effect.name}.{own.name}"), own.unit, f"{effect.name}.{own.name}: {own.description}")
        for effect in CATALOGUE.values()
        if effect.named
        for own in effect.parameters
    )


def quantities() -> tuple[Quantity, ...]:
    """All that is estimated of the corrected valve: motion, declared parameters, parameters of effects."""
    return (*MOTION, *declared_quantities(), *effect_quantities())


def followed() -> tuple[Quantity, ...]:
    """What is followed over time: motion and declared parameters of the declared valve, refitted."""
    return tuple(
        Quantity(f"{own.name}{BEFORE}", own.unit, f"{own.meaning}; of the declared valve, refitted")
        for own in (*MOTION, *declared_quantities())
    )


def columns() -> tuple[Column, ...]:
    """All columns, in order."""
    estimates = [
        column
        for own in (*quantities(), *followed())
        for column in (
            Column(own.name, NUMBER, own.unit, own.meaning),
            Column(own.stderr, NUMBER, own.unit, f"standard error of {own.name}"),
        )
    ]
    return (*_OF_A_BAG, *_OF_A_DIAGNOSIS, *estimates, *_LAST)
