"""Libraries of extras, and the nodes that need them: a missing one is one line that says what to install."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from valve_sim.model.errors import ValveError

if TYPE_CHECKING:
    from valve_sim.nodes.starting import GivenFiles, RunsAsNode


def require(module: str, extra: str, purpose: str) -> None:
    """Import a library of an extra.

    Args:
        module: its name. extra: of this package, that brings it. purpose: what it is needed for.

    Raises:
        ValveError: it is not installed, or cannot be imported.
    """
    try:
        importlib.import_module(module)
    except ImportError as error:
        raise ValveError(
            f"{purpose} needs {module}, which cannot be imported ({error}); pip install '.[{extra}]' in a checkout"
        ) from error


def opcua_node(given: GivenFiles) -> RunsAsNode:
    """The node that serves OPC UA.

    Raises:
        ValveError: its library is missing, or the node cannot start.
    """
    require("asyncua", "opcua", "the OPC UA server")
    from valve_sim.station.opcua_node import OpcUaNode

    return OpcUaNode(given)


def plc_node(given: GivenFiles) -> RunsAsNode:
    """The node between a PLC and its valves; errors as `opcua_node`."""
    require("pymodbus.simulator", "modbus", "Modbus TCP")
    from valve_sim.station.plc_node import PlcNode

    return PlcNode(given)


def archive_node(given: GivenFiles) -> RunsAsNode:
    """The node that keeps an archive; errors as `opcua_node`."""
    require("pyarrow", "parquet", "the archive")
    from valve_sim.station.archive_node import ArchiveNode

    return ArchiveNode(given)
