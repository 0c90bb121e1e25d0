"""Figures of motion: velocities, joints, path, and what it cost in thrust, torque and energy."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uvms_ocp.errors import plain_line
from uvms_ocp.ocp.separating_planes import support_of
from uvms_ocp.record import meta_values, run_meta, tables
from uvms_ocp.record.record import Record
from uvms_ocp.robot.shapes.obstacles import build_obstacle
from uvms_ocp.viz import style
from uvms_ocp.viz.series import (
    PhaseSpan,
    axis_label,
    axis_names,
    floor_heights,
    has_vehicle,
    phase_spans,
)

# What a mission on the physical plant cost: thrust, torque, power, tracking and disturbance.

_LEGEND = 20  # letters of a name beside lines
_PARTS = ("force", "moment")
_TRACKED = {"velocity": "linear", "rate": "angular"}

_ZOOM = 1.0  # [s] on each side of a transition
_ZOOM_WIDTH = 1.7  # [in]
_SHORT = 10  # letters of a phase above a zoom
_LEAST_SPAN = 0.02  # [m/s, rad/s] of a velocity panel

_VELOCITY_PANELS = (
    (slice(0, 3), axis_label("linear", "v", "linear"), ("surge", "sway", "heave")),
    (slice(3, 6), axis_label("angular", "v", "angular"), ("roll", "pitch", "yaw")),
)

_SAND = "#8C6D46"
_OBSTACLE = "#D9B48F"
_OBSTACLE_EDGE = "#8A5A2B"
_ENTRY = 1.4  # [in] of the legend
_DIRECTIONS = 48  # that an outline is found in


@style.styled
def figure_efforts(
    record: Record, *, fig: style.Given = None, width: style.Width = "page"
) -> Figure | None:
    """Draw thrust of every thruster, or the planned wrench, torque of every joint, and the energy
    taken so far.
    """
    draw = next((drawn for name, drawn in _PUSHES.items() if name in record.series), None)
    if draw is None or "joint_energy" not in record.series:
        return None
    if draw is _thrust:
        n_pushes = 1
    else:
        n_pushes = len(_PARTS)
    figure, axes = style.stacked(n_pushes + 2, 1.5, "Forces, torque and energy", fig, width)
    draw(record, axes[:n_pushes])
    _torque(record, axes[-2])
    _energy(record, axes[-1])
    for axis in axes:
        style.legend_beside(axis)
    style.mark_time(axes, record)
    return figure


def _thrust(record: Record, axes: Sequence[Axes]) -> None:
    columns = tables.column_names("thrust", record["thrust"].shape[1], record.meta)
    names = [column.partition(".")[2] for column in columns]
    labels = style.label_texts(names, _LEGEND)
    for i, (label, thrust) in enumerate(zip(labels, record["thrust"].T, strict=True)):
        axes[0].plot(record["t"], thrust, **style.line_style(i), lw=0.8, label=label)
    axes[0].set_ylabel(axis_label("thrust", "thrust"))


def _wrench(record: Record, axes: Sequence[Axes]) -> None:
    for axis, part, values in zip(
        axes, _PARTS, np.hsplit(record["wrench"], len(_PARTS)), strict=True
    ):
        for color, name, column in zip(style.AXES_XYZ, "xyz", values.T, strict=True):
            axis.plot(record["t"], column, color=color, lw=0.8, label=name)
        axis.set_ylabel(axis_label(part, "wrench", part))


_PUSHES: Mapping[str, Callable[[Record, Sequence[Axes]], None]] = {
    "thrust": _thrust,
    "wrench": _wrench,
}


def _torque(record: Record, axis: Axes) -> None:
    labels = style.label_texts(axis_names(record, record["torque"].shape[1]), _LEGEND)
    for i, (label, torque) in enumerate(zip(labels, record["torque"].T, strict=True)):
        axis.plot(record["t"], torque, **style.line_style(i), lw=0.8, label=label)
    axis.set_ylabel(axis_label("torque", "torque", meta=record.meta))


def _energy(record: Record, axis: Axes) -> None:
    thrusters = record["thruster_energy"].sum(axis=1)
    unknown = " (not known)" if np.isnan(thrusters).any() else ""
    axis.plot(record["t"], thrusters, color=style.BLUE, label=f"thrusters{unknown}")
    axis.plot(record["t"], record["joint_energy"], color=style.VERMILLION, label="joints")
    axis.set_ylabel(axis_label("energy", "joint_energy"))


@style.styled
def figure_tracking(
    record: Record, *, fig: style.Given = None, width: style.Width = "page"
) -> Figure | None:
    """Draw how well the vehicle follows its reference velocity, and the force that the observer
    holds responsible.
    """
    if "disturbance" not in record.series or not has_vehicle(record):
        return None
    t = record["t"]
    error = record["v"] - record["command"]
    figure, axes = style.stacked(3, 1.5, "Velocity tracking and estimated disturbance", fig, width)
    for i, (color, names) in enumerate(
        zip(style.AXES_XYZ, ("surge, roll", "sway, pitch", "heave, yaw"), strict=True)
    ):
        linear, angular = names.split(", ")
        axes[0].plot(t, 1e3 * error[:, i], color=color, lw=0.9, label=linear)
        axes[1].plot(t, 1e3 * error[:, 3 + i], color=color, lw=0.9, label=angular)
        axes[2].plot(t, record["disturbance"][:, i], color=color, lw=0.9, label=linear)
    velocity, rate = (
        axis_label(f"{subject} error", "v", part, "m") for subject, part in _TRACKED.items()
    )
    labels = (velocity, rate, axis_label("disturbance", "disturbance", "force"))
    for axis, label in zip(axes, labels, strict=True):
        axis.set_ylabel(label)
        style.legend_beside(axis)
        # Limits that show all but the most extreme thousandth of all lines.
        values = np.concatenate([np.asarray(line.get_ydata()) for line in axis.lines])
        low, high = np.percentile(values, [0.05, 99.95])
        margin = 0.1 * max(high - low, 1e-9)
        axis.set_ylim(low - margin, high + margin)
    style.mark_time(axes, record)
    return figure


# Figures of how the vehicle and the joints move, with their limits.


@style.styled
def figure_velocities(
    record: Record, *, fig: style.Given = None, width: style.Width = "page"
) -> Figure | None:
    """Draw linear and angular velocity of the vehicle in B, whole run and a zoom on every change of
    phase.
    """
    if not has_vehicle(record):
        return None
    spans = phase_spans(record)
    changes = [span.start for span in spans[1:]]
    figure = style.titled(3.9 + (2.6 if changes else 0.0), "Vehicle velocity", fig, width)
    changes = changes[: max(1, int(style.inches(figure) / _ZOOM_WIDTH))]
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
        style.legend_beside(axis)
    axes[-1].set_xlabel(axis_label("time", "t"))
    style.mark_time(axes, record)


def _zooms(
    parent: Figure, record: Record, changes: Sequence[float], spans: Sequence[PhaseSpan]
) -> None:
    grid = parent.subplots(2, len(changes), sharex="col", squeeze=False)
    for column, change in enumerate(changes):
        for axis, (part, label, names) in zip(grid[:, column], _VELOCITY_PANELS, strict=True):
            _velocity_lines(axis, record, part, names, center=change)
            style.mark_time([axis], record, named=False)
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
    for values, name, color, dashes in zip(
        v[is_shown].T, names, style.AXES_XYZ, style.DASHES, strict=True
    ):
        axis.plot(t[is_shown], values, color=color, ls=dashes, label=name, lw=1.2)


@style.styled
def figure_joints(
    record: Record, *, fig: style.Given = None, width: style.Width = "page"
) -> Figure | None:
    """Draw joint positions and velocities, with limits where the record gives them; one small panel
    per joint.
    """
    names = record.meta.joints
    values = run_meta.joint_positions(record.series, record.meta)
    n = len(names)
    if not names or values is None:
        return None
    figure = style.titled(0.78 * n + 0.9, "Joints", fig, width)
    grid = figure.subplots(n, 2, sharex=True, squeeze=False)
    positions, velocities = _joint_bounds(record, n)
    _joint_column(grid[:, 0], record, values, positions)
    _joint_column(grid[:, 1], record, record["v"][:, -n:], velocities)
    for axis, name in zip(grid[:, 0], names, strict=True):
        axis.set_ylabel(style.label_text(name), rotation=0, ha="right", va="center")
    for axis, title, name in zip(grid[0], ("position", "velocity"), "qv", strict=True):
        axis.set_title(
            axis_label(title, name, "joints", meta=record.meta).replace(" [", "\n["),
            pad=1 + style.space_above(record),
        )
    for axis in grid[-1]:
        axis.set_xlabel(axis_label("time", "t"))
    for column in grid.T:
        style.mark_time(column, record)
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
        axis.plot(record["t"], values[:, i], color=style.LINES[i % len(style.LINES)])
        for bound in bounds:
            if np.isfinite(bound[i]):
                axis.axhline(bound[i], color=style.VERMILLION, lw=0.8, ls="--")


# Figure of the vehicle's path over the floor.


@style.styled
def figure_path(
    record: Record, *, fig: style.Given = None, width: style.Width = "page"
) -> Figure | None:
    """Draw the vehicle's path from above and from the side, coloured by phase, with the markers and
    obstacles of the scenario.
    """
    if not has_vehicle(record):
        return None
    figure = style.titled(3.3, "Path of the vehicle", fig, width)
    views = style.abreast(figure)
    for axis, (i, j) in zip(views, style.VIEWS.values(), strict=True):
        _path_panel(axis, record, i, j)
        axis.margins(0.14)
    side_view = views[-1]
    _draw_floor(side_view, record)
    lines_by_label = {
        line.get_label(): line
        for line in side_view.get_lines()
        if not str(line.get_label()).startswith("_")
    }
    n_columns = max(1, int(style.inches(figure) / style.points(_ENTRY)))
    figure.legend(
        handles=list(lines_by_label.values()),
        loc="outside lower center",
        ncols=min(len(lines_by_label), n_columns),
    )
    return figure


def _draw_floor(axis: Axes, record: Record) -> None:
    """Draw a line for a flat floor, else the floor below the path."""
    below = floor_heights(record, record["q"][:, :2])
    if below is not None and record.meta.surroundings.floor is None:
        axis.axhline(below[0], color=_SAND, lw=2, label="floor")
    elif below is not None:
        axis.plot(record["q"][:, 0], below, color=_SAND, lw=2, label="floor below")


def _path_panel(axis: Axes, record: Record, i: int, j: int) -> None:
    t = record["t"]
    p = record["q"][:, :3]
    for span in phase_spans(record):
        part = (t >= span.start) & (t <= span.end)
        color = style.LINES[span.index % len(style.LINES)]
        axis.plot(p[part, i], p[part, j], color=color, lw=2, label=style.label_text(span.label))
    axis.plot(p[0, i], p[0, j], "o", color=style.BLACK, ms=4)
    for item in record.meta.surroundings.obstacles:
        outline = obstacle_outline(item, i, j)
        axis.fill(
            *outline.T, facecolor=_OBSTACLE, edgecolor=_OBSTACLE_EDGE, lw=0.8, alpha=0.55, zorder=1
        )
        below = outline[:, 0].mean(), outline[:, 1].min()
        style.note(
            axis,
            style.label_text(item.name, 16),
            below,
            (0, -2),
            ha="center",
            va="top",
            fontsize=style.points(6.5),
        )
    for k, marker in enumerate(
        record.meta.surroundings.markers
    ):  # above and below in turn: those of two tools are near
        place = marker.position[i], marker.position[j]
        axis.plot(*place, "*", color=style.BLACK, ms=7)
        style.note(
            axis,
            style.label_text(marker.name),
            place,
            (5, 4 - 13 * (k % 2)),
            fontsize=style.points(7),
        )


def obstacle_outline(data: meta_values.ObstacleMeta, i: int, j: int) -> np.ndarray:
    """Return corners (n, 2) [m] of what an obstacle covers, seen along the axis of W that is
    neither i nor j; of a mesh its hull.
    """
    from scipy.spatial import ConvexHull  # a quarter of a second, which few need

    points = _surface_points(data, i, j)[:, [i, j]]
    return np.asarray(points[ConvexHull(points).vertices])


def _surface_points(data: meta_values.ObstacleMeta, i: int, j: int) -> np.ndarray:
    """Return points (n, 3) [m] in W, the farthest of the obstacle in every direction of the plane
    of axes i and j among them.
    """
    item = build_obstacle(data)
    rotation = item.X_WO.rotation
    p = item.X_WO.translation
    if data.vertices:
        return np.asarray(np.array(data.vertices) @ rotation.T + p)
    angle = np.linspace(0.0, 2 * np.pi, _DIRECTIONS, endpoint=False)
    directions = np.zeros((_DIRECTIONS, 3))
    directions[:, i] = np.cos(angle)
    directions[:, j] = np.sin(angle)
    towards = directions @ rotation  # in the frame of the shape
    support = support_of(item.shape, -towards, np.zeros((_DIRECTIONS, 3)))
    return np.asarray(
        (support.centres + support.radius * towards[:, None]).reshape(-1, 3) @ rotation.T + p
    )
