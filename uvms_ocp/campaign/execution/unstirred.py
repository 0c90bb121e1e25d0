"""Loaded by workers of this machine as they start: Ctrl-C is for the command, which then ends them itself."""

from __future__ import annotations

import signal
import threading
from typing import Any


def dask_setup(worker: Any) -> None:
    """What Dask calls. Interrupts go past this process."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)
