"""Text of LLVM made into code of this processor, kept on disk by its content, and loaded from there.

The key of what is kept is the text itself, or what it is derived from, together with the sources of this package, the
versions of LLVM and Python, and the processor. The folder is the user's own and not writable by others: who can write
there could run code as this user. If no folder can be used, the code is made again and kept in memory.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import stat
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, ParamSpec, TypeVar

import llvmlite
import llvmlite.binding as llvm

_Given = ParamSpec("_Given")
_Made = TypeVar("_Made")
_MAKING: Final = threading.RLock()
_ENTRIES: Final = 4096
"""Files that are kept; the oldest go first."""


def made_once(make: Callable[_Given, _Made]) -> Callable[_Given, _Made]:
    """A function whose results are kept for good, and are made by one thread at a time.

    `functools.cache` lets two threads make a result at once and keeps the later one. Where that is loaded code, the
    earlier one is freed while its thread runs it.
    """
    kept: dict[Any, _Made] = {}

    @functools.wraps(make)
    def found(*args: _Given.args, **named: _Given.kwargs) -> _Made:
        if named:
            raise TypeError(f"{make.__name__} takes no arguments by name")
        if args not in kept:
            with _MAKING:
                if args not in kept:
                    kept[args] = make(*args, **named)
        return kept[args]

    return found


def source_files() -> list[Path]:
    """The modules whose functions, and whose numbers, go into compiled code."""
    here = Path(__file__).parent
    return [*sorted(here.rglob("*.py")), here.parent / "core_types.py"]


@functools.cache
def sources() -> str:
    """A digest of all that compiled code is made from, but for the equations at hand."""
    content = hashlib.sha256(f"{llvmlite.__version__} {sys.version} {llvm.get_host_cpu_name()}".encode())
    content.update(_features().encode())
    for source in source_files():
        content.update(source.read_bytes())
    return content.hexdigest()


@functools.cache
def _features() -> str:
    return str(llvm.get_host_cpu_features().flatten())


def folders() -> Iterator[Path]:
    """Where compiled code may be kept, the best place first."""
    if chosen := os.environ.get("VALVE_SIM_CACHE"):
        yield Path(chosen)
        return
    cache, home = os.environ.get("XDG_CACHE_HOME", ""), os.environ.get("HOME", "")
    if Path(cache).is_absolute():  # else it is to be ignored, says the XDG base directory specification
        yield Path(cache) / "valve_sim"
    elif home:
        yield Path(home) / ".cache" / "valve_sim"
    yield Path(os.environ.get("TMPDIR") or "/tmp") / f"valve_sim-{os.getuid()}"


def folder_in_use() -> Path | None:
    """Where compiled code is kept; None where there is no place that nobody else can write to."""
    return next((folder for folder in folders() if _usable(folder)), None)


def _usable(folder: Path) -> bool:
    """Whether a folder, made if necessary, is this user's own and nobody else can write to it, or exchange it."""
    if not folder.is_absolute():
        return False
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        whole = folder.resolve()
        status = whole.stat()
        is_safe = not any(_others_can_exchange(above.stat()) for above in whole.parents)
    except OSError:
        return False
    return is_safe and status.st_uid == os.getuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _others_can_exchange(above: os.stat_result) -> bool:
    """Whether another user, except root, can replace a folder inside this one.

    A group may write here, because many systems give each user a group of their own.
    """
    is_foreign = above.st_uid not in (0, os.getuid())
    return is_foreign or bool(above.st_mode & stat.S_IWOTH and not above.st_mode & stat.S_ISVTX)


_SAID: Final[list[Callable[[], None]]] = []


def when_compiling(say: Callable[[], None]) -> None:
    """Call a function once, before something is compiled next."""
    _SAID.append(say)


class Library:
    """Loaded code: the addresses of its functions.

    Args:
        code: an object file.
    """

    def __init__(self, code: bytes) -> None:
        self._engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _target_machine())
        self._engine.add_object_file(llvm.ObjectFileRef.from_data(code))
        self._engine.finalize_object()

    def address(self, name: str) -> int:
        """The address of a function."""
        return int(self._engine.get_function_address(name))


QUICKLY, WELL, AS_A_WHOLE = 0, 1, 2
"""How hard code is optimised: see `library`."""


INLINED: Final = 10
"""LLVM's cost of a call that is worth its function's body: more of them take longer to compile and run no faster."""


def _target_machine(level: int = WELL) -> Any:
    """A description of this processor, and how hard code is optimised for it; each engine takes one of its own."""
    _initialise()
    target = llvm.Target.from_default_triple()
    return target.create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=_features(), opt=level, jit=True, codemodel="jitdefault"
    )


@made_once
def _initialise() -> None:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()


def compiled(text: str, effort: int = AS_A_WHOLE) -> bytes:
    """The object file of a text; `effort`: see `library`."""
    machine = _target_machine(min(effort, WELL))
    module = llvm.parse_assembly(text)
    module.verify()
    if effort == AS_A_WHOLE:
        options = llvm.create_pipeline_tuning_options(speed_level=1)
        options.inlining_threshold = INLINED
        builder = llvm.create_pass_builder(machine, options)
        builder.getModulePassManager().run(module, builder)
    return bytes(machine.emit_object(module))


def library(key: str, text: Callable[[], str], effort: int = AS_A_WHOLE) -> Library:
    """The code of a text: from disk if it is there, else compiled and kept.

    Args:
        key: equal for equal texts, given the sources of this package.
        text: makes the text, if it has to be compiled.
        effort: `AS_A_WHOLE`, by LLVM's passes, of code with branches and calls. Straight-line code is simplified
            when its graph is made, and they would bring nothing: `WELL` or `QUICKLY`, in a quarter of the time, to code
            that takes up to a third longer and gives the same numbers. Code that is better than asked for will do.
    """
    name = hashlib.sha256(f"{sources()} {key}".encode()).hexdigest()[:32]
    kept = folder_in_use()
    if kept is None:
        return Library(_compiled(text, effort))
    for better in range(AS_A_WHOLE, effort - 1, -1):
        with contextlib.suppress(OSError):
            return Library((kept / f"{name}.{better}.o").read_bytes())
    code = _compiled(text, effort)
    with contextlib.suppress(OSError):
        _keep(kept / f"{name}.{effort}.o", code)
    return Library(code)


def _compiled(text: Callable[[], str], effort: int) -> bytes:
    while _SAID:
        _SAID.pop()()
    return compiled(text(), effort)


def _keep(path: Path, code: bytes) -> None:
    """Write a file whole or not at all, and remove the oldest where there are too many."""
    with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
        begun = Path(file.name)
        try:
            file.write(code)
            file.flush()
        except OSError:
            begun.unlink()
            raise
    begun.replace(path)
    held = sorted(path.parent.glob("*.o"), key=lambda one: one.stat().st_mtime)
    for old in held[:-_ENTRIES]:
        old.unlink(missing_ok=True)
