"""What holds for anything: drawn recordings, valves, cuts, orders and names. The draws are the same each time."""

from __future__ import annotations

import functools
import json
import math
import tempfile
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from identification.recordings import COARSER, friction_found, recorded
from model.core.cases import DRAWN, drawn
from recordings.bag_makers import EPOCH, FLOAT, STROKE, Message, good_messages, make_mcap

from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.diagnosis.identify import identify
from valve_sim.identification.diagnosis.run import Diagnosis
from valve_sim.identification.reporting import strokes
from valve_sim.identification.reporting.diagnosis_document import diagnosis_document
from valve_sim.identification.reporting.page import write_page
from valve_sim.model import CATALOGUE, Drive, Reading, Response, Stepper, simulate
from valve_sim.recordings import CSV_COLUMNS, Signal, Trace, read_trace, write_bag, write_csv

NANOSECOND = 1e-9
NOTHING = Drive.of([], [])
SEEDS = st.integers(0, 2**32)
STEPS = (10_000, 1_000_000)
"""ns between samples, and between commands."""


def random_trace(seed: int) -> Trace:
    """A recording of anything that a sensor can show: times in whole nanoseconds, values that never repeat."""
    random = np.random.default_rng(seed)

    def stamps(count: int) -> np.ndarray:
        return np.cumsum(random.integers(*STEPS, count)) * NANOSECOND

    count, commands = random.integers(8, 60), random.integers(1, 7)
    signals = {
        name: Signal(stamps(count), random.uniform(-size, size, count))
        for name, size in (("coil_current", 2.0), ("acceleration", 500.0), ("coil_temperature", 90.0))
        if random.random() < 0.5
    }
    pilot, main = random.uniform(-0.1 * STROKE, 1.1 * STROKE, (2, count))
    drive = Drive(stamps(commands), np.round(random.uniform(-30.0, 30.0, commands), 3))
    return Trace(
        "drawn", drive, stamps(count), pilot, main if random.random() < 0.5 else None, epoch_ns=EPOCH, **signals
    )


def absolute(trace: Trace, times: np.ndarray) -> np.ndarray:
    """ns since 1970."""
    return trace.epoch_ns + np.rint(times / NANOSECOND).astype(np.int64)


def same(found: Trace, expected: Trace) -> bool:
    """Whether two traces say the same, to the nanosecond and to the last bit."""

    def equal(a: Any, b: Any) -> bool:
        return (a is None) == (b is None) and (a is None or np.array_equal(a, b))

    names = found.signals().keys() | expected.signals().keys()
    signals = [(found.signals().get(name), expected.signals().get(name)) for name in names]
    return (
        equal(absolute(found, found.times), absolute(expected, expected.times))
        and equal(found.pilot_position, expected.pilot_position)
        and equal(found.main_position, expected.main_position)
        and equal(absolute(found, found.drive.times), absolute(expected, expected.drive.times))
        and equal(found.drive.volts, expected.drive.volts)
        and all(
            a is not None and b is not None
            and equal(absolute(found, a.times), absolute(expected, b.times)) and equal(a.values, b.values)
            for a, b in signals
        )
    )  # fmt: skip


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("bare.mcap", {}),
        ("packed.mcap", {"compressed": True}),
        ("folder", {}),
        ("database", {"storage": "sqlite3"}),
        ("packed_database", {"storage": "sqlite3", "compressed": True}),
    ],
)
@settings(max_examples=12)
@given(seed=SEEDS)
def test_a_bag_that_is_written_is_read_as_it_was(name: str, options: dict[str, Any], seed: int) -> None:
    trace = random_trace(seed)
    with tempfile.TemporaryDirectory() as folder:
        write_bag(Path(folder) / name, trace, **options)
        found = read_trace(Path(folder) / name)
        assert [path.name for path in Path(folder).iterdir()] == [name]
    assert same(found, trace)


@settings(max_examples=30)
@given(seed=SEEDS)
def test_a_table_that_is_written_is_read_as_it_was(seed: int) -> None:
    trace, random = random_trace(seed), np.random.default_rng(seed)
    count, zeros = len(trace.times), np.zeros(len(trace.times))
    volts = np.repeat(random.permutation((0.0, 9.0, 12.0, 5.0)), -(-count // 4))[:count]
    current, main = random.uniform(-2.0, 2.0, (2, count))
    columns = (trace.times, volts, current, trace.pilot_position, main, zeros, zeros)
    with tempfile.TemporaryDirectory() as folder:
        write_csv(Path(folder) / "a.csv", dict(zip(CSV_COLUMNS, columns, strict=True)))
        found = read_trace(Path(folder) / "a.csv")
    steps = np.flatnonzero(np.diff(volts, prepend=math.nan))
    assert np.array_equal(found.drive.volts, volts[steps])
    between = absolute(trace, trace.times[steps]) - EPOCH - absolute(found, found.drive.times)
    gaps = np.diff(absolute(trace, trace.times), prepend=absolute(trace, trace.times)[0])
    assert ((between >= 0) & (between <= gaps[steps])).all(), "a command lies between the rows that show it"
    signals = {name: None for name in trace.signals()} | {"coil_current": Signal(trace.times, current)}
    expected = replace(trace, drive=NOTHING, main_position=main, epoch_ns=0, **signals)
    assert same(replace(found, drive=NOTHING), expected)


# --- cuts ---


COLUMNS = (
    "pilot_position", "main_position", "pilot_velocity", "coil_current", "attraction", "phase", "coil_voltage",
    "outlet_pressure", "mass_flow",
)  # fmt: skip


@pytest.mark.parametrize("kind", DRAWN)
@settings(max_examples=12)
@given(seed=st.integers(0, 10_000), cuts=st.lists(st.floats(0.0, 1.0), max_size=6).map(sorted))
def test_a_run_that_is_cut_anywhere_is_the_same_run(kind: str, seed: int, cuts: list[float]) -> None:
    """A cut looks at the valve, and goes on with a copy of it; the other one is driven elsewhere."""
    valve, drive, times = drawn(kind, seed)
    whole = simulate(valve, drive, times)
    start = float(min(drive.times[0], times[0]))
    acts: list[tuple[float, int, float]] = [(time, 0, math.nan) for time in times.tolist()]
    acts += [(start + cut * (times[-1] - start), 1, math.nan) for cut in cuts]
    acts += [(time, 2, volts) for time, volts in zip(drive.times.tolist(), drive.volts.tolist(), strict=True)]
    stepper, events, shown = Stepper(valve, start), [], list[Reading]()
    for time, act, volts in sorted(acts):
        if act == 2:
            stepper.command(time, volts)
            continue
        reading = stepper.advance(time)
        events += reading.events
        if act == 0:
            shown.append(reading)
            continue
        other, stepper = stepper, stepper.copy()
        other.command(time, 30.0)
        other.advance(time + 1e-3)
    assert tuple(events) == whole.events
    for name in COLUMNS:
        expected = of(whole, name)
        found = np.array([getattr(reading, name) for reading in shown])
        assert np.array_equal(found, np.full(len(times), np.nan) if expected is None else expected, equal_nan=True)


def of(response: Response, name: str) -> np.ndarray | None:
    found = getattr(response, name)
    return None if found is None else np.asarray(found)


# --- the order of messages ---


@functools.cache
def plain() -> tuple[tuple[Message, ...], Trace]:
    """The messages of a short recording, and what they say in order."""
    messages = tuple(good_messages(duration=0.06))[:300]
    with tempfile.TemporaryDirectory() as folder:
        trace = read_trace(make_mcap(Path(folder) / "a.mcap", list(messages)))
    assert trace.findings == ()
    return messages, trace


@settings(max_examples=40)
@given(
    seed=SEEDS, share=st.sampled_from((0.0, 0.01, 0.3)), late=st.sampled_from((0, 100_000, 50_000_000)),
    is_shuffled=st.booleans(),
)  # fmt: skip
def test_messages_in_any_order_or_twice_are_the_same_trace(
    seed: int, share: float, late: int, is_shuffled: bool
) -> None:
    """Messages that come late, in another order, or twice; a command has no stamp, and is not delayed."""
    random = np.random.default_rng(seed)
    messages, expected = plain()
    sent = [*messages, *(message for message in messages if random.random() < share)]
    delays = [0 if message.type == FLOAT else int(random.integers(late + 1)) for message in sent]
    sent = [message._replace(time=message.time + delay) for message, delay in zip(sent, delays, strict=True)]
    order = random.permutation(len(sent)).tolist() if is_shuffled else range(len(sent))
    with tempfile.TemporaryDirectory() as folder:
        found = read_trace(make_mcap(Path(folder) / "a.mcap", [sent[place] for place in order]))
    assert same(found, expected)


# --- names ---


class Page(HTMLParser):
    """What a browser makes of a page: its elements, the attributes that run scripts, and its scripts."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements, self.handlers, self.scripts = list[str](), list[str](), list[str]()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append(tag)
        self.handlers += [name for name, value in attrs if name.startswith("on") or "javascript:" in (value or "")]
        if tag == "script":
            self.scripts.append("")

    def handle_data(self, data: str) -> None:
        if self.elements and self.elements[-1] == "script":
            self.scripts[-1] += data


@functools.cache
def harmless() -> tuple[Diagnosis, Page]:
    """A diagnosis that is not sure of its effect, and its page where all is called `valve`."""
    found = friction_found()
    unsure = replace(found, verdict=replace(found.verdict, confusable_with={"coulomb_friction": ("stiction",)}))
    return unsure, named_page(unsure, "valve")


def named_page(found: Diagnosis, name: str) -> Page:
    """The page of a diagnosis whose recording, valve, channel, stroke, effect and command line are all called so."""
    friction = replace(CATALOGUE["coulomb_friction"], title=name, on_a_real_valve=name, what_to_do=name)
    stroke = strokes.strokes_of(found)[0]._replace(title=name, quantity=name)
    with (
        tempfile.TemporaryDirectory() as folder,
        patch.dict(CATALOGUE._entries, {"coulomb_friction": friction}),
        patch.object(strokes, "strokes_of", lambda _: [stroke]),
    ):
        path = Path(folder) / "report.html"
        write_page(diagnosis_document(replace(found, sources=(name,)), provenance=name), path)
        return Page(path.read_text(encoding="utf-8"))


MARKUP = ("<", ">", '"', "'", "&", "</script>", "<script>", "<!--", "-->", "<img src=x onerror=a()>", "{{", "}}")


@settings(max_examples=12)
@given(parts=st.lists(st.one_of(st.sampled_from(MARKUP), st.text(max_size=4)), min_size=1, max_size=8))
def test_any_text_as_a_name_leaves_the_page_as_it_is(parts: list[str]) -> None:
    unsure, expected = harmless()
    found = named_page(unsure, "".join(parts) or "valve")
    assert found.elements == expected.elements and found.handlers == []
    shapes = [[[*plot] for plot in json.loads(page.scripts[0])] for page in (found, expected)]
    assert shapes[0] == shapes[1]
    assert found.scripts[1:] == expected.scripts[1:]


# --- what a fit finds ---


@settings(max_examples=5)
@given(seed=SEEDS)
def test_a_refit_finds_what_was_simulated_within_its_errors(seed: int) -> None:
    """The recording is of an independent plant, with noise; the parameters are random."""
    random = np.random.default_rng(seed)
    truth = {
        "pilot_damping": random.uniform(0.5, 2.5),
        "main_damping": random.uniform(2.0, 6.0),
        "spring_preload": random.uniform(2.2, 2.8),
    }
    found = identify([recorded(COARSER, seed=seed % 1000, **truth)], default_valve().exact(), sorted(truth))
    for name, value in truth.items():
        interval = found.intervals[name]
        assert abs(interval.value - value) < 4.0 * interval.stderr, name
        assert interval.stderr < 0.1 * value, name
    assert found.fit.chi2 / found.fit.problem.effective_samples == pytest.approx(1.0, abs=0.2), "what is left is noise"
