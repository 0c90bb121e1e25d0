"""Figures of how the vehicle and the joints move, with their limits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uvms_ocp.arguments import checked
from uvms_ocp.exceptions import plain_line
from uvms_ocp.record import Record
from uvms_ocp.viz.series import PhaseSpan, has_vehicle, labelled, n_joints, phase_spans
from uvms_ocp.viz.style import AXES_XYZ, DASHES, LINES, VERMILLION, WIDTH, RecordFigure, legend_beside, shown, styled
from uvms_ocp.viz.time_marks import mark_time, room_above

_ZOOM = 1.0  # [s] on each side of a transition
_MAX_ZOOMS = 4
_SHORT = 10  # [-] letters of a phase above a zoom
_LEAST_SPAN = 0.02  # [m/s, rad/s] of a velocity panel


@checked
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
    _whole_run(parts[0], record)
    if changes:
        _zooms(parts[1], record, changes, spans)
    return figure


_VELOCITY_PANELS = (
    (slice(0, 3), labelled("linear", "v", "linear"), ("surge", "sway", "heave")),
    (slice(3, 6), labelled("angular", "v", "angular"), ("roll", "pitch", "yaw")),
)


def _whole_run(parent: Figure, record: Record) -> None:
    axes = parent.subplots(2, 1, sharex=True)
    for axis, (part, label, names) in zip(axes, _VELOCITY_PANELS, strict=True):
        _velocity_lines(axis, record, part, names)
        axis.set_ylabel(label)
        legend_beside(axis)
    axes[-1].set_xlabel(labelled("time", "t"))
    mark_time(axes, record, share=0.92)


def _zooms(parent: Figure, record: Record, changes: Sequence[float], spans: Sequence[PhaseSpan]) -> None:
    grid = parent.subplots(2, len(changes), sharex="col", squeeze=False)
    for column, change in enumerate(changes):
        for axis, (part, label, names) in zip(grid[:, column], _VELOCITY_PANELS, strict=True):
            _velocity_lines(axis, record, part, names, around=change)
            mark_time([axis], record, named=False)
            axis.set_xlim(change - _ZOOM, change + _ZOOM)
            _keep_span(axis)
            if column == 0:
                axis.set_ylabel(label)
        grid[0, column].set_title(_change(spans[column], spans[column + 1]), fontsize=8)
        grid[1, column].set_xlabel(labelled("time", "t"))


def _change(before: PhaseSpan, after: PhaseSpan) -> str:
    return f"{plain_line(before.name, _SHORT)} to {plain_line(after.name, _SHORT)} at {after.start:.2f} s"


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


@checked
@styled
def figure_joints(record: Record) -> Figure | None:
    """Joint positions and velocities, with limits where the record gives them; one small panel per joint."""
    names = record.meta.joints
    n = n_joints(record)
    if not names or n != len(names):
        return None
    figure = RecordFigure(figsize=(WIDTH, 0.78 * n + 0.9))
    figure.suptitle("Joints", fontsize=10, fontweight="bold", x=0.01, ha="left")
    grid = figure.subplots(n, 2, sharex=True, squeeze=False)
    positions, velocities = _joint_bounds(record, n)
    _joint_column(grid[:, 0], record, record["q"][:, -n:], positions)
    _joint_column(grid[:, 1], record, record["v"][:, -n:], velocities)
    for axis, name in zip(grid[:, 0], names, strict=True):
        axis.set_ylabel(shown(name), rotation=0, ha="right", va="center")
    for axis, title in zip(
        grid[0], (labelled("position", "q", "joints"), labelled("velocity", "v", "joints")), strict=True
    ):
        axis.set_title(title, pad=1 + room_above(record))
    for axis in grid[-1]:
        axis.set_xlabel(labelled("time", "t"))
    for column in grid.T:
        mark_time(column, record, share=0.46)
    figure.align_ylabels(grid[:, 0])
    return figure


def _joint_bounds(record: Record, n: int) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Bounds (n,) of positions and of velocities; none where the record tells no limits."""
    limits = record.meta.limits
    if limits is None:
        return [], []
    velocity = np.array(limits.velocity)[-n:]
    return [np.array(limits.position_lower)[-n:], np.array(limits.position_upper)[-n:]], [velocity, -velocity]


def _joint_column(axes: Sequence[Axes], record: Record, values: np.ndarray, bounds: Sequence[np.ndarray]) -> None:
    for i, axis in enumerate(axes):
        axis.plot(record["t"], values[:, i], color=LINES[i % len(LINES)])
        for bound in bounds:
            if np.isfinite(bound[i]):
                axis.axhline(bound[i], color=VERMILLION, lw=0.8, ls="--")
