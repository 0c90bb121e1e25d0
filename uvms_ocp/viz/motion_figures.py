"""Figures of how the vehicle and the joints move, with their limits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uvms_ocp.errors import plain_line
from uvms_ocp.record import run_meta
from uvms_ocp.record.record import Record
from uvms_ocp.viz import layout, marks, style
from uvms_ocp.viz.colours import AXES_XYZ, DASHES, LINES, VERMILLION
from uvms_ocp.viz.label_text import label_text
from uvms_ocp.viz.line_widths import LIGHT, STRONG
from uvms_ocp.viz.series import axis_label, has_vehicle
from uvms_ocp.viz.time_spans import PhaseSpan, phase_spans

_ZOOM = 1.0  # [s] on each side of a transition
_ZOOM_WIDTH = 1.7  # [in]
_SHORT = 10  # letters of a phase above a zoom
_LEAST_SPAN = 0.02  # [m/s, rad/s] of a velocity panel

_VELOCITY_PANELS = (
    (slice(0, 3), axis_label("linear", "v", "linear"), ("surge", "sway", "heave")),
    (slice(3, 6), axis_label("angular", "v", "angular"), ("roll", "pitch", "yaw")),
)


@style.styled
def figure_velocities(
    record: Record, *, fig: style.Canvas = None, width: layout.Width = "page"
) -> Figure | None:
    """Draw linear and angular velocity of the vehicle in B, whole run and a zoom on every change of
    phase.
    """
    if not has_vehicle(record):
        return None
    spans = phase_spans(record)
    changes = [span.start for span in spans[1:]]
    figure = layout.titled(3.9 + (2.6 if changes else 0.0), "Vehicle velocity", fig, width)
    changes = changes[: max(1, int(layout.inches(figure) / _ZOOM_WIDTH))]
    if changes:
        parts = figure.subfigures(2, 1, height_ratios=(3.4, 3.0))
    else:
        parts = [figure]
    _whole_run(parts[0], record)
    if changes:
        _zooms(parts[1], record, changes, spans)
    return figure


def _whole_run(parent: Figure, record: Record) -> None:
    axes = parent.subplots(2, 1, sharex=True)
    for axis, (part, label, names) in zip(axes, _VELOCITY_PANELS, strict=True):
        _velocity_lines(axis, record, part, names)
        axis.set_ylabel(label)
        layout.legend_beside(axis)
    axes[-1].set_xlabel(axis_label("time", "t"))
    marks.mark_time(axes, record)


def _zooms(
    parent: Figure, record: Record, changes: Sequence[float], spans: Sequence[PhaseSpan]
) -> None:
    grid = parent.subplots(2, len(changes), sharex="col", squeeze=False)
    for column, change in enumerate(changes):
        for axis, (part, label, names) in zip(grid[:, column], _VELOCITY_PANELS, strict=True):
            _velocity_lines(axis, record, part, names, center=change)
            marks.mark_time([axis], record, named=False)
            axis.set_xlim(change - _ZOOM, change + _ZOOM)
            # Without it a velocity of rounding size would fill its panel.
            low, high = axis.get_ylim()
            if high - low < _LEAST_SPAN:
                axis.set_ylim((low + high - _LEAST_SPAN) / 2, (low + high + _LEAST_SPAN) / 2)
            if column == 0:
                axis.set_ylabel(label)
        phases = " to ".join(plain_line(span.name, _SHORT) for span in spans[column : column + 2])
        grid[0, column].set_title(f"{phases} at {change:.2f} s", fontsize=style.points(8))
        grid[1, column].set_xlabel(axis_label("time", "t"))


def _velocity_lines(
    axis: Axes, record: Record, part: slice, names: Sequence[str], center: float | None = None
) -> None:
    t = record["t"]
    v = record["v"][:, part]
    if center is None:
        is_shown = np.ones(len(t), dtype=bool)
    else:
        is_shown = np.abs(t - center) <= _ZOOM
    for values, name, color, dashes in zip(v[is_shown].T, names, AXES_XYZ, DASHES, strict=True):
        axis.plot(t[is_shown], values, color=color, ls=dashes, label=name, lw=STRONG)


@style.styled
def figure_joints(
    record: Record, *, fig: style.Canvas = None, width: layout.Width = "page"
) -> Figure | None:
    """Draw joint positions and velocities, with limits where the record gives them; one small panel
    per joint.
    """
    names = record.meta.joints
    values = run_meta.joint_positions(record.series, record.meta)
    n = len(names)
    if not names or values is None:
        return None
    figure = layout.titled(0.78 * n + 0.9, "Joints", fig, width)
    grid = figure.subplots(n, 2, sharex=True, squeeze=False)
    positions, velocities = _joint_bounds(record, n)
    _joint_column(grid[:, 0], record, values, positions)
    _joint_column(grid[:, 1], record, record["v"][:, -n:], velocities)
    for axis, name in zip(grid[:, 0], names, strict=True):
        axis.set_ylabel(label_text(name), rotation=0, ha="right", va="center")
    for axis, title, name in zip(grid[0], ("position", "velocity"), "qv", strict=True):
        axis.set_title(
            axis_label(title, name, "joints", meta=record.meta).replace(" [", "\n["),
            pad=1 + marks.space_above(record),
        )
    for axis in grid[-1]:
        axis.set_xlabel(axis_label("time", "t"))
    for column in grid.T:
        marks.mark_time(column, record)
    figure.align_ylabels(grid[:, 0])
    return figure


def _joint_bounds(record: Record, n: int) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return bounds (n,) of positions and of velocities; none where the record tells no limits."""
    limits = record.meta.limits
    if limits is None:
        return [], []
    velocity = np.array(limits.velocity)[-n:]
    return [np.array(limits.position_lower)[-n:], np.array(limits.position_upper)[-n:]], [
        velocity,
        -velocity,
    ]


def _joint_column(
    axes: Sequence[Axes], record: Record, values: np.ndarray, bounds: Sequence[np.ndarray]
) -> None:
    for i, axis in enumerate(axes):
        axis.plot(record["t"], values[:, i], color=LINES[i % len(LINES)])
        for bound in bounds:
            if np.isfinite(bound[i]):
                axis.axhline(bound[i], color=VERMILLION, lw=LIGHT, ls="--")
