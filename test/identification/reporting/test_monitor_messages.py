"""What a monitor finds is data, and has words with its numbers in the units that people read."""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from valve_sim.identification.diagnosis.run import Verdict
from valve_sim.identification.fit.intervals import Interval
from valve_sim.identification.monitoring.fault_isolation import FaultFinding
from valve_sim.identification.monitoring.findings import (
    DidNotClose,
    DidNotOpen,
    NotSimulated,
    Occasion,
    OpenedPartly,
    Remark,
    TimingTooUncertain,
    WaitsForPressure,
)
from valve_sim.identification.reporting.monitor_messages import finding_json, finding_words, remark_words, told_finding

SENTENCES: list[tuple[Remark, str]] = [
    (DidNotOpen(20e-6), "the valve did not open: the pilot plunger moved 0.020 mm only"),
    (OpenedPartly(0.5e-3, 1.23e-3), "the valve opened to 0.500 mm only, of 1.230 mm"),
    (
        WaitsForPressure(0.26e-3),
        "the pilot is open, at 0.260 mm; the main plunger waits for the pressure to equalise, longer than it should",
    ),
    (DidNotClose(0.4e-3), "the valve did not close: 0.400 mm open, without voltage"),
    (TimingTooUncertain(4.4e-3), "timing too uncertain to judge: held open for 4 ms only"),
    (NotSimulated("no such voltage"), "it could not be compared with the model: no such voltage"),
]


@pytest.mark.parametrize(("remark", "words"), SENTENCES, ids=lambda value: type(value).__name__)
def test_a_remark_has_words_with_its_numbers(remark: Remark, words: str) -> None:
    assert remark_words(remark) == words


def found(
    effects: tuple[str, ...],
    parameters: Mapping[str, Interval],
    alike: tuple[str, ...] = (),
    *,
    kind: str = "effects",
    declared: Mapping[str, float] | None = None,
    unnamed: float = 0.01,
) -> FaultFinding:
    verdict = Verdict(kind, effects, {name: alike for name in effects}, 0.9, unnamed, 0.9, 8)
    commissioned = {"main_damping.value": 4.0, "valve.spring_rate": 428.0}
    return FaultFinding(verdict, parameters, commissioned, declared or {}, 8)


def test_what_has_changed_is_said_with_its_size_and_what_it_was() -> None:
    force, film = Interval(0.31, 0.02, 0.27, 0.35), Interval(21e-6, 1e-6, 19e-6, 23e-6)
    damping = Interval(5.2, 0.1, 5.0, 5.4)
    friction = found(("coulomb_friction",), {"coulomb_friction.force": force}, alike=("stiction", "drive_gain"))
    assert finding_words(friction) == (
        "Coulomb friction 0.310 ± 0.020 N, none when commissioned (drive gain or stiction would explain it about as "
        "well)"
    )
    assert finding_words(found(("main_damping",), {"main_damping.value": damping})) == (
        "Main damping 5.20 ± 0.10 N·s/m, 4.00 N·s/m when commissioned"
    )
    both = {"squeeze_film.coefficient": force, "squeeze_film.film_thickness": film}
    assert finding_words(found(("squeeze_film",), both)) == (
        "Squeeze film: B, damping at contact 0.310 ± 0.020 N·s/m, h, film left at contact 21.0 ± 1.0 µm, none when "
        "commissioned"
    )


def test_what_is_left_of_an_orifice_is_a_share_of_what_it_was() -> None:
    clogged = {"pilot_clogging.ratio": Interval(0.6, 0.031, 0.54, 0.66)}
    assert finding_words(found(("pilot_clogging",), clogged)) == "pilot orifice at 60.0 ± 3.1 % of when commissioned"
    in_vain = {"pilot_clogging.ratio": Interval(0.311, 0.051, 0.2506, 0.6112)}
    assert (
        finding_words(found(("pilot_clogging",), in_vain)) == "pilot orifice at 31 % (25 to 61 %) of when commissioned"
    )
    leak = {"seat_leak.area": Interval(2.1e-9, 1e-10, 1.9e-9, 2.3e-9)}
    assert finding_words(found(("seat_leak",), leak)) == "Leaking seat 0.00210 ± 0.00010 mm², none when commissioned"


def test_growth_of_what_is_declared_is_said_with_what_was_declared() -> None:
    force, gain = Interval(0.8, 0.02, 0.76, 0.84), Interval(0.9, 0.002, 0.896, 0.904)
    grown = found(("coulomb_friction",), {"coulomb_friction.force": force}, declared={"coulomb_friction.force": 0.3})
    assert finding_words(grown) == "Coulomb friction 0.800 ± 0.020 N, declared 0.300 N"
    spring = found(("valve.seat_load",), {"valve.seat_load": force}, declared={"valve.seat_load": 0.5})
    assert finding_words(spring) == "Seat load 0.800 ± 0.020 N, declared 0.500 N"
    clogged = found(("pilot_clogging",), {"pilot_clogging.ratio": gain}, declared={"pilot_clogging.ratio": 0.95})
    assert finding_words(clogged) == "pilot orifice at 90.00 ± 0.20 % of its full size, declared 0.950"
    rebounds = {"stop_bounce.restitution_stop": gain, "stop_bounce.restitution_seat": gain}
    bounce = found(("stop_bounce",), rebounds, declared={name: 0.3 for name in rebounds})
    assert finding_words(bounce).count("0.9000 ± 0.0020, declared 0.300") == 2
    told = finding_json(grown, Occasion("/tank_2/valve", 31, 0))
    assert told["was"]["coulomb_friction.force"] == 0.3


def test_what_is_not_certain_is_not_said_as_if_it_were() -> None:
    force = {"coulomb_friction.force": Interval(0.31, 0.02, 0.27, 0.35)}
    hedged = found(("coulomb_friction",), force, alike=("stiction",), kind="insufficient")
    assert finding_words(hedged) == (
        "the strokes cannot tell what has changed; the most probable: Coulomb friction 0.310 ± 0.020 N, none when "
        "commissioned (stiction would explain it about as well)"
    )
    assert finding_words(found((), {}, kind="insufficient")).endswith("the most probable: no change at all")


def test_a_finding_is_told_with_valve_stroke_time_and_probability() -> None:
    occasion = Occasion("/tank_1/valve", 31, 1_764_000_000_123_456_789)
    friction = found(("coulomb_friction",), {"coulomb_friction.force": Interval(0.31, 0.02, 0.27, 0.35)})
    words = (
        "/tank_1/valve, stroke 31 at 2025-11-24T16:00:00.123Z: Coulomb friction 0.310 ± 0.020 N, none when "
        "commissioned; probability 90 %"
    )
    assert told_finding(friction, occasion) == words
    told = finding_json(friction, occasion)
    assert told["summary"] == words
    assert (told["valve"], told["stroke"], told["probability"]) == ("/tank_1/valve", 31, 0.9)
    assert told["time"] == pytest.approx(1_764_000_000.123456789, abs=1e-6)
    assert told_finding(found((), {}, kind="none"), occasion).endswith("those at commissioning; probability 90 %")
