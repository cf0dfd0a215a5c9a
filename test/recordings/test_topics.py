"""Messages are decoded while they are read, whatever blocks they come in."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from valve_sim.recordings.cdr import typestore
from valve_sim.recordings.topics import Topic

STORE = get_typestore(Stores.ROS2_JAZZY)
JOINT_STATE = "sensor_msgs/msg/JointState"


def joint_state(names: list[str], position: float) -> bytes:
    header = STORE.types["std_msgs/msg/Header"](STORE.types["builtin_interfaces/msg/Time"](3, 5), "valve")
    values = np.array([position] * len(names))
    message = STORE.types[JOINT_STATE](header, names, values, values, values)
    return bytes(STORE.serialize_cdr(message, JOINT_STATE))


def topic(keep: set[str] | None = None) -> Topic:
    return Topic(JOINT_STATE, typestore().fielddefs, keep)


@given(
    st.lists(
        st.tuples(st.integers(0, 99), st.sampled_from([["pilot"], ["pilot", "main"], ["other"]]), st.floats(-1, 1)),
        max_size=30,
    ),
    st.integers(1, 7),
)
def test_blocks_and_files_make_no_difference(messages: list[tuple[int, list[str], float]], size: int) -> None:
    """Whatever blocks they come in, and however files overlap, they are in the order of time."""
    taken = topic()
    for start in range(0, len(messages), size):
        block = messages[start : start + size]
        payloads = [joint_state(names, position) for _, names, position in block]
        stops = np.cumsum([len(payload) for payload in payloads])
        starts = np.concatenate([[0], stops[:-1]])
        times = np.array([time for time, _, _ in block], dtype=np.int64)
        taken.take(times, np.frombuffer(b"".join(payloads), np.uint8), starts, stops, times)
    taken.finish()
    found, times = {}, taken.stamps("bag").taken
    for batch in taken.batches:
        for index, position in zip(batch.indices.tolist(), batch.columns["position", 0].tolist(), strict=True):
            found[index] = (int(times[index]), list(batch.joints), position)
    assert [found[index] for index in range(len(messages))] == sorted(messages, key=lambda message: message[0])


@pytest.mark.parametrize(
    ("keep", "kept"),
    [
        ({"position"}, [("position", 0), ("position", 1)]),
        ({"velocity[1]", "effort[5]"}, [("velocity", 1)]),
        ({""}, []),
    ],
)
def test_only_what_is_asked_for_is_kept(keep: set[str], kept: list[tuple[str, int]]) -> None:
    taken = topic(keep)
    taken.add(7, joint_state(["pilot", "main"], 0.5))
    taken.finish()
    (batch,) = taken.batches
    assert list(batch.columns) == kept
    assert [column.tolist() for column in taken.stamps()] == [[3_000_000_005], [7 - 3_000_000_005], [True]]
    assert [column.tolist() for column in taken.stamps("bag")] == [[7], [0], [False]]
