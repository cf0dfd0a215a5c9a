"""Columns of a machine by its map: out of bags as out of tables, and beside gaps of the logger."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import valve_sim as vs
from valve_sim.model import ValveError

from .bag_makers import EPOCH, Message, float_message, joint_state, make_folder, make_mcap

MAP = {
    "force": {"topic": "/motor/force", "unit": "kN", "scale": 2.0},
    "angle": {"topic": "/joint_states", "joint": "hinge", "unit": "deg"},
    "use": "time > 0.1 and force > 0",
}


def messages() -> list[Message]:
    """A force at 250 Hz without stamps, and an angle at 500 Hz whose stamps are 2 ms before their arrival."""
    found = []
    for i in range(500):
        time = EPOCH + i * 2_000_000
        found.append(joint_state("/joint_states", time + 2_000_000, (0.0, float(i)), stamp=time, names=("a", "hinge")))
        if i % 2 == 0:
            found.append(float_message("/motor/force", time, float(np.sin(0.02 * i))))
    return sorted(found, key=lambda message: message.time)


@pytest.mark.parametrize("make", [make_mcap, make_folder])
def test_a_bag_is_read_as_a_table_is(make: Any, tmp_path: Path) -> None:
    read = vs.read(make(tmp_path / "log.mcap", messages()), MAP)
    force, angle = read["force"], read["angle"]
    assert (len(force.times), len(angle.times)) == (250, 500)
    np.testing.assert_allclose(angle.times, 2e-3 * np.arange(500), atol=1e-12)
    assert angle.unit is not None
    assert force.unit is not None
    np.testing.assert_allclose(angle.si(angle.unit), np.deg2rad(np.arange(500.0)))
    np.testing.assert_allclose(force.si(force.unit), 2000.0 * np.sin(0.04 * np.arange(250)), atol=1e-9)
    # The force, which has times of its own, chooses among the samples of both.
    assert not angle.used[angle.times < 0.1].any()
    shown = np.sin(10.0 * angle.times)
    assert np.array_equal(angle.used[shown > 0.05], angle.times[shown > 0.05] > 0.1)
    assert not angle.used[shown < -0.05].any()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"force": {"topic": "/motor/torque"}},
            r"force.topic: /motor/torque is not in .*, it has|it has /joint_states",
        ),
        ({"angle": {"topic": "/joint_states", "joint": "knee"}}, "names a, hinge, expected knee"),
        ({"angle": {"topic": "/joint_states"}}, "holds several numbers .* choose one with field:"),
        ({"force": {"topic": "/motor/force", "clock": "header"}}, "have no stamp; use clock: bag"),
        ({"force": {"topic": "/motor/force", "clock": "sundial"}}, "found 'sundial', expected"),
        ({"force": {"column": "F"}}, r"force: found .*, expected \{topic:"),
        ({"time": {"column": "t"}}, "time: is for tables"),
        (
            {"force": {"topic": "/motor/force", "color": 3}},
            r"force\.color: unknown key; .*expected one of topic, field",
        ),
    ],
)
def test_a_map_that_does_not_fit_the_bag_is_one_line(change: Any, words: str, tmp_path: Path) -> None:
    with pytest.raises(ValveError) as raised:
        vs.read(make_mcap(tmp_path / "log.mcap", messages()), MAP | change)
    assert re.search(words, str(raised.value)), raised.value
    assert len(str(raised.value).splitlines()) == 1


def test_a_bag_without_a_map_asks_for_one(tmp_path: Path) -> None:
    from valve_sim.recordings.columns import read

    with pytest.raises(ValveError, match="or a bag with --map"):
        read(make_mcap(tmp_path / "log.mcap", messages()))


def test_a_filter_begins_anew_after_a_gap_and_what_it_distorts_is_left_out(tmp_path: Path) -> None:
    times = np.arange(0.0, 4.0, 1e-3)
    times = times[(times < 1.5) | (times > 2.1)]
    np.savetxt(
        tmp_path / "t.csv", np.c_[times, np.sin(6.0 * times)], delimiter=",", header="t,q", comments="", fmt="%.9g"
    )
    found = vs.read(
        tmp_path / "t.csv", {"time": "t", "w": {"column": "q", "unit": "rad", "derivative": 1, "low_pass": 20}}
    )
    column = found["w"]
    beside = ((times > 1.4) & (times < 1.5)) | ((times > 2.1) & (times < 2.2))
    assert not column.used[beside].any()
    kept = column.used & (times > 0.1) & (times < 3.9)
    assert kept.sum() > 0.85 * np.sum((times > 0.1) & (times < 3.9))
    assert np.max(np.abs(column.readings - 6.0 * np.cos(6.0 * times))[kept]) < 0.03
    assert any("beside gaps (the longest 0.6" in finding for finding in found.findings)
