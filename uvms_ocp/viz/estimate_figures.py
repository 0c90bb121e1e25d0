"""Figure of the errors of the estimate within the standard deviations that the filter gives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uvms_ocp.record.record import Record
from uvms_ocp.record.run_meta import joint_errors
from uvms_ocp.viz import layout, marks, style
from uvms_ocp.viz.colours import AXES_XYZ, LINES
from uvms_ocp.viz.label_text import label_texts
from uvms_ocp.viz.line_widths import FINE, PLAIN
from uvms_ocp.viz.series import axis_label, axis_names, has_vehicle
from uvms_ocp.viz.time_spans import phase_spans

_FITTING = 98.0  # [%] share of ticks that fit into the axes; bands before first readings are huge
_Panel = tuple[str, Sequence[str], Sequence[str], np.ndarray, np.ndarray]
"""Label of an axis; of each line its name, colour, errors (n, lines) and standard deviations."""


@style.styled
def figure_estimate(
    record: Record, *, fig: style.Canvas = None, width: layout.Width = "page"
) -> Figure | None:
    """Draw errors of position, attitude and joints, estimate less truth, within two standard
    deviations that the filter gives.
    """
    if not {"q", "q_estimated", "q_std"} <= record.series.keys():
        return None
    panels = _panels(record)
    if not panels:
        return None
    figure, axes = layout.stacked(
        len(panels), 1.5, "Estimate less truth, and two standard deviations", fig, width
    )
    for axis, (label, names, colors, errors, spreads) in zip(axes, panels, strict=True):
        _draw(axis, record["t"], names, colors, errors, spreads)
        axis.set_ylabel(label)
    marks.shade_phases(axes, phase_spans(record))
    return figure


def _panels(record: Record) -> list[_Panel]:
    """Return the panels of position and attitude, where there is a vehicle, and of joints."""
    q = record["q"]
    estimated = record["q_estimated"]
    spread = record["q_std"]
    panels: list[_Panel] = []
    if has_vehicle(record):
        position = axis_label("position", "q", "position", "m")
        attitude = axis_label("attitude", "q_std", "attitude", "m")
        place = 1e3 * (estimated - q)[:, :3]
        turn = 1e3 * _turns(q[:, 3:7], estimated[:, 3:7])
        panels = [
            (position, ("x", "y", "z"), AXES_XYZ, place, 1e3 * spread[:, :3]),
            (attitude, ("roll", "pitch", "yaw"), AXES_XYZ, turn, 1e3 * spread[:, 3:6]),
        ]
    errors = joint_errors(record.series, record.meta)
    if errors is None:
        return panels
    n = errors.shape[1]
    if n and spread.shape[1] >= n:
        names = label_texts(axis_names(record, n), 10)
        colors = [LINES[i % len(LINES)] for i in range(n)]
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


def _turns(true: np.ndarray, estimated: np.ndarray) -> np.ndarray:
    """Return small rotations (n, 3) [rad] in B from true attitudes to estimated ones, quaternions
    (n, 4) xyzw.
    """
    true_vector = true[:, :3]
    true_scalar = true[:, 3:]
    estimated_vector = estimated[:, :3]
    estimated_scalar = estimated[:, 3:]
    vector = true_scalar * estimated_vector - estimated_scalar * true_vector
    vector = vector - np.cross(true_vector, estimated_vector)
    scalar = true_scalar * estimated_scalar
    scalar = scalar + (true_vector * estimated_vector).sum(axis=1, keepdims=True)
    return np.asarray(2.0 * np.sign(scalar) * vector)


def _draw(
    axis: Axes,
    t: np.ndarray,
    names: Sequence[str],
    colors: Sequence[str],
    errors: np.ndarray,
    spreads: np.ndarray,
) -> None:
    """Draw errors (n, lines) over time, each between lines at two standard deviations to either side."""
    for i, (name, color) in enumerate(zip(names, colors, strict=True)):
        axis.plot(t, errors[:, i], color=color, lw=PLAIN, label=name)
        for sign in (-2.0, 2.0):
            axis.plot(t, sign * spreads[:, i], color=color, lw=FINE, ls=":")
    largest = max(
        float(np.percentile(2.0 * spreads, _FITTING)),
        float(np.percentile(np.abs(errors), _FITTING)),
        1e-9,
    )
    axis.set_ylim(-1.2 * largest, 1.2 * largest)
    layout.legend_beside(axis)
