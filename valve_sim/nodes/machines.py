"""Which machine the node `valve` simulates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from valve_sim.files.parameter_sections import Section
from valve_sim.nodes.machine import MachineNode
from valve_sim.nodes.parameters import sources_of
from valve_sim.nodes.valve_parameters import ValveSettings
from valve_sim.nodes.wiring import make_node


def valve_node(sections: Sequence[tuple[str, Section]]) -> MachineNode[Any, Any]:
    """The node with the valve, or, where the parameter `plant` is given, with the machine of that file.

    Raises:
        ParameterError, PlantFileError: it cannot be made.
    """
    node = make_node("valve")
    if node.has_parameter("plant"):
        place = sources_of(sections, node.get_fully_qualified_name()).get("plant", "command line")
        path = ValveSettings.rows()["plant"].check(node.get_parameter("plant").value, f"{place}: plant")
        if path:
            from valve_sim.nodes.plant import PlantNode

            return PlantNode(node, sections, path)
    from valve_sim.nodes.valve import ValveNode

    return ValveNode(node, sections)
