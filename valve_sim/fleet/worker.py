"""What a worker of the embedded cluster does as it starts: Dask loads this module and calls `dask_setup`."""

from __future__ import annotations

import os
import signal
import threading

# Before NumPy is loaded: matrices of a fit are thin, and the other processors belong to the other workers.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def dask_setup(worker: object) -> None:
    """Leave Ctrl-C to the process that started the cluster: it ends its workers."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)
