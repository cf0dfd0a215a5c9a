"""What a unit runs: one script for each version of FMI, which a copy in the unit brings to the tool that loads it."""
