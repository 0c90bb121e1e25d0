"""Figures of the effort of a motion: thrust, torque and energy, tracking and disturbance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uvms_ocp.record import tables
from uvms_ocp.record.record import Record
from uvms_ocp.viz import layout, marks, style
from uvms_ocp.viz.colours import AXES_XYZ, BLUE, VERMILLION, line_style
from uvms_ocp.viz.label_text import label_texts
from uvms_ocp.viz.line_widths import LIGHT, PLAIN
from uvms_ocp.viz.series import axis_label, axis_names, has_vehicle

_LONGEST_NAME = 20  # letters of a name beside lines
_PARTS = ("force", "moment")
"""Parts of a planned wrench, a panel each."""


@style.styled
def figure_efforts(
    record: Record, *, fig: style.Canvas = None, width: layout.Width = "page"
) -> Figure | None:
    """Draw thrust of every thruster, or the planned wrench, torque of every joint, and the energy
    taken so far.
    """
    has_thrust = "thrust" in record.series
    has_forces = has_thrust or "wrench" in record.series
    if not has_forces or "joint_energy" not in record.series:
        return None
    n_pushes = 1 if has_thrust else len(_PARTS)
    figure, axes = layout.stacked(n_pushes + 2, 1.5, "Forces, torque and energy", fig, width)
    if has_thrust:
        _thrust(record, axes[0])
    else:
        _wrench(record, axes[:n_pushes])
    _torque(record, axes[-2])
    _energy(record, axes[-1])
    for axis in axes:
        layout.legend_beside(axis)
    marks.mark_time(axes, record)
    return figure


def _thrust(record: Record, axis: Axes) -> None:
    """Draw the thrust of every thruster."""
    columns = tables.column_names("thrust", record["thrust"].shape[1], record.meta)
    names = [column.partition(".")[2] for column in columns]
    labels = label_texts(names, _LONGEST_NAME)
    for i, (label, thrust) in enumerate(zip(labels, record["thrust"].T, strict=True)):
        axis.plot(record["t"], thrust, **line_style(i), lw=LIGHT, label=label)
    axis.set_ylabel(axis_label("thrust", "thrust"))


def _wrench(record: Record, axes: Sequence[Axes]) -> None:
    """Draw the planned force and moment, a panel each."""
    part_columns = np.hsplit(record["wrench"], len(_PARTS))
    for axis, part, values in zip(axes, _PARTS, part_columns, strict=True):
        for color, name, column in zip(AXES_XYZ, "xyz", values.T, strict=True):
            axis.plot(record["t"], column, color=color, lw=LIGHT, label=name)
        axis.set_ylabel(axis_label(part, "wrench", part))


def _torque(record: Record, axis: Axes) -> None:
    """Draw the torque of every joint."""
    labels = label_texts(axis_names(record, record["torque"].shape[1]), _LONGEST_NAME)
    for i, (label, torque) in enumerate(zip(labels, record["torque"].T, strict=True)):
        axis.plot(record["t"], torque, **line_style(i), lw=LIGHT, label=label)
    axis.set_ylabel(axis_label("torque", "torque", meta=record.meta))


def _energy(record: Record, axis: Axes) -> None:
    """Draw the energy that thrusters and joints have taken so far."""
    thrusters = record["thruster_energy"].sum(axis=1)
    unknown = " (not known)" if np.isnan(thrusters).any() else ""
    axis.plot(record["t"], thrusters, color=BLUE, label=f"thrusters{unknown}")
    axis.plot(record["t"], record["joint_energy"], color=VERMILLION, label="joints")
    axis.set_ylabel(axis_label("energy", "joint_energy"))


@style.styled
def figure_tracking(
    record: Record, *, fig: style.Canvas = None, width: layout.Width = "page"
) -> Figure | None:
    """Draw the errors of the vehicle from its reference velocity, and the disturbing force that the
    observer estimates.
    """
    if "disturbance" not in record.series or not has_vehicle(record):
        return None
    t = record["t"]
    error = record["v"] - record["command"]
    figure, axes = layout.stacked(3, 1.5, "Velocity tracking and estimated disturbance", fig, width)
    axis_pairs = (("surge", "roll"), ("sway", "pitch"), ("heave", "yaw"))
    for i, (color, (linear, angular)) in enumerate(zip(AXES_XYZ, axis_pairs, strict=True)):
        axes[0].plot(t, 1e3 * error[:, i], color=color, lw=PLAIN, label=linear)
        axes[1].plot(t, 1e3 * error[:, 3 + i], color=color, lw=PLAIN, label=angular)
        axes[2].plot(t, record["disturbance"][:, i], color=color, lw=PLAIN, label=linear)
    labels = (
        axis_label("velocity error", "v", "linear", "m"),
        axis_label("rate error", "v", "angular", "m"),
        axis_label("disturbance", "disturbance", "force"),
    )
    for axis, label in zip(axes, labels, strict=True):
        axis.set_ylabel(label)
        layout.legend_beside(axis)
        # Limits that show all but the most extreme thousandth of all lines.
        values = np.concatenate([np.asarray(line.get_ydata()) for line in axis.lines])
        low, high = np.percentile(values, [0.05, 99.95])
        margin = 0.1 * max(high - low, 1e-9)
        axis.set_ylim(low - margin, high + margin)
    marks.mark_time(axes, record)
    return figure
