"""The driver of the benchmarks of nodes: starts processes, counts what they use, and listens in a thread."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

ENDS_WITHIN = 30.0
"""s after SIGINT; a calculation that is under way on a busy machine may take minutes, and is killed."""


def program(
    name: str, *parameters: str, namespace: str = "", package: str = "nodes", file: Path | None = None
) -> list[str]:
    """The command that runs a node with these parameters, name:=value."""
    words = [word for parameter in parameters for word in ("-p", parameter)]
    words += ["-r", f"__ns:=/{namespace}"] if namespace else []
    words += ["--params-file", str(file)] if file is not None else []
    return [sys.executable, "-m", f"valve_sim.{package}", name, "--ros-args", *words]


@contextlib.contextmanager
def running(commands: Mapping[str, Sequence[str]], **environment: str) -> Iterator[dict[str, subprocess.Popen[bytes]]]:
    """Processes by name, while inside; ended by SIGINT."""
    processes = {
        name: subprocess.Popen(command, env={**os.environ, **environment}) for name, command in commands.items()
    }
    try:
        yield processes
    finally:
        for process in processes.values():
            process.send_signal(signal.SIGINT)
        for process in processes.values():
            try:
                process.wait(ENDS_WITHIN)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


@contextlib.contextmanager
def busy(count: int) -> Iterator[None]:
    """So many processes that do nothing but compute, while inside."""
    spin = [sys.executable, "-S", "-c", "while True: pass"]
    processes = [subprocess.Popen(spin) for _ in range(count)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


@contextlib.contextmanager
def ros() -> Iterator[None]:
    """ROS 2 of this machine alone, while inside."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    rclpy.init()
    try:
        yield
    finally:
        rclpy.try_shutdown()


@contextlib.contextmanager
def spinning(node: Node) -> Iterator[None]:
    """A node that hears in a thread of its own, while inside; it is destroyed in the end."""
    executor = SingleThreadedExecutor()
    executor.add_node(node)

    def spin() -> None:
        with contextlib.suppress(ExternalShutdownException):
            executor.spin()

    thread = threading.Thread(target=spin, daemon=True)
    thread.start()
    try:
        yield
    finally:
        executor.shutdown()
        thread.join(2.0)
        node.destroy_node()


def processor_seconds(process_id: int) -> float:
    """User and system time of a process so far, s."""
    fields = Path(f"/proc/{process_id}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def values_of(status: Any) -> dict[str, str]:
    """Keys and values of a status of diagnostics."""
    return {item.key: item.value for item in status.values}
