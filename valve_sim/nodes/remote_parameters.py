"""Parameters of a running valve node, read and set over ROS; a request is repeated where its reply is lost."""

from __future__ import annotations

import contextlib
import math
import queue
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient

from valve_sim.files.parameter_files import read_tolerances
from valve_sim.identification.estimation.intervals import Interval
from valve_sim.model import CATALOGUE, DECLARED, ParameterError
from valve_sim.model.gas import GAS
from valve_sim.nodes.valve_parameters import TOLERANCES

FIND_SECONDS: Final = 10.0
"""Time in which a node must be found: announcements that DDS loses are repeated every 3 s."""
ANSWER_SECONDS: Final = 10.0
"""Time in which it must answer, all requests together."""
_REQUESTS: Final = 4
"""Requests to a node that does not answer: a reply that is sent before DDS has matched its reader is lost."""
_DIGITS: Final = 5
_EXACT: Final = 0.0
"""Of a tolerance that is not given."""

Values = dict[str, Any]
"""Flat parameter name to value."""


class Change(NamedTuple):
    """One parameter that is set to another value.

    Attributes:
        name: flat, as the valve node has it. old, new: in `unit`.
        interval: 95 %, of the new value; None where it was not fitted.
    """

    name: str
    old: Any
    new: Any
    interval: tuple[float, float] | None
    unit: str

    def text(self) -> str:
        """One line for the log."""
        if self.interval is None:
            return f"{self.name}: {_short(self.old)} → {_short(self.new)} {self.unit}".rstrip()
        low, high = self.interval
        digits = _digits(self.new, high - low)
        return (
            f"{self.name}: {_short(self.old)} → {_short(self.new, digits)} {self.unit}, 95 % interval "
            f"{_short(low, digits)} to {_short(high, digits)}"
        )


class RemoteParameters:
    """Parameters of a running valve node. The methods block, so they must not be called by the spinning thread.

    Args:
        node: makes the requests; another thread spins it.
        name: full name of the valve node.
    """

    def __init__(self, node: Node, name: str) -> None:
        self.name = name
        self._client = AsyncParameterClient(node, name)

    def values(self, names: Sequence[str]) -> Values:
        """The present values of these parameters.

        Raises:
            ParameterError: no such node, no answer, or it lacks one of them.
        """
        answer = self._ask(lambda callback: self._client.get_parameters(list(names), callback))
        found = dict(zip(names, map(parameter_value_to_python, answer.values), strict=False))
        missing = [name for name in names if found.get(name) is None]
        if missing:
            raise ParameterError(f"{self.name} has no parameter {missing[0]}; expected a valve_node of this release")
        return {name: value if isinstance(value, float | str) else list(value) for name, value in found.items()}

    def set(self, values: Mapping[str, Any]) -> None:
        """Set all of these, or none.

        Raises:
            ParameterError: no such node, no answer, or it refuses them; the message has its reason.
        """
        parameters = [Parameter(name, value=value) for name, value in values.items()]
        # Setting the same values again changes nothing, so the first reply counts.
        answer = self._ask(lambda callback: self._client.set_parameters_atomically(parameters, callback))
        if not answer.result.successful:
            raise ParameterError(f"{self.name} refuses them: {answer.result.reason}")

    def _ask(self, question: Callable[[Callable[[Any], None]], object]) -> Any:
        if not self._client.wait_for_services(timeout_sec=FIND_SECONDS):
            raise ParameterError(f"{self.name}: no such node was found within {FIND_SECONDS:g} s")
        answers: queue.SimpleQueue[Any] = queue.SimpleQueue()
        for _ in range(_REQUESTS):
            question(answers.put)
            with contextlib.suppress(queue.Empty):
                return answers.get(timeout=ANSWER_SECONDS / _REQUESTS).result()
        raise ParameterError(f"{self.name}: did not answer within {ANSWER_SECONDS:g} s")


def changes_between(old: Mapping[str, Any], new: Mapping[str, Any], intervals: Mapping[str, Interval]) -> list[Change]:
    """The changes from `old` to `new`, tolerances one by one.

    Args:
        old, new: flat names and values. intervals: by the names of a fit, such as pilot_damping or stiction.force.
    """
    before, after = _with_each_tolerance(old), _with_each_tolerance(new)
    pairs = {name: (before.get(name, _EXACT), after.get(name, _EXACT)) for name in {**after, **before}}
    return [
        Change(name, was, becomes, _interval_of(name, intervals), _unit(name))
        for name, (was, becomes) in pairs.items()
        if was != becomes
    ]


def _with_each_tolerance(values: Mapping[str, Any]) -> Values:
    """Values with a name for each tolerance, as in a parameter file, in place of one text of all."""
    found = {name: value for name, value in values.items() if name != TOLERANCES}
    return {**found, **dict(_flat(read_tolerances(values.get(TOLERANCES, ""), ""), TOLERANCES))}


def _flat(found: Any, prefix: str) -> Iterator[tuple[str, Any]]:
    if not isinstance(found, Mapping):
        yield prefix, found
        return
    for name, value in found.items():
        yield from _flat(value, f"{prefix}.{name}")


def _interval_of(name: str, intervals: Mapping[str, Interval]) -> tuple[float, float] | None:
    root, _, rest = name.partition(".")
    found = None if root == "tolerances" else intervals.get(name if root == "gas" else rest)
    return None if found is None else (found.low, found.high)


def _unit(name: str) -> str:
    root, _, rest = name.partition(".")
    if root == "tolerances":
        return _unit(rest if rest.startswith(("effects.", "gas.")) else f"valve.{rest}")
    if root == "gas":
        return GAS[rest].unit if rest in GAS else ""
    if root == "valve":
        return DECLARED[rest].unit if rest in DECLARED else ""
    effect, _, parameter = rest.partition(".")
    return next((rule.unit for rule in CATALOGUE[effect].parameters if rule.name == parameter), "")


def _digits(value: float, width: float) -> int:
    """Significant digits of a value such that the width of its interval shows two."""
    if not 0.0 < width < math.inf or value == 0.0:
        return _DIGITS
    return max(_DIGITS, math.ceil(math.log10(abs(value) / width)) + 2)


def _short(value: object, digits: int = _DIGITS) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_short, value))}]"
    if isinstance(value, float) and math.isinf(value):
        return "infinity" if value > 0.0 else "-infinity"
    return f"{value:.{digits}g}" if isinstance(value, float) else str(value)
