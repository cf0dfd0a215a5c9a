"""`valve-sim history`."""

from __future__ import annotations

from datetime import datetime, timezone
from pathlib import Path

import click

from valve_sim.cli.command_line import Command
from valve_sim.cli.options import FILE, json_option
from valve_sim.cli.printing import print_json

_DAY = click.DateTime(["%Y-%m-%d", "%Y-%m-%dT%H:%M:%S"])


@click.command(cls=Command)
@click.argument("valve")
@click.option("--archive", metavar="DIR", type=FILE, required=True, help="The archive.")
@click.option("--since", metavar="DAY", type=_DAY, help="From this day or time on, UTC, e.g. 2026-11-01.")
@click.option("--until", metavar="DAY", type=_DAY, help="Until before this day or time, UTC.")
@click.option("--plot", metavar="PNG", type=FILE, help="Draw the figures of all strokes over time.")
@json_option
def history(
    *, valve: str, archive: Path, since: datetime | None, until: datetime | None, plot: Path | None, as_json: bool
) -> None:
    r"""Print what an archive holds of a valve.

    The medians of each month's strokes, then findings and alarms. archive_node fills an archive from running monitors:
      valve-sim history tank_1/valve --archive archive

    All strokes since a day as a picture:
      valve-sim history tank_1/valve --archive archive --since 2026-01-01 \
          --plot tank_1.png

    Read on: docs/how_to/archive.md
    """
    from valve_sim.records.archive import Archive
    from valve_sim.records.story import plot_story, story_json, story_text, tell

    first, last = (None if day is None else day.replace(tzinfo=timezone.utc) for day in (since, until))
    story = tell(Archive(archive), valve, first, last)
    if plot is not None:
        plot_story(plot, story)
    if as_json:
        print_json(story_json(story))
    else:
        click.echo(story_text(story))
        if plot is not None:
            click.echo(f"wrote {plot}")
