"""Recordings as laboratories make them: what sensor, mount, source and clocks add to the truth of plant (a).

Everything here is written from the physics of the apparatus, and nothing comes from the package:

- The position sensor warms up and cools down with the air: an Ornstein-Uhlenbeck air temperature passes the wall of its
  housing, a first-order lag, and moves the zero. The zero is set at the first sample.
- Its mount is an oscillator of one degree of freedom. A plunger that comes to rest at the stop, at the main seat or at
  its seat gives its momentum to the body, which kicks the mount. A pick-up is between the plungers and kicks nothing.
- Its reading is a projective function of the position where its beam is tilted, a cubic where its lens distorts, both
  with the ends of the travel in place; its gain is off; its interpolation is off by a sine of the position.
- Hum of the mains and noise come on top, then a moving average, then what electronics do: spikes, the end of the range,
  steps, values that are held, and codes of no reading.
- The source's resistance lowers the voltage at the coil's terminals while the driver is on, by the current that flows.
- Every stroke has its own dampings, seat load and preload, as friction and gas do not repeat.

The sensors of both plungers are alike, with noise, drift, phases and outliers of their own, on one mount.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal

import numpy as np
from scipy.signal import lfilter

from .common import FloatArray, PlantEvent, PlantRun
from .declared import COPPER, DeclaredPlant
from .recording import SAMPLE_RATE, Profile, Recording
from .tolerances import Entries

Effects = Mapping[str, Mapping[str, float]]

STROKE_PERIOD = 60e-3
"""s from stroke to stroke of the training profile; the time in which the zero drifts by as much as is asked for."""
AIR_TIME_CONSTANT = 0.5
"""s, of the fluctuations of the air's temperature: over a recording's strokes the zero wanders freely."""
WALL_TIME_CONSTANT = 0.05
"""s, of the housing's wall: within a stroke the zero moves along a ramp."""
HUM_SHARES = {1: 1.0, 3: 0.4, 5: 0.2}
"""Amplitude of the mains' harmonics over that of the fundamental: odd ones, as a rectifier's load makes them."""
IMPACT = 0.3
"""m/s: an impact of the moving mass at this speed makes the mount ring with the amplitude that is asked for."""
SUPPLY_STEP = 20e-6
"""s, of the voltage at the terminals: a fiftieth of the coil's time constant."""
SHARE_OF_LOADS = 1.0 / 3.0
"""Relative variation of seat load and preload over that of the dampings."""
LEAST_FACTOR = 0.1
"""No stroke's damping, load or preload is a smaller share of the mean one."""
DROPOUT_CODE = 32.767e-3
"""m: the largest signed 16-bit integer in µm, which sensors give for no reading."""
SPIKES = (0.5, 1.5)
"""Range of a spike's size over that asked for, drawn evenly, of either sign."""

REPEATABLE = ("pilot_damping", "main_damping", "seat_load", "spring_preload")
"""Entries of a valve that differ from stroke to stroke; the order in which they are drawn."""
PILOT, MAIN = 0, 1
"""The two position sensors."""


class _Source(IntEnum):
    """What random numbers are drawn for, each by a generator of its own."""

    NOISE = 0
    FLICKER = 1
    DRIFT = 2
    HUM = 3
    RINGING = 4
    SPIKES = 6
    HELD = 7
    DROPOUTS = 8
    COMMANDS = 9
    STROKES = 10
    CURRENT = 11


@dataclass(frozen=True)
class Laboratory:
    """What measuring and driving add to a valve; the default is 1 µm of white noise and nothing else. SI units.

    Attributes:
        position_noise: standard deviation of the noise, m. colour: its AR(1) coefficient, which leaves that alone.
        flicker: m RMS of 1/f noise, from one over the recording's length to half the sample rate.
        quantisation: m, the step of the readings. sample_rate: Hz.
        with_current, current_noise: whether the current is recorded, and its white noise, A.
        drift: standard deviation of the zero's change within `STROKE_PERIOD`, m.
        hum: amplitude of the fundamental, m. hum_frequency: Hz.
        ringing: amplitude of the mount for an impact of the moving mass at 0.3 m/s, m. ringing_frequency: Hz.
        ringing_damping: ratio to the critical one. ringing_scatter: relative standard deviation of each impulse.
        scale: relative error of the gain. bend: peak of the error of linearity over the travel, m.
        bend_shape: "bow" of a tilted beam, or "s" of a lens that distorts.
        outliers: spikes a second. outlier_size: m. dropouts: codes of no reading a second.
        held: share of the samples that repeat the one before.
        clipping: length of the end of the travel that lies beyond the range, m; readings stand at the range's end.
        averaging: samples in the sensor's moving average, up to the present one; its noise passes it, too.
        supply_resistance: of the source, in series with the coil while the driver is on, Ω.
        clock_rate: by which the clock of the commands runs faster than that of the samples, relative.
        clock_offset: by which the stamps of commands are late, s. command_jitter: standard deviation of each stamp, s.
        stroke_variation: relative standard deviation of both dampings from stroke to stroke, each drawn for itself;
            seat load and preload vary by a third of it.
        trend: relative growth of the main damping from the first to the last stroke, about its mean.
    """

    position_noise: float = 1e-6
    colour: float = 0.0
    flicker: float = 0.0
    quantisation: float = 0.0
    sample_rate: float = SAMPLE_RATE
    with_current: bool = False
    current_noise: float = 1e-3
    drift: float = 0.0
    hum: float = 0.0
    hum_frequency: float = 50.0
    ringing: float = 0.0
    ringing_frequency: float = 800.0
    ringing_damping: float = 0.1
    ringing_scatter: float = 0.0
    scale: float = 0.0
    bend: float = 0.0
    bend_shape: Literal["bow", "s"] = "bow"
    outliers: float = 0.0
    outlier_size: float = 50e-6
    dropouts: float = 0.0
    held: float = 0.0
    clipping: float = 0.0
    averaging: int = 1
    supply_resistance: float = 0.0
    clock_rate: float = 0.0
    clock_offset: float = 0.0
    command_jitter: float = 0.0
    stroke_variation: float = 0.0
    trend: float = 0.0


IMPERFECTIONS: dict[str, tuple[Laboratory, Laboratory, Laboratory]] = {
    "drift": (Laboratory(drift=1e-6), Laboratory(drift=4e-6), Laboratory(drift=15e-6)),
    "hum": (Laboratory(hum=0.3e-6), Laboratory(hum=1e-6, hum_frequency=60.0), Laboratory(hum=3e-6)),
    "colour": (Laboratory(colour=0.5), Laboratory(colour=0.9), Laboratory(flicker=1e-6)),
    # Decay within 2, 3.2 and 1.3 ms.
    "ringing": (
        Laboratory(ringing=1.5e-6, ringing_frequency=800.0, ringing_damping=0.1),
        Laboratory(ringing=3e-6, ringing_frequency=2500.0, ringing_damping=0.02),
        Laboratory(ringing=6e-6, ringing_frequency=400.0, ringing_damping=0.3),
    ),
    "scale": (Laboratory(scale=0.5e-3), Laboratory(scale=-2e-3), Laboratory(scale=5e-3)),
    "bend": (Laboratory(bend=0.3e-6), Laboratory(bend=1e-6), Laboratory(bend=3e-6, bend_shape="s")),
    "supply": (
        Laboratory(supply_resistance=0.05),
        Laboratory(supply_resistance=0.2),
        Laboratory(supply_resistance=0.5),
    ),
    "stroke_variation": (
        Laboratory(stroke_variation=0.03),
        Laboratory(stroke_variation=0.08),
        Laboratory(stroke_variation=0.15),
    ),
    "clock_rate": (Laboratory(clock_rate=50e-6), Laboratory(clock_rate=-100e-6), Laboratory(clock_rate=200e-6)),
    "command_stamps": (
        Laboratory(command_jitter=30e-6),
        Laboratory(command_jitter=100e-6),
        Laboratory(command_jitter=300e-6),
    ),
    "outliers": (
        Laboratory(outliers=1.0, dropouts=4.0),
        Laboratory(outliers=5.0, dropouts=4.0),
        Laboratory(outliers=20.0, dropouts=4.0),
    ),
    "clipping": (Laboratory(clipping=2e-6), Laboratory(clipping=5e-6), Laboratory(clipping=10e-6)),
    "averaging": (Laboratory(averaging=2), Laboratory(averaging=4), Laboratory(averaging=8)),
    "quantisation": (Laboratory(quantisation=1e-6), Laboratory(quantisation=3e-6), Laboratory(quantisation=5e-6)),
}
"""One imperfection each, small, middle and large, beside 1 µm of white noise."""

LOW_RATES: dict[str, Laboratory] = {
    "1 kHz": Laboratory(sample_rate=1e3),
    "2 kHz": Laboratory(sample_rate=2e3),
    "2 kHz, coarse": Laboratory(sample_rate=2e3, quantisation=3e-6, supply_resistance=0.3, stroke_variation=0.15),
}
"""Slow sensors, as data loggers have them."""

LABORATORIES: dict[str, Laboratory] = {
    "good bench": Laboratory(position_noise=0.2e-6, drift=0.5e-6, hum=0.2e-6),
    "ringing mount": Laboratory(
        position_noise=0.5e-6,
        ringing=4e-6,
        ringing_frequency=1100.0,
        ringing_damping=0.07,
        ringing_scatter=0.4,
        drift=1e-6,
        hum=0.3e-6,
    ),
    "workshop": Laboratory(
        sample_rate=2e3,
        quantisation=3e-6,
        supply_resistance=0.3,
        stroke_variation=0.15,
        drift=3e-6,
        command_jitter=50e-6,
    ),
    "old laser": Laboratory(
        position_noise=0.5e-6,
        flicker=1e-6,
        outliers=5.0,
        dropouts=4.0,
        held=2e-4,
        bend=2e-6,
        bend_shape="s",
        scale=1e-3,
        drift=5e-6,
    ),
    "station": Laboratory(
        command_jitter=80e-6,
        clock_rate=100e-6,
        supply_resistance=0.1,
        stroke_variation=0.05,
        hum=1e-6,
        trend=0.1,
    ),
}
"""Whole laboratories, where everything comes together."""


def true_sizes(laboratory: Laboratory) -> dict[str, float]:
    """The size of each error that a diagnosis estimates, by the names that it gives them; SI units, 0 where it is off.

    Hum is the root of the sum of the squares of its harmonics' amplitudes, m; ringing is for 0.3 m/s of the moving
    mass, m; bend is its peak, m; supply in Ω; scale, stroke_variation and clock_rate are relative; command_stamps in s.
    """
    return {
        "drift": laboratory.drift,
        "hum": laboratory.hum * float(np.linalg.norm(list(HUM_SHARES.values()))),
        "ringing": laboratory.ringing,
        "scale": laboratory.scale,
        "bend": laboratory.bend,
        "supply": laboratory.supply_resistance,
        "stroke_variation": laboratory.stroke_variation,
        "clock_rate": laboratory.clock_rate,
        "command_stamps": laboratory.command_jitter,
    }


def drift_over_strokes(laboratory: Laboratory, recording: Recording, seed: int) -> float:
    """Root mean square by which the zero of the pilot's sensor has changed from release to release, m."""
    drift = _drift(recording.times.size, laboratory, _random(seed, _Source.DRIFT, PILOT))
    releases = recording.command_times[recording.volts == 0.0]
    places = np.interp([recording.times[0], *releases], recording.times, drift)
    return float(np.sqrt(np.mean(np.square(np.diff(places)))))


def measure(valve: Entries, effects: Effects, profile: Profile, laboratory: Laboratory, seed: int) -> Recording:
    """Drive a valve of these entries and effects through the profile in a laboratory; a seed determines all of it.

    `truth` is what the valve did: an ideal sensor's positions in the strokes and at the voltage that there were.
    """
    times = np.arange(round(profile.duration * laboratory.sample_rate)) / laboratory.sample_rate
    driven = profile
    if laboratory.supply_resistance > 0.0:
        driven = _at_the_terminals(profile, laboratory.supply_resistance, valve, effects)
    truth = _merged(times, _strokes(valve, effects, profile, driven, times, laboratory, seed))
    mount = _mount(truth.events, times, valve, effects, laboratory, seed)
    stroke = _number(valve, "stroke") + effects.get("stroke_offset", {}).get("offset", 0.0)
    gap = _number(valve, "pilot_gap") + effects.get("gap_offset", {}).get("offset", 0.0)
    gain = effects.get("sensor_gain", {}).get("gain", 1.0)
    jitter = _random(seed, _Source.COMMANDS).standard_normal(profile.times.size)
    stamps = profile.times * (1.0 + laboratory.clock_rate) + laboratory.clock_offset
    noise = _random(seed, _Source.CURRENT).standard_normal(times.size)
    return Recording(
        stamps + laboratory.command_jitter * jitter,
        profile.volts,
        times,
        _read(truth.pilot_position - mount, gain * stroke, PILOT, laboratory, seed),
        _read(truth.main_position - mount, gain * (stroke - gap), MAIN, laboratory, seed),
        truth.coil_current + laboratory.current_noise * noise if laboratory.with_current else None,
        profile.times,
        truth,
    )


def _random(seed: int, source: _Source, sensor: int = PILOT) -> np.random.Generator:
    """The generator of one source of errors: no other draws from it."""
    return np.random.default_rng([seed, int(source), sensor])


def _number(entries: Entries, name: str) -> float:
    return float(np.asarray(entries[name]))


# --- the valve as it is driven ---------------------------------------------------------------------------------------


def _at_the_terminals(profile: Profile, resistance: float, valve: Entries, effects: Effects) -> Profile:
    """The voltage at the coil's terminals, in steps: that of the source less its drop by the current that flows.

    The circuit is linear but for the copper's warming: (R + R_s) i + L di/dt = V, with R_s while the driver is on.
    """
    gain = effects.get("drive_gain", {}).get("gain", 1.0)
    heating = effects.get("coil_heating", {})
    warming = heating.get("temperature_rate", 0.0)
    cooling = 1.0 / heating.get("cooling_time_constant", np.inf)
    lag = _number(valve, "coil_time_constant") + effects.get("coil_lag", {}).get("time_constant", 0.0)
    rated = _number(valve, "reference_voltage")
    share = resistance / _number(valve, "coil_resistance")
    times: list[float] = []
    volts: list[float] = []
    current = temperature = 0.0  # relative to the rated one, and K
    for start, end, level in zip(profile.times, [*profile.times[1:], profile.duration], profile.volts, strict=True):
        is_on = level != 0.0
        steps = max(1, round((end - start) / SUPPLY_STEP))
        step = (end - start) / steps
        if not is_on:
            times.append(start)
            volts.append(0.0)
        for index in range(steps):
            load = 1.0 + COPPER * temperature + (share if is_on else 0.0)
            final = gain * level / rated / load
            half = np.exp(-0.5 * step * load / lag) if lag > 0.0 else 0.0
            middle = final + (current - final) * half
            if is_on:
                times.append(start + index * step)
                # The plant multiplies what it is given by the gain, the source's drop is behind that.
                volts.append(level - share * rated * middle / gain)
            current = final + (current - final) * half**2
            temperature += step * (warming * middle**2 - cooling * temperature)
    return Profile(np.array(times), np.array(volts), profile.duration)


def _strokes(
    valve: Entries,
    effects: Effects,
    profile: Profile,
    driven: Profile,
    times: FloatArray,
    laboratory: Laboratory,
    seed: int,
) -> Iterator[tuple[PlantRun, float, float]]:
    """For each stroke a run of the whole recording up to its end by the valve of that stroke, and its begin and end, s.

    A stroke begins where the voltage rises from 0. The valve is closed there, whatever its dampings were, and the
    strokes before have warmed and magnetised it as they do any valve.
    """
    if laboratory.stroke_variation == 0.0 and laboratory.trend == 0.0:
        yield DeclaredPlant(effects, valve).simulate(driven.times, driven.volts, times), -np.inf, np.inf
        return
    rises = (profile.volts != 0.0) & (np.concatenate([[0.0], profile.volts[:-1]]) == 0.0)
    begins = np.concatenate([[-np.inf], profile.times[rises][1:]])
    ends = np.concatenate([begins[1:], [np.inf]])
    draws = _random(seed, _Source.STROKES).standard_normal((begins.size, len(REPEATABLE)))
    grown = np.linspace(-0.5, 0.5, begins.size) if begins.size > 1 else np.zeros(1)
    for begin, end, draw, growth in zip(begins.tolist(), ends.tolist(), draws, grown, strict=True):
        entries = dict(valve)
        for name, deviation in zip(REPEATABLE, draw, strict=True):
            share = 1.0 if name.endswith("_damping") else SHARE_OF_LOADS
            factor = 1.0 + share * laboratory.stroke_variation * deviation
            if name == "main_damping":
                factor *= 1.0 + laboratory.trend * growth
            entries[name] = max(LEAST_FACTOR, factor) * _number(valve, name)
        given = driven.times < end
        plant = DeclaredPlant(effects, entries)
        yield plant.simulate(driven.times[given], driven.volts[given], times[times < end]), begin, end


def _merged(times: FloatArray, strokes: Iterator[tuple[PlantRun, float, float]]) -> PlantRun:
    """One run of the samples and events of each stroke."""
    columns: list[list[FloatArray]] = [[], [], [], []]
    events: list[PlantEvent] = []
    for run, begin, end in strokes:
        inside = (run.time >= begin) & (run.time < end)
        values = (run.pilot_position, run.main_position, run.pilot_velocity, run.coil_current)
        for column, own in zip(columns, values, strict=True):
            column.append(own[inside])
        events += [event for event in run.events if begin <= event.time < end]
    pilot, main, velocity, current = (np.concatenate(column) for column in columns)
    return PlantRun(times, pilot, main, velocity, current, tuple(events))


# --- the mount -------------------------------------------------------------------------------------------------------


def _mount(
    events: tuple[PlantEvent, ...],
    times: FloatArray,
    valve: Entries,
    effects: Effects,
    laboratory: Laboratory,
    seed: int,
) -> FloatArray:
    """Displacement of the sensor's mount, m: an oscillator that each contact with the body has kicked."""
    moved = np.zeros(times.size)
    if laboratory.ringing == 0.0:
        return moved
    random = _random(seed, _Source.RINGING)
    # A sensor that is late shows its mount late, too.
    delay = effects.get("sensor_delay", {}).get("delay", 0.0)
    full = _number(valve, "moving_mass") * IMPACT
    free = 2.0 * np.pi * laboratory.ringing_frequency
    damped = free * np.sqrt(1.0 - laboratory.ringing_damping**2)
    for event in events:
        lost = _lost_momentum(event, valve, effects)
        if lost == 0.0:
            continue
        kick = lost / full * (1.0 + laboratory.ringing_scatter * random.standard_normal())
        since = times - event.time - delay
        after = since >= 0.0
        decay = np.exp(-laboratory.ringing_damping * free * since[after])
        moved[after] += laboratory.ringing * kick * decay * np.sin(damped * since[after])
    return moved


def _lost_momentum(event: PlantEvent, valve: Entries, effects: Effects) -> float:
    """What a contact gives to the body, N·s; upwards at the stop, downwards at the seats."""
    pilot, moving = _number(valve, "pilot_mass"), _number(valve, "moving_mass")
    bounce = effects.get("stop_bounce", {})
    masses = {
        "opened": moving,
        "stop_rebound": moving * (1.0 + bounce.get("restitution_stop", 0.0)),
        "main_seated": moving - pilot,
        "seated": pilot,
        "seat_rebound": pilot * (1.0 + bounce.get("restitution_seat", 0.0)),
    }
    return masses.get(event.kind, 0.0) * event.velocity


# --- the sensor ------------------------------------------------------------------------------------------------------


def _read(seen: FloatArray, travel: float, sensor: int, laboratory: Laboratory, seed: int) -> FloatArray:
    """Readings, m, (n,), of what a sensor has before it, whose travel ends at so many m."""
    count = seen.size
    readings = _bent(seen, travel, laboratory) * (1.0 + laboratory.scale)
    if laboratory.drift > 0.0:
        readings = readings + _drift(count, laboratory, _random(seed, _Source.DRIFT, sensor))
    if laboratory.hum > 0.0:
        readings = readings + _hum(count, laboratory, _random(seed, _Source.HUM, sensor))
    readings = readings + _noise(count, laboratory, _random(seed, _Source.NOISE, sensor))
    if laboratory.flicker > 0.0:
        readings = readings + laboratory.flicker * _flicker(count, _random(seed, _Source.FLICKER, sensor))
    return _converted(_averaged(readings, laboratory.averaging), travel, sensor, laboratory, seed)


def _bent(x: FloatArray, travel: float, laboratory: Laboratory) -> FloatArray:
    """Positions by a scale that is not even, but right at both ends of the travel."""
    if laboratory.bend == 0.0:
        return x
    peak = laboratory.bend / travel
    share = x / travel
    if laboratory.bend_shape == "bow":
        # s (1 + a) / (1 + a s) misses s by (√(1 + a) - 1)²/a at most.
        ratio = (1.0 + peak) / (1.0 - peak)
        tilt = ratio**2 - 1.0
        return travel * share * (1.0 + tilt) / (1.0 + tilt * share)
    # h (1 + k h²) / (1 + k/4), from the middle of the travel, misses h by k/(1 + k/4)/(12 √3) at most.
    distortion = 12.0 * np.sqrt(3.0) * peak
    cubic = distortion / (1.0 - distortion / 4.0)
    middle = share - 0.5
    bent: FloatArray = travel * (0.5 + middle * (1.0 + cubic * middle**2) / (1.0 + cubic / 4.0))
    return bent


def _drift(count: int, laboratory: Laboratory, random: np.random.Generator) -> FloatArray:
    """The zero, m, as the temperature behind a wall moves it; 0 at the first sample."""
    step = 1.0 / laboratory.sample_rate
    settling = round(5.0 * AIR_TIME_CONSTANT * laboratory.sample_rate)
    kept = np.exp(-step / AIR_TIME_CONSTANT)
    air = lfilter([np.sqrt(1.0 - kept**2)], [1.0, -kept], random.standard_normal(settling + count))
    passed = 1.0 - np.exp(-step / WALL_TIME_CONSTANT)
    inside = lfilter([0.5 * passed, 0.5 * passed], [1.0, passed - 1.0], air)[settling:]
    # Of two lags in series: variance behind the second one, and correlation over a stroke.
    variance = AIR_TIME_CONSTANT / (AIR_TIME_CONSTANT + WALL_TIME_CONSTANT)
    lags = np.array([AIR_TIME_CONSTANT, -WALL_TIME_CONSTANT])
    correlation = lags @ np.exp(-STROKE_PERIOD / np.abs(lags)) / lags.sum()
    change = np.sqrt(2.0 * variance * (1.0 - correlation))
    drift: FloatArray = laboratory.drift / change * (inside - inside[0])
    return drift


def _hum(count: int, laboratory: Laboratory, random: np.random.Generator) -> FloatArray:
    """The mains and their harmonics, m, with steady phases."""
    turns = 2.0 * np.pi * laboratory.hum_frequency / laboratory.sample_rate * np.arange(count)
    hum: FloatArray = np.zeros(count)
    for harmonic, share in HUM_SHARES.items():
        hum += laboratory.hum * share * np.sin(harmonic * turns + random.uniform(0.0, 2.0 * np.pi))
    return hum


def _noise(count: int, laboratory: Laboratory, random: np.random.Generator) -> FloatArray:
    """White noise, m, or stationary AR(1) noise of the same standard deviation."""
    drawn = random.standard_normal(count)
    if laboratory.colour != 0.0:
        drawn[1:] *= np.sqrt(1.0 - laboratory.colour**2)
        drawn = lfilter([1.0], [1.0, -laboratory.colour], drawn)
    return laboratory.position_noise * drawn


def _flicker(count: int, random: np.random.Generator) -> FloatArray:
    """1/f noise of unit power from one over its length to half the sample rate, as a piece of a longer one."""
    pieces = 4
    amplitudes = np.zeros(pieces * count // 2 + 1)
    amplitudes[pieces:] = 1.0 / np.sqrt(np.arange(pieces, amplitudes.size))
    phasors = random.standard_normal(amplitudes.size) + 1j * random.standard_normal(amplitudes.size)
    whole = np.fft.irfft(amplitudes * phasors, pieces * count) * (pieces * count)
    # Each component has the power 4 a², but the last one, which has but a cosine.
    power = 4.0 * np.sum(np.square(amplitudes))
    return np.asarray(whole[:count] / np.sqrt(power), dtype=np.float64)


def _averaged(readings: FloatArray, samples: int) -> FloatArray:
    """Means of so many samples up to the present one; of fewer in the beginning."""
    if samples == 1:
        return readings
    sums = np.concatenate([[0.0], np.cumsum(readings)])
    last = np.arange(1, readings.size + 1)
    first = np.maximum(0, last - samples)
    return np.asarray((sums[last] - sums[first]) / (last - first), dtype=np.float64)


def _converted(analogue: FloatArray, travel: float, sensor: int, laboratory: Laboratory, seed: int) -> FloatArray:
    """What comes out of the electronics, m: spikes, the range's end, steps, held values and codes of no reading."""
    readings = analogue.copy()
    count = readings.size
    random = _random(seed, _Source.SPIKES, sensor)
    struck = random.random(count) < laboratory.outliers / laboratory.sample_rate
    signs = np.where(random.random(count) < 0.5, -1.0, 1.0)
    readings += struck * signs * laboratory.outlier_size * random.uniform(*SPIKES, count)
    if laboratory.clipping > 0.0:
        readings = np.minimum(readings, travel - laboratory.clipping)
    if laboratory.quantisation > 0.0:
        readings = laboratory.quantisation * np.round(readings / laboratory.quantisation)
    repeats = _random(seed, _Source.HELD, sensor).random(count) < laboratory.held
    repeats[0] = False
    readings = readings[np.maximum.accumulate(np.where(repeats, 0, np.arange(count)))]
    lost = _random(seed, _Source.DROPOUTS, sensor).random(count) < laboratory.dropouts / laboratory.sample_rate
    readings[lost] = DROPOUT_CODE
    return readings
