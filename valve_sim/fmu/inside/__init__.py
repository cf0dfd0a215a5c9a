"""What a unit runs: a script, of which a copy in the unit brings the valve to the tool that loads it."""
