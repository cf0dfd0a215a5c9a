"""A valve as a Functional Mock-up Unit (FMI 2.0 and 3.0, co-simulation), for other simulation tools.

`export` writes the file; `fmi2` and `fmi3` are what runs inside it, around `cosimulation`, which knows no FMI.
Only the modules that write or run a unit import pythonfmu and pythonfmu3, which the extra `fmi` brings.
"""
