"""What all tests share: how hypothesis draws, and which files share a process where several run them."""

from __future__ import annotations

import signal
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

# The same examples each time, and none is refused because the machine is busy.
settings.register_profile("seeded", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("seeded")

# A shell's background job ignores Ctrl-C, and so would every program that a test starts and stops by it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

SHARED = {
    "test_page.py": "the diagnosis of friction",
    "test_properties.py": "the diagnosis of friction",
    "test_wording.py": "the diagnosis of friction",
    "test_golden.py": "the shipped recordings",
    "test_bags.py": "the shipped recordings",
    "test_api.py": "the shipped recordings",
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
