"""Truth plants: valves to record test data from, written from MODEL.md alone and sharing no code with the package."""
