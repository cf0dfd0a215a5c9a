"""Real hydrogen at 288.15 K as CoolProp has it, written once: `python coolprop_table.py > coolprop_hydrogen.csv`.

CoolProp's wheel is 11 MB and neither the package nor its tests need it, so its values are kept instead. The equation of
state is that of Leachman et al., J. Phys. Chem. Ref. Data 38 (2009) 721.
"""

import math
import sys

import CoolProp  # type: ignore[import-not-found]
from CoolProp.CoolProp import PropsSI  # type: ignore[import-not-found]

TEMPERATURE = 288.15
FLUID = "Hydrogen"


def flux(upstream: float, pressure: float) -> float:
    """Of an isentropic expansion to a pressure, kg/(m² s)."""
    enthalpy, entropy = (PropsSI(name, "P", upstream, "T", TEMPERATURE, FLUID) for name in ("HMASS", "SMASS"))
    after, density = (PropsSI(name, "P", pressure, "SMASS", entropy, FLUID) for name in ("HMASS", "DMASS"))
    return float(density * math.sqrt(2.0 * max(0.0, enthalpy - after)))


def largest_flux(upstream: float) -> float:
    """By golden section, kg/(m² s)."""
    low, high, part = 0.3 * upstream, 0.7 * upstream, (math.sqrt(5.0) - 1.0) / 2.0
    while high - low > 1e-7 * upstream:
        left, right = high - part * (high - low), low + part * (high - low)
        if flux(upstream, left) > flux(upstream, right):
            high = right
        else:
            low = left
    return flux(upstream, 0.5 * (low + high))


if __name__ == "__main__":
    sys.stdout.write(f"# {FLUID} at {TEMPERATURE} K, CoolProp {CoolProp.__version__}, by coolprop_table.py\n")
    sys.stdout.write("pressure,density,choked_flux,flux_to_90_percent\n")
    for pressure in (2e6, 5e6, 10e6, 20e6, 35e6, 50e6, 70e6, 87.5e6):
        density = PropsSI("DMASS", "P", pressure, "T", TEMPERATURE, FLUID)
        choked, subsonic = largest_flux(pressure), flux(pressure, 0.9 * pressure)
        sys.stdout.write(f"{pressure:g},{density:.8g},{choked:.8g},{subsonic:.8g}\n")
