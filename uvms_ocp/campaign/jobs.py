"""Jobs of a campaign: run k on any machine with its time limit, its metrics, and a row whatever
goes wrong.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from threading import TIMEOUT_MAX as THREADS_WAIT
from time import perf_counter
from typing import Any, Protocol

from uvms_ocp.campaign.time_limit import OverTime, time_limit
from uvms_ocp.errors import plain_line
from uvms_ocp.version import __version__

Row = Mapping[str, Any]
"""Row of a campaign's table, by the names of its columns."""
COMPLETED = "completed"
ERROR = "error"
KILLED = "killed"
TIME_LIMIT = "time limit"
"""Outcomes: success, an exception, the end of the process, no end in the time allowed. Other
outcomes are those of missions.
"""
FIRST: Mapping[str, type] = {"run": int}
"""Columns of every campaign before those of its job."""
LAST: Mapping[str, type] = {
    "outcome": str,
    "success": bool,
    "cause": str,
    "wall_s": float,
    "worker": str,
    "version": str,
}
"""Columns of every campaign after those of its job."""
VARYING = ("wall_s", "worker")
"""Columns that differ when a run is repeated."""
_LONGEST = 2000  # characters of a cause


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RunResult:
    """Result of a run."""

    row: Row
    """Row with the job's own columns, outcome and cause."""
    attachment: bytes = b""
    """File to keep as bytes, such as the record; empty for none."""


class CampaignJob(Protocol):
    """Work of which a campaign makes runs by their numbers; it is sent to other processes by cloudpickle."""

    @property
    def columns(self) -> Mapping[str, type]:
        """Columns of the job with their types: int, float, str or bool."""

    def head(self, run: int) -> Row:
        """Return the columns that are known before a run is made."""

    def make(self, run: int) -> RunResult:
        """Make a run."""


def columns_of(work: CampaignJob) -> dict[str, type]:
    """Return all columns of its table, in their order."""
    return {**FIRST, **work.columns, **LAST}


def attempt_job(
    work: CampaignJob,
    run: int,
    worker: str,
    limit: float = THREADS_WAIT,
    stuck: Callable[[], None] = lambda: None,
) -> RunResult:
    """Run a job and return its whole row; an exception becomes one too, with its text, and so does
    the end of the time `limit` [s].

    stuck: called where a run does not end by itself then.
    """
    begin = perf_counter()
    try:
        with time_limit(min(limit, THREADS_WAIT), stuck):
            done = work.make(run)
    except OverTime as error:
        done = RunResult(
            row=failed_row(work, run, TIME_LIMIT, f"{over_time(limit)}{_place(error)}")
        )
    except (Exception, SystemExit) as error:
        done = RunResult(row=failed_row(work, run, ERROR, describe(error)))
    row = {
        "run": run,
        **done.row,
        "wall_s": perf_counter() - begin,
        "worker": worker,
        "version": __version__,
    }
    return RunResult(row=row, attachment=done.attachment)


def failed_row(work: CampaignJob, run: int, outcome: str, text: str) -> dict[str, Any]:
    """Make the row of a run that made none itself."""
    try:
        head = dict(work.head(run))
    except Exception as error:
        head = {}
        text = f"{text}; and its parameters cannot be drawn: {describe(error)}"
    ending = {"outcome": outcome, "success": False, "cause": plain_line(text, _LONGEST)}
    return {"run": run, **head, **ending, "version": __version__}


def over_time(limit: float) -> str:
    """Say why a run was stopped; limit [s]."""
    return f"not over after {limit:g} s, and stopped; give more by the time limit"


def describe(error: BaseException) -> str:
    """Describe an error by class, message and place."""
    return f"{type(error).__name__}: {error}{_place(error)}"


def _place(error: BaseException) -> str:
    """Return file and line of the innermost call."""
    frames = traceback.extract_tb(error.__traceback__)
    if frames:
        return f" ({frames[-1].filename.rpartition('/')[2]}:{frames[-1].lineno})"
    return ""
