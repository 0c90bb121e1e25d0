"""Execute a campaign: from its folder to its cluster and back."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import numpy as np

from uvms_ocp.campaign.cluster import connected, dask
from uvms_ocp.campaign.jobs import CampaignJob
from uvms_ocp.campaign.store import CampaignFolder, CampaignManifest, arrow, opened
from uvms_ocp.codegen.compile import warn_if_slower
from uvms_ocp.types import Range

Progress = Callable[[int, int, int], None]
"""Told how many runs are done, how many of them failed, and of how many."""
Workers = Annotated[int, Range(1, 4096)]
"""Processes of this machine."""


def run_jobs(
    out: Path,
    identity: CampaignManifest,
    work: CampaignJob,
    *,
    sources: Mapping[str, bytes] | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    limit: float = math.inf,
    progress: Progress | None = None,
) -> None:
    """Make all runs of `work` that are not finished in the folder `out`; workers: processes of this machine;
    limit [s] of a run.

    Raises what `opened`, `connected` and `Dispatch.run` raise, and `NotInstalled` without the extra ``uvms-ocp[campaign]``.
    """
    dask(), arrow()
    with ExitStack() as held:
        # Nobody at the address is found out before there is a folder.
        client = None if scheduler is None else held.enter_context(connected(scheduler, workers))
        folder = held.enter_context(opened(out, identity, sources or {}))
        report_progress = _progress_reporter(folder, progress)
        report_progress()
        if len(folder.left):
            from uvms_ocp.campaign.dispatch import Dispatch  # with Dask, which takes a second

            if client is None:
                warn_if_slower()  # which workers would not say
                client = held.enter_context(connected(None, workers))
            dispatch = Dispatch(client, work, folder, limit=limit, exclusive=scheduler is None)
            dispatch.run(folder.left.tolist(), report_progress)


def _progress_reporter(folder: CampaignFolder, progress: Progress | None) -> Callable[[], None]:
    def report_progress() -> None:
        if progress is not None:
            progress(int(np.sum(folder.finished)), folder.failed, len(folder.finished))

    return report_progress
