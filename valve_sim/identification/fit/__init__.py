"""The fit: unknowns, sums of squares by stroke, one descent, and what follows from them: theory, section 4."""
