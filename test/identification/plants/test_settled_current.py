"""Where a coil current has settled, so that what is seen of it is noise, however late the commands' stamps are."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from plants.recording import Recorder, train_profile

from identification.recordings import recorded
from valve_sim.identification.fit.noise import estimate_noise
from valve_sim.identification.plants.protocol import Channel
from valve_sim.identification.plants.valve_sensors import channels_of
from valve_sim.recordings import Signal

NOISE = 1e-3
"""A."""


def current(recorder: Recorder, heating: float = 0.0) -> tuple[Channel, np.ndarray]:
    """The channel of a recorded current that falls by `heating` a second, and when the commands acted, s."""
    trace = recorded(recorder, seed=3, pilot_damping=1.0, main_damping=4.0)
    assert trace.coil_current is not None
    shown = trace.coil_current.values * np.exp(-heating * trace.times)
    trace = replace(trace, coil_current=Signal(trace.times, shown))
    return channels_of(0, trace)[1], train_profile().times


@pytest.mark.parametrize(("late", "scatter"), [(-1e-3, 0.0), (3e-3, 0.5e-3)])
def test_stamps_that_come_late_are_no_noise_of_the_current(late: float, scatter: float) -> None:
    recorder = Recorder(with_current=True, current_noise=NOISE, clock_offset=late, command_jitter=scatter)
    assert estimate_noise([current(recorder)[0]]).sigma == pytest.approx(NOISE, rel=0.05)


@pytest.mark.parametrize(("noise", "heating"), [(0.0, 0.0), (NOISE, 0.5)])
def test_of_right_stamps_the_last_third_of_each_interval_is_settled(noise: float, heating: float) -> None:
    channel, acted = current(Recorder(with_current=True, current_noise=noise), heating)
    edges = np.concatenate([acted, channel.times[-1:]])
    shares = [
        np.mean(channel.quiet[(channel.times >= start) & (channel.times < stop)])
        for start, stop in itertools.pairwise(edges)
    ]
    np.testing.assert_allclose(shares, 1.0 / 3.0, atol=0.02)
    assert np.all(channel.quiet[channel.times < acted[0]])
