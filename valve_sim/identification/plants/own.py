"""A plant of a user's own equations, from a file, with recordings of it: what fit, diagnosis and report see.

Each recording is integrated from its start, or from the start of each window, driven by its recorded inputs. States
that start `free`, values with a tolerance, values that vary from recording to recording and errors of its columns are
nuisances. Derivatives of all of them come from the same run.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.files.changed_plants import changed_plant, save_plant
from valve_sim.files.plant_files import InputEntry, OutputEntry, PlantFile
from valve_sim.identification.plants.input_edges import (
    Edge,
    LevelError,
    edge_errors,
    edges_of,
    jumps_of,
    raised,
    with_edges,
    without_noise,
)
from valve_sim.identification.plants.own_model import OwnModel
from valve_sim.identification.plants.protocol import (
    Advice,
    Array,
    Channel,
    Direction,
    Estimate,
    Nuisance,
    Piece,
    Wording,
)
from valve_sim.identification.plants.recorded import Prediction, RecordedPlant
from valve_sim.model.core.own.grammar import walk
from valve_sim.model.core.own.simulation import Inputs, level_at, without_straight
from valve_sim.model.core.own.units import same
from valve_sim.model.errors import SimulationError
from valve_sim.recordings.columns import Column, Columns
from valve_sim.recordings.resting_noise import step_of

GROUPS: Final = 8
"""Parts of a recording without windows, of which some are held out."""
QUIET: Final = 100
"""Samples in a row over which a signal must stand to show its noise."""
CALMEST: Final = 0.1
"""Of windows, the share in which second differences are taken to show a sensor's noise alone."""
STANDS: Final = 4.0
"""Standard errors of the difference of the means of both halves."""
STANDS_WITHIN: Final = 0.1
"""Of an input's whole range: what varies by more in a window acts on the machine."""
CONSTANT: Final = 0.01
"""Of an input's largest reading: one that never varies by more stands all the time."""
SPAN: Final = 0.5
"""Of a measured signal's range: standard deviation of the start of a state that it shows."""
TIMES_STEPS: Final = 20
"""Steps of a run as declared, of which a run with other values may take so many."""
STEPS_BESIDE: Final = 12
"""Further steps for each sample and each time of an input: what turns faster than half their rate needs more."""
STEPS_LEAST: Final = 20_000

Moved = Mapping[tuple[str, int, int], Nuisance]
"""Nuisances by number, recording and part."""


@dataclass(frozen=True)
class Run:
    """A stretch of a recording that is integrated in one go.

    Attributes:
        recording, window: numbers from 0 on. start: s. inputs: that drive it.
        samples: (n,) s, of all outputs together. rows: by output the rows of its samples among them.
    """

    recording: int
    window: int
    start: float
    inputs: Inputs
    samples: Array
    rows: Mapping[str, NDArray[np.int64]]


class Number(NamedTuple):
    """A number of the equations in a run, or where a state starts, and which values of a fit it follows.

    Attributes:
        name: of it. declared: what it is where the values say nothing.
        value: the name of the value that takes its place. added: of the one that is added to it; empty: none.
    """

    name: str
    declared: float
    value: str = ""
    added: str = ""

    def at(self, values: Mapping[str, float]) -> float:
        """What it is."""
        return values.get(self.value, self.declared) + values.get(self.added, 0.0)

    def slope(self, slopes: Mapping[str, float]) -> float:
        """How it moves with the values."""
        return slopes.get(self.value, 0.0) + slopes.get(self.added, 0.0)


class OwnPlant(RecordedPlant[OwnModel]):
    """A machine of a user's own with its recordings.

    All columns of a recording share a clock; only when inputs jumped between two of its readings is not known. Which
    inputs the machine may be given is not known: it has no experiments.

    Raises:
        PlantFileError: its equations are more than the integrator has room for.
        MapError: a recording lacks an input or every output, or a unit does not fit.
    """

    def __init__(self, file: PlantFile, recordings: Sequence[Columns]) -> None:
        model = OwnModel(file, recordings)
        self.file, self.recordings = model.file, tuple(recordings)
        self._steps: dict[int, int | None] = {}
        self.findings: list[str] = []
        self._switched = () if self.file.states else _signs_of(self.file)
        self._of_channel: list[tuple[int, str]] = []
        super().__init__(model, [own for place in enumerate(recordings) for own in self._measured_by(*place)])
        self._runs = [run for place in enumerate(recordings) for run in self._runs_of(*place)]
        self._edges = [self._edges_of(*place) for place in enumerate(recordings)]
        self._levels: list[list[LevelError]] = [[] for _ in recordings]
        self._nuisances = (*self._of_machine(), *self._of_starts(), *self._of_columns(), *self._of_levels())
        moved = {(own.number, own.recording, own.part): own for own in self._nuisances}
        self._numbers = [self._numbers_of(run, moved) for run in self._runs]
        self._starts = [self._starts_of(run, moved) for run in self._runs]
        self._of_effect = {
            name: [Number(own, self.declared(own), own) for own in (f"{name}.{one}" for one in effect.parameters)]
            for name, effect in self.file.effects.items()
        }

    @property
    def nuisances(self) -> Sequence[Nuisance]:
        """Values with a tolerance, starts, and errors of the columns and of the levels at which inputs rest."""
        return self._nuisances

    @functools.cached_property
    def timing_errors(self) -> Sequence[Nuisance]:
        """When inputs that hold have jumped, where a recording shows it to an interval of its readings only."""
        longest = max((edge.interval for edges in self._edges for edge in edges), default=0.0)
        pairs = enumerate(self._edges)
        return [own for index, edges in pairs for own in edge_errors(edges, self.channels_in(index), longest)]

    @property
    def advice(self) -> Advice:
        """What to record next."""
        inputs = ", ".join(self.file.inputs) or "its start"
        return Advice(
            "one recording of one kind cannot tell an effect from what is refitted anyway",
            f"Record next: {inputs} at several levels, slowly and quickly, in both directions, and with rests",
            f"Record next: {inputs} at levels and rates that are not among these recordings",
        )

    @property
    def wording(self) -> Wording:
        """What its report calls what belongs to it."""
        return Wording(
            unknown_noise="If a data sheet has it, declare it (noise: of an output).", corrected="a plant file",
            uses=("valve-sim validate ANOTHER_RECORDING --plant {file}{options}",),
        )  # fmt: skip

    def save_corrected(self, path: Path, estimate: Estimate, effects: Sequence[str], provenance: str) -> bool:
        """Write its file, with those of the effects among the equations that are its own."""
        variances = np.maximum(np.diag(estimate.covariance), 0.0).tolist()
        errors = {name: math.sqrt(own) for name, own in zip(estimate.names, variances, strict=True)}
        effects = [name for name in effects if name in self.file.effects]
        save_plant(path, changed_plant(self.file, estimate.values, errors, effects), provenance)
        return True

    # -- simulation ----------------------------------------------------------------------------------------------------

    def prediction(self, values: Mapping[str, float], directions: Sequence[Direction] = ()) -> Prediction:
        """The simulated signal of each channel; all derivatives but those to delays are known."""
        effects = tuple(name for name, own in self._of_effect.items() if any(one.name in values for one in own))
        machine, delays = self.model.machine(effects), self.model.delays(values, effects)
        found = {
            (index, name): np.zeros((len(self.recordings[index][name].times), 1 + len(directions)))
            for index, name in self._of_channel
        }
        added = [self._of_effect[name] for name in effects]
        for place, (run, starts) in enumerate(zip(self._runs, self._starts, strict=True)):
            of_machine = [*self._numbers[place], *itertools.chain.from_iterable(added)]
            numbers, start = ({one.name: one.at(values) for one in table} for table in (of_machine, starts))
            own = [
                {one.name: by for one in (*of_machine, *starts) if (by := one.slope(direction.slopes))}
                for direction in directions
            ]
            inputs, moves = self._driven(run, values, directions, delays)
            acting = [k for k, one in enumerate(own) if one or moves[:, :, k].any()]
            samples, rows_of = late(run, delays)
            try:
                shown, changes, *_ = machine.run(
                    numbers,
                    start,
                    inputs,
                    samples,
                    [own[k] for k in acting],
                    run.start,
                    self._most(place),
                    moves=moves[:, :, acting] if moves.any() else None,
                )
            except SimulationError as error:
                raise SimulationError(f"{self.file.path}: {self.recordings[run.recording].source}: {error}") from error
            columns = [0, *(1 + k for k in acting)]
            for output, name in enumerate(self.file.outputs):
                if (run.recording, name) in found:
                    rows, into = rows_of[name], self._samples_of(run, name)
                    seen = np.column_stack([shown[rows, output], changes[rows, output]])
                    found[run.recording, name][into, columns] = seen
        known = [self.model.delaying.isdisjoint(direction.slopes) for direction in directions]
        whole = [self.recordings[index][name].filtered(found[index, name]) for index, name in self._of_channel]
        return Prediction(
            np.array(known, dtype=bool),
            [Piece(channel, 0, own[:, 0], own[:, 1:]) for channel, own in enumerate(whole)],
        )

    def _driven(
        self, run: Run, values: Mapping[str, float], directions: Sequence[Direction], delays: Mapping[str, float]
    ) -> tuple[Inputs, Array]:
        """What drives a run, and (k, 1 + i, d) derivatives of when inputs step, and of their levels.

        Where the data do not ask for the times of jumps, inputs are as they are declared.
        """
        later = [delays.get(name, 0.0) for name in self.file.inputs]
        edges = [edge for edge in self._edges_in(run) if edge.name in values]
        by = [values[edge.name] for edge in edges]
        edges = [edge._replace(time=edge.time + later[edge.columns[0]]) for edge in edges]
        levels = self._levels[run.recording]

        def shown(inputs: Inputs, slopes: Mapping[str, float]) -> Inputs:
            more = [slopes.get(level.name, 0.0) for level in levels]
            return with_edges(delayed(raised(inputs, levels, more), later), edges, by)

        inputs = shown(run.inputs, values)
        count = len(inputs.times) if edges or levels else 0
        moves = np.zeros((count, 1 + len(later), len(directions)))
        rows = [
            int(np.searchsorted(inputs.times, edge.time + own, side="right")) - 1
            for edge, own in zip(edges, by, strict=True)
        ]
        for k, direction in enumerate(directions):
            moves[rows, 0, k] = [direction.slopes.get(edge.name, 0.0) for edge in edges]
            if any(level.name in direction.slopes for level in levels):
                nothing = run.inputs._replace(levels=np.zeros_like(run.inputs.levels))
                moves[:, 1:, k] = shown(nothing, direction.slopes).levels
        return inputs, moves

    def _most(self, place: int) -> int | None:
        """How many steps a run may take; None: the declared machine itself cannot be simulated.

        A fit may come to values that make a machine turn thousands of times between two samples, such as ripples a
        hundredth as long as they are. One such run takes as long as a whole fit.
        """
        if place not in self._steps:
            run = self._runs[place]
            numbers, start = ({own.name: own.declared for own in of[place]} for of in (self._numbers, self._starts))
            beside = STEPS_LEAST + STEPS_BESIDE * (len(run.samples) + len(run.inputs.times))
            try:
                declared = self.model.machine(()).run(numbers, start, run.inputs, run.samples, start_time=run.start)
                self._steps[place] = TIMES_STEPS * declared.steps + beside
            except SimulationError:
                self._steps[place] = None
        return self._steps[place]

    def _samples_of(self, run: Run, name: str) -> slice:
        times = self.recordings[run.recording][name].times
        own = run.samples[run.rows[name]]
        if not len(own):
            return slice(0, 0)
        first = int(np.searchsorted(times, own[0]))
        return slice(first, first + len(own))

    def _numbers_of(self, run: Run, moved: Moved) -> list[Number]:
        """The numbers of the equations without effects."""

        def added(name: str) -> str:
            own = moved.get((name, run.recording, -1))
            return "" if own is None else own.name

        found = [Number(name, own.value, name, added(name)) for name, own in self.file.parameters.items()]
        for gain, offset in self.model.corrected.values():
            found += [Number(gain, 1.0, added=added(gain)), Number(offset, 0.0, added=added(offset))]
        return found

    def _starts_of(self, run: Run, moved: Moved) -> list[Number]:
        """Where the states start."""
        found = []
        for name, entry in self.file.states.items():
            own = moved.get((name, run.recording, run.window))
            found.append(Number(name, entry.start or 0.0) if own is None else Number(name, own.mean, own.name))
        return found

    # -- the recordings ------------------------------------------------------------------------------------------------

    def _runs_of(self, index: int, recording: Columns) -> list[Run]:
        inputs = without_straight(inputs_of(self.file, recording))
        present = [name for name in self.file.outputs if name in recording.columns]
        samples = np.unique(np.concatenate([recording[name].times for name in present]))
        begins = min(samples[0], inputs.times[0]) if len(inputs.times) else samples[0]
        window, longest = self.file.window, self.model.longest_delay()
        count = 1 if math.isinf(window) else max(1, round((samples[-1] - begins) / window))
        edges = [begins] if count == 1 else (begins + window * np.arange(count)).tolist()
        runs = []
        for number, start in enumerate(edges):
            stop = edges[number + 1] if number + 1 < len(edges) else math.inf
            own = samples[(samples >= start) & (samples < stop)]
            if len(own):
                first = start if number == 0 else float(own[0])
                rows = {
                    name: np.flatnonzero(np.isin(own, recording[name].times)) for name in self.file.outputs
                    if name in recording.columns
                }  # fmt: skip
                kept = _between(inputs, first - longest, float(own[-1]))
                runs.append(Run(index, number, float(first), kept, own, rows))
        return runs

    def _edges_of(self, index: int, recording: Columns) -> list[Edge]:
        inputs = [(recording[name], own) for name, own in self.file.inputs.items()]
        if not inputs or not self.file.states:
            return []
        columns = [(column.times, column.si(own.unit)) for column, own in inputs]
        held = [_holds(column, own) for column, own in inputs]
        steps = [float(np.median(np.diff(self._channels[place].times))) for place in self.channels_in(index)]
        return edges_of(index, columns, held, min(steps))

    def _edges_in(self, run: Run) -> list[Edge]:
        """The jumps of inputs on the way of a run, not at its ends."""
        times = run.inputs.times
        if not len(times):
            return []
        first, last = max(run.start, float(times[0])), float(times[-1])
        return [own for own in self._edges[run.recording] if first < own.time - own.interval and own.time <= last]

    def _measured_by(self, index: int, recording: Columns) -> list[Channel]:
        channels = []
        inputs = [(recording[name], own) for name, own in self.file.inputs.items()]
        for name, entry in self.file.outputs.items():
            if name not in recording.columns:
                continue
            column = recording[name]
            data, times = column.si(entry.unit)[column.compared], column.times[column.compared]
            left_out = ~column.used[column.compared]
            turns = self._turns(recording, times)
            if (turns & ~left_out).any():
                self.findings.append(
                    f"{recording.source}: {name}: {int((turns & ~left_out).sum())} samples take no part, where "
                    f"{' or '.join(self._switched)} passes through 0: dry friction is anything up to its level there"
                )
                left_out |= turns
            noise = entry.noise or 0.0
            quiet = np.zeros(len(data), dtype=bool) if noise else quiet_samples(times, data, [own for own, _ in inputs])
            self._of_channel.append((index, name))
            channels.append(
                Channel(
                    f"{recording.source}: {name}",
                    name,
                    times,
                    data,
                    quiet,
                    self._groups(times),
                    entry.unit.si,
                    recording=index,
                    source=recording.source,
                    left_out=left_out if left_out.any() else None,
                    noise=noise,
                )
            )
        return channels

    def _turns(self, recording: Columns, times: Array) -> NDArray[np.bool_]:
        """(n,) where, of a plant without states, a measured velocity passes through 0.

        Dry friction at rest is a set: any force up to its level. The sign of a measured velocity knows no rest, and
        behind a low-pass it turns up to half a period of the corner before or after the machine does.
        """
        found = np.zeros(len(times), dtype=bool)
        for name in self._switched:
            column = recording[name]
            if column.turns:
                continue
            signs = np.sign(column.readings)
            crossed = column.times[:-1][signs[1:] != signs[:-1]]
            beside = max(0.5 / column.smoothing, float(np.median(np.diff(column.times))))
            if len(crossed):
                after = np.minimum(np.searchsorted(crossed, times), len(crossed) - 1)
                nearest = np.minimum(np.abs(times - crossed[after]), np.abs(times - crossed[np.maximum(after - 1, 0)]))
                found |= nearest <= beside
        return found

    def _groups(self, times: Array) -> NDArray[np.int64]:
        """(n,) the window, or the eighth of the recording, that each sample is in."""
        span = times[-1] - times[0]
        window = self.file.window
        if math.isinf(window):
            share = (times - times[0]) / (span or 1.0)
            return np.asarray(np.minimum((GROUPS * share).astype(np.int64), GROUPS - 1))
        count = max(1, round(span / window))
        return np.asarray(np.minimum(((times - times[0]) / window).astype(np.int64), count - 1))

    # -- nuisances and effects -----------------------------------------------------------------------------------------

    def _error(self, name: str, sigma: float, unit: str, recording: int, number: str) -> Nuisance:
        """What is added to a number of the equations in a recording."""
        channels = self.channels_in(recording)
        return Nuisance(name, sigma, unit, channels, step=1e-2 * sigma, number=number, recording=recording)

    def _of_machine(self) -> Iterator[Nuisance]:
        for name, own in self.file.parameters.items():
            if own.tolerance:
                step = min(own.tolerance, 1e-3 * abs(own.value) or own.tolerance)
                yield Nuisance(
                    name, own.tolerance, own.unit.si, step=1e-2 * step, mean=own.value, lower=own.lower,
                    upper=own.upper, is_of_machine=True, number=name,
                )  # fmt: skip
            if own.varies:
                for index in range(len(self.recordings)):
                    yield self._error(f"{name}[{index}]", own.varies, own.unit.si, index, name)

    def _of_starts(self) -> Iterator[Nuisance]:
        is_windowed = not math.isinf(self.file.window)
        for run in self._runs:
            stretch = (float(run.samples[0]) - 1e-9, float(run.samples[-1]) + 1e-9)
            during = stretch if is_windowed else (-math.inf, math.inf)
            for name, entry in self.file.states.items():
                if entry.start is None or is_windowed:
                    mean, sigma = self._first(run, name)
                    yield Nuisance(
                        f"start[{run.recording},{run.window}].{name}", sigma, entry.unit.si,
                        self.channels_in(run.recording), during, step=1e-3 * sigma, mean=mean, number=name,
                        recording=run.recording, part=run.window,
                    )  # fmt: skip

    def _first(self, run: Run, state: str) -> tuple[float, float]:
        """Where a state probably starts, and how well that is known: by an output that shows it, or what it changes."""
        recording = self.recordings[run.recording]
        for name, output in self.file.outputs.items():
            if name not in recording.columns or output.value.op != "name":
                continue
            column, shown = recording[name], str(output.value.value)
            values = column.si(output.unit)
            begin = int(np.searchsorted(column.times, run.samples[0]))
            few = slice(begin, begin + 5)
            if shown == state:
                return float(np.median(values[few])), SPAN * float(np.ptp(values)) or 1.0
            rate = self.file.derivatives.get(shown)
            if rate is not None and rate.op == "name" and rate.value == state:
                slopes = np.gradient(values, column.times)
                line = (
                    np.polyfit(column.times[few] - column.times[begin], values[few], 1)[0]
                    if begin + 5 <= len(values)
                    else 0.0
                )
                return float(line), 2.0 * float(np.percentile(np.abs(slopes), 99)) or 1.0
        entry = self.file.states[state]
        if entry.start is None:
            # What no sensor shows is probably about as large as what one shows of its kind: the level of another tank.
            for name, output in self.file.outputs.items():
                if name in recording.columns and same(output.unit.dimension, entry.unit.dimension):
                    values = recording[name].si(output.unit)
                    middle = float(np.median(values))
                    return middle, max(abs(middle), float(np.ptp(values))) or 1.0
        return entry.start or 0.0, max(abs(entry.start or 0.0), entry.unit.factor)

    def _of_columns(self) -> Iterator[Nuisance]:
        known: dict[str, InputEntry | OutputEntry] = {**self.file.inputs, **self.file.outputs}
        for index, recording in enumerate(self.recordings):
            for name, column in recording.columns.items():
                own = self.channels_in(index)
                if name in self.file.outputs:
                    own = tuple(place for place in own if self._of_channel[place][1] == name)
                gain, offset = self.model.corrected.get(name, ("", ""))
                if column.gain:
                    yield self._error(f"gain[{index}].{name}", column.gain, "–", index, gain)._replace(channels=own)
                if column.offset:
                    unit = known[name].unit
                    size = (unit.factor if column.unit is None else column.unit.factor) * column.offset
                    yield self._error(f"offset[{index}].{name}", size, unit.si, index, offset)._replace(channels=own)

    def _of_levels(self) -> Iterator[Nuisance]:
        """Of inputs that are known to have jumped where their levels end."""
        for index, recording in enumerate(self.recordings):
            jumps = [place for edge in self._edges[index] for place in edge.columns]
            for place, (name, entry) in enumerate(self.file.inputs.items()):
                column = recording[name]
                readings = column.si(entry.unit)
                if _holds(column, entry) or not self.file.states or jumps.count(place) != len(jumps_of(readings)):
                    continue
                for number, level in enumerate(without_noise(readings)[1]):
                    spans = np.array([[column.times[first], column.times[last - 1]] for first, last in level.rests])
                    own = LevelError(f"input_level[{index},{number}].{name}", place, spans)
                    self._levels[index].append(own)
                    error = self._error(own.name, level.error, entry.unit.si, index, f"{name} level")
                    during = float(spans[0, 0]) - 1e-9, math.inf
                    yield error._replace(during=during, part=number)


def inputs_of(file: PlantFile, recording: Columns | None) -> Inputs:
    """All inputs of a recording, at the times of each of them."""
    entries = file.inputs
    if not entries or recording is None:
        return Inputs(np.empty(0), np.empty((0, 0)), np.empty(0, dtype=bool))
    columns = [recording[name] for name in entries]
    pairs = list(zip(columns, entries.values(), strict=True))
    held = np.array([_holds(column, own) for column, own in pairs])
    times = np.unique(np.concatenate([column.times for column in columns]))
    levels = np.empty((len(times), len(columns)))
    for place, (column, own) in enumerate(pairs):
        readings = column.si(own.unit)
        # What is held was commanded, and has no noise.
        seen = readings if held[place] else without_noise(readings)[0]
        levels[:, place] = level_at(times, column.times, seen, is_held=held[place])
    return Inputs(times, levels, held)


def _holds(column: Column, entry: InputEntry) -> bool:
    """Whether an input holds between its samples, by the recording's map or else by the plant's file."""
    return entry.held if column.held is None else column.held


def delayed(inputs: Inputs, delays: Sequence[float]) -> Inputs:
    """Inputs of which each acts some seconds later; before its first time an input is as it begins."""
    if not any(delays) or not len(inputs.times):
        return inputs
    times = np.unique(np.concatenate([inputs.times + own for own in sorted(set(delays))]))
    # Whether a time is that of a step must not hang on how its sum with a delay was rounded.
    rounding = 1e-12 * (float(np.max(np.abs(times))) + 1.0)
    levels = np.empty((len(times), len(delays)))
    for place, own in enumerate(delays):
        is_held = inputs.held[place]
        at = times - own + rounding if is_held else times - own
        levels[:, place] = level_at(at, inputs.times, inputs.levels[:, place], is_held=is_held)
    return Inputs(times, levels, inputs.held)


def late(run: Run, delays: Mapping[str, float]) -> tuple[Array, Mapping[str, NDArray[np.int64]]]:
    """When a run is looked at, s, so that outputs are shown late, and by output the rows of its samples among these.

    Before the run's start an output is as it begins.
    """
    if not any(delays.get(name) for name in run.rows):
        return run.samples, run.rows
    asked = {name: np.maximum(run.samples[own] - delays.get(name, 0.0), run.start) for name, own in run.rows.items()}
    samples = np.unique(np.concatenate(list(asked.values())))
    return samples, {name: np.searchsorted(samples, own) for name, own in asked.items()}


def _signs_of(file: PlantFile) -> tuple[str, ...]:
    """Inputs whose sign an equation or an effect switches on: sign(v), or where(v > 0, a, b)."""
    parts = [own.value for own in file.outputs.values()]
    parts += [added for effect in file.effects.values() for added in effect.add.values()]
    found: dict[str, None] = {}
    for one in (node for part in parts for node in walk(part)):
        if one.op == "sign" or (one.op == ">" and any(own.op == "number" and own.value == 0.0 for own in one.args)):
            found |= {str(own.value): None for own in one.args if own.op == "name" and own.value in file.inputs}
    return tuple(found)


def _between(inputs: Inputs, first: float, last: float) -> Inputs:
    """The inputs from one time to another, with what is needed on either side."""
    if not len(inputs.times):
        return inputs
    low = max(0, int(np.searchsorted(inputs.times, first, side="right")) - 1)
    high = min(len(inputs.times), int(np.searchsorted(inputs.times, last, side="left")) + 1)
    return Inputs(inputs.times[low:high], inputs.levels[low:high], inputs.held)


def _noise_between_neighbours(data: Array, first: NDArray[np.int64]) -> float:
    """The noise that second differences show in the calmest windows, of `QUIET` samples from `first` each.

    While a machine moves they show its motion, too, most of all behind a low-pass, where few samples are compared: by
    the whole recording, motion of that size would pass for noise at rest.
    """
    bends = np.diff(data, 2)
    sizes = [float(np.median(np.abs(own - np.median(own)))) for own in (bends[i : i + QUIET - 2] for i in first)]
    return 1.4826 * float(np.quantile(sizes, CALMEST)) / math.sqrt(6.0)


def quiet_samples(times: Array, data: Array, inputs: Sequence[Column]) -> NDArray[np.bool_]:
    """(n,) where output and inputs stand for `QUIET` samples, so that what is seen is the sensor's noise."""
    quiet = np.zeros(len(data), dtype=bool)
    if len(data) < 2 * QUIET:
        return quiet
    half = QUIET // 2
    total = np.concatenate([[0.0], np.cumsum(data - data.mean())])
    first = np.arange(0, len(data) - QUIET + 1, half)
    noise = _noise_between_neighbours(data, first)
    early = (total[first + half] - total[first]) / half
    late = (total[first + QUIET] - total[first + half]) / half
    spread = np.array([np.ptp(data[i : i + QUIET]) for i in first])
    step = step_of(data)
    still = np.abs(late - early) <= STANDS * noise * math.sqrt(2.0 / half) + 0.5 * step
    still &= spread <= max(12.0 * noise, 2.0 * step) + 1e-15
    for column in inputs:
        own = np.interp(times, column.times, column.readings)
        size, whole = _noise_between_neighbours(own, first), float(np.ptp(own))
        if whole > CONSTANT * float(np.max(np.abs(own))):
            # Neighbours differ by all of its range where it is switched at each sample, which is no noise.
            allowed = max(min(12.0 * size, STANDS_WITHIN * whole), 1e-3 * whole)
            still &= np.array([np.ptp(own[i : i + QUIET]) <= allowed for i in first])
    for i in first[still]:
        quiet[i : i + QUIET] = True
    return quiet
