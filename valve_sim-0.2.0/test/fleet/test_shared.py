"""One valve from many recordings, each fitted by itself: what one fit to all of them finds."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from distributed import Client, LocalCluster
from plants.declared import CAMPAIGN_VALVE, DeclaredPlant
from plants.laboratory import Laboratory, measure
from plants.recording import Recorder, record, train_bags, write_bag

from valve_sim.cli import main
from valve_sim.files.parameter_files import default_valve, load_valve
from valve_sim.fleet.shared import Recordings, identify_shared
from valve_sim.identification.estimation.findings import LacksSomething
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.estimation.shared_fit import (
    ReducedNormalEquations,
    as_fit,
    fit_shared,
    machine_nuisances,
    share_of,
)
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.valve import DAMPINGS, ValvePlant
from valve_sim.traces import read_trace

VALVE: dict[str, float | tuple[float, float, float, float]] = {
    **CAMPAIGN_VALVE, "spring_rate": 445.0, "pilot_damping": 1.3,
}  # fmt: skip
STAMPS_ERR = Recorder(quantisation=0.1e-6, command_jitter=30e-6, sample_rate=10e3)


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Four recordings of one stroke each, whose stamps err."""
    folder = tmp_path_factory.mktemp("shared")
    strokes = train_bags(8)[:4]
    return [
        write_bag(record(DeclaredPlant({}, VALVE), stroke, STAMPS_ERR, seed), folder / f"day_{seed}")
        for seed, stroke in enumerate(strokes)
    ]


def test_the_optimum_and_its_errors_are_those_of_one_fit_to_all_recordings(bags: list[Path]) -> None:
    traces = [read_trace(bag) for bag in bags]
    whole = Problem(ValvePlant(traces, default_valve()))
    plant = whole.plant
    nuisances = (*plant.nuisances, *plant.timing_errors)
    together = fit(whole, DAMPINGS, fit(whole, DAMPINGS, {}, nuisances=nuisances).values, nuisances=nuisances)
    # The noise of one sensor is estimated from all recordings or from each; here it is that of all.
    parts = [Problem(ValvePlant([trace], default_valve()), noises=whole.noises) for trace in traces]

    def shares_at(values: Mapping[str, float]) -> list[ReducedNormalEquations]:
        return [share_of(part, DAMPINGS, values, {})[0] for part in parts]

    shared = fit_shared(parts[0], DAMPINGS, shares_at, {})
    assert shared.converged
    assert shared.chi2 == pytest.approx(together.chi2, abs=0.01)
    apart = as_fit(parts[0], DAMPINGS, shared)
    machine = [*DAMPINGS, *(own.name for own in machine_nuisances(plant, DAMPINGS))]
    assert len(machine) > 8
    (at, errors), (at_apart, errors_apart) = (of_machine(result, machine) for result in (together, apart))
    # A fit ends within a tenth of a standard error of the optimum.
    assert (np.abs(at - at_apart) / errors).max() < 0.1
    assert errors_apart == pytest.approx(errors, rel=1e-3)


def test_recordings_whose_sensors_drift_and_hum_give_the_truth_and_what_errs(tmp_path: Path) -> None:
    valve = {**CAMPAIGN_VALVE, "pilot_damping": 0.7, "main_damping": 5.4}
    laboratory = Laboratory(drift=1.5e-6, hum=1e-6, sample_rate=10e3)
    bags = [
        write_bag(measure(valve, {}, profile, laboratory, seed), tmp_path / f"day_{seed}")
        for seed, profile in enumerate(train_bags(2))
    ]
    found = identify_shared(bags, Recordings(default_valve(), DAMPINGS))
    for name, interval in found.intervals.items():
        assert abs(interval.value - valve[name]) < 4.0 * interval.stderr
    assert len(found.recording) == len(bags)
    assert all(bag.name in source for bag, source in zip(bags, found.recording, strict=True))
    assert not any(isinstance(finding, LacksSomething) for finding in found.findings)
    for errors in found.recording.values():
        assert {"drift", "hum"} <= {own.error for own in errors if own.is_likely}


def test_what_the_model_lacks_in_all_recordings_is_said_once(tmp_path: Path) -> None:
    friction = {"coulomb_friction": {"force": 0.1}}
    bags = [
        write_bag(record(DeclaredPlant(friction, CAMPAIGN_VALVE), profile, Recorder(), seed), tmp_path / f"day_{seed}")
        for seed, profile in enumerate(train_bags(2))
    ]
    found = identify_shared(bags, Recordings(default_valve(), DAMPINGS))
    (lacking,) = [finding for finding in found.findings if isinstance(finding, LacksSomething)]
    assert lacking.probability > 0.99
    assert not found.recording


def of_machine(result: Fit, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Internal coordinates of what is the machine's, and their standard errors."""
    all_names = [*result.free, *(own.name for own in result.nuisances)]
    places = [all_names.index(name) for name in names]
    return result.coordinates[places], np.sqrt(np.diag(result.covariance))[places]


def test_many_recordings_give_the_same_on_a_cluster_and_the_truth_within_its_errors(bags: list[Path]) -> None:
    recordings = Recordings(default_valve(), DAMPINGS)
    here = identify_shared(bags, recordings)
    cluster = LocalCluster(n_workers=2, threads_per_worker=1, processes=False, dashboard_address=":0")
    with cluster, Client(cluster, set_as_default=False) as client:
        there = identify_shared(bags, recordings, lambda: client)
    assert {name: there.fit.values[name] for name in here.fit.values} == pytest.approx(here.fit.values, rel=1e-9)
    truth = {"pilot_damping": 1.3, "main_damping": 4.0}
    for name, interval in here.intervals.items():
        assert abs(interval.value - truth[name]) < 4.0 * interval.stderr
    alone = identify_shared(bags[:1], recordings)
    assert here.intervals["main_damping"].stderr < 0.7 * alone.intervals["main_damping"].stderr
    (spring,) = [own for own in here.declared if own.name == "spring_rate"]
    assert abs(spring.estimate - 445.0) < 4.0 * spring.stderr
    assert here.rmse_after < 0.5 * here.rmse_before


def test_identify_shared_writes_what_identify_does_and_refuses_in_one_line(bags: list[Path], tmp_path: Path) -> None:
    output = ["--output", str(tmp_path / "out")]
    ran = CliRunner().invoke(main, ["identify", *map(str, bags[:2]), "--shared", *output])
    assert ran.exit_code == 0, ran.output
    report = json.loads((tmp_path / "out" / "identify.json").read_text("utf-8"))
    assert report["sources"] == [str(bag) for bag in bags[:2]]
    identified = load_valve(tmp_path / "out" / "identified.yaml").parameters
    assert identified.pilot_damping == pytest.approx(report["parameters"]["pilot_damping"]["value"], rel=1e-5)
    (tmp_path / "none.mcap").write_bytes(b"")
    for words, message in (
        ([str(bags[0]), str(tmp_path / "none.mcap"), "--shared"], "none.mcap: is empty"),
        ([str(bags[0]), "--workers", "2"], "are for --shared"),
    ):
        refused = CliRunner().invoke(main, ["identify", *words, *output])
        assert refused.exit_code == 2
        assert message in refused.stderr.strip().splitlines()[-1]
        assert "Traceback" not in refused.stderr
