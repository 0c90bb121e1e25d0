"""What a campaign runs: something that makes a row of a number, on any machine, and a row of whatever goes wrong."""

from __future__ import annotations

import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from time import perf_counter
from typing import Any, Protocol

from uvms_ocp.exceptions import plain_line
from uvms_ocp.version import __version__

Row = Mapping[str, Any]
COMPLETED, ERROR, KILLED = "completed", "error", "killed"
"""Outcomes: success, an exception, the end of the process. Other outcomes are those of missions."""
FIRST: Mapping[str, type] = {"run": int}
LAST: Mapping[str, type] = {
    "outcome": str,
    "success": bool,
    "cause": str,
    "wall_s": float,
    "worker": str,
    "version": str,
}
"""Columns of every campaign, before and after its own."""
VARYING = ("wall_s", "worker")
"""Columns that differ when a run is repeated."""
_LONGEST = 2000  # characters of a cause


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Done:
    """What became of a run."""

    row: Row
    """Its own columns, outcome and cause."""
    attachment: bytes = b""
    """A file to keep, such as the record."""


class Work(Protocol):
    """Goes to other processes as it is, by cloudpickle."""

    @property
    def columns(self) -> Mapping[str, type]:
        """Its own, with the type of their values: int, float, str or bool."""

    def head(self, run: int) -> Row:
        """What is known of a run [-] before it is made."""

    def make(self, run: int) -> Done:
        """Make a run [-]."""


def columns_of(work: Work) -> dict[str, type]:
    """All columns of its table, in their order."""
    return {**FIRST, **work.columns, **LAST}


def attempted(work: Work, run: int, worker: str) -> Done:
    """The whole row of a run [-]; an exception is one too, with its text."""
    begin = perf_counter()
    try:
        done = work.make(run)
    except (Exception, SystemExit) as error:
        done = Done(row=failed_row(work, run, ERROR, _told(error)))
    wall = perf_counter() - begin
    row = {"run": run, **done.row, "wall_s": wall, "worker": worker, "version": __version__}
    return Done(row=row, attachment=done.attachment)


def failed_row(work: Work, run: int, outcome: str, text: str) -> dict[str, Any]:
    """Of a run [-] that made none itself."""
    try:
        head = dict(work.head(run))
    except Exception as error:
        head, text = {}, f"{text}; and its parameters cannot be drawn: {_told(error)}"
    own = {"outcome": outcome, "success": False, "cause": plain_line(text, _LONGEST)}
    return {"run": run, **head, **own, "version": __version__}


def _told(error: BaseException) -> str:
    """Class, message and place, of the innermost call."""
    frames = traceback.extract_tb(error.__traceback__)
    place = f" ({frames[-1].filename.rpartition('/')[2]}:{frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {error}{place}"
