"""A pilot-operated solenoid valve of an ultra-high-pressure hydrogen vessel: simulated, identified, diagnosed."""

__version__ = "0.2.0"
