"""`valve-sim commission`."""

from __future__ import annotations

from datetime import datetime, timezone
from pathlib import Path

import click

from valve_sim.cli.command_line import Command
from valve_sim.cli.options import FILE, folder_option, json_option
from valve_sim.cli.printing import print_json
from valve_sim.files.ledger import plan_files


@click.command(cls=Command)
@click.argument("report", type=FILE)
@click.option("--params", metavar="FILE", type=FILE, required=True, help="The parameter file that is signed off.")
@click.option("--serial", metavar="NUMBER", required=True, help="Serial number of the valve.")
@click.option("--by", metavar="NAME", required=True, help="Who signs.")
@click.option(
    "--sensors", metavar="FILE", type=FILE, required=True, help="The sensors with their certificates: see above."
)
@click.option("--days", type=click.IntRange(1, 36500), default=365, help="How long it is valid, days.")
@click.option("--note", metavar="TEXT", default="", help="A note for the record.")
@folder_option
@json_option
def commission(
    *,
    report: Path,
    params: Path,
    serial: str,
    by: str,
    sensors: Path,
    days: int,
    note: str,
    output: Path,
    as_json: bool,
) -> None:
    r"""Sign off a calibration.

    REPORT is the identify.json or the report.json that the figures are from, with their intervals. Writes
    DIR/calibration.json, the record, and DIR/calibration.html, the page to be printed and signed:
      valve-sim identify bags/eight_strokes.mcap --output results
      echo '- {name: laser, serial_number: L-12, certificate: DKD 1234,
          expires: 2099-05-01}' > sensors.yaml
      valve-sim commission results/identify.json --by Lovelace --serial SN-7 \
          --params results/identified.yaml --sensors sensors.yaml \
          --output results

    The sensors are a list in YAML; the record is valid no longer than the certificate that expires first. It holds the
    digests of the parameter file, of the report and of itself, so that a change by hand shows.

    Read on: docs/how_to/calibration.md
    """
    from valve_sim.files.parameter_files import load_valve
    from valve_sim.model import CATALOGUE, DECLARED
    from valve_sim.model.gas.parameters import GAS
    from valve_sim.records.calibration import read_sensors, save_record, sign
    from valve_sim.records.certificate import write_certificate

    load_valve(params)
    units = {name: entry.unit for name, entry in DECLARED.items()}
    units |= {f"gas.{name}": entry.unit for name, entry in GAS.items()}
    units |= {f"{name}.{entry.name}": entry.unit for name, effect in CATALOGUE.items() for entry in effect.parameters}
    record_file, page = output / "calibration.json", output / "calibration.html"
    record = sign(
        report, params, read_sensors(sensors), serial_number=serial, signed_by=by,
        now=datetime.now(timezone.utc), days=days, units=units, note=note,
    )  # fmt: skip
    plan_files(record_file, page)
    save_record(record_file, record)
    write_certificate(page, record)
    if as_json:
        print_json(record.to_json())
        return
    click.echo(f"valve {serial}: {len(record.figures)} figures signed off by {by}, valid until {record.valid_until}")
    click.echo(f"wrote {record_file} and {page}")
