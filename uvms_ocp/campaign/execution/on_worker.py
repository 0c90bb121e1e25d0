"""What runs on a worker: some runs one after the other, of the work that was sent to it once."""

from __future__ import annotations

import logging
import os
from collections.abc import Sequence
from typing import Any

from distributed import WorkerPlugin, get_worker

from uvms_ocp.campaign.runs.work import Done, Work, attempted


class WorkHere(WorkerPlugin):
    """Every worker gets it as it joins, one that replaces another too."""

    def __init__(self, name: str, work: Work) -> None:
        """name: of the campaign, by which its runs find it."""
        self.name, self.work = name, work

    def setup(self, worker: Any) -> None:
        """Keep quiet: what a run has to say stands in its row."""
        logging.getLogger("uvms_ocp").setLevel(logging.ERROR)


def make_runs(name: str, runs: Sequence[int]) -> list[Done]:
    """The rows of these runs [-] of the campaign of that name."""
    worker = get_worker()
    work: Work = worker.plugins[name].work
    return [attempted(work, run, f"{worker.address} {os.getpid()}") for run in runs]
