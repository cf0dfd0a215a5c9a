"""Which tests share a process, where several processes run them."""

from __future__ import annotations

import pytest

SHARED = {
    "test_html.py": "the diagnosis of friction",
    "test_wording.py": "the diagnosis of friction",
}
"""Files whose costly recordings or diagnoses are cached in the process that made them, and what these are."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """With `--dist loadgroup` the tests of a file run in one process, and so do those of files that share something."""
    for item in items:
        item.add_marker(pytest.mark.xdist_group(SHARED.get(item.path.name, str(item.path))))
