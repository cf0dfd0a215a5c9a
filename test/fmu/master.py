"""A master as small as can be: it loads a unit by fmpy and steps it."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import TracebackType
from typing import Any

import pytest

fmpy = pytest.importorskip("fmpy", reason="fmpy, which loads units, is not installed: pip install '.[fmi]'")
_GETTERS = {"Real": "getReal", "Integer": "getInteger", "Boolean": "getBoolean"}


class Master:
    """One loaded unit, which begins at a time in s; what its log says is kept."""

    def __init__(self, path: Path, start: float = 0.0) -> None:
        self.description = fmpy.read_model_description(str(path))
        self._folder = fmpy.extract(str(path))
        self._variables = {variable.name: variable for variable in self.description.modelVariables}
        self.log: list[str] = []
        self.unit = fmpy.instantiate_fmu(
            self._folder, self.description, "CoSimulation", debug_logging=True, logger=self._note
        )
        self.unit.setupExperiment(startTime=start)
        self.unit.enterInitializationMode()
        self.unit.exitInitializationMode()

    def set(self, name: str, value: float) -> None:
        self.unit.setReal([self._variables[name].valueReference], [value])

    def get(self, name: str) -> Any:
        variable = self._variables[name]
        return getattr(self.unit, _GETTERS[variable.type])([variable.valueReference])[0]

    def step(self, time: float, size: float) -> None:
        self.unit.doStep(currentCommunicationPoint=time, communicationStepSize=size)

    def __enter__(self) -> Master:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.unit.terminate()
        self.unit.freeInstance()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _note(self, _: Any, instance: bytes, status: int, category: bytes, message: bytes) -> None:
        self.log.append(message.decode())
