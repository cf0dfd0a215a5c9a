"""The picture of `info --plot`: what it shows of a recording, and that it is written."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from valve_sim.cli import main
from valve_sim.recordings import Trace, describe, events_from_sensors
from valve_sim.recordings.pictures import MOST_POINTS, draw_recordings, thinned

from .bag_makers import GAP, clean_trace


def drawn(*traces: Trace) -> list[tuple[Trace, object, object]]:
    return [(trace, describe(trace).strokes, events_from_sensors(trace, GAP)) for trace in traces]


def test_channels_strokes_arrivals_and_what_was_left_out_are_shown() -> None:
    trace = clean_trace(0.2)
    positions = trace.pilot_position.copy()
    positions[[300, 700]] += 300e-6
    positions[900:905] = 32.767e-3
    figure = draw_recordings(drawn(replace(trace, pilot_position=positions)))
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels == [
        "pilot plunger\nµm", "main plunger\nµm", "command, V", "pilot plunger, µm", "pilot plunger, µm",
    ]  # fmt: skip
    channel, _, command, openings, closings = figure.axes
    _, words = channel.get_legend_handles_labels()
    assert words == ["left out: 2 spikes", "left out: 5 codes"]
    assert max(command.lines[0].get_ydata()) == 9.0
    assert channel.get_ylim()[1] < 2000.0, "a code hides nothing"
    for axes, arrivals in ((openings, (6.0, 10.0)), (closings, (8.9, 10.0))):
        (seen,) = [[float(own.get_xdata()[0]) for own in axes.lines if own.get_marker() == "o"]]
        assert sorted(seen) == pytest.approx(arrivals, abs=0.1)


def test_recordings_stand_below_each_other_on_the_same_axes() -> None:
    figure = draw_recordings(drawn(clean_trace(), clean_trace(seed=2)))
    openings = [axes for axes in figure.axes if axes.get_title() == "openings beside each other"]
    assert len(openings) == 2
    assert openings[0].get_xlim() == openings[1].get_xlim()


def test_a_long_line_is_thinned_and_keeps_its_spikes() -> None:
    times = np.arange(1_000_003) * 1e-4
    values = np.sin(times)
    values[[123_456, 777_777]] = 5.0, -7.0
    fewer, seen = thinned(times, values)
    assert len(fewer) == len(seen) <= 1.01 * MOST_POINTS
    assert (np.diff(fewer) > 0.0).all()
    assert seen.max() == 5.0
    assert seen.min() == -7.0


@pytest.mark.parametrize("ending", ["png", "svg"])
def test_info_writes_the_picture(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"a.{ending}"
    result = CliRunner().invoke(main, ["info", "bags/friction", "bags/live.mcap", "--plot", str(path)])
    assert result.exit_code == 0, result.output
    assert result.stdout.endswith(f"wrote {path}\n")
    assert path.stat().st_size > 10_000
    refused = CliRunner().invoke(main, ["info", "bags/friction", "--plot", "/dev/null/a.png"])
    assert refused.exit_code == 2
