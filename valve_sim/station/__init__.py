"""What a filling station has beside its valves: so far the dispenser that opens them in turn."""
