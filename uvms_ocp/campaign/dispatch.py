"""Dispatch runs to the workers of a cluster and collect rows: a bounded number at a time, whatever
becomes of the workers.
"""

from __future__ import annotations

import logging
import math
import os
import queue
import time
from collections import deque
from collections.abc import Iterable, Sequence
from contextlib import suppress
from functools import partial
from itertools import islice
from time import monotonic
from typing import Any
from uuid import uuid4

from distributed import WorkerPlugin, get_worker

from uvms_ocp.campaign.cluster import dask
from uvms_ocp.campaign.jobs import (
    ERROR,
    KILLED,
    TIME_LIMIT,
    CampaignJob,
    RunResult,
    attempt_job,
    failed_row,
    over_time,
)
from uvms_ocp.campaign.store import CampaignFolder
from uvms_ocp.errors import OutputError

_LOG_DELAY = 1.0  # [s] in which an event of a worker arrives before its process ends
_AHEAD = 3  # tasks that are sent for every thread of the cluster
_TASK = 0.3  # [s] that a task of several short runs takes
_MOST = 50  # runs of a task
_LOOK = 0.5  # [s] between two looks at the clock
_ALONE = 60.0  # [s] without any worker, after which it is logged

_log = logging.getLogger(__name__)


class JobPlugin(WorkerPlugin):
    """Plugin that carries the work of a campaign to every worker as it joins."""

    def __init__(self, name: str, work: CampaignJob) -> None:
        """name: of the campaign, by which its runs find it."""
        self.name = name
        self.work = work

    def setup(self, worker: Any) -> None:
        """Keep quiet: what a run has to say stands in its row."""
        logging.getLogger("uvms_ocp").setLevel(logging.ERROR)


def make_runs(name: str, runs: Sequence[int], limit: float) -> list[RunResult]:
    """Make runs on a worker, one after the other, of the campaign of a name; limit: [s] of each run."""
    worker = get_worker()
    work: CampaignJob = worker.plugins[name].work
    place = f"{worker.address} {os.getpid()}"
    return [attempt_job(work, run, place, limit, partial(_end, worker, name, run)) for run in runs]


def _end(worker: Any, name: str, run: int) -> None:
    """End a process in a call that does not return, after informing whoever waits for the run."""
    worker.log_event(name, {"run": run})
    time.sleep(_LOG_DELAY)
    os._exit(1)


class Dispatch:
    """Dispatcher of the runs of one campaign on one cluster."""

    def __init__(
        self,
        client: Any,
        work: CampaignJob,
        folder: CampaignFolder,
        *,
        limit: float = math.inf,
        exclusive: bool = False,
    ) -> None:
        """client: a ``distributed.Client``. limit [s] of a run. exclusive: whether workers have one
        at a time, alone to blame.
        """
        self._client = client
        self._work = work
        self._folder = folder
        self._name = f"runs-{uuid4().hex}"
        self._limit = limit
        self._overdue: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._running: dict[Any, Sequence[int]] = {}
        self._alone: deque[int] = deque()
        self._exclusive = exclusive
        self._suspects = deque[int]()
        self._tried = set[int]()
        self._arrived: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._wall = 0.0
        self._made = 0
        self._alone_since: float | None = None

    def run(self, runs: Iterable[int], progress: Any) -> None:
        """Make all of these runs; progress: called without arguments whenever rows have come.

        Raises `OutputError` where the cluster is lost. Rows that have come are in the folder then,
        as after an interrupt.
        """
        todo = iter(runs)
        self._client.register_plugin(JobPlugin(self._name, self._work), name=self._name)
        self._client.subscribe_topic(self._name, self._overdue.put)
        try:
            self._fill(todo)
            while self._running:
                self._take(self._wait())
                self._give_up()
                self._folder.flush()
                self._fill(todo)
                progress()
        finally:
            self._stop()

    def _fill(self, todo: Any) -> None:
        if self._running:
            workers = self._client.scheduler_info(n_workers=-1)["workers"].values()
            counts = [worker["nthreads"] for worker in workers]
        else:
            workers = ()
            counts = self._client.nthreads().values()
        threads = max(1, sum(counts))
        while len(self._running) < _AHEAD * threads:
            chunk = self._next(todo)
            if not chunk:
                break
            self._send(chunk)
        if self._suspects and not self._running:
            self._send([self._suspects.popleft()])  # with nothing beside it

    def _next(self, todo: Any) -> list[int]:
        """Runs of the next task: those under suspicion one by one, others together as far as they
        are short.
        """
        if self._alone:
            return [self._alone.popleft()]
        mean = self._wall / self._made if self._made else _TASK
        size = min(_MOST, max(1, int(_TASK / max(mean, 1e-6))))
        return [int(run) for run in islice(todo, size)]

    def _send(self, chunk: list[int]) -> None:
        key = (self._name, chunk[0], uuid4().hex)
        future = self._client.submit(make_runs, self._name, chunk, self._limit, key=key, pure=False)
        self._running[future] = chunk
        future.add_done_callback(self._arrived.put)

    def _wait(self) -> list[Any]:
        """Futures that are done, once some are or it is time to look at the clock."""
        done_futures = []
        with suppress(queue.Empty):
            done_futures.append(self._arrived.get(timeout=_LOOK))
            while True:
                done_futures.append(self._arrived.get_nowait())
        if not done_futures:
            self._require_cluster()
            self._warn_of_no_workers()
        return done_futures

    def _warn_of_no_workers(self) -> None:
        """Warn once, as a cluster may still be waiting for its machines."""
        if self._client.nthreads():
            self._alone_since = None
        elif self._alone_since is None:
            self._alone_since = monotonic()
        elif monotonic() - self._alone_since > _ALONE:
            self._alone_since = math.inf
            _log.warning(
                "the cluster has had no worker for %g s; they need this version of uvms_ocp, too",
                _ALONE,
            )

    def _take(self, futures: Sequence[Any]) -> None:
        finished = {future: future for future in futures if future.status == "finished"}
        for future, results in self._client.gather(finished, errors="skip").items():
            if results is not None:  # else its worker has gone since, and with it the rows
                for result in results:
                    self._wall = self._wall + float(result.row["wall_s"] or 0.0)
                    self._made = self._made + 1
                    self._folder.add(result)
                self._running.pop(future)
        for future in futures:
            if future in self._running:
                self._judge(future, self._running.pop(future))

    def _judge(self, future: Any, chunk: Sequence[int]) -> None:
        """Deal with a task that gave no rows: of several runs each is tried alone, and a single one
        that ended its processes becomes a row.
        """
        if future.status == "error":
            error = future.exception()
        else:
            error = None
        if error is None or len(chunk) > 1:
            self._require_cluster()
            self._alone.extend(chunk)
        elif (
            isinstance(error, dask().KilledWorker)
            and not self._exclusive
            and chunk[0] not in self._tried
        ):
            self._tried.add(chunk[0])
            self._suspects.append(chunk[0])
        else:
            outcome = KILLED if isinstance(error, dask().KilledWorker) else ERROR
            if outcome == KILLED:
                text = f"the process of the run ended: {error}"
            else:
                text = f"{type(error).__name__}: {error}"
            self._folder.add(RunResult(row=failed_row(self._work, chunk[0], outcome, text)))

    def _give_up(self) -> None:
        """Runs that did not end in their time, nor when they were told to: their processes end just
        now.
        """
        while not self._overdue.empty():
            _, overdue = self._overdue.get_nowait()
            for future, chunk in list(self._running.items()):
                if overdue["run"] in chunk:
                    self._running.pop(future)
                    self._client.cancel([future], force=True)
                    self._alone.extend(run for run in chunk if run != overdue["run"])
                    self._folder.add(
                        RunResult(
                            row=failed_row(
                                self._work, overdue["run"], TIME_LIMIT, over_time(self._limit)
                            )
                        )
                    )

    def _require_cluster(self) -> None:
        if self._client.status not in ("running", "connecting"):
            raise OutputError(
                "the Dask scheduler is gone; start it, then give the same command again to go on"
            )

    def _stop(self) -> None:
        """Nothing of ours stays on the cluster."""
        with suppress(
            OSError, ValueError, RuntimeError, TimeoutError
        ):  # a cluster that is gone keeps nothing
            self._client.cancel(list(self._running), force=True)
            self._running.clear()
            self._client.unregister_worker_plugin(self._name)
            self._client.unsubscribe_topic(self._name)
