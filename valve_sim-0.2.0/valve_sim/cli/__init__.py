"""`valve-sim`: parse, call, print; a module for each command.

Everything that takes long to import is imported by the command that needs it, so that --help answers at once. Exit
codes: 0 done (validate: within), 1 outside (validate), 2 unusable input, with one line on stderr.
"""

from valve_sim.cli.command_line import COMPLETE_VAR
from valve_sim.cli.program import main

__all__ = ["COMPLETE_VAR", "main"]
