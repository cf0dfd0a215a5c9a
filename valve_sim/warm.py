"""Compile the model now, so that no first command or node has to: `python -m valve_sim.warm`.

What is compiled is kept in the user's cache folder and found there from then on. `make` runs this; after pip or colcon,
which run no code of a package, it can be run by hand, or each first use takes a second or two. `--gas` compiles the
model with gas as well, which most never use.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from typing import Final

import numpy as np

from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.estimation.budget import Budget
from valve_sim.identification.estimation.noise import Noise
from valve_sim.identification.estimation.rows import CondensedRows
from valve_sim.identification.plants.protocol import Direction
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.model import CATALOGUE, Drive, Stepper, Valve, ValveError, simulate, simulate_many
from valve_sim.model.core.machine import when_compiling
from valve_sim.model.gas import GasParameters
from valve_sim.model.runs import WIDTHS
from valve_sim.traces import Trace

COMPILING: Final = "compiling the model for this machine, once"
NO_NOISE: Final = Noise(1.0, 1.0, (), 0.0, 0)
"""White, of 1 m: nothing is fitted here."""


def warm() -> None:
    """Have compiled code at hand: of a valve with each effect alone, with derivatives, live, and of a fit."""
    valve = default_valve()
    drive = Drive.of([0.0], [valve.parameters.reference_voltage])
    simulate(valve, drive, [0.0, 1e-3])
    simulate_many([valve], drive, [0.0, 1e-3], threads=1)
    _warm_plans(valve, has_gas=False)
    stepper = Stepper(valve)
    stepper.command(1e-3, valve.parameters.reference_voltage)
    stepper.set_valve(valve, 2e-3)
    stepper.advance(3e-3)
    _warm_fits(valve, drive)


def _warm_fits(valve: Valve, drive: Drive) -> None:
    """Residuals, and derivatives: all that a run has room for, or the first few of it; and those of fewer rows."""
    white, shown = np.empty((2, 1)), np.zeros((2, 2))
    for columns in (shown[:, :1], shown[:, :1].copy()):
        NO_NOISE.whiten_into(white, columns, np.ones(2))
    times = np.array([0.0, 1e-3, 2e-3])
    plant = ValvePlant([Trace("nothing", drive, times, np.zeros(3))], valve)
    fewer = CondensedRows(plant, [np.ones(3)], [NO_NOISE], Budget.unlimited())
    fewer.residuals({})
    for count in (1, 4):
        fewer.sensitivities({}, count * [Direction({"main_damping": 1.0}, 1e-6)])


def warm_gas() -> None:
    """Compile what a valve with gas needs: with each effect alone, and with derivatives."""
    sizes = GasParameters(1e7, 1e-5, 2e-4, 3e-3, 4e-3)
    for demand in (0.0, 1e-4):
        gas = sizes._replace(demand_orifice_diameter=demand)
        valve = replace(default_valve().with_values(seat_load=0.3), gas=gas)
        _warm_plans(valve, has_gas=True)
        simulate(valve, Drive.of([0.0], [valve.parameters.reference_voltage]), [0.0, 1e-3])


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
