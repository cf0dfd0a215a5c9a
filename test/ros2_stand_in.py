"""What the documents' `ros2` commands do, where there is no ros2cli: the wheels that CI installs have none.

`run`, `topic pub --once`, `topic echo --once` and `bag record` as the documents use them; anything else fails.
"""

from __future__ import annotations

import argparse
import importlib
import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

PATIENCE = 60.0


def run(words: list[str]) -> int:
    """ros2 run PACKAGE NODE arguments."""
    package, node, *rest = words
    program = [package] if node == "valve-sim" else [f"{package}.nodes", node]
    os.execv(sys.executable, [sys.executable, "-m", *program, *rest])


def message_class(name: str) -> Any:
    package, _, kind = name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), kind)


def _patient(node: Any, condition: Callable[[], bool], what: str) -> None:
    import rclpy

    end = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > end:
            raise SystemExit(f"no {what} within {PATIENCE:g} s")
        rclpy.spin_once(node, timeout_sec=0.02)


def publish(words: list[str]) -> int:
    """ros2 topic pub --once [-w LISTENERS] TOPIC TYPE VALUES."""
    import rclpy
    import yaml

    listeners = int(words[2]) if words[1] == "-w" else 1
    topic, kind, values = words[-3:]
    node = rclpy.create_node("publisher")
    talker = node.create_publisher(message_class(kind), topic, 10)
    message = message_class(kind)()
    for field, value in yaml.safe_load(values).items():
        setattr(message, field, value)
    _patient(node, lambda: talker.get_subscription_count() >= listeners, f"listener on {topic}")
    talker.publish(message)
    talker.wait_for_all_acked()
    return 0


def echo(words: list[str]) -> int:
    """ros2 topic echo --once OPTIONS TOPIC TYPE, of a topic that is latched.

    As the real one: where one quality of service is given, the others are those of sensor data. Who is not reliable
    hears what comes, but nothing of before.
    """
    import rclpy
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    parser = argparse.ArgumentParser()
    parser.add_argument("--once", action="store_true", required=True)
    parser.add_argument("--qos-durability", choices=["transient_local"], required=True)
    parser.add_argument("--qos-reliability", choices=["reliable", "best_effort"], default="best_effort")
    parser.add_argument("topic")
    parser.add_argument("kind")
    given = parser.parse_args(words)
    topic, kind = given.topic, given.kind
    node = rclpy.create_node("listener")
    heard: list[Any] = []
    reliability = ReliabilityPolicy[given.qos_reliability.upper()]
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL, reliability=reliability)
    node.create_subscription(message_class(kind), topic, heard.append, latched)
    _patient(node, lambda: bool(heard), f"message on {topic}")
    print(f"data: {str(heard[0].data).lower()}\n---")
    return 0


def record(words: list[str]) -> int:
    """ros2 bag record --storage mcap --output FOLDER TOPICS, until SIGINT: what came in before then is kept."""
    import rclpy
    from rclpy.qos import QoSProfile

    from valve_sim.recordings.writing import BagRecorder

    parser = argparse.ArgumentParser()
    parser.add_argument("--storage", choices=["mcap"], required=True)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("topics", nargs="+")
    given = parser.parse_args(words)
    node = rclpy.create_node("recorder")
    stopped: list[int] = []
    signal.signal(signal.SIGINT, lambda number, frame: stopped.append(time.time_ns()))
    waiting: dict[str, tuple[str, Any]] = {}
    for topic in given.topics:
        _patient(node, lambda topic=topic: topic in dict(node.get_topic_names_and_types()), topic)
        (kind,) = dict(node.get_topic_names_and_types())[topic]
        ears = node.create_subscription(message_class(kind), topic, print, QoSProfile(depth=50_000), raw=True)
        waiting[topic] = kind, ears.handle
    with BagRecorder(given.output) as recorder:
        while not stopped:
            time.sleep(0.02)
            for topic, (kind, handle) in waiting.items():
                # Without an executor, which would need longer for each message than it takes to write it.
                while (found := handle.take_message(message_class(kind), True)) is not None:
                    payload, info = found
                    if stopped and info["received_timestamp"] > stopped[0]:
                        break
                    # As ros2 bag's own, by the time at which it came in.
                    recorder.write(topic, kind, payload, info["received_timestamp"])
    return 0


COMMANDS = {("topic", "pub"): publish, ("topic", "echo"): echo, ("bag", "record"): record}


def main(words: list[str]) -> int:
    """Dispatch."""
    if words[0] == "run":
        return run(words[1:])
    if words[0] == "topic" and words[2] != "--once":
        raise SystemExit(f"not stood in for: ros2 {' '.join(words)}")
    command = COMMANDS.get((words[0], words[1]))
    if command is None:
        raise SystemExit(f"not stood in for: ros2 {' '.join(words)}")
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        return command(words[2:])
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
