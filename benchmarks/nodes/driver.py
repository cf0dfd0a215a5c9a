"""The driver of the benchmarks of nodes: starts processes of nodes, and of neighbours that keep the machine busy."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any

import rclpy
from nodes.ros_process import end

Processes = dict[str, subprocess.Popen[bytes]]


def program(name: str, *parameters: str, namespace: str = "") -> list[str]:
    """The command that runs a node with these parameters, name:=value."""
    words = [word for parameter in parameters for word in ("-p", parameter)]
    words += ["-r", f"__ns:=/{namespace}"] if namespace else []
    return [sys.executable, "-m", "valve_sim.nodes", name, "--ros-args", *words]


@contextlib.contextmanager
def running(commands: Mapping[str, Sequence[str]], **environment: str) -> Iterator[Processes]:
    """Processes by name, while inside."""
    processes = {
        name: subprocess.Popen(command, env={**os.environ, **environment}) for name, command in commands.items()
    }
    try:
        yield processes
    finally:
        for process in processes.values():
            process.terminate()
        for process in processes.values():
            end(process)


def busy(count: int) -> AbstractContextManager[Processes]:
    """So many processes that do nothing but compute, while inside."""
    return running({f"neighbour {number}": [sys.executable, "-S", "-c", "while True: pass"] for number in range(count)})


@contextlib.contextmanager
def ros() -> Iterator[None]:
    """ROS 2 of this machine alone, while inside."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    rclpy.init()
    try:
        yield
    finally:
        rclpy.try_shutdown()


def values_of(status: Any) -> dict[str, str]:
    """Keys and values of a status of diagnostics."""
    return {item.key: item.value for item in status.values}
