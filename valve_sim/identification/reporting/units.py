"""Numbers for people: in a unit that suits their size, with as many digits as their error has, without exponents."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

from valve_sim.identification.fit.intervals import Interval
from valve_sim.identification.plants.protocol import KEY_OF_UNIT, READABLE_UNITS

_READABLE: Final[Mapping[str, tuple[tuple[float, float, str], ...]]] = {
    "m": ((1e-3, 1e6, "µm"), (1.0, 1e3, "mm")),
    "s": ((1e-3, 1e6, "µs"), (1.0, 1e3, "ms"), (math.inf, 1.0, "s")),
    "A": ((1.0, 1e3, "mA"), (math.inf, 1.0, "A")),
    "Hz": ((1e3, 1.0, "Hz"), (math.inf, 1e-3, "kHz")),
    "Pa": ((1e6, 1e-3, "kPa"), (math.inf, 1e-6, "MPa")),
    "H": ((1e-3, 1e6, "µH"), (1.0, 1e3, "mH"), (math.inf, 1.0, "H")),
    "m²": ((math.inf, 1e6, "mm²"),),
    "m³": ((math.inf, 1e6, "cm³"),),
}
"""SI unit to bound, factor and name of display units, each for sizes below its bound, the last beyond, too."""
_NO_UNIT: Final = ("", "–")
_MOST_PLACES: Final = 7
_LARGE: Final = 1e5
_SIGMAS_95: Final = 1.96
_HALF_MORE: Final = 1.5
_FAR_LESS: Final = 1000.0
"""Ln of the evidence: a set that has less by so much is out of the question."""
_RAISED: Final = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def readable(unit: str, size: float) -> tuple[float, str]:
    """Factor from SI and name of the display unit for a value of this size."""
    options = _READABLE.get(unit, ((math.inf, 1.0, unit),))
    _, factor, name = next((option for option in options if abs(size) < option[0]), options[-1])
    return factor, "" if name in _NO_UNIT else name


def quantity(value: float, unit: str, digits: int = 3) -> str:
    """A number with the unit that suits its size; – where it is not known."""
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return "−∞" if value < 0.0 else "∞"
    scale, name = readable(unit, value)
    return f"{_short(scale * value, digits)} {name}".rstrip()


def percent(probability: float) -> str:
    """A probability in percent; never 0 or 100."""
    if probability >= 0.995:
        return "> 99 %"
    return f"{100 * probability:.0f} %" if probability >= 0.005 else "< 1 %"


def three_digits(value: float) -> str:
    """With trailing zeros, 1.00, so that columns can be compared; – where it is not known."""
    return "–" if math.isnan(value) else _short(value, 3)


def change(before: float, after: float, unit: str) -> str:
    """Of an error in this unit: 1.20 → 1.00 µm."""
    return f"{three_digits(before)} → {three_digits(after)} {unit}"


def error_words(error: float, unit: str) -> str:
    """An error, SI, in the unit in which errors are shown, whatever its size; – where it is not known."""
    scale, name = READABLE_UNITS.get(unit, (1.0, unit))
    return f"{three_digits(scale * error)} {name}" if math.isfinite(error) else "–"


def in_units(values: Mapping[str, Any], unit: str) -> dict[str, Any]:
    """Several entries of a report, each as `in_unit` has it."""
    return {key: own for name, value in values.items() for key, own in in_unit(name, value, unit).items()}


def in_unit(name: str, value: Any, unit: str) -> dict[str, Any]:
    """An entry of a report in the unit in which people read it; where that has a short name, under `<name>_um`, too."""
    return {name: value, f"{name}_{KEY_OF_UNIT[unit]}": value} if unit in KEY_OF_UNIT else {name: value}


def measured(interval: Interval, unit: str) -> str:
    """A value with its standard error, both in the unit that suits them and to the two digits that the error has."""
    if not (math.isfinite(interval.value) and math.isfinite(interval.stderr)):
        return quantity(interval.value, unit)
    scale, name = readable(unit, interval.value or interval.stderr)
    value, error = scale * interval.value, scale * interval.stderr
    places = 1 - math.floor(math.log10(error)) if error > 0.0 else _MOST_PLACES
    if places < 0 and max(abs(value), error) < _LARGE:
        places = 0
    if not 0 <= places < _MOST_PLACES or abs(value) >= _LARGE:
        return f"{_short(value, 5)} ± {_short(error, 2)} {name}".rstrip()
    return f"{value:.{places}f} ± {error:.{places}f} {name}".rstrip().replace("-", "−")


def disagree(interval: Interval) -> bool:
    """Whether one side of a 95 % interval is longer or shorter by more than a half than its standard error says."""
    expected = _SIGMAS_95 * interval.stderr
    if not (math.isfinite(expected) and expected > 0.0):
        return False
    sides = (interval.value - interval.low, interval.high - interval.value)
    return any(not expected / _HALF_MORE <= side <= expected * _HALF_MORE for side in sides)


def amount(interval: Interval, unit: str) -> str:
    """A value with its standard error, or with its 95 % interval where the standard error does not describe it."""
    if not disagree(interval):
        return measured(interval, unit)
    return f"{quantity(interval.value, unit)} (95 %: {limits(interval, unit)})"


def gain_words(log_odds: float) -> str:
    """By how much ln of the evidence is larger than that of the declared model: +12.3, −0.4, < −1000."""
    if log_odds < -_FAR_LESS:
        return f"< −{_FAR_LESS:.0f}"
    return signed(log_odds, 1 if log_odds < _FAR_LESS else 0)


def limits(interval: Interval, unit: str) -> str:
    """The 95 % interval; an open end is infinite."""
    scale, name = readable(unit, interval.value if math.isfinite(interval.value) else interval.low)
    low, high = (
        _short(scale * end, 4) if math.isfinite(end) else ("−∞" if end < 0 else "∞")
        for end in (interval.low, interval.high)
    )
    return f"{low} to {high} {name}".rstrip()


def signed(value: float, places: int) -> str:
    """With its sign, U+2212 for a minus, and so many decimals; what is rounded to nothing has none."""
    words = f"{value:+.{places}f}".replace("-", "−")
    return words if any(digit in words for digit in "123456789") else words[1:]


def _short(value: float, digits: int) -> str:
    """So many significant digits, an exponent only where the number would be long, and U+2212 for a minus."""
    text = f"{value:#.{digits}g}".rstrip(".")
    mantissa, e, exponent = text.partition("e")
    if e and 1e-4 <= abs(value) < _LARGE:
        text = f"{value:.0f}" if abs(value) >= 1.0 else f"{value:.{digits + 3}f}"
    elif e:
        text = f"{mantissa}·10{str(int(exponent)).translate(_RAISED)}"
    return text.replace("-", "−")
