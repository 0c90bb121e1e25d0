"""Figures of a planned motion, read from its `Record`."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uvms_ocp.checks import checked
from uvms_ocp.errors import plain_line
from uvms_ocp.record import meta_values, tables
from uvms_ocp.record.record import Record
from uvms_ocp.viz import layout, marks, style
from uvms_ocp.viz.colours import BLACK, BREAK, THRESHOLD, VERMILLION, line_style
from uvms_ocp.viz.effort_figures import figure_efforts
from uvms_ocp.viz.label_text import label_text, label_texts
from uvms_ocp.viz.line_widths import EDGELESS, HAIR, LIGHT
from uvms_ocp.viz.series import axis_label, require_rows

_ROWS = {
    "x": "position",
    "x_rate": "velocity",
    "x_acceleration": "acceleration",
    "x_jerk": "jerk",
    "x_snap": "snap",
}
"""Names of the derivatives of a planned motion, by their series."""
_FAR = 0.5  # [m] least height of axes that leaves out larger distances
_VEHICLE = ("x", "y", "z", "roll", "pitch", "yaw")


@style.styled
def figure_vehicle_motion(
    record: Record, *, fig: style.Canvas = None, width: layout.Width = "page"
) -> Figure | None:
    """Draw planned vehicle axes from position to snap; `None` where none is planned."""
    return _motion(
        record, _VEHICLE, ("position", "attitude"), "Planned motion of the vehicle", (fig, width)
    )


@style.styled
def figure_joint_motion(
    record: Record, *, fig: style.Canvas = None, width: layout.Width = "page"
) -> Figure | None:
    """Draw planned joints from position to snap; `None` where none is planned."""
    return _motion(
        record, record.meta.joints, ("joints",), "Planned motion of the joints", (fig, width)
    )


@style.styled
def figure_clearance(
    record: Record, *, fig: style.Canvas = None, width: layout.Width = "page"
) -> Figure | None:
    """Draw the distance from each obstacle and between links along the path, and the requested
    clearance.
    """
    if "clearance" not in record.series or not record["clearance"].shape[1]:
        return None
    d = record["clearance"]
    meta = record.plan_meta
    clearance = meta.clearance_wanted
    link_clearance = meta.link_clearance_wanted
    figure, (axis,) = layout.stacked(1, 2.8, "Clearance along the path", fig, width)
    for k, name in enumerate(meta.clearance_groups):
        axis.plot(record["t"], d[:, k], **line_style(k), label=label_text(name, 24))
    marks.threshold(axis, clearance, f"wanted {clearance:g} m")
    if link_clearance is not None and link_clearance != clearance:
        marks.threshold(axis, link_clearance, f"wanted {link_clearance:g} m between links", 0.5)
    if meta.min_clearance is not None:
        _mark_least(axis, meta.min_clearance)
    top = min(float(d.max()), max(_FAR, 5.0 * clearance))
    bottom = min(float(d.min()), 0.0)
    top = max(top, clearance, link_clearance or 0.0)
    axis.set_ylim(1.1 * bottom - 0.03 * top, 1.05 * top)
    axis.axhspan(axis.get_ylim()[0], 0.0, color=VERMILLION, alpha=0.15, lw=EDGELESS)
    axis.set_ylabel(axis_label("distance", "clearance"))
    figure.legend(loc="outside upper right", ncols=4)
    _mark_breaks([axis], record)
    return figure


def _mark_least(axis: Axes, nearest: meta_values.ClearanceMeta) -> None:
    """Draw a dot at the smallest distance, with the names of the two shapes towards the middle of
    the panel.
    """
    t = nearest.t
    distance = nearest.distance
    is_early = t < axis.get_xlim()[1] / 2.0
    axis.plot(t, distance, "o", color=BLACK, ms=4, clip_on=False, zorder=3)
    if is_early:
        offset = (5, -4)
        side = "left"
    else:
        offset = (-5, -4)
        side = "right"
    text = plain_line(f"{distance:.3g} m, {nearest.between}", 80)
    marks.note(axis, text, (t, distance), offset, ha=side, va="top", fontsize=style.points(7))


_ALL = (figure_vehicle_motion, figure_joint_motion, figure_clearance, figure_efforts)
PLAN_FIGURES: Mapping[str, Callable[..., Figure | None]] = style.by_name(_ALL)
"""Functions that draw each figure of a plan, by name."""


@checked
def write_plan_figures(record: Record, folder: Path | str) -> tuple[Path, ...]:
    """Write every figure that the plan can fill as PNG; returns the paths. Raises `OutputError`."""
    figures = {name: draw(record) for name, draw in PLAN_FIGURES.items()}
    paths = []
    for name, figure in figures.items():
        if figure is not None:
            paths.append(style.save_figure(figure, Path(folder) / f"{name}.png"))
    return tuple(paths)


def _motion(
    record: Record, names: Collection[str], parts: Sequence[str], title: str, page: layout.Page
) -> Figure | None:
    """Draw one row per derivative that is recorded, one line per axis; each with its limit where it
    has one and comes near it.
    """
    if "x" not in record.series:
        return None
    planned = record.plan_meta.axes
    indices = [i for i, name in enumerate(planned) if name in names]
    if not indices:
        return None
    rows = [(series, label) for series, label in _ROWS.items() if series in record.series]
    figure, axes = layout.stacked(len(rows), 1.25, title, *page)
    axis_labels = label_texts([planned[i] for i in indices], 10)
    for row, (series, label) in zip(axes, rows, strict=True):
        for k, (i, name) in enumerate(zip(indices, axis_labels, strict=True)):
            row.plot(record["t"], record[series][:, i], **line_style(k), label=name)
        units = [tables.unit_of(series, part, record.meta) for part in parts]
        row.set_ylabel(f"{label}\n[{', '.join(units)}]")
        _draw_limits(row, record, series, indices)
    axes[0].legend(
        ncols=len(indices), loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize=style.points(7)
    )
    _mark_breaks(axes, record)
    return figure


def _draw_limits(row: Axes, record: Record, series: str, indices: list[int]) -> None:
    limits = record.plan_meta.axis_limits
    values = {"x_rate": limits.x_rate, "x_acceleration": limits.x_acceleration}.get(series)
    if values is None:
        return
    low, high = row.get_ylim()
    for limit in sorted({values[i] for i in indices if np.isfinite(values[i])}):
        # Dashes in turn in the colours of the lines that it bounds.
        colors = []
        for k, i in enumerate(indices):
            if values[i] == limit:
                colors.append(line_style(k)["color"])
        if len(colors) == len(indices):
            colors = [THRESHOLD]
        for (n, color), side in itertools.product(enumerate(colors), (limit, -limit)):
            if low * 1.4 <= side <= high * 1.4:
                row.axhline(side, color=color, lw=LIGHT, ls=(8 * n, (5, 8 * len(colors) - 5)))


def _mark_breaks(axes: list[Axes], record: Record) -> None:
    """Draw thin lines where the pieces of the trajectory meet. Raises `InvalidInput` where there is
    nothing to draw.
    """
    require_rows(record)
    for axis in axes:
        for t in record.plan_meta.breaks[1:-1]:
            axis.axvline(t, color=BREAK, lw=HAIR, zorder=-1)
        axis.set_xlim(record["t"][0], record["t"][-1])
