"""Which modes the mounts of sensors ring in: looked for in what a fit leaves after contacts."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from valve_sim.identification.fit.columns import seen_by
from valve_sim.identification.fit.errors.error import Mode
from valve_sim.identification.fit.errors.ringing import columns, grid, refined
from valve_sim.identification.fit.gaussian import Gaussian
from valve_sim.identification.plants.protocol import Sensor

MOST_MODES: Final = 2
"""Of one mount."""
WORTH: Final = 8.0
"""Half of the fall of χ² from which a mode is one."""
RINGS: Final = 20e-3
"""s after a contact, in which ringing is looked for."""
PLAINLY: Final = 4.0
"""Standard deviations of a sum of squares beyond which more than noise is left after contacts."""


def ringing_modes(gaussian: Gaussian) -> dict[int, tuple[Mode, ...]]:
    """The modes of a fit's columns, and one more of each sensor that plainly rings in another, by channel.

    Raises:
        SimulationError: the machine cannot be simulated where the fit is.
    """
    problem = gaussian.model.problem
    found = dict(problem.columns.modes)
    for channel, sensor in problem.plant.sensors(gaussian.model.values(gaussian.z)).items():
        modes = found.get(channel, ())
        mode = likely_mode(gaussian, channel, sensor) if len(modes) < MOST_MODES else None
        if mode is not None:
            found[channel] = (*modes, mode)
    return found


def likely_mode(gaussian: Gaussian, channel: int, sensor: Sensor) -> Mode | None:
    """The mode that explains most of what is left of a channel, all else at its best; None of noise."""
    problem, times = gaussian.model.problem, sensor.contacts.times
    if not len(times):
        return None
    places, own = problem.rows.places, problem.plant.channels[channel]
    since = places.time - times[np.clip(np.searchsorted(times, places.time) - 1, 0, None)]
    after = (places.channel == channel) & (since >= 0.0) & (since < RINGS) & (places.steady > 0.0)
    left, count = gaussian.left_at_best[after], int(np.count_nonzero(after))
    interval = float(np.median(np.diff(own.times)))
    candidates = grid(interval)
    if not count or not candidates or float(left @ left) < count + PLAINLY * math.sqrt(2.0 * count):
        return None
    shown = np.zeros(len(own.times))

    def gain(mode: Mode) -> float:
        waves = columns(seen_by(sensor, own, shown, (mode,)))
        where, rows = problem.rows.whitened_columns({channel: waves})[channel]
        further = np.zeros((len(places.time), rows.shape[1]))
        further[where] = -rows
        squares, pulls = gaussian.beyond(further)
        return 0.5 * float(pulls @ np.linalg.lstsq(squares, pulls, rcond=1e-10)[0])

    best = max(candidates, key=gain)
    return refined(best, lambda mode: -gain(mode), interval) if gain(best) > WORTH else None
