"""Nodes as processes: how they keep time, what a station takes, and how they stand a busy machine."""
