"""From the table of scores to a verdict, and what to record next."""
