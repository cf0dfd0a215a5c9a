"""A valve as a Functional Mock-up Unit (FMI 2.0, co-simulation), for other simulation tools.

`export` writes the file; the script in `inside` is what runs in it, around `cosimulation`, which knows no FMI.
Only `export` and the script import pythonfmu, which the extra `fmi` brings.
"""
