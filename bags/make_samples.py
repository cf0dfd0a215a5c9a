"""Makes the sample bags: `python bags/make_samples.py` from a checkout (README.md says what each is).

The seeded ones come out alike each time, to the byte of every sample. The live one is a recording of valve_node in real
time: it needs ROS 2, and comes out a little different each time.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from valve_sim.files.parameter_files import default_valve, save_valve
from valve_sim.model import Drive, Valve, simulate
from valve_sim.recordings import BagRecorder, Signal, Trace, write_bag

HERE = Path(__file__).resolve().parent
EPOCH_NS = 1_700_000_000_000_000_000
RATE = 10e3
"""Hz, of the samples of the seeded bags."""
NOISE = 1e-6
"""m, standard deviation."""
STEP = 0.1e-6
"""m, of the position sensor."""
CURRENT_NOISE = 1e-3
"""A."""
BENCH_VALVE = {
    "pilot_mass": 0.021,
    "moving_mass": 0.030,
    "main_damping": 3.0,
    "spring_rate": 2000.0,
    "spring_preload": 3.0,
    "a0": 4.5,
    "a1": 8.0e3,
    "a2": 1.0e7,
    "a3": 0.0,
    "pilot_gap": 0.15e-3,
    "stroke": 0.6e-3,
    "reference_voltage": 24.0,
    "coil_time_constant": 2.0e-3,
    "coil_resistance": 38.0,
}
"""Of the valve that the oscilloscope's table is of, in SI units; docs/tutorials/own_oscilloscope.md declares it."""
LIVE_DAMPINGS = {"pilot_damping": 1.3, "main_damping": 4.8}
"""N·s/m, of the valve that the live recording is of."""
LIVE_RATE = 2000.0
"""Hz."""


class Sample(NamedTuple):
    """One seeded bag.

    Attributes:
        name: file or folder. seed: of its noise. valve: what made it. storage: of a folder.
        volts: (s, V) commands. duration: s. with_current: whether the coil current is recorded too.
    """

    name: str
    seed: int
    valve: Valve
    volts: Sequence[tuple[float, float]]
    duration: float
    storage: Literal["mcap", "sqlite3"] = "mcap"
    with_current: bool = False


def strokes(*levels: float, length: float = 0.030) -> list[tuple[float, float]]:
    """Openings at these voltages for a time, s, each followed by a rest as long, beginning at 10 ms."""
    commands = []
    for index, volts in enumerate(levels):
        start = 0.010 + 2.0 * length * index
        commands += [(start, volts), (start + length, 0.0)]
    return commands


def samples() -> list[Sample]:
    """The seeded bags."""
    declared = default_valve()
    damped = declared.with_values(pilot_damping=1.5, main_damping=5.0)
    sticky = Valve(declared.parameters, {"coulomb_friction": {"force": 0.15}})
    return [
        Sample("eight_strokes.mcap", 1, damped, strokes(9.0, 12.0, 7.5, 14.0, 10.3, 8.4, 13.0, 11.2), 0.5),
        Sample("friction", 2, sticky, strokes(9.0, 12.0, 7.5, 14.0), 0.26, "sqlite3", with_current=True),
        Sample("one_opening.mcap", 3, declared, [(0.010, 9.0)], 0.040),
    ]


def make(sample: Sample, folder: Path) -> Path:
    """Simulate, add noise, and write one seeded bag; returns it."""
    random = np.random.default_rng(sample.seed)
    times = np.arange(round(sample.duration * RATE)) / RATE
    drive = Drive.of(*zip(*sample.volts, strict=True))
    shown = simulate(sample.valve, drive, times)

    def measured(position: Any) -> Any:
        return STEP * np.round((position + NOISE * random.standard_normal(len(times))) / STEP)

    pilot, main = measured(shown.pilot_position), measured(shown.main_position)
    current = Signal(times, shown.coil_current + CURRENT_NOISE * random.standard_normal(len(times)))
    shown_current = current if sample.with_current else None
    trace = Trace(sample.name, drive, times, pilot, main, coil_current=shown_current, epoch_ns=EPOCH_NS)
    path = folder / sample.name
    if path.is_dir():
        shutil.rmtree(path)
    write_bag(path, trace, storage=sample.storage, compressed=True)
    return path


def make_table(folder: Path) -> Path:
    """Write a seeded recording of another valve as an oscilloscope exports it; returns it.

    CH1 is the coil's voltage behind a 1:10 probe, CH2 a laser of 1 V per mm, CH3 a current clamp of 100 mV per A.
    """
    random = np.random.default_rng(4)
    times = np.arange(round(0.21 * RATE)) / RATE
    drive = Drive.of(*zip(*strokes(24.0, 20.0, 28.0, 22.0, length=0.025), strict=True))
    declared = default_valve().with_values(**BENCH_VALVE)
    shown = simulate(Valve(declared.parameters, {"coulomb_friction": {"force": 0.3}}), drive, times)

    def channel(values: Any, noise: float) -> Any:
        return values + noise * random.standard_normal(len(times))

    volts = channel(0.1 * shown.coil_voltage, 2e-3)
    lift = channel(1e3 * shown.pilot_position, 1e-3)
    clamp = channel(0.1 * shown.coil_current, 2e-4)
    lines = ["Model;4-channel oscilloscope", "Sample rate;10 kHz", "Time;CH1;CH2;CH3", "s;V;V;V"]
    for row in zip(times, volts, lift, clamp, strict=True):
        lines.append(";".join(f"{value:.4f}" for value in row).replace(".", ","))
    path = folder / "oscilloscope.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def record_live(path: Path, volts: Sequence[tuple[float, float]], duration: float, parameters: Sequence[str]) -> None:
    """Start valve_node, command it in real time, and record what it publishes and what it is told.

    Args:
        path: the new recording.
        volts: (s, V) commands, times from the beginning of the recording.
        duration: s.
        parameters: further arguments of the node, in ROS's form.

    Raises:
        TimeoutError: the node does not answer.
    """
    # Linux then ends the node with this process, though it be killed and can tell nobody.
    with_parent = ["setpriv", "--pdeathsig", "TERM"] if shutil.which("setpriv") else []
    command = [*with_parent, sys.executable, "-m", "valve_sim.nodes", "valve_node", "--ros-args", *parameters]
    with subprocess.Popen(command) as node:
        try:
            _record(path, volts, duration)
        finally:
            node.send_signal(signal.SIGTERM)


def _record(path: Path, volts: Sequence[tuple[float, float]], duration: float) -> None:
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.qos import QoSProfile
    from rclpy.serialization import serialize_message
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64

    rclpy.init()
    node = rclpy.create_node("recorder")
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    heard: list[tuple[str, str, bytes, int]] = []

    def listen(topic: str, kind: Any, name: str) -> None:
        def hear(payload: bytes) -> None:
            heard.append((topic, name, payload, time.time_ns()))

        node.create_subscription(kind, topic, hear, QoSProfile(depth=10_000), raw=True)

    listen("/valve/joint_states", JointState, "sensor_msgs/msg/JointState")
    listen("/valve/coil_current", Float64, "std_msgs/msg/Float64")
    talker = node.create_publisher(Float64, "/valve/coil_voltage", 10)

    def until(condition: Callable[[], bool], patience: float) -> bool:
        end = time.monotonic() + patience
        while not condition():
            if time.monotonic() > end:
                return False
            executor.spin_once(timeout_sec=0.001)
        return True

    try:
        if not until(lambda: bool(heard) and talker.get_subscription_count() > 0, 60.0):
            raise TimeoutError("valve_node did not answer within a minute")
        heard.clear()
        start = time.monotonic()
        for at, level in volts:
            until(lambda at=at: time.monotonic() - start >= at, duration)
            message = Float64(data=level)
            sent = time.time_ns()
            talker.publish(message)
            heard.append(("/valve/coil_voltage", "std_msgs/msg/Float64", serialize_message(message), sent))
        until(lambda: time.monotonic() - start >= duration, duration)
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown()
    with BagRecorder(path, compressed=True) as recorder:
        for topic, name, payload, stamp in sorted(heard, key=lambda message: message[3]):
            recorder.write(topic, name, payload, stamp)


def make_live(folder: Path) -> Path:
    """The live bag; returns it."""
    path = folder / "live.mcap"
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch) / "valve.yaml"
        save_valve(file, default_valve().with_values(**LIVE_DAMPINGS), "the valve of bags/live.mcap")
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        arguments = ["--params-file", str(file), "-p", f"publish_rate:={LIVE_RATE}"]
        record_live(path, strokes(9.0, 12.0, 7.5, 14.0, 10.0), 0.33, arguments)
    return path


def main() -> int:
    """Make the bags into a folder."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=HERE)
    parser.add_argument("--live", action="store_true", help="record the live one too (needs ROS 2)")
    given = parser.parse_args()
    paths = [*(make(sample, given.folder) for sample in samples()), make_table(given.folder)]
    if given.live:
        paths.append(make_live(given.folder))
    for path in paths:
        print(path)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
