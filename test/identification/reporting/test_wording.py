"""Verdicts in plain words: values with the unit that people read, and no name of code where a title is due."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import pytest
from plants.recording import Recorder

from identification.recordings import friction_found, recorded
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.diagnosis.run import Diagnosis, diagnose
from valve_sim.identification.fit.declared_values import DeclaredValue, out_of_tolerance
from valve_sim.identification.fit.intervals import Interval, Unbounded
from valve_sim.identification.plants.effect_titles import title_of
from valve_sim.identification.reporting.claims import (
    certainty,
    headline,
    meaning_entry,
    meanings,
    recording_advice,
    rounding_words,
    summarise,
)
from valve_sim.identification.reporting.diagnosis_document import diagnosis_document
from valve_sim.identification.reporting.document import Words
from valve_sim.identification.reporting.units import amount, gain_words, limits, measured, percent, quantity, signed
from valve_sim.identification.reporting.values import amount_words, declared_section, remark_on, summary_words
from valve_sim.model import CATALOGUE
from valve_sim.model.effects.entry import Severity

NAMED = [name for name, entry in CATALOGUE.items() if entry.named]
UNITS = sorted({parameter.unit for entry in CATALOGUE.values() for parameter in entry.parameters} - {"–"})


@pytest.fixture(scope="module")
def diagnosis() -> Diagnosis:
    return friction_found()


@pytest.mark.parametrize(
    ("value", "unit", "words"),
    [
        (1.04e-6, "m", "1.04 µm"),
        (1.23e-3, "m", "1.23 mm"),
        (-5.0e-6, "m", "−5.00 µm"),
        (6e-3, "s", "6.00 ms"),
        (50e-6, "s", "50.0 µs"),
        (3.7, "s", "3.70 s"),
        (0.0, "m", "0.00 µm"),
        (math.inf, "–", "∞"),
        (math.inf, "Hz", "∞"),
        (1.02, "–", "1.02"),
        (-6.76e7, "N/m³", "−6.76·10⁷ N/m³"),
        (0.1, "N", "0.100 N"),
        (math.nan, "N", "–"),
    ],
)
def test_a_value_has_the_unit_that_people_read(value: float, unit: str, words: str) -> None:
    assert quantity(value, unit) == words


@pytest.mark.parametrize("unit", UNITS)
def test_every_value_of_the_catalogue_has_a_unit(unit: str) -> None:
    values = [(value, Interval(value, 0.1 * value + 1e-9, 0.8 * value, math.inf)) for value in (0.0, 1.04e-6, 3e5)]
    told = [(quantity(value, unit), measured(found, unit), limits(found, unit)) for value, found in values]
    for words in itertools.chain(*told):
        assert words.split(" ")[-1][-1] == unit[-1]
        assert "e-" not in words
        assert "inf" not in words


def test_a_value_has_as_many_digits_as_its_error() -> None:
    assert measured(Interval(0.0047292, 0.00064, 0.0035, 0.0060), "N") == "0.00473 ± 0.00064 N"
    assert measured(Interval(1.04e-6, 0.13e-6, 0.8e-6, 1.3e-6), "m") == "1.04 ± 0.13 µm"


@pytest.mark.parametrize(("kind", "probability"), [("effects", 0.33), ("unknown", 0.7), ("insufficient", 0.99)])
def test_headlines_have_no_names_of_code(diagnosis: Diagnosis, kind: str, probability: float) -> None:
    for name in NAMED:
        verdict = diagnosis.verdict
        verdict = replace(
            verdict, kind=kind, effects=(name,), probability=probability, confusable_with={name: tuple(NAMED)}
        )
        words = headline(replace(diagnosis, verdict=verdict))
        assert "_" not in words
        assert words[0].isupper()
        assert words.endswith(".")
        assert title_of(name).lower() in words.lower()


def test_what_acts_like_a_name_and_what_also_changed_are_told_apart(diagnosis: Diagnosis) -> None:
    (grade,) = diagnosis.grades
    also = [grade._replace(effect=name, word="possible") for name in ("stop_bounce", "coulomb_friction")]
    like = grade._replace(effect="eddy_lag", word="acts_like")
    partly = replace(diagnosis, verdict=replace(diagnosis.verdict, kind="partly"), grades=(like, *also))
    told = headline(partly)
    assert told.startswith("Corrected. The machine acts as if it had eddy currents: the error of unseen strokes falls")
    assert told.endswith("Bounce and Coulomb friction also changed, and may stand for something else.")


@pytest.mark.parametrize(("probability", "words"), [(1.0, "> 99 %"), (0.5, "50 %"), (0.0, "< 1 %")])
def test_nothing_is_said_to_be_certain(probability: float, words: str) -> None:
    assert percent(probability) == words


@pytest.mark.long
def test_what_is_off_is_said_beside_what_was_declared() -> None:
    valve = default_valve().exact()
    trace = recorded(Recorder(quantisation=0.1e-6), effects={"coulomb_friction": {"force": 0.1}})
    declared = replace(valve, effects={"coulomb_friction": {"force": 0.03}})
    grown = diagnose([trace], [], declared)
    assert grown.verdict.effects == ("coulomb_friction",)
    assert headline(grown).startswith("The model declares another size of Coulomb friction: 0.10")
    assert "declared 0.0300 N" in headline(grown)


def test_nothing_is_advised_where_nothing_is_open(diagnosis: Diagnosis) -> None:
    certain = replace(diagnosis, verdict=replace(diagnosis.verdict, confusable_with={"coulomb_friction": ()}))
    assert not certain.verdict.is_open
    assert recording_advice(certain) == ""
    assert diagnosis_document(certain).to_json()["record_next"] is None


def test_the_terminal_says_title_amount_unit_and_what_to_do(diagnosis: Diagnosis) -> None:
    text = diagnosis_document(diagnosis).to_text()
    entry = CATALOGUE["coulomb_friction"]
    assert text.replace("\n", "").isprintable(), "a terminal would show marks in place of some letters"
    assert text.startswith("effects: The model lacks Coulomb friction: 0.100")
    assert "  Coulomb friction (coulomb_friction)\n    How much: friction force 0.100" in text
    for words in (" N, 4 % of the spring preload", entry.on_a_real_valve, entry.what_to_do):
        assert words in text
    values = [line for line in text.splitlines() if " ± " in line and ":" not in line]
    assert [line.split()[0] for line in values] == ["pilot_damping", "main_damping", "coulomb_friction.force"]
    assert [line.split()[-1] for line in values] == ["N·s/m", "N·s/m", "N"]


def test_a_guess_is_called_a_guess(diagnosis: Diagnosis) -> None:
    guess = replace(diagnosis, verdict=replace(diagnosis.verdict, probability=0.38, confusable_with={}))
    assert certainty(guess.verdict) == ("A first guess, more likely wrong than right", False)
    assert headline(guess).startswith("Perhaps the model lacks Coulomb friction")
    alike = replace(guess.verdict, confusable_with={"coulomb_friction": ("stiction",)})
    assert certainty(alike) == ("A first guess among look-alikes", False)


def test_the_report_for_programs_has_the_same_words(diagnosis: Diagnosis) -> None:
    report = diagnosis_document(diagnosis).to_json()
    assert report["verdict"]["headline"] == headline(diagnosis)
    force, told = diagnosis.after.intervals["coulomb_friction.force"], report["after"]["effects"]["coulomb_friction"]
    assert told["force"]["stderr"] == force.stderr
    assert told["force"]["ci95"] == [force.low, force.high]
    assert told["force"]["was"] == 0.0
    meaning = report["meaning"]["coulomb_friction"]
    assert meaning["severity"] == "4 % of the spring preload"
    assert meaning["what_to_do"] == CATALOGUE["coulomb_friction"].what_to_do


def test_a_deviation_inside_its_own_error_is_none() -> None:
    """A spring rate of 1264 ± 666 N/m says nothing of a declared 2000, however tight the tolerance is."""
    loose = DeclaredValue("spring_rate", "N/m", 2000.0, 40.0, 1264.3, 666.0, -18.4, 16.65)
    tight = loose._replace(stderr=20.0, spread=0.5)
    assert out_of_tolerance([loose]) == [] and out_of_tolerance([tight]) == ["spring_rate"]
    assert "tolerances" not in amount_words(loose)
    assert amount_words(loose).startswith("1264 ± 666 N/m, which agrees with the declared 2000")
    assert amount_words(tight) == "1264 ± 20 N/m, not 2000: 18.4 tolerances"
    assert amount_words(loose) in summary_words([loose])
    assert not any(block.style == "doubt" for block in declared_section([loose]).blocks if isinstance(block, Words))


@pytest.mark.parametrize(
    ("share", "words"), [(1.0, "100 %"), (12.34, "1200 %"), (0.097, "9.7 %"), (0.04, "4 %"), (1e-6, "0.0001 %")]
)
def test_a_size_beside_something_known_has_no_exponent(share: float, words: str) -> None:
    assert str(Severity(share, "the spring preload")) == f"{words} of the spring preload"


@pytest.mark.parametrize(
    ("odds", "words"), [(12.34, "+12.3"), (-0.04, "0.0"), (-138341.9, "< −1000"), (138341.9, "+138342")]
)
def test_evidence_is_told_to_the_digits_that_matter(odds: float, words: str) -> None:
    assert gain_words(odds) == words


def test_where_a_standard_error_does_not_describe_the_interval_the_interval_is_told() -> None:
    assert amount(Interval(0.136, 0.013, 0.111, 0.161), "N") == "0.136 ± 0.013 N"
    assert amount(Interval(0.136, 0.013, 0.06, 0.21), "N") == "0.136 N (95 %: 0.06000 to 0.2100 N)"


def test_what_one_of_several_effects_explains_is_a_statement_of_its_own(diagnosis: Diagnosis) -> None:
    worth = "less than 1 % of the improvement"
    meaning = meanings(diagnosis)["coulomb_friction"]
    meaning["amounts"]["explains"] = worth
    told = meaning_entry("coulomb_friction", meaning, ()).blocks[0]
    assert isinstance(told, Words)
    assert told.text.endswith(f"4 % of the spring preload; it accounts for {worth}.")


def test_where_the_budget_ended_the_recording_is_not_blamed(diagnosis: Diagnosis) -> None:
    verdict = replace(diagnosis.verdict, kind="insufficient", effects=(), probability=1e-3, is_cut_short=True)
    ended = replace(diagnosis, verdict=verdict, untried=("coil lag",), allowed=6000.0)
    text = diagnosis_document(ended).to_text()
    assert "budget of 6,000 simulated strokes ended" in text and "--budget 3" in text
    assert "recordings cannot tell" not in text and "data cannot tell" not in text and "Record next" not in text
    assert "likeliest" not in text and "probability" not in text.splitlines()[1]
    rivals = replace(verdict, effects=("coil_lag",), confusable_with={"coil_lag": ("eddy_lag",)})
    untried = diagnosis_document(replace(ended, verdict=rivals)).to_text()
    assert "so far coil lag fits best." in untried and "ddy currents" not in untried, "it was never fitted"
    report = diagnosis_document(ended).to_json()
    assert (report["verdict"]["ended"], report["record_next"]) == ("budget", None)
    whole = replace(ended, verdict=replace(verdict, is_cut_short=False), untried=())
    assert "no set of effects is likelier than many others" in summarise(whole)
    assert diagnosis_document(whole).to_json()["verdict"]["ended"] is None


def test_an_error_that_grows_by_copies_of_a_rounding_error_is_explained(diagnosis: Diagnosis) -> None:
    assert rounding_words(diagnosis) == ""
    assert "rounded reading" not in diagnosis_document(diagnosis).to_text()
    larger = replace(diagnosis, after=replace(diagnosis.after, train_rmse=1.01 * diagnosis.before.train_rmse))
    errors = (quantity(state.train_rmse, "m") for state in (diagnosis.before, diagnosis.after))
    assert "counted once" in rounding_words(larger)
    assert " to ".join(errors) in rounding_words(larger)
    assert rounding_words(larger) in diagnosis_document(larger).to_text()


def test_a_correction_says_what_it_leaves_and_what_confirms_it(diagnosis: Diagnosis) -> None:
    told, found = diagnosis_document(diagnosis).to_json()["correction"], diagnosis.correction
    assert found is not None
    volts = {own.words: float(own.words.split(" V")[0]) for own in found.parts}
    assert told["valid_for"] == {"voltages": sorted({*volts.values()}), "lifts": "full", "profiles": [*volts]}
    left = math.sqrt(max(found.after**2 - found.noise**2, 0.0))
    assert told["remains"]["rms_um"] == pytest.approx(1e6 * left)
    assert told["remains"]["channel"] == "position"


@pytest.mark.parametrize(("value", "words"), [(1.25, "+1.250"), (-0.428, "−0.428"), (-0.0004, "0.000"), (0.0, "0.000")])
def test_a_minus_is_always_the_same_sign_and_nothing_has_none(value: float, words: str) -> None:
    assert signed(value, 3) == words


@pytest.mark.parametrize("found", [Interval(0.77919, 0.00081, 0.7626, 0.7872), Interval(4.147, 0.089, 3.678, 4.6)])
def test_an_interval_that_its_standard_error_does_not_explain_is_explained(found: Interval) -> None:
    assert "one standard error" in remark_on(found)
    assert "use the interval" in remark_on(found)


def test_an_interval_as_its_standard_error_says_needs_no_words() -> None:
    assert remark_on(Interval(1.0, 0.1, 0.81, 1.2)) == ""
    assert "flat" in remark_on(Interval(1.0, 0.1, 0.0, 9.0, Unbounded.FLAT_PROFILE))
