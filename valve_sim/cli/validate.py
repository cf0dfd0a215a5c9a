"""`valve-sim validate`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final, TypeVar

import click

from valve_sim.cli.command_line import Command
from valve_sim.cli.options import (
    FILE,
    bags_argument,
    finite_number,
    json_option,
    map_option,
    plant_option,
    valve_option,
)
from valve_sim.cli.printing import print_report, progress_bar, refuse, shown
from valve_sim.cli.reading import chosen_params, declared_valve, is_own, read_plant, read_recordings, recorded_name

Decorated = TypeVar("Decorated", bound=Callable[..., object])
OUTSIDE: Final = 1
"""Exit code where a recording is outside the tolerance."""


def _tolerance_option(unit: str, words: str) -> Callable[[Decorated], Decorated]:
    """--tolerance-<unit>: the largest error of one quantity."""
    return click.option(
        f"--tolerance-{unit}",
        metavar=unit.upper(),
        type=finite_number(0.0, is_open=True),
        show_default="3 times the standard deviation that is predicted",
        help=words,
    )


@click.command(cls=Command)
@bags_argument
@click.option("--params", metavar="FILE", type=FILE, help="Parameter file of the valve to check.")
@plant_option
@click.option(
    "--tolerance",
    metavar="SI",
    type=finite_number(0.0, is_open=True),
    help="With --plant: largest rms error of its first output, in its SI unit.",
)
@_tolerance_option("um", "Largest rms error, µm.")
@_tolerance_option("ma", "Largest rms error of the current, mA, for recordings without positions.")
@_tolerance_option("kpa", "Largest rms error of the outlet's pressure, kPa, for a valve with gas.")
@click.option("--junit", metavar="XML", type=FILE, help="Write a JUnit report, a test case for each stroke.")
@click.option(
    "--plot",
    metavar="PNG",
    type=FILE,
    help="Draw what was measured and predicted, and the residual (one BAG; its first signal).",
)
@valve_option
@map_option
@json_option
def validate(
    *,
    bags: tuple[Path, ...],
    params: Path | None,
    plant: Path | None,
    tolerance: float | None,
    tolerance_um: float | None,
    tolerance_ma: float | None,
    tolerance_kpa: float | None,
    junit: Path | None,
    plot: Path | None,
    name: str | None,
    as_json: bool,
) -> int:
    r"""Check a declared valve against recordings.

    The recorded commands are replayed on the declared valve. The exit code is 0 if every stroke is within the
    tolerance, and 1 if not:
      valve-sim validate bags/one_opening.mcap --params config/valve.yaml

    A stroke is within the tolerance if its root-mean-square error is, over all its samples and over those in which the
    model moves. By default the tolerance is three times the predicted standard deviation, which follows from the
    sensor's noise and from the tolerances in the file. No parameter of the valve is estimated, only the offset between
    the clocks of commands and samples and, where the recording shows them, errors of the commands' stamps, each with
    the prior N(0, 50 µs).

    In continuous integration; with a machine of your own:
      valve-sim validate tests/*.mcap --params results/identified.yaml \
          --tolerance-um 17 --junit replay.xml
      valve-sim validate log.csv --plant results/corrected.yaml --map map.yaml

    Read on: docs/tutorials/first_diagnosis.md
    """
    params = chosen_params(plant, params)
    if plant is not None and is_own(plant):
        given = (("--tolerance-um", tolerance_um), ("--tolerance-ma", tolerance_ma), ("--tolerance-kpa", tolerance_kpa))
        for option, value in given:
            if value is not None:
                refuse(f"{option}: is for valves; with --plant give --tolerance, in SI")
    elif params is None:
        raise click.UsageError("Missing option '--params' or '--plant'.", click.get_current_context())
    elif tolerance is not None:
        refuse("--tolerance: is for --plant; give --tolerance-um, --tolerance-ma or --tolerance-kpa")
    if plot is not None and len(bags) > 1:
        raise click.UsageError("--plot draws one recording; give one BAG", click.get_current_context())
    from valve_sim.files.whole_files import refuse_unwritable, write_whole
    from valve_sim.identification.reporting.validation_document import validation_document
    from valve_sim.identification.validation.own_plant import validate_plant
    from valve_sim.identification.validation.replay import validate as replay

    planned = [path for path in (junit, plot) if path]
    refuse_unwritable(*planned)
    if plant is not None and is_own(plant):
        result = validate_plant(read_plant(plant, bags), tolerance)
    else:
        valve = declared_valve(params, recorded_name(bags, name) if params else None)
        traces = read_recordings(bags, name, valve)
        with progress_bar() as progress:
            result = replay(
                traces, valve, None if tolerance_um is None else 1e-6 * tolerance_um,
                current_tolerance=None if tolerance_ma is None else 1e-3 * tolerance_ma,
                pressure_tolerance=None if tolerance_kpa is None else 1e3 * tolerance_kpa, progress=progress,
            )  # fmt: skip
    document = validation_document(result)
    if junit is not None:
        write_whole(junit, shown(document.to_junit()))  # XML has no place for control characters
    if plot is not None:
        from valve_sim.identification.reporting.figures import save_plots

        save_plots(document, plot)
    print_report(document.to_json(), document.to_text(), [path for path in (junit, plot) if path], as_json)
    return 0 if result.passed else OUTSIDE
