"""What a unit does in both versions of FMI; the scripts in `inside` add what differs between their libraries."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from valve_sim.files.parameter_files import load_valve
from valve_sim.fmu.cosimulation import CoSimulatedValve
from valve_sim.fmu.description import complete
from valve_sim.fmu.identity import DESCRIPTION, NEEDED, PARAMETER_FILE, token
from valve_sim.model import ValveError


class ValveUnit:
    """A valve that a master steps: to be put before a library's class of units among the bases of a script's class."""

    resources: str
    vars: Mapping[int, Any]
    register_variable: Callable[..., None]

    def open_valve(
        self, kinds: Mapping[str, Any], causality: Any, variability: Any, initial: Mapping[str, Any]
    ) -> None:
        """Load the valve of the unit's resources, and register its variables.

        Args:
            kinds: the library's classes of variables, by "real", "integer" and "boolean".
            causality, variability: its enumerations. initial: its words for how a value begins, by causality.
        """
        file = Path(self.resources) / PARAMETER_FILE
        self.guid, self.description, self.start_time = token(file), f"{DESCRIPTION} {NEEDED}", 0.0
        self.steps = CoSimulatedValve(load_valve(file))
        for entry in self.steps.variables:
            is_parameter = entry.causality == "parameter"
            varies = "tunable" if is_parameter else "continuous" if entry.kind == "real" else "discrete"
            variable = kinds[entry.kind](
                entry.name,
                causality=causality[entry.causality],
                variability=variability[varies],
                initial=initial.get(entry.causality),
                description=entry.description,
                getter=partial(self.steps.get, entry.name),
                setter=partial(self.steps.set, entry.name),
            )
            self.register_variable(variable, nested=False)

    def to_xml(self, model_options: Any = ()) -> Element:
        """The model description."""
        references = {found.name: found.value_reference for found in self.vars.values()}
        made = super().to_xml(dict(model_options))  # type: ignore[misc]  # of the library's class, which comes next
        return complete(made, self.steps.variables, references)

    def exit_initialization_mode(self) -> None:
        """Begin with the inputs and parameters as they are set; where they do not go together, the first step fails."""
        with suppress(ValveError):
            self.steps.start(self.start_time)

    def refusal(self, current_time: float, step_size: float) -> str:
        """Step on; why that is not possible, or nothing: an exception would end the master, too."""
        try:
            self.steps.step(current_time, step_size)
        except ValveError as error:
            return str(error)
        return ""
