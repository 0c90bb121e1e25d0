"""Jobs of a campaign: run k on any machine with its time limit, its metrics, and a row whatever
goes wrong.
"""

from __future__ import annotations

import csv
import ctypes
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.resources import files
from threading import TIMEOUT_MAX as THREADS_WAIT
from time import perf_counter
from typing import Any, Protocol

import numpy as np

from uvms_ocp.errors import plain_line
from uvms_ocp.record.record import Record, quantity
from uvms_ocp.report import metrics
from uvms_ocp.robot.robot import Robot
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim.environment import closest_approach
from uvms_ocp.version import __version__

# An end for runs that find none.

GRACE = 3.0
"""[s] that Python has to leave a run whose time is over; what is deeper, in a call that does not
come back, is ended.
"""


_WAITS = 50  # [ms] in which an interrupt that is on its way arrives


class OverTime(BaseException):
    """The time of a run is over. No `Exception`, so that whatever a run catches lets it through."""


@contextmanager
def time_limit(seconds: float, stuck: Callable[[], None]) -> Iterator[None]:
    """Raise `OverTime` in the block after so many seconds [s], wherever it is; stuck: called where
    it does not get there.

    It comes between two steps of Python, so that a single call that never returns, such as a sleep,
    is for `stuck`.
    """
    watch = _Watch(threading.get_ident(), stuck)
    timer = threading.Timer(seconds, watch.end)
    timer.daemon = True
    try:
        timer.start()
        yield
    finally:
        try:
            timer.cancel()
        finally:
            watch.leave()


class _Watch:
    """Watchdog of one run in one thread."""

    def __init__(self, thread: int, stuck: Callable[[], None]) -> None:
        self._thread = thread
        self._stuck = stuck
        self._lock = threading.Lock()
        self._left = threading.Event()
        self._fired = False

    def end(self) -> None:
        """Interrupt the run, unless it has ended."""
        with self._lock:
            if self._left.is_set():
                return
            self._fired = True
            ctypes.pythonapi.PyThreadState_SetAsyncExc(
                ctypes.c_ulong(self._thread), ctypes.py_object(OverTime)
            )
        if not self._left.wait(GRACE):
            self._stuck()

    def leave(self) -> None:
        """The run has ended; an interrupt on its way arrives here, and not in the next run."""
        try:
            with self._lock:
                self._left.set()
            for _ in range(
                _WAITS if self._fired and not isinstance(sys.exc_info()[1], OverTime) else 0
            ):
                time.sleep(0.001)
        finally:
            self._left.set()


# What a campaign runs: something that makes a row of a number, on any machine, and a row of
# whatever goes wrong.

Row = Mapping[str, Any]
COMPLETED = "completed"
ERROR = "error"
KILLED = "killed"
TIME_LIMIT = "time limit"
"""Outcomes: success, an exception, the end of the process, no end in the time allowed. Other
outcomes are those of missions.
"""
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
class RunResult:
    """Result of a run."""

    row: Row
    """Row with the job's own columns, outcome and cause."""
    attachment: bytes = b""
    """A file to keep, such as the record."""


class CampaignJob(Protocol):
    """Goes to other processes as it is, by cloudpickle."""

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
    """The whole row of a run; an exception is one too, with its text, and the end of the time
    `limit` [s].

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
    own = {"outcome": outcome, "success": False, "cause": plain_line(text, _LONGEST)}
    return {"run": run, **head, **own, "version": __version__}


def over_time(limit: float) -> str:
    """Why a run was stopped; limit [s]."""
    return f"not over after {limit:g} s, and stopped; give more by the time limit"


def describe(error: BaseException) -> str:
    """Class, message and place."""
    return f"{type(error).__name__}: {error}{_place(error)}"


def _place(error: BaseException) -> str:
    """Return file and line of the innermost call."""
    frames = traceback.extract_tb(error.__traceback__)
    if frames:
        return f" ({frames[-1].filename.rpartition('/')[2]}:{frames[-1].lineno})"
    return ""


# Figures of merit of one run, a number each: what a campaign has distributions of.

_TABLE = (files("uvms_ocp.campaign") / "metrics.csv").read_text(encoding="utf-8").splitlines()
METRICS: Mapping[str, str] = {row["metric"]: row["meaning"] for row in csv.DictReader(_TABLE)}
"""Metrics of a run, with unit and meaning."""
OF_EACH_TOOL = ("tool_position_error_m", "tool_orientation_error_rad", "clearance_m")
"""Those that a robot with several tools has of each, such as ``clearance_m[port_tool]``, that of
its arm.
"""
_FROM_REPORT = (
    "energy_j",
    "path_length_m",
    "joint_margin_rad",
    "joint_margin_m",
    "saturation_time_s",
    "peak_thrust_n",
)
_LOOKS = 200  # configurations at which the clearance is measured


def tool_metrics(robot: Robot) -> dict[str, str]:
    """The tool of each metric that is of one of several; none where there is one tool."""
    return {
        f"{name}[{tool}]": tool
        for tool in robot.tools
        if len(robot.tools) > 1
        for name in OF_EACH_TOOL
    }


def metrics_among(columns: Iterable[str]) -> dict[str, str]:
    """`METRICS`, and those of tools among the columns of a campaign, with their meanings."""
    return {
        **METRICS,
        **{
            name: f"{METRICS[kind]}, of {name}"
            for name in columns
            if name != (kind := kind_of(name)) in METRICS
        },
    }


def kind_of(name: str) -> str:
    """The metric that a column is of, without its tool."""
    return name.partition("[")[0]


def run_metrics(scenario: Scenario, record: Record) -> dict[str, float | None]:
    """Compute the metrics of a run by name, as in `METRICS` and `tool_metrics`; `None` where a run
    has no such figure.
    """
    meta = record.run_meta
    task = record.run_meta.tool_task
    end = float(record["t"][-1])
    spent = metrics.figures_between(record, 0.0, end)
    tilt = quantity(record, "HA.tilt", metrics.extremes_of(record, "quantities")[-1])
    failed = metrics.failed_ticks(record)
    figures = {
        "duration_s": end,
        "tool_position_error_m": meta.true_quantity(f"{task}.position_error"),
        "tool_orientation_error_rad": meta.true_quantity(f"{task}.orientation_error"),
        **{name: spent.get(name) for name in _FROM_REPORT},
        "clearance_m": _clearance(scenario, record, None),
        "min_altimeter_m": metrics.least_altimeter_range(record),
        "tilt_rad": metrics.largest_tilt(record) if tilt is None else metrics.largest_or_none(tilt),
        "alarms": float(len(meta.alarms)),
        "failed_ticks": None if failed is None else float(sum(failed.values())),
    }
    for name, tool in tool_metrics(scenario.robot).items():
        own = next((one.name for one in meta.tasks if one.tool == tool), "")
        error = f"{own}.{kind_of(name).removeprefix('tool_').rpartition('_')[0]}"
        if kind_of(name) == "clearance_m":
            figures[name] = _clearance(scenario, record, tool)
        else:
            figures[name] = meta.true_quantity(error)
    return {
        name: None if figure is None or not np.isfinite(figure) else float(figure)
        for name, figure in figures.items()
    }


def _clearance(scenario: Scenario, record: Record, tool: str | None) -> float | None:
    """Compute the least distance [m] to obstacles along a run, of the whole robot or of the arm
    that moves the tool.
    """
    if not scenario.environment.obstacles:
        return None
    q: Any = record["q"][:: max(1, len(record) // _LOOKS)]
    if not np.isfinite(q).all():
        return None
    if tool is None:
        links = None
    else:
        links = scenario.robot.arm_shapes(tool)
    return closest_approach(
        scenario.robot, scenario.environment, q, floor=False, links=links
    ).distance


# Distributions of figures of merit.

QUANTILES = (0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0)
_NAMES = ("least", "5 %", "25 %", "median", "75 %", "95 %", "largest")


def metric_values(table: Any, name: str) -> np.ndarray:
    """(n,) [unit of the merit] of all runs, NaN where one has none, as in a campaign of a version
    without that merit.
    """
    return np.asarray(table.reindex(columns=[name])[name].to_numpy(dtype=float, na_value=np.nan))


def distribution_table(table: Any) -> list[dict[str, Any]]:
    """One row per figure that some run has: quantiles over the runs that have it, failed ones
    too.
    """
    rows = []
    for name, meaning in metrics_among(table).items():
        values = metric_values(table, name)
        known = values[np.isfinite(values)]
        if known.size:
            spread = dict(zip(_NAMES, map(float, np.quantile(known, QUANTILES)), strict=True))
            rows.append({"figure": name, "meaning": meaning, "runs": int(known.size), **spread})
    return rows
