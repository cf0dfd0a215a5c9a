"""A first map of a foreign recording: what each topic, field or column looks like, with every guess marked."""

from __future__ import annotations

import itertools
import re
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import yaml

from valve_sim.files.cells import kind_of
from valve_sim.files.channels import CHANNELS, SIGNALS, UNITS
from valve_sim.files.data_tables import is_table, open_table
from valve_sim.files.entries import Entries
from valve_sim.files.recording_map import MapError, TimeAxis, map_from, time_axis
from valve_sim.files.tables import EXCEL_DAYS, MOST_REPEATED, PARTS, DataTable, TableError
from valve_sim.model.errors import ValveError
from valve_sim.recordings.map_series import MOST_LEVELS, Series, bag_series, table_series
from valve_sim.recordings.reading import read_trace
from valve_sim.recordings.trace import TraceError
from valve_sim.recordings.trouble import MOST_AMPERES
from valve_sim.recordings.voltage_steps import count_levels

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from valve_sim.model import ValveParameters

    Array = NDArray[np.float64]

HINTS = {key: channel.hint for key, channel in CHANNELS.items() if channel.hint}
"""Words in the names of a channel's topics, fields and columns."""
BESIDE = [key for key in HINTS if key in SIGNALS and key != "voltage"]
"""What is looked for beside voltage and position."""
PLAIN = re.compile(r"(?:time|t|zeit|uhrzeit|timestamp|sec|seconds|elapsed).*", re.IGNORECASE)
FEW_MESSAGES = 0.2
"""A topic with less than this share of the messages of another is a command: sent when it changes."""
RESTS = 0.6
"""Share of a position's samples that are at either end, or more."""
ALIKE = 0.15
"""What is off by a smaller share of the declared stroke travels as far."""
UNLIKE = 4.0
"""A travel of so many strokes, or of so small a part of one, is not of this unit."""
MOST_LISTED = 40
WHOLE = re.compile(r"date|datum|day|tag|(.*[^a-z])?(s|sec|secs|seconds)", re.IGNORECASE)
"""Names of a column with days, or whole seconds, whose fractions are in the next one."""
TICKS, TICKS_NOW = "100ns", (1e17, 7e17)
"""As Windows counts since 1601, and .NET since year 1; nanoseconds since 1970 are more, and microseconds less."""
FORMS = tuple(
    f"{day} {clock}"
    for clock in ("%H:%M:%S.%f", "%H:%M:%S:%f", "%H:%M:%S,%f", "%I:%M:%S.%f %p")
    for day in ("%m/%d/%Y", "%d/%m/%Y", "%d-%b-%Y", "%d %b %Y", "%b %d, %Y", "%Y-%m-%d", "%d.%m.%Y")
)
"""Dates that are tried beside ISO and German ones."""
NANOSECONDS = (1e6, 1e9)
"""Between which the largest lies of a recording that lasts longer than a millisecond."""


class Guess(NamedTuple):
    """One line of a map: what is written, and why."""

    quantity: str
    series: Series
    settings: Mapping[str, object]
    reasons: Sequence[str]

    @property
    def lines(self) -> list[str]:
        """This entry as YAML on one line, after its reasons as comments; the first of them calls it a guess."""
        first, *others = self.reasons
        comments = [f"# {self.quantity} is a guess: {first}", *(f"# {reason}" for reason in others)]
        return [*comments, f"{self.quantity}: {_yaml({**self.series.place, **self.settings})}"]


def draft_map(path: Path, parameters: ValveParameters, command: str) -> str:
    """Draft the map of a recording from what it contains.

    Args:
        path: A bag or a table.
        parameters: The declared valve, whose stroke and voltage tell units apart.
        command: The command that asked for it, for the first line.

    Returns:
        The map's YAML; a comment says what each guess is based on, and CHECK marks what only its user can know.

    Raises:
        ValveError: The recording cannot be read, or nothing in it moves.
    """
    lines = [f"# Written by: {command}", "# A first guess: read each line. CHECK marks what only you can know."]
    if is_table(path):
        table = open_table(path)
        time, series, troubles = _time_line(table)
        lines += time
    else:
        series, troubles = bag_series(path)
    moving = [entry for entry in series if entry.span > 0.0 or _is_one_command(entry)]
    if not moving:
        unread = [f"{name} {words}" for name, words in troubles.items()]
        names = ", ".join([*(entry.name for entry in series), *unread][:12]) or "no number at all"
        raise TraceError(f"{path}: nothing in it moves ({names}); record while the valve works")
    moving = [entry for entry in moving if not _counts(entry) or re.search(HINTS["position"], entry.words)] or moving
    used: set[str] = set()
    for valve, guesses in _valves(moving, parameters).items():
        indent = ""
        if valve:
            lines += [*(["valves:"] if "valves:" not in lines else []), f"  {valve}:"]
            indent = "    "
        lines += [indent + line for guess in guesses for line in guess.lines]
        found = {guess.quantity for guess in guesses}
        if "position" not in found:
            alone = "; without one the current alone is gone by" if "current" in found else ""
            lines.append(f"{indent}# CHECK: no position found; add position: {{...}}{alone}")
        used |= {guess.series.name for guess in guesses}
    left = {**{entry.name: _range(entry) for entry in series if entry.name not in used}, **troubles}
    lines += [f"# not used: {name}, {words}" for name, words in itertools.islice(left.items(), MOST_LISTED)]
    if len(left) > MOST_LISTED:
        lines.append(f"# and {len(left) - MOST_LISTED} more")
    text = "\n".join(lines) + "\n"
    _check(path, text, {**{entry.name: _range(entry) for entry in series}, **troubles})
    return text


def _check(path: Path, text: str, there: Mapping[str, str]) -> None:
    """Refuse a draft that no command could read: a voltage or what the valve does is missing, or is not that."""
    try:
        drafted = map_from(yaml.safe_load(text), "the draft")
        for valve in drafted.valves:
            read_trace(path, valve, drafted)
    except ValveError as error:
        listed = "; ".join(f"{name}: {words}" for name, words in itertools.islice(there.items(), MOST_LISTED))
        why = str(error).removeprefix("the draft: ").removeprefix(f"{path}: ").partition(";")[0]
        raise TraceError(
            f"{path}: no draft can be read: {why}; write a map by hand, of what there is: {listed}"
        ) from None


def _range(entry: Series) -> str:
    """What a series reads, and so what it may be."""
    reads = f"{entry.low:.6g} to {entry.high:.6g}"
    if _counts(entry) or not entry.span:
        return f"{reads}, ascends: times or a counter" if entry.span else f"always {entry.low:.6g}"
    if np.unique(entry.values).size == 2:
        return f"{reads}, two levels: a switch or a command"
    if 2 <= count_levels(entry.values) <= MOST_LEVELS and entry.sharpness > 0.5:
        return f"{reads}, steps between levels: a voltage, or what is switched by it"
    if entry.rest_share > RESTS:
        return f"{reads}, rests at either end: a position between stops"
    return f"{reads}, hardly changes: a temperature or a pressure" if entry.span < 0.1 * abs(entry.low) else reads


def _valves(series: Sequence[Series], parameters: ValveParameters) -> dict[str, list[Guess]]:
    """Guesses by valve; one valve without a name unless numbers in the names tell several apart."""
    lifts = [entry for entry in series if re.search(HINTS["position"], entry.words)]
    volts = {entry.number for entry in series if re.search(f"{HINTS['command']}|{HINTS['voltage']}", entry.words)}
    numbers = sorted({entry.number for entry in lifts if entry.number and entry.number in volts})
    if len(numbers) < 2:
        return {"": _guesses(series, parameters)}
    return {
        f"/valve_{number}": _guesses([entry for entry in series if entry.number == number], parameters)
        for number in numbers
    }


def _guesses(series: Sequence[Series], parameters: ValveParameters) -> list[Guess]:
    """The quantities of one valve, the voltage first: the series that moves at its steps is the position.

    Beside a voltage that was sampled there may be the commands as they were sent.
    """
    rest = list(series)
    guesses: list[Guess] = []
    voltage = _best(rest, _voltage_score)
    if voltage is not None:
        rest.remove(voltage)
    # A laser's voltage is called one, too.
    others = [entry for entry in rest if not _is_voltage(entry)] or [own for own in rest if own.rest_share > RESTS]
    position = _best(others, partial(_position_score, stroke=parameters.stroke))
    if position is not None:
        rest.remove(position)
    if voltage is not None:
        guesses.append(_voltage_guess(voltage, max(len(entry.values) for entry in series), parameters))
        if guesses[0].quantity == "voltage":
            sent = [entry for entry in rest if _is_voltage(entry) and len(np.unique(entry.values)) <= MOST_LEVELS]
            for entry in sent[:1]:
                rest.remove(entry)
                guesses.append(Guess("command", entry, {}, [f"reads {entry.low:.4g} to {entry.high:.4g}"]))
    if position is not None:
        guesses.append(_position_guess("position", position, parameters))
        for main in [entry for entry in rest if _is_main(entry) and _names(entry, "position")][:1]:
            rest.remove(main)
            guesses.append(_position_guess("main_position", main, parameters))
    for quantity in BESIDE:
        named = [entry for entry in rest if _names(entry, quantity)]
        # A current without a name is taken to be the remaining channel of an oscilloscope.
        is_alone = len(rest) == 1 and "column" in rest[0].place
        unnamed = rest if quantity == "current" and is_alone and not any(_names(rest[0], own) for own in BESIDE) else []
        for entry in [found for found in named or unnamed if _is_possible(quantity, found, parameters)][:1]:
            rest.remove(entry)
            guesses.append(_other_guess(quantity, entry, is_named=bool(named), parameters=parameters))
    return guesses


def _counts(entry: Series) -> bool:
    """Whether a series grows from each value to the next, as stamps and counters do and no quantity of a valve does."""
    return len(entry.values) > MOST_LEVELS and bool((np.diff(entry.values) > 0.0).all())


def _is_possible(quantity: str, entry: Series, parameters: ValveParameters) -> bool:
    """Whether a series can be this quantity in any unit that a map knows, or in the one that its file states.

    A current that would be refused as soon as it is read is none, and nothing is colder than absolute zero.
    """
    channel = CHANNELS[quantity]
    units, (least, most) = UNITS[channel.dimension], channel.bounds
    possible = [units[entry.unit]] if entry.unit in units else list(units.values())
    if quantity == "current":
        # The drive may be of several times the reference voltage, as with peak and hold.
        amperes = MOST_AMPERES * parameters.reference_voltage / parameters.coil_resistance
        return any(unit.factor * max(abs(entry.low), abs(entry.high)) <= amperes for unit in possible)
    usual = float(np.median(entry.values))
    return any(least <= unit.factor * usual + unit.zero <= most for unit in possible)


def _best(series: Sequence[Series], score: Callable[[Series], float]) -> Series | None:
    ranked = sorted(series, key=score, reverse=True)
    return ranked[0] if ranked and score(ranked[0]) > 0.0 else None


def _names(entry: Series, quantity: str) -> bool:
    """Whether its words say that it is this quantity, or its unit where its words say no other."""
    if re.search(HINTS[quantity], entry.words):
        return True
    if any(re.search(HINTS[other], entry.words) for other in (*BESIDE, "position")):
        return False
    return entry.unit in UNITS[CHANNELS[quantity].dimension] and entry.unit not in ("g", "m")


def _voltage_score(entry: Series) -> float:
    """How much a series looks like a voltage that is switched."""
    levels = count_levels(entry.values)
    named = _names(entry, "command") or bool(re.search(HINTS["voltage"], entry.words))
    other = any(_names(entry, quantity) for quantity in ("position", *BESIDE))
    is_switched = 2 <= levels <= MOST_LEVELS
    return 2.0 * named + is_switched + (0.5 * entry.sharpness if is_switched else 0.0) - 2.0 * (other and not named)


def _position_score(entry: Series, stroke: float) -> float:
    """How much a series looks like a plunger between two stops that are so far apart, m."""
    other = any(_names(entry, quantity) for quantity in BESIDE)
    unit = UNITS["length"][_length_unit(entry, stroke)]
    is_as_far = abs(np.log(unit.factor * entry.span / stroke)) < ALIKE if entry.span else False
    return (
        2.0 * _names(entry, "position")
        + entry.rest_share
        - 2.0 * other
        + 0.1 * entry.is_first_choice
        + 0.3 * is_as_far
        - _is_main(entry)
    )


def _length_unit(entry: Series, stroke: float) -> str:
    """The unit that its file states, or in which it travels about as far as a stroke, m."""
    units = UNITS["length"]
    if entry.unit in units:
        return entry.unit
    return min(
        ("m", "mm", "um", "nm"), key=lambda name: abs(np.log(units[name].factor * max(entry.span, 1e-300) / stroke))
    )


def _is_voltage(entry: Series) -> bool:
    """Whether its name says that it is a voltage, and not also that it is a position."""
    says = re.search(f"{HINTS['command']}|{HINTS['voltage']}", entry.words) is not None
    return says and re.search(HINTS["position"], entry.words) is None


def _is_one_command(entry: Series) -> bool:
    """Whether it is a voltage that was commanded once, and held."""
    return len(entry.values) == 1 and entry.high != 0.0 and _is_voltage(entry)


def _is_main(entry: Series) -> bool:
    return re.search(r"main", entry.words) is not None


def _voltage_guess(entry: Series, most: int, parameters: ValveParameters) -> Guess:
    """What a voltage is; `most`: values of the longest series beside it."""
    reasons = [f"reads {entry.low:.4g} to {entry.high:.4g}"]
    settings: dict[str, object] = {}
    is_bag = "topic" in entry.place
    few = len(entry.values) < FEW_MESSAGES * most
    named = bool(re.search(HINTS["command"], entry.words))
    exact = len(np.unique(entry.values)) <= MOST_LEVELS
    quantity = "command" if (is_bag and few) or (named and exact) or (not is_bag and exact) else "voltage"
    reasons.append("sent when it changes" if is_bag and few else "steps between few levels")
    if entry.unit in UNITS["voltage"]:
        settings["unit"] = entry.unit
    highest = max(abs(entry.low), abs(entry.high))
    ratio = highest / parameters.reference_voltage
    if "unit" not in settings and ratio > 100.0:
        settings["unit"] = "mV"
        reasons.append("CHECK unit: by the declared reference_voltage")
    elif ratio < 0.3:
        reasons.append(
            f"CHECK: the declared valve has {parameters.reference_voltage:g} V; behind a divider? then scale: 10, say"
        )
    return Guess(quantity, entry, settings, reasons)


def _position_guess(quantity: str, entry: Series, parameters: ValveParameters) -> Guess:
    reasons = [f"reads {entry.low:.6g} to {entry.high:.6g}, at rest {entry.at_rest:.6g}"]
    settings: dict[str, object] = {}
    units = UNITS["length"]
    unit = _length_unit(entry, parameters.stroke)
    if entry.unit in units:
        reasons.append("unit as the file says")
    else:
        reasons.append(f"CHECK unit: travels {entry.span:.4g}, the declared stroke is {parameters.stroke:.4g} m")
        ratio = parameters.stroke / (units[unit].factor * entry.span)
        if not 1.0 / UNLIKE < ratio < UNLIKE:
            reasons.append(f"CHECK scale: of a sensor in % or in V? Then scale: {ratio:.4g}")
    settings["unit"] = unit
    sign = -1 if entry.at_rest - entry.low > entry.high - entry.at_rest else 1
    if sign < 0:
        settings["sign"] = -1
        reasons.append("CHECK sign: it begins at its highest, taken for closed")
    if abs(entry.at_rest) > 0.05 * entry.span:
        settings["offset"] = float(f"{-sign * entry.at_rest:.6g}")
        reasons.append("offset: of the first samples, taken for closed")
    return Guess(quantity, entry, settings, reasons)


def _other_guess(quantity: str, entry: Series, *, is_named: bool, parameters: ValveParameters) -> Guess:
    dimension = CHANNELS[quantity].dimension
    units = UNITS[dimension]
    unit = entry.unit if entry.unit in units else next(iter(units))
    highest = max(abs(entry.low), abs(entry.high))
    if quantity == "current" and entry.unit not in units:
        expected = parameters.reference_voltage / parameters.coil_resistance
        unit = "mA" if highest > 30.0 * expected else "A"
    reasons = [f"reads {entry.low:.4g} to {entry.high:.4g}", "by its name" if is_named else "CHECK: what else is there"]
    if entry.unit not in units:
        reasons.append("CHECK unit, and scale: of a probe")
    if CHANNELS[quantity].to_check:
        reasons.append(f"CHECK {CHANNELS[quantity].to_check}")
    return Guess(quantity, entry, {"unit": unit}, reasons)


def _time_line(table: DataTable) -> tuple[list[str], list[Series], dict[str, str]]:
    """The lines about time, what the other columns hold, and why those are left out that cannot be read, by name."""
    columns, troubles = {}, {}
    for name in table.names:
        try:
            columns[name] = table.column(name)
        except TableError as error:  # words
            troubles[name] = (
                str(error).removeprefix(f"{table.path}: ").partition(";")[0].replace(f"column {name}: ", "")
            )
    parts = [pair for pair in itertools.pairwise(table.names) if _is_part(table, columns, *pair)]
    with np.errstate(invalid="ignore"):  # of readings beyond the range
        steps_of = {name: np.diff(_begun(values)) for name, values in columns.items() if len(values) > 1}
    dating = {name: steps for name, steps in steps_of.items() if _dates(name, steps)}
    usable = [name for name, steps in dating.items() if np.mean(steps == 0.0) <= 1.0 / MOST_REPEATED]
    named = [name for name in usable if PLAIN.fullmatch(name)]
    tried = [_whole_stamp(table, pair) for pair in parts]
    tried += [_stamp(table, name, columns[name]) for name in (*named, *usable)[:1]]
    tried += [_dated(table, name) for name in troubles]
    entry, reason = next((found for found in tried if found), (None, ""))
    if entry is None and table.interval[0]:
        entry, reason = {"rate": float(f"{1.0 / table.interval[0]:.9g}")}, f"CHECK: by {table.interval[1]} in its head"
    if entry is None:
        _refuse_one_value_a_row(table, troubles)
        coarse = next((name for name in dating if PLAIN.fullmatch(name)), "")
        why = f"column {coarse} repeats: it has too few digits" if coarse else _without_times(table, troubles)
        raise TraceError(
            f"{table.path}: {why}, and nothing else says when its rows were taken; write a map by hand with "
            "time: {rate: ...} (rows a second), or export the times"
        )
    axis = time_axis(Entries("", MapError), entry)
    taken = columns.get(axis.columns[0]) if len(axis.columns) == 1 else None
    clocks = (
        []
        if taken is None
        else [
            name
            for name, own in columns.items()
            if name not in axis.columns
            and _is_another_clock(own, _begun(taken), is_time=name.startswith(axis.columns[0]))
        ]
    )
    others = {
        name: own
        for name, own in columns.items()
        if name not in (*axis.columns, *clocks) and not table.holds_dates(name)
    }
    series = table_series(table, others, _clock_of(table.names, axis, clocks))
    steps = np.diff(table.row_times(axis, may_end=bool(clocks)).times)
    rate = 1.0 / float(np.median(steps[steps > 0.0]))
    lines = [f"# {rate:.6g} rows a second; {reason}", f"time: {_yaml(entry)}"]
    lines += [
        f"# CHECK: {name} is another column of times, and is taken for that of the columns after it" for name in clocks
    ]
    return lines, series, {name: words for name, words in troubles.items() if name not in axis.columns}


def _without_times(table: DataTable, troubles: Mapping[str, str]) -> str:
    """Why no column says when the rows were taken: that whose name says that it does, or else the first broken one."""
    for name in table.names:
        says_so = PLAIN.fullmatch(name) or any(part.fullmatch(name) for part in PARTS.values())
        if not says_so and table.units.get(name) not in UNITS["time"]:
            continue
        errors = [words for _, words in _tried(table, name)]
        if all(errors):
            # Of dates that one of the forms fits, it is their times that are wrong.
            why = next((words for words in errors if ": found " not in words), errors[0])
            return why.removeprefix(f"{table.path}: ").partition(";")[0]
    return next((f"column {name}: {words}" for name, words in troubles.items()), "no column ascends")


def _tried(table: DataTable, name: str) -> Iterator[tuple[str, str]]:
    """Forms of dates, the first empty: numbers and dates that are known; and why a column holds no such times."""
    for form in ("", *FORMS):
        try:
            table.row_times(TimeAxis((name,), form=form))
        except TableError as error:
            yield form, str(error)
        else:
            yield form, ""


def _begun(values: Array) -> Array:
    """A column without the empty cells at its end, where others are longer."""
    seen = np.isfinite(values)
    return values[: len(values) - int(np.argmax(seen[::-1]))] if seen.any() else values


def _clock_of(names: Sequence[str], axis: TimeAxis, clocks: Sequence[str]) -> dict[str, str]:
    """The column of times that each column comes after, where it is not the rows'."""
    found, clock = {}, ""
    for name in names:
        clock = name if name in clocks else "" if name in axis.columns else clock
        if clock:
            found[name] = clock
    return found


def _is_another_clock(values: Array, taken: Array, *, is_time: bool) -> bool:
    """Whether a column grows by equal steps, as times do, from about where a column of times begins, but is another.

    One that counts rows is none, unless its name is that of the column of times.
    """
    seen = values[np.isfinite(values)]
    steps, usual = np.diff(seen), float(np.median(np.diff(taken)))
    if len(steps) < MOST_LEVELS or not np.ptp(steps) < 0.01 * abs(float(steps.mean())):
        return False
    if (steps == 1.0).all() and not is_time:
        return False
    begins_near = abs(float(seen[0] - taken[0])) < MOST_LEVELS * usual
    is_other = seen[0] != taken[0] or len(seen) != len(taken) or abs(float(steps.mean()) - usual) > 0.01 * usual
    return bool(begins_near and is_other)


def _refuse_one_value_a_row(table: DataTable, names: Iterable[str]) -> None:
    """Refuse a table in which a column of few words says what each row has a value of, as archives of a PLC do."""
    for name in names:
        words = list(dict.fromkeys(table.texts(name)))
        if 1 < len(words) <= MOST_LEVELS < table.rows and all(kind_of(word) in ("word", "") for word in words):
            raise TraceError(
                f"{table.path}: each row has the value of one quantity, which column {name} names "
                f"({', '.join(words[:4])}); export a column for each"
            )


def _is_part(table: DataTable, columns: Mapping[str, Array], first: str, second: str) -> bool:
    """Whether two columns hold one time: a day and a time of day, or seconds and their fractions."""
    if first.isdigit():  # without names: as `ros2 topic echo --csv` writes a stamp
        return {first, second} <= set(columns) and _is_stamp(columns[first], columns[second])
    is_fraction = any(part.fullmatch(second) for part in PARTS.values())
    if is_fraction and PLAIN.fullmatch(first) and table.holds_dates(first):
        return True
    return (is_fraction or PLAIN.fullmatch(second) is not None) and WHOLE.fullmatch(first) is not None


def _is_stamp(seconds: Array, rest: Array) -> bool:
    """Whether two columns hold seconds that ascend and their nanoseconds."""
    are_whole = all((own == np.round(own)).all() and own.min() >= 0.0 for own in (seconds, rest))
    return bool(are_whole and (np.diff(seconds) >= 0.0).all() and NANOSECONDS[0] < rest.max() < NANOSECONDS[1])


def _whole_stamp(table: DataTable, pair: tuple[str, str]) -> tuple[dict[str, object], str] | None:
    """The entry of a time in two columns, if it is one."""
    unit = next((name for name, part in PARTS.items() if part.fullmatch(pair[1])), "ns" if pair[0].isdigit() else "")
    entry: dict[str, object] = {"column": list(pair), **({"unit": ["s", unit]} if unit else {})}
    try:
        table.row_times(time_axis(Entries("", MapError), entry))
    except TableError:
        return None
    return entry, "time in two columns"


def _stamp(table: DataTable, name: str, values: Array) -> tuple[dict[str, object], str]:
    """The entry of a time in a column of numbers or of dates that are known."""
    step = float(np.median(np.diff(values)[np.diff(values) > 0.0]))
    units = UNITS["time"]
    unit, reason = table.units.get(name, ""), "unit as the file says"
    if unit.lower().startswith("s"):
        unit = "s"
    if unit not in units:
        is_calendar = EXCEL_DAYS[0] < values[0] < EXCEL_DAYS[1] and step < 1e-4
        known = ("d",) if is_calendar else ("s", "ms", "us", "ns", "d")
        known = (TICKS,) if TICKS_NOW[0] < values[0] < TICKS_NOW[1] else known
        unit = next((own for own in known if 2e-7 < units[own].factor * step < 2e-2), "s")
        reason = "CHECK unit"
    return {"column": name, "unit": unit}, reason


def _dated(table: DataTable, name: str) -> tuple[dict[str, object], str] | None:
    """The entry of dates of another form, if one of those that are usual fits."""
    form = next((form for form, trouble in _tried(table, name) if form and not trouble), "")
    return (
        ({"column": name, "format": form}, "CHECK format: day and month may be the other way round") if form else None
    )


def _dates(name: str, steps: Array) -> bool:
    """Whether a column may be of times: it never falls, and is no counter of rows unless its name says time."""
    if not ((steps >= 0.0).all() and steps.any()):
        return False
    counts = bool((steps == np.round(steps)).all()) and float(np.median(steps)) == 1.0
    return not counts or PLAIN.fullmatch(name) is not None


def _yaml(entry: Mapping[str, object]) -> str:
    """An entry of a map on one line."""
    return yaml.safe_dump(
        dict(entry), default_flow_style=True, sort_keys=False, allow_unicode=True, width=2**20
    ).strip()
