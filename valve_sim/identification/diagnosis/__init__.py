"""The run from recordings to a verdict: search, posterior and held-out strokes together, and what to record next."""
