"""How the core is compiled, and where the compiled code is kept.

Numba looks at a function's own file only when it decides whether a cached version is still good, so the cache lives
in a folder named after a digest of every source in this room: change one, and all is compiled anew. The folder is
the user's own (the package may be installed read-only) and not writable by others: Numba unpickles the files in it, so
anyone who can write there can run code as this user. A folder that somebody else owns or can write to is not used.

Processes share the folder, and a process may load code that several others compiled. Numba names a compiled function by
its Python name, the types of its arguments and a number that counts in every process from 1, and knows a record type by
such a number too: a function for valves with gas, compiled in one process, and the same function for valves without,
compiled in another, could have one name, and a process that loads both would run one of the two for both
(https://github.com/numba/numba/issues/10486). So the numbers are drawn at random here, and one process at a time
writes, since two would choose the same file for different code.

All this takes private names of Numba. A version that it was not tried with, or that numbers functions in another way,
is left alone: it compiles at every start, in its own way, and nothing is kept.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import pwd
import shutil
import stat
import sys
import tempfile
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import FunctionType
from typing import Any, Final

import numba

_ROOM: Final = 16_000_000
"""Bytes that must be free: the compiled code takes about two million, and Numba fails if it cannot write all of it."""
_TRIED: Final = ((0, 58), (0, 68))
"""The first and the last version of Numba whose private names are used here."""
COMPILING: Final = "compiling the model for this machine, once: up to 25 s of one core"
"""What is said when code has to be compiled; measured in seconds of processor time on a server of 2.5 GHz."""


def is_tried(version: tuple[int, int]) -> bool:
    """Whether this package was tried with a version of Numba."""
    return _TRIED[0] <= version <= _TRIED[1]


def cache_folder() -> Path | None:
    """The folder for compiled code, created if necessary.

    NUMBA_CACHE_DIR is used if it is set; otherwise the user's cache folder or, failing that, a folder of the user's
    among the temporary files. A path that is not absolute is not used: it would be another in each working directory.
    None if none of them can be written: the package still works, but compiles at every start, and warns about it.
    """
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    tried = []
    for candidate in [Path(chosen)] if chosen else _own_folders():
        folder = candidate / _digest_of_sources()
        why_not = _why_unusable(folder)
        if not why_not:
            return folder
        tried.append(f"{candidate}: {why_not}")
    _warn_that_nothing_is_kept(
        f"no folder for compiled code can be used ({'; '.join(tried)})",
        "set NUMBA_CACHE_DIR to the absolute path of a folder that only you can write to",
    )
    return None


def _own_folders() -> list[Path]:
    """Where a user's compiled code may be: the user's cache, if there is a home, and a folder of temporary files."""
    found = []
    cache, home = os.environ.get("XDG_CACHE_HOME", ""), os.environ.get("HOME", "")
    with contextlib.suppress(KeyError):  # a user without an entry in the list of users
        home = home or pwd.getpwuid(os.getuid()).pw_dir
    if Path(cache).is_absolute():  # else it is to be ignored, says the XDG base directory specification
        found.append(Path(cache) / "valve_sim")
    elif home:
        found.append(Path(home) / ".cache" / "valve_sim")
    temporary = Path(os.environ.get("TMPDIR") or "/tmp")
    return [*found, temporary / f"valve_sim-{os.getuid()}"]


def _warn_that_nothing_is_kept(why: str, mend: str) -> None:
    warnings.warn(
        f"{why}: every start compiles anew, which takes up to 25 s of one core; {mend}",
        RuntimeWarning,
        stacklevel=3,
    )


def _digest_of_sources() -> str:
    digest = hashlib.sha256(f"{numba.__version__} {sys.version}".encode())
    for source in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


def _why_unusable(folder: Path) -> str:
    """Why compiled code cannot be stored in, or loaded from, a folder, which is created; empty if it can."""
    if not folder.is_absolute():
        return "not an absolute path"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        whole = folder.resolve()
        if whole.stat().st_uid != os.getuid():
            return "owned by another user"
        if whole.stat().st_mode & (stat.S_IWGRP | stat.S_IWOTH):
            return "others can write to it"
        for above in whole.parents:
            if _others_can_exchange(above.stat()):
                return f"others can exchange what is in {above}"
        with tempfile.TemporaryFile(dir=whole):
            return "" if shutil.disk_usage(whole).free >= _ROOM else "the disk is full"
    except OSError as error:
        return f"cannot be written, {error.strerror}"


def _others_can_exchange(above: os.stat_result) -> bool:
    """Whether another user, except root, can replace a folder inside this one.

    A group may write here, because many systems give each user a group of their own.
    """
    is_foreign = above.st_uid not in (0, os.getuid())
    return is_foreign or bool(above.st_mode & stat.S_IWOTH and not above.st_mode & stat.S_ISVTX)


def _numbered_at_random() -> bool:
    """Have Numba number compiled functions unlike any other process, one forked from this included.

    The numbers of the whole process are drawn, because what others compile may be taken into code that is kept here;
    all that anybody asks of a number is that no other is equal.

    Returns:
        whether this Numba does so.
    """
    if not is_tried(numba.version_info.short):
        return False
    try:
        from numba.core.bytecode import FunctionIdentity

        before = FunctionIdentity._unique_ids
        drawn: Any = iter(lambda: int.from_bytes(os.urandom(16), "big"), None)
        FunctionIdentity._unique_ids = drawn
        if FunctionIdentity.from_function(_numbered_at_random).unique_id > 2**64:
            return True
        FunctionIdentity._unique_ids = before
    except (ImportError, AttributeError):
        pass
    return False


def _folder_in_use() -> Path | None:
    """The folder for compiled code; None, and a warning, where there is none or this Numba has to be left alone."""
    if _numbered_at_random():
        return cache_folder()
    first, last = (".".join(map(str, version)) for version in _TRIED)
    _warn_that_nothing_is_kept(
        f"Numba {numba.__version__} works otherwise than those that were tried, {first} to {last}",
        f"install a Numba from {first} to {last}",
    )
    return None


_FOLDER: Final = _folder_in_use()
_SETTING: Final = threading.Lock()


@contextlib.contextmanager
def cached() -> Iterator[bool]:
    """Context in which Numba's decorators store code in our folder; yields whether there is such a folder.

    Numba reads the folder from a variable of the whole process. Two threads that set it at once would leave it empty
    for each other, and Numba would write into the working directory.
    """
    if _FOLDER is None:
        yield False
        return
    settings: Any = numba.config
    ours = {"CACHE_DIR": str(_FOLDER), "CACHE_LOCATOR_CLASSES": ""}
    with _SETTING:
        before = {name: getattr(settings, name) for name in ours if hasattr(settings, name)}
        try:
            vars(settings).update({name: ours[name] for name in before})
            yield True
        finally:
            vars(settings).update(before)


def compiled(function: Callable[..., Any]) -> Any:
    """Compile when first called, keep on disk, release the interpreter lock; divisions follow IEEE 754."""
    with cached() as has_folder:
        dispatcher = numba.njit(cache=has_folder, nogil=True, error_model="numpy")(function)
    if has_folder:
        cache = _cache_of(dispatcher)
        _load_at_once(cache)
        _keep_where_possible(cache)
        _announce_where_missing(cache)
    return dispatcher


def _cache_of(function: Any) -> Any:
    return function._cache  # Numba has no public way to say how it stores and loads


def _load_at_once(cache: Any) -> None:
    """Load compiled code without what only compiling needs, a hundred modules of Numba: a tenth of a short command."""
    from numba.core.runtime.nrt import rtsys

    def load_at_once(signature: Any, context: Any) -> Any:
        rtsys.initialize(context)
        with cache._guard_against_spurious_io_errors():
            return cache._load_overload(signature, context)

    cache.load_overload = load_at_once


def _keep_where_possible(cache: Any) -> None:
    """Use compiled code even if it cannot be stored: the disk or a quota may be full."""
    keep = cache.save_overload

    def keep_if_possible(signature: Any, result: Any) -> None:
        _under_way.discard(threading.get_ident())
        with contextlib.suppress(OSError), _alone_in(Path(cache.cache_path)):
            keep(signature, result)

    cache.save_overload = keep_if_possible


@contextlib.contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Context that one process at a time is in: Numba reads its index, chooses a file and writes both, unguarded."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "lock").open("w") as lock:
        with contextlib.suppress(OSError):  # some network file systems lock nothing
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


_announcements: list[Callable[[], None]] = []
_under_way: set[int] = set()
"""Threads that compile."""


def is_compiling() -> bool:
    """Whether a function is being compiled that was not on disk."""
    return bool(_under_way)


def announce_compiling(tell: Callable[[], None]) -> None:
    """Call `tell` once, before the first function that has to be compiled; never if all are on disk."""
    _announcements.append(tell)


def _announce_where_missing(cache: Any) -> None:
    load = cache.load_overload

    def load_or_announce(signature: Any, context: Any) -> Any:
        found = load(signature, context)
        if found is None:
            _under_way.add(threading.get_ident())
        while found is None and _announcements:
            _announcements.pop()()
        return found

    cache.load_overload = load_or_announce


def compiled_callback(signature: Any, function: Callable[..., Any], given: Mapping[str, Any], kept_as: str = "") -> Any:
    """Compile to a C callback.

    Args:
        signature: of the callback. function: to compile; it must not be a closure.
        given: the globals that the function lacks, compiled functions among them.
        kept_as: name under which it is stored on disk, one for each choice of `given`; default: not stored.
    """
    # For code on disk Numba compares the variables of a closure, and compiled functions of two processes are never
    # equal; it does not compare globals.
    bound: Any = FunctionType(function.__code__, {**function.__globals__, **given})
    bound.__module__ = function.__module__
    if kept_as and _FOLDER is not None:
        from numba.core.ccallback import CFunc
        from numba.core.sigutils import normalize_signature

        bound.__qualname__ = kept_as  # the name of its file
        callback = CFunc(bound, normalize_signature(signature), locals={}, options={})
        with contextlib.suppress(OSError):  # a disk may be full
            with cached():
                callback.enable_caching()
            _load_at_once(_cache_of(callback))
            callback.compile()
            return callback
    return numba.cfunc(signature)(bound)


def compiled_once(function: Callable[..., Any]) -> Any:
    """`compiled` without storing it: a function that belongs to no module cannot be found again by its name."""
    return numba.njit(nogil=True, error_model="numpy")(function)


def linked(version: tuple[int, int]) -> dict[str, Any]:
    """How a function is compiled that is only taken in by others, as options of `numba.njit`.

    Args:
        version: of Numba.

    Returns:
        the pipeline of `linking`; nothing, so Numba's own, for a version whose insides it has not been tried with:
        there the first start takes half as long again.
    """
    if not is_tried(version):
        return {}
    from valve_sim.model.linking import LinkedCompiler  # another Numba may lack what it imports

    return {"pipeline_class": LinkedCompiler}


_TAKEN_IN: dict[str, Any] = {
    **linked(numba.version_info.short),
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
    "error_model": "numpy",
}
_INNER: dict[str, Any] = {
    **_TAKEN_IN,
    "_nrt": False,  # nothing is allocated inside a step, so no references are counted
    "fastmath": {"contract", "arcp"},  # fused multiply-add and shared reciprocals; NaN and infinity stay exact
}


def taken_in(function: Callable[..., Any]) -> Any:
    """Compile the body of a function that Python calls: without Python's wrappers, and otherwise as that function."""
    return numba.njit(**_TAKEN_IN)(function)


def inner(function: Callable[..., Any]) -> Any:
    """Compile a function that only compiled code calls: without Python's wrappers and reference counts."""
    return numba.njit(**_INNER)(function)


def inlined(function: Callable[..., Any]) -> Any:
    """A compiled function that is inlined into its callers: for code that every stage of a step evaluates."""
    return numba.njit(forceinline=True, **_INNER)(function)
