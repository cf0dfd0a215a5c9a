"""A force-driven axis as a plant: one mass that friction holds back, such as a servo drive with a ball screw.

    (1)  mass · q'' = F − viscous_friction · q' + Σ effects

What is compared is the drive force: measured, and as (1) asks for it from the measured motion (the inverse dynamic
model of robotics; Janot, Gautier and Brunot 2019). Position is low-passed without phase and differentiated centrally;
both sides of the comparison then pass the same decimation filter. The axis integrates freely, so a simulation over the
whole record tells little; over windows of a second it tells much (`window_rmse`).

Friction and force effects are the valve's: the expressions of the same catalogue entries, added up as in the valve's
Phase 1. "Opening" is motion towards larger q, "closing" towards smaller q.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, signal

from valve_sim.files.parameter_files import off_value
from valve_sim.identification.plants.force_map_choice import force_map_over
from valve_sim.identification.plants.protocol import (
    Array,
    Channel,
    EffectChoice,
    Experiment,
    ForceMap,
    Nuisance,
    Sensor,
)
from valve_sim.identification.plants.root_mean_square import root_mean_square
from valve_sim.identification.plants.variation import group_variations, variation_name
from valve_sim.model import CATALOGUE, DECLARED, Parameter, Tag
from valve_sim.model.core.symbols import Motion as Symbols
from valve_sim.model.core.symbols import Own
from valve_sim.model.core.tracer import Condition, Node, Trace, evaluate, pieces_of_curve

LOW_PASS: Final = 100.0
"""Hz, of the fourth-order Butterworth filter that position passes forwards and backwards."""
DECIMATION: Final = 10
"""Every tenth sample is compared: the filtered force is smooth, and neighbours are nearly equal."""
EDGE: Final = 0.05
"""s at both ends of a record, where filters and differences lack neighbours."""
CRUISE: Final = 0.01
"""The axis cruises while its velocity varies by less than this share of the largest: force changes are then noise."""
SETTLED: Final = 0.1
"""s over which the velocity must vary so little."""
WINDOW_STEP: Final = 0.1
"""s from the start of one freely simulated window to the next."""
SUBSTEPS: Final = 5
"""Steps of the free simulation between two samples."""

BASE: Final = {
    "mass": Parameter("mass", "kg", "all that moves, as seen by the drive", 0.0, 1e6, 100.0, lower_is_allowed=False),
    "viscous_friction": Parameter("viscous_friction", "N·s/m", "against motion", 0.0, 1e6, 100.0),
}
FRICTION: Final = "friction"
"""What varies from one out-and-back to the next: viscous friction, and forces of effects that dissipate."""
_MAP_VARIABLES: Final = ("x", "v", "t", "x·v", "t·v")


EXPECTED_SHARE: Final = 0.1
"""Of the drive's force: the prior scale of what an effect adds to it."""


@dataclass(frozen=True)
class AxisRecord:
    """What was measured, at a fixed rate.

    Attributes:
        source: for messages.
        times: (n,) s. position: (n,) m. force: (n,) N, of the drive, + towards larger positions.
    """

    source: str
    times: Array
    position: Array
    force: Array

    @property
    def rate(self) -> float:
        """Samples a second."""
        return float((len(self.times) - 1) / (self.times[-1] - self.times[0]))


@dataclass(frozen=True)
class Motion:
    """Position, velocity and acceleration (n,) of a record, m and s, free of encoder noise."""

    position: Array
    velocity: Array
    acceleration: Array

    @classmethod
    def of(cls, record: AxisRecord) -> Motion:
        """Motion of a record by zero-phase filtering and central differences."""
        numerator, denominator = signal.butter(4, LOW_PASS / (0.5 * record.rate))
        position = signal.filtfilt(numerator, denominator, record.position)
        velocity = np.gradient(position) * record.rate
        return cls(position, velocity, np.gradient(velocity) * record.rate)


class AxisPlant:
    """The axis behind one record.

    Args:
        record: what was measured.
        declared: mass and viscous friction that a fit starts from.
        sensor: the errors of the force; None: there are none.
        variation: scale of the prior of how much friction varies from one out-and-back to the next; 0: it does not.
    """

    def __init__(
        self,
        record: AxisRecord,
        declared: Mapping[str, float] | None = None,
        sensor: Sensor | None = None,
        variation: float = 0.0,
    ) -> None:
        self.record = record
        self._sensors = {} if sensor is None else {0: sensor}
        self.motion = Motion.of(record)
        self._declared = {name: parameter.prior_scale for name, parameter in BASE.items()} | dict(declared or {})
        self._edge = math.ceil(EDGE * record.rate / DECIMATION)
        force = self._decimated(record.force)
        times = record.times[::DECIMATION][self._edge : self._edge + len(force)]
        self._groups = _repetitions(self.motion)
        self._channels = (
            Channel(
                f"{record.source}: force", "force", times, force, self._thinned(self._cruises()),
                self._thinned(self._groups), "N",
            ),
        )  # fmt: skip
        self._varying = group_variations(self._channels, {FRICTION: variation}) if variation > 0.0 else ()
        self._size = root_mean_square(force)
        fastest = float(np.max(np.abs(self.motion.velocity)))
        expected = EXPECTED_SHARE * self._size
        self._scales = {"N": expected, "N·s/m": expected / fastest, "N·s²/m²": expected / fastest**2}

    @property
    def channels(self) -> Sequence[Channel]:
        """The drive force."""
        return self._channels

    @property
    def base(self) -> Sequence[str]:
        """Mass and viscous friction."""
        return tuple(BASE)

    @property
    def nuisances(self) -> Sequence[Nuisance]:
        """None: force and position are sampled by one clock."""
        return ()

    @property
    def timing_errors(self) -> Sequence[Nuisance]:
        """None: there are no commands."""
        return ()

    @property
    def varying(self) -> Sequence[Nuisance]:
        """Friction, by out-and-back, where it was said to vary."""
        return self._varying

    def sensors(self, values: Mapping[str, float]) -> Mapping[int, Sensor]:
        """The sensor of the force, where its errors were said."""
        return self._sensors

    @property
    def effects(self) -> Mapping[str, EffectChoice]:
        """Effects of the catalogue that any axis can have; a gain of the drive would be mass."""
        return {
            entry.name: EffectChoice(entry.name, tuple(map(self._scaled, entry.parameters)), entry.confused_with)
            for entry in CATALOGUE.tagged(Tag.ANY_AXIS)
        }

    @property
    def force_maps(self) -> Sequence[ForceMap]:
        """Curves over position, velocity and time, and such curves times velocity."""
        fastest = float(np.max(np.abs(self.motion.velocity)))
        spans = {
            "x": (float(np.min(self.motion.position)), float(np.max(self.motion.position)), "m"),
            "v": (-fastest, fastest, "m/s"),
            "t": (float(self.record.times[0]), float(self.record.times[-1]), "s"),
        }
        return [force_map_over(variable, *spans[variable[0]]) for variable in _MAP_VARIABLES]

    @property
    def experiments(self) -> Sequence[Experiment]:
        """None: which trajectories a servo may follow is not known here."""
        return ()

    def parameter(self, name: str) -> Parameter:
        """Unit and range of mass, viscous friction or `<effect>.<parameter>`.

        Raises:
            KeyError: there is none.
        """
        effect, dot, parameter = name.partition(".")
        return self._scaled(CATALOGUE[effect].parameter(parameter)) if dot else BASE[name]

    def _scaled(self, parameter: Parameter) -> Parameter:
        """A parameter of the catalogue with the prior scale of this axis, in place of a small plunger's."""
        scale = self._scales.get(parameter.unit)
        return parameter if scale is None else parameter._replace(prior_scale=scale)

    def declared(self, name: str) -> float:
        """Where a fit starts, or the value at which an effect changes nothing."""
        return off_value(self.parameter(name)) if "." in name else self._declared[name]

    def predict(self, values: Mapping[str, float]) -> list[Array]:
        """The force that (1) asks for, N, at the channel's times."""
        force = self._force(values, np.ones(len(self._groups), dtype=bool))
        for number in np.unique(self._groups).tolist():
            deviation = values.get(variation_name(0, number, FRICTION), 0.0)
            if deviation:
                own = self._groups == number
                force[own] = self._force(self._with_friction(values, 1.0 + deviation), own)
        return [self._decimated(force)]

    def _force(self, values: Mapping[str, float], own: NDArray[np.bool_]) -> Array:
        """The force that (1) asks for, N, at some samples of the record."""
        motion = self.motion
        columns = (motion.position, motion.velocity, motion.acceleration, self.record.times)
        return np.asarray(_drive_force(self._axis(values), *(column[own] for column in columns)))

    def _with_friction(self, values: Mapping[str, float], factor: float) -> dict[str, float]:
        """Values of the parameters with so many times the friction."""
        found = dict(values)
        found["viscous_friction"] = factor * values.get("viscous_friction", self._declared["viscous_friction"])
        for name in values:
            effect, dot, _ = name.partition(".")
            if dot and Tag.DISSIPATIVE in CATALOGUE[effect].tags and self.parameter(name).unit in self._scales:
                found[name] = factor * values[name]
        return found

    def residual_share(self, values: Mapping[str, float]) -> float:
        """Norm of the force residual over the norm of the force: the figure that Janot et al. publish."""
        residual = self._channels[0].data - self.predict(values)[0]
        return float(np.linalg.norm(residual) / np.linalg.norm(self._channels[0].data))

    def window_rmse(self, values: Mapping[str, float], window: float = 1.0) -> float:
        """Root mean square of measured less simulated position, m, over windows that are simulated freely.

        Args:
            values: freed parameters by name.
            window: s; each starts at the measured position and velocity and is driven by the measured force. Windows
                start every WINDOW_STEP, so that where the first one starts does not matter.
        """
        count, edge = round(window * self.record.rate), round(EDGE * self.record.rate)
        starts = np.arange(edge, len(self.record.times) - edge - count, round(WINDOW_STEP * self.record.rate))
        states = np.column_stack((self.motion.position, self.motion.velocity))[starts]
        shown = _simulated_windows(self._axis(values), starts, states, self.record, count)
        measured = self.motion.position[starts[:, None] + np.arange(count)]
        return root_mean_square(measured - shown)

    def _axis(self, values: Mapping[str, float]) -> _Axis:
        """The axis with the effects that are on."""
        effects: dict[str, dict[str, float]] = {}
        for name, value in values.items():
            effect, dot, parameter = name.partition(".")
            if dot:
                effects.setdefault(effect, {})[parameter] = value
        mass, viscous_friction = (values.get(name, self._declared[name]) for name in BASE)
        return _Axis.of(mass, viscous_friction, effects)

    def _decimated(self, values: Array) -> Array:
        """Low-passed and thinned, the edges cut."""
        return self._cut(signal.decimate(values, DECIMATION, zero_phase=True))

    def _thinned(self, values: NDArray[Any]) -> NDArray[Any]:
        return self._cut(values[::DECIMATION])

    def _cut(self, values: NDArray[Any]) -> NDArray[Any]:
        return values[self._edge : len(values) - self._edge]

    def _cruises(self) -> NDArray[np.bool_]:
        """(n,) where the axis has been moving steadily, so that its force ought to be steady too."""
        velocity = self.motion.velocity
        span = round(SETTLED * self.record.rate)
        spread = ndimage.maximum_filter1d(velocity, span) - ndimage.minimum_filter1d(velocity, span)
        return np.asarray(spread < CRUISE * float(np.max(np.abs(velocity))))


def _repetitions(motion: Motion) -> NDArray[np.int64]:
    """(n,) which out-and-back each sample belongs to: it begins where the axis turns at its near end."""
    middle = 0.5 * (float(np.min(motion.position)) + float(np.max(motion.position)))
    below = motion.position < middle
    edges = np.flatnonzero(np.diff(below.astype(np.int8)))
    begins = [
        start + int(np.argmin(motion.position[start:stop]))
        for start, stop in itertools.pairwise(edges)
        if below[start + 1]
    ]
    return np.searchsorted(np.array(begins, dtype=np.int64), np.arange(len(below)), side="right").astype(np.int64)


@dataclass(frozen=True)
class _Axis:
    """Forces of an axis but the drive's, as expressions of its position, velocity and time, and of all numbers.

    Attributes:
        values: the numbers, by name. mass: kg.
        force: all but dry friction, N. friction: dry friction, N, against the motion.
    """

    values: Mapping[str, float]
    mass: float
    force: Node
    friction: Node

    @classmethod
    def of(cls, mass: float, viscous_friction: float, effects: Mapping[str, Mapping[str, float]]) -> _Axis:
        """The pilot plunger of a valve without coil, seat and spring, with effects that are on."""
        trace = Trace()
        values = {"mass": mass, "viscous_friction": viscous_friction}
        x, v, t, direction = (trace.number(name) for name in ("x", "v", "t", "direction"))
        nothing, never = trace.constant(0.0), Condition(trace.constant(-1.0))
        p = Own(**dict.fromkeys(DECLARED, nothing))
        motion = Symbols(x, v, nothing, nothing, t, t, direction, never, never, p)
        force: Node = -trace.number("viscous_friction") * v
        friction: Node = nothing
        for name, given in effects.items():
            entry = CATALOGUE[name]
            whole = {**entry.neutral_values(), **given}
            values |= {f"{name}.{parameter}": value for parameter, value in whole.items()}
            nodes = {parameter: trace.number(f"{name}.{parameter}") for parameter in entry.names}
            own = Own(**{**nodes, **{shape: trace.constant(whole[shape]) for shape in entry.shapes}})
            if entry.force is not None:
                force = force + entry.force(motion, own)
            if entry.friction is not None:
                friction = friction + entry.friction(motion, own)
        return cls(values, mass, force, friction)

    def at(self, x: Array, v: Array, direction: Array, t: Array) -> tuple[Array, Array]:
        """Force, and level of dry friction, N, at (n,) positions, velocities, ways of motion (+1 or −1) and times."""
        values: dict[str, Any] = {**self.values, "x": x, "v": v, "direction": direction, "t": t}
        if self.force.trace.curve is not None:
            values |= pieces_of_curve(self.force.trace.curve, values)
        force, friction = evaluate([self.force, self.friction], values)
        return np.broadcast_to(force, x.shape), np.broadcast_to(friction, x.shape)


def _drive_force(axis: _Axis, x: Array, v: Array, acceleration: Array, times: Array) -> Array:
    """(n,) N: equation (1) solved for the drive's force."""
    direction = np.where(v > 0.0, 1.0, -1.0)
    other, friction = axis.at(x, v, direction, times)
    held = np.where(v != 0.0, direction * friction, 0.0)
    return np.asarray(axis.mass * acceleration - other + held)


def _simulated_windows(axis: _Axis, starts: NDArray[np.int64], states: Array, record: AxisRecord, count: int) -> Array:
    """(w, count) m: (1) integrated from each start, all windows side by side; `states` are their (w, 2) m and m/s.

    Dry friction takes the velocity towards 0 and, within a step, not beyond.
    """
    interval = 1.0 / record.rate
    h = interval / SUBSTEPS
    (x, v), shown = states.T.copy(), np.empty((len(starts), count))
    for i in range(count):
        shown[:, i] = x
        before, after = record.force[starts + i], record.force[starts + i + 1]
        for substep in range(SUBSTEPS):
            share = (substep + 0.5) / SUBSTEPS
            drive = before + share * (after - before)
            direction = np.where((v > 0.0) | ((v == 0.0) & (drive > 0.0)), 1.0, -1.0)
            t = record.times[starts + i] + share * interval
            pushed = v + h * (drive + axis.at(x, v, direction, t)[0]) / axis.mass
            way = np.where(pushed > 0.0, 1.0, -1.0)
            lost = h * axis.at(x, v, way, t)[1] / axis.mass
            v = pushed - np.minimum(lost, np.abs(pushed)) * way
            x = x + h * v
    return shown
