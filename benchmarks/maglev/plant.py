"""An electromagnet and a ball that moves before it, as a plant: the current that a duty cycle drives through the coil.

    (1)  φ' = supply_current · duty − dead_band − r i − back_emf · z',       φ and i never below 0
    (2)  φ  = time_constant · w + flux of the ball,   i = w + eddy_currents · φ'

φ is the flux linkage over the resistance of the cold coil, in A·s; w the current that makes it, i the current at the
terminals, z the distance from magnet to ball as measured, r the resistance over that of the cold coil. What drives the
current, and the voltage that the bridge's transistors keep for themselves, are given as currents likewise. Of the
declared model all of (2) is φ = time_constant · i: a resistance and a constant inductance.

Motional EMF is φ' while the ball moves: with a flux that grows as it approaches,

    (3)  flux of the ball = f tanh(inductance / (1 + z / gap_length)² · w / f),       f where its iron is saturated

equation (1) is Faraday's law, and the current dips. The gap's reluctance grows with its length and with the area that
the flux spreads over, hence the square; saturation is an effect of its own, off at infinite f.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numba import njit

from benchmarks.maglev.records import Array, MagnetRecord
from valve_sim.identification.plants.advice import Advice
from valve_sim.identification.plants.protocol import (
    Channel,
    EffectChoice,
    Experiment,
    ForceMap,
    Nuisance,
    Sensor,
)
from valve_sim.identification.plants.variation import group_factors, group_variations
from valve_sim.model import Parameter

REST, BEFORE, AFTER = 1.5, 0.5, 0.5
"""s: before a jump from which on the current is compared, and up to which the ball rests; after it, to the end."""
SUBSTEPS: Final = 3
"""Steps from one sample to the next; with ten the current differs by less than 0.2 mA."""
COPPER: Final = 0.00393
"""1/K, by which the resistance of copper grows."""

DEAD_BAND: Final = Nuisance(
    "dead_band", 0.01, "A", step=1e-4, mean=0.145, lower=0.0, is_of_machine=True, same_as="duty_offset.current"
)
"""What the transistors keep: 0.56 V by the owners' voltmeter over 4.17 Ω, and 10 mA that leak where the duty cycle is 0
and are taken off with the sensor's zero."""
TIME_CONSTANT: Final = Nuisance("time_constant", 0.003, "s", step=1e-5, mean=0.0287, lower=1e-3, is_of_machine=True)
"""Inductance over resistance without the ball: a step with the ball 20 mm away rises so; it falls 4 ms faster."""
DECLARED: Final = {nuisance.name: nuisance for nuisance in (DEAD_BAND, TIME_CONSTANT)}
BASE: Final = {
    "supply_current": Parameter(
        "supply_current", "A", "current at a duty cycle of 1, but for the dead band", 0.1, 100.0, 2.8
    ),
}
"""Declared by its prior scale: 11.66 V by the owners' voltmeter over 4.17 Ω."""
VARIES: Final = "supply_current"
"""What varies from record to record: the current at full voltage, as a warmer coil and the mains let it."""
EFFECTS: Final = {
    "motional_emf": (
        Parameter("inductance", "s", "what inductance over resistance gains up to contact", 0.0, 1.0, 0.01, off=0.0),
        Parameter("gap_length", "m", "distance at which a quarter of that is left", 5e-4, 0.1, 5e-3),
    ),
    "magnetic_saturation": (
        Parameter("flux", "A·s", "largest flux linkage of the ball over resistance", 1e-3, 1e3, 0.02, off=math.inf),
    ),
    "eddy_currents": (
        Parameter("ratio", "–", "resistance of the coil over that of the eddy currents' path", 0.0, 1.0, 0.05, off=0.0),
    ),
    "coil_heating": (
        Parameter("temperature_rate", "K/(A²·s)", "warming of the coil", 0.0, 100.0, 1.0, off=0.0),
        Parameter("cooling_time_constant", "s", "of the coil", 0.1, 1e4, 30.0),
    ),
    "back_emf": (
        Parameter("constant", "A·s/m", "counter-voltage over resistance for each m/s", -10.0, 10.0, 0.1, off=0.0),
    ),
    "duty_offset": (
        Parameter("current", "A", "what an offset of the duty cycle adds to the current", -1.0, 1.0, 0.01, off=0.0),
    ),
}  # fmt: skip
"""What the magnet may lack, each with its parameters."""
LOOK_ALIKES: Final = {
    "motional_emf": ("back_emf",),
    "back_emf": ("motional_emf",),
}
PARAMETERS: Final = BASE | {
    f"{effect}.{parameter.name}": parameter for effect, parameters in EFFECTS.items() for parameter in parameters
}


class Magnet(NamedTuple):
    """Values of one magnet, as (1) to (3) call them."""

    supply_current: float
    dead_band: float
    time_constant: float
    inductance: float
    gap_length: float
    ball_flux: float
    eddy_ratio: float
    temperature_rate: float
    cooling_time_constant: float
    back_emf: float

    @classmethod
    def of(cls, values: Mapping[str, float]) -> Magnet:
        """From freed parameters and nuisances by name; the rest is as declared."""

        def value(name: str) -> float:
            return float(values.get(name, PARAMETERS[name].neutral))

        def declared(name: str) -> float:
            return float(values.get(name, DECLARED[name].mean))

        return cls(
            value("supply_current"), declared("dead_band") - value("duty_offset.current"),
            declared("time_constant"), value("motional_emf.inductance"), value("motional_emf.gap_length"),
            value("magnetic_saturation.flux"), value("eddy_currents.ratio"),
            value("coil_heating.temperature_rate"), value("coil_heating.cooling_time_constant"),
            value("back_emf.constant"),
        )  # fmt: skip


class MagnetPlant:
    """The magnet behind one or several records; each is a recording of one stroke.

    Args:
        records: of one magnet. One with a jump is compared around it, one without from its first step on.
        sensor: the errors of the current; None: there are none.
        variation: scale of the prior of how much `VARIES` varies from record to record; 0: it does not.
    """

    base: Sequence[str] = tuple(BASE)
    nuisances: Sequence[Nuisance] = tuple(DECLARED.values())
    timing_errors: Sequence[Nuisance] = ()
    force_maps: Sequence[ForceMap] = ()
    experiments: Sequence[Experiment] = ()
    effects: Mapping[str, EffectChoice] = {
        name: EffectChoice(name, parameters, LOOK_ALIKES.get(name, ())) for name, parameters in EFFECTS.items()
    }
    advice = Advice(
        "one jump cannot tell a flux that saturates from one that decays",
        "Record next: jumps from at least four distances",
        "Record next: jumps from distances not used yet",
    )

    def __init__(self, records: Sequence[MagnetRecord], sensor: Sensor | None = None, variation: float = 0.0) -> None:
        self.records = tuple(records)
        self._spans = [compared(record) for record in records]
        self.channels: Sequence[Channel] = tuple(
            _channel(record, span, number)
            for number, (record, span) in enumerate(zip(records, self._spans, strict=True))
        )
        self._sensors = {} if sensor is None else dict.fromkeys(range(len(records)), sensor)
        self.varying: Sequence[Nuisance] = (
            group_variations(self.channels, {VARIES: variation}) if variation > 0.0 else ()
        )

    def sensors(self, values: Mapping[str, float]) -> Mapping[int, Sensor]:
        """That of the current, the same for each record, where its errors were said."""
        return self._sensors

    def parameter(self, name: str) -> Parameter:
        """Unit and range of a declared value or `<effect>.<parameter>`.

        Raises:
            KeyError: there is none.
        """
        return PARAMETERS[name]

    def declared(self, name: str) -> float:
        """The declared value, or the value at which an effect changes nothing."""
        return PARAMETERS[name].neutral

    def predict(self, values: Mapping[str, float]) -> list[Array]:
        """The current, A, at each channel's times: (1) from the beginning of the record on, where there is none."""
        magnet = Magnet.of(values)
        shown = []
        for record, span, channel in zip(self.records, self._spans, self.channels, strict=True):
            factor = float(group_factors(channel, VARIES, values)[0])
            own = magnet._replace(supply_current=factor * magnet.supply_current)
            shown.append(_current(own, record.duty[: span.stop], record.distance[: span.stop], record.interval)[span])
        return shown


def compared(record: MagnetRecord) -> slice:
    """Which samples of a record are compared."""
    if record.jump is None:
        return slice(0, len(record.times))
    rest, after = round(REST / record.interval), round(AFTER / record.interval)
    return slice(max(0, record.jump - rest), min(len(record.times), record.jump + after))


def _channel(record: MagnetRecord, span: slice, number: int) -> Channel:
    """The current of one record. It rises with the duty cycle while the ball rests, and that drift is no noise."""
    times = record.times[span]
    rests = np.zeros(len(times), dtype=bool)
    if record.jump is not None:
        rests = times < record.times[record.jump] - BEFORE
    group = np.zeros(len(times), dtype=np.int64)
    return Channel(
        f"{record.source}: current", "current", times, record.current[span], rests, group, "A", recording=number,
        drifts=True,
    )  # fmt: skip


@njit(cache=True)
def _flux(magnet, nearness, w):  # type: ignore[no-untyped-def]
    """(2) and (3): the flux at a current, and its derivative."""
    inductance = magnet.inductance * nearness
    ball = inductance * w
    if ball > 0.0 and magnet.ball_flux < math.inf:
        full = math.tanh(ball / magnet.ball_flux)
        ball, inductance = magnet.ball_flux * full, inductance * (1.0 - full * full)
    return magnet.time_constant * w + ball, magnet.time_constant + inductance


@njit(cache=True)
def _current_at(magnet, nearness, share, known, w):  # type: ignore[no-untyped-def]
    """The w > 0 at which flux + share · w = known, by Newton's steps from a near w; 0 where there is none."""
    if known <= 0.0:
        return 0.0
    for _ in range(20):
        flux, slope = _flux(magnet, nearness, w)
        step = (flux + share * w - known) / (slope + share)
        w = max(w - step, 0.0)
        if abs(step) < 1e-9:
            break
    return w


@njit(cache=True)
def _current(magnet, duty, distance, interval):  # type: ignore[no-untyped-def]
    """(n,) A: (1) by the trapezoidal rule; distance is linear between samples, and the duty cycle held."""
    current = np.zeros(len(duty))
    h = interval / SUBSTEPS
    flux, w, warm = 0.0, 0.0, 0.0
    for n in range(1, len(duty)):
        resistance = 1.0 + COPPER * warm
        loss = 1.0 + resistance * magnet.eddy_ratio
        speed = (distance[n] - distance[n - 1]) / interval
        drive = magnet.supply_current * duty[n - 1] - magnet.dead_band - magnet.back_emf * speed
        for m in range(SUBSTEPS):
            z = distance[n - 1] + (m + 1) / SUBSTEPS * (distance[n] - distance[n - 1])
            nearness = 1.0 / (1.0 + z / magnet.gap_length) ** 2
            share = 0.5 * h * resistance / loss
            known = flux + h * drive / loss - share * w
            w = _current_at(magnet, nearness, share, known, w)
            flux = max(known - share * w, 0.0)
            warm += h * (magnet.temperature_rate * w * w - warm / magnet.cooling_time_constant)
        change = (drive - resistance * w) / loss if flux > 0.0 else 0.0
        current[n] = max(w + magnet.eddy_ratio * change, 0.0)
    return current
