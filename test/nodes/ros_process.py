"""A real node in a process of its own, and a node here that talks to it."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

PATIENCE = 120.0
"""Seconds after which something that should happen counts as not happening; of a machine of one's own: see `until`."""
SLOWEST = 10.0
"""A machine that is slower than so many times is waited for no longer."""
ENDS_WITHIN = 600.0
"""Seconds after which a process that should end counts as hanging."""
ASK_AGAIN = 5.0
"""Seconds after which a question, or a message that has no effect, counts as lost."""
NODES = ("valve_node", "monitor_node", "identification_node", "command_profile")
"""Programs of `valve_sim.nodes`; the others are of `valve_sim.station`."""
_MIDDLEWARE = re.compile(r"^\d{4}-\d\d-\d\d [\d:.]+ \[\w+ (Error|Warning)\] ")
_COLOUR = re.compile(r"\x1b\[[\d;]*m")


def slowness() -> float:
    """How many times as long as alone on a core a calculation takes here now; at least 1.

    What has to be done within a time by the wall, has that time as often where others use the cores.
    """
    begin, used = time.monotonic(), time.thread_time()
    while time.thread_time() - used < 0.05:
        pass
    return max(1.0, (time.monotonic() - begin) / (time.thread_time() - used))


def free_port() -> int:
    """A port of this machine that nothing listens on."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


def own_lines(output: str) -> list[str]:
    """What a program has said, without what the DDS library says beside it when it is in difficulties."""
    lines = [_COLOUR.sub("", line) for line in output.splitlines()]
    return [line for line in lines if line and not _MIDDLEWARE.match(line)]


def cpu_seconds(process: int) -> float:
    """What a process has used of the cores, s, its end included as long as nobody has waited for it."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def end(process: subprocess.Popen[Any]) -> None:
    """Ask it to end, so that others learn that it has gone; kill it only if it does not."""
    if process.poll() is None:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def report_of(message: Any) -> dict[str, Any]:
    """What the only status of a message says, by key; numbers and truths as such."""
    (status,) = message.status
    return {pair.key: _plain(pair.value) for pair in status.values}


def _plain(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return text


class NodeProcess:
    """valve_node or another program, started as a user does; its stderr goes to a file."""

    def __init__(
        self, folder: Path, arguments: Sequence[str] = (), program: str = "valve_node", **environment: str
    ) -> None:
        self._log = folder / f"stderr-{time.monotonic_ns()}.txt"
        package = "nodes" if program in NODES else "station"
        command = [sys.executable, "-m", f"valve_sim.{package}", program, *arguments]
        with self._log.open("w") as log:
            self.process = subprocess.Popen(
                command, stdout=log, stderr=log, env={**os.environ, "ROS_LOG_DIR": str(folder), **environment}
            )

    @property
    def output(self) -> str:
        """What it has said so far."""
        return self._log.read_text()

    def exit_code(self) -> int:
        """The exit code, once it has ended."""
        return self.process.wait(ENDS_WITHIN)


@contextlib.contextmanager
def running(
    folder: Path, arguments: Sequence[str] = (), program: str = "valve_node", **environment: str
) -> Iterator[NodeProcess]:
    """valve_node, or another program, while inside."""
    node = NodeProcess(folder, arguments, program, **environment)
    try:
        yield node
    finally:
        end(node.process)


@contextlib.contextmanager
def beside(
    folder: Path, name: str, arguments: Sequence[str] = (), program: str = "valve_node", **environment: str
) -> Iterator[tuple[Probe, NodeProcess]]:
    """A node of this full name, and a probe of it."""
    namespace, _, base = name.rpartition("/")
    words = ["--ros-args", "-r", f"__node:={base}", "-r", f"__ns:={namespace or '/'}", *arguments]
    probe = Probe(name)
    try:
        with running(folder, words, program, **environment) as process:
            yield probe, process
    finally:
        probe.close()


def ended(process: subprocess.Popen[str], number: int | None = None, code: int = 0) -> str:
    """What a program of `piped` has said, once it has ended with this code; after a signal, if one is given."""
    if number is not None:
        process.send_signal(number)
    _, said = process.communicate(timeout=ENDS_WITHIN)
    assert process.returncode == code, said
    return said


@contextlib.contextmanager
def piped(
    folder: Path, program: Sequence[str], words: Sequence[str] = (), **parameters: object
) -> Iterator[subprocess.Popen[str]]:
    """Python with a program that takes ROS parameters, while inside; its stderr is a pipe, read when it has ended."""
    pairs = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    command = [sys.executable, *program, "--ros-args", *words, *pairs]
    environment = {**os.environ, "ROS_LOG_DIR": str(folder)}
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment) as process:
        try:
            yield process
        finally:
            end(process)


class Diagnostics:
    """What a node, by default the probe's target, says on /diagnostics from now on."""

    def __init__(self, probe: Probe, node: str = "") -> None:
        from diagnostic_msgs.msg import DiagnosticArray

        self._node = node or probe.target[1:]
        self.heard = probe.hear("/diagnostics", DiagnosticArray)

    def all(self, task: str, since: int = 0) -> list[Any]:
        """The statuses of a task, oldest first; those of a stamp, ns, and later."""
        name = f"{self._node}: {task}"
        fresh = (one for one in self.heard if one.header.stamp.sec * 10**9 + one.header.stamp.nanosec >= since)
        return [status for message in fresh for status in message.status if status.name == name]

    def values(self, task: str) -> dict[str, Any]:
        """Keys, values and the level of a task's last status; nothing before the first."""
        said = self.all(task)
        return {**{pair.key: pair.value for pair in said[-1].values}, "level": said[-1].level[0]} if said else {}

    def is_said(self, task: str, level: int, words: str = "") -> bool:
        """Whether a status of this task has had this level and words."""
        return any(status.level[0] == level and words in status.message for status in self.all(task))


class Probe:
    """A node in the test's own process: hears, commands, calls."""

    def __init__(self, target: str = "/valve") -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor

        self.target = target
        self.node: Any = rclpy.create_node("probe")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)

    def close(self) -> None:
        """Release the node."""
        self._executor.shutdown()
        self.node.destroy_node()

    def hear(self, topic: str, kind: Any, *, latched: bool = False) -> list[Any]:
        """A list that grows by each message."""
        from rclpy.qos import DurabilityPolicy, QoSProfile

        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        heard: list[Any] = []
        name = topic if topic.startswith("/") else f"{self.target}/{topic}"
        self.node.create_subscription(kind, name, heard.append, QoSProfile(depth=1000, durability=durability))
        return heard

    def talker(self, topic: str, kind: Any, qos: Any = 10) -> Any:
        """A publisher that somebody listens to."""
        name = topic if topic.startswith("/") else f"{self.target}/{topic}"
        publisher = self.node.create_publisher(kind, name, qos)
        return publisher

    def until(self, condition: Callable[[], Any], patience: float = PATIENCE) -> bool:
        """Spin until the condition holds; whether it came to that.

        What is waited for takes as many times as long as this machine is slow.
        """
        begin = time.monotonic()
        while not condition():
            waited = time.monotonic() - begin
            if waited > patience and (patience < ASK_AGAIN or waited > patience * min(slowness(), SLOWEST)):
                return False
            self._executor.spin_once(timeout_sec=0.02)
        return True

    def insist(self, action: Callable[[], Any], condition: Callable[[], Any]) -> bool:
        """Do it, and again as often as nothing comes of it: the first message may be lost; whether it came to that."""
        for _ in range(round(PATIENCE / ASK_AGAIN)):
            action()
            if self.until(condition, ASK_AGAIN):
                return True
        return False

    def spin_for(self, seconds: float) -> None:
        """Hear what comes in so many seconds: for what must not come."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.02)

    def call(self, service: str, kind: Any, request: Any = None) -> Any:
        """The answer of a service of the node."""
        client = self.node.create_client(kind, f"{self.target}/{service}")
        assert self.until(client.service_is_ready), f"{self.target}/{service} did not appear"
        return self.answers([client], kind.Request() if request is None else request)[0]

    def answers(self, clients: Sequence[Any], request: Any) -> list[Any]:
        """What each of these services says; who does not answer is asked again, as DDS may lose a first reply.

        A server that has a question before it has found the reader of replies waits for it for 100 ms, then drops the
        reply (https://github.com/ros2/ros2/issues/1253).
        """
        replies: dict[Any, Any] = {}
        for _ in range(round(PATIENCE / ASK_AGAIN)):
            for client in clients:
                if client not in replies:
                    future = client.call_async(request)
                    future.add_done_callback(lambda future, client=client: replies.update({client: future.result()}))
            if self.until(lambda: len(replies) == len(clients), ASK_AGAIN):
                return [replies[client] for client in clients]
        silent = [client.srv_name for client in clients if client not in replies]
        raise AssertionError(f"no answer within {PATIENCE:g} s from {silent}")

    def set_parameters(self, **values: Any) -> list[Any]:
        """Set parameters, `__` for a dot; the results."""
        from rclpy.parameter import Parameter

        return self.set_messages(
            [Parameter(name.replace("__", "."), value=value).to_parameter_msg() for name, value in values.items()]
        )

    def set_messages(self, parameters: Sequence[Any]) -> list[Any]:
        """Set parameters that are messages; the results."""
        from rcl_interfaces.srv import SetParameters

        return list(self.call("set_parameters", SetParameters, SetParameters.Request(parameters=parameters)).results)

    def parameters(self) -> dict[str, Any]:
        """All parameters of the node."""
        from rcl_interfaces.srv import GetParameters, ListParameters
        from rclpy.parameter import parameter_value_to_python

        names = list(self.call("list_parameters", ListParameters).result.names)
        values = self.call("get_parameters", GetParameters, GetParameters.Request(names=names)).values
        return {name: parameter_value_to_python(value) for name, value in zip(names, values, strict=True)}
