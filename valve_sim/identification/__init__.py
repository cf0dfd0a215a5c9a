"""Fits and diagnoses: what measured strokes say of a machine. Knows plants, not valves, but for `valve_plant`."""
