"""A force-driven axis as a plant: one mass that friction holds back, such as a servo drive with a ball screw.

    (1)  mass · q'' = F − viscous_friction · q' + Σ effects

What is compared is the drive force: measured, and as (1) asks for it from the measured motion (the inverse dynamic
model of robotics; Janot, Gautier and Brunot 2019). Position is low-passed without phase and differentiated centrally;
both sides of the comparison then pass the same decimation filter. The axis integrates freely, so a simulation over the
whole record tells little; over windows of a second it tells much (`window_rmse`).

Friction and force effects are the valve's: the same catalogue entries fill the same record, and the compiled equations
of the valve's Phase 1 add them up. "Opening" is motion towards larger q, "closing" towards smaller q.
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
from valve_sim.model import CATALOGUE, DECLARED, Parameter, Phase, Tag
from valve_sim.model.compiling import compiled
from valve_sim.model.effects import new_record
from valve_sim.model.gas.equations import dry_friction, force_without_dry_friction

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
_CORE_NAMES: Final = {"mass": "pilot_mass", "viscous_friction": "pilot_damping"}
FRICTION: Final = "friction"
"""What varies from one out-and-back to the next: viscous friction, and forces of effects that dissipate."""
_FREE_PHASE: Final = int(Phase.PILOT)
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
        shown = np.empty((len(starts), count))
        _simulate_windows(
            self._axis(values), starts, np.column_stack((self.motion.position, self.motion.velocity))[starts],
            self.record.force, self.record.times, 1.0 / self.record.rate, shown,
        )  # fmt: skip
        measured = self.motion.position[starts[:, None] + np.arange(count)]
        return root_mean_square(measured - shown)

    def _axis(self, values: Mapping[str, float]) -> Any:
        """The compiled core's record: a pilot plunger without coil, seat and spring, and the effects that are on."""
        declared = dict.fromkeys(DECLARED, 0.0)
        declared |= {"reference_voltage": 1.0, "coil_resistance": 1.0}
        declared |= {_CORE_NAMES[name]: values.get(name, self._declared[name]) for name in BASE}
        effects: dict[str, dict[str, float]] = {}
        for name, value in values.items():
            effect, dot, parameter = name.partition(".")
            if dot:
                effects.setdefault(effect, {})[parameter] = value
        return new_record(declared, effects)[0]

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


@compiled
def _other_force(p, x, v, direction, t):  # type: ignore[no-untyped-def]
    """All forces but the drive's and dry friction, N."""
    return force_without_dry_friction(p, t, (x, v), (0.0, 0.0), (_FREE_PHASE, direction, 0.0))


@compiled
def _drive_force(p, position, velocity, acceleration, times):  # type: ignore[no-untyped-def]
    """(n,) N: equation (1) solved for the drive's force."""
    force = np.empty(len(times))
    for i in range(len(times)):
        v = velocity[i]
        direction = 1 if v > 0.0 else -1
        held = direction * dry_friction(p, v, direction) if v != 0.0 else 0.0
        force[i] = p.pilot_mass * acceleration[i] - _other_force(p, position[i], v, direction, times[i]) + held
    return force


@compiled
def _simulate_windows(p, starts, states, force, times, interval, shown):  # type: ignore[no-untyped-def]
    """Integrate (1) from each start, `states` its position and velocity.

    Dry friction takes the velocity towards 0 and, within a step, not beyond.
    """
    h = interval / SUBSTEPS
    for window in range(len(starts)):
        first = starts[window]
        x, v = states[window]
        for i in range(shown.shape[1]):
            shown[window, i] = x
            for substep in range(SUBSTEPS):
                share = (substep + 0.5) / SUBSTEPS
                drive = force[first + i] + share * (force[first + i + 1] - force[first + i])
                direction = 1 if v > 0.0 or (v == 0.0 and drive > 0.0) else -1
                t = times[first + i] + share * interval
                pushed = v + h * (drive + _other_force(p, x, v, direction, t)) / p.pilot_mass
                lost = h * dry_friction(p, v, 1 if pushed > 0.0 else -1) / p.pilot_mass
                v = pushed - min(lost, abs(pushed)) * (1.0 if pushed > 0.0 else -1.0)
                x += h * v
