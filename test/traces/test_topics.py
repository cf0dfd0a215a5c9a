"""Messages are decoded while they are read, whatever blocks they come in."""

import tracemalloc
from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from valve_sim.model import Drive
from valve_sim.traces import Signal, Trace, read_trace, write_bag
from valve_sim.traces.cdr import Decoder
from valve_sim.traces.topics import TopicReader

STORE = get_typestore(Stores.ROS2_JAZZY)
JOINT_STATE = "sensor_msgs/msg/JointState"


def joint_state(names: list[str], position: float) -> bytes:
    header = STORE.types["std_msgs/msg/Header"](STORE.types["builtin_interfaces/msg/Time"](3, 5), "valve")
    values = np.array([position] * len(names))
    message = STORE.types[JOINT_STATE](header, names, values, values, values)
    return bytes(STORE.serialize_cdr(message, JOINT_STATE))


@given(
    st.lists(st.tuples(st.sampled_from([["pilot"], ["pilot", "main"], ["other"]]), st.floats(-1, 1)), max_size=30),
    st.integers(1, 7),
)
def test_blocks_make_no_difference(messages: list[tuple[list[str], float]], size: int) -> None:
    payloads = [joint_state(names, position) for names, position in messages]
    decoder = Decoder(JOINT_STATE)
    for start in range(0, len(payloads), size):
        decoder.take_messages(payloads[start : start + size])
    found = {}
    for batch in decoder.decoded().batches:
        for place, position in zip(batch.places.tolist(), batch.numbers("position").tolist(), strict=True):
            found[place] = (list(batch.layout.texts["name"]), position)
    assert [found[place] for place in range(len(messages))] == messages


def test_only_what_is_asked_for_is_kept() -> None:
    decoder = Decoder(JOINT_STATE, keep={"position"})
    decoder.take_messages([joint_state(["pilot"], 0.5)])
    (batch,) = decoder.decoded().batches
    assert set(batch.columns) == {"position"}
    assert batch.stamps is not None
    assert batch.stamps.array().tolist() == [3_000_000_005]


def test_later_files_come_in_bag_time_order() -> None:
    first, later = (TopicReader(Decoder(JOINT_STATE)) for _ in range(2))
    first.take_message(20, joint_state(["pilot"], 2.0))
    first.take_message(40, joint_state(["pilot"], 4.0))
    later.take_message(10, joint_state(["pilot"], 1.0))
    later.take_message(30, joint_state(["pilot"], 3.0))
    first.absorb(later)
    times, decoded = first.topic()
    assert decoded is not None
    values = np.empty(4)
    for batch in decoded.batches:
        values[batch.where] = batch.numbers("position")
    assert times.array().tolist() == [10, 20, 30, 40]
    assert values.tolist() == [1.0, 2.0, 3.0, 4.0]


def test_memory_does_not_hold_the_messages(tmp_path: Path) -> None:
    """A joint state and a current are 250 bytes in the file; what is wanted of them, with their times, is 32."""
    count = 200_000
    times = np.arange(count) / 20e3 + 1e-5 * np.random.default_rng(1).random(count)
    position = 1e-3 * np.sin(times)
    trace = Trace("test", Drive.of([0.0], [9.0]), times, position, coil_current=Signal(times, position))
    write_bag(tmp_path / "long.mcap", trace)
    read_trace(tmp_path / "long.mcap")  # what is imported on the way counts no more
    tracemalloc.start()
    try:
        read_trace(tmp_path / "long.mcap")
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 60 * count
