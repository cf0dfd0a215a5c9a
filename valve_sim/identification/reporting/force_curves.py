"""Force maps restricted to where the data determine them: the range that the machine visited while it moved.

A force map spans the whole range of its variable. Where the machine never was, or only rested against a stop that
takes up any force, the data do not determine it, only its smoothness does: it may reach thousands of newtons there
beside a fault of a tenth of one. So the curve is drawn, and its size and place are given, for samples of motion alone.
A map that is a damping is collinear with the machine's own dampings, which are free too: its mean, which one of these
could be, is subtracted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.diagnosis.outcome import Diagnosis
from valve_sim.identification.fit.curves import Unexplained
from valve_sim.identification.fit.gram import root_mean_square
from valve_sim.identification.plants.protocol import Array
from valve_sim.identification.reporting.document import Line, Panel, Plot
from valve_sim.identification.reporting.units import gain_words, quantity
from valve_sim.model.effects import is_damping

MOVES: Final = 0.02
"""Share of the fastest speed above which the machine counts as moving."""
PULLS: Final = 0.1
"""Share of the rated current below which a force proportional to its square is not visible."""
STRONG: Final = 0.5
"""Share of the largest force above which the force counts as acting at a place."""
_FACTOR_WORDS: Final = {"·v": ", times velocity", "·u²": ", with the current squared"}
_AXES: Final = {"x": ("position", 1e3, "mm"), "v": ("velocity", 1.0, "m/s"), "t": ("time", 1e3, "ms")}


class MovingSamples(NamedTuple):
    """The fitted samples at which the machine moves; (n,) each, SI.

    Attributes:
        current: over the rated one, 1 where it is not known. damping: which of the machine's dampings acts, by number.
    """

    position: Array
    velocity: Array
    time: Array
    current: Array
    damping: NDArray[np.int64]


@dataclass(frozen=True)
class ForceCurve:
    """A force map over the range that the data visited.

    Attributes:
        variable: what it is a function of, as in `ForceMap`. gain: of the score S against the model without it.
        label: of the axis; force_label: of the force, with unit.
        at: (n,) in the unit of the axis. force: (n,) in N, or N·s/m of a damping; NaN outside the data.
        band: (n,) two standard errors of the force; NaN where they are not known.
        rms: of the force as it acts at the samples of motion, N. where: it is strongest, in words.
    """

    variable: str
    gain: float
    label: str
    force_label: str
    at: Array
    force: Array
    band: Array
    rms: float
    where: str

    def plot(self) -> Plot:
        """The curve with its band."""
        low, high = self.force - self.band, self.force + self.band
        panel = Panel(self.force_label, [Line("after", self.force)], low, high, has_zero=True)
        axis = self.label.partition(",")[0] + _FACTOR_WORDS.get(self.variable[1:], "")
        gain, rms = gain_words(0.5 * self.gain), quantity(self.rms, "N")
        caption = f"ln evidence {gain} · rms {rms} · strongest at {self.where}"
        return Plot(f"over {axis}", caption, self.at, self.label, [panel])


def unexplained_json(entry: Unexplained, motion: MovingSamples) -> dict[str, Any]:
    """Size and place over the range that the data visited: beyond, only smoothness determines the curve."""
    curve = force_curve(entry, motion)
    return {
        "force_rms_n": curve.rms,
        "where": curve.where,
        "variable": entry.variable,
        "at": list(entry.at),
        "force": list(entry.force),
        "force_stderr": list(entry.stderr),
        "delta_bic": -entry.gain,
    }


def motion_of(diagnosis: Diagnosis) -> MovingSamples:
    """The samples of motion, from the refitted declared model: its velocity has no noise."""
    fitted = diagnosis.before.fit
    plant = fitted.problem.plant
    shown = plant.predict(fitted.values)
    parts: list[tuple[NDArray[Any], ...]] = []
    for index, channel in enumerate(plant.channels):
        if channel.unit != "m" or len(channel.times) < 3:
            continue
        speed = np.gradient(shown[index], channel.times)
        current = plant.currents_at(channel.times, fitted.values)
        damping = plant.dampings_at(shown[index])
        takes_part = fitted.problem.weight(index) > 0.0
        parts.append(tuple(values[takes_part] for values in (shown[index], speed, channel.times, current, damping)))
    if not parts:
        nothing = np.empty(0)
        return MovingSamples(nothing, nothing, nothing, nothing, np.empty(0, np.int64))
    columns = [np.concatenate(values) for values in zip(*parts, strict=True)]
    moves = np.abs(columns[1]) > MOVES * np.max(np.abs(columns[1]), initial=0.0)
    return MovingSamples(*(values[moves] for values in columns))


def force_curve(entry: Unexplained, motion: MovingSamples) -> ForceCurve:
    """A force map restricted to the range that the data visited; all of it where the motion is not known."""
    drawn, shown = np.array(entry.at), np.array(entry.force)
    samples, factor = _visits(entry.variable, motion)
    is_known = len(motion.position) > 0
    seen = _near(drawn, samples) if is_known else np.ones(len(drawn), bool)
    acting = np.interp(samples, drawn, shown) * factor if is_known else shown
    if is_damping(entry.variable) and is_known:
        acting, shown = _without_damping(entry.variable, motion, acting, drawn, shown)
    values = np.where(seen, shown, np.nan)
    name, scale, unit = _AXES.get(entry.variable[0], (entry.variable, 1.0, ""))
    rms = root_mean_square(acting) if len(acting) else 0.0
    band = np.where(seen, 2.0 * _errors(entry), np.nan)
    return ForceCurve(
        entry.variable, entry.gain, f"{name}, {unit}", _force_label(entry.variable), scale * drawn, values, band,
        rms, _where(name, unit, scale * drawn, values),
    )  # fmt: skip


def _visits(variable: str, motion: MovingSamples) -> tuple[Array, Array]:
    """The places of the samples on the axis of a map, and the factor by which its curve is multiplied there."""
    samples = {"x": motion.position, "v": motion.velocity, "t": motion.time}.get(variable[0], np.empty(0))
    if is_damping(variable):
        return samples, -motion.velocity
    if variable.endswith("u²"):
        pulls = motion.current > PULLS
        return samples[pulls], motion.current[pulls] ** 2
    return samples, np.ones(len(samples))


def _without_damping(
    variable: str, motion: MovingSamples, acting: Array, drawn: Array, shown: Array
) -> tuple[Array, Array]:
    """A damping map less its mean over the samples; over x, less the mean in the range of each of the dampings."""
    acting, shown = acting.copy(), shown.copy()
    number = motion.damping if variable == "x·v" else np.zeros(len(acting), np.int64)
    for one in np.unique(number):
        chosen = number == one
        velocity = motion.velocity[chosen]
        damping = -float(acting[chosen] @ velocity / (velocity @ velocity))
        acting[chosen] += damping * velocity
        place = motion.position[chosen]
        reached = (drawn >= place.min()) & (drawn <= place.max()) if variable == "x·v" else slice(None)
        shown[reached] -= damping
    return acting, shown


def _near(drawn: Array, samples: Array) -> NDArray[np.bool_]:
    """(n,) whether a sample lies within one step of each drawn point."""
    if not len(samples):
        return np.zeros(len(drawn), bool)
    step = drawn[1] - drawn[0]
    counts, _ = np.histogram(samples, np.concatenate([drawn - 0.5 * step, [drawn[-1] + 0.5 * step]]))
    visited = counts > 0
    widened = visited.copy()
    widened[1:] |= visited[:-1]
    widened[:-1] |= visited[1:]
    return np.asarray(widened)


def _errors(entry: Unexplained) -> Array:
    return np.array(entry.stderr) if entry.stderr else np.full(len(entry.at), np.nan)


def _force_label(variable: str) -> str:
    if is_damping(variable):
        return "damping, N·s/m"
    return "force at rated current, N" if variable.endswith("u²") else "force, N"


def _where(name: str, unit: str, at: Array, force: Array) -> str:
    """Where a curve is strongest, of where it is drawn."""
    if np.isnan(force).all():
        return "no place that the data visited"
    strong = np.flatnonzero(np.abs(np.nan_to_num(force)) >= STRONG * np.nanmax(np.abs(force)))
    ends = dict.fromkeys(f"{at[place]:.3g}".replace("-", "−") for place in (strong[0], strong[-1]))
    return f"{name} {' to '.join(ends)} {unit}"
