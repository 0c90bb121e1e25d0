"""What runs on a worker: some runs one after the other, of the work that was sent to it once."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Sequence
from functools import partial
from typing import Any

from distributed import WorkerPlugin, get_worker

from uvms_ocp.campaign.runs.work import Done, Work, attempted

_TOLD = 1.0  # [s] in which word of it arrives


class WorkHere(WorkerPlugin):
    """Every worker gets it as it joins, one that replaces another too."""

    def __init__(self, name: str, work: Work) -> None:
        """name: of the campaign, by which its runs find it."""
        self.name, self.work = name, work

    def setup(self, worker: Any) -> None:
        """Keep quiet: what a run has to say stands in its row."""
        logging.getLogger("uvms_ocp").setLevel(logging.ERROR)


def make_runs(name: str, runs: Sequence[int], limit: float) -> list[Done]:
    """The rows of these runs [-] of the campaign of that name; limit [s] of each."""
    worker = get_worker()
    work: Work = worker.plugins[name].work
    place = f"{worker.address} {os.getpid()}"
    return [attempted(work, run, place, limit, partial(_end, worker, name, run)) for run in runs]


def _end(worker: Any, name: str, run: int) -> None:
    """Of a process in a call that does not come back: whoever waits for the run is told first."""
    worker.log_event(name, {"run": run})
    time.sleep(_TOLD)
    os._exit(1)
