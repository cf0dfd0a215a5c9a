"""A DDS domain that no other run of these tests on this machine has, for as long as this process lives."""

from __future__ import annotations

import fcntl
import functools
import os
import tempfile
from pathlib import Path

DOMAINS = range(20, 100)
"""Free of what people use (0 and a few more), and below 102, where ports of outgoing connections begin."""

_held: list[int] = []


@functools.cache
def own_domain() -> int:
    """The first domain whose lock file nobody holds; the kernel lets go of it when this process ends."""
    for domain in DOMAINS:
        path = Path(tempfile.gettempdir()) / f"valve_sim-test-domain-{domain}-{os.getuid()}"
        lock = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(lock)
            continue
        _held.append(lock)
        return domain
    raise RuntimeError(
        f"every domain from {DOMAINS.start} to {DOMAINS.stop - 1} is taken by another run of these tests"
    )
