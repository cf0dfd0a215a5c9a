"""Errors of a recording: their columns, what is told of their size, and the priors of it."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import pytest

from valve_sim.identification.fit.errors import Seen
from valve_sim.identification.fit.errors.bend import BEND
from valve_sim.identification.fit.errors.drift import DRIFT, RAMPS
from valve_sim.identification.fit.errors.error import Mode
from valve_sim.identification.fit.errors.hum import HUM
from valve_sim.identification.fit.errors.ringing import RINGING, RINGING_SCATTER
from valve_sim.identification.fit.unknown import Group
from valve_sim.identification.plants.protocol import Array, Contacts

SPAN = 1.2e-3
TIMES = np.arange(4000) / 20e3
CONTACTS = Contacts(np.array([0.02, 0.05, 0.12]), np.array([1.0, 0.5, 1.0]), np.array([1, 0, 1]))


def seen(shown: Array | None = None, modes: tuple[Mode, ...] = ()) -> Seen:
    """A channel of 0.2 s at 20 kHz with four commands."""
    return Seen(
        TIMES,
        np.zeros_like(TIMES) if shown is None else shown,
        SPAN,
        np.array([0.01, 0.06, 0.1, 0.15]),
        CONTACTS,
        modes,
    )


def test_a_bend_is_straight_at_both_ends_of_the_range() -> None:
    assert BEND.columns is not None
    assert BEND.amount is not None
    columns = BEND.columns(seen(np.linspace(0.0, SPAN, len(TIMES))))
    np.testing.assert_allclose(columns[[0, -1]], 0.0, atol=1e-12)
    assert BEND.amount(np.array([4e-6, 0.0, 0.0, 0.0, 0.0, 0.0]), columns) == pytest.approx(1e-6)


def test_drift_is_a_constant_and_ramps_that_stay() -> None:
    assert DRIFT.columns is not None
    columns = DRIFT.columns(seen())
    assert columns.shape == (len(TIMES), 1 + RAMPS * 5)  # four commands make five intervals
    np.testing.assert_allclose(columns[:, 0], 1.0)
    assert np.all(np.diff(columns[:, 1:], axis=0) >= -1e-12)
    np.testing.assert_allclose(columns[0, 1:], 0.0)


def test_drift_is_told_of_whole_strokes() -> None:
    """3 µm in each of two strokes of different lengths; half a stroke at the end, which drifts by less, is none."""
    assert DRIFT.columns is not None
    assert DRIFT.amount is not None
    zero = np.interp(TIMES, [0.0, 0.06, 0.15, TIMES[-1]], [0.0, 3e-6, 0.0, 1e-6])
    columns = DRIFT.columns(seen())
    coefficients = np.linalg.lstsq(columns, zero, rcond=None)[0]
    assert DRIFT.amount(coefficients, columns) == pytest.approx(3e-6)
    # A recording that is shorter than a stroke has what there is.
    short = DRIFT.columns(seen()._replace(times=TIMES[:1000], knots=np.array([0.01])))
    climbs = np.linalg.lstsq(short, zero[:1000], rcond=None)[0]
    assert DRIFT.amount(climbs, short) == pytest.approx(float(zero[999]))


def test_hum_holds_a_sine_of_the_mains_of_any_phase() -> None:
    assert HUM.columns is not None
    assert HUM.amount is not None
    wave = 2e-6 * np.sin(2.0 * math.pi * 150.0 * TIMES + 1.0)
    columns = HUM.columns(seen())
    coefficients = np.linalg.lstsq(columns, wave, rcond=None)[0]
    np.testing.assert_allclose(columns @ coefficients, wave, atol=1e-12)
    assert HUM.amount(coefficients, columns) == pytest.approx(2e-6, rel=1e-6)


def test_a_harmonic_that_samples_cannot_show_is_left_out() -> None:
    assert HUM.columns is not None
    slow = seen()._replace(times=np.arange(200) / 400.0, shown=np.zeros(200))
    assert HUM.columns(slow).shape[1] == 2 * len(
        [f for f in (50, 100, 150, 200, 250, 60, 120, 180, 240, 300) if f < 200]
    )


def test_a_mount_rings_after_contacts_alone_and_as_their_momentum() -> None:
    assert RINGING.columns is not None
    assert RINGING_SCATTER.columns is not None
    assert RINGING.columns(seen()).shape[1] == 0
    modes = (Mode(800.0, 2e-3),)
    columns = RINGING.columns(seen(modes=modes))
    assert columns.shape[1] == 4  # a pair at the seat and at the stop
    assert not np.any(columns[TIMES < 0.02])
    stop = columns[:, 2:]
    since = TIMES[(TIMES >= 0.02) & (TIMES < 0.03)] - 0.02
    np.testing.assert_allclose(
        stop[(TIMES >= 0.02) & (TIMES < 0.03), 0],
        np.exp(-since / 2e-3) * np.sin(2.0 * math.pi * 800.0 * since),
        atol=1e-9,
    )
    assert np.max(np.abs(columns[:, :2])) == pytest.approx(0.5, rel=0.1)
    assert RINGING_SCATTER.columns(seen(modes=modes)).shape[1] == 6


@pytest.mark.parametrize("law", ["cauchy", "normal"])
def test_the_prior_of_a_size_is_a_density_over_its_scale(law: Literal["cauchy", "normal"]) -> None:
    sizes = np.geomspace(1e-6, 1e6, 20_001)
    density = np.exp(Group(0, "made", 2.0, law).log_prior(2.0 * sizes))
    assert np.trapezoid(density, sizes) == pytest.approx(1.0, abs=1e-3)
