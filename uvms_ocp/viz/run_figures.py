"""All figures of one run or plan, read from its `Record` alone.

Each ``figure_*`` returns a Matplotlib figure, or `None` where the record lacks what it shows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypeAlias, overload

from matplotlib.figure import Figure

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput
from uvms_ocp.ocp.plan import Plan
from uvms_ocp.record.record import Record
from uvms_ocp.viz import layout, style, task_figures as tasks
from uvms_ocp.viz.effort_figures import figure_efforts, figure_tracking
from uvms_ocp.viz.estimate_figures import figure_estimate
from uvms_ocp.viz.health_figures import figure_health
from uvms_ocp.viz.motion_figures import figure_joints, figure_velocities
from uvms_ocp.viz.path_figures import figure_path
from uvms_ocp.viz.plan_figures import PLAN_FIGURES
from uvms_ocp.viz.series import require_rows
from uvms_ocp.viz.several_runs import figure_several_runs
from uvms_ocp.viz.thinning import thinned
from uvms_ocp.viz.timing_figures import figure_tick_time

_OF_ERRORS = (
    tasks.figure_errors,
    tasks.figure_misalignment,
    tasks.figure_altitude,
    tasks.figure_tool_error,
)

Format = Literal["png", "pdf", "svg"]

_Names = str | Sequence[str]
Runs: TypeAlias = Sequence[Plan | Record] | Mapping[str, Plan | Record | Sequence[Plan | Record]]
"""Several runs or plans: a list, or by name, each of them one or a list."""

_OF_MOTION = (
    figure_velocities,
    figure_joints,
    figure_path,
    figure_efforts,
    figure_tracking,
    figure_estimate,
)
_ALL = (
    *_OF_ERRORS,
    tasks.figure_activations,
    tasks.figure_quantities,
    *_OF_MOTION,
    figure_health,
    figure_tick_time,
)
FIGURES: Mapping[str, Callable[..., Figure | None]] = style.by_name(_ALL)


@checked
def write_figures(
    record: Record, folder: Path | str, format: Format = "png", *, width: layout.Width = "page"
) -> tuple[Path, ...]:
    """Write every figure that the record can fill as ``folder/<name>.png``, or in another format;
    returns the paths written.

    width: of a page or a column of a journal, or [in]. Raises `InvalidInput` for a record with
    fewer than two rows and `OutputError` where the folder cannot be written.
    """
    require_rows(record)
    record = thinned(record)
    paths = (write_figure(record, name, folder, format, width) for name in FIGURES)
    return tuple(path for path in paths if path is not None)


def write_figure(
    record: Record,
    name: str,
    folder: Path | str,
    format: Format = "png",
    width: layout.Width = "page",
) -> Path | None:
    """Write one of `FIGURES`, or of a plan's; `None` where the record cannot fill it. Raises
    `InvalidInput` for a record with fewer than two rows and `OutputError` where the folder cannot
    be written.
    """
    figure = {**PLAN_FIGURES, **FIGURES}[name](record, width=width)
    if figure is None:
        return None
    return style.save_figure(figure, Path(folder) / f"{name}.{format}")


@overload
def plot(
    what: Plan | Record,
    name: _Names,
    /,
    *names: _Names,
    differences: Literal[False] = False,
    ax: style.Panels = None,
    fig: style.Canvas = None,
    width: layout.Width = "page",
) -> Figure: ...
@overload
def plot(what: Plan | Record, *, width: layout.Width = "page") -> style.Figures: ...
@overload
def plot(
    what: Runs,
    *names: _Names,
    differences: bool = False,
    ax: style.Panels = None,
    fig: style.Canvas = None,
    width: layout.Width = "page",
) -> Figure: ...
@checked
def plot(
    what: Plan | Record | Runs,
    *names: _Names,
    differences: bool = False,
    ax: style.Panels = None,
    fig: style.Canvas = None,
    width: layout.Width = "page",
) -> Figure | style.Figures:
    """Draw every figure that a run or a plan can fill, or one with a panel for each of the names;
    of several runs, one figure with all of them in the same panels.

    what: a run or a plan, a list of them, or several by name, such as ``{"strict": a, "iCAT": b}``;
    a list in place of one of those is drawn as a median and a band. names: quantities such as
    ``T.position_error``, series such as ``thrust``, columns such as ``q.z``, or lists of them; see
    `figure_of` and `figure_several_runs`, which tell what they raise. Raises `InvalidInput` for
    what is no name, and for differences of a single run. differences: of each run to the first. ax,
    fig: axes of the caller's, one for each name, or a figure or subfigure, drawn on in the caller's
    style; by default a figure of our own, of the width of a page or a column of a journal, or [in].
    """
    if differences and isinstance(what, Plan | Record):
        what = [what]  # which is refused as a list of one
    if not isinstance(what, Plan | Record):
        if not what:
            raise InvalidInput(f"what = {what}; give a run or a plan, or one or more of them")
        return figure_several_runs(
            _records_by_name(what),
            *_flattened(names, allows_none=True),
            differences=differences,
            ax=ax,
            fig=fig,
            width=width,
        )
    record = _thinned_record(what)
    if names or ax is not None or fig is not None:
        return tasks.figure_of(record, *_flattened(names), ax=ax, fig=fig, width=width)
    draws = PLAN_FIGURES if record.meta.kind == "plan" else FIGURES
    figures = [draw(record, width=width) for draw in draws.values()]
    return style.Figures(figure for figure in figures if figure is not None)


def _thinned_record(what: Plan | Record) -> Record:
    """Return the record of a run or a plan, thinned where it is very long."""
    if isinstance(what, Record):
        return thinned(what)
    return thinned(what.to_record())


def _records_by_name(runs: Runs) -> dict[str, Record | list[Record]]:
    """Return records by the names that legends show: ``run 1``, ... where there are none."""
    if not isinstance(runs, Mapping):
        return {f"run {k}": _thinned_record(run) for k, run in enumerate(runs, start=1)}
    records = dict[str, Record | list[Record]]()
    for name, run in runs.items():
        if isinstance(run, Plan | Record):
            records[name] = _thinned_record(run)
        else:
            records[name] = [_thinned_record(part) for part in run]
    return records


def _flattened(names: Sequence[_Names], *, allows_none: bool = False) -> list[str]:
    """Return the names one by one. Raises `InvalidInput` for what is no name, and for no names
    unless they may be left out.
    """
    flat_names = list[Any]()
    for name in names:
        if isinstance(name, tuple | list):
            flat_names += name
        else:
            flat_names.append(name)
    wrong = [repr(item) for item in flat_names if not isinstance(item, str)]
    if wrong or not (flat_names or allows_none):
        raise InvalidInput(
            f"plot of {', '.join(wrong) or 'no name on ax or fig'}; give names such as 'q',"
            " 'T.position_error'"
        )
    return flat_names
