"""Rows that stand for many samples of a machine at rest say what all of these say."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from plants.recording import Recorder

from identification.recordings import FINE, recorded
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.fit.problem import Problem
from valve_sim.identification.fit.rows import CondensedRows, Rows
from valve_sim.identification.fit.result import fit
from valve_sim.identification.plants.valve import ValvePlant

BOTH = ("pilot_damping", "main_damping")
COLOURED, COARSE = Recorder(colour=0.7), Recorder(quantisation=5e-6)


def problem_of(recorder: Recorder) -> Problem:
    return Problem(ValvePlant([recorded(recorder)], default_valve().exact()))


@pytest.fixture(scope="module", params=[FINE, COLOURED, COARSE], ids=["white", "coloured", "coarse"])
def problem(request: pytest.FixtureRequest) -> Problem:
    return problem_of(request.param)


def chi2(rows: Rows, values: Mapping[str, float]) -> float:
    return rows.constant + float(np.sum(np.square(rows.residuals(values))))


def test_few_rows_have_the_criterion_of_all_samples(problem: Problem) -> None:
    rows = problem.condensed().rows
    assert isinstance(rows, CondensedRows)
    assert np.sum(rows.counts) == pytest.approx(problem.samples, abs=1)
    assert len(rows.counts) < 0.5 * problem.samples
    for values in ({}, {"pilot_damping": 1.4, "main_damping": 3.2}, {"stroke_offset.offset": 2e-6}):
        assert chi2(rows, values) == pytest.approx(chi2(problem.every_row, values), abs=0.01)


def test_a_fit_to_few_rows_ends_where_one_to_all_samples_does(problem: Problem) -> None:
    nuisances = (*problem.plant.nuisances, *problem.plant.timing_errors)
    every, few = (fit(one, BOTH, {}, nuisances=nuisances) for one in (problem, problem.condensed()))
    assert few.converged
    assert few.log_evidence == pytest.approx(every.log_evidence, abs=0.01)
    for name in BOTH:
        assert abs(few.values[name] - every.values[name]) < 1e-3 * every.stderr(name)
    # What is asked of a fit beside its optimum is of every sample.
    assert few.residuals.shape == every.residuals.shape
    np.testing.assert_allclose(few.jacobian, every.jacobian, atol=1e-3 * float(np.max(np.abs(every.jacobian))))
