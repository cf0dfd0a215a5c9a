"""Truth plants: valves to record test data from, sharing no code with the package."""
