"""Signal processing on arrays: what rests, moves, steps or spikes in a signal. It knows no valve and no file."""
