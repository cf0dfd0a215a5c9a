"""`valve-sim info`."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from valve_sim.cli.command_line import Command
from valve_sim.cli.options import FILE, bags_argument, json_option, map_option, params_option, valve_option
from valve_sim.cli.printing import print_json, progress_bar, shown
from valve_sim.cli.reading import chosen_map, declared_parameters, declared_valve
from valve_sim.files.json_text import plain

if TYPE_CHECKING:
    from valve_sim.files.recording_map import RecordingMap
    from valve_sim.identification.diagnosis.recording_state import RecordingState
    from valve_sim.recordings import StrokeEvents, StrokePart, Trace, TraceSummary


@click.command(cls=Command)
@bags_argument
@valve_option
@map_option
@params_option
@click.option(
    "--state", "with_state", is_flag=True,
    help="Also fit the declared valve, and list the errors of the recording (drift, hum, ringing ...) with what to do "
    "about them, and how large each effect would have to be to be named.",
)  # fmt: skip
@click.option(
    "--plot", metavar="FILE", type=FILE,
    help="Draw the channels over time and the strokes beside each other: .png, .svg or .pdf.",
)  # fmt: skip
@json_option
def info(
    *,
    bags: tuple[Path, ...],
    name: str | None,
    params: Path | None,
    with_state: bool,
    plot: Path | None,
    as_json: bool,
) -> None:
    """Show what recordings contain.

    Valves, signals and their rates, strokes, gaps, clock problems, and what was dropped or repaired on reading:
      valve-sim info bags/friction

    The arrivals of the plungers are found from the sensors alone, without a model. Of the declared parameters only
    pilot_gap is used for that; the others are used to check whether the recording can be of that valve. --state fits
    the declared valve, and lists the errors of the recording:
      valve-sim info bags/eight_strokes.mcap --state

    Several recordings are shown one after the other, and drawn below each other:
      valve-sim info bags/friction bags/eight_strokes.mcap --plot first_look.png

    One valve of several, for a program:
      valve-sim info station_bag --valve /tank_1/valve --json

    Read on: docs/reference/info.md, docs/how_to/your_own_recordings.md, docs/how_to/record_well.md
    """
    from valve_sim.recordings import another_valve, describe, doubtful_units, events_from_sensors, read_trace

    if plot is not None:
        from valve_sim.files.whole_files import refuse_unwritable

        refuse_unwritable(plot)
    valves, traces, recording_map = [], [], chosen_map()
    places = [(bag, valve) for bag in bags for valve in _valves_of(bag, name, recording_map)]
    for bag, valve in places:
        parameters = declared_parameters(params, valve)
        trace = read_trace(bag, valve, recording_map)
        doubts = (*doubtful_units(trace, parameters), *another_valve(trace, parameters))
        trace = dataclasses.replace(trace, findings=(*trace.findings, *doubts))
        state = _state(trace, params, valve) if with_state else None
        valves.append((describe(trace), events_from_sensors(trace, parameters.pilot_gap), state))
        if plot is not None:
            traces.append(trace)
    if plot is not None:
        _draw(plot, [(trace, own.strokes, arrivals) for trace, (own, arrivals, _) in zip(traces, valves, strict=True)])
    if as_json:
        print_json({"valves": [_as_json(*valve) for valve in valves]})
        return
    for summary, arrivals, state in valves:
        _print_summary(summary, arrivals)
        if state is not None:
            _print_state(state)
    if plot is not None:
        click.echo(shown(f"wrote {plot}"))


def _draw(plot: Path, recordings: Sequence[tuple[Trace, Sequence[StrokePart], Sequence[StrokeEvents]]]) -> None:
    from valve_sim.identification.reporting.figures import save_figure
    from valve_sim.recordings.pictures import draw_recordings

    save_figure(draw_recordings(recordings), plot)


def _valves_of(bag: Path, name: str | None, recording_map: RecordingMap | None) -> Sequence[str | None]:
    """The valve that was asked for, or all of a recording; None: the only one, which has no name."""
    from valve_sim.recordings import list_valves

    return (name,) if name else list_valves(bag, recording_map) or (None,)


def _state(trace: Trace, params: Path | None, name: str | None) -> RecordingState:
    from valve_sim.identification.diagnosis.recording_state import state_of_recording

    valve = declared_valve(params, name)
    with progress_bar() as progress:
        return state_of_recording(trace, valve, progress)


def _as_json(summary: TraceSummary, arrivals: Sequence[StrokeEvents], state: RecordingState | None) -> dict[str, Any]:
    from valve_sim.identification.reporting.recording_document import recording_document

    told = {**plain(summary), "arrivals": plain(arrivals)}
    return told if state is None else {**told, "state": recording_document(state).to_json()}


def _print_state(state: RecordingState) -> None:
    from valve_sim.identification.reporting.recording_document import recording_document

    click.echo(shown(recording_document(state).to_text()))


def _judged_words(summary: TraceSummary) -> str:
    if summary.position_range is None:
        is_current = summary.primary_signal == "current"
        noise = f"current {1e3 * summary.noise:.3g} mA" if is_current else f"pressure {1e-3 * summary.noise:.3g} kPa"
        return f"no position; noise of the {noise}"
    low, high = (1e6 * position for position in summary.position_range)
    return f"pilot plunger from {low:.2f} to {high:.2f} µm, noise {1e6 * summary.noise:.3g} µm"


def _print_summary(summary: TraceSummary, arrivals: Sequence[StrokeEvents]) -> None:
    from valve_sim.recordings.left_out import words_of

    click.echo(shown(f"{summary.source}: {summary.duration:.6g} s, timed by {summary.timed_by}"))
    for signal, rate in summary.signals.items():
        click.echo(
            f"  {signal:<18}{rate.samples:>9} samples{rate.rate:>12.6g} Hz{', in bursts' if rate.in_bursts else ''}"
        )
    click.echo(f"  {'commands':<18}{summary.commands:>9} at {', '.join(f'{volts:g}' for volts in summary.voltages)} V")
    click.echo(shown(f"  {'input':<18}{summary.input}"))
    click.echo(f"  {_judged_words(summary)}; sample interval within {1e6 * summary.jitter:.3f} µs of its median (99 %)")
    if words := words_of(summary.left_out):
        click.echo(f"  left out: {words}")
    for gap in summary.gaps[:10]:
        click.echo(f"  gap at {gap.start:.6f} s: {1e3 * gap.length:.3f} ms without samples")
    if len(summary.gaps) > 10:
        click.echo(f"  and {len(summary.gaps) - 10} gaps more")
    seen = {found.stroke: found.events for found in arrivals}
    for stroke in summary.strokes:
        click.echo(f"  {stroke.name}" + ("" if stroke.moved else ": nothing moved"))
        for event in seen.get(stroke, ()):
            words = f"{event.kind.replace('_', ' ')} ({event.sensor})"
            click.echo(f"    {words:<34}{1e3 * event.after_command:9.3f} ± {1e3 * event.stderr:.3f} ms")
    for finding in summary.findings:
        click.echo(shown(f"  note: {finding}"))
