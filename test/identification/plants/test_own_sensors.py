"""A plant of one's own with the errors of its recordings: a lagging heater, written out here, and its thermometer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from valve_sim.identification.diagnosis.run import Diagnosis, diagnose_plant
from valve_sim.identification.plants.protocol import (
    Array,
    Channel,
    EffectChoice,
    Nuisance,
    Plant,
    Sensor,
    SharedSize,
)
from valve_sim.model import Parameter

INTERVAL, CYCLES, CYCLE = 0.02, 8, 400
NOISE, LOW, SPAN = 0.02, -5.0, 65.0
LEVELS = (20.0, 32.0, 14.0, 38.0, 8.0, 26.0, 36.0, 6.0)
"""W, of the cycles: four seconds on, four off, of which the last are rest."""
SENSOR = Sensor(SPAN, low=LOW, shares={"zero": 5e-3, "scale": 0.02, "bend": 2e-3})
PARAMETERS = {
    "gain": Parameter("gain", "K/W", "K at rest for each watt", 0.0, 100.0, 1.0),
    "time_constant": Parameter("time_constant", "s", "of the warming", 1e-2, 100.0, 0.5),
    "radiation.coefficient": Parameter("coefficient", "1/K", "loss that grows with T²", 0.0, 1.0, 1e-3, off=0.0),
    "dead_band.power": Parameter("power", "W", "that warms nothing", 0.0, 20.0, 0.5, off=0.0),
}


class Lag(Plant):
    """T' = (gain · max(power − dead band, 0) − T − radiation · T²)/time constant, from 0 at the beginning."""

    base = ("gain", "time_constant")
    channels: tuple[Channel, ...] = ()
    varying: Sequence[Nuisance] = ()
    effects: ClassVar = {
        name: EffectChoice(name, (PARAMETERS[free],))
        for name, free in (("radiation", "radiation.coefficient"), ("dead_band", "dead_band.power"))
    }

    def __init__(self, data: Array, sensor: Sensor | None = SENSOR, *, varies: bool = True) -> None:
        self.times, self.power, self.quiet = cycles()
        group = np.arange(CYCLES * CYCLE) // CYCLE
        self.channels = (Channel("made up: T", "temperature", self.times, data, self.quiet, group, "K", drifts=True),)
        self._sensors = {} if sensor is None else {0: sensor}
        self.varying = [varying_gain(cycle) for cycle in range(CYCLES)] if varies else ()

    def sensors(self, values: Mapping[str, float]) -> Mapping[int, Sensor]:
        return self._sensors

    def parameter(self, name: str) -> Parameter:
        return PARAMETERS[name]

    def declared(self, name: str) -> float:
        parameter = PARAMETERS[name]
        return parameter.prior_scale if parameter.off is None else parameter.off

    def predict(self, values: Mapping[str, float]) -> list[Array]:
        value = {name: values.get(name, self.declared(name)) for name in PARAMETERS}
        deviations = [values.get(varying_gain(cycle).name, 0.0) for cycle in range(CYCLES)]
        gains = value["gain"] * (1.0 + np.repeat(deviations, CYCLE))
        shown, warm, step = np.empty(len(self.times)), 0.0, INTERVAL
        heats = np.maximum(self.power - value["dead_band.power"], 0.0) * gains
        for i, heat in enumerate(heats.tolist()):
            shown[i] = warm
            warm += step * (heat - warm - value["radiation.coefficient"] * warm**2) / value["time_constant"]
        return [shown]


def varying_gain(cycle: int) -> Nuisance:
    """By how much the gain differs in a cycle, relative."""
    begin = CYCLE * cycle * INTERVAL
    during = begin, begin + CYCLE * INTERVAL if cycle < CYCLES - 1 else np.inf
    return Nuisance(
        f"stroke_variation[0,{cycle},gain]", 0.05, "–", (0,), during, 1e-4, lower=-0.9, upper=0.9,
        error="stroke_variation", group=SharedSize("gain", 0), number="gain", recording=0, part=cycle,
    )  # fmt: skip


def cycles() -> tuple[Array, Array, np.ndarray]:
    """Times, powers, and where nothing has been warm for some time."""
    place = np.arange(CYCLES * CYCLE) % CYCLE
    power = np.where((place >= 100) & (place < 250), np.repeat(LEVELS, CYCLE), 0.0)
    return np.arange(CYCLES * CYCLE) * INTERVAL, power, place < 90


@dataclass(frozen=True)
class Laboratory:
    """What a laboratory adds: K of zero and bend, a share of gain, K a cycle of drift, and of the gain's variation."""

    zero: float = 0.0
    gain: float = 0.0
    bend: float = 0.0
    drift: float = 0.0
    variation: float = 0.0


def warmed(air: Array) -> Array:
    """The temperature of a sensor that follows that of the air by a time constant of 2 s."""
    found = np.zeros_like(air)
    for i in range(1, len(air)):
        found[i] = found[i - 1] + INTERVAL / 2.0 * (air[i] - found[i - 1])
    return found


def recorded(laboratory: Laboratory, seed: int, *, radiation: float = 0.0) -> tuple[Array, Array]:
    """What is shown, exactly solved over each sample, and (c,) by how much the gain differed in each cycle."""
    random = np.random.default_rng(seed)
    times, power, _ = cycles()
    deviations = laboratory.variation * random.standard_normal(CYCLES)
    true, warm, fine = np.empty(len(times)), 0.0, 20
    for i, heat in enumerate((power * 1.5 * (1.0 + np.repeat(deviations, CYCLE))).tolist()):
        true[i] = warm
        for _ in range(fine):
            middle = warm + 0.5 * INTERVAL / fine * (heat - warm - radiation * warm**2) / 0.4
            warm += INTERVAL / fine * (heat - middle - radiation * middle**2) / 0.4
    share = (true - LOW) / SPAN
    walk = warmed(np.cumsum(random.standard_normal(len(times))) * laboratory.drift / np.sqrt(CYCLE))
    shown = true * (1.0 + laboratory.gain) + 4.0 * laboratory.bend * share * (1.0 - share) + laboratory.zero + walk
    return shown + NOISE * random.standard_normal(len(times)), deviations


def diagnosed(laboratory: Laboratory, seed: int, *, radiation: float = 0.0) -> tuple[Diagnosis, Array]:
    data, deviations = recorded(laboratory, seed, radiation=radiation)
    return diagnose_plant(Lag(data), None), deviations


EVERYTHING = Laboratory(zero=0.4, gain=0.01, bend=0.3, drift=0.05, variation=0.03)
LABORATORIES = [
    Laboratory(),
    Laboratory(zero=0.4),
    Laboratory(gain=0.02),
    Laboratory(bend=0.3),
    Laboratory(drift=0.05),
    Laboratory(variation=0.03),
    EVERYTHING,
]
NAMES = ["nothing", "zero", "gain", "bend", "drift", "variation", "everything"]
EACH = [
    pytest.param(one, id=name, marks=() if name == "everything" else pytest.mark.long)
    for one, name in zip(LABORATORIES, NAMES, strict=True)
]


@pytest.mark.parametrize("laboratory", EACH)
def test_errors_of_a_plant_of_ones_own_are_none_with_their_sizes_in_the_intervals(laboratory: Laboratory) -> None:
    diagnosis, deviations = diagnosed(laboratory, 1)
    assert diagnosis.verdict.kind == "none"
    assert diagnosis.after.intervals["time_constant"].value == pytest.approx(0.41, abs=2e-3)
    (errors,) = diagnosis.recording.values()
    found = {own.error: own for own in errors}
    assert list(found) == ["zero", "drift", "scale", "bend", "stroke_variation"]  # and no mains below 25 Hz
    size = np.sqrt(np.mean(np.square(deviations)))
    true = {"zero": laboratory.zero, "scale": laboratory.gain, "bend": laboratory.bend, "stroke_variation": size}
    for name, one in true.items():
        own = found[name]
        assert own.low <= one <= own.high or (one == 0.0 and not own.is_likely)
        assert own.is_likely or not one or name == "scale"  # the machine's gain is not known, and may be all of it
    assert found["drift"].size == pytest.approx(laboratory.drift, rel=0.5, abs=0.01)


@pytest.mark.parametrize("laboratory", EACH)
def test_what_such_a_plant_lacks_is_named_beside_its_errors(laboratory: Laboratory) -> None:
    diagnosis, _ = diagnosed(laboratory, 1, radiation=1e-3)
    assert (diagnosis.verdict.kind, diagnosis.verdict.effects) == ("effects", ("radiation",))
    found = diagnosis.after.intervals["radiation.coefficient"]
    # Of seven intervals of 95 % one may miss; three errors none should.
    assert abs(found.value - 1e-3) <= 3.0 * found.stderr


@pytest.mark.long
@pytest.mark.parametrize("radiation", [0.0, 1e-3])
def test_without_them_the_plant_is_said_to_lack_something_else(radiation: float) -> None:
    data, _ = recorded(EVERYTHING, 1, radiation=radiation)
    verdict = diagnose_plant(Lag(data, None, varies=False), None).verdict
    assert verdict.kind in ("unknown", "partly")
    assert verdict.unnamed > 0.5


class KnownGain(Lag):
    """Where the machine's gain is known, that of the thermometer is not free to be taken for it."""

    base = ("time_constant",)

    def declared(self, name: str) -> float:
        return 1.5 if name == "gain" else super().declared(name)


@pytest.mark.parametrize("gain", [0.015, -0.015])
def test_a_gain_is_reported_as_a_share_of_what_is_shown_with_its_sign(gain: float) -> None:
    data, _ = recorded(Laboratory(gain=gain), 3)
    (errors,) = diagnose_plant(KnownGain(data, varies=False), None).recording.values()
    (own,) = [one for one in errors if one.error == "scale"]
    assert own.unit == "–"
    assert own.size == pytest.approx(gain, abs=5e-4)
    assert own.probability > 0.99
