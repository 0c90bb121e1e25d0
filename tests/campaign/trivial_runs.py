"""Runs that take no time, raise or end their process; and a Dask cluster of real processes over
TCP.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from campaigns import trivial

from uvms_ocp.campaign.jobs import CampaignJob, RunResult
from uvms_ocp.campaign.manifest import CampaignManifest


@dataclass(frozen=True, kw_only=True)
class TrivialRuns(trivial.Trivial):
    """Some of which never end well."""

    pause: float = 0.0
    deadly: frozenset[int] = frozenset()
    broken: frozenset[int] = frozenset()
    endless: frozenset[int] = frozenset()
    asleep: frozenset[int] = frozenset()
    kept: bool = False

    def make(self, run: int) -> RunResult:
        time.sleep(self.pause)
        if run in self.deadly:
            os._exit(1)
        while run in self.endless:
            pass
        if run in self.asleep:
            time.sleep(3600.0)
        if run in self.broken:
            raise ValueError(f"run {run} was\nnever to be")
        return replace(super().make(run), attachment=b"whole" if self.kept else b"")


def identity_of(work: CampaignJob, runs: int, **changes: object) -> CampaignManifest:
    return trivial.identity_of(work, runs).model_copy(update=changes)


@dataclass
class Cluster:
    """Scheduler and workers, each a process of its own."""

    address: str
    workers: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def add_worker(self) -> None:
        words = [
            "-m",
            "distributed.cli.dask_worker",
            self.address,
            "--nthreads",
            "1",
            "--no-dashboard",
        ]
        self.workers.append(_started([*words, "--no-nanny"]))


def _started(words: list[str]) -> subprocess.Popen[bytes]:
    search_path = os.pathsep.join(sys.path)  # where workers find this module and that of its runs
    quick_to_blame = {
        "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0"
    }  # whatever was on a worker that ended
    environment = os.environ | {"PYTHONPATH": search_path} | quick_to_blame
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    return subprocess.Popen([sys.executable, *words], env=environment, **quiet)


@contextmanager
def cluster(folder: Path, workers: int = 2) -> Iterator[Cluster]:
    """Over TCP, with an address; everything ends with the block."""
    file = folder / "scheduler.json"
    words = [
        "-m",
        "distributed.cli.dask_scheduler",
        "--host",
        "127.0.0.1",
        "--port",
        "0",
        "--no-dashboard",
    ]
    scheduler = _started([*words, "--scheduler-file", str(file)])
    processes = [scheduler]
    try:
        started = Cluster(address=_address(file, scheduler))
        processes = started.workers
        for _ in range(workers):
            started.add_worker()
        yield started
    finally:
        for process in {*processes, scheduler}:
            process.kill()
            process.wait()


def _address(file: Path, scheduler: subprocess.Popen[bytes]) -> str:
    for _ in range(600):
        assert scheduler.poll() is None, "the scheduler has ended"
        if file.exists() and file.stat().st_size:
            return str(json.loads(file.read_text())["address"])
        time.sleep(0.1)
    raise AssertionError("no scheduler after a minute")
