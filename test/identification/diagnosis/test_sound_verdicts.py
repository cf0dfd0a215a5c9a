"""Verdicts on awkward data: none leaves a larger error, and what is written is what is claimed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import pytest
from plants.recording import train_profile

from benchmarks.campaign.cases import draw_case
from benchmarks.campaign.declared import as_trace
from benchmarks.campaign.hard import CAMPAIGN, cases
from identification.recordings import Short
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.diagnosis.run import Diagnosis, diagnose, diagnose_plant
from valve_sim.identification.plants.protocol import Array, Channel, EffectChoice, Plant, Role
from valve_sim.identification.reporting.claims import recording_advice, summarise
from valve_sim.identification.reporting.diagnosis_document import diagnosis_document
from valve_sim.model import Drive, Parameter
from valve_sim.model.effects import basis
from valve_sim.recordings import Signal
from valve_sim.recordings.synthetic import Sensor, record


def assert_sound(found: Diagnosis) -> None:
    """No larger error after than before, and a corrected model that is the one the verdict speaks of."""
    assert found.after.train_rmse <= found.before.train_rmse * (1.0 + 1e-9)
    if not np.isnan(found.before.holdout_rmse):
        assert found.after.holdout_rmse <= found.before.holdout_rmse * (1.0 + 1e-9)
    values = found.after.fit.values
    count = int(values.get("force_map.count", 0.0))
    coefficients = [values[f"force_map.c{number}"] for number in range(1, count + 1)]
    if found.verdict.kind in ("none", "effects"):
        assert not coefficients
        assert {name.split(".")[0] for name in found.after.fit.free if "." in name} == set(found.verdict.effects)
    elif coefficients:
        assert found.unexplained is not None
        low, high = values["force_map.low"], values["force_map.high"]
        curve = basis(np.array(found.unexplained.at), low, high, count) @ coefficients
        assert found.unexplained.force == pytest.approx(curve)


@pytest.mark.long
def test_strokes_are_held_out_of_bags_of_two_strokes_each() -> None:
    (case,) = (case for case in cases() if case.kind == "four bags of two strokes" and case.seed == 1)
    traces = case.make(1)
    assert [int(np.count_nonzero(trace.drive.volts)) for trace in traces] == [2, 2, 2, 2]
    found = diagnose(traces, [], CAMPAIGN)
    assert_sound(found)
    assert found.verdict.effects == ("coulomb_friction",)
    assert found.after.holdout_rmse == pytest.approx(1e-6, rel=0.1)


@pytest.mark.long
@pytest.mark.parametrize(
    ("seed", "few", "kind", "names", "times"),
    [
        # A delay of 1.1 ms: saturation beside something unnamed explains more than the delay does beside that.
        (4511, ("magnetic_saturation", "eddy_lag"), "effects", {"constant_force", "sensor_delay"}, 10.0),
        # Stamps that are learned explain what the model lacks, but not on strokes of another kind. Of two effects the
        # training data show one.
        (4514, ("residual_magnetism", "coulomb_friction"), "partly", {"constant_force"}, 10.0),
        # Friction by direction: full strokes hide most of it in a damping, so that a constant force predicts them well.
        (6008, ("constant_force", "stiction"), "partly", {"coulomb_friction", "pressure_force"}, 3.0),
    ],
)
def test_two_effects_that_were_lost_are_corrected(
    seed: int, few: tuple[str, ...], kind: str, names: set[str], times: float
) -> None:
    """`times`: the noise, beyond which the declared model errs on held-out strokes."""
    case = draw_case("pair", seed)
    traces = [as_trace(own, f"bag {number}") for number, own in enumerate(case.recordings())]
    train, held_out = (Short([trace], case.declared, (*few, *names)) for trace in traces)
    found = diagnose_plant(train, held_out)
    assert (found.verdict.kind, set(found.verdict.effects)) == (kind, names)
    assert found.correction is not None
    assert found.before.holdout_rmse > times * found.correction.noise
    assert found.after.holdout_rmse < 1.1 * found.correction.noise
    assert found.correction.after == pytest.approx(found.correction.noise, rel=0.1)


@pytest.mark.long
def test_a_force_in_place_of_all_names_is_weighed_where_a_name_imitates_it() -> None:
    """A ripple of 0.4 mN: the first steps of a curve's fit have to be damped, and say little of where it ends."""
    case = draw_case("weak", 4516)
    train, held_out = (
        Short([as_trace(own, f"bag {number}")], case.declared, ("constant_force",), with_curves=True)
        for number, own in enumerate(case.recordings())
    )
    table = diagnose_plant(train, held_out).grounds.table
    assert table[()].forced > table["constant_force",].plain - 15.0


@pytest.mark.long
def test_a_sample_at_the_command_of_an_instant_coil_makes_no_effect() -> None:
    valve = default_valve().with_values(coil_time_constant=0.0)
    profile = train_profile()
    made = record(valve, Drive(profile.times, profile.volts), profile.duration, 10e3, Sensor()).trace
    times = made.coil_current.times + 1e-9 * (np.arange(len(made.times)) % 2)
    found = diagnose([replace(made, coil_current=Signal(times, made.coil_current.values))], [], valve)
    assert (found.verdict.kind, found.verdict.effects) == ("none", ())


# -- a user's plants ---------------------------------------------------------------------------------------------------


class Decay(Plant):
    """Shown: gain · exp(−t) in every group, with a `step` in later groups as its one effect."""

    base = ("gain",)
    channels: tuple[Channel, ...] = ()
    PARAMETERS: ClassVar = {
        "gain": Parameter("gain", "A", "of the decay", 0.0, 1e3, 1.0),
        "ramp.slope": Parameter("slope", "A/s", "added", -1e3, 1e3, 0.1, 0.0),
    }
    effects: ClassVar = {"ramp": EffectChoice("ramp", (PARAMETERS["ramp.slope"],))}

    def __init__(
        self,
        kind: str,
        unit: str,
        data: Sequence[Array] = (),
        *,
        quiet: bool = True,
        groups: int = 8,
        recordings: int = 1,
        role: Role = "response",
    ) -> None:
        self.times = np.arange(200 * groups) / 100.0
        group = np.arange(200 * groups) // 200
        still = np.arange(200 * groups) % 200 >= 60 if quiet else np.zeros(200 * groups, bool)
        self.channels = tuple(
            Channel(f"user {number}", kind, self.times, shown, still, group, unit, role, number)
            for number, shown in enumerate(data or [np.zeros(len(self.times))] * recordings)
        )

    def parameter(self, name: str) -> Parameter:
        return self.PARAMETERS[name]

    def declared(self, name: str) -> float:
        return 1.0 if name == "gain" else 0.0

    def predict(self, values: Mapping[str, float]) -> list[Array]:
        since = np.minimum(self.times % 2.0, 0.6)
        shape = np.exp(-20.0 * since) - np.exp(-20.0 * 0.6)
        shown = values.get("gain", 1.0) * shape + values.get("ramp.slope", 0.0) * since * (0.6 - since)
        return [shown for _ in self.channels]


def made(kind: str, unit: str, extra: Array | float = 0.0, slope: float = 0.0, **form: Any) -> Decay:
    plant, random = Decay(kind, unit, **form), np.random.default_rng(3)
    shown = plant.predict({"gain": 1.3, "ramp.slope": slope})
    return Decay(kind, unit, [one + random.normal(0.0, 0.01, len(one)) + extra for one in shown], **form)


@pytest.mark.parametrize(
    ("kind", "unit", "shown", "scale", "key"),
    [("current", "A", "mA", 1e3, "rmse_ma"), ("force", "N", "N", 1.0, "rmse")],
)
def test_a_user_s_only_channel_counts_whatever_its_kind(
    kind: str, unit: str, shown: str, scale: float, key: str
) -> None:
    found = diagnose_plant(made(kind, unit, slope=2.0), None)
    assert found.verdict.effects == ("ramp",)
    assert found.before.train_rmse > 2.0 * found.after.train_rmse
    assert found.after.holdout_rmse == pytest.approx(0.01, rel=0.1)
    assert "V" not in summarise(found)
    report = diagnosis_document(found).to_json()
    assert report["unit"] == shown
    assert {name for name in report["after"] if name.startswith("rmse")} == {"rmse", key}
    assert report["after"][key]["train"] == pytest.approx(scale * found.after.train_rmse)


@pytest.mark.parametrize(
    ("recordings", "groups", "role", "quiet"),
    [(1, 8, "response", True), (4, 2, "response", False), (8, 1, "actuation", False)],
)
def test_a_user_s_strokes_count_however_they_were_recorded(
    recordings: int, groups: int, role: Role, *, quiet: bool
) -> None:
    form = {"recordings": recordings, "groups": groups, "role": role, "quiet": quiet}
    for slope, expected in ((2.0, ("ramp",)), (0.0, ())):
        found = diagnose_plant(made("current", "A", slope=slope, **form), None)
        assert found.verdict.effects == expected
        assert found.verdict.kind == ("effects" if expected else "none")
        assert found.after.train_rmse == pytest.approx(0.01, rel=0.1)
        assert found.after.holdout_rmse == pytest.approx(0.01, rel=0.1)


def test_advice_to_another_machine_is_not_the_valve_s() -> None:
    found = diagnose_plant(made("current", "A", slope=2.0, groups=1), None)
    assert found.verdict.kind == "effects"
    assert "V" not in summarise(found) + recording_advice(found)


def test_what_no_effect_explains_is_unknown_without_maps_too() -> None:
    wave = 0.1 * np.sin(np.arange(1600) * 0.7) * (np.arange(1600) % 200 < 60)
    found = diagnose_plant(made("temperature", "K", wave), None)
    assert found.verdict.kind == "unknown"
    assert found.unexplained is None
    assert_sound(found)


def test_noise_that_is_never_seen_alone_is_what_the_model_leaves() -> None:
    smooth = np.convolve(np.random.default_rng(5).normal(size=1600), np.ones(25) / 25.0, "same")
    coloured = diagnose_plant(made("temperature", "K", 0.5 * smooth, quiet=False), None)
    # Differences see a hundredth of noise of this colour, and made every effect certain.
    assert coloured.before.fit.problem.noise.sigma == pytest.approx(0.1, rel=0.3)
    assert coloured.verdict.effects == ()
    jagged = Decay("force", "N", quiet=False)
    jagged.predict = lambda values: [values.get("gain", 1.0) * np.sign(np.sin(3.1 * np.arange(1600)))]  # type: ignore[method-assign]
    noise = np.random.default_rng(6).normal(0.0, 1e-3, 1600)
    jagged.channels = (replace(jagged.channels[0], data=jagged.predict({})[0] + noise),)
    # Differences see the signal itself, half a thousand times the noise.
    found = diagnose_plant(jagged, None)
    assert found.before.fit.problem.noise.sigma == pytest.approx(1e-3, rel=0.1)
