"""Functions of the small language of `lowering` as functions of Python: what computes number by number, fast."""

from __future__ import annotations

import ctypes
import inspect
from collections.abc import Callable, Mapping
from typing import Any, Final

from valve_sim.model.core.code import Code
from valve_sim.model.core.lowering import lowered
from valve_sim.model.core.machine import Library, library
from valve_sim.model.core.series import Series
from valve_sim.model.core.tracer import Node

_TYPES: Final[Mapping[str, Any]] = {
    "float": ctypes.c_double, "int": ctypes.c_int64, "Block": ctypes.c_void_p, "None": None,
}  # fmt: skip


def native(*functions: Callable[..., Any], more: str = "") -> Callable[..., Any]:
    """The first of some functions, compiled with the others that it calls.

    Blocks are contiguous arrays of doubles, handed over by address (`array.ctypes.data`).

    Args:
        functions: in the language of `lowering`. more: text of LLVM to go with them.
    """
    entry = functions[0]
    text = lowered(functions, [entry.__name__]) + more
    loaded = library(text, lambda: text)
    kinds = [_TYPES[str(parameter.annotation)] for parameter in inspect.signature(entry).parameters.values()]
    made = ctypes.CFUNCTYPE(_TYPES[str(inspect.signature(entry).return_annotation)], *kinds)
    found: Any = made(loaded.address(entry.__name__))
    found.library = loaded  # the code lives as long as what calls it
    return found  # type: ignore[no-any-return]


def kernel(nodes: Mapping[int, Node], slots: Mapping[str, int]) -> tuple[int, Library]:
    """A function of a block, to be invoked by its address, that puts the values of expressions into slots of it.

    Args:
        nodes: expressions by the slots where they are wanted. slots: of the numbers that they are made of, by name.

    Returns:
        its address, and the code that it belongs to, to be kept.
    """
    code = Code()
    series = Series(code, lambda name: slots[name], {}, {}, {})
    for slot, node in nodes.items():
        code.store(slot, series.value(node))
    text = "\n".join([*sorted(code.declared), code.function("kernel")])
    loaded = library(text, lambda: text)
    return loaded.address("kernel"), loaded
