"""The cases: what is wrong with which valve and how it is recorded. A family and a seed determine all of it."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from plants.common import Plant
from plants.declared import CAMPAIGN_VALVE, DeclaredPlant
from plants.mismatched import BENCH_VALVE, EFFECTS, MismatchedPlant
from plants.recording import Recorder, Recording, record, single_opening, train_profile
from plants.recording import holdout_profile as other_profile

from benchmarks.campaign.effects import CATALOGUED, UNCATALOGUED, Effects, are_confusable, log_uniform
from benchmarks.campaign.limits import detection_limit, size_at, yardstick
from valve_sim.model import Valve

NOISES: Final[Mapping[str, Recorder]] = {
    "white": Recorder(),
    "coloured": Recorder(colour=0.7),
    "quantised": Recorder(quantisation=5e-6),
    "jitter": Recorder(command_jitter=50e-6),
}
"""1 µm white; AR(1) of 0.7; steps of 5 µm; 50 µs on every command's stamp."""
CLOCK_OFFSET: Final = 30e-6
"""s, standard deviation; drawn for each bag."""
DAMPING_FACTOR: Final = (0.7, 1.5)
"""True over declared damping of plant (a), drawn evenly in the logarithm for each of both."""
LIMITS: Final = (5.0, 40.0)
"""Amplitudes in detection limits, drawn evenly in the logarithm; cut at what is physically sensible."""
MISMATCHED_LIMITS: Final = (20.0, 100.0)
"""The same on plant (b), whose own mismatch must not drown the effect."""
NARROWEST: Final = 1.5
"""Upper over lower end of the amplitudes, where physics would leave less."""
STRONG: Final = (2e-6, 8e-6)
"""m RMS by which uncatalogued effects move the valve after a refit of the dampings."""
WEAK_SHARE: Final = 0.1
"""Amplitude of a weak uncatalogued effect over that of a strong one."""

Numbers = dict[str, float]


@dataclass(frozen=True)
class Case:
    """One valve and its recordings.

    Attributes:
        truth: the effects that are on. amplitudes: in detection limits, or in µm RMS for uncatalogued effects.
        dampings: true ones, N·s/m; empty where the plant has its own.
        noise: one of `NOISES`. clock_offsets: s, of the bags in the order in which they are recorded.
    """

    family: str
    seed: int
    truth: Effects
    amplitudes: Numbers
    dampings: Numbers
    noise: str
    with_current: bool
    clock_offsets: tuple[float, float]
    record_seeds: tuple[int, int]

    @property
    def name(self) -> str:
        """What `--case` takes."""
        return f"{self.family}:{self.seed}"

    @property
    def plant(self) -> Plant:
        """The true valve."""
        if self.family == "mismatched":
            return MismatchedPlant(self.truth)
        return DeclaredPlant(self.truth, self.dampings)

    @property
    def declared(self) -> Valve:
        """What the diagnosis is told of the valve."""
        return declared_valve(BENCH_VALVE if self.family == "mismatched" else CAMPAIGN_VALVE)

    def recorder(self, bag: int) -> Recorder:
        """How a bag, 0 or 1, is recorded."""
        noise = NOISES[self.noise]
        return Recorder(
            colour=noise.colour,
            quantisation=noise.quantisation,
            command_jitter=noise.command_jitter,
            clock_offset=self.clock_offsets[bag],
            with_current=self.with_current,
        )

    def recordings(self) -> tuple[Recording, Recording]:
        """To train on and to hold out; for an opening, the opening and what it is advised to record next."""
        first, second = (
            (single_opening(), train_profile()) if self.family == "opening" else (train_profile(), other_profile())
        )
        return (
            record(self.plant, first, self.recorder(0), self.record_seeds[0]),
            record(self.plant, second, self.recorder(1), self.record_seeds[1]),
        )


def declared_valve(entries: Mapping[str, float | tuple[float, ...]]) -> Valve:
    """The package's valve of a plant's entries."""
    values = {name: list(value) if isinstance(value, tuple) else value for name, value in entries.items()}
    return Valve.from_mapping({"valve": values}, "the campaign")


@dataclass(frozen=True)
class Family:
    """A kind of case.

    Attributes:
        draw: truth and amplitudes of a seed. kinds: over so many seeds every effect takes its turn.
        per_round: cases for each of the campaign's seeds. in_slice: cases of the slice for CI, the quicker ones.
    """

    draw: Callable[[int, np.random.Generator, Recorder], tuple[Effects, Numbers]]
    kinds: int
    per_round: int
    in_slice: tuple[int, ...]


def draw_case(family: str, seed: int) -> Case:
    """The case of a family and a seed."""
    random = np.random.default_rng([zlib.crc32(family.encode()), seed])
    kind, turn = seed % FAMILIES[family].kinds, seed // FAMILIES[family].kinds
    # Over eight turns every effect meets every noise, with current and without.
    noise = list(NOISES)[(kind + turn) % len(NOISES)]
    with_current = (kind + turn // len(NOISES)) % 2 == 1
    dampings = {
        name: float(np.asarray(CAMPAIGN_VALVE[name])) * log_uniform(random, *DAMPING_FACTOR)
        for name in ("pilot_damping", "main_damping")
    }
    offsets = CLOCK_OFFSET * random.standard_normal(2)
    seeds = random.integers(2**31, size=2)
    truth, amplitudes = FAMILIES[family].draw(seed, random, NOISES[noise])
    return Case(
        family,
        seed,
        truth,
        amplitudes,
        {} if family == "mismatched" else dampings,
        noise,
        with_current,
        (float(offsets[0]), float(offsets[1])),
        (int(seeds[0]), int(seeds[1])),
    )


def _catalogued(
    name: str, random: np.random.Generator, recorder: Recorder, limits: tuple[float, float] = LIMITS
) -> tuple[Effects, Numbers]:
    """One effect of an amplitude between so many detection limits."""
    scale = CATALOGUED[name]
    shape, sign = scale.draw_shape(random), scale.draw_sign(random)
    limit = detection_limit(name, shape, recorder)
    low = limits[0] * limit
    size = min(log_uniform(random, low, max(NARROWEST * low, min(limits[1] * limit, scale.largest))), scale.most)
    return {name: scale.parameters(sign * size, shape)}, {name: size / limit}


def _single(seed: int, random: np.random.Generator, recorder: Recorder) -> tuple[Effects, Numbers]:
    return _catalogued(list(CATALOGUED)[seed % len(CATALOGUED)], random, recorder)


def _none(seed: int, random: np.random.Generator, recorder: Recorder) -> tuple[Effects, Numbers]:
    return {}, {}


def _pair(seed: int, random: np.random.Generator, recorder: Recorder) -> tuple[Effects, Numbers]:
    while True:
        first, second = (str(name) for name in random.choice(list(CATALOGUED), 2, replace=False))
        if not are_confusable(first, second):
            break
    effects, amplitudes = _catalogued(first, random, recorder)
    others, other_amplitudes = _catalogued(second, random, recorder)
    return {**effects, **others}, {**amplitudes, **other_amplitudes}


def _uncatalogued(
    seed: int, random: np.random.Generator, recorder: Recorder, share: float = 1.0
) -> tuple[Effects, Numbers]:
    name = list(UNCATALOGUED)[seed % len(UNCATALOGUED)]
    scale = UNCATALOGUED[name]
    shape, sign = scale.draw_shape(random), scale.draw_sign(random)
    moved = log_uniform(random, *STRONG)
    plain = NOISES["white"]
    distance = moved / plain.position_noise * math.sqrt(yardstick(plain).samples)
    size = share * size_at(distance, name, scale, shape, plain, sign)
    return {name: scale.parameters(sign * size, shape)}, {name: share * moved * 1e6}


def _weak(seed: int, random: np.random.Generator, recorder: Recorder) -> tuple[Effects, Numbers]:
    return _uncatalogued(seed, random, recorder, WEAK_SHARE)


def _mismatched(seed: int, random: np.random.Generator, recorder: Recorder) -> tuple[Effects, Numbers]:
    return _catalogued(list(EFFECTS)[seed % len(EFFECTS)], random, recorder, MISMATCHED_LIMITS)


FAMILIES: Final[Mapping[str, Family]] = {
    "single": Family(_single, len(CATALOGUED), len(CATALOGUED), (0, 12, 17, 20)),
    "none": Family(_none, 1, 20, (0, 1, 2, 3)),
    "pair": Family(_pair, 1, 5, (2,)),
    "uncatalogued": Family(_uncatalogued, len(UNCATALOGUED), 5, (5,)),
    "weak": Family(_weak, len(UNCATALOGUED), 5, (2,)),
    "mismatched": Family(_mismatched, len(EFFECTS), 5, (10,)),
    "opening": Family(_single, len(CATALOGUED), 4, (0,)),
}
"""In the order in which they are run and reported."""


def planned(rounds: range, families: tuple[str, ...], *, is_slice: bool) -> list[tuple[str, int]]:
    """Family and seed of every case."""
    return [
        (name, seed)
        for name, family in FAMILIES.items()
        if name in families
        for seed in (
            family.in_slice if is_slice else range(rounds.start * family.per_round, rounds.stop * family.per_round)
        )
    ]
