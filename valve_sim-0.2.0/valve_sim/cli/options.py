"""Arguments and options that several commands share."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Final

import click

FILE: Final = click.Path(path_type=Path)
MAP_KEY: Final = "valve_sim.map"
"""Where click's context keeps the file given as --map."""


def finite_number(lowest: float = -math.inf, *, is_open: bool = False) -> Callable[[str], float]:
    """The type of an option that takes a finite number, at least `lowest`; above it if `is_open`."""

    def convert(text: str) -> float:
        try:
            found = float(text)
        except ValueError:
            found = math.nan
        if not math.isfinite(found) or found < lowest or (is_open and found == lowest):
            bound = "" if math.isinf(lowest) else f", {'above' if is_open else 'at least'} {lowest:g}"
            raise click.BadParameter(f"found {text!r}, expected a finite number{bound}")
        return found

    return convert


bags_argument = click.argument("bags", metavar="BAG...", type=FILE, nargs=-1, required=True)
params_option = click.option(
    "--params", metavar="FILE", type=FILE, help="Parameter file. Default: the shipped valve.yaml."
)
valve_option = click.option(
    "--valve", "name", metavar="NAME", help="Which valve, if the bag has several, e.g. /tank_1/valve."
)
map_option = click.option(
    "--map",
    metavar="FILE",
    type=FILE,
    expose_value=False,
    callback=lambda context, _, path: context.meta.__setitem__(MAP_KEY, path),
    help="Map: which topic or column is which quantity. The command map drafts one.",
)
plant_option = click.option(
    "--plant",
    metavar="FILE",
    type=FILE,
    help="Plant file: a machine of your own in place of the valve.",
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON in place of text.")
folder_option = click.option("--output", metavar="DIR", type=FILE, required=True, help="Folder for the results.")
