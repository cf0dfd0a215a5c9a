"""A master as small as can be: it loads a unit by fmpy and steps it, whichever version of FMI it is of."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import TracebackType
from typing import Any

import pytest

fmpy = pytest.importorskip("fmpy", reason="fmpy, which loads units, is not installed: pip install '.[fmi]'")
LIBRARIES = {"2.0": "pythonfmu", "3.0": "pythonfmu3"}
_GETTERS = {"Real": "getReal", "Integer": "getInteger", "Boolean": "getBoolean"} | {
    "Float64": "getFloat64",
    "Int32": "getInt32",
}


class Master:
    """One loaded unit, which begins at a time in s; what its log says is kept."""

    def __init__(self, path: Path, start: float = 0.0, **values: float) -> None:
        self.description = fmpy.read_model_description(str(path))
        self._folder = fmpy.extract(str(path))
        self._variables = {found.name: found for found in self.description.modelVariables}
        self.is_third = self.description.fmiVersion.startswith("3")
        self.log: list[str] = []
        self.unit = fmpy.instantiate_fmu(
            self._folder, self.description, "CoSimulation", debug_logging=True,
            logger=self._note_third if self.is_third else self._note_second,
        )  # fmt: skip
        if self.is_third:
            self.unit.enterInitializationMode(startTime=start)
        else:
            self.unit.setupExperiment(startTime=start)
            self.unit.enterInitializationMode()
        for name, value in values.items():
            self.set(name, value)
        self.unit.exitInitializationMode()

    def set(self, name: str, value: float) -> None:
        place = [self._variables[name].valueReference]
        (self.unit.setFloat64 if self.is_third else self.unit.setReal)(place, [value])

    def get(self, name: str) -> Any:
        variable = self._variables[name]
        if self.is_third and variable.type == "Boolean":
            return self.unit.getBoolean([variable.valueReference])[0]
        return getattr(self.unit, _GETTERS[variable.type])([variable.valueReference])[0]

    def step(self, time: float, size: float) -> None:
        self.unit.doStep(currentCommunicationPoint=time, communicationStepSize=size)

    def keep(self) -> Any:
        return self.unit.getFMUState() if self.is_third else self.unit.getFMUstate()

    def restore(self, state: Any) -> None:
        (self.unit.setFMUState if self.is_third else self.unit.setFMUstate)(state)

    def drop(self, state: Any) -> None:
        (self.unit.freeFMUState if self.is_third else self.unit.freeFMUstate)(state)

    def __enter__(self) -> Master:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.unit.terminate()
        self.unit.freeInstance()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _note_second(self, _: Any, instance: bytes, status: int, category: bytes, message: bytes) -> None:
        self.log.append(message.decode())

    def _note_third(self, _: Any, status: int, category: bytes, message: bytes) -> None:
        self.log.append(message.decode())
