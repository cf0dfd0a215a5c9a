"""Results as JSON: records become mappings, and numbers that are not finite become null, as JSON has none."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def finite_or_none(value: float) -> float | None:
    """The number if it is finite, else None."""
    return float(value) if math.isfinite(value) else None


def plain(value: Any) -> Any:
    """The value in the types of JSON: mappings, lists, strings, finite numbers, null."""
    if isinstance(value, float):
        return finite_or_none(value)
    if dataclasses.is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if hasattr(value, "_asdict"):
        return plain(value._asdict())
    if isinstance(value, Mapping):
        return plain_mapping(value)
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return str(value) if isinstance(value, Path) else value


def plain_mapping(report: Mapping[str, Any]) -> dict[str, Any]:
    """A report in the types of JSON."""
    return {str(key): plain(item) for key, item in report.items()}


def json_text(report: Mapping[str, Any]) -> str:
    """A report as the text of a file or of a terminal."""
    return json.dumps(plain(report), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
