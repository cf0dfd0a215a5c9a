"""Machines as identification sees them: parameters by name, inputs and sample times in, what sensors would show out."""
