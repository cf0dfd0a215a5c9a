"""What a worker of the embedded cluster does as it starts: Dask loads this module and calls `dask_setup`."""

from __future__ import annotations

import signal
import threading


def dask_setup(worker: object) -> None:
    """Leave Ctrl-C to the process that started the cluster: it ends its workers."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)
