"""Dispatch runs to the workers of a cluster and collect their rows, a bounded number at a time; runs
of workers that die are made again or become rows of failures.
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
_TASKS_PER_THREAD = 3  # tasks that are sent for every thread of the cluster
_TASK_DURATION = 0.3  # [s] that a task of several short runs takes
_MAX_RUNS = 50  # largest number of runs in a task
_POLL_PERIOD = 0.5  # [s] between two checks that the cluster is there
_WITHOUT_WORKERS = 60.0  # [s] without any worker, after which it is logged

_log = logging.getLogger(__name__)


class JobPlugin(WorkerPlugin):
    """Plugin that carries the job of a campaign to every worker as it joins."""

    def __init__(self, name: str, work: CampaignJob) -> None:
        """name: name of the campaign, by which `make_runs` finds the plugin."""
        self.name = name
        self.work = work

    def setup(self, worker: Any) -> None:
        """Silence warnings of runs: what matters of them is in their rows."""
        logging.getLogger("uvms_ocp").setLevel(logging.ERROR)


def make_runs(name: str, runs: Sequence[int], limit: float) -> list[RunResult]:
    """Make runs of a campaign on a worker, one after the other; name: name of the campaign's plugin;
    limit [s]: time limit of each run.
    """
    worker = get_worker()
    work: CampaignJob = worker.plugins[name].work
    place = f"{worker.address} {os.getpid()}"
    return [attempt_job(work, run, place, limit, partial(_end, worker, name, run)) for run in runs]


def _end(worker: Any, name: str, run: int) -> None:
    """End this process, whose run is in a call that does not return, after informing the dispatcher."""
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
        """client: a ``distributed.Client``. limit [s]: time limit of a run. exclusive: True where a
        worker makes one run at a time, so that a run whose worker dies is itself the cause.
        """
        self._client = client
        self._work = work
        self._folder = folder
        self._name = f"runs-{uuid4().hex}"
        self._limit = limit
        self._exclusive = exclusive
        self._running: dict[Any, Sequence[int]] = {}
        """Runs of each task on the cluster, by its future."""
        self._arrived: queue.SimpleQueue[Any] = queue.SimpleQueue()
        """Futures that are done."""
        self._overdue: queue.SimpleQueue[Any] = queue.SimpleQueue()
        """Events of runs that did not end in their time."""
        self._single_runs = deque[int]()
        """Runs to be made in a task each, as a task of theirs failed."""
        self._suspects = deque[int]()
        """Runs to be made with nothing beside them, as their worker died."""
        self._tried = set[int]()
        """Runs that have been suspects."""
        self._total_wall_time = 0.0
        """[s] time of all runs made, by which the size of tasks is chosen."""
        self._n_made = 0
        self._without_workers_since: float | None = None
        """[s] time at which the cluster lost its last worker."""

    def run(self, runs: Iterable[int], progress: Any) -> None:
        """Make all of these runs; progress: called without arguments whenever rows have come.

        Raises `OutputError` where the cluster is lost. Rows that had come by then are in the folder,
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
        """Send tasks until every thread of the cluster has some ahead."""
        if self._running:
            workers = self._client.scheduler_info(n_workers=-1)["workers"].values()
            counts = [worker["nthreads"] for worker in workers]
        else:
            counts = self._client.nthreads().values()
        n_threads = max(1, sum(counts))
        while len(self._running) < _TASKS_PER_THREAD * n_threads:
            chunk = self._next(todo)
            if not chunk:
                break
            self._send(chunk)
        if self._suspects and not self._running:
            self._send([self._suspects.popleft()])  # with nothing beside it

    def _next(self, todo: Any) -> list[int]:
        """Return the runs of the next task: those whose task failed one by one, others together as
        far as they are short.
        """
        if self._single_runs:
            return [self._single_runs.popleft()]
        mean_time = _TASK_DURATION
        if self._n_made:
            mean_time = self._total_wall_time / self._n_made
        size = max(1, int(_TASK_DURATION / max(mean_time, 1e-6)))
        return [int(run) for run in islice(todo, min(_MAX_RUNS, size))]

    def _send(self, chunk: list[int]) -> None:
        """Send a task with a chunk of runs to the cluster."""
        key = (self._name, chunk[0], uuid4().hex)
        future = self._client.submit(make_runs, self._name, chunk, self._limit, key=key, pure=False)
        self._running[future] = chunk
        future.add_done_callback(self._arrived.put)

    def _wait(self) -> list[Any]:
        """Return futures that are done; none where `_POLL_PERIOD` passes without any."""
        done_futures = []
        with suppress(queue.Empty):
            done_futures.append(self._arrived.get(timeout=_POLL_PERIOD))
            while True:
                done_futures.append(self._arrived.get_nowait())
        if not done_futures:
            self._require_cluster()
            self._warn_of_no_workers()
        return done_futures

    def _warn_of_no_workers(self) -> None:
        """Warn once of a cluster without workers, which may still be waiting for its machines."""
        if self._client.nthreads():
            self._without_workers_since = None
        elif self._without_workers_since is None:
            self._without_workers_since = monotonic()
        elif monotonic() - self._without_workers_since > _WITHOUT_WORKERS:
            self._without_workers_since = math.inf
            _log.warning(
                "the cluster has had no worker for %g s; they need this version of uvms_ocp, too",
                _WITHOUT_WORKERS,
            )

    def _take(self, futures: Sequence[Any]) -> None:
        """Keep the rows of tasks that are done, and deal with those that gave none."""
        finished = {future: future for future in futures if future.status == "finished"}
        for future, results in self._client.gather(finished, errors="skip").items():
            if results is None:  # its worker has gone since, and with it the rows
                continue
            for result in results:
                self._total_wall_time += float(result.row["wall_s"] or 0.0)
                self._n_made += 1
                self._folder.add(result)
            self._running.pop(future)
        for future in futures:
            if future in self._running:
                self._judge(future, self._running.pop(future))

    def _judge(self, future: Any, chunk: Sequence[int]) -> None:
        """Deal with a task that gave no rows.

        Several runs get a task each. A single run whose worker died becomes a suspect, and where it
        was one before, or its worker made nothing else, a row of its failure.
        """
        if future.status == "error":
            error = future.exception()
        else:
            error = None
        if error is None or len(chunk) > 1:
            self._require_cluster()
            self._single_runs.extend(chunk)
            return
        run = chunk[0]
        was_killed = isinstance(error, dask().KilledWorker)
        if was_killed and not self._exclusive and run not in self._tried:
            self._tried.add(run)
            self._suspects.append(run)
        elif was_killed:
            self._add_failure(run, KILLED, f"the process of the run ended: {error}")
        else:
            self._add_failure(run, ERROR, f"{type(error).__name__}: {error}")

    def _add_failure(self, run: int, outcome: str, text: str) -> None:
        """Add the row of a run that failed."""
        self._folder.add(RunResult(row=failed_row(self._work, run, outcome, text)))

    def _give_up(self) -> None:
        """Give up runs that did not end in their time, nor when they were interrupted: their
        processes are ending themselves.
        """
        while not self._overdue.empty():
            _, event = self._overdue.get_nowait()
            overdue_run = event["run"]
            for future, chunk in list(self._running.items()):
                if overdue_run not in chunk:
                    continue
                self._running.pop(future)
                self._client.cancel([future], force=True)
                self._single_runs.extend(run for run in chunk if run != overdue_run)
                self._add_failure(overdue_run, TIME_LIMIT, over_time(self._limit))

    def _require_cluster(self) -> None:
        """Raise `OutputError` where the scheduler is gone."""
        if self._client.status not in ("running", "connecting"):
            raise OutputError(
                "the Dask scheduler is gone; start it, then give the same command again to go on"
            )

    def _stop(self) -> None:
        """Remove tasks, plugin and subscription from the cluster; one that is gone keeps nothing."""
        with suppress(OSError, ValueError, RuntimeError, TimeoutError):
            self._client.cancel(list(self._running), force=True)
            self._running.clear()
            self._client.unregister_worker_plugin(self._name)
            self._client.unsubscribe_topic(self._name)
