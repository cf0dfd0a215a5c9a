"""The page that people look at: what it says, that it draws in a browser, and that it asks no network."""

from __future__ import annotations

import html
import json
import re
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from identification.browser import CHROMIUM, Browser
from identification.recordings import friction_found
from valve_sim.files.parameter_files import load_valve
from valve_sim.identification.diagnosis.run import Diagnosis
from valve_sim.identification.plants.protocol import Plant
from valve_sim.identification.plants.valve import STROKE_LEVELS
from valve_sim.identification.reporting import strokes as curves
from valve_sim.identification.reporting.claims import headline, summarise
from valve_sim.identification.reporting.diagnosis_document import SHOWN_STROKES, diagnosis_document
from valve_sim.identification.reporting.files import write_diagnosis
from valve_sim.identification.reporting.page import write_page
from valve_sim.identification.reporting.strokes import StrokeCurves, keep_extremes, strokes_of
from valve_sim.model import CATALOGUE, ValveError
from valve_sim.recordings.synthetic import read_profile

LARGEST_PAGE = 8_000_000
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed to open the report in")


@pytest.fixture(scope="module")
def diagnosis() -> Diagnosis:
    return friction_found()


@pytest.fixture
def page(diagnosis: Diagnosis, tmp_path: Path) -> Path:
    path = tmp_path / "report.html"
    write_page(diagnosis_document(diagnosis, provenance="valve-sim diagnose strokes.mcap"), path)
    return path


def test_the_page_says_what_was_found(diagnosis: Diagnosis, page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert f"<h1>{headline(diagnosis)}</h1>" in text
    assert summarise(diagnosis) in text
    for words in (CATALOGUE["coulomb_friction"].on_a_real_valve, CATALOGUE["coulomb_friction"].what_to_do):
        assert words in text
    assert "coulomb_friction.force" in text
    assert all(" + ".join(candidate.effects) in text for candidate in diagnosis.candidates)
    values = [part for cell in re.findall(r'data-label="values">([^<]*)<', text) for part in cell.split("; ") if part]
    assert values
    assert [part for part in values if not re.match(r"[a-z0-9 ]+ (−?[0-9]|∞|not determined)", part)] == []
    assert '<tr class="chosen"><td>Coulomb friction <code' in text
    assert all(name in text for name in diagnosis.sources)
    assert "valve-sim diagnose strokes.mcap" in text


def test_root_mean_squares_of_strokes_add_up_to_those_of_the_diagnosis(diagnosis: Diagnosis) -> None:
    strokes = [stroke for stroke in strokes_of(diagnosis) if not stroke.is_held_out]
    squares = sum(len(stroke.time) * stroke.root_mean_squares[0] ** 2 for stroke in strokes)
    count = sum(len(stroke.time) for stroke in strokes)
    assert (squares / count) ** 0.5 == pytest.approx(1e6 * diagnosis.before.train_rmse, rel=1e-9)


def test_thinning_keeps_the_extremes_and_the_ends() -> None:
    values = np.random.default_rng(1).normal(size=20000)
    values[12345] = 40.0
    kept = keep_extremes((values, -values), 100)
    assert len(kept) <= 100
    assert {0, 12345, int(np.argmin(values)), 19999} <= set(kept.tolist())


def with_strokes(monkeypatch: pytest.MonkeyPatch, strokes: list[StrokeCurves]) -> None:
    monkeypatch.setattr(curves, "strokes_of", lambda _: strokes)


def test_a_hundred_strokes_fit_into_eight_megabytes(
    diagnosis: Diagnosis, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with_strokes(monkeypatch, (curves.strokes_of(diagnosis) * 7)[:100])
    path = tmp_path / "report.html"
    write_page(diagnosis_document(diagnosis), path)
    assert path.read_text(encoding="utf-8").count("<figure data-plot=") == 100
    assert path.stat().st_size <= LARGEST_PAGE


def test_a_page_that_cannot_be_written_is_one_clear_error(diagnosis: Diagnosis, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ValveError, match="cannot be written"):
        write_page(diagnosis_document(diagnosis), tmp_path / "file" / "report.html")


def test_all_files_of_a_diagnosis_are_written_and_nothing_else(diagnosis: Diagnosis, tmp_path: Path) -> None:
    certain = replace(diagnosis, verdict=replace(diagnosis.verdict, confusable_with={}))
    written = write_diagnosis(certain, tmp_path / "results", "by a test")
    assert sorted(path.name for path in written) == ["corrected.yaml", "report.html", "report.json"]
    assert sorted((tmp_path / "results").iterdir()) == sorted(written)
    assert json.loads(written[0].read_text())["verdict"]["effects"] == ["coulomb_friction"]
    assert load_valve(tmp_path / "results" / "corrected.yaml") == diagnosis.valve


def test_the_next_recording_is_a_profile_in_the_folder_while_there_is_something_to_tell_apart(
    diagnosis: Diagnosis, tmp_path: Path
) -> None:
    unsure = replace(diagnosis.verdict, confusable_with={"coulomb_friction": ("stiction",)})
    doubtful = write_diagnosis(replace(diagnosis, verdict=unsure, recommendation=None), tmp_path, "by a test")
    assert doubtful[-1].name == "record_next.yaml"
    assert len(read_profile(doubtful[-1]).times) == 2 * len(STROKE_LEVELS)
    assert json.loads(doubtful[0].read_text())["record_next_gain"] is None
    page, header = doubtful[1].read_text(), doubtful[-1].read_text()
    for program in (
        "valve-sim simulate --profile ",
        "ros2 run valve_sim command_profile --ros-args -p profile:=",
    ):
        typed = f"{program}{shlex.quote(str(doubtful[-1]))}"
        assert typed + " " in header
        assert typed + " " in html.unescape(page)
    duration = re.search(r"--duration ([\d.]+)", page)
    assert duration is not None
    assert f"--duration {duration[1]} " in header
    assert float(duration[1]) > float(read_profile(doubtful[-1]).times[-1])
    certain = replace(diagnosis.verdict, confusable_with={})
    write_diagnosis(replace(diagnosis, verdict=certain), tmp_path, "by a test")
    assert not doubtful[-1].exists()


def test_commands_are_for_the_valve_that_was_diagnosed(diagnosis: Diagnosis, tmp_path: Path) -> None:
    unsure = replace(diagnosis.verdict, confusable_with={"coulomb_friction": ("stiction",)})
    options = "--params 'my valve.yaml' --map map.yaml --valve /tank_1/valve"
    _, page, _, profile = write_diagnosis(replace(diagnosis, verdict=unsure), tmp_path, "by a test", options=options)
    told, header = html.unescape(page.read_text()), profile.read_text()
    for text in (told, header):
        (simulate,) = re.findall(r" simulate --profile .*", text)
        assert "--params 'my valve.yaml'" in simulate and "--map" not in simulate
    (check,) = re.findall(r" validate ANOTHER_RECORDING .*", told)
    assert check.endswith("corrected.yaml --map map.yaml --valve /tank_1/valve")
    assert f" diagnose OLD NEW {options} --output results" in header


class OtherMachine:
    """A plant that is no valve: it has no corrected file, and no voltages drive it."""

    wording, stroke_voltages, save_corrected = Plant.wording, Plant.stroke_voltages, Plant.save_corrected

    def __init__(self, plant: Any) -> None:
        self._plant = plant

    def __getattr__(self, name: str) -> Any:
        return getattr(self._plant, name)


def test_another_machine_has_no_corrected_valve(diagnosis: Diagnosis, tmp_path: Path) -> None:
    written = write_diagnosis(replace(diagnosis, plant=OtherMachine(diagnosis.plant)), tmp_path, "by a test")
    assert sorted(path.name for path in written) == ["report.html", "report.json"]


@pytest.mark.long
@needs_chromium
def test_the_page_draws_in_a_browser_without_errors_or_requests(
    diagnosis: Diagnosis, page: Path, tmp_path: Path
) -> None:
    with Browser(page, tmp_path) as browser:
        browser.show(1280)
        tree = browser.evaluate("document.documentElement.outerHTML")
        requests = browser.evaluate("performance.getEntriesByType('resource').map(entry => entry.name)")
        errors = browser.errors
    plots = SHOWN_STROKES + len(diagnosis.maps)
    assert f'data-drawn="{plots}"' in tree
    curves = [int(count) for count in re.findall(r'data-points="(\d+)"', tree)]
    assert len(curves) == 5 * SHOWN_STROKES + len(diagnosis.maps)
    assert min(curves) > 50
    drawings = re.findall(r"<svg.*?</svg>", tree, re.DOTALL)
    numbers = [axis.count('class="tick"') for drawing in drawings for axis in drawing.split('class="frame"')[:-1]]
    assert min(numbers) >= 2, "one number is no scale"
    assert "NaN" not in tree
    assert errors == []
    assert [url for url in requests if not url.startswith(("file:", "data:"))] == []


@pytest.mark.long
@needs_chromium
def test_strokes_can_be_compared_and_what_was_tried_sorts(diagnosis: Diagnosis, page: Path, tmp_path: Path) -> None:
    with Browser(page, tmp_path) as browser:
        browser.show(1280)

        def curves(name: str) -> int:
            return int(browser.evaluate(f"document.querySelectorAll('path.{name}').length"))

        before = curves("before")
        browser.evaluate("document.querySelector('.legend input[value=before]').click()")
        assert (before, curves("before")) == (2 * SHOWN_STROKES, 0)
        assert curves("measured") == SHOWN_STROKES
        browser.evaluate("document.querySelector('.legend input[value=alike]').click()")
        zoomed = browser.evaluate("""(() => {
          const [first, second] = document.querySelectorAll("figure svg"), box = first.getBoundingClientRect();
          first.setPointerCapture = () => {};
          const at = part => ({clientX: box.left + part * box.width});
          const drag = (kind, part) => first.dispatchEvent(new PointerEvent(kind, at(part)));
          const labels = () => second.textContent;
          const whole = labels();
          drag("pointerdown", 0.3); drag("pointermove", 0.5); drag("pointerup", 0.5);
          return whole !== labels();
        })()""")
        assert zoomed, "the second stroke has the zoom of the first"
        gains = """(() => {
          document.querySelectorAll("table[data-sort] th")[3].click();
          const rows = [...document.querySelector("table[data-sort]").tBodies[0].rows];
          return rows.map(row => parseFloat(row.cells[3].textContent.replace("−", "-").replace("<", "")));
        })()"""
        first, second = browser.evaluate(gains), browser.evaluate(gains)
        assert first == sorted(first, reverse=True) and second == first[::-1]
        assert browser.errors == []


@pytest.fixture
def doubtful(diagnosis: Diagnosis) -> Diagnosis:
    """A diagnosis with less certainty, and with more words of every kind."""
    every = tuple(name for name, entry in CATALOGUE.items() if entry.named and name != "coulomb_friction")
    verdict = replace(diagnosis.verdict, probability=0.38, confusable_with={"coulomb_friction": every})
    return replace(diagnosis, verdict=verdict)


WIDER_THAN_THE_SCREEN = """
[...document.querySelectorAll("main *")].filter(element => !element.closest("svg")).filter(element => {
  const box = element.getBoundingClientRect();
  const isCut = element.clientWidth > 0 && element.scrollWidth > element.clientWidth + 1;
  return box.right > innerWidth + 0.5 || box.left < -0.5 || isCut;
}).map(element => element.outerHTML.slice(0, 120))
"""
CUT_LABELS = """
[...document.querySelectorAll("svg text")].filter(text => {
  const box = text.getBoundingClientRect(), around = text.closest("svg").getBoundingClientRect();
  return box.left < around.left - 0.5 || box.right > around.right + 0.5 || box.bottom > around.bottom + 0.5;
}).map(text => text.textContent)
"""


@pytest.mark.long
@needs_chromium
@pytest.mark.parametrize("width", [390, 1280])
def test_nothing_is_cut_off_on_a_narrow_screen_or_a_wide_one(doubtful: Diagnosis, tmp_path: Path, width: int) -> None:
    document = diagnosis_document(doubtful, provenance="Written by: valve-sim diagnose " + "a_long_name/" * 20)
    write_page(document, tmp_path / "report.html")
    with Browser(tmp_path / "report.html", tmp_path) as browser:
        browser.show(width)
        browser.evaluate("document.querySelectorAll('details').forEach(folded => { folded.open = true; })")
        assert browser.evaluate("document.documentElement.scrollWidth") == width
        assert browser.evaluate(WIDER_THAN_THE_SCREEN) == []
        assert browser.evaluate(CUT_LABELS) == []
        smallest = browser.evaluate(
            "Math.min(...[...document.querySelectorAll('svg text')].map(text => text.getBoundingClientRect().height))"
        )
        assert smallest > 9.0, "letters of the plots are too small to read"


@pytest.mark.long
@needs_chromium
def test_what_is_more_likely_wrong_than_right_is_neither_green_nor_found(
    diagnosis: Diagnosis, doubtful: Diagnosis, tmp_path: Path
) -> None:
    sure = replace(diagnosis, verdict=replace(diagnosis.verdict, probability=0.97))
    shown = {}
    for name, said in (("sure", sure), ("doubtful", doubtful)):
        write_page(diagnosis_document(said), tmp_path / f"{name}.html")
        with Browser(tmp_path / f"{name}.html", tmp_path / name) as browser:
            browser.show(1280)
            shown[name] = browser.evaluate(
                "[document.querySelector('.kind')].map(kind => [kind.textContent, getComputedStyle(kind).color])[0]"
            )
    assert "found" in shown["sure"][0]
    assert shown["sure"][1] == "rgb(26, 127, 75)"
    assert "found" not in shown["doubtful"][0]
    assert "probability 38 %" in shown["doubtful"][0]
    assert shown["doubtful"][1] == "rgb(160, 100, 0)"
