"""Figures of one run, read from its `Record` alone ([Gao2022] figures 5-9 and what an engineer asks next).

Each ``figure_*`` returns a Matplotlib figure, or `None` where the record lacks what it shows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from uvms_ocp.exceptions import OutputError
from uvms_ocp.record import Record
from uvms_ocp.viz.efforts import figure_efforts, figure_tracking
from uvms_ocp.viz.path import figure_path
from uvms_ocp.viz.series import (
    PhaseSpan,
    has_vehicle,
    joint_limits,
    n_joints,
    phase_spans,
    quantity,
    require_rows,
    task_activity,
    task_gate,
    thresholds,
)
from uvms_ocp.viz.style import (
    AXES_XYZ,
    BLACK,
    BLUE,
    DASHES,
    DPI,
    FADED,
    GREEN,
    LINES,
    ORANGE,
    VERMILLION,
    WIDTH,
    RecordFigure,
    activation_legend,
    heading_legend,
    shade_phases,
    stacked,
    styled,
    threshold,
)
from uvms_ocp.viz.tick_time import figure_tick_time

_LOG_FLOOR = 1e-9  # [m, rad] below this an error is rounding
_ZOOM = 1.0  # [s] on each side of a transition
_MAX_ZOOMS = 4
_LEAST_SPAN = 0.02  # [m/s, rad/s] of a velocity panel


@styled
def figure_errors(record: Record, task: str = "PC") -> Figure | None:
    """Position and orientation error of the vehicle to its way point; faded while the task is off."""
    return _pose_error_figure(record, task, "Vehicle: error to the way point")


@styled
def figure_tool_error(record: Record, task: str | None = None) -> Figure | None:
    """Position and orientation error of the tool; faded while the task is off. `task` is the record's tool task."""
    return _pose_error_figure(record, task or record.meta.get("tool_task") or "T", "Tool: error to its goal")


def _pose_error_figure(record: Record, task: str, title: str) -> Figure | None:
    rows = (
        (f"{task}.position_error", "position error [m]", BLUE),
        (f"{task}.orientation_error", "orientation error [rad]", VERMILLION),
    )
    return _quantity_figure(record, rows, title, _logarithmic_panel)


def _quantity_figure(
    record: Record,
    rows: Sequence[tuple[str, str, str]],
    title: str,
    panel: Callable[[Axes, Record, str, str], None],
) -> Figure | None:
    """One panel per row (quantity, label, colour) that the record has."""
    known = [row for row in rows if quantity(record, row[0]) is not None]
    if not known:
        return None
    figure, axes = stacked(len(known), 1.75, title)
    for axis, (name, label, color) in zip(axes, known, strict=True):
        panel(axis, record, name, color)
        axis.set_ylabel(label)
    shade_phases(axes, phase_spans(record))
    heading_legend(
        figure,
        [Line2D([], [], color=BLACK, label="task active"), Line2D([], [], color=FADED, lw=0.9, label="task off")],
    )
    return figure


def _panel(axis: Axes, record: Record, name: str, color: str) -> np.ndarray:
    """Draw a quantity, faded while its task is off; returns its values (k,) while the task is on."""
    values, on = _required(record, name), _task_on(record, name.split(".")[0])
    axis.plot(record["t"], values, color=color, alpha=0.35, lw=0.9)
    axis.plot(record["t"], np.where(on, values, np.nan), color=color)
    for limit in thresholds(record, name):
        threshold(axis, limit, f"threshold {limit:g}")
    return values[on]


def _task_on(record: Record, task: str) -> np.ndarray:
    gate = task_gate(record, task)
    return np.ones(len(record), dtype=bool) if gate is None else gate > 0


def _logarithmic_panel(axis: Axes, record: Record, name: str, color: str) -> None:
    """Logarithmic, because convergence is exponential; an exact start does not stretch the axis."""
    active = _panel(axis, record, name, color)
    axis.set_yscale("log", nonpositive="mask")
    if len(active):
        lowest = min([*thresholds(record, name), float(np.percentile(active, 5)), float(active[-1])])
        axis.set_ylim(bottom=max(lowest, _LOG_FLOOR) / 2)


def _linear_panel(axis: Axes, record: Record, name: str, color: str) -> None:
    _panel(axis, record, name, color)
    axis.set_ylim(bottom=0)


def _required(record: Record, name: str) -> np.ndarray:
    values = quantity(record, name)
    return np.full(len(record), np.nan) if values is None else values


@styled
def figure_misalignment(record: Record) -> Figure | None:
    """Angle between the vehicle's x axis and the horizontal direction to the target (AT), and tilt (HA)."""
    rows = (("AT.misalignment", "misalignment [rad]", GREEN), ("HA.tilt", "tilt [rad]", ORANGE))
    return _quantity_figure(record, rows, "Vehicle: alignment with the target, and tilt", _linear_panel)


@styled
def figure_altitude(record: Record) -> Figure | None:
    """Altitude above the floor with the thresholds on it, and a closer view of its end."""
    name = next((n for n in ("LA.altitude", "MAC.altitude") if quantity(record, n) is not None), None)
    if name is None:
        return None
    t, altitude = record["t"], _required(record, name)
    figure, axes = stacked(2, 1.75, "Altitude of the altimeter above the floor")
    near = 2.5 * max([*thresholds(record, name), float(np.nanmin(altitude))])
    for axis in axes:
        axis.plot(t, altitude, color=BLUE, label="altitude")
        for limit in thresholds(record, name):
            threshold(axis, limit, f"landed below {limit:g} m")
    lowest = int(np.nanargmin(altitude))
    axes[1].plot(t[lowest], altitude[lowest], "v", color=VERMILLION, ms=5, label=f"lowest: {altitude[lowest]:.3f} m")
    axes[0].set(ylabel="altitude [m]", ylim=(0, None))
    axes[1].set(ylabel="altitude [m], near floor", ylim=(0, near))
    axes[1].legend(loc="lower left")
    shade_phases(axes, phase_spans(record))
    return figure


@styled
def figure_activations(record: Record) -> Figure | None:
    """One small panel per task: activation of its rows (internal bell x phase) under the phase's own activation."""
    tasks = [entry for entry in record.meta.get("tasks", ()) if task_activity(record, entry["name"]) is not None]
    if not tasks:
        return None
    figure, axes = stacked(len(tasks), 0.56, "Activation of the tasks, highest priority on top")
    for axis, entry in zip(axes, tasks, strict=True):
        _activation_panel(axis, record, entry)
    shade_phases(axes, phase_spans(record))
    activation_legend(figure)
    return figure


def _activation_panel(axis: Axes, record: Record, task: Mapping[str, str]) -> None:
    t, rows, gate = record["t"], task_activity(record, task["name"]), task_gate(record, task["name"])
    if rows is None or gate is None:
        return
    axis.fill_between(t, rows.max(axis=1, initial=0.0), color=BLUE, alpha=0.25, lw=0)
    axis.plot(t, rows, color=BLUE, lw=0.8)
    axis.plot(t, gate, color=VERMILLION, lw=0.9, ls="--")
    axis.set(ylim=(-0.08, 1.12), yticks=(0, 1))
    axis.grid(visible=False, axis="y")
    axis.set_ylabel(task["name"], rotation=0, ha="right", va="center", fontweight="bold")
    axis.annotate(
        task["label"], (1.008, 0.5), xycoords="axes fraction", va="center", fontsize=6.5, annotation_clip=False
    )


@styled
def figure_velocities(record: Record) -> Figure | None:
    """Linear and angular velocity of the vehicle in B, whole run and a zoom on every change of phase."""
    if not has_vehicle(record):
        return None
    spans = phase_spans(record)
    changes = [span.start for span in spans[1:]][:_MAX_ZOOMS]
    figure = RecordFigure(figsize=(WIDTH, 3.9 + (2.6 if changes else 0.0)))
    figure.suptitle("Vehicle velocity", fontsize=10, fontweight="bold", x=0.01, ha="left")
    parts = figure.subfigures(2, 1, height_ratios=(3.4, 3.0)) if changes else [figure]
    _whole_run(parts[0], record, spans)
    if changes:
        _zooms(parts[1], record, changes, spans)
    return figure


_VELOCITY_PANELS = (
    (slice(0, 3), "linear [m/s]", ("surge", "sway", "heave")),
    (slice(3, 6), "angular [rad/s]", ("roll", "pitch", "yaw")),
)


def _whole_run(parent: Figure, record: Record, spans: Sequence[PhaseSpan]) -> None:
    axes = parent.subplots(2, 1, sharex=True)
    for axis, (part, label, names) in zip(axes, _VELOCITY_PANELS, strict=True):
        _velocity_lines(axis, record, part, names)
        axis.set_ylabel(label)
        axis.legend(ncols=3, loc="best")
    axes[-1].set_xlabel("time [s]")
    shade_phases(axes, spans)


def _zooms(parent: Figure, record: Record, changes: Sequence[float], spans: Sequence[PhaseSpan]) -> None:
    grid = parent.subplots(2, len(changes), sharex="col", squeeze=False)
    for column, change in enumerate(changes):
        for axis, (part, label, names) in zip(grid[:, column], _VELOCITY_PANELS, strict=True):
            _velocity_lines(axis, record, part, names, around=change)
            shade_phases([axis], spans, named=False)
            axis.set_xlim(change - _ZOOM, change + _ZOOM)
            _keep_span(axis)
            if column == 0:
                axis.set_ylabel(label)
        grid[0, column].set_title(f"{spans[column].name} to {spans[column + 1].name} at {change:.2f} s", fontsize=8)
        grid[1, column].set_xlabel("time [s]")


def _keep_span(axis: Axes) -> None:
    """Without it a velocity of rounding size would fill its panel."""
    low, high = axis.get_ylim()
    if high - low < _LEAST_SPAN:
        axis.set_ylim((low + high - _LEAST_SPAN) / 2, (low + high + _LEAST_SPAN) / 2)


def _velocity_lines(axis: Axes, record: Record, part: slice, names: Sequence[str], around: float | None = None) -> None:
    t, v = record["t"], record["v"][:, part]
    shown = np.ones(len(t), dtype=bool) if around is None else np.abs(t - around) <= _ZOOM
    for values, name, color, dashes in zip(v[shown].T, names, AXES_XYZ, DASHES, strict=True):
        axis.plot(t[shown], values, color=color, ls=dashes, label=name, lw=1.2)


@styled
def figure_joints(record: Record) -> Figure | None:
    """Joint positions and velocities, with limits where the record gives them; one small panel per joint."""
    names = record.meta.get("joints", [])
    n = n_joints(record)
    if not names or n != len(names):
        return None
    figure = RecordFigure(figsize=(WIDTH, 0.78 * n + 0.9))
    figure.suptitle("Joints", fontsize=10, fontweight="bold", x=0.01, ha="left")
    grid = figure.subplots(n, 2, sharex=True, squeeze=False)
    _joint_column(grid[:, 0], record, record["q"][:, -n:], ("position_lower", "position_upper"))
    _joint_column(grid[:, 1], record, record["v"][:, -n:], ("velocity",))
    for axis, name in zip(grid[:, 0], names, strict=True):
        axis.set_ylabel(name, rotation=0, ha="right", va="center")
    for axis, title in zip(grid[0], ("position [rad or m]", "velocity [rad/s or m/s]"), strict=True):
        axis.set_title(title, pad=14)
    for axis in grid[-1]:
        axis.set_xlabel("time [s]")
    spans = phase_spans(record)
    for column in grid.T:
        shade_phases(column, spans, share=0.46)
    figure.align_ylabels(grid[:, 0])
    return figure


def _joint_column(axes: Sequence[Axes], record: Record, values: np.ndarray, limits: Sequence[str]) -> None:
    bounds = [bound for name in limits if (bound := joint_limits(record, name)) is not None]
    if limits == ("velocity",):
        bounds += [-bound for bound in bounds]
    for i, axis in enumerate(axes):
        axis.plot(record["t"], values[:, i], color=LINES[i % len(LINES)])
        for bound in bounds:
            if np.isfinite(bound[i]):
                axis.axhline(bound[i], color=VERMILLION, lw=0.8, ls="--")


FIGURES: Mapping[str, Callable[[Record], Figure | None]] = MappingProxyType(
    {
        "errors": figure_errors,
        "misalignment": figure_misalignment,
        "altitude": figure_altitude,
        "tool_error": figure_tool_error,
        "activations": figure_activations,
        "velocities": figure_velocities,
        "joints": figure_joints,
        "path": figure_path,
        "efforts": figure_efforts,
        "tracking": figure_tracking,
        "tick_time": figure_tick_time,
    }
)


def write_figures(record: Record, folder: Path | str) -> tuple[Path, ...]:
    """Write every figure that the record can fill as ``folder/<name>.png``; returns the paths written.

    Raises `InvalidInput` for a record with fewer than two rows and `OutputError` where the folder cannot be written.
    """
    require_rows(record)
    drawn = {name: draw(record) for name, draw in FIGURES.items()}
    return tuple(_save(figure, Path(folder), name) for name, figure in drawn.items() if figure is not None)


def _save(figure: Figure, folder: Path, name: str) -> Path:
    path = folder / f"{name}.png"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=DPI)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({error}); choose another folder") from error
    return path
