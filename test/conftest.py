"""Which tests share a process, where several processes run them."""

from __future__ import annotations

from typing import Any

import pytest

SHARED = {
    "test_html.py": "the diagnosis of friction",
    "test_wording.py": "the diagnosis of friction",
}
"""Files whose costly recordings or diagnoses are cached in the process that made them, and what these are."""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """With `--dist loadfile` one process runs the tests of a file, and those of all files that share something."""
    from xdist.scheduler import LoadFileScheduling

    class SharingScheduling(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = super()._split_scope(nodeid)
            return SHARED.get(file.rpartition("/")[2], file)

    return SharingScheduling(config, log) if config.getvalue("dist") == "loadfile" else None
