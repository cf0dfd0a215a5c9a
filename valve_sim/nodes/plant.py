"""The node `valve` with a machine of a plant file. No physics, no decisions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from rclpy.node import Node

from valve_sim.files.parameter_sections import Section
from valve_sim.nodes.live_plant import LivePlant, NodePlant, PlantParameters
from valve_sim.nodes.machine import MachineNode
from valve_sim.nodes.messages import JOINT_NAMES
from valve_sim.nodes.parameters import PLANT_KEY, Value

_JOINTS: Final = dict(zip(("position", "main_position"), JOINT_NAMES, strict=True))


class PlantNode(MachineNode[Mapping[str, float], LivePlant]):
    """The node `valve`, with the topics and services `topics.VALVE` that show a machine of a plant file.

    Parameters: `live_plant.PlantParameters`; all but `plant` can be set at run time.

    Raises:
        ParameterError: a parameter is unknown, of the wrong type or out of range. PlantFileError: the file is no use.
    """

    rests = "the machine begins anew, at 0 V"
    keys = (PLANT_KEY,)

    def __init__(self, node: Node, sections: Sequence[tuple[str, Section]], path: str) -> None:
        self._plant = NodePlant(path)
        self._of_plant = PlantParameters(self._plant)
        shown = self._plant.channels.delays
        super().__init__(
            node, sections, self._of_plant, [joint for name, joint in _JOINTS.items() if name in shown],
            shows_current="current" in shown, shows_phase=bool(self._plant.modes),
        )  # fmt: skip

    def _made(self, machine: Mapping[str, float], **options: float) -> LivePlant:
        return LivePlant(self._plant, machine, **options)

    def _machine_of(self, values: Mapping[str, Value]) -> dict[str, float]:
        return self._of_plant.numbers(values)

    def _go_on_as(self, now: int, machine: Mapping[str, float]) -> None:
        self._live.set_numbers(now, machine)

    def _prepare(self) -> None:
        """It was compiled when its file was read."""

    def _self_test(self) -> tuple[bool, str]:
        return False, f"a self-test is of the valve; the machine of {self._plant.file.path} has none"
