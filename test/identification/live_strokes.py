"""Strokes of the independent plant as a monitor meets them: one after another, in small batches, stamps jittered."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from plants.common import FloatArray
from plants.declared import CAMPAIGN_VALVE, DeclaredPlant
from plants.laboratory import REPEATABLE, SHARE_OF_LOADS
from plants.recording import LEVELS

LEAD, OPEN_SECONDS, CLOSED_SECONDS = 0.02, 0.03, 0.03
"""s: of rest before a stroke, with voltage, and after it."""
STROKE_SECONDS = LEAD + OPEN_SECONDS + CLOSED_SECONDS
MAINS = 50.0
"""Hz."""
STEP = 1e-5
"""s: of the plant. Its fourth order leaves the positions within a picometre of those by 2 µs."""
BATCH = 0.01
"""s of samples that are handed over together."""


class LiveStroke(NamedTuple):
    """One stroke as stamped: commands (2,) s and V, samples (n,) s, m and A (the current without noise)."""

    command_times: FloatArray
    volts: FloatArray
    times: FloatArray
    position: FloatArray
    current: FloatArray


@dataclass
class LiveValve:
    """A valve that strokes for ever.

    Attributes:
        seed: of noise and jitter. parameters: that differ from the shipped valve's.
        rate: samples a second. noise: m, standard deviation. colour: of first order.
        jitter: s, of each command's stamp. offset: s by which all samples are stamped late.
        variation: relative standard deviation of each damping from stroke to stroke, each drawn for itself; seat load
            and preload vary by a third of it. drift: m, standard deviation of what the sensor's zero, a random walk,
            moves by from stroke to stroke. hum: m, amplitude of the mains of 50 Hz.
    """

    seed: int
    parameters: Mapping[str, float] = field(default_factory=dict)
    rate: float = 20e3
    noise: float = 1e-6
    colour: float = 0.0
    jitter: float = 50e-6
    offset: float = 0.0
    variation: float = 0.0
    drift: float = 0.0
    hum: float = 0.0
    levels: tuple[float, ...] = LEVELS
    strokes: int = 0

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)
        # What a laboratory adds has generators of its own: all else is the same with and without it.
        self._of_strokes, self._of_zero = (np.random.default_rng([self.seed, own]) for own in (1, 2))
        self._phase = float(self._of_zero.uniform(0.0, 2.0 * np.pi))
        self._time, self._zero = 0.0, 0.0

    def stroke(
        self,
        effects: Mapping[str, Mapping[str, float]] | None = None,
        open_seconds: float = OPEN_SECONDS,
        **parameters: float,
    ) -> LiveStroke:
        """The next stroke, by a valve with these effects, which is at rest and cold before it."""
        return self.row(1, effects, open_seconds, **self._varied(parameters))[0]

    def _varied(self, parameters: Mapping[str, float]) -> dict[str, float]:
        """Parameters of the next stroke."""
        if not self.variation:
            return dict(parameters)
        mean = {**CAMPAIGN_VALVE, **self.parameters, **parameters}
        draws = zip(REPEATABLE, self._of_strokes.standard_normal(len(REPEATABLE)).tolist(), strict=True)
        shares = {name: (1.0 if name.endswith("_damping") else SHARE_OF_LOADS) * draw for name, draw in draws}
        varied = {name: float(np.asarray(mean[name])) * (1.0 + self.variation * own) for name, own in shares.items()}
        return {**parameters, **varied}

    def row(
        self,
        count: int,
        effects: Mapping[str, Mapping[str, float]] | None = None,
        open_seconds: float = OPEN_SECONDS,
        **parameters: float,
    ) -> list[LiveStroke]:
        """The next strokes, of a valve at rest before the first: what one leaves, such as heat, the next one has."""
        duration, begin = LEAD + OPEN_SECONDS + CLOSED_SECONDS, self._time
        commands, starts, volts, times = np.array([LEAD, LEAD + open_seconds]), [], [], []
        for index in range(count):
            starts.append(self._time)
            volts.append(np.array([self.levels[(self.strokes + index) % len(self.levels)], 0.0]))
            first = np.ceil(self._time * self.rate) / self.rate - self._time
            times.append(np.arange(first, duration - 1e-9, 1.0 / self.rate))
            self._time += duration
        plant = DeclaredPlant(effects or {}, {**CAMPAIGN_VALVE, **self.parameters, **parameters}, step=STEP)
        shown = plant.simulate(
            np.concatenate([start - begin + commands for start in starts]),
            np.concatenate(volts),
            np.concatenate([start - begin + own for start, own in zip(starts, times, strict=True)]),
        )
        edges = np.cumsum([len(own) for own in times])[:-1]
        positions, currents = np.split(shown.pilot_position, edges), np.split(shown.coil_current, edges)
        self.strokes += count
        return [
            self._stamped(start + commands, own_volts, start + own, position, current)
            for start, own_volts, own, position, current in zip(starts, volts, times, positions, currents, strict=True)
        ]

    def _stamped(
        self, commands: FloatArray, volts: FloatArray, times: FloatArray, position: FloatArray, current: FloatArray
    ) -> LiveStroke:
        """A stroke with noise, and errors of its stamps."""
        white = self._random.standard_normal(len(times))
        noise = np.empty_like(white)
        noise[0] = white[0]
        for index in range(1, len(white)):
            noise[index] = self.colour * noise[index - 1] + np.sqrt(1.0 - self.colour**2) * white[index]
        stamps = commands + self.jitter * self._random.standard_normal(2)
        shown = position + self.noise * noise + self._added(times)
        return LiveStroke(stamps, volts, times + self.offset, shown, current)

    def _added(self, times: FloatArray) -> FloatArray:
        """(n,) m, what drift and hum add to samples of a stroke."""
        each = self.drift * np.sqrt(STROKE_SECONDS * self.rate) / (STROKE_SECONDS * self.rate)
        walk = self._zero + each * np.cumsum(self._of_zero.standard_normal(len(times)))
        self._zero = float(walk[-1])
        return np.asarray(walk + self.hum * np.sin(2.0 * np.pi * MAINS * times + self._phase))

    def rest(self, seconds: float) -> LiveStroke:
        """So long without a command, closed."""
        first = np.ceil(self._time * self.rate) / self.rate
        times = np.arange(first, self._time + seconds - 1e-9, 1.0 / self.rate)
        position = self.noise * self._random.standard_normal(len(times))
        self._time += seconds
        return LiveStroke(np.zeros(0), np.zeros(0), times + self.offset, position, np.zeros(len(times)))


def feed(monitor: Any, stroke: LiveStroke, current: FloatArray | None = None, late: float = 0.0) -> Iterator[Any]:
    """Hand a stroke over as time goes by, with what an ammeter shows, stamped late; yields the reports."""
    edges = np.searchsorted(stroke.times, np.sort(np.concatenate([stroke.command_times, _ticks(stroke)])))
    commands = list(zip(stroke.command_times.tolist(), stroke.volts.tolist(), strict=True))
    for first, stop in zip([0, *edges], [*edges, len(stroke.times)], strict=True):
        while commands and commands[0][0] <= stroke.times[min(first, len(stroke.times) - 1)]:
            yield from monitor.command(*commands.pop(0))
        if current is not None:
            for index in range(first, stop):
                monitor.segmenter.measure_current(float(stroke.times[index]) + late, float(current[index]))
        if stop > first:
            yield from monitor.measure_many(stroke.times[first:stop], stroke.position[first:stop])


def _ticks(stroke: LiveStroke) -> FloatArray:
    return np.arange(stroke.times[0] + BATCH, stroke.times[-1], BATCH)


def hand_over(receiver: Any, commands: Sequence[tuple[float, float]], times: Any, positions: Any) -> Iterator[Any]:
    """Hand samples over one by one, each behind the commands up to it; what the receiver answers to each sample."""
    waiting = list(commands)
    for time, position in zip(np.asarray(times).tolist(), np.asarray(positions).tolist(), strict=True):
        answers = []
        while waiting and waiting[0][0] <= time:
            answers += receiver.command(*waiting.pop(0)) or []
        found = receiver.measure(time, position)
        yield [*answers, *found] if isinstance(found, list) else found
