"""One linearisation: derivatives of each kind of unknown beside difference quotients, and products of its rows."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
import pytest
from plants.recording import Recorder

from identification import freed
from identification.recordings import FINE, recorded
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.fit import problem as problems
from valve_sim.identification.fit.columns import Columns, columns_of
from valve_sim.identification.fit.gaussian import Gaussian
from valve_sim.identification.fit.gram import gram
from valve_sim.identification.fit.model import Model
from valve_sim.identification.fit.problem import Problem
from valve_sim.identification.fit.result import fit
from valve_sim.identification.fit.rows import CondensedRows
from valve_sim.identification.fit.unknown import Hypothesis, Unknown, curve, unknowns_of
from valve_sim.identification.plants import valve_pieces
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.model import Tolerances, Valve, simulate
from valve_sim.recordings import Signal, Trace

BOTH = ("pilot_damping", "main_damping")
SHORT = 1e-3
"""Of the step of a difference quotient: no sample lies between an event and where such a step moves it."""
SHORTER = 2e-5
"""Of a standard deviation of a value of the machine."""


def tolerant() -> Valve:
    """The default valve, whose declared values are known within tolerances."""
    declared = {"spring_rate": 4.0, "spring_preload": 0.02, "pilot_gap": 2e-6, "stroke": 2e-6, "moving_mass": 1e-4}
    covariance = tuple(map(tuple, np.diag([0.03, 100.0, 1e5, 1e8]) ** 2))
    return replace(default_valve(), tolerances=Tolerances(declared, covariance))


def with_current(trace: Trace) -> Trace:
    """A recording with a coil current beside, from the default valve, sampled at no command's own time."""
    times = trace.times + 13e-6
    current = simulate(default_valve(), trace.drive, times).coil_current
    noise = 1e-3 * np.random.default_rng(2).standard_normal(len(current))
    return replace(trace, coil_current=Signal(times, current + noise))


@pytest.fixture(scope="module")
def problem() -> Problem:
    """Two recordings of position and current, with all errors that they may have."""
    trace = with_current(recorded())
    plant = ValvePlant([trace, replace(trace, source="again")], tolerant())
    return Problem(plant).with_columns(columns_of(plant, {}, {}))


# -- derivatives -------------------------------------------------------------------------------------------------------


def in_general(unknowns: list[Unknown]) -> np.ndarray:
    """(k,) a place off where unknowns begin, and within their ranges."""
    off = 0.2 * np.random.default_rng(3).standard_normal(len(unknowns))
    at = [
        own.coordinate(own.parameter.prior_scale) if own.is_switch and own.parameter else own.start + own.scale * move
        for own, move in zip(unknowns, off.tolist(), strict=True)
    ]
    return np.clip(at, [own.lower for own in unknowns], [own.upper for own in unknowns])


def quotient(model: Model, z: np.ndarray, place: int) -> np.ndarray:
    own = model.moving[place]
    step = SHORTER * own.scale if own.is_tolerated else (0.1 if own.slopes else SHORT) * own.step
    move = step * (np.arange(len(z)) == place)
    return np.asarray(model.residuals(z + move) - model.residuals(z - move)) / (2.0 * step)


def kinds(problem: Problem, kind: str) -> tuple[list[Unknown], Mapping[str, float]]:
    """Unknowns of a kind, and what is held beside them."""
    plant, known = problem.plant, unknowns_of(problem.plant)
    if kind.startswith("curve"):
        (own,) = (one for one in plant.force_maps if kind == f"curve({one.variable})")
        chosen: Hypothesis = curve(own, 0.02, 8)
        return [*chosen.frees], chosen.held
    of_kind = {
        "dampings and voltage": freed.unknowns(problem, (*BOTH, "reference_voltage")),
        "tolerances": [own for own in known.known if own.of_machine],
        "clocks": [own for own in known.known if not own.of_machine],
        "stamps": [*known.stamps],
        "what varies": [*problem.columns.varying],
    }
    return of_kind[kind] if kind in of_kind else [*known.hypotheses[kind].frees], {}


CURVES = [f"curve({own.variable})" for own in ValvePlant([recorded()], default_valve()).force_maps]
KINDS = ["dampings and voltage", "tolerances", "clocks", "stamps", "what varies",
         "squeeze_film", "eddy_lag", "magnetic_saturation"]  # fmt: skip


@pytest.mark.parametrize("kind", [*KINDS, *CURVES])
def test_derivatives_of_every_kind_of_unknown_are_those_of_small_differences(problem: Problem, kind: str) -> None:
    unknowns, held = kinds(problem, kind)
    assert unknowns
    model = Model(problem, unknowns, held)
    z = in_general(unknowns)
    jacobian = model.linearise(z).moved[:, :-1]
    for place, own in enumerate(unknowns):
        expected = quotient(model, z, place)
        assert np.linalg.norm(jacobian[:, place] - expected) < 1e-4 * np.linalg.norm(expected), own.name
    assert np.all(np.linalg.norm(jacobian, axis=0) > 0.0)


# -- sums --------------------------------------------------------------------------------------------------------------


def places(unknowns: list[Unknown]) -> Iterator[np.ndarray]:
    yield np.array([own.start for own in unknowns])
    yield in_general(unknowns)


RECORDERS = {"white": FINE, "coloured": Recorder(colour=0.7), "coarse": Recorder(quantisation=5e-6)}


@pytest.mark.parametrize("recorder", RECORDERS)
def test_few_rows_have_the_criterion_of_all_samples_and_a_fit_to_them_its_optimum(recorder: str) -> None:
    plant = ValvePlant([recorded(RECORDERS[recorder])], default_valve())
    every = Problem(plant)
    few = every.condensed()
    assert isinstance(few.rows, CondensedRows)
    assert np.sum(few.rows.counts) == pytest.approx(every.samples, abs=1)
    assert len(few.rows.counts) < 0.5 * every.samples
    unknowns = freed.unknowns(every, BOTH, plant.nuisances)
    for z in places(unknowns):
        whole, part = (Gaussian(model := Model(one, unknowns), z, model.linearise(z), {}) for one in (every, few))
        assert part.cost == pytest.approx(whole.cost, rel=1e-6, abs=0.01)
    # Within a block, hum and ringing are their means.
    columns = columns_of(plant, {}, {})
    for own, of_evidence, of_value in ((Columns(), 0.01, 0.001), (columns, 2.0, 0.2)):
        all_rows, few_rows = (fit(one.with_columns(own), [*unknowns, *own.unknowns], {}) for one in (every, few))
        assert few_rows.converged
        assert few_rows.log_evidence == pytest.approx(all_rows.log_evidence, abs=of_evidence)
        for name in BOTH:
            assert abs(few_rows.values[name] - all_rows.values[name]) < of_value * all_rows.stderr(name)
    # What is asked of a fit beside its optimum is of every sample.
    assert few_rows.residuals.shape == all_rows.residuals.shape


@pytest.fixture
def _short_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(valve_pieces, "SAMPLES", 2)  # fewer than what colours the noise


@pytest.mark.usefixtures("_short_pieces")
@pytest.mark.parametrize("further", [(), ("coil_heating.temperature_rate",)])
def test_products_of_pieces_are_those_of_their_rows(further: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    plant = ValvePlant([recorded(RECORDERS["coloured"])], default_valve())
    problem = Problem(plant)
    model = Model(problem, freed.unknowns(problem, (*BOTH, *further), plant.nuisances))
    for z in places(list(model.moving)):
        by_rows = model.linearise(z)
        with monkeypatch.context() as patch:
            patch.setattr(problems, "LONG", 0)
            by_pieces = model.linearise(z)
        assert len(by_pieces.moved) == 0
        scale = np.sqrt(np.diag(by_rows.products))
        by_hand = gram(by_rows.rows, by_rows.rows)
        for products in (by_rows.products, by_pieces.products):
            np.testing.assert_allclose(products / np.outer(scale, scale), by_hand / np.outer(scale, scale), atol=1e-9)


def test_products_with_columns_are_those_of_the_rows(problem: Problem) -> None:
    model = Model(problem, [*freed.unknowns(problem, BOTH), *problem.columns.unknowns])
    assert len(model.linear) > 20
    sums = model.linearise(model.start)
    scale = np.sqrt(np.diag(sums.products))
    np.testing.assert_allclose(
        sums.products / np.outer(scale, scale), sums.rows.T @ sums.rows / np.outer(scale, scale), atol=1e-9
    )
    # A column says what its coefficient adds to what the sensor shows.
    own = model.linear[5]
    change = problem.every_row.whitened_columns({0: problem.columns.samples[0]})[0][1][:, own.column]
    whole = sums.fixed.dense()
    np.testing.assert_allclose(whole[: len(change), 5], -change)
    # A model frees some of them.
    places = [1, 5, len(model.linear) - 1]
    some, coefficients = problem.white_columns.chosen(places), np.array([1.0, -2.0, 3.0])
    np.testing.assert_array_equal(some.dense(), whole[:, places])
    np.testing.assert_allclose(some @ coefficients, whole[:, places] @ coefficients, atol=1e-12)
    np.testing.assert_allclose(some.onto(sums.moved), whole[:, places].T @ sums.moved, rtol=1e-9, atol=1e-9)


@pytest.mark.long
def test_memory_holds_no_column_of_a_tolerance() -> None:
    """Residuals come in pieces, so that twelve tolerances take no more memory than what a piece of them does."""
    trace = recorded()
    times = np.linspace(trace.times[0], trace.times[-1], 4 * problems.LONG)
    position = np.interp(times, trace.times, trace.pilot_position)
    plant = ValvePlant([replace(trace, times=times, pilot_position=position, main_position=None)], default_valve())
    assert len(plant.nuisances) > 8
    freed.fit(Problem(plant), BOTH, {}, nuisances=plant.nuisances)  # what is compiled on the way counts no more
    problem = Problem(plant)
    assert problem.is_long
    tracemalloc.start()
    try:
        freed.fit(problem, BOTH, {}, nuisances=plant.nuisances)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 60 * len(times)
