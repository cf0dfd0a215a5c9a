"""Is a live recording true on a busy machine? `python -m benchmarks.nodes.recording --strokes 40`.

Starts valve_node as a process at 1 kHz, puts busy processes beside it at the same priority, commands full strokes of
9 V, and records what comes: commands by their arrival, ~/joint_states and ~/coil. t1 is then read from two bags of the
same strokes, with ~/coil and without, and compared with that of the model. Wanted with ~/coil: within 0.02 ms in every
stroke whose samples came; those of a few may be lost where the recorder has too little of a processor, but not of half.
Exit code 1 where that falls short; needs ROS 2.
"""

from __future__ import annotations

import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import BatteryState, JointState
from std_msgs.msg import Float64

from benchmarks.common import parser, say
from benchmarks.nodes.driver import busy, program, ros, running, spinning
from benchmarks.nodes.timing import AT_RATE
from valve_sim.files.parameter_files import default_valve
from valve_sim.model import Drive, published_times, simulate
from valve_sim.traces import BagRecorder, events_from_sensors, read_trace

VOLTS: Final = 9.0
HELD: Final = 0.5
"""s of each voltage: a node that has a tenth of a processor obeys within it."""
WANTED: Final = 0.02e-3
"""s, by which t1 may differ from the model's."""
COMPILING, SETTLING = 300.0, 5.0
"""s for the node to be there, on a machine that compiles meanwhile, and for the last messages to come."""
TOPICS: Final = {
    "/valve/coil_voltage": ("std_msgs/msg/Float64", Float64),
    "/valve/joint_states": ("sensor_msgs/msg/JointState", JointState),
    "/valve/coil": ("sensor_msgs/msg/BatteryState", BatteryState),
}
STAMPED: Final = "/valve/coil"


class Message(NamedTuple):
    """What came, and when, ns of the recorder's clock."""

    topic: str
    payload: bytes
    arrived: int


class Recorder:
    """Commands the valve, and keeps what comes on its topics."""

    def __init__(self) -> None:
        self.node = Node("live_recording")
        self.messages: list[Message] = []
        self.heard = {topic: threading.Event() for topic in TOPICS}
        for topic, (_, kind) in TOPICS.items():
            self.node.create_subscription(kind, topic, self._keeper(topic), QoSProfile(depth=5000), raw=True)
        self.commands = self.node.create_publisher(Float64, "/valve/coil_voltage", 10)

    def _keeper(self, topic: str) -> Any:
        def keep(payload: bytes) -> None:
            self.messages.append(Message(topic, bytes(payload), time.time_ns()))
            self.heard[topic].set()

        return keep

    def is_connected(self) -> bool:
        """Whether the valve hears the commands, and the recorder hears them and the valve."""
        self.commands.publish(Float64(data=0.0))
        is_obeyed = self.commands.get_subscription_count() > 1
        return is_obeyed and all(event.is_set() for event in self.heard.values())

    def strokes(self, count: int) -> None:
        """Command so many."""
        for _ in range(count):
            for volts in (VOLTS, 0.0):
                self.commands.publish(Float64(data=volts))
                time.sleep(HELD)
        time.sleep(SETTLING)


def recorded(strokes: int, neighbours: int) -> list[Message]:
    """What was recorded of so many strokes beside so many busy processes; RuntimeError where the node did not come."""
    recorder = Recorder()
    with running({"valve": program("valve_node", AT_RATE)}), spinning(recorder.node):
        end = time.monotonic() + COMPILING
        while not recorder.is_connected():
            if time.monotonic() > end:
                raise RuntimeError("valve_node did not come")
            time.sleep(0.1)
        with busy(neighbours):
            recorder.messages.clear()
            recorder.strokes(strokes)
        return list(recorder.messages)


def arrivals(path: Path, messages: Sequence[Message]) -> np.ndarray:
    """(strokes,) s, t1 by the bag that these messages make, as `valve-sim info` has it."""
    with BagRecorder(path) as bag:
        for message in messages:
            bag.write(message.topic, TOPICS[message.topic][0], message.payload, message.arrived)
    strokes = events_from_sensors(read_trace(path), default_valve().parameters.pilot_gap)
    seen = [event for stroke in strokes for event in stroke.events]
    return np.array([event.after_command for event in seen if event.kind == "pilot_reaches_main"])


def main() -> int:
    """Record, compare and print; 1 if anything falls short."""
    known = parser("nodes.recording", __doc__)
    known.add_argument("--strokes", type=int, default=40)
    known.add_argument("--neighbours", type=int, default=8, help="busy processes (default 8)")
    chosen = known.parse_args()
    with ros():
        messages = recorded(chosen.strokes, chosen.neighbours)
    t1, _ = published_times(simulate(default_valve(), Drive.of([0.0], [VOLTS]), [0.0, 0.04]))
    good: list[bool] = []
    with tempfile.TemporaryDirectory() as folder:
        for words, wanted, kept in (
            ("commands by their arrival", np.inf, [one for one in messages if one.topic != STAMPED]),
            ("with ~/coil", WANTED, messages),
        ):
            errors = arrivals(Path(folder, f"{len(good)}.mcap"), kept) - t1
            worst = float(np.max(np.abs(errors), initial=0.0))
            middle, spread = np.median(errors), np.std(errors)
            figures = f"median {1e3 * middle:+.4f}, standard deviation {1e3 * spread:.4f}, largest {1e3 * worst:.4f} ms"
            print(
                f"      {words}: t1 less the model's, {1e3 * t1:.3f} ms, in {len(errors)} of {chosen.strokes} strokes:"
            )
            good.append(say(2 * len(errors) > chosen.strokes and worst <= wanted, figures))
    return 0 if all(good) else 1


if __name__ == "__main__":
    sys.exit(main())
