"""The form of ROS 2 parameter files: every node's parameters by flat dotted names; what they mean is not looked at.

What only shows a recording reads the declared parameters from here: what they mean needs the catalogue of effects,
and loading that takes half a second.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import yaml

from valve_sim.files.entries import short
from valve_sim.files.resources import config_path
from valve_sim.files.whole_files import write_whole
from valve_sim.files.yaml_files import read_yaml
from valve_sim.model.errors import ParameterError
from valve_sim.model.parameters import ValveParameters, check_declared

DEFAULT_FILE: Final = "valve.yaml"
"""The shipped parameter file, whose values are the defaults of others."""
LARGEST_INTEGER: Final = 2**63 - 1
"""ROS 2 parameters hold 64 bit."""
ROOT_KEYS: Final = ("valve", "effects", "tolerances", "gas")
"""Groups of names that are about a valve."""
FORM: Final = "expected a ROS 2 parameter file: '/**:', below it 'ros__parameters:', below it 'valve:' and 'effects:'"


class Section(NamedTuple):
    """The parameters that a file holds for one node.

    Attributes:
        node: the node's full name, or a pattern, with a leading slash.
        values: flat dotted name to value, as found.
    """

    node: str
    values: dict[str, object]

    def applies_to(self, node: str) -> bool:
        """Whether ROS 2 gives these parameters to the node of this full name."""
        pattern = re.escape(self.node).replace(r"/\*\*", "(/[^/]+)*").replace(r"\*", "[^/]+")
        return re.fullmatch(pattern, node) is not None

    @property
    def is_about_valve(self) -> bool:
        """Whether a valve, its effects or its tolerances are among the parameters."""
        return any(
            name.partition(".")[0] in ROOT_KEYS and not is_a_name(name, self.values[name]) for name in self.values
        )


def is_a_name(name: str, value: object) -> bool:
    """Whether this is a parameter `valve` that holds a name, as command_profile has one, and no group of numbers."""
    return name == "valve" and isinstance(value, str)


def read_sections(path: Path | str) -> tuple[Section, ...]:
    """Every node's parameters in a file, in the file's order; of any ROS 2 parameter file: names are not checked.

    Raises:
        ParameterError: the file cannot be read, is not YAML, or does not have the form of a parameter file.
    """
    document = read_yaml(path, "expected a ROS 2 parameter file", ParameterError)
    try:
        sections = tuple(_find_sections(document, "", str(path)))
    except RecursionError as error:
        raise ParameterError(f"{path}: {' '.join(str(error).split())}, expected valid YAML") from error
    if not sections:
        raise ParameterError(f"{path}: holds no ros__parameters; {FORM}")
    return sections


def default_values() -> dict[str, object]:
    """All values of config/valve.yaml by their flat names, as found.

    Raises:
        ValveError: the installation lacks the file.
    """
    path = config_path(DEFAULT_FILE)
    return {name: value for section in read_sections(path) for name, value in section.values.items()}


def default_parameters() -> ValveParameters:
    """The declared parameters of config/valve.yaml alone, without its effects, tolerances and gas.

    Raises:
        ValveError: the installation lacks the file.
    """
    declared = {key.removeprefix("valve."): value for key, value in default_values().items() if key[:6] == "valve."}
    return check_declared(declared, str(config_path(DEFAULT_FILE)))


def write_sections(path: Path, sections: Sequence[Section]) -> None:
    """Write parameters in the simplest form, whole or not at all: flat names, and lists of one type.

    ROS 2's own parser refuses a file where one list holds 0 and 0.5, or where a mapping is empty.

    Raises:
        ParameterError: the file cannot be written.
    """
    document: dict[str, Any] = {}
    for section in sections:
        document.setdefault(section.node, {"ros__parameters": {}})["ros__parameters"].update(
            {name: _one_type(value) for name, value in section.values.items()}
        )
    filled = {node: content for node, content in document.items() if content["ros__parameters"]}
    text = yaml.dump(filled, Dumper=Dumper, sort_keys=False, allow_unicode=True) if filled else "{}\n"
    write_whole(path, text, ParameterError)


class Dumper(yaml.SafeDumper):
    """Mappings in block style, lists of numbers on one line."""


Dumper.add_representer(
    list, lambda dumper, items: dumper.represent_sequence("tag:yaml.org,2002:seq", items, flow_style=True)
)


def _find_sections(found: object, prefix: str, path: str) -> Iterator[Section]:
    if not isinstance(found, Mapping):
        raise ParameterError(f"{path}: {prefix or 'the file'}: found {short(found)}; {FORM}")
    for key, value in found.items():
        if not isinstance(key, str):
            raise ParameterError(f"{path}: {prefix}: found the key {key!r}, expected a name")
        if key == "ros__parameters":
            yield Section(prefix or "/**", dict(_flat(value, "", path)))
        else:
            yield from _find_sections(value, f"{prefix}/{key.strip('/')}", path)


def _flat(found: object, prefix: str, path: str) -> Iterator[tuple[str, object]]:
    """Dotted names and values. An empty mapping has none, unless it is in the place of an effect's parameters."""
    if found is None and prefix in ("", *ROOT_KEYS, "tolerances.effects", "tolerances.gas", "tolerances.sensor"):
        return
    if not isinstance(found, Mapping):
        if not prefix:
            raise ParameterError(f"{path}: ros__parameters: found {short(found)}, expected names and values")
        if found is None:
            raise ParameterError(f"{path}: {prefix}: has no value; give one, or take the line out")
        for item in found if isinstance(found, list) else [found]:
            if isinstance(item, int) and abs(item) > LARGEST_INTEGER:
                raise ParameterError(f"{path}: {prefix}: found {short(item)}, more than an integer of ROS 2 can hold")
        yield prefix, found
        return
    if not found and prefix.startswith("effects."):
        yield prefix, {}
    for key, value in found.items():
        if not isinstance(key, str):
            raise ParameterError(f"{path}: {prefix}: found the key {key!r}, expected a name")
        yield from _flat(value, f"{prefix}.{key}" if prefix else key, path)


def _one_type(value: object) -> object:
    is_mixed = isinstance(value, list) and any(isinstance(item, float) for item in value)
    if is_mixed and all(type(item) in (int, float) for item in value):  # type: ignore[attr-defined]
        return [float(item) for item in value]  # type: ignore[attr-defined]
    return value
