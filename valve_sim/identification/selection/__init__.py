"""Which model: hypotheses, their fits, criteria, residual tests, held-out data."""
