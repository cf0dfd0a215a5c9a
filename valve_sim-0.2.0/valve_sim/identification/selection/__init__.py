"""Which effects act: hypotheses, the search over them, their evidence and posterior, predictions of held-out data."""
