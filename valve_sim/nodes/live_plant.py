"""A machine of a plant file that is simulated in step with a clock, and the table of its parameters, without ROS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Final

from valve_sim.files.plant_entries import PlantFileError
from valve_sim.files.plant_files import load_plant
from valve_sim.model import Parameter, ParameterError, SimulationError
from valve_sim.model.core.hybrid.system import EquationsError
from valve_sim.model.core.own.simulation import Machine
from valve_sim.model.core.own.units import Unit, dimension_words, parse_unit, same
from valve_sim.model.machine_stepper import Channels, MachineReading, MachineStepper
from valve_sim.nodes.live_machine import LiveMachine
from valve_sim.nodes.parameters import OF_ANY_NODE, PLANT_KEY, VALVE_KEYS, NodeParameter, Value, check_given
from valve_sim.nodes.valve_parameters import ValveSettings

INPUT: Final = "voltage"
"""The input that ~/coil_voltage commands."""
SHOWN: Final = {"position": "m", "main_position": "m", "current": "A"}
"""Outputs that topics show, and their units."""
PHASE: Final = "phase"
"""The output that says which region's modes are on ~/phase."""


class NodePlant:
    """A machine of a plant file that topics can command and show, and the table of its node's parameters.

    The table has the node's own, and `parameters.<name>`, SI.

    Args:
        path: of the file.

    Attributes:
        file: as it was read. channels: what topics show of it.

    Raises:
        PlantFileError: it cannot be used, or not by topics; one line.
    """

    def __init__(self, path: str) -> None:
        self.file = file = load_plant(path)
        self._check_inputs()
        self.channels = self._read_channels()
        try:
            self._machine = Machine(file.equations(), ())
            self.stepper({name: own.value for name, own in file.parameters.items()})
        except (EquationsError, SimulationError) as error:
            raise PlantFileError(f"{path}: {error}") from error

    def stepper(self, numbers: Mapping[str, float]) -> MachineStepper:
        """The machine at its start, with values of its parameters, SI; states that start free start at 0.

        Raises:
            SimulationError: it cannot start with these.
        """
        start = {name: own.start or 0.0 for name, own in self.file.states.items()}
        return MachineStepper(self._machine, self.channels, numbers, start, self.file.inputs[INPUT].delay)

    @property
    def modes(self) -> tuple[str, ...]:
        """The modes that are on ~/phase, in the order of their numbers; none without modes."""
        return tuple(self.file.automaton.regions.get(self.channels.region, ()))

    def table(self) -> dict[str, NodeParameter]:
        """Every parameter, by name."""
        found = ValveSettings.rows()
        for name, own in self.file.parameters.items():
            key, meaning = f"{PLANT_KEY}{name}", own.title or "as the plant's file declares it"
            rule = Parameter(name, own.unit.si, meaning, own.lower, own.upper, prior_scale=own.value)
            found[key] = NodeParameter(key, own.value, meaning, own.unit.si, rule, read_only=False)
        return found

    def passes_over(self, name: str, given: Mapping[str, object]) -> bool:
        """See `NodeSettings`."""
        return name in OF_ANY_NODE or name.startswith(VALVE_KEYS)

    def values(self, given: Mapping[str, object], sources: Mapping[str, str]) -> dict[str, Value]:
        """The values at the start; arguments and errors: see `check_given`."""
        for name in given:
            if name.startswith(VALVE_KEYS):
                where, path = f"{sources.get(name, 'command line')}: {name}", self.file.path
                raise ParameterError(
                    f"{where}: is of the valve, which plant:={path} replaces; its own: {PLANT_KEY}<name>"
                )
        values = check_given(given, self.table(), sources, ValveSettings.program)
        self.numbers(values)
        return values

    def of(self, values: Mapping[str, Value]) -> ValveSettings:
        """The node's own among the values."""
        return ValveSettings.of(values)

    def numbers(self, values: Mapping[str, Value]) -> dict[str, float]:
        """The machine's parameters among the values, SI.

        Raises:
            ParameterError: it cannot start with these.
        """
        numbers = {name: float(values[f"{PLANT_KEY}{name}"]) for name in self.file.parameters}
        try:
            self.stepper(numbers)
        except SimulationError as error:
            raise ParameterError(f"{self.file.path}: with these parameters {error}") from error
        return numbers

    def _fail(self, key: str, words: str) -> PlantFileError:
        return PlantFileError(f"{self.file.path}: {key}: {words}")

    def _check_inputs(self) -> None:
        inputs = self.file.inputs
        if INPUT not in inputs:
            raise self._fail(
                f"inputs.{INPUT}", "is missing; a node's machine is driven by the voltage at its coil, in V"
            )
        for name in inputs:
            if name != INPUT:
                raise self._fail(f"inputs.{name}", f"no topic commands it; make it a parameter, or call it {INPUT}")
        self._check_unit(f"inputs.{INPUT}", inputs[INPUT].unit, "V")

    def _check_unit(self, key: str, unit: Unit, expected: str) -> None:
        if not same(unit.dimension, parse_unit(expected).dimension):
            found = dimension_words(unit.dimension)
            raise self._fail(f"{key}.unit", f"is {found}, expected {expected} or a part of it, as its topic has it")

    def _read_channels(self) -> Channels:
        outputs, regions = self.file.outputs, self.file.automaton.regions
        for name, unit in SHOWN.items():
            if name in outputs:
                self._check_unit(f"outputs.{name}", outputs[name].unit, unit)
        delays = {name: outputs[name].delay for name in SHOWN if name in outputs}
        phase, region = outputs.get(PHASE), next(iter(regions), "")
        if phase is not None:
            if phase.value.op != "name" or phase.value.value not in regions:
                known = " or ".join(regions) or "mode, of a machine with modes"
                raise self._fail(f"outputs.{PHASE}.value", f"is no region of modes; expected {known}, or take it out")
            region = str(phase.value.value)
        if not delays and not region:
            raise self._fail("outputs", f"topics show none of these; call one {', '.join(SHOWN)}, or declare modes")
        return Channels(delays, region, 0.0 if phase is None else phase.delay)


class LivePlant(LiveMachine[MachineStepper]):
    """A live machine that is of a plant file."""

    rests = "the machine starts again, at 0 V"

    def __init__(self, plant: NodePlant, numbers: Mapping[str, float], **options: float) -> None:
        super().__init__(**options)
        self._plant, self._numbers = plant, numbers
        self.shows = {*plant.channels.delays, *(("phase",) if plant.modes else ())}
        self._modes: Mapping[str, str] = {}
        self._events, self._last_event = 0, ""

    def go_on_as(self, clock: int, machine: Mapping[str, float]) -> None:
        """Continue with other parameters, SI; states go on."""
        self._numbers = machine
        self._requests.post(clock, "numbers", partial(self._continue_with, machine))

    def self_test(self) -> tuple[bool, str]:
        """It has none."""
        return False, f"a self-test is of the valve; the machine of {self._plant.file.path} has none"

    def facts(self) -> Mapping[str, str]:
        """The mode that is the phase, those of other regions, and events."""
        modes, region = self._plant.modes, self._plant.channels.region
        found = {"phase": modes[self.phase]} if modes else {}
        found |= {f"mode of {name}": mode for name, mode in self._modes.items() if name != region}
        return found | {"events": str(self._events), "last event": self._last_event or "none"}

    def _begun(self) -> MachineStepper:
        return self._plant.stepper(self._numbers)

    def _entered(self, reading: MachineReading) -> Sequence[int]:
        self._modes = reading.modes
        if reading.events:
            self._events += len(reading.events)
            self._last_event = reading.events[-1].name
        return reading.entered

    def _continue_with(self, numbers: Mapping[str, float], clock: int) -> None:
        self._running.set_numbers(self._timeline.model_time(clock), numbers)
