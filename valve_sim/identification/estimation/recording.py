"""Errors of a recording on a machine that stays as it is: clocks and stamps, and nothing of the machine."""

from __future__ import annotations

from collections.abc import Mapping

from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.estimation.solver import fit


def fit_recording(problem: Problem, machine: Mapping[str, float]) -> Fit:
    """What a machine of known values shows of a recording, once the errors of the recording are estimated.

    Errors of the commands' stamps are among them where the evidence is for it: most recorders stamp commands well, and
    a few stamp them when they happen to receive them.

    Args:
        problem: the recording. machine: values of the machine by name; what is missing is as declared.

    Raises:
        SimulationError: the machine cannot be simulated.
    """
    plant = problem.plant
    clocks = tuple(own for own in plant.nuisances if not own.is_of_machine)
    plain = fit(problem, (), {}, nuisances=clocks, fixed=machine)
    if not plant.timing_errors:
        return plain
    stamped = fit(problem, (), plain.values, nuisances=(*clocks, *plant.timing_errors), fixed=machine)
    return max(plain, stamped, key=lambda found: found.log_evidence)
