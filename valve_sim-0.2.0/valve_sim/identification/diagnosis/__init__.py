"""Search, posterior and held-out strokes in one run: recordings to a verdict, and what to record next."""
