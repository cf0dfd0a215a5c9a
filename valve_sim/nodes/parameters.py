"""The one mechanism of the nodes' parameters, without ROS: settings declare, check, describe and document themselves.

A node's settings are a dataclass whose fields are made by `option`: the default, the meaning, the unit and the range
stand together. Its table of parameters follows from that. valve_node and monitor_node have a valve in theirs, too.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any, ClassVar, Final, NamedTuple, Protocol, TypeVar

from valve_sim.files.entries import short
from valve_sim.files.parameter_files import check_with_off, off_value
from valve_sim.files.parameter_sections import Section
from valve_sim.model import Parameter, ParameterError
from valve_sim.model.parameters import closest

Value = Any
"""Of a parameter: bool, int, float, str, or a list of floats or texts."""

VALVE_KEYS: Final = ("valve.", "effects.", "gas.", "tolerances.")
"""What the names of parameters that describe a valve, not a node, begin with."""
PLANT_KEY: Final = "parameters."
"""What the names of the parameters of a machine of a plant file begin with."""
OF_ANY_NODE: Final = frozenset((
    "publish_rate", "time_scale", "command_timeout", "max_voltage", "frame_id", "plant", "bag", "map", "valve_name",
    "params", "free", "rate", "loop", "apply_to", "apply_always", "output", "linger", "mode", "budget", "valve_node",
    "measured", "state", "commissioning_strokes", "diagnosis_strokes", "strokes_between_false_alarms",
    "stroke_timeout", "settle", "patience", "noise_um", "max_rate", "profile", "valve", "listener", "valves",
    "monitors", "alarms", "folder", "years", "megabytes", "serial_numbers", "address", "port", "anonymous_read",
    "history_days", "voltage", "watchdog", "plc_host", "first_register", "unit", "low_word_first", "map_file",
))  # fmt: skip
"""The settings of all nodes of this package; a node that looked into the tables of the others would load their work."""
ROS_OWN: Final = ("use_sim_time", "start_type_description_service")
ROS_OWN_PREFIX: Final = "qos_overrides."
LONGEST_TEXT: Final = 4096
"""Characters of a parameter: as many as the longest path of a file."""
LONGEST_LIST: Final = 1000
_TYPES: Final = {bool: "bool", int: "integer", float: "double", str: "string"}


class NodeParameter(NamedTuple):
    """One parameter of a node.

    Attributes:
        name: flat, dotted.
        default: gives the type too: bool, int, float, text, or a list of floats or texts. Empty texts of a given list
            count only where one is in the default.
        meaning: in words. unit: of a number or of each in a list; empty for none.
        rule: range of a number, or of each in a list; None for any.
        choices: all that a text may be; empty for any.
        read_only: whether it is read once, at the start.
    """

    name: str
    default: Value
    meaning: str
    unit: str = ""
    rule: Parameter | None = None
    choices: tuple[str, ...] = ()
    read_only: bool = True

    @property
    def description(self) -> str:
        """Unit first."""
        return f"[{self.unit}] {self.meaning}" if self.unit else self.meaning

    @property
    def choice_words(self) -> str:
        """All that it may be, in words."""
        return " or ".join(self.choices) if len(self.choices) == 2 else f"one of {', '.join(self.choices)}"

    @property
    def type(self) -> str:
        """The type, in the words of `ros2 param describe`."""
        if isinstance(self.default, Sequence) and not isinstance(self.default, str):
            return f"{_TYPES[type(self.default[0])]} array"
        return _TYPES[type(self.default)]

    @property
    def range(self) -> tuple[float, float] | None:
        """Smallest and largest value that may be declared to ROS; None for none."""
        rule = self.rule
        if (
            rule is None
            or self.type not in ("double", "integer")
            or (math.isinf(rule.lower) and math.isinf(rule.upper))
        ):
            return None
        if self.type == "integer":
            return rule.lower, rule.upper
        upper = math.inf if rule.off == math.inf else rule.upper
        return min(rule.lower, off_value(rule)), upper

    def check(self, value: object, where: str) -> Value:
        """The value in its own type; an integer may stand for a double.

        Args:
            value: what was given. where: the file and the name, for messages.

        Raises:
            ParameterError: wrong type, or out of range.
        """
        if self.type.endswith("array"):
            return self._checked_list(value, where)
        if self.type == "bool":
            if not isinstance(value, bool):
                raise ParameterError(f"{where}: found {short(value)}, expected true or false")
            return value
        if self.type == "string":
            if not isinstance(value, str):
                raise ParameterError(f"{where}: found {short(value)}, expected text")
            if len(value) > LONGEST_TEXT:
                raise ParameterError(f"{where}: found {len(value)} characters, expected at most {LONGEST_TEXT}")
            if self.choices and value not in self.choices:
                raise ParameterError(f"{where}: found {short(value)}, expected {self.choice_words}")
            return value
        if self.type == "integer" and (isinstance(value, bool) or not isinstance(value, int)):
            raise ParameterError(f"{where}: found {short(value)}, expected a whole number")
        return self._checked_number(value, where)

    def _checked_number(self, value: object, where: str) -> float:
        rule = self.rule or Parameter(self.name, self.unit, self.meaning)
        return type(self.default if not isinstance(self.default, Sequence) else 0.0)(check_with_off(rule, value, where))

    def _checked_list(self, value: object, where: str) -> list[Value]:
        of_text = self.type.startswith("string")
        if isinstance(value, str) or not isinstance(value, Collection):
            kind = "names" if of_text else "numbers"
            raise ParameterError(f"{where}: found {short(value)}, expected a list of {kind}")
        items = list(value)
        if len(items) > LONGEST_LIST:
            raise ParameterError(f"{where}: found {len(items)} entries, expected at most {LONGEST_LIST}")
        if not of_text:
            return [self._checked_number(item, f"{where}[{index}]") for index, item in enumerate(items)]
        if not all(isinstance(item, str) and len(item) <= LONGEST_TEXT for item in items):
            raise ParameterError(f"{where}: found {short(value)}, expected a list of names")
        may_be_empty = "" in self.default
        names = [name for item in items if (name := item.strip()) or may_be_empty]
        if not names:
            raise ParameterError(f"{where}: found {short(value)}, expected at least one name")
        return names


Table = Mapping[str, NodeParameter]
S = TypeVar("S", bound="NodeSettings")


def option(
    default: Value, meaning: str, unit: str = "", lower: float = -math.inf, upper: float = math.inf, *,
    choices: tuple[str, ...] = (), read_only: bool = True,
) -> Any:  # fmt: skip
    """One field of a node's settings: a parameter.

    Args:
        default: gives the type, too; a tuple of numbers or of texts for a list.
        meaning: in words. unit, lower, upper: of a number, or of each in a list.
        choices: all that a text may be; empty for any. read_only: whether it is read once, at the start.
    """
    value = list(default) if isinstance(default, tuple) else default
    one = value[0] if isinstance(value, list) else value
    is_number = isinstance(one, int | float) and not isinstance(one, bool)
    rule = Parameter("", unit, meaning, lower, upper) if is_number else None
    return field(default=default, metadata={"row": NodeParameter("", value, meaning, unit, rule, choices, read_only)})


@dataclass(frozen=True)
class NodeSettings:
    """What the settings of all nodes have in common. Lists are tuples here.

    Attributes:
        program: the node's, for messages. has_valve: whether it declares a valve.
    """

    program: ClassVar[str]
    has_valve: ClassVar[bool] = False

    @classmethod
    def rows(cls) -> dict[str, NodeParameter]:
        """A table of the settings alone."""
        return {entry.name: entry.metadata["row"]._replace(name=entry.name) for entry in fields(cls)}

    @classmethod
    def table(cls) -> dict[str, NodeParameter]:
        """Every parameter of the node, by name."""
        return cls.rows()

    @classmethod
    def passes_over(cls, name: str, given: Mapping[str, object]) -> bool:
        """Whether a name that a section of many nodes gives is of another node, and not misspelt; `given`: all."""
        return name in OF_ANY_NODE or name.startswith(PLANT_KEY if cls.has_valve else (*VALVE_KEYS, PLANT_KEY))

    @classmethod
    def values(cls, given: Mapping[str, object], sources: Mapping[str, str]) -> dict[str, Value]:
        """The values at the start, of the whole table; arguments and errors: see `check_given`."""
        return asdict(cls.read(given, sources))

    @classmethod
    def read(cls: type[S], given: Mapping[str, object], sources: Mapping[str, str]) -> S:
        """The settings at the start; arguments and errors: see `check_given`."""
        return cls.of(check_given(given, cls.table(), sources, cls.program)).completed()

    @classmethod
    def of(cls: type[S], values: Mapping[str, Value]) -> S:
        """The settings among a node's values."""
        found = {entry.name: values[entry.name] for entry in fields(cls)}
        return cls(**{name: tuple(value) if isinstance(value, list) else value for name, value in found.items()})

    def completed(self: S) -> S:
        """These settings, of which each is in its range, with what follows from others.

        Raises:
            ParameterError: they do not fit each other.
        """
        return self


S_co = TypeVar("S_co", covariant=True)


class Declares(Protocol[S_co]):
    """The parameters of a node as they are declared: the class of its settings, or what else has these."""

    def table(self) -> dict[str, NodeParameter]:
        """Every parameter, by name."""

    def passes_over(self, name: str, given: Mapping[str, object]) -> bool:
        """See `NodeSettings`."""

    def values(self, given: Mapping[str, object], sources: Mapping[str, str]) -> dict[str, Value]:
        """The values at the start; arguments and errors: see `check_given`."""

    def of(self, values: Mapping[str, Value]) -> S_co:
        """The node's settings among them."""


def check_given(
    given: Mapping[str, object],
    table: Table,
    sources: Mapping[str, str],
    program: str,
    defaults: Mapping[str, Value] | None = None,
) -> dict[str, Value]:
    """The values at the start: the defaults, replaced by what was given.

    Args:
        given: flat names and values; those of ROS itself are passed over.
        table: the node's.
        sources: name to the file where it was given; the command line where missing.
        program: the node's, for messages.
        defaults: in place of those of the table.

    Raises:
        ParameterError: unknown name, wrong type or out of range; one line.
    """
    values = {name: entry.default for name, entry in table.items()} if defaults is None else dict(defaults)
    for name, value in given.items():
        where = f"{sources.get(name, 'command line')}: {name}"
        if name in table:
            values[name] = table[name].check(value, where)
        elif not is_of_ros(name):
            raise ParameterError(
                f"{where}: found {short(value)} under an unknown name; expected a parameter of {program}, "
                f"did you mean {closest(name, list(table))}?"
            )
    return values


def is_of_ros(name: str) -> bool:
    """Whether this parameter is ROS's own, which every node has."""
    return name in ROS_OWN or name.startswith(ROS_OWN_PREFIX)


def sources_of(sections: Sequence[tuple[str, Section]], node: str) -> dict[str, str]:
    """Flat name to the file that gave it to this node, by its full name; a later file wins, as in ROS."""
    return {name: path for path, section in sections if section.applies_to(node) for name in section.values}


def of_others(
    given: Mapping[str, object], sections: Sequence[tuple[str, Section]], node: str, settings: Declares[object]
) -> list[str]:
    """What a section of many nodes, such as `/**`, gives to this one, and is of another node of this package."""
    applying = [section for _, section in sections if section.applies_to(node)]
    own = {name for section in applying if "*" not in section.node for name in section.values}
    common = {name for section in applying for name in section.values} - own - settings.table().keys()
    return [name for name in given if name in common and settings.passes_over(name, given)]


def files_for_others(sections: Sequence[tuple[str, Section]], node: str) -> dict[str, list[str]]:
    """Files without a section for this node, and the node names that they have."""
    names: dict[str, list[str]] = {}
    for path, section in sections:
        names.setdefault(path, []).append(section.node)
    used = {path for path, section in sections if section.applies_to(node)}
    return {path: found for path, found in names.items() if path not in used}


def changed_words(before: Mapping[str, Value], after: Mapping[str, Value]) -> str:
    """The parameters that have another value, each with the old one and the new; empty where none has."""
    return ", ".join(f"{name} {before[name]} → {value}" for name, value in after.items() if value != before[name])


def as_declared(name: str, value: object, table: Table) -> object:
    """A number, or numbers in a list, where the table has doubles, as doubles; all else is returned as is.

    `ros2 param load` hands on 1e-06, inf, and lists that hold such, as texts.
    """
    kind = table[name].type if name in table else ""
    if kind == "double" and type(value) in (int, str):
        return _double(value)
    if kind != "double array":
        return value
    if isinstance(value, str):
        value = value.strip("[]").split(",")
    if not isinstance(value, Collection):
        return value
    items = [_double(item) for item in value]
    return items if all(type(item) is float for item in items) else value


def _double(value: object) -> object:
    if type(value) not in (int, float, str):
        return value
    try:
        return float(value)  # type: ignore[arg-type]
    except (ValueError, OverflowError):
        return value
