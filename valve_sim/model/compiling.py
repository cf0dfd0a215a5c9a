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
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba


def cache_folder() -> Path | None:
    """The folder for compiled code, made if need be.

    NUMBA_CACHE_DIR, where set, is the only choice; else the user's cache folder, or a folder of the user's among
    temporary files. None where none can be written: all works, but is compiled at every start, and a warning says so.
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
    warnings.warn(
        f"no folder for compiled code can be written (tried {tried}): every start compiles anew, which takes about ten "
        "seconds; set NUMBA_CACHE_DIR to a folder that can",
        RuntimeWarning,
        stacklevel=2,
    )
    return None


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
def cached() -> Iterator[bool]:
    """While inside, Numba's decorators keep their code in our folder; gives whether there is one to keep it in."""
    settings: Any = numba.config
    before = settings.CACHE_DIR
    if _FOLDER is not None:
        settings.CACHE_DIR = str(_FOLDER)
    try:
        yield _FOLDER is not None
    finally:
        settings.CACHE_DIR = before


def compiled(function: Callable[..., Any]) -> Any:
    """Compile when first called, keep on disk, release the interpreter lock; divisions follow IEEE 754."""
    with cached() as has_folder:
        return numba.njit(cache=has_folder, nogil=True, error_model="numpy")(function)


def compiled_once(function: Callable[..., Any]) -> Any:
    """The same for this process only: code that no module holds cannot be found again."""
    return numba.njit(nogil=True, error_model="numpy")(function)


_INNER: dict[str, Any] = {
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
    "error_model": "numpy",
    "_nrt": False,  # nothing is allocated inside a step, so nothing needs counting
    "fastmath": {"contract", "arcp"},  # a x + b in one rounding, one division for many; NaN and infinity stay exact
}


def inner(function: Callable[..., Any]) -> Any:
    """Compile a function that only compiled code calls: without Python's wrappers and reference counts."""
    return numba.njit(**_INNER)(function)


def inlined(function: Callable[..., Any]) -> Any:
    """The same, pasted into its callers: for what each stage of a step evaluates, where calls cost as much as work."""
    return numba.njit(forceinline=True, **_INNER)(function)
