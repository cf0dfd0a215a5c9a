"""MAT files of others, which do not ship: arrays by name, or one clear line."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat
from scipy.io.matlab import MatReadError

from valve_sim.model import ValveError


def read_variables(path: Path, names: Sequence[str], how_to_get_it: str) -> list[NDArray[np.float64]]:
    """The variables of a MAT file, as they are there.

    Args:
        path: the file. names: of the variables. how_to_get_it: ends every message.

    Raises:
        ValveError: the file is missing, is no such file or lacks a variable.
    """
    if not path.is_file():
        raise ValveError(f"{path}: no such file; {how_to_get_it}")
    try:
        content = loadmat(path)
    except OSError as error:
        raise ValveError(f"{path}: cannot be read ({error.strerror}); {how_to_get_it}") from error
    except (MatReadError, ValueError, TypeError, NotImplementedError) as error:
        raise ValveError(f"{path}: is no MAT file; {how_to_get_it}") from error
    missing = [name for name in names if name not in content]
    if missing:
        raise ValveError(f"{path}: holds no variable {missing[0]}; {how_to_get_it}")
    return [np.asarray(content[name], dtype=np.float64) for name in names]
