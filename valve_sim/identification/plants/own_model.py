"""A machine of a user's own equations, from a file: names and values in, the compiled equations out."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from valve_sim.files.plant_entries import PlantFileError
from valve_sim.files.plant_files import InputEntry, OutputEntry, PlantFile, inlined
from valve_sim.files.recording_map import MapError
from valve_sim.identification.plants.protocol import Array, EffectChoice
from valve_sim.identification.plants.tolerances import hypothesis_of
from valve_sim.model.core.hybrid.system import EquationsError
from valve_sim.model.core.own.equations import Equations
from valve_sim.model.core.own.grammar import Expr, names_in
from valve_sim.model.core.own.simulation import Machine
from valve_sim.model.core.own.units import dimension_words, same
from valve_sim.model.errors import ParameterError
from valve_sim.model.parameters import Parameter, closest
from valve_sim.recordings.columns import Columns

QUANTILES: Final = (0.1, 0.3, 0.5, 0.7, 0.9)
"""Of what a threshold acts on, from which fits start it."""
LAG: Final = 0.01
"""Of a recording's samples, over which its fastest rate is taken."""


class OwnModel:
    """What a plant of a file holds, whatever was measured of it.

    Args:
        file: the machine. recordings: of its inputs and outputs, by which scales that it does not declare are chosen.

    Attributes:
        file: with these scales. refitted: the parameters that are declared `free`.
        effects: those of the file, and that a declared value is wrong.
        corrected: by the name of a column whose gain or offset is estimated, the names of both in the equations.

    Raises:
        PlantFileError: its equations are more than the integrator has room for.
        MapError: a recording lacks an input or every output, or a unit does not fit.
    """

    def __init__(self, file: PlantFile, recordings: Sequence[Columns]) -> None:
        self.file, self._recordings = file, recordings
        self._machines: dict[tuple[str, ...], Machine] = {}
        self._lock = threading.Lock()
        for recording in recordings:
            self._check(recording)
        if recordings:
            self.file = file.sized(self._sizes())
        self._of_effects = {
            f"{name}.{own}": (own, entry)
            for name, effect in self.file.effects.items()
            for own, entry in effect.parameters.items()
        }
        self.refitted = tuple(name for name, own in self.file.parameters.items() if own.free)
        erring = {name for own in recordings for name, column in own.columns.items() if column.gain or column.offset}
        self.corrected = {name: (f"{name} gain", f"{name} offset") for name in sorted(erring)}
        self.delaying = {f"{name}.{own}" for name, effect in file.effects.items() for own in effect.delay.values()}
        self.effects: Mapping[str, EffectChoice] = self._effect_choices()
        self.machine(())

    def parameter(self, name: str) -> Parameter:
        """Unit, range and scale of a parameter of the machine or of an effect.

        Raises:
            KeyError: there is none.
        """
        if name not in self._of_effects:
            entry = self.file.parameters[name]
            size = abs(entry.value) or (
                0.25 * (entry.upper - entry.lower) if math.isfinite(entry.upper - entry.lower) else 1.0
            )
            scale = entry.tolerance or size
            title = entry.title or name.replace("_", " ")
            return Parameter(name, entry.unit.si, title, entry.lower, entry.upper, scale)
        own, found = self._of_effects[name]
        title = found.title or own.replace("_", " ")
        return Parameter(own, found.unit.si, title, found.lower, found.upper, found.scale, found.neutral)

    def declared(self, name: str) -> float:
        """The declared value, or that at which an effect changes nothing; of a shape one within its range."""
        if name not in self._of_effects:
            return self.file.parameters[name].value
        _, found = self._of_effects[name]
        if found.neutral is not None:
            return found.neutral
        if math.isfinite(found.lower) and not found.lower <= found.scale <= found.upper:
            return 0.5 * (found.lower + min(found.upper, found.lower + 2.0 * found.scale))
        return found.scale

    def check_free(self, names: Sequence[str]) -> None:
        """Check that these parameters, or `<effect>.<parameter>`, can be freed.

        Raises:
            ParameterError: there is none of such a name, or none is given.
        """
        known = [*self.file.parameters, *self._of_effects]
        if not names:
            raise ParameterError(
                f"{self.file.path}: frees nothing; write free: true beside a parameter, or give --free NAME"
            )
        for name in names:
            if name not in known:
                alike = closest(name, known)
                raise ParameterError(
                    f"{name}: cannot be freed, {self.file.path} has no such name; did you mean {alike}?"
                )

    def machine(self, effects: tuple[str, ...]) -> Machine:
        """The compiled equations with some effects on.

        Raises:
            PlantFileError: there are more switches and so on than the integrator has room for.
        """
        with self._lock:
            if effects not in self._machines:
                equations = self._with_errors(self.file.equations(effects))
                free = [
                    name for name in equations.parameters
                    if (own := self.file.parameters.get(name)) is None or own.free or own.tolerance or own.varies
                ]  # fmt: skip
                try:
                    self._machines[effects] = Machine(equations, free)
                except EquationsError as error:
                    raise PlantFileError(f"{self.file.path}: {error}") from error
            return self._machines[effects]

    def _with_errors(self, equations: Equations) -> Equations:
        """The equations with factor and offset of each column whose errors are estimated."""
        outputs, names = dict(equations.outputs), list(equations.parameters)
        driven: dict[str, Expr] = {}
        for name, both in self.corrected.items():
            gain, offset = (Expr("name", (), own) for own in both)
            names += both
            if name in self.file.inputs:
                # The machine is driven by the true input, of which the column shows this much.
                hidden = Expr("name", (), f"{name} recorded")
                driven[name] = Expr("+", (Expr("*", (hidden, gain)), offset))
            else:
                outputs[name] = Expr("+", (Expr("*", (outputs[name], gain)), offset))
        inputs = tuple(f"{name} recorded" if name in driven else name for name in equations.inputs)
        corrected = replace(equations, outputs=outputs, inputs=inputs, parameters=tuple(names))
        return corrected.mapped(lambda own: inlined(own, driven))

    def delays(self, values: Mapping[str, float], effects: Sequence[str]) -> dict[str, float]:
        """S by which inputs act and outputs show late, by name, where they do."""
        entries: dict[str, InputEntry | OutputEntry] = {**self.file.inputs, **self.file.outputs}
        found = {name: own.delay for name, own in entries.items() if own.delay}
        for effect in effects:
            for target, own in self.file.effects[effect].delay.items():
                found[target] = found.get(target, 0.0) + values.get(f"{effect}.{own}", 0.0)
        return found

    def longest_delay(self) -> float:
        """s: no input acts later."""
        ends = [own.delay for own in self.file.inputs.values()]
        ends += [effect.parameters[own].upper for effect in self.file.effects.values() for own in effect.delay.values()]
        return math.fsum(ends)

    def _check(self, recording: Columns) -> None:
        known: dict[str, InputEntry | OutputEntry] = {**self.file.inputs, **self.file.outputs}
        for name, column in recording.columns.items():
            if name not in known:
                raise MapError(
                    f"{recording.source}: {name}: is no input and no output of {self.file.path}; expected one of "
                    f"{', '.join(known)}"
                )
            unit = known[name].unit
            if column.unit is not None and not same(column.unit.dimension, unit.dimension):
                raise MapError(
                    f"{recording.source}: {name}: {column.source} is in "
                    f"{dimension_words(column.unit.dimension)}, expected {dimension_words(unit.dimension)}; "
                    "correct its unit in the map"
                )
        for name in self.file.inputs:
            if name not in recording.columns:
                raise MapError(
                    f"{recording.source}: no column is named for the input {name}; add to the map "
                    f"{name}: {{column: ..., unit: ...}}"
                )
        if not any(name in recording.columns for name in self.file.outputs):
            raise MapError(
                f"{recording.source}: no column is named for an output; add to the map one of "
                f"{', '.join(self.file.outputs)}"
            )

    def _sizes(self) -> dict[str, float]:
        """How large signals are, SI: of inputs the largest, of what sensors show half the range, of time the longest.

        Of a state that is the rate of one that a sensor shows it is the fastest mean rate over `LAG` of a recording; of
        one of which a sensor shows the rate, half of the way that this makes.
        """
        columns = [column for recording in self._recordings for column in recording.columns.values()]
        found = {"t": max(float(np.ptp(column.times)) for column in columns)}
        found["time"] = found["t"]
        for name, entry in self.file.inputs.items():
            found[name] = max(float(np.max(np.abs(own[name].si(entry.unit)))) for own in self._recordings)
        for name, output in self.file.outputs.items():
            shown = [(own[name].times, own[name].si(output.unit)) for own in self._recordings if name in own.columns]
            if not shown:
                continue
            found[name] = 0.5 * max(float(np.ptp(values)) for _, values in shown)
            if output.value.op == "name" and output.value.value in self.file.states:
                state = str(output.value.value)
                found[state] = found[name]
                rate = self.file.derivatives[state]
                if rate.op == "name" and rate.value in self.file.states:
                    found.setdefault(str(rate.value), max(_fastest(times, values) for times, values in shown))
                for other, its in self.file.derivatives.items():
                    if its.op == "name" and its.value == state:
                        way = max(float(np.ptp(_integral(times, values))) for times, values in shown)
                        found.setdefault(other, 0.5 * way)
        return found

    def _effect_choices(self) -> dict[str, EffectChoice]:
        found = {}
        for name, entry in self.file.effects.items():
            parameters = tuple(self.parameter(f"{name}.{own}") for own in entry.parameters)
            found[name] = EffectChoice(name, parameters, entry.confused_with, places=self._places(name))
        for name, own in self.file.parameters.items():
            if own.tolerance:
                key = hypothesis_of(name)
                parameter = self.parameter(name)._replace(off=own.value)
                found[key] = EffectChoice(key, (parameter,), is_declared_value=True)
        return found

    def _places(self, effect: str) -> dict[str, tuple[float, ...]]:
        """Where thresholds of an effect may lie: at quantiles of what they are compared with, if that is measured."""
        found: dict[str, tuple[float, ...]] = {}
        entry = self.file.effects[effect]
        for name, own in entry.parameters.items():
            if own.neutral is not None:
                continue
            seen = [self._seen(acted) for added in entry.add.values() for acted in _compared_with(added, name)]
            values = [one for one in seen if one is not None]
            if values:
                places = np.quantile(np.concatenate(values), QUANTILES)
                within = [float(p) for p in places if own.lower < p < own.upper]
                if within:
                    found[f"{effect}.{name}"] = tuple(dict.fromkeys(within))
        return found

    def _seen(self, name: str) -> Array | None:
        """The recorded signal of a state, input or output; None if there is none."""
        for shown, output in self.file.outputs.items():
            if name == shown or (output.value.op == "name" and output.value.value == name):
                columns = [own[shown].si(output.unit) for own in self._recordings if shown in own.columns]
                return np.concatenate(columns) if columns else None
        if name in self.file.inputs:
            return np.concatenate([own[name].si(self.file.inputs[name].unit) for own in self._recordings])
        return None


def _fastest(times: Array, values: Array) -> float:
    """The fastest mean rate over `LAG` of a recording: over shorter times noise would be rates, too."""
    lag = max(1, round(LAG * len(values)))
    return float(np.max(np.abs(values[lag:] - values[:-lag]) / (times[lag:] - times[:-lag]), initial=0.0))


def _integral(times: Array, values: Array) -> Array:
    """(n,) over the times, from 0 on, on straight lines between samples."""
    steps = 0.5 * np.diff(times) * (values[1:] + values[:-1])
    return np.concatenate([[0.0], np.cumsum(steps)])


def _compared_with(expression: Expr, name: str) -> list[str]:
    """Names that stand in one sum or comparison with a name: of x − level it is x."""
    found: list[str] = []
    if expression.op in ("-", "+", ">", "min", "max"):
        sides = [names_in(own) for own in expression.args]
        if any(side == (name,) for side in sides):
            found += [one for side in sides for one in side if one != name]
    return found + [one for own in expression.args for one in _compared_with(own, name)]
