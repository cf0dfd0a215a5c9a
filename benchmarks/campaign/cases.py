"""The cases: what is wrong with which valve and how it is recorded. A family and a seed determine all of it."""

from __future__ import annotations

import math
import tempfile
import zlib
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
from plants import recording, tolerances
from plants.common import Plant
from plants.declared import CAMPAIGN_VALVE, DeclaredPlant
from plants.laboratory import IMPERFECTIONS, LABORATORIES, LOW_RATES, Laboratory, measure
from plants.mismatched import BENCH_VALVE, EFFECTS, MismatchedPlant
from plants.recording import Recorder, Recording, record, single_opening, three_strokes, train_bags, train_profile
from plants.recording import holdout_profile as other_profile
from plants.reluctance import DATA_SHEET, ReluctancePlant, built
from plants.reluctance import EFFECTS as RELUCTANCE_EFFECTS
from plants.tolerances import LENGTHS, NAMES, SHARES, SHEET_VALVE, Entries, deviated, drawn_deviations

from benchmarks.campaign import actuators, coil, hard, outlet
from benchmarks.campaign.bench import Bench, Measured
from benchmarks.campaign.declared import declared_valve
from benchmarks.campaign.effects import CATALOGUED, UNCATALOGUED, Effects, are_confusable, log_uniform
from benchmarks.campaign.limits import Knowledge, detection_limit, effect_distance, size_at, yardstick
from valve_sim.identification.fit.static_force import fit_static_force
from valve_sim.model import Valve

NOISES: Final[Mapping[str, Recorder]] = {
    "white": Recorder(),
    "coloured": Recorder(colour=0.7),
    "quantised": Recorder(quantisation=5e-6),
    "jitter": Recorder(command_jitter=50e-6),
}
"""1 µm white; AR(1) of 0.7; steps of 5 µm; 50 µs on every command's stamp."""
LABORATORY_NOISES: Final[Mapping[str, float]] = {"white": 1e-6, "quiet": 0.2e-6}
"""m, standard deviation of the white noise beside one imperfection: as everywhere, and as a good sensor has it."""
MISTAKES: Final[Mapping[str, Laboratory]] = {
    "nothing": Laboratory(),
    "five times the noise": Laboratory(position_noise=5e-6),
    "2 kHz in place of 20 kHz": Laboratory(sample_rate=2e3),
    "steps of 5 µm": Laboratory(quantisation=5e-6),
    "a sensor that drifts by 15 µm a stroke": Laboratory(drift=15e-6),
    "3 µm of hum": Laboratory(hum=3e-6),
    "a mount that rings, 6 µm at 400 Hz": Laboratory(ringing=6e-6, ringing_frequency=400.0, ringing_damping=0.3),
    "a tilted sensor, bent by 3 µm": Laboratory(bend=3e-6),
    "a supply of 0.5 Ω": Laboratory(supply_resistance=0.5),
    "stamps that scatter by 300 µs": Laboratory(command_jitter=300e-6),
    "a dry valve, friction varies by 15 %": Laboratory(stroke_variation=0.15),
}
"""One mistake each, beside 1 µm of white noise at 20 kHz, as docs/how_to/record_well.md lists them."""
WHOLE: Final = {**LABORATORIES, **LOW_RATES, **MISTAKES}
"""Laboratories with their own noise, by name."""
OWN_NOISE: Final = "own"
"""The noise of a whole laboratory, which says itself what it is."""
SIZES: Final = ("small", "middle", "large")
"""Of an imperfection, as `IMPERFECTIONS` lists them."""
CLOCK_OFFSET: Final = 30e-6
"""s, standard deviation; drawn for each bag."""
DAMPING_FACTOR: Final = (0.7, 1.5)
"""True over declared damping of plant (a), drawn evenly in the logarithm for each of both."""
LIMITS: Final = (5.0, 40.0)
"""Amplitudes in detection limits, drawn evenly in the logarithm; cut at what is physically sensible."""
BESIDE_LIMITS: Final = (10.0, 40.0)
"""Amplitudes beside an imperfection of the recording: strong enough to be named where nothing is in the way."""
MISMATCHED_LIMITS: Final = (20.0, 100.0)
"""Amplitudes on plant (b), whose own mismatch must not drown the effect."""
NARROWEST: Final = 1.5
"""Upper over lower end of the amplitudes, where physics would leave less."""
STRONG: Final = (2e-6, 8e-6)
"""m RMS by which uncatalogued effects move the valve after a refit of the dampings."""
WEAK_SHARE: Final = 0.1
"""Amplitude of a weak uncatalogued effect over that of a strong one."""
FOLDER: Final = 4
"""Bags to train on in a folder; with clocks of their own, or (odd seeds) all with one."""
WRONG_VALUE: Final = (4.0, 10.0)
"""Tolerances by which a declared value is wrong, drawn evenly in the logarithm."""
SEEN: Final = "seen"
"""Among a wrong value's amplitudes: standard deviations by which it stands out of noise and other tolerances."""
WRONG: Final = "valve."
"""Begins the name of a declared value that is wrong, where effects have theirs."""
AT_LIMITS: Final = (0.5, 1.0, 1.5, 2.0, 3.0)
"""Detection limits at which effects are drawn round by round: too weak to be named, and just strong enough."""
OFF: Final = (0.05, 0.2)
"""Shares by which a file has a value off that it says to be exact, either way."""
GROWTH: Final = (0.2, 3.0)
"""By how many times its declared size an effect has grown, drawn evenly in the logarithm."""
EXACT_VALVE: Final[Entries] = {**SHEET_VALVE, "pickup_velocity_ratio": 0.82}
"""The valve of files that are wrong: every value can be off either way."""
EXACT_VALUES: Final = tuple(name for name in EXACT_VALVE if not name.endswith("_damping"))
"""Every declared value but the dampings, which are refitted anyway."""
OFF_IN_TURN: Final = (*EXACT_VALUES, *CATALOGUED)
"""What an exact file is wrong in: a value, or an effect that has grown."""
LARGEST_WITHIN: Final[Mapping[str, float]] = {
    "stroke_offset": 100e-6,
    "gap_offset": 100e-6,
    "rest_attraction": 1.5,
}
"""What physics can be blamed for where tolerances hide what is smaller: a fault of assembly, half the rest force."""

Numbers = dict[str, float]
Draw = Callable[[int, np.random.Generator, Recorder], tuple[Effects, Numbers]]
"""Truth and amplitudes of a seed, from a generator, for recordings by a recorder."""


@dataclass(frozen=True)
class Case:
    """One valve and its recordings.

    Attributes:
        truth: the effects that are on, and values of the file that are wrong. amplitudes: in detection limits, in µm
            RMS for uncatalogued effects; of `exact_wrong` the share by which a value is off, or an effect has grown.
        dampings: true ones, N·s/m; empty where the plant has its own.
        deviations: of the true values from the declared ones, in tolerances; none where the declared file is exact.
        noise: one of `NOISES`, with a laboratory of `LABORATORY_NOISES` or its own. clock_offsets: s, of the bags in
            the order in which they are recorded.
        laboratory: that records it: an imperfection with its size, as "drift:large", or a whole one's name; or empty.
    """

    family: str
    seed: int
    truth: Effects
    amplitudes: Numbers
    dampings: Numbers
    noise: str
    with_current: bool
    clock_offsets: tuple[float, ...]
    record_seeds: tuple[int, ...]
    deviations: Numbers = field(default_factory=dict)
    laboratory: str = ""

    @property
    def name(self) -> str:
        """What `--case` takes."""
        return f"{self.family}:{self.seed}"

    @property
    def effects(self) -> Effects:
        """What of the truth is an effect, not a wrong value."""
        return {name: values for name, values in self.truth.items() if not name.startswith(WRONG)}

    @property
    def origin(self) -> Origin:
        """Where its valve and its file come from."""
        return FAMILIES[self.family].origin

    @property
    def bench(self) -> Bench | None:
        """What is diagnosed, where the family says so; else the plant, recorded."""
        make = FAMILIES[self.family].bench
        return None if make is None else make(self.seed, next(iter(self.truth), ""))

    @property
    def true_values(self) -> Entries:
        """The true valve's numbers, where it is of the declared form."""
        sheet = self.origin.sheet
        return {**deviated(sheet, self.deviations), **self.dampings} if sheet else {}

    @property
    def true_scalars(self) -> Numbers:
        """True values, one number a name: the difference of the masses too, and the polynomial's coefficients."""
        entries = self.true_values
        scalars = {name: value for name, value in entries.items() if isinstance(value, float)}
        if scalars:
            scalars["main_mass"] = scalars["moving_mass"] - scalars["pilot_mass"]
            coefficients = np.asarray(entries["attraction_polynomial"]).tolist()
            scalars |= {f"a{power}": value for power, value in enumerate(coefficients)}
        return scalars

    @property
    def plant(self) -> Plant:
        """The true valve."""
        return self.origin.plant(self)

    @property
    def declared(self) -> Valve:
        """What the diagnosis is told of the valve."""
        return self.origin.declared(self)

    def recorder(self, bag: int) -> Recorder:
        """How a bag, by its place, is recorded."""
        return replace(NOISES[self.noise], clock_offset=self.clock_offsets[bag], with_current=self.with_current)

    def laboratory_of(self, bag: int) -> Laboratory:
        """The laboratory as it records a bag, by its place, with that bag's clock."""
        if self.laboratory in WHOLE:
            laboratory = WHOLE[self.laboratory]
        else:
            name, _, size = self.laboratory.partition(":")
            laboratory = replace(IMPERFECTIONS[name][SIZES.index(size)], position_noise=LABORATORY_NOISES[self.noise])
        offset = laboratory.clock_offset + self.clock_offsets[bag]
        return replace(laboratory, clock_offset=offset, with_current=self.with_current)

    def recordings(self) -> tuple[Recording, ...]:
        """To train on, and last what to hold out; for an opening, the opening and what it is advised to record next."""
        profiles = FAMILIES[self.family].profiles()
        if self.laboratory:
            return tuple(
                measure(self.true_values, self.effects, profile, self.laboratory_of(bag), self.record_seeds[bag])
                for bag, profile in enumerate(profiles)
            )
        return tuple(
            record(self.plant, profile, self.recorder(bag), self.record_seeds[bag])
            for bag, profile in enumerate(profiles)
        )


class Origin(NamedTuple):
    """A valve that is recorded, and the file that a diagnosis gets of it.

    Attributes:
        plant: the true valve of a case. declared: what its file says.
        sheet: numbers that the true ones deviate from; none where the plant is of another form than the declared one.
        deviates: names of the numbers that are off within their tolerances; none where the file is exact.
    """

    plant: Callable[[Case], Plant]
    declared: Callable[[Case], Valve]
    sheet: Entries = MappingProxyType({})
    deviates: Sequence[str] = ()


def _of_the_form(case: Case) -> Plant:
    return DeclaredPlant(case.effects, case.true_values)


def _mismatched(case: Case) -> Plant:
    return MismatchedPlant(case.effects)


def _mismatched_file(case: Case) -> Valve:
    """This plant's own numbers are fixed: it is the file that is off."""
    sheet = deviated({**CAMPAIGN_VALVE, **BENCH_VALVE}, case.deviations)
    return declared_valve(sheet, tolerances.declared_tolerances(sheet))


def _wrong_file(case: Case) -> Valve:
    """One value is off, or one effect is declared smaller than it is; all of it is said to be exact."""
    [(name, amount)] = case.amplitudes.items()
    if name in CATALOGUED:
        return declared_valve(EXACT_VALVE, effects={name: CATALOGUED[name].parameters(*_declared_size(name))})
    own = name.removeprefix(WRONG)
    off = (np.asarray(EXACT_VALVE[own]) * (1.0 + amount)).tolist()
    return declared_valve({**EXACT_VALVE, own: off})


def _reluctance_plant(case: Case) -> ReluctancePlant:
    return ReluctancePlant(case.effects, built(deviated(DATA_SHEET, case.deviations)))


def _from_static_table(case: Case) -> Valve:
    """A rounded data sheet, with the attraction that `fit_static_force` finds in a noisy table."""
    known = tolerances.declared_tolerances(DATA_SHEET)
    scalars = {name: value for name, value in known.items() if name != "attraction_covariance"}
    sheet = declared_valve(DATA_SHEET, scalars | {"pickup_velocity_ratio": 0.01})
    plant = ReluctancePlant(build=built(deviated(DATA_SHEET, case.deviations)))
    table = np.column_stack(plant.static_table(np.random.default_rng(case.record_seeds)))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "static.csv"
        np.savetxt(path, table, delimiter=",", header="displacement,force", comments="", fmt="%.6g")
        return fit_static_force(path, sheet).valve


def _sheet_within(case: Case) -> Valve:
    return declared_valve(SHEET_VALVE, tolerances.declared_tolerances(SHEET_VALVE))


TOLD_EXACTLY: Final = Origin(_of_the_form, lambda case: declared_valve(CAMPAIGN_VALVE), CAMPAIGN_VALVE)
TOLD_WITHIN: Final = Origin(_of_the_form, _sheet_within, SHEET_VALVE, NAMES)
TOLD_WRONG: Final = Origin(_of_the_form, _wrong_file, EXACT_VALVE)
MISMATCHED: Final = Origin(_mismatched, lambda case: declared_valve(BENCH_VALVE))
MISMATCHED_WITHIN: Final = Origin(_mismatched, _mismatched_file, deviates=NAMES)
# The pull of this one is measured at rest.
RELUCTANCE: Final = Origin(_reluctance_plant, _from_static_table, deviates=(*SHARES, *LENGTHS))


@dataclass(frozen=True)
class Family:
    """A kind of case.

    Attributes:
        draw: truth and amplitudes of a seed. kinds: over so many seeds every effect takes its turn.
        per_round: cases for each of the campaign's seeds. in_slice: cases of the slice for CI, the quicker ones.
        origin: of the valve and its file. is_true: whether no number is off, although the file tells tolerances.
        profiles: what is commanded, to train on and last what to hold out.
        laboratory: the laboratory of a seed and its noise; None where a plain recorder does.
        bench: what is diagnosed, of a seed and of what is missing, where a case's own plant and recorder do not do.
        wanted: what the bench's figures may be at most, without their sign; those that have a bound.
    """

    draw: Draw
    kinds: int
    per_round: int
    in_slice: tuple[int, ...]
    origin: Origin = TOLD_EXACTLY
    profiles: Callable[[], Sequence[recording.Profile]] = lambda: (train_profile(), other_profile())
    laboratory: Callable[[int], tuple[str, str]] | None = None
    is_true: bool = False
    bench: Callable[[int, str], Bench] | None = None
    wanted: Measured = field(default_factory=dict)


def draw_case(family: str, seed: int) -> Case:
    """The case of a family and a seed."""
    random = np.random.default_rng([zlib.crc32(family.encode()), seed])
    own = FAMILIES[family]
    if own.bench is not None:
        truth, amplitudes = own.draw(seed, random, NOISES["white"])
        return Case(family, seed, truth, amplitudes, {}, "white", False, (), ())
    turn, kind = divmod(seed, own.kinds)
    # Over eight turns every effect meets every noise, with current and without.
    noise = list(NOISES)[(kind + turn) % len(NOISES)]
    with_current = (kind + turn // len(NOISES)) % 2 == 1
    dampings = {
        name: float(np.asarray(CAMPAIGN_VALVE[name])) * log_uniform(random, *DAMPING_FACTOR)
        for name in ("pilot_damping", "main_damping")
    }
    laboratory, recorder = "", NOISES[noise]
    if own.laboratory is not None:
        laboratory, noise = own.laboratory(seed)
        recorder = NOISES["white"]
        # The place of the imperfection must not say whether there is a current.
        with_current = (kind // 2 + turn // 2) % 2 == 1
    bags = len(own.profiles())
    offsets = CLOCK_OFFSET * random.standard_normal(bags)
    if bags > 2 and seed % 2 == 1:
        offsets[:] = offsets[0]
    seeds = random.integers(2**31, size=bags)
    deviations = drawn_deviations(random) if own.origin.deviates else {}
    deviations = {name: size for name, size in deviations.items() if name in own.origin.deviates}
    if own.is_true:
        deviations, dampings = {}, {}
    truth, amplitudes = own.draw(seed, random, recorder)
    # No position shows the coil's resistance.
    with_current = with_current or f"{WRONG}coil_resistance" in truth
    if deviations:
        # What is wrong is not within its tolerance.
        deviations |= {name.removeprefix(WRONG): size for name, size in amplitudes.items() if name.startswith(WRONG)}
    return Case(
        family,
        seed,
        truth,
        amplitudes,
        dampings if own.origin.sheet else {},
        noise,
        with_current,
        tuple(offsets.tolist()),
        tuple(seeds.tolist()),
        deviations,
        laboratory,
    )


def _one_imperfection(seed: int) -> tuple[str, str]:
    """Every imperfection in turn, by its size, and then all of them in the other noise."""
    place, kind = divmod(seed, len(IMPERFECTIONS))
    turn, size = divmod(place, len(SIZES))
    noise = list(LABORATORY_NOISES)[(kind + size + turn) % len(LABORATORY_NOISES)]
    return f"{list(IMPERFECTIONS)[kind]}:{SIZES[size]}", noise


def _whole(names: Iterable[str], seeds: int = 1) -> Callable[[int], tuple[str, str]]:
    """Whole laboratories in turn, each for so many seeds."""
    known = tuple(names)
    return lambda seed: (known[seed // seeds % len(known)], OWN_NOISE)


def _clear_imperfection(seed: int) -> tuple[str, str]:
    """Every imperfection of middle or large size in turn; each round of effects begins one place further on."""
    place = (seed + seed // len(CATALOGUED)) % (2 * len(IMPERFECTIONS))
    size, kind = divmod(place, len(IMPERFECTIONS))
    return f"{list(IMPERFECTIONS)[kind]}:{SIZES[1 + size]}", "white"


def _catalogued(
    name: str,
    random: np.random.Generator,
    recorder: Recorder,
    limits: tuple[float, float] = LIMITS,
    knowledge: Knowledge = Knowledge.EXACT,
) -> tuple[Effects, Numbers]:
    """One effect of an amplitude between so many detection limits, or of just so many."""
    scale = CATALOGUED[name]
    shape, sign = scale.draw_shape(random), scale.draw_sign(random)
    limit = detection_limit(name, shape, recorder, knowledge)
    if limits[0] == limits[1]:
        size = min(limits[0] * limit, scale.most)
        return {name: scale.parameters(sign * size, shape)}, {name: size / limit}
    low = limits[0] * limit
    size = min(log_uniform(random, low, max(NARROWEST * low, min(limits[1] * limit, scale.largest))), scale.most)
    if knowledge is Knowledge.WITHIN:
        size = min(size, LARGEST_WITHIN.get(name, math.inf))
    return {name: scale.parameters(sign * size, shape)}, {name: size / limit}


def _in_turn(
    names: Iterable[str], limits: tuple[float, float] = LIMITS, knowledge: Knowledge = Knowledge.EXACT
) -> Draw:
    """One effect after the other, one in each seed."""
    known = tuple(names)
    return lambda seed, random, recorder: _catalogued(known[seed % len(known)], random, recorder, limits, knowledge)


_single: Final = _in_turn(CATALOGUED)
_single_within: Final = _in_turn(CATALOGUED, knowledge=Knowledge.WITHIN)
_beside: Final = _in_turn(CATALOGUED, BESIDE_LIMITS, Knowledge.WITHIN)


def _at_limits(
    seed: int, random: np.random.Generator, recorder: Recorder, knowledge: Knowledge = Knowledge.EXACT
) -> tuple[Effects, Numbers]:
    """One effect at so many detection limits, as its round has it."""
    turn, kind = divmod(seed, len(CATALOGUED))
    times = AT_LIMITS[turn % len(AT_LIMITS)]
    return _catalogued(list(CATALOGUED)[kind], random, recorder, (times, times), knowledge)


def _exact_wrong(seed: int, random: np.random.Generator, recorder: Recorder) -> tuple[Effects, Numbers]:
    """A value that is off, by its true value, or an effect that has grown since it was declared."""
    name = OFF_IN_TURN[seed % len(OFF_IN_TURN)]
    if name in CATALOGUED:
        size, shape = _declared_size(name)
        growth = min(log_uniform(random, *GROWTH), CATALOGUED[name].most / size - 1.0)
        return {name: CATALOGUED[name].parameters(size * (1.0 + growth), shape)}, {name: growth}
    share = random.uniform(*OFF) * (-1.0 if random.random() < 0.5 else 1.0)
    true = np.asarray(EXACT_VALVE[name])
    return {f"{WRONG}{name}": {name: float(true)} if true.ndim == 0 else {}}, {f"{WRONG}{name}": share}


def _declared_size(name: str) -> tuple[float, Numbers]:
    """The size and the shape of an effect in a file that declares it."""
    scale = CATALOGUED[name]
    return math.sqrt(scale.guess * min(scale.largest, scale.most)), scale.middle()


def _unnamed_beside(seed: int, random: np.random.Generator, recorder: Recorder) -> tuple[Effects, Numbers]:
    """One effect of the catalogue, and one that no catalogue holds."""
    return _both(_single(seed, random, recorder), _uncatalogued(seed, random, recorder))


def _both(one: tuple[Effects, Numbers], other: tuple[Effects, Numbers]) -> tuple[Effects, Numbers]:
    return {**one[0], **other[0]}, {**one[1], **other[1]}


def _none(seed: int, random: np.random.Generator, recorder: Recorder) -> tuple[Effects, Numbers]:
    return {}, {}


def _pair(seed: int, random: np.random.Generator, recorder: Recorder) -> tuple[Effects, Numbers]:
    while True:
        first, second = (str(name) for name in random.choice(list(CATALOGUED), 2, replace=False))
        if not are_confusable(first, second):
            break
    return _both(_catalogued(first, random, recorder), _catalogued(second, random, recorder))


def _uncatalogued(
    seed: int, random: np.random.Generator, recorder: Recorder, share: float = 1.0
) -> tuple[Effects, Numbers]:
    name = list(UNCATALOGUED)[seed % len(UNCATALOGUED)]
    scale = UNCATALOGUED[name]
    shape, sign = scale.draw_shape(random), scale.draw_sign(random)
    moved = log_uniform(random, *STRONG)
    plain = NOISES["white"]
    measure = yardstick(plain)
    distance = moved / plain.position_noise * math.sqrt(measure.samples)
    size = share * size_at(distance, scale, effect_distance(measure, name, scale, shape, sign))
    return {name: scale.parameters(sign * size, shape)}, {name: share * moved * 1e6}


def _wrong_value(seed: int, random: np.random.Generator, recorder: Recorder) -> tuple[Effects, Numbers]:
    """One scalar that is off by more than its tolerance allows; the true value is what counts as its parameter."""
    names = (*SHARES, *LENGTHS)
    name = names[seed % len(names)]
    sign = 1.0 if random.random() < 0.5 else -1.0
    size = sign * log_uniform(random, *WRONG_VALUE)
    true = deviated(SHEET_VALVE, {name: size})
    own = "moving_mass" if name == "main_mass" else name
    seen = abs(size) * yardstick(recorder, Knowledge.WITHIN).distance_of_deviation(name)
    return {f"{WRONG}{name}": {own: float(np.asarray(true[own]))}}, {f"{WRONG}{name}": size, SEEN: seen}


def _every_other(seed: int, random: np.random.Generator, recorder: Recorder) -> tuple[Effects, Numbers]:
    """Nothing, and in every other seed one effect."""
    return _beside(seed // 2, random, recorder) if seed % 2 else _none(seed, random, recorder)


def _twice_three() -> Sequence[recording.Profile]:
    return three_strokes(), three_strokes()


def _one_of(names: Iterable[str]) -> Draw:
    """One of these names in turn is missing; what it does is the bench's business."""
    known = tuple(names)
    return lambda seed, random, recorder: ({known[seed % len(known)]: {}}, {})


def _hard(seed: int, random: np.random.Generator, recorder: Recorder) -> tuple[Effects, Numbers]:
    return {name: dict(values) for name, values in HARD[seed % len(HARD)].effects.items()}, {}


def _actuator(seed: int, random: np.random.Generator, recorder: Recorder) -> tuple[Effects, Numbers]:
    missing = actuators.missing(seed)
    return ({missing: {}} if missing else {}), {}


HARD: Final = hard.cases()
_mismatched_within: Final = _in_turn(EFFECTS, knowledge=Knowledge.WITHIN)
_reluctance: Final = _in_turn(RELUCTANCE_EFFECTS, knowledge=Knowledge.WITHIN)
_at_limits_within: Final = partial(_at_limits, knowledge=Knowledge.WITHIN)
EXACT: Final[Mapping[str, Family]] = {
    "single": Family(_single, len(CATALOGUED), len(CATALOGUED), (0, 12, 17, 20)),
    "none": Family(_none, 1, 20, (0, 1, 2, 3)),
    "pair": Family(_pair, 1, 5, (2,)),
    "uncatalogued": Family(_uncatalogued, len(UNCATALOGUED), 5, (5,)),
    "weak": Family(partial(_uncatalogued, share=WEAK_SHARE), len(UNCATALOGUED), 5, (2,)),
    "mismatched": Family(_in_turn(EFFECTS, MISMATCHED_LIMITS), len(EFFECTS), 5, (10,), MISMATCHED),
    "opening": Family(_single, len(CATALOGUED), 4, (0,), profiles=lambda: (single_opening(), train_profile())),
    "at_limits": Family(_at_limits, len(CATALOGUED), len(CATALOGUED), ()),
    "exact_wrong": Family(_exact_wrong, len(OFF_IN_TURN), len(OFF_IN_TURN), (), TOLD_WRONG),
    "unnamed_beside": Family(_unnamed_beside, len(CATALOGUED), 5, ()),
}
WITHIN: Final[Mapping[str, Family]] = {
    "none_within": Family(_none, 1, 10, (), TOLD_WITHIN),
    "single_within": Family(_single_within, len(CATALOGUED), 10, (), TOLD_WITHIN),
    "wrong_value": Family(_wrong_value, len(SHARES) + len(LENGTHS), 4, (), TOLD_WITHIN),
    "folder": Family(
        _single_within, len(CATALOGUED), 2, (), TOLD_WITHIN, lambda: (*train_bags(FOLDER), other_profile())
    ),
    "mismatched_within": Family(_mismatched_within, len(EFFECTS), 3, (), MISMATCHED_WITHIN),
    "reluctance": Family(_reluctance, len(RELUCTANCE_EFFECTS), 3, (), RELUCTANCE),
    "at_limits_within": Family(_at_limits_within, len(CATALOGUED), len(CATALOGUED), (), TOLD_WITHIN),
}
RECORDED: Final[Mapping[str, Family]] = {
    "imperfect": Family(_none, 42, 42, (), TOLD_WITHIN, laboratory=_one_imperfection),
    "laboratory": Family(_none, 5, 5, (), TOLD_WITHIN, laboratory=_whole(LABORATORIES)),
    "beside": Family(_beside, len(CATALOGUED), len(CATALOGUED), (), TOLD_WITHIN, laboratory=_clear_imperfection),
    "mistake": Family(_none, len(MISTAKES), len(MISTAKES), (), TOLD_WITHIN, laboratory=_whole(MISTAKES), is_true=True),
    "low_rate": Family(_every_other, 2 * len(CATALOGUED), 12, (), TOLD_WITHIN, _twice_three, _whole(LOW_RATES, 2)),
}
"""Of valves within their tolerances, recorded with errors; run where they are asked for by `--only`."""
BENCHES: Final[Mapping[str, Family]] = {
    "actuator": Family(_actuator, actuators.ROUND, actuators.ROUND, (), bench=actuators.bench),
    "hard": Family(_hard, len(HARD), len(HARD), (), bench=lambda seed, _: HARD[seed % len(HARD)].bench(),
                   wanted=dict.fromkeys(hard.FAULTS, 0.0)),
    "coil_none": Family(_none, 1, 3, (), bench=coil.bench, wanted=coil.WANTED),
    "coil_single": Family(_one_of(coil.EFFECTS), len(coil.EFFECTS), 3, (), bench=coil.bench, wanted=coil.WANTED),
    "emf_by_position": Family(_one_of(["motional_emf"]), 1, 1, (), bench=partial(coil.bench, by_position=True)),
    "outlet_none": Family(_none, 1, 2, (), bench=outlet.bench, wanted=outlet.WANTED),
    "outlet_single": Family(
        _one_of(outlet.EFFECTS), len(outlet.EFFECTS), 2, (), bench=outlet.bench, wanted=outlet.WANTED
    ),
}  # fmt: skip
"""Families with plants, sensors or judgements of their own; run where they are asked for by `--only`."""
FAMILIES: Final[Mapping[str, Family]] = {**EXACT, **WITHIN, **RECORDED, **BENCHES}
"""In the order in which they are run and reported; those of `WITHIN` and `RECORDED` with tolerances."""


def planned(rounds: range, families: Collection[str], *, is_slice: bool) -> list[tuple[str, int]]:
    """Family and seed of every case."""
    return [
        (name, seed)
        for name, family in FAMILIES.items()
        if name in families
        for seed in (
            family.in_slice if is_slice else range(rounds.start * family.per_round, rounds.stop * family.per_round)
        )
    ]
