"""Equations of a machine from a file, as expressions, and the machine of the engine that they describe."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from valve_sim.model.core.hybrid.description import TIME, Description, Region, Transition
from valve_sim.model.core.own.grammar import Expr, evaluate
from valve_sim.model.core.tracer import Node


@dataclass(frozen=True)
class Equations:
    """What a machine's equations are, with the effects that are on.

    Attributes:
        derivatives: of the states, by name. outputs: by name.
        inputs: names of what drives it. parameters: names of its numbers.
        held: numbers that only transitions change, and their starts. regions: of modes, by name.
    """

    derivatives: Mapping[str, Expr]
    outputs: Mapping[str, Expr]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    held: Mapping[str, float] = field(default_factory=dict)
    regions: Mapping[str, Region[Expr]] = field(default_factory=dict)
    transitions: tuple[Transition[Expr], ...] = ()

    def mapped(self, change: Callable[[Expr], Expr]) -> Equations:
        """These equations with other expressions."""
        return replace(
            self,
            derivatives=_mapped(self.derivatives, change),
            outputs=_mapped(self.outputs, change),
            regions={name: {mode: _mapped(flow, change) for mode, flow in own.items()}
                     for name, own in self.regions.items()},
            transitions=tuple(own.mapped(change) for own in self.transitions),
        )  # fmt: skip

    def described(self) -> Description:
        """The machine of the engine."""
        found = Description(tuple(self.derivatives), self.inputs, self.parameters, self.held)
        values = found.symbols
        values |= {"t": values[TIME]} | {name: found.mode(name) for name in self.regions}

        def node(expression: Expr) -> Node:
            return found.trace.lift(evaluate(expression, values))

        found.flows = {name: node(own) for name, own in self.derivatives.items()}
        found.outputs = {name: node(own) for name, own in self.outputs.items()}
        for name, region in self.regions.items():
            found.regions[name] = {
                mode: {state: node(rate) for state, rate in flow.items()} for mode, flow in region.items()
            }
        found.transitions = [own.mapped(node) for own in self.transitions]
        return found


def _mapped(expressions: Mapping[str, Expr], change: Callable[[Expr], Expr]) -> dict[str, Expr]:
    return {name: change(own) for name, own in expressions.items()}
