"""How the core is compiled, and where the compiled code is kept.

Numba looks at a function's own file only when it decides whether a cached version is still good, so the cache lives
in a folder named after a digest of every source in this room: change one, and all is compiled anew. The folder is
the user's own (the package may be installed read-only) and closed to others, because it holds code.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba

from valve_sim.model.errors import ValveError


def cache_folder() -> Path:
    """The folder for compiled code, made if need be.

    NUMBA_CACHE_DIR, where set, wins; then the user's cache folder; then a folder of the user's among temporary files.

    Raises:
        ValveError: none of them can be written.
    """
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    home = os.environ.get("XDG_CACHE_HOME") or str(Path("~").expanduser() / ".cache")
    temporary = Path(tempfile.gettempdir()) / f"valve_sim-{os.getuid()}"
    candidates = [Path(chosen)] if chosen else [Path(home) / "valve_sim", temporary]
    for candidate in candidates:
        folder = candidate / _digest_of_sources()
        if _is_ours_to_write(folder):
            return folder
    tried = ", ".join(str(candidate) for candidate in candidates)
    raise ValveError(f"no folder for compiled code can be written (tried {tried}); set NUMBA_CACHE_DIR to one that can")


def _digest_of_sources() -> str:
    digest = hashlib.sha256(f"{numba.__version__} {sys.version}".encode())
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


def _is_ours_to_write(folder: Path) -> bool:
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if folder.stat().st_uid != os.getuid():
            return False
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


_FOLDER = cache_folder()


@contextlib.contextmanager
def cached() -> Iterator[None]:
    """While inside, Numba's decorators keep their code in our folder; other packages are left alone."""
    settings: Any = numba.config
    before = settings.CACHE_DIR
    settings.CACHE_DIR = str(_FOLDER)
    try:
        yield
    finally:
        settings.CACHE_DIR = before


def compiled(function: Callable[..., Any]) -> Any:
    """Compile when first called, keep on disk, release the interpreter lock; divisions follow IEEE 754."""
    with cached():
        return numba.njit(cache=True, nogil=True, error_model="numpy")(function)


def compiled_once(function: Callable[..., Any]) -> Any:
    """The same for this process only: code that no module holds cannot be found again."""
    return numba.njit(nogil=True, error_model="numpy")(function)


def inner(function: Callable[..., Any]) -> Any:
    """Compile a function that only compiled code calls: without the wrappers that Python would need."""
    options: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "error_model": "numpy"}
    return numba.njit(**options)(function)
