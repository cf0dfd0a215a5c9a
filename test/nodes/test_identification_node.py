"""identification_node as a user meets it: a live valve recorded, identified, and given what was found."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nodes.ros import Float64, JointState, String
from valve_sim.files.parameter_files import default_valve, load_valve
from valve_sim.files.parameter_sections import read_sections
from valve_sim.files.resources import config_path
from valve_sim.identification.plants.valve import STROKE_LEVELS, volts_at
from valve_sim.recordings import read_trace
from valve_sim.recordings.synthetic import read_profile

from .ros_process import PATIENCE, Diagnostics, Probe, ended, piped, running

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("ros")]
TARGET = "/identification"


BAGS = Path(__file__).resolve().parents[2] / "bags"
MAKER = BAGS / "make_samples.py"


@pytest.fixture(scope="module")
def target(ros: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """One valve_node for all tests that give a valve another one's parameters; it has its own name, /valve."""
    with running(tmp_path_factory.mktemp("target")):
        yield


@pytest.fixture
def live(target: None) -> Iterator[Probe]:
    """A probe of that valve, which has its own parameters before and after."""
    probe = Probe("/valve")
    own = probe.parameters()
    yield probe
    found = probe.parameters()
    changed = {name.replace(".", "__"): value for name, value in own.items() if found[name] != value}
    assert all(result.successful for result in probe.set_parameters(**changed))
    probe.close()


def identifying(folder: Path, **parameters: object) -> contextlib.AbstractContextManager[subprocess.Popen[str]]:
    """identification_node while inside; it writes into the folder."""
    given: dict[str, object] = {"output": folder, **parameters}
    return piped(folder, ("-m", "valve_sim.nodes", "identification_node"), **given)


def maker() -> Any:
    spec = importlib.util.spec_from_file_location("make_samples", MAKER)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["make_samples"] = module
    spec.loader.exec_module(module)
    return module


def test_a_recorded_live_valve_is_identified_and_another_one_given_its_parameters(
    probe: Probe, live: Probe, tmp_path: Path
) -> None:
    # The shipped recording of a live run: one made here would hold the stamps of whatever else this machine does.
    bag = BAGS / "live.mcap"
    results = probe.hear("result", String, latched=True)
    given: dict[str, object] = {"apply_to": "valve", "linger": "true", "rate": 0}
    with identifying(tmp_path, bag=bag, **given) as process:
        assert probe.until(lambda: results), "no result"
        report = json.loads(results[0].data)
        applied = live.parameters()
        said = ended(process, signal.SIGINT)
    for name, truth in maker().LIVE_DAMPINGS.items():
        found = report["parameters"][name]
        assert found["ci95"][0] <= truth <= found["ci95"][1]
        assert found["ci95"][1] - found["ci95"][0] < 0.05 * truth
        assert applied[f"valve.{name}"] == found["value"]
    assert (report["applied"]["node"], report["applied"]["is_set"], report["applied"]["reason"]) == ("/valve", True, "")
    for line in report["applied"]["changes"]:
        assert f"/valve: {line}" in said
    assert "valve.pilot_damping: 1 → 1.3" in said
    assert "95 % interval 1.2" in said
    assert f"ready: replays {bag} on /identification/measured/joint_states beside the model" in said
    file = tmp_path / "identified.yaml"
    assert report["file"] == str(file)
    written = load_valve(file).parameters
    assert written.pilot_damping == pytest.approx(applied["valve.pilot_damping"], rel=1e-12)
    assert written.main_damping == pytest.approx(applied["valve.main_damping"], rel=1e-12)


def test_it_ends_when_the_recording_is_played_and_the_result_is_known(tmp_path: Path) -> None:
    with identifying(tmp_path, bag=BAGS / "one_opening.mcap", rate=0) as process:
        said = ended(process)
    assert f"; see {tmp_path / 'identified.yaml'}" in said
    assert re.search(r"identified: pilot_damping \d\.\d+ ± \d\.\d+ N·s/m, main_damping", said)
    assert "Traceback" not in said


FRICTION = BAGS / "friction"
"""A recording of a valve with Coulomb friction, which the declared one lacks."""
EXACT = config_path("tank_1.yaml")
"""The shipped valve, its values taken as exact."""


@pytest.mark.long
@pytest.mark.any_distribution
def test_a_fit_that_leaves_more_than_tolerances_is_not_handed_on(probe: Probe, live: Probe, tmp_path: Path) -> None:
    results = probe.hear("result", String, latched=True)
    given: dict[str, object] = {"apply_to": "valve", "linger": "true", "rate": 0}
    with identifying(tmp_path, bag=FRICTION, **given) as process:
        assert probe.until(lambda: results), "no result"
        said = ended(process, signal.SIGINT, 1)
        assert (live.parameters()["valve.pilot_damping"], live.parameters()["valve.main_damping"]) == (1.0, 4.0)
    applied = json.loads(results[0].data)["applied"]
    assert not applied["is_set"]
    assert "tolerances off, so the model lacks something" in applied["reason"]
    assert "/valve is as it was" in said
    assert not (tmp_path / "before.yaml").exists()


def test_what_was_set_all_the_same_can_be_undone(probe: Probe, live: Probe, tmp_path: Path) -> None:
    results = probe.hear("result", String, latched=True)
    given: dict[str, object] = {
        "apply_to": "valve",
        "apply_always": "true",
        "linger": "true",
        "rate": 0,
        "params": EXACT,
    }
    before = live.parameters()
    with identifying(tmp_path, bag=FRICTION, **given) as process:
        assert probe.until(lambda: results), "no result"
        assert json.loads(results[0].data)["applied"]["is_set"]
        wrong = live.parameters()
        assert wrong["valve.main_damping"] != 4.0
        assert live.set_parameters(frame_id="tank")[0].successful
        said = ended(process, signal.SIGINT)
    assert "is given the result although the residual is not white" in said
    file = tmp_path / "before.yaml"
    assert f"undo: `ros2 param load /valve {file.resolve()}`" in said
    (section,) = read_sections(file)
    assert all(one.successful for one in live.set_parameters(**section.values)), "as that command does"
    assert live.parameters() == {**before, "frame_id": "tank"}, "what others set meanwhile stays"
    assert section.node == "/valve"
    assert section.values == {name: before[name] for name in section.values}
    assert {"valve.main_damping", "effects.coulomb_friction.force", "tolerances.stroke"} <= section.values.keys()


@pytest.mark.long
def test_the_replay_is_the_recording_beside_the_model(probe: Probe, tmp_path: Path) -> None:
    bag = BAGS / "one_opening.mcap"
    trace = read_trace(bag)
    measured, predicted = ByStamp(probe, "measured/joint_states"), ByStamp(probe, "predicted/joint_states")
    residuals, volts = probe.hear("residual", Float64), probe.hear("coil_voltage", Float64)
    heard = Diagnostics(probe)
    stamps = {trace.epoch_ns + round(time * 1e9) for time in trace.times.tolist()}
    with identifying(tmp_path, bag=bag, rate=0.05, loop="true") as process:
        assert probe.until(lambda: measured.messages.keys() == predicted.messages.keys() == stamps)
        assert probe.until(lambda: volts and heard.is_said("replay", 0))
        ended(process, signal.SIGTERM)
    positions = measured.positions()
    np.testing.assert_array_equal(positions, trace.pilot_position)
    assert np.std(positions - predicted.positions()) < 3e-6
    assert {round(message.data, 12) for message in volts} == {9.0}
    assert max(abs(message.data) for message in residuals) < 10e-6


class ByStamp:
    """The last message of each stamp: what one turn of a replay lacks, the next one brings."""

    def __init__(self, probe: Probe, topic: str) -> None:
        self.messages: dict[int, Any] = {}
        probe.node.create_subscription(JointState, f"{probe.target}/{topic}", self._take, 1000)

    def _take(self, message: Any) -> None:
        self.messages[message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec] = message

    def positions(self) -> np.ndarray:
        """Of the pilot plunger, in the order of the stamps, m."""
        return np.array([message.position[0] for _, message in sorted(self.messages.items())])


@pytest.mark.long
@pytest.mark.any_distribution
def test_a_diagnosis_is_published_too(probe: Probe, tmp_path: Path) -> None:
    results = probe.hear("result", String, latched=True)
    heard = Diagnostics(probe)
    profile = tmp_path / "record_next.yaml"
    bag = BAGS / "one_opening.mcap"
    # It declares friction that this valve has not: one stroke cannot tell that from a constant force.
    given: dict[str, object] = {"params": config_path("tank_2.yaml"), "mode": "diagnose", "budget": 4.0}
    with identifying(tmp_path, bag=bag, rate=0, linger="true", **given):
        assert probe.until(lambda: results, 3 * PATIENCE), "no result"
        assert probe.until(lambda: heard.is_said("identification", 0, f"and {profile} for what to record next"))
    report = json.loads(results[0].data)
    assert report["schema"] == "valve_sim/diagnosis/3"
    assert load_valve(tmp_path / "corrected.yaml").parameters.stroke == 1.23e-3
    assert report["record_next"], "one stroke tells nothing apart"
    assert set(volts_at(default_valve(), STROKE_LEVELS)) <= set(read_profile(profile).volts)
