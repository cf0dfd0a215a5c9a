"""Gases by name, as Abel–Noble gases: p (1/ρ − b) = R T, with a constant ratio of specific heats."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple


class Fluid(NamedTuple):
    """An Abel–Noble gas.

    Attributes:
        name: as in parameter files.
        gas_constant: R, J/(kg K).
        covolume: b, m³/kg.
        heat_capacity_ratio: γ, –.
        source: of these numbers.
    """

    name: str
    gas_constant: float
    covolume: float
    heat_capacity_ratio: float
    source: str


_FITTED: Final = "b: fitted here to CoolProp 8.0.0 at 288.15 K, 2 to 35 MPa, where the density is within"
_FLUIDS: Final = (
    Fluid(
        "hydrogen", 4124.5, 7.691e-3, 1.41,
        "b: Chenoweth, SAND83-8229 (1983), as used for hydrogen storage; at 288.15 K from 2 to 87.5 MPa within 1.2 % "
        "of the density of Leachman et al., J. Phys. Chem. Ref. Data 38 (2009) 721",
    ),
    Fluid(
        "nitrogen", 296.80, 3.475e-4, 1.40,
        f"{_FITTED} 4.3 % of Span et al., J. Phys. Chem. Ref. Data 29 (2000) 1361",
    ),
    Fluid("helium", 2077.26, 2.879e-3, 5 / 3, f"{_FITTED} 0.1 % of Ortiz Vega, Texas A&M University (2013)"),
    Fluid("air", 287.05, 2.375e-4, 1.40, f"{_FITTED} 4.6 % of Lemmon et al., J. Phys. Chem. Ref. Data 29 (2000) 331"),
)  # fmt: skip
FLUIDS: Final[Mapping[str, Fluid]] = {fluid.name: fluid for fluid in _FLUIDS}
"""Every gas that a parameter file may name."""
