"""Functions of the integrator as functions of Python, without the tenth of a microsecond that others take.

A function of Python's C interface is emitted beside the integrator: it takes the time from its arguments, steps the
valve that it is bound to, and returns an integer. Only documented, stable names of that interface are used.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any, Final

import llvmlite.binding as llvm

from valve_sim.model.core.code import POINTER

ENTRIES: Final = {"advance": 1, "command": 2, "halt": 1}
"""Functions of a block and of so many doubles, which return an integer."""
ARRAYS, DOUBLES = 5, 3
"""`driver.whole` takes so many arrays, each followed by how many doubles it holds, and so many doubles."""
_USED: Final = (
    "PyFloat_AsDouble", "PyLong_AsVoidPtr", "PyLong_FromLongLong", "PyErr_Occurred", "PyObject_GetBuffer",
    "PyBuffer_Release", "PyEval_SaveThread", "PyEval_RestoreThread",
)  # fmt: skip
_BUFFER: Final = 16
"""Words of a Py_buffer, or more: its address, its owner and its length in bytes are the first three."""
_FASTCALL: Final = 0x0080
_OBJECTS: Final = "ptr" if POINTER == "ptr" else "i8**"
_OBJECT: Final = "ptr" if POINTER == "ptr" else "i8*"
_Method = Callable[..., int]


class _MethodDefinition(ctypes.Structure):
    """What Python asks of a function of C: its name, address, way of being called and documentation."""

    _fields_ = (
        ("name", ctypes.c_char_p), ("function", ctypes.c_void_p), ("flags", ctypes.c_int), ("doc", ctypes.c_char_p),
    )  # fmt: skip


def text() -> str:
    """The functions, as text of LLVM, to be compiled with those that they call."""
    parts = [
        f"declare double @PyFloat_AsDouble({_OBJECT})", f"declare {POINTER} @PyLong_AsVoidPtr({_OBJECT})",
        f"declare {_OBJECT} @PyLong_FromLongLong(i64)", f"declare {_OBJECT} @PyErr_Occurred()",
    ]  # fmt: skip
    for name, count in ENTRIES.items():
        lines = [f"%block = call {POINTER} @PyLong_AsVoidPtr({_OBJECT} %self)"]
        for i in range(count):
            lines += [
                f"%place{i} = getelementptr {_OBJECT}, {_OBJECTS} %given, i64 {i}",
                f"%given{i} = load {_OBJECT}, {_OBJECTS} %place{i}",
                f"%double{i} = call double @PyFloat_AsDouble({_OBJECT} %given{i})",
            ]
        doubles = ", ".join(f"double %double{i}" for i in range(count))
        lines += [
            f"%wrong = call {_OBJECT} @PyErr_Occurred()", f"%fails = icmp ne {_OBJECT} %wrong, null",
            "br i1 %fails, label %failed, label %sound", "failed:", f"ret {_OBJECT} null", "sound:",
            f"%outcome = call i64 @{name}({POINTER} %block, {doubles})",
            f"%answer = call {_OBJECT} @PyLong_FromLongLong(i64 %outcome)", f"ret {_OBJECT} %answer",
        ]  # fmt: skip
        body = "\n  ".join(lines)
        parts.append(f"define {_OBJECT} @py_{name}({_OBJECT} %self, {_OBJECTS} %given, i64 %count) {{\n  {body}\n}}\n")
    return "\n".join([*parts, _text_of_whole()])


def _text_of_whole() -> str:
    """The function that runs a valve from beginning to end, on arrays, and lets other threads run meanwhile."""
    buffer = f"[{_BUFFER} x i64]"
    opened = "ptr" if POINTER == "ptr" else f"{buffer}*"
    lines, given = [f"%b{i} = alloca {buffer}, align 8" for i in range(ARRAYS)], []
    lines += ["br label %open0"]
    for i in range(ARRAYS + DOUBLES):
        lines += [f"open{i}:"] if i < ARRAYS else []
        lines += [
            f"%p{i} = getelementptr {_OBJECT}, {_OBJECTS} %given, i64 {i}", f"%o{i} = load {_OBJECT}, {_OBJECTS} %p{i}",
        ]  # fmt: skip
        if i < ARRAYS:
            lines += [
                f"%e{i} = call i32 @PyObject_GetBuffer({_OBJECT} %o{i}, {opened} %b{i}, i32 0)",
                f"%f{i} = icmp ne i32 %e{i}, 0",
                f"br i1 %f{i}, label %failed{i}, label %{'open' + str(i + 1) if i + 1 < ARRAYS else 'opened'}",
            ]
            lines += ["opened:"] if i + 1 == ARRAYS else []
        else:
            lines.append(f"%d{i} = call double @PyFloat_AsDouble({_OBJECT} %o{i})")
    for i in range(ARRAYS):
        lines += [
            f"%n{i}p = getelementptr {buffer}, {opened} %b{i}, i64 0, i64 2", f"%n{i}b = load i64, {_words()} %n{i}p",
            f"%n{i} = sdiv i64 %n{i}b, 8", f"%a{i}p = getelementptr {buffer}, {opened} %b{i}, i64 0, i64 0",
            f"%a{i}i = load i64, {_words()} %a{i}p", f"%a{i} = inttoptr i64 %a{i}i to {POINTER}",
        ]  # fmt: skip
        given.append(f"{POINTER} %a{i}, i64 %n{i}")
    given += [f"double %d{i}" for i in range(ARRAYS, ARRAYS + DOUBLES)]
    lines += [
        f"%thread = call {_OBJECT} @PyEval_SaveThread()", f"%outcome = call i64 @whole({', '.join(given)})",
        f"call void @PyEval_RestoreThread({_OBJECT} %thread)",
        *(f"call void @PyBuffer_Release({opened} %b{i})" for i in range(ARRAYS)),
        f"%answer = call {_OBJECT} @PyLong_FromLongLong(i64 %outcome)", f"ret {_OBJECT} %answer",
    ]  # fmt: skip
    for i in range(ARRAYS):
        lines += [f"failed{i}:", *(f"call void @PyBuffer_Release({opened} %b{j})" for j in range(i))]
        lines.append(f"ret {_OBJECT} null")
    declared = [
        f"declare i32 @PyObject_GetBuffer({_OBJECT}, {opened}, i32)", f"declare void @PyBuffer_Release({opened})",
        f"declare {_OBJECT} @PyEval_SaveThread()", f"declare void @PyEval_RestoreThread({_OBJECT})",
    ]  # fmt: skip
    body = "\n  ".join(lines)
    define = f"define {_OBJECT} @py_whole({_OBJECT} %self, {_OBJECTS} %given, i64 %count)"
    return "\n".join([*declared, f"{define} {{\n  {body}\n}}\n"])


def _words() -> str:
    return "ptr" if POINTER == "ptr" else "i64*"


def resolve() -> None:
    """Tell LLVM where the functions of Python's C interface are, before code that calls them is loaded."""
    for name in _USED:
        llvm.add_symbol(name, _address(name))


def _address(name: str) -> int:
    """The address of a function of Python's C interface."""
    return ctypes.cast(getattr(ctypes.pythonapi, name), ctypes.c_void_p).value or 0


class Method:
    """One of the functions, to be bound to blocks.

    Args:
        name: of `ENTRIES`. address: where it was loaded.
    """

    def __init__(self, name: str, address: int) -> None:
        self._definition = _MethodDefinition(name.encode(), address, _FASTCALL, None)
        signature = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.py_object, ctypes.c_void_p)
        self._make: Any = signature(_address("PyCFunction_NewEx"))

    def bound(self, address: int) -> _Method:
        """The function of the valve whose block is at an address; it takes doubles and returns an Outcome."""
        return self._make(ctypes.addressof(self._definition), address, None)  # type: ignore[no-any-return]
