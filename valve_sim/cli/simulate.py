"""`valve-sim simulate`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from valve_sim.cli.command_line import Command
from valve_sim.cli.options import FILE, finite_number, json_option, map_option, params_option, plant_option
from valve_sim.cli.printing import print_json, refuse
from valve_sim.cli.reading import chosen_map_file, chosen_params, declared_valve, is_own

if TYPE_CHECKING:
    from valve_sim.model import Drive, Event
    from valve_sim.recordings.synthetic import Recording


@click.command(cls=Command)
@click.argument("log", metavar="[LOG]", type=FILE, required=False)
@params_option
@plant_option
@map_option
@click.option("--voltage", metavar="V", type=finite_number(), help="Constant voltage from time 0 on.")
@click.option("--profile", metavar="FILE", type=FILE, help="Voltage over time, YAML or CSV: see above.")
@click.option("--duration", metavar="S", type=finite_number(0.0, is_open=True), help="Duration, s.")
@click.option("--rate", metavar="HZ", type=finite_number(0.0, is_open=True), default=20000.0, help="Sample rate, Hz.")
@click.option(
    "--noise-um",
    metavar="UM",
    type=finite_number(0.0),
    default=0.0,
    help="Standard deviation of the positions' noise, µm.",
)
@click.option(
    "--quantisation-um", metavar="UM", type=finite_number(0.0), default=0.0, help="Resolution of the positions, µm."
)
@click.option(
    "--current-noise-ma",
    metavar="MA",
    type=finite_number(0.0),
    show_default="1 with --noise-um, else 0",
    help="Standard deviation of the current's noise, mA.",
)
@click.option(
    "--voltage-noise-mv",
    metavar="MV",
    type=finite_number(0.0),
    help="Also record the voltage at the coil, with noise of this standard deviation, mV.",
)
@click.option(
    "--pressure-noise-kpa",
    metavar="KPA",
    type=finite_number(0.0),
    default=0.0,
    help="Standard deviation of the noise of the outlet's pressure, kPa, of a valve with gas.",
)
@click.option("--with-noise", is_flag=True, help="With --plant: add the outputs' declared noise, drawn with --seed.")
@click.option("--without-position", is_flag=True, help="Record no position, as if none could be measured.")
@click.option(
    "--seed", type=click.IntRange(min=0), default=0, help="Seed of the noise; the same seed gives the same recording."
)
@click.option("--output", metavar="FILE", type=FILE, required=True, help="x.mcap, x.csv, or x for a rosbag2 folder.")
@click.option("--plot", metavar="PNG", type=FILE, help="Draw displacement, velocity, current and phase.")
@json_option
def simulate(
    *,
    log: Path | None,
    params: Path | None,
    plant: Path | None,
    voltage: float | None,
    profile: Path | None,
    duration: float | None,
    rate: float,
    noise_um: float,
    quantisation_um: float,
    current_noise_ma: float | None,
    voltage_noise_mv: float | None,
    pressure_noise_kpa: float,
    with_noise: bool,
    without_position: bool,
    seed: int,
    output: Path,
    plot: Path | None,
    as_json: bool,
) -> None:
    r"""Simulate strokes and record them.

    One opening at 9 V, as a table and a picture:
      valve-sim simulate --voltage 9 --duration 0.02 --output opening.csv \
          --plot opening.png

    Two strokes with a noisy sensor, as a bag that identify reads back:
      echo '[[0.01, 9], [0.04, 0], [0.07, 12], [0.10, 0]]' > strokes.yaml
      valve-sim simulate --profile strokes.yaml --duration 0.14 \
          --noise-um 1 --output strokes.mcap

    The outputs of a machine of your own, driven by the inputs in a table:
      valve-sim simulate log.csv --plant my_axis.yaml --map map.yaml \
          --output shown.csv

    A profile lists times (s) and voltages (V), each voltage held until the next row. It is a YAML file as above, or
    with named keys ([{time: 0.01, volts: 9}, ...]), or a CSV file with the columns time and volts. A CSV that simulate
    wrote is a profile, too.

    The CSV has the columns time, coil_voltage, coil_current, pilot_position, main_position, pilot_velocity, phase and,
    of a valve with gas, outlet_pressure and mass_flow (from inlet to outlet), in SI units. The bag has
    /valve/coil_voltage, /valve/measured/joint_states, /valve/measured/coil_current and, with gas,
    /valve/measured/outlet_pressure; its stamps begin at 0. With --voltage-noise-mv, voltage and current at the coil's
    terminals are in /valve/measured/coil.

    Read on: docs/tutorials/first_diagnosis.md, docs/reference/parameters.md
    """
    from valve_sim.recordings.synthetic import Sensor, record

    params = chosen_params(plant, params)
    if plant is not None and is_own(plant):
        if voltage is not None or profile is not None or plot is not None:
            refuse("--voltage, --profile and --plot: are for valves; with --plant give a LOG that holds its inputs")
        _simulate_own(plant, log, (duration, rate), seed if with_noise else None, output, as_json=as_json)
        return
    if log is not None:
        refuse(f"{log}: a LOG of inputs is for --plant; a valve takes --voltage or --profile")
    if duration is None:
        raise click.UsageError("Missing option '--duration'.", click.get_current_context())
    drive = _drive(voltage, profile)
    if output.suffix not in (".csv", ".mcap", ""):
        refuse(f"--output {output}: expected x.mcap, x.csv, or a name without ending for a rosbag2 folder")
    current_noise = (1.0 if noise_um else 0.0) if current_noise_ma is None else current_noise_ma
    voltage_noise = None if voltage_noise_mv is None else 1e-3 * voltage_noise_mv
    sensor = Sensor(
        1e-6 * noise_um, 1e-6 * quantisation_um, 1e-3 * current_noise, seed, voltage_noise,
        has_positions=not without_position, pressure_noise=1e3 * pressure_noise_kpa,
    )  # fmt: skip
    valve = declared_valve(params)
    recording = record(valve, drive, duration, rate, sensor)
    _write(output, recording)
    if plot is not None:
        from valve_sim.identification.reporting.figures import draw_simulation, save_figure

        title = str(params or "valve.yaml")
        save_figure(draw_simulation(recording.response, recording.trace.drive, valve, title), plot)
    if as_json:
        _print_json(recording, output)
        return
    _print_events(recording.response.events)
    click.echo(f"wrote {output} ({len(recording.trace.sample_times)} samples)" + (f" and {plot}" if plot else ""))


def _drive(voltage: float | None, profile: Path | None) -> Drive:
    """One voltage from the start, or a profile."""
    if (voltage is None) == (profile is None):
        raise click.UsageError("give either --voltage or --profile", click.get_current_context())
    from valve_sim.model import Drive
    from valve_sim.recordings.synthetic import read_profile

    return Drive.of([0.0], [voltage or 0.0]) if profile is None else read_profile(profile)


def _write(output: Path, recording: Recording) -> None:
    from valve_sim.recordings import write_bag, write_csv

    if output.suffix == ".csv":
        write_csv(output, recording.columns())
    else:
        write_bag(output, recording.trace)


def _print_json(recording: Recording, output: Path) -> None:
    from valve_sim.model import published_times

    events = [{**event._asdict(), "kind": event.kind.name.lower()} for event in recording.response.events]
    t1, t2 = published_times(recording.response)
    times = {"t1_ms": 1e3 * t1, "t2_ms": 1e3 * t2}
    print_json({"output": output, "samples": len(recording.trace.sample_times), **times, "events": events})


def _print_events(events: Sequence[Event]) -> None:
    for event in events:
        words = event.kind.name.lower().replace("_", " ")
        click.echo(f"{1e3 * event.time:12.6f} ms  {words:<16}{1e6 * event.position:10.3f} µm{event.velocity:12.6f} m/s")
    if not events:
        click.echo("the valve stays closed")


def _simulate_own(
    plant: Path,
    log: Path | None,
    span: tuple[float | None, float],
    noise_seed: int | None,
    output: Path,
    *,
    as_json: bool,
) -> None:
    """`simulate --plant`: what its sensors would show, as a table in the units of its file."""
    import numpy as np

    from valve_sim.files.plant_files import load_plant
    from valve_sim.files.whole_files import write_whole
    from valve_sim.identification.plants.own_simulation import simulate_plant
    from valve_sim.recordings.columns import read

    if output.suffix != ".csv":
        refuse(f"--output {output}: expected x.csv, a table, with --plant")
    file = load_plant(plant)
    recording = None if log is None else read(log, chosen_map_file())
    if recording is None and file.inputs:
        refuse(f"--plant {plant}: has inputs ({', '.join(file.inputs)}); give a LOG that holds them, with --map")
    duration, rate = span
    if recording is None and duration is None:
        refuse("--duration: is missing; give it, or a LOG")
    columns, events = simulate_plant(file, recording, duration, rate)
    if noise_seed is not None:
        random = np.random.default_rng(noise_seed)
        for name, own in file.outputs.items():
            columns[name] = columns[name] + random.normal(0.0, (own.noise or 0.0) / own.unit.factor, len(columns[name]))
    header, rows = ",".join(columns), np.column_stack(list(columns.values()))
    lines = [header, *(",".join(f"{value:.12g}" for value in row) for row in rows.tolist())]
    write_whole(output, "\n".join(lines) + "\n")
    if as_json:
        found = {"output": output, "samples": len(columns["time"]), "columns": list(columns)}
        print_json(found | {"events": [event._asdict() for event in events]})
        return
    for event in events:
        click.echo(f"{1e3 * event.time:12.6f} ms  {event.name}")
    click.echo(f"wrote {output} ({len(columns['time'])} samples: {', '.join(columns)})")
