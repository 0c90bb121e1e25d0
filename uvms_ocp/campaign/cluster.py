"""Make the runs of a campaign on a Dask cluster, this machine or another, into the campaign's
folder.
"""

from __future__ import annotations

import math
import signal
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from uvms_ocp.campaign.jobs import CampaignJob
from uvms_ocp.campaign.manifest import CampaignManifest
from uvms_ocp.campaign.store import arrow, opened
from uvms_ocp.codegen.background import n_processors
from uvms_ocp.codegen.c_compiler import warn_if_slower
from uvms_ocp.errors import (
    InvalidInput,
    OutputError,
    UvmsError,
    optional_module,
    require_first_reading,
)
from uvms_ocp.interrupts import held_back
from uvms_ocp.progress import progress_bar, show_progress
from uvms_ocp.record.table_files import CAMPAIGN_EXTRA
from uvms_ocp.types import Range

DEATHS = 3
"""Deaths of workers after which a run is taken for the cause, on this machine; a cluster at an
address has its own number.
"""
_SETTINGS = {
    "distributed.scheduler.allowed-failures": DEATHS - 1,
    # A run that waits on a worker would be blamed when another run ends that worker: none waits.
    "distributed.scheduler.worker-saturation": 1.0,
    "distributed.worker.daemon": True,
    "distributed.comm.retry.count": 3,
    "distributed.admin.log-format": "%(message)s",
}
_CONNECTION_TIMEOUT = 30.0  # [s] for a scheduler to answer

Progress = Callable[[int, int, int], None]
"""Function that gets the numbers of finished, of failed and of all runs."""
Workers = Annotated[int, Range(1, 4096)]
"""Number of processes of this machine."""


def dask_setup(worker: Any) -> None:
    """Set a worker of this machine up, called by Dask as it starts: its runs show no bars, and it ignores
    Ctrl-C, which is for the command that then ends its workers.
    """
    show_progress(False)
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def dask() -> Any:
    """Import the library distributed. Raises `NotInstalled` without it."""
    return optional_module("distributed", "a campaign", CAMPAIGN_EXTRA)


def connected(scheduler: str | None, workers: int | None) -> AbstractContextManager[Any]:
    """Connect a `distributed.Client` to the scheduler at an address, or to `workers` processes of this
    machine, by default one for each processor.

    Raises `OutputError` where nobody answers at the address, `InvalidInput` for an empty address and
    where both an address and a number of workers are given, and `UvmsError` where workers end as
    they start.
    """
    if scheduler is None:
        return _local_cluster(workers or n_processors())
    if workers is not None:
        raise InvalidInput(
            f"workers = {workers} with a scheduler; a cluster has its own: leave it out"
        )
    if not scheduler.strip():
        raise InvalidInput(
            "scheduler is empty; give the address of a Dask cluster such as tcp://host:8786"
        )
    return _remote_client(scheduler)


@contextmanager
def _local_cluster(workers: int) -> Iterator[Any]:
    """Start workers on this machine, and connect a client to them."""
    distributed = dask()
    from dask import config

    with config.set(_SETTINGS), tempfile.TemporaryDirectory(prefix="uvms_ocp_") as folder:
        try:
            with held_back(), _ctrl_c_blocked():
                cluster = distributed.LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    processes=True,
                    host="127.0.0.1",
                    dashboard_address=None,
                    # any free port: another campaign may run on this machine
                    scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
                    local_directory=folder,
                    silence_logs=50,
                    preload=["uvms_ocp.campaign.cluster"],
                )
        except RuntimeError:
            raise UvmsError(
                "a campaign: its worker processes ended as they started; see their last words on"
                " stderr"
            ) from None
        with cluster, distributed.Client(cluster) as client:
            yield client


@contextmanager
def _ctrl_c_blocked() -> Iterator[None]:
    """Keep Ctrl-C from threads and processes that are started within: a terminal sends it to all,
    and each would end with a traceback of its own.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    # Started later, the tracker would unblock Ctrl-C in the thread that starts workers.
    resource_tracker.ensure_running()
    mask_before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask_before)


def _remote_client(address: str) -> Any:
    """Connect a client to the scheduler at an address. Raises `OutputError` where none answers."""
    try:
        return dask().Client(address, timeout=_CONNECTION_TIMEOUT)
    except (OSError, ValueError, TimeoutError) as error:
        reason = " ".join(str(error).split())[:200]
        raise OutputError(
            f"no Dask scheduler answers at {address} ({reason}); give one such as tcp://host:8786"
        ) from None


def run_jobs(
    out: Path,
    identity: CampaignManifest,
    work: CampaignJob,
    sources: Mapping[str, bytes] | None = None,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    limit: float = math.inf,
    progress: Progress | None = None,
) -> None:
    """Make all runs of `work` that are not finished in the folder `out`; workers: processes of this
    machine; limit [s] of a run.

    Raises what `opened`, `connected` and `Dispatch.run` raise, and `NotInstalled` without the extra
    ``uvms-ocp[campaign]``.
    """
    require_first_reading("Campaign.run")
    with held_back():  # a library that is loaded by half cannot be loaded again
        dask()
        arrow()
        from uvms_ocp.campaign.dispatch import Dispatch
    with ExitStack() as resources:
        # Before the folder is made, so that a wrong address leaves none behind.
        if scheduler is None:
            client = None
        else:
            client = resources.enter_context(connected(scheduler, workers))
        folder = resources.enter_context(opened(out, identity, sources or {}))

        begun = int(np.sum(folder.finished))
        total = len(folder.finished)
        bar = resources.enter_context(
            progress_bar(shown=progress is None, unit="run", initial=begun, total=total)
        )

        def report_progress() -> None:
            done = int(np.sum(folder.finished))
            bar.set_postfix(failed=folder.failed, refresh=False)
            bar.update(done - bar.n)
            if progress is not None:
                progress(done, folder.failed, total)

        report_progress()
        if len(folder.left):
            if client is None:
                warn_if_slower()  # here, as workers do not print it
                client = resources.enter_context(connected(None, workers))
            Dispatch(client, work, folder, limit=limit, exclusive=scheduler is None).run(
                folder.left.tolist(), report_progress
            )
