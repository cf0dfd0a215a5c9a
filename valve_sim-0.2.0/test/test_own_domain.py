"""Two runs of the tests at once do not hear each other."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from own_domain import DOMAINS, own_domain


def test_two_processes_have_two_domains() -> None:
    mine = own_domain()
    script = "from own_domain import own_domain; print(own_domain())"
    other = subprocess.run(
        [sys.executable, "-c", script], cwd=Path(__file__).parent, capture_output=True, text=True, check=True
    )
    assert {mine, int(other.stdout)} <= set(DOMAINS)
    assert int(other.stdout) != mine
    assert own_domain() == mine
