"""`valve-sim`: parse, call, print.

Everything that takes long to import is imported by the command that needs it, so that --help answers at once. Exit
codes: 0 done (validate: within), 1 outside (validate), 2 unusable input, with one line on stderr.
"""

from __future__ import annotations

import dataclasses
import inspect
import math
import os
import re
import shlex
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NoReturn

import click

from valve_sim import __version__
from valve_sim.files.json_text import json_text, plain
from valve_sim.files.ledger import keeping_ledger, plan_files
from valve_sim.invocation import invocation

if TYPE_CHECKING:
    from valve_sim.files.recording_map import RecordingMap
    from valve_sim.model import Valve
    from valve_sim.traces import StrokeEvents, Trace, TraceSummary

# The matrices of a fit are thin: threads of the linear algebra cost more than they bring. NumPy comes later.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

Progress = Callable[[str, float], None]

OUTSIDE: Final = 1
UNUSABLE: Final = 2
STOPPED: Final = 130
COMPLETE_VAR: Final = "_VALVE_SIM_COMPLETE"
"""What a shell sets to ask for completions; however the program is called, it is the same for the scripts that ship."""
_FILE: Final = click.Path(path_type=Path)
_MAP_KEY: Final = "valve_sim.map"
"""Where click's context keeps the file given as --map."""


class Command(click.Command):
    """A command whose help shows paragraphs with indented lines, its examples, as they stand."""

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **{**settings, "help": _with_examples(settings.get("help"))})

    def get_help(self, ctx: click.Context) -> str:
        """The help, with examples that work in this terminal as they stand."""
        return _as_typed(super().get_help(ctx))


class CommandLine(click.Group):
    """A group whose every failure is one line on stderr."""

    command_class = Command

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **{**settings, "help": _with_examples(settings.get("help"))})

    def get_help(self, ctx: click.Context) -> str:
        """The help, with examples that work in this terminal as they stand."""
        return _as_typed(super().get_help(ctx))

    def main(self, *arguments: Any, **settings: Any) -> Any:
        """Run the command line and exit."""
        settings = {"prog_name": invocation(), "complete_var": COMPLETE_VAR, **settings, "standalone_mode": False}
        try:
            with keeping_ledger() as ledger:
                code = super().main(*arguments, **settings)
            sys.stdout.flush()
        except click.ClickException as error:
            context = getattr(error, "ctx", None)
            hint = f" (see {context.command_path} --help)" if context else ""
            _end(f"{_one_line(error.format_message()).removesuffix('.')}{hint}")
        except click.Abort:
            _end(_one_line(f"stopped; {ledger.words()}"), STOPPED)
        except BrokenPipeError:
            # Whoever read the output, such as head, has had enough; Python's own last flush must not complain.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            sys.exit(0)
        except Exception as error:
            from valve_sim.model.errors import ValveError

            if not isinstance(error, ValveError):
                raise
            _end(_one_line(str(error)))
        sys.exit(code if isinstance(code, int) else 0)


def _with_examples(text: str | None) -> str | None:
    """Help in which click leaves the lines of paragraphs with indented lines alone."""
    if text is None:
        return None
    paragraphs = inspect.cleandoc(text).split("\n\n")
    return "\n\n".join(f"\b\n{words}" if "\n  " in f"\n{words}" else words for words in paragraphs)


def _as_typed(text: str) -> str:
    """Help in which the program of the examples is typed as it must be here, .venv/bin/valve-sim say."""
    return re.sub(r"^( +)valve-sim(?= )", lambda found: f"{found[1]}{invocation()}", text, flags=re.MULTILINE)


def _number(lowest: float = -math.inf, *, is_open: bool = False) -> Callable[[str], float]:
    """The type of an option that takes a finite number, above a bound or from it on."""

    def convert(text: str) -> float:
        try:
            number = float(text)
        except ValueError:
            number = math.nan
        if not math.isfinite(number) or number < lowest or (is_open and number == lowest):
            bound = "" if math.isinf(lowest) else f", {'above' if is_open else 'at least'} {lowest:g}"
            raise click.BadParameter(f"found {text!r}, expected a finite number{bound}")
        return number

    return convert


@click.group(
    cls=CommandLine,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110, "show_default": True},
    no_args_is_help=False,
)
@click.version_option(__version__, prog_name="valve-sim")
def main() -> None:
    """Simulate, identify, diagnose and validate a pilot-operated solenoid valve.

    From nothing to an identified valve in four lines:
      echo '[[0.01, 9], [0.04, 0], [0.07, 12], [0.10, 0]]' > strokes.yaml
      valve-sim simulate --profile strokes.yaml --duration 0.14 --noise-um 1 --output strokes.mcap
      valve-sim info strokes.mcap
      valve-sim identify strokes.mcap --output results

    A recording is a rosbag2 folder or a bare .mcap file with the topics ~/coil_voltage and ~/measured/joint_states. A
    parameter file is a ROS 2 parameter file, the one that valve_node takes; without --params the shipped
    config/valve.yaml holds.
    """


# --- options that several commands share ---

_bags = click.argument("bags", metavar="BAG...", type=_FILE, nargs=-1, required=True)
_params = click.option("--params", metavar="FILE", type=_FILE, help="Parameter file. Default: the shipped valve.yaml.")
_valve = click.option("--valve", "name", metavar="NAME", help="Which valve of a bag that holds several, /tank_1/valve.")
_map = click.option(
    "--map",
    metavar="FILE",
    type=_FILE,
    expose_value=False,
    callback=lambda context, _, path: context.meta.__setitem__(_MAP_KEY, path),
    help="Which topic or column of a recording is what; valve-sim map writes a first one.",
)
_json = click.option("--json", "as_json", is_flag=True, help="Print JSON in place of text.")
_folder = click.option("--output", metavar="DIR", type=_FILE, required=True, help="Folder for the results.")


# --- commands ---


@main.command()
@_params
@click.option("--voltage", metavar="V", type=_number(), help="Hold this voltage from time 0 on.")
@click.option("--profile", metavar="FILE", type=_FILE, help="Voltage over time: see below.")
@click.option("--duration", metavar="S", type=_number(0.0, is_open=True), required=True, help="How long, s.")
@click.option("--rate", metavar="HZ", type=_number(0.0, is_open=True), default=20000.0, help="Samples a second.")
@click.option(
    "--noise-um", metavar="UM", type=_number(0.0), default=0.0, help="Noise of the positions, µm (std. dev.)."
)
@click.option("--quantisation-um", metavar="UM", type=_number(0.0), default=0.0, help="Step of the positions, µm.")
@click.option(
    "--current-noise-ma",
    metavar="MA",
    type=_number(0.0),
    show_default="1 with --noise-um, else 0",
    help="Noise of the coil current, mA.",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, help="Of the noise; the same gives the same recording.")
@click.option("--output", metavar="FILE", type=_FILE, required=True, help="x.mcap, x.csv, or x for a rosbag2 folder.")
@click.option("--plot", metavar="PNG", type=_FILE, help="Draw displacement, velocity, current and phase.")
@_json
def simulate(
    *,
    params: Path | None,
    voltage: float | None,
    profile: Path | None,
    duration: float,
    rate: float,
    noise_um: float,
    quantisation_um: float,
    current_noise_ma: float | None,
    seed: int,
    output: Path,
    plot: Path | None,
    as_json: bool,
) -> None:
    """Simulate strokes and record them.

    One opening at 9 V, as a table and a picture:
      valve-sim simulate --voltage 9 --duration 0.02 --output opening.csv --plot opening.png
    Strokes with a noisy sensor, as a bag that identify reads back:
      valve-sim simulate --profile strokes.csv --duration 0.5 --noise-um 1 --output strokes.mcap

    A profile is a CSV file with the columns time (s) and volts (V), each voltage held until the next row:
      time,volts
      0.010,9.0
      0.040,0.0
    or a YAML file of the same rows: [[0.010, 9.0], [0.040, 0.0]] or [{time: 0.010, volts: 9.0}, ...].
    A CSV that simulate wrote is a profile too.

    The CSV has the columns time, coil_voltage, coil_current, pilot_position, main_position, pilot_velocity, phase, in
    SI units. The bag has /valve/coil_voltage, /valve/measured/joint_states and /valve/measured/coil_current, and
    its stamps begin at 0.
    """
    if (voltage is None) == (profile is None):
        raise click.UsageError("give either --voltage or --profile", click.get_current_context())
    from valve_sim.model import Drive, published_times
    from valve_sim.traces import write_bag, write_csv
    from valve_sim.traces.synthetic import Sensor, read_profile, record

    if output.suffix not in (".csv", ".mcap", ""):
        _refuse(f"--output {output}: expected x.mcap, x.csv, or a name without ending for a rosbag2 folder")
    drive = Drive.of([0.0], [voltage or 0.0]) if profile is None else read_profile(profile)
    current_noise = (1.0 if noise_um else 0.0) if current_noise_ma is None else current_noise_ma
    sensor = Sensor(1e-6 * noise_um, 1e-6 * quantisation_um, 1e-3 * current_noise, seed)
    valve = _load(params)
    recording = record(valve, drive, duration, rate, sensor)
    if output.suffix == ".csv":
        write_csv(output, recording.columns())
    else:
        write_bag(output, recording.trace)
    events, (t1, t2) = recording.response.events, published_times(recording.response)
    if plot is not None:
        from valve_sim.identification.reporting.figures import plot_response

        levels = {"gap": valve.parameters.pilot_gap, "stroke": valve.parameters.stroke}
        marks = {name: time for name, time in (("t1", t1), ("t2", t2)) if math.isfinite(time)}
        title = str(params or "valve.yaml")
        plot_response(plot, recording.response, recording.trace.drive, title, marks=marks, levels=levels)
    if as_json:
        listed = [{**event._asdict(), "kind": event.kind.name.lower()} for event in events]
        times = {"t1_ms": 1e3 * t1, "t2_ms": 1e3 * t2}
        _print_json({"output": output, "samples": len(recording.trace.times), **times, "events": listed})
        return
    for event in events:
        words = event.kind.name.lower().replace("_", " ")
        click.echo(f"{1e3 * event.time:12.6f} ms  {words:<16}{1e6 * event.position:10.3f} µm{event.velocity:12.6f} m/s")
    if not events:
        click.echo("the valve stays closed")
    click.echo(f"wrote {output} ({len(recording.trace.times)} samples)" + (f" and {plot}" if plot else ""))


@main.command()
@click.argument("bag", type=_FILE)
@_valve
@_map
@_params
@_json
def info(*, bag: Path, name: str | None, params: Path | None, as_json: bool) -> None:
    """Say what a recording holds.

    Valves, signals and their rates, strokes, gaps, trouble with clocks, and what reading it dropped or repaired.
    Arrivals of each stroke are read from the sensors alone; only the place of the gap is taken from the parameters.

      valve-sim info strokes.mcap
      valve-sim info station_bag --valve /tank_1/valve --json | jq '.valves[0].strokes'
    """
    from valve_sim.traces import describe, doubtful_units, events_from_sensors, list_valves, read_trace

    parameters, recording_map = _load(params).parameters, _recording_map()
    valves = []
    for valve in (name,) if name else list_valves(bag, recording_map) or (None,):
        trace = read_trace(bag, valve, recording_map)
        trace = dataclasses.replace(trace, findings=(*trace.findings, *doubtful_units(trace, parameters)))
        valves.append((describe(trace), events_from_sensors(trace, parameters.pilot_gap)))
    if as_json:
        _print_json({"valves": [{**plain(summary), "arrivals": plain(arrivals)} for summary, arrivals in valves]})
        return
    for summary, arrivals in valves:
        _print_summary(summary, arrivals)


@main.command("map")
@click.argument("recording", type=_FILE)
@_params
@click.option("--output", metavar="FILE", type=_FILE, show_default="the terminal", help="Where to write the map.")
def draft(*, recording: Path, params: Path | None, output: Path | None) -> None:
    """Write a first map of a recording of yours.

    RECORDING is a bag with any topics, or a table of a data logger: CSV, Parquet, or MATLAB. The map says which topic
    or column is position, voltage and current, in which unit; lines with CHECK need your eye.

      valve-sim map scope.csv --output scope.yaml
      valve-sim info scope.csv --map scope.yaml
      valve-sim identify scope.csv --map scope.yaml --output results
    """
    from valve_sim.files.whole_files import write_whole
    from valve_sim.traces.map_draft import draft_map

    if output is not None and output.exists():
        _refuse(f"--output {output}: exists, and may be corrected by hand; choose another name or take it away")
    text = _shown(draft_map(recording, _load(params).parameters, f"{invocation()} {shlex.join(sys.argv[1:])}"))
    if output is None:
        click.echo(text, nl=False)
        return
    write_whole(output, text)
    checks = text.count("CHECK") - 1  # one is in the heading
    then = f"{invocation()} {shlex.join(['info', str(recording), '--map', str(output)])}"
    click.echo(_shown(f"wrote {output}; read it, {checks} guesses are marked CHECK; then: {then}"))


@main.command()
@_bags
@_params
@click.option(
    "--free",
    metavar="A,B",
    default="pilot_damping,main_damping",
    help="What to refit: declared parameters (a0 ... a3 of the polynomial) and effects, coulomb_friction.force.",
)
@_valve
@_map
@_folder
@_json
def identify(
    *, bags: tuple[Path, ...], params: Path | None, free: str, name: str | None, output: Path, as_json: bool
) -> None:
    """Refit parameters to recordings.

    Every value comes with its 95 % interval, and what the data do not determine is said. Writes DIR/identify.json and
    DIR/identified.yaml, which valve_node, simulate and validate load.

      valve-sim identify strokes.mcap --output results
      valve-sim identify day_1 day_2 --free pilot_damping,main_damping,a0 --params my_valve.yaml --output results
      valve-sim validate tomorrow.mcap --params results/identified.yaml
    """
    from valve_sim.files.parameter_files import save_valve
    from valve_sim.files.whole_files import write_whole
    from valve_sim.identification.estimation.identify import identify as refit
    from valve_sim.identification.reporting.identification import identification_json, identification_text

    written = (output / "identify.json", output / "identified.yaml")
    plan_files(*written)
    valve = _load(params)
    names = tuple(dict.fromkeys(part.strip() for part in free.split(",") if part.strip()))
    if not names:
        _refuse(f"--free {free!r}: names nothing; expected names, parted by commas")
    traces = _read(bags, name, valve)
    with _progress() as progress:
        result = refit(traces, valve, names, progress)
    report = identification_json(result)
    write_whole(output / "identify.json", json_text(report))
    values = [f"{key}: {interval.value:.6g} ± {interval.stderr:.2g}" for key, interval in result.intervals.items()]
    save_valve(output / "identified.yaml", result.valve, _provenance(params, [f"identified: {', '.join(values)}"]))
    _print_report(report, identification_text(result), written, as_json)


@main.command()
@click.argument("bags", metavar="[BAG...]", type=_FILE, nargs=-1)
@click.option("--events", metavar="FILE", type=_FILE, help="Table of events in place of bags, as a paper prints them.")
@click.option(
    "--holdout", metavar="BAG", type=_FILE, multiple=True, help="Recording to judge by, not to fit. Repeatable."
)
@click.option(
    "--budget",
    metavar="SECONDS",
    type=_number(1.0),
    default=120.0,
    help="Time that search, report and pictures may take, from when the recordings are read.",
)
@_params
@_valve
@_map
@_folder
@_json
def diagnose(
    *,
    bags: tuple[Path, ...],
    events: Path | None,
    holdout: tuple[Path, ...],
    budget: float,
    params: Path | None,
    name: str | None,
    output: Path,
    as_json: bool,
) -> None:
    """Find the effect that the model lacks.

    Refits the declared model, tests whether what is left is more than noise, searches the effects, and reports errors
    before and after, on the data it was fitted to and on held-out data. Without --holdout, strokes are held out. What
    the budget was too short for, it says.

    Writes DIR/report.json, report.html and report.png for people, corrected.yaml, which valve_node, simulate and
    validate load, and record_next.yaml, a profile for simulate and command_profile, where there is something to tell
    apart.

      valve-sim diagnose strokes.mcap --output results
      valve-sim diagnose day_1 day_2 --holdout day_3 --params my_valve.yaml --output results
      valve-sim diagnose --events config/paper_events.yaml --output results
    """
    if (events is None) == (not bags):
        raise click.UsageError("diagnose takes either BAG... or --events FILE", click.get_current_context())
    if events is not None:
        _diagnose_events(events, output, as_json)
        return
    before_wall, before_processor = time.perf_counter(), time.process_time()
    from valve_sim.identification.diagnosis.run import diagnose as trace_residual
    from valve_sim.identification.estimation.budget import Budget, kept_for_writing
    from valve_sim.identification.plants.valve import ValvePlant
    from valve_sim.identification.reporting.diagnosis_json import to_json
    from valve_sim.identification.reporting.files import FILES, load_drawing, write_diagnosis
    from valve_sim.identification.reporting.text import diagnosis_text

    valve = _load(params)
    plan_files(*(output / file for file in FILES))
    traces, held_out = _read(bags, name, valve), _read(holdout, name, valve)
    with _progress() as progress:
        # The first prediction after an installation compiles the model, which no budget is meant for.
        ValvePlant(traces, valve).predict({})
        load_drawing()
        wall, processor = time.perf_counter() - before_wall, time.process_time() - before_processor
        time_left = Budget(budget - kept_for_writing(budget, wall / processor), time.monotonic)
        result = trace_residual(traces, held_out, valve, progress, time_left)
    report = to_json(result)
    written = write_diagnosis(result, output, _provenance(params, [report["verdict"]["summary"]]))
    _print_report(report, diagnosis_text(result), written, as_json)


def _diagnose_events(events: Path, output: Path, as_json: bool) -> None:
    from valve_sim.identification.diagnosis.events import diagnose_events
    from valve_sim.identification.plants.event_table import read_event_table
    from valve_sim.identification.reporting.event_files import write_event_report
    from valve_sim.identification.reporting.event_report import event_json, event_text

    table = read_event_table(events)
    _say_when_compiling()
    with _progress() as progress:
        found = diagnose_events(table, progress)
    written = write_event_report(found, output)
    _print_report(event_json(found), event_text(found), written, as_json)


@main.command()
@_bags
@click.option("--params", metavar="FILE", type=_FILE, required=True, help="Parameter file of the valve to check.")
@click.option(
    "--tolerance-um",
    metavar="UM",
    type=_number(0.0, is_open=True),
    show_default="3 times the noise",
    help="Largest rms error, µm.",
)
@click.option("--command-jitter", is_flag=True, help="Take an error of each command's stamp for granted, N(0, 50 µs).")
@click.option("--junit", metavar="XML", type=_FILE, help="Write a JUnit report, a test case for each stroke.")
@click.option("--plot", metavar="PNG", type=_FILE, help="Draw measured, predicted and what lies between (one BAG).")
@_valve
@_map
@_json
def validate(
    *,
    bags: tuple[Path, ...],
    params: Path,
    tolerance_um: float | None,
    command_jitter: bool,
    junit: Path | None,
    plot: Path | None,
    name: str | None,
    as_json: bool,
) -> int:
    """Check a declared valve against recordings.

    The recorded commands are replayed on it. Exit 0 when it does what was measured, 1 when not. A stroke is within
    the tolerance when its root-mean-square error is, over all its samples and over those in which
    the model moves. Nothing is fitted but the offset between the clocks of commands and samples, prior N(0, 50 µs).

      valve-sim validate strokes.mcap --params config/valve.yaml
      valve-sim validate tests/*.mcap --params results/identified.yaml --tolerance-um 17 --junit replay.xml
    """
    if plot is not None and len(bags) > 1:
        raise click.UsageError("--plot draws one recording; give one BAG", click.get_current_context())
    from valve_sim.files.whole_files import write_whole
    from valve_sim.identification.reporting.validation import validation_json, validation_junit, validation_text
    from valve_sim.identification.validation.replay import validate as replay

    plan_files(*(path for path in (junit, plot) if path))
    valve = _load(params)
    traces = _read(bags, name, valve)
    tolerance = None if tolerance_um is None else 1e-6 * tolerance_um
    with _progress() as progress:
        result = replay(traces, valve, tolerance, command_jitter=command_jitter, progress=progress)
    if junit is not None:
        write_whole(junit, _shown(validation_junit(result)))  # XML has no place for control characters
    if plot is not None:
        from valve_sim.identification.reporting.figures import plot_replay

        plot_replay(plot, result.replays[0])
    _print_report(validation_json(result), validation_text(result), [path for path in (junit, plot) if path], as_json)
    return 0 if result.passed else OUTSIDE


@main.command("fit-force")
@click.argument("file", type=_FILE)
@_params
@click.option("--degree", type=int, default=3, help="Of the polynomial, up to 3.")
@click.option("--voltage", metavar="V", type=_number(), help="Of the table. Default: valve.reference_voltage.")
@click.option("--no-constant", is_flag=True, help="Leave a0 out, as the paper does; the report says what comes of it.")
@_folder
@_json
def fit_force(
    *,
    file: Path,
    params: Path | None,
    degree: int,
    voltage: float | None,
    no_constant: bool,
    output: Path,
    as_json: bool,
) -> None:
    """Fit the attraction to a static table.

    FILE is a CSV with the columns displacement (m) and force (N), measured at one voltage with load cell and stage.
    Writes DIR/fit-force.json, DIR/fit-force.png (force and residuals) and DIR/attraction.yaml, which valve_node,
    simulate and validate load.

      valve-sim fit-force force_9V.csv --output results
      valve-sim fit-force force_12V.csv --voltage 12 --params my_valve.yaml --output results
    """
    from valve_sim.files.parameter_files import save_valve
    from valve_sim.files.whole_files import write_whole
    from valve_sim.identification.estimation.static_force import fit_static_force
    from valve_sim.identification.reporting.figures import plot_static_force
    from valve_sim.identification.reporting.static_force import static_force_json, static_force_text

    result = fit_static_force(file, _load(params), degree=degree, voltage=voltage, constant=not no_constant)
    report, picture, parameters = (output / f for f in ("fit-force.json", "fit-force.png", "attraction.yaml"))
    plan_files(report, picture, parameters)
    write_whole(report, json_text(static_force_json(result)))
    plot_static_force(picture, result)
    save_valve(parameters, result.valve, _provenance(params, ["attraction_polynomial: fitted", *result.remarks]))
    _print_report(static_force_json(result), static_force_text(result), (report, picture, parameters), as_json)


# --- in ---


def _load(params: Path | None) -> Valve:
    from valve_sim.files.parameter_files import default_valve, load_valve

    _say_when_compiling()
    return default_valve() if params is None else load_valve(params)


def _recording_map() -> RecordingMap | None:
    from valve_sim.files.recording_map import load_map

    path: Path | None = click.get_current_context().meta.get(_MAP_KEY)
    return None if path is None else load_map(path)


def _read(bags: Sequence[Path], name: str | None, valve: Valve) -> list[Trace]:
    """Read recordings; what was dropped or repaired is said on stderr, numbers of another unit are refused."""
    from valve_sim.traces import read_trace, refuse_doubtful_units

    traces, recording_map = [], _recording_map()
    for bag in bags:
        trace = read_trace(bag, name, recording_map)
        refuse_doubtful_units(trace, valve.parameters)
        for finding in trace.findings:
            click.echo(_shown(f"valve-sim: {bag}: {finding}"), err=True)
        traces.append(trace)
    return traces


# --- out ---


def _say_when_compiling() -> None:
    """The first use after an installation is slow: say why, on a terminal and in a log alike."""
    from valve_sim.model.compiling import announce_compiling

    words = "valve-sim: compiling the model for this machine (ten seconds or so, once)"
    announce_compiling(lambda: click.echo(words, err=True))


@contextmanager
def _progress() -> Iterator[Progress]:
    """A bar on stderr while that is a terminal; a line every ten seconds elsewhere."""
    if not sys.stderr.isatty():
        from valve_sim.progress_lines import ProgressLines

        with ProgressLines(sys.stderr) as lines:
            yield lines
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("starting", total=1.0)
        yield lambda what, fraction: bar.update(task, description=what, completed=fraction)


def _print_report(report: Mapping[str, Any], text: str, written: Sequence[Path], as_json: bool) -> None:
    if as_json:
        _print_json(report)
        return
    click.echo(_shown(text))
    if written:
        click.echo(_shown(f"wrote {', '.join(str(path) for path in written)}"))


def _print_summary(summary: TraceSummary, arrivals: Sequence[StrokeEvents]) -> None:
    low, high = (1e6 * position for position in summary.position_range)
    clock = f"{summary.clock} stamps" if summary.clock in ("header", "bag") else f"its {summary.clock}"
    click.echo(_shown(summary.source) + f": {summary.duration:.6g} s, timed by {clock}")
    for signal, rate in summary.signals.items():
        click.echo(
            f"  {signal:<18}{rate.samples:>9} samples{rate.rate:>12.6g} Hz{', in bursts' if rate.in_bursts else ''}"
        )
    click.echo(f"  {'commands':<18}{summary.commands:>9} at {', '.join(f'{volts:g}' for volts in summary.voltages)} V")
    click.echo(
        f"  pilot plunger from {low:.2f} to {high:.2f} µm, noise {1e6 * summary.noise:.3g} µm; "
        f"sample interval within {1e6 * summary.jitter:.3f} µs of its median (99 %)"
    )
    for gap in summary.gaps[:10]:
        click.echo(f"  gap at {gap.start:.6f} s: {1e3 * gap.length:.3f} ms without samples")
    if len(summary.gaps) > 10:
        click.echo(f"  and {len(summary.gaps) - 10} gaps more")
    seen = {found.stroke: found.events for found in arrivals}
    for stroke in summary.strokes:
        click.echo(f"  {stroke.name}" + ("" if stroke.moved else ": nothing moved"))
        for event in seen.get(stroke, ()):
            words = f"{event.kind.replace('_', ' ')} ({event.sensor})"
            click.echo(f"    {words:<34}{1e3 * event.after_command:9.3f} ± {1e3 * event.uncertainty:.3f} ms")
    for finding in summary.findings:
        click.echo(_shown(f"  note: {finding}"))


def _provenance(params: Path | None, lines: Sequence[str]) -> str:
    """Where the values of a written parameter file are from."""
    command = shlex.join(["valve-sim", *sys.argv[1:]])
    return "\n".join(
        [f"Written by: {command}", f"From: {params or 'the shipped valve.yaml'}, changed as follows", *lines]
    )


def _print_json(report: Mapping[str, Any]) -> None:
    click.echo(json_text(report), nl=False)


def _refuse(message: str) -> NoReturn:
    from valve_sim.model.errors import ValveError

    raise ValveError(message)


def _one_line(message: str) -> str:
    return _shown(" ".join(message.split()))


def _shown(text: str) -> str:
    """Text with names from bags and files, fit for a terminal and XML: what would steer it becomes a mark."""
    return "".join(character if character.isprintable() or character == "\n" else "\ufffd" for character in text)


def _end(message: str, code: int = UNUSABLE) -> NoReturn:
    click.echo(f"valve-sim: {message}", err=True)
    sys.exit(code)


if __name__ == "__main__":
    main()
