"""The reference page: topics, parameters and effects, from the tables that the code itself uses.

`python -m valve_sim.reference` prints it; `python -m valve_sim.reference docs/reference.md` writes it.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator, Sequence
from importlib import resources
from pathlib import Path
from typing import Final, NamedTuple

from valve_sim.model import CATALOGUE
from valve_sim.model.parameters import Parameter
from valve_sim.nodes import monitor_parameters
from valve_sim.nodes.identification_parameters import DESCRIPTIONS, Settings
from valve_sim.nodes.parameters import NodeParameter, table
from valve_sim.parameter_files import default_valve
from valve_sim.traces.reading import CHANNELS, MEASURED

_NODES: Final = {
    "valve_node": "valve_shell.py",
    "identification_node": "identification_shell.py",
    "monitor_node": "monitor_shell.py",
}
_CALLS: Final = {"create_publisher": "out", "create_subscription": "in", "create_service": "service"}


class Interface(NamedTuple):
    """A topic or service of a node: its name, the message's name, and "in", "out" or "service"."""

    name: str
    message: str
    direction: str


def interfaces(source: str) -> list[Interface]:
    """The topics and services that a node's source makes, in the order in which it makes them.

    Read from the source, so that neither ROS nor a running node is needed.
    """
    return sorted(_interfaces(ast.parse(source)), key=lambda entry: list(_CALLS.values()).index(entry.direction))


def _interfaces(tree: ast.AST) -> Iterator[Interface]:
    for node in ast.walk(tree):
        match node:
            case ast.Call(func=ast.Attribute(attr=call), args=[ast.Name(id=message), name, *_]) if call in _CALLS:
                yield Interface(_written(name), message, _CALLS[call])


def _written(name: ast.expr) -> str:
    """A name as it is written in the source; `<valve>` where a value is put in."""
    match name:
        case ast.Constant(value=str(words)):
            return words
        case ast.JoinedStr(values=parts):
            return "".join(_written(part) for part in parts)
        case ast.FormattedValue(value=value):
            return _written(value)
        case ast.Attribute(attr=attribute):
            return f"<{attribute.lstrip('_')}>"
        case _:
            raise ValueError(f"a topic is made as {ast.unparse(name)}, which cannot be read from the source")


def page() -> str:
    """The reference, as Markdown."""
    parts = [
        "# Reference",
        "Made by `python -m valve_sim.reference docs/reference.md` from the code's own tables; a test keeps it so.",
        *_topics(),
        *_bag_topics(),
        *_node_parameters(),
        *_effects(),
    ]
    return "\n\n".join(parts) + "\n"


def _topics() -> Iterator[str]:
    yield "## Topics and services"
    folder = resources.files("valve_sim.nodes")
    for node, file in _NODES.items():
        yield f"### {node}"
        found = interfaces((folder / file).read_text(encoding="utf-8"))
        yield _table(("name", "type", "direction"), [(f"`{e.name}`", e.message, e.direction) for e in found])
    yield "`<valve>` and `<measured>` are parameters of monitor_node; `<sensors>` is where `<measured>` is."


def _bag_topics() -> Iterator[str]:
    yield "## What is read from a bag"
    yield "Below the valve's name, such as `/valve` or `/tank_1/valve`."
    rows = [
        ("`coil_voltage`", "std_msgs/msg/Float64", "`data`, V"),
        (f"`{MEASURED}`", "sensor_msgs/msg/JointState", "`position`, m"),
    ]
    rows += [(f"`{entry.topic}`", entry.message_type, f"`{entry.path}`") for entry in CHANNELS.values()]
    yield _table(("topic", "type", "what is read"), rows)


def _node_parameters() -> Iterator[str]:
    yield "## Parameters of valve_node"
    yield "SI units. Those that begin with `valve.` are a parameter file's keys too; those of effects follow below."
    entries = [entry for entry in table(default_valve()).values() if not entry.name.startswith("effects.")]
    rows = [(f"`{e.name}`", _default(e.default), _range(e), e.description) for e in entries]
    yield _table(("name", "default", "range", "meaning"), rows)
    yield "## Parameters of identification_node"
    defaults = Settings()._asdict()
    yield _table(
        ("name", "default", "meaning"),
        [(f"`{name}`", _default(defaults[name]), DESCRIPTIONS[name]) for name in defaults],
    )
    yield "## Parameters of monitor_node"
    yield "Beside these: `valve.` and `effects.` as for valve_node, for the valve that it declares."
    own, words = monitor_parameters.Settings()._asdict(), monitor_parameters.descriptions()
    yield _table(("name", "default", "meaning"), [(f"`{name}`", _default(own[name]), words[name]) for name in own])


def _effects() -> Iterator[str]:
    yield "## Effects"
    yield "Each is off unless a parameter file has it under `effects:`. How to add one is in [effects.md](effects.md)."
    for effect in CATALOGUE.values():
        yield f"### {effect.name}"
        words = effect.summary[0].upper() + effect.summary[1:] + f". Source: {effect.source}."
        if effect.confused_with:
            words += f" Often confused with: {', '.join(effect.confused_with)}."
        if not effect.named:
            words += " Never claimed as a name."
        yield words
        rows = [
            (f"`{p.name}`", p.unit, p.description, f"{p.lower:g} … {p.upper:g}", _off(p)) for p in effect.parameters
        ]
        yield _table(("parameter", "unit", "meaning", "range", "off"), rows)


def _off(parameter: Parameter) -> str:
    return "–" if parameter.off is None else f"{parameter.off:g}"


def _range(entry: NodeParameter) -> str:
    return "–" if entry.range is None else f"{entry.range[0]:g} … {entry.range[1]:g}"


def _default(value: object) -> str:
    if isinstance(value, str):
        return f"`{value}`" if value else "empty"
    if isinstance(value, Sequence):
        return ", ".join(_default(item) for item in value)
    return f"{value:g}" if isinstance(value, float) else f"`{value}`"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def main(arguments: Sequence[str]) -> None:
    """Print the page, or write it to the file that is given."""
    if arguments:
        Path(arguments[0]).write_text(page(), encoding="utf-8")
    else:
        sys.stdout.write(page())


if __name__ == "__main__":
    main(sys.argv[1:])
