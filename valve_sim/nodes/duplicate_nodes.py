"""Two nodes of one name: ROS allows it, and both obey commands and publish on the same topics."""

from __future__ import annotations

from rclpy.node import Node


class DuplicateNodes:
    """Looks for other nodes with the name of a node; logs each change of their number.

    Args:
        node: whose name it is.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._others = 0

    def look(self) -> int:
        """How many others there are now."""
        name = self._node.get_fully_qualified_name()
        found = [f"{space.rstrip('/')}/{short}" for short, space in self._node.get_node_names_and_namespaces()]
        others = max(0, found.count(name) - 1)
        if others > self._others:
            self._node.get_logger().warning(
                f"{others + 1} nodes are called {name}: all of them publish and obey on the same topics; end "
                "the others, or start each under its own name or namespace (--ros-args -r __node:=... or -r __ns:=...)"
            )
        self._others = others
        return others
