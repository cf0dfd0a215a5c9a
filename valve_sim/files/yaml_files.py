"""Reading YAML: numbers as people write them, duplicate keys refused, every error one line with its place."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Final

import yaml

from valve_sim.files.bounded import check_file
from valve_sim.model.errors import ValveError

LARGEST_YAML: Final = 1_000_000
MOST_NODES: Final = 20_000
"""Bytes of a file, and values in it, those counted each time that an alias repeats."""


class _Loader(yaml.SafeLoader):
    """YAML 1.1 with three changes: 1e-3 is a number, a duplicate key is an error, and a tuple of Python's is a list."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        self._nodes = getattr(self, "_nodes", 0) + 1
        if self._nodes > MOST_NODES:
            raise yaml.YAMLError(f"more than {MOST_NODES} values")
        return super().compose_node(parent, index)

    def get_single_node(self) -> yaml.Node | None:
        node = super().get_single_node()
        if node is not None and _size(node, {}) > MOST_NODES:
            raise yaml.YAMLError(f"more than {MOST_NODES} values, by aliases")
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if key.value in seen and key.tag != "tag:yaml.org,2002:merge":
                raise yaml.constructor.ConstructorError(
                    None, None, f"found {key.value!r} a second time", key.start_mark
                )
            if isinstance(key.value, str):
                seen.add(key.value)
        return super().construct_mapping(node, deep)


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
)


def _size(node: yaml.Node, known: dict[int, float]) -> float:
    """How many values a node has below it; infinite where it is below itself."""
    if id(node) not in known:
        known[id(node)] = float("inf")
        parts = node.value if isinstance(node, yaml.CollectionNode) else []
        below = [own for part in parts for own in (part if isinstance(part, tuple) else (part,))]
        known[id(node)] = 1 + sum(_size(own, known) for own in below)
    return known[id(node)]


def _list(loader: _Loader, node: yaml.SequenceNode) -> list[Any]:
    """What `ros2 launch` makes of a list in a launch file; ROS 2 itself looks at no tags."""
    return list(loader.construct_sequence(node, deep=True))


_Loader.add_constructor("tag:yaml.org,2002:python/tuple", _list)


def read_yaml(path: Path | str, expected: str, refusal: type[ValveError]) -> object:
    """The content of a YAML file.

    Args:
        path: the file.
        expected: ends the message where the file cannot be read: "expected a ROS 2 parameter file".
        refusal: the error that is raised.

    Raises:
        ValveError: it cannot be read, or is not YAML; of the type `refusal`; one line that names file and line.
    """
    try:
        check_file(Path(path), LARGEST_YAML, refusal)
        return yaml.load(Path(path).read_text(encoding="utf-8"), Loader=_Loader)  # noqa: S506 -- it is a SafeLoader
    except OSError as error:
        raise refusal(f"{path}: cannot be read ({error.strerror}); {expected}") from error
    except UnicodeDecodeError as error:
        raise refusal(f"{path}: is not UTF-8 text; {expected}") from error
    except yaml.MarkedYAMLError as error:
        line = "" if error.problem_mark is None else f"line {error.problem_mark.line + 1}: "
        raise refusal(f"{path}: {line}{error.problem or error.context}, expected valid YAML") from error
    except ValveError:
        raise
    except (yaml.YAMLError, RecursionError, ValueError, TypeError, AttributeError, KeyError, IndexError) as error:
        raise refusal(f"{path}: {' '.join(str(error).split())}, expected valid YAML") from error
