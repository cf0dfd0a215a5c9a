"""Plants and recordings with a slip in them, two surfaces of `benchmarks.fuzz`.

Each must end in one typed error of one line that says what is wrong.

A plant of a user's own gets one slip (a NaN, a wrong shape, name or type, an exception, a complex number), a recording
that was put together in Python one defect. A number gives a case again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.diagnosis.identify import identify
from valve_sim.identification.diagnosis.run import diagnose, diagnose_plant
from valve_sim.identification.plants.protocol import Channel, EffectChoice, ForceMap, Nuisance
from valve_sim.identification.validation.replay import validate
from valve_sim.model import Drive, Parameter, Valve, ValveError, simulate
from valve_sim.traces import Signal, Trace

SAMPLES, GROUPS = 400, 8
LONGEST: Final = 400
"""Characters of a message that is read at a glance."""
TRUE_GAIN: Final = 2.0
"""Of the heater; 1 is declared."""

Array = NDArray[np.float64]
Random = np.random.Generator


class Heater:
    """shown = gain · power + offset + radiation · power²: a sound plant, each member of which a slip may spoil."""

    def __init__(self, seed: int = 0) -> None:
        random = np.random.default_rng(seed)
        self.times = np.arange(SAMPLES) / 10.0
        self.power = np.where(self.times < 8.0, 0.0, 2.0 + np.sin(self.times) + np.sin(0.37 * self.times))
        group = np.arange(SAMPLES) * GROUPS // SAMPLES
        data = TRUE_GAIN * self.power + random.normal(0.0, 0.05, SAMPLES)
        self.channels: Any = [Channel("heater", "temperature", self.times, data, self.times < 8.0, group, "K")]
        self.base: Any = ("gain",)
        self.nuisances: Any = (Nuisance("zero", 0.1, "K"),)
        self.timing_errors: Any = ()
        self.force_maps: Any = ()
        self.experiments: Any = ()
        self.parameters: dict[str, Any] = {
            "gain": Parameter("gain", "K/W", "K for each watt", 0.0, 1e3, 1.0),
            "radiation.coefficient": Parameter("coefficient", "K/W²", "grows with power²", -1.0, 1.0, 1e-2, off=0.0),
            "drift.rate": Parameter("rate", "K/s", "of the sensor", -1.0, 1.0, 1e-3, off=0.0),
        }
        self.effects: Any = {
            name: EffectChoice(name, (self.parameters[free],))
            for name, free in (("radiation", "radiation.coefficient"), ("drift", "drift.rate"))
        }

    def parameter(self, name: str) -> Any:
        """Unit and range."""
        return self.parameters[name]

    def declared(self, name: str) -> Any:
        """The prior scale of the gain, off of effects."""
        parameter = self.parameters[name]
        return parameter.prior_scale if parameter.off is None else parameter.off

    def predict(self, values: Mapping[str, float]) -> Any:
        """The temperature, K."""
        gain = values.get("gain", 1.0)
        radiation, rate = values.get("radiation.coefficient", 0.0), values.get("drift.rate", 0.0)
        shown = gain * self.power + radiation * self.power**2 + rate * self.times + values.get("zero", 0.0)
        return [shown]


Spoil = Callable[[Array, Random], Any]
"""Makes another array, or something else, of a sound one."""
Slip = Callable[[Heater, Random], Any]
"""Spoils a plant."""


def _holed(values: Array, random: Random, hole: float = np.nan) -> Array:
    values = np.array(values, dtype=np.float64)
    values[random.integers(0, len(values), random.integers(1, 5))] = hole
    return values


SPOILT: Final[Sequence[Spoil]] = (
    _holed,
    lambda values, random: _holed(values, random, np.inf),
    lambda values, random: _holed(values, random, -np.inf),
    lambda values, random: values[: -int(random.integers(1, min(len(values), 9)))],
    lambda values, random: values[:, None],
    lambda values, random: values.astype(complex),
    lambda values, random: values.astype(object),
    lambda values, random: values.astype(str),
)
"""What no array may be, wherever it stands: with holes, too short, a column, complex, of objects, of words."""


def _in_channel(column: str, spoil: Callable[[Array, Random], Any]) -> Slip:
    def slip(plant: Heater, random: Random) -> None:
        channel = plant.channels[0]
        plant.channels = [replace(channel, **{column: spoil(np.copy(getattr(channel, column)), random)})]

    return slip


def _in_predictions(spoil: Callable[[Array], Any], *, during: str = "") -> Slip:
    """Something else in place of all predictions, or of those in which a name is given."""

    def slip(plant: Heater, random: Random) -> None:
        sound = plant.predict

        def predict(values: Mapping[str, float]) -> Any:
            (shown,) = sound(values)
            return spoil(shown) if not during or during in values else [shown]

        plant.predict = predict  # type: ignore[method-assign]

    return slip


def _in_prediction(spoil: Spoil, *, during: str = "") -> Slip:
    """Something else in place of the one channel's prediction."""
    return lambda plant, random: _in_predictions(lambda shown: [spoil(shown, random)], during=during)(plant, random)


def _with(**members: Any) -> Slip:
    """Other members."""

    def slip(plant: Heater, random: Random) -> None:
        for name, value in members.items():
            setattr(plant, name, value)

    return slip


def _with_parameter(**changes: Any) -> Slip:
    """Another range of one of the parameters."""

    def slip(plant: Heater, random: Random) -> None:
        name = str(random.choice(list(plant.parameters)))
        plant.parameters[name] = plant.parameters[name]._replace(**changes)

    return slip


def _with_nuisance(**changes: Any) -> Slip:
    def slip(plant: Heater, random: Random) -> None:
        plant.nuisances = (plant.nuisances[0]._replace(**changes),)

    return slip


def _without(member: str) -> Slip:
    def slip(plant: Heater, random: Random) -> None:
        if member in vars(plant):
            delattr(plant, member)
        else:
            setattr(plant, member, None)

    return slip


def _raising(kind: type[Exception], message: str, *, during: str = "", above: float = -np.inf) -> Slip:
    """With any values, where a name is given, or where the gain is above something, which only a search comes to."""

    def slip(plant: Heater, random: Random) -> None:
        sound = plant.predict

        def predict(values: Mapping[str, float]) -> Any:
            if (not during or during in values) and values.get("gain", 1.0) > above:
                raise kind(message)
            return sound(values)

        plant.predict = predict  # type: ignore[method-assign]

    return slip


def _raising_property(plant: Heater, random: Random) -> Heater:
    def channels(self: Heater) -> Any:
        raise IndexError("list index\nout of range")

    return type("Heater", (Heater,), {"channels": property(channels, lambda self, value: None)})()  # type: ignore[no-any-return]


def _misspelt(plant: Heater, random: Random) -> None:
    name = "gain"
    at = int(random.integers(0, len(name) - 1))
    plant.base = (name[:at] + name[at + 1] + name[at] + name[at + 2 :],)


def _misspelt_in_predict(plant: Heater, random: Random) -> None:
    sound = plant.predict
    misspelt = str(random.choice(["radiaton.coefficient", "drift.rates", "gian"]))

    def predict(values: Mapping[str, float]) -> Any:
        return sound({**values, "zero": values[misspelt]} if values else values)

    plant.predict = predict  # type: ignore[method-assign]


def _misspelt_effect(plant: Heater, random: Random) -> None:
    choice = plant.effects["drift"]
    plant.effects = {
        **plant.effects,
        "drift": choice
        if random.random() < 0.3
        else replace(choice, parameters=(choice.parameters[0]._replace(name="rates"),)),
    }
    if plant.effects["drift"] is choice:
        plant.effects["drfit"] = plant.effects.pop("drift")


def _forgotten_parameter(plant: Heater, random: Random) -> None:
    del plant.parameters[str(random.choice(list(plant.parameters)))]


def _declared_as(value: Any) -> Slip:
    return _with(declared=lambda name: value)


MEMBERS: Final = ("channels", "base", "effects", "nuisances", "force_maps", "experiments")
SLIPS: Final[Sequence[Slip]] = (
    *(_in_channel(column, spoil) for column in ("data", "times") for spoil in SPOILT),
    *(_in_prediction(spoil, during=name) for name in ("", "gain", "drift.rate") for spoil in SPOILT),
    # Of another shape.
    _in_prediction(lambda shown, random: [shown]),
    _in_prediction(lambda shown, random: np.append(shown, 0.0)),
    _in_prediction(lambda shown, random: float(shown[0])),
    *(_in_predictions(spoil) for spoil in (
        lambda shown: shown, lambda shown: [shown, shown], lambda shown: [], lambda shown: None,
        lambda shown: (part for part in [shown]),
    )),
    _in_channel("data", lambda values, random: values.tolist()),
    _in_channel("times", lambda values, random: values[::-1]),
    _in_channel("quiet", lambda values, random: values[1:]),
    _in_channel("group", lambda values, random: values[: SAMPLES // 2]),
    _in_channel("group", lambda values, random: values - 1),
    _with(channels=()),
    _with_nuisance(channels=(1,)),
    # Of another name.
    _misspelt,
    _misspelt_in_predict,
    _misspelt_effect,
    _forgotten_parameter,
    _with(base="gain"),
    _with(base=("gain", "gain")),
    _with(nuisances=(Nuisance("zero", 0.1, "K"), Nuisance("zero", 0.2, "K"))),
    _with(nuisances=(Nuisance("zero", 0.1, "K", is_of_machine=True, same_as="drift.rate"),)),
    _with(force_maps=(ForceMap("t", ("curve.c0", "curve.c1"), {}, 0.0, 1.0, "s", "curve.count"),)),
    *(_without(member) for member in (*MEMBERS, "parameter", "declared", "predict", "timing_errors")),
    # Raising.
    _raising(KeyError, "gian"),
    _raising(ValueError, "math domain error", during="drift.rate"),
    _raising(IndexError, "index 400 is out of bounds\nfor axis 0 with size 400"),
    _raising(ZeroDivisionError, "division by zero"),
    _raising(TypeError, "unsupported operand", above=1.5),
    _raising(RuntimeError, "", above=1.2),
    _raising(AssertionError, "", during="radiation.coefficient"),
    _raising(MemoryError, "", during="gain"),
    _raising_property,
    _with(parameter=lambda name: 1 / 0),
    _with(declared=lambda name: {}["nothing"]),
    # Of another type or value.
    _in_prediction(lambda shown, random: shown.astype(np.int64)),
    _in_prediction(lambda shown, random: shown.tolist()),
    _in_channel("data", lambda values, random: (100.0 * values).astype(np.int32)),
    _in_channel("quiet", lambda values, random: values.astype(np.float64)),
    _in_channel("group", lambda values, random: values.astype(np.float64)),
    *(_declared_as(value) for value in (np.nan, 1.0 + 0.0j, "1.0", None)),
    _with(effects=["radiation", "drift"]),
    _with(nuisances=({"name": "zero", "sigma": 0.1},)),
    *(_with_parameter(**changes) for changes in (
        {"lower": np.nan}, {"prior_scale": np.nan}, {"lower": 5.0, "upper": -5.0}, {"prior_scale": 0.0}, {"off": "0"},
    )),
    *(_with_nuisance(**changes) for changes in (
        {"sigma": np.nan}, {"mean": np.inf}, {"sigma": 0.0}, {"sigma": -0.1}, {"step": 0.0}, {"channels": ("first",)},
    )),
    _with(channels=[{"data": np.zeros(4)}]),
    *(_with(**{member: None}) for member in MEMBERS[2:]),
    _with(timing_errors=None),
    _with(effects={"drift": EffectChoice("drift", ("rate",))}),  # type: ignore[arg-type]
    _with(effects={"drift": EffectChoice("drift", ())}),
    _with(base=(1,)),
    _with(base=(["gain"],)),
)  # fmt: skip
"""What may be wrong with a plant."""


def try_plant(number: int) -> str:
    """Diagnose a plant with a slip; see `refused`."""
    random = np.random.default_rng([number, 1])
    plant = Heater(number)
    spoilt = SLIPS[number % len(SLIPS)](plant, random)
    return refused(lambda: diagnose_plant(spoilt if isinstance(spoilt, Heater) else plant, None), "Heater")


def refused(work: Callable[[], object], place: str) -> str:
    """'refused'.

    Raises:
        AssertionError: it does not end in a typed error of one line, short enough to be read, that names the place.
        Exception: what else it ends in.
    """
    try:
        work()
    except ValveError as error:
        message = str(error)
        is_a_line = message.strip() and "\n" not in message and len(message) <= LONGEST
        assert is_a_line and place in message, f"{place}: {message[:200]!r}"
        return "refused"
    raise AssertionError("nothing was refused")


# -- recordings --------------------------------------------------------------------------------------------------------


@cache
def sound_trace() -> Trace:
    """Four strokes of the default valve with noise, its current recorded."""
    random = np.random.default_rng(1)
    valve = Valve.from_mapping(DECLARED, "the declared valve")
    drive = Drive.of([0.01, 0.04, 0.07, 0.10, 0.13, 0.16, 0.19, 0.22], [9.0, 0.0, 12.0, 0.0, 8.0, 0.0, 14.0, 0.0])
    times = np.arange(1200) / 5e3
    run = simulate(valve, drive, times)
    position = run.pilot_position + random.normal(0.0, 1e-6, len(times))
    main = run.main_position + random.normal(0.0, 1e-6, len(times))
    current = Signal(np.copy(times), run.coil_current + random.normal(0.0, 1e-3, len(times)))
    return Trace("made.mcap", drive, times, position, main, coil_current=current)


DECLARED: Final[dict[str, Any]] = {
    "valve": {
        "attraction_polynomial": [3.0336, 17.096e3, -30.931e6, 24.026e9], "coil_time_constant": 0.9934e-3,
        "coil_resistance": 10.0,
    }
}  # fmt: skip

COLUMNS: Final = ("times", "pilot_position", "main_position", "drive.times", "drive.volts", "coil_current.times",
                  "coil_current.values")  # fmt: skip


def _with_column(trace: Trace, column: str, values: Any) -> Trace:
    owner, _, name = column.rpartition(".")
    if not owner:
        return replace(trace, **{name: values})
    return replace(trace, **{owner: getattr(trace, owner)._replace(**{name: values})})


def _column(trace: Trace, column: str) -> Array:
    found: Any = trace
    for name in column.split("."):
        found = getattr(found, name)
    return np.copy(found)


Defect = Callable[[Trace, Random], Any]


def _in_column(spoil: Spoil, column: str) -> Defect:
    return lambda trace, random: _with_column(trace, column, spoil(_column(trace, column), random))


TIMES: Final = ("times", "drive.times", "coil_current.times")
DEFECTS: Final[Sequence[Defect]] = (
    *(_in_column(spoil, column) for column in COLUMNS for spoil in SPOILT),
    *(_in_column(lambda values, random: np.float64(values[0]), column) for column in COLUMNS),
    *(_in_column(lambda values, random: values.tolist(), column) for column in COLUMNS),
    *(_in_column(lambda values, random: (1e6 * values).astype(np.int64), column) for column in COLUMNS),
    *(_in_column(lambda values, random: None, column) for column in (
        "times", "pilot_position", "drive.times", "coil_current.values",
    )),
    *(_in_column(lambda values, random: values[::-1], column) for column in TIMES),
    *(_in_column(lambda values, random: random.permutation(values), column) for column in TIMES),
    _in_column(lambda values, random: np.full(len(values), values[0]), "times"),
    lambda trace, random: replace(trace, drive=(0.0, 9.0)),
    lambda trace, random: replace(trace, coil_current=trace.coil_current.values),  # type: ignore[union-attr]
    lambda trace, random: {"made.mcap": trace},
    lambda trace, random: [str(trace.source)],
    lambda trace, random: trace,
    lambda trace, random: [],
    lambda trace, random: replace(trace, drive=Drive.of([], [])),
    lambda trace, random: _few(trace, 0),
    lambda trace, random: _few(trace, int(random.integers(1, 3))),
)  # fmt: skip
"""What may be wrong with a recording."""


def _few(trace: Trace, count: int) -> Trace:
    """The first samples alone."""
    return Trace(trace.source, trace.drive, trace.times[:count], trace.pilot_position[:count])


def try_recording(number: int) -> str:
    """Diagnose, identify or validate with a spoilt recording; see `refused`."""
    spoilt = DEFECTS[number % len(DEFECTS)](sound_trace(), np.random.default_rng([number, 2]))
    # A recording may be given bare, where a list is wanted.
    traces = [spoilt] if isinstance(spoilt, Trace) and spoilt is not sound_trace() else spoilt
    valve = Valve.from_mapping(DECLARED, "the declared valve")
    uses: Sequence[Callable[[], object]] = (
        lambda: diagnose(traces, [], valve),
        lambda: identify(traces, valve),
        lambda: validate(traces, valve),
    )
    return refused(uses[number % len(uses)], "")
