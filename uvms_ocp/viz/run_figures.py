"""Figures of estimate, sensor health and computation time, and all figures of one run or plan.

Each ``figure_*`` returns a Matplotlib figure, or `None` where the record lacks what it shows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypeAlias, overload

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput
from uvms_ocp.ocp.plan import Plan
from uvms_ocp.record.record import Record
from uvms_ocp.record.run_meta import joint_errors
from uvms_ocp.viz import style, task_figures as tasks
from uvms_ocp.viz.motion_figures import (
    figure_efforts,
    figure_joints,
    figure_path,
    figure_tracking,
    figure_velocities,
)
from uvms_ocp.viz.plan_figures import PLAN_FIGURES
from uvms_ocp.viz.series import (
    axis_label,
    axis_names,
    has_vehicle,
    intervals_of,
    phase_spans,
    require_rows,
    thinned,
)
from uvms_ocp.viz.several_runs import figure_several_runs

# How well the estimator knew where the robot was, and how well it said so.

_SHOWN = 98.0  # [%] of the ticks whose bands fit; before the first readings they are endless

_VEHICLE = (("position", "q"), ("attitude", "q_std"))
_Panel = tuple[str, Sequence[str], Sequence[str], np.ndarray, np.ndarray]

_COLORS = {"good": style.GREEN, "suspect": style.ORANGE, "lost": style.VERMILLION}
_MOST_WORDS = 8  # alarms written below the bars
_HEIGHT = 0.62  # of a bar, of the space of a channel
_LINE = 0.17  # [in] of text

_OF_ERRORS = (
    tasks.figure_errors,
    tasks.figure_misalignment,
    tasks.figure_altitude,
    tasks.figure_tool_error,
)

Format = Literal["png", "pdf", "svg"]

_Names = str | Sequence[str]
Runs: TypeAlias = Sequence[Plan | Record] | Mapping[str, Plan | Record | Sequence[Plan | Record]]


@style.styled
def figure_estimate(
    record: Record, *, fig: style.Given = None, width: style.Width = "page"
) -> Figure | None:
    """Draw errors of position, attitude and joints, estimate less truth, within two standard
    deviations that the filter gives.
    """
    if {"q", "q_estimated", "q_std"} <= record.series.keys():
        panels = _panels(record)
    else:
        panels = []
    if not panels:
        return None
    figure, axes = style.stacked(
        len(panels), 1.5, "Estimate less truth, and two standard deviations", fig, width
    )
    for axis, (label, names, colors, errors, spreads) in zip(axes, panels, strict=True):
        _draw(axis, record["t"], names, colors, errors, spreads)
        axis.set_ylabel(label)
    style.shade_phases(axes, phase_spans(record))
    return figure


def _panels(record: Record) -> list[_Panel]:
    q = record["q"]
    measured = record["q_estimated"]
    spread = record["q_std"]
    panels: list[_Panel] = []
    if has_vehicle(record):
        position, attitude = (axis_label(subject, name, subject, "m") for subject, name in _VEHICLE)
        place = 1e3 * (measured - q)[:, :3]
        turn = 1e3 * _turns(q[:, 3:7], measured[:, 3:7])
        panels = [
            (position, ("x", "y", "z"), style.AXES_XYZ, place, 1e3 * spread[:, :3]),
            (attitude, ("roll", "pitch", "yaw"), style.AXES_XYZ, turn, 1e3 * spread[:, 3:6]),
        ]
    errors = joint_errors(record.series, record.meta)
    n = 0 if errors is None else errors.shape[1]
    if n and spread.shape[1] >= n:
        names = style.label_texts(axis_names(record, n), 10)
        colors = [style.LINES[i % len(style.LINES)] for i in range(n)]
        panels.append(
            (
                axis_label("joints", "q", "joints", "m", record.meta),
                names,
                colors,
                1e3 * errors,
                1e3 * spread[:, -n:],
            )
        )
    return panels


def _turns(true: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Return (n, 3) [rad], the small rotation in B from the true attitude to the measured one;
    quaternions (n, 4) xyzw.
    """
    v = true[:, :3]
    w = true[:, 3:]
    vm = measured[:, :3]
    wm = measured[:, 3:]
    vector = w * vm - wm * v - np.cross(v, vm)
    scalar = w * wm + (v * vm).sum(axis=1, keepdims=True)
    return np.asarray(2.0 * np.sign(scalar) * vector)


def _draw(
    axis: Axes,
    t: np.ndarray,
    names: Sequence[str],
    colors: Sequence[str],
    errors: np.ndarray,
    spreads: np.ndarray,
) -> None:
    for i, (name, color) in enumerate(zip(names, colors, strict=True)):
        axis.plot(t, errors[:, i], color=color, lw=0.9, label=name)
        for sign in (-2.0, 2.0):
            axis.plot(t, sign * spreads[:, i], color=color, lw=0.6, ls=":")
    largest = max(
        float(np.percentile(2.0 * spreads, _SHOWN)),
        float(np.percentile(np.abs(errors), _SHOWN)),
        1e-9,
    )
    axis.set_ylim(-1.2 * largest, 1.2 * largest)
    style.legend_beside(axis)


# Figure of how far each sensor could be trusted.


@style.styled
def figure_health(
    record: Record, *, fig: style.Given = None, width: style.Width = "page"
) -> Figure | None:
    """Draw one bar over time per channel, green where it was good, and below the bars what was said
    against channels.
    """
    if record.meta.kind != "run" or "health" not in record.series or not record.meta.channels:
        return None
    t = record["t"]
    names = record.meta.channels
    alarms = _alarm_lines(record)
    figure = style.titled(
        1.0 + 0.26 * len(names) + _LINE * len(alarms), "Health of the sensors", fig, width
    )
    axis = figure.subplots()
    for row, codes in enumerate(record["health"].T):
        # A piece for every stay in one state.
        for code, color in enumerate(_COLORS.values()):
            pieces = [(t[i], t[j] - t[i]) for i, j, state in intervals_of(codes) if state == code]
            axis.broken_barh(pieces, (row - _HEIGHT / 2, _HEIGHT), facecolors=color, lw=0)
    axis.set_yticks(range(len(names)), [style.label_text(name) for name in names])
    axis.set_ylim(len(names) - 0.5, -0.5)
    axis.grid(visible=False, axis="y")
    axis.set_xlabel(axis_label("time", "t"))
    if alarms:
        figure.supxlabel("\n".join(alarms), x=0.01, ha="left", fontsize=style.points(7))
    style.shade_phases([axis], phase_spans(record), letters_beside=12)
    patches = [Patch(color=color, label=name) for name, color in _COLORS.items()]
    figure.legend(handles=patches, loc="outside upper right", ncols=len(patches))
    return figure


def _alarm_lines(record: Record) -> list[str]:
    """Return the first alarms on channels, a line each."""
    alarms = [
        alarm
        for alarm in record.run_meta.alarms
        if alarm.text.partition(" ")[0] in record.run_meta.channels
    ]
    lines = [
        style.label_text(f"{alarm.t:.2f} s  {alarm.text}", 110) for alarm in alarms[:_MOST_WORDS]
    ]
    n_more = len(alarms) - len(lines)
    if n_more:
        return [*lines, f"and {n_more} more"]
    return lines


# Figure of the computation time of the control ticks.


@style.styled
def figure_tick_time(
    record: Record, *, fig: style.Given = None, width: style.Width = "page"
) -> Figure | None:
    """Draw how long one control tick took, over time and as a distribution."""
    if "tick_time" not in record.series:
        return None
    tick = np.maximum(record["tick_time"] * 1e6, 1e-3)
    figure = style.titled(2.6, "Computation time of one control tick", fig, width)
    over_time, spread = figure.subplots(1, 2, sharey=True, width_ratios=(3, 1))
    style.logarithmic(over_time)
    over_time.plot(record["t"], tick, ".", ms=1.4, color=style.BLUE, rasterized=True)
    over_time.set(
        xlabel=axis_label("time", "t"), ylabel=axis_label("tick", "tick_time", prefix="µ")
    )
    period = 1e6 * record.run_meta.dt
    edges = np.geomspace(tick.min(), tick.max() * 1.01, 50)
    spread.hist(tick, bins=edges, orientation="horizontal", histtype="stepfilled", color=style.BLUE)
    spread.set_xlabel("ticks")
    lines = []
    for share, color in ((50, style.BLACK), (99, style.VERMILLION)):
        value = float(np.percentile(tick, share))
        label = f"p{share}  {value:.0f} µs"
        lines += [
            axis.axhline(value, color=color, lw=0.9, ls="--", label=label)
            for axis in (over_time, spread)
        ][1:]
    style.threshold(over_time, period, "control period")
    over_time.set_ylim(
        top=3.0 * max(period, float(tick.max()))
    )  # room for its name below those of the phases
    style.heading_legend(figure, lines)
    style.mark_time([over_time], record)
    return figure


# All figures of one run or plan, read from its `Record` alone.
#
# Each ``figure_*`` returns a Matplotlib figure, or `None` where the record lacks what it shows.

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
    record: Record, folder: Path | str, format: Format = "png", *, width: style.Width = "page"
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
    width: style.Width = "page",
) -> Path | None:
    """Write one of `FIGURES`, or of a plan's; `None` where the record cannot fill it. Raises as
    `write_figures`.
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
    fig: style.Given = None,
    width: style.Width = "page",
) -> Figure: ...
@overload
def plot(what: Plan | Record, *, width: style.Width = "page") -> style.Figures: ...
@overload
def plot(
    what: Runs,
    *names: _Names,
    differences: bool = False,
    ax: style.Panels = None,
    fig: style.Given = None,
    width: style.Width = "page",
) -> Figure: ...
@checked
def plot(
    what: Plan | Record | Runs,
    *names: _Names,
    differences: bool = False,
    ax: style.Panels = None,
    fig: style.Given = None,
    width: style.Width = "page",
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
    if differences:
        raise InvalidInput("differences of one run; give two or more, the first is what counts")
    record = _thinned_record(what)
    if names or ax is not None or fig is not None:
        return tasks.figure_of(record, *_flattened(names), ax=ax, fig=fig, width=width)
    draws = PLAN_FIGURES if record.meta.kind == "plan" else FIGURES
    figures = [draw(record, width=width) for draw in draws.values()]
    return style.Figures(figure for figure in figures if figure is not None)


def _thinned_record(what: Plan | Record) -> Record:
    """Return what is drawn of a run or a plan."""
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
