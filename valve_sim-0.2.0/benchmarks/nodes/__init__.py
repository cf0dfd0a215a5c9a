"""Nodes as processes: how they keep time, what a station takes, how they stand a busy machine and a long day."""
