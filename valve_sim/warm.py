"""Compile the model now, so that no first command or node has to: `python -m valve_sim.warm`.

What is compiled is kept in the user's cache folder and found there from then on. `make` runs this; after pip or colcon,
which run no code of a package, it can be run by hand, or each first use takes a second or two. `--gas` compiles the
model with gas as well, which most never use.
"""

from __future__ import annotations

from valve_sim import early_signals  # noqa: F401 -- first, for its effect

# isort: split

import argparse
import sys
from dataclasses import replace
from typing import Final

from valve_sim.files.parameter_files import default_valve
from valve_sim.model import CATALOGUE, Valve, ValveError
from valve_sim.model.core.machine import when_compiling
from valve_sim.model.core.plan import integrator
from valve_sim.model.gas import GasParameters
from valve_sim.model.runs import WIDTHS

COMPILING: Final = "compiling the model for this machine, once"


def warm() -> None:
    """Have compiled code at hand: the integrator, and the equations of a valve with each effect alone."""
    integrator(False)
    _warm_plans(default_valve(), has_gas=False)


def warm_gas() -> None:
    """Have at hand what a valve with gas needs, with each effect alone."""
    integrator(True)
    sizes = GasParameters(1e7, 1e-5, 2e-4, 3e-3, 4e-3)
    for demand in (0.0, 1e-4):
        gas = sizes._replace(demand_orifice_diameter=demand)
        _warm_plans(replace(default_valve().with_values(seat_load=0.3), gas=gas), has_gas=True)


def _warm_plans(valve: Valve, *, has_gas: bool) -> None:
    """The equations of a valve with each effect alone, without derivatives and with them."""
    alone = [name for name, effect in CATALOGUE.items() if effect.is_of(has_gas=has_gas)]
    for effects in ({}, *({name: CATALOGUE[name].neutral_values()} for name in alone)):
        for width in WIDTHS:
            replace(valve, effects=effects).plan(width)


def main() -> int:
    """Compile what is missing; 0, or 2 after one line on stderr."""
    parser = argparse.ArgumentParser(description="Compile the model now, so that no first command or node has to.")
    parser.add_argument("--gas", action="store_true", help="the model with gas as well")
    has_gas = parser.parse_args().gas
    when_compiling(lambda: print(COMPILING, flush=True))
    try:
        warm()
        if has_gas:
            warm_gas()
    except ValveError as error:
        print(f"warm: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
