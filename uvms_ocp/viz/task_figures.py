"""Figures of tasks: errors and other measured quantities, and activations ([Gao2022] figures
5-10).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from uvms_ocp.errors import NameNotFound
from uvms_ocp.record import meta_values, tables
from uvms_ocp.record.record import Record, quantity
from uvms_ocp.viz import layout, marks, series as recorded, style
from uvms_ocp.viz.colours import BLACK, BLUE, FADED, GREEN, ORANGE, VERMILLION, line_style
from uvms_ocp.viz.label_text import label_text, label_texts
from uvms_ocp.viz.line_widths import EDGELESS, FIRM, LIGHT, PLAIN

PANEL_HEIGHT = 1.75  # [in]
_TASK_HEIGHT = 0.56  # [in] of the activation of a task
_ROW_HEIGHT = 0.5  # [in] of the activation of one row
MOST_PANELS = 12
_LOG_FLOOR = 1e-9  # [m, rad] below this an error is rounding
_A_TABLE = 2  # axes of a series with columns
_ALTITUDES = ("LA.altitude", "MAC.altitude")
"""Quantities with the altitude of the altimeter, the first that was measured."""
_TASKS_WITH_FIGURES = ("PC", "AT", "HA", "LA", "MAC")
_QUANTITIES_WITH_FIGURES = (
    *("position_error", "orientation_error", "misalignment", "tilt", "altitude"),
    *("overhead", "horizontal_error"),  # of less use than those beside them
)
"""Last words of quantities of these tasks, and of tools, that have a figure of their own."""

_Panel = Callable[[Axes, Record, str, str], object]
"""Draws a quantity of a record, by its name, in a colour."""


@style.styled
def figure_errors(
    record: Record, task: str = "PC", *, fig: style.Canvas = None, width: layout.Width = "page"
) -> Figure | None:
    """Draw the position and orientation error of the vehicle to its way point; faded while the task
    is off.
    """
    return _pose_error_figure(record, {task: ""}, "Vehicle: error to the way point", (fig, width))


@style.styled
def figure_tool_error(
    record: Record,
    task: str | None = None,
    *,
    fig: style.Canvas = None,
    width: layout.Width = "page",
) -> Figure | None:
    """Draw the position and orientation error of the tool, of several by their names; faded while
    the task is off.

    task: one of them; left out: all of the record.
    """
    if task is None:
        tools = _tool_tasks(record)
    else:
        tools = {task: ""}
    title = "Tools: errors to their goals" if len(tools) > 1 else "Tool: error to its goal"
    return _pose_error_figure(record, tools, title, (fig, width))


def _tool_tasks(record: Record) -> dict[str, str]:
    """Return the tool of each task of one, by the name of the task; without a name where there is
    one alone.
    """
    tools = {task.name: task.tool for task in record.meta.tasks if task.tool}
    first = record.meta.tool_task
    if len(tools) > 1:
        return tools
    if first is None:
        return {}
    return {first: ""}


def _pose_error_figure(
    record: Record, tasks: Mapping[str, str], title: str, page: layout.Page
) -> Figure | None:
    rows = []
    for task, tool in tasks.items():
        for part, color in (("position", BLUE), ("orientation", VERMILLION)):
            label = f"{label_text(tool, 16)}\n{part} error".lstrip()
            rows.append((f"{task}.{part}_error", label, color))
    return _quantity_figure(record, rows, title, _logarithmic_panel, page)


def _quantity_figure(
    record: Record,
    rows: Sequence[tuple[str, str, str]],
    title: str,
    panel: _Panel,
    page: layout.Page,
) -> Figure | None:
    """Draw one panel per row (quantity, label, colour) that the record has."""
    drawn_rows = [row for row in rows if quantity(record, row[0]) is not None]
    if not drawn_rows:
        return None
    title += recorded.estimate_suffix(record)
    figure, axes = layout.stacked(len(drawn_rows), PANEL_HEIGHT, title, *page)
    for axis, (name, label, color) in zip(axes, drawn_rows, strict=True):
        panel(axis, record, name, color)
        axis.set_ylabel(recorded.axis_label(label, name, meta=record.meta))
    marks.mark_time(axes, record)
    active = Line2D([], [], color=BLACK, label="task active")
    inactive = Line2D([], [], color=FADED, lw=PLAIN, label="task off")
    layout.heading_legend(figure, [active, inactive])
    return figure


def _panel(axis: Axes, record: Record, name: str, color: str) -> np.ndarray:
    """Draw a quantity, faded while its task is off; returns its values (k,) while the task is
    on.
    """
    gate = recorded.task_gate(record, name.rpartition(".")[0])
    values = _required(record, name)
    if gate is None:
        is_on = np.ones(len(record), dtype=bool)
    else:
        is_on = gate > 0
    axis.plot(record["t"], values, color=color, alpha=0.35, lw=PLAIN)
    axis.plot(record["t"], np.where(is_on, values, np.nan), color=color)
    mark_thresholds(axis, record, name)
    return values[is_on]


def mark_thresholds(axis: Axes, record: Record, name: str) -> None:
    for limit in recorded.thresholds(record, name):
        marks.threshold(axis, limit, recorded.threshold_text(record, name, limit))


def _logarithmic_panel(axis: Axes, record: Record, name: str, color: str) -> None:
    """Draw on a logarithmic axis, because convergence is exponential; an exact start does not
    stretch the axis; linear where all is 0.
    """
    if not (_required(record, name) > 0.0).any():
        _linear_panel(axis, record, name, color)
        return
    values = _panel(axis, record, name, color)
    values = values[np.isfinite(values)]
    layout.logarithmic(axis)
    if len(values):
        low = float(np.percentile(values, 5))
        final = float(values[-1])
        lowest = min(low, final, *recorded.thresholds(record, name))
        axis.set_ylim(bottom=max(lowest, _LOG_FLOOR) / 2)


def _linear_panel(axis: Axes, record: Record, name: str, color: str) -> None:
    _panel(axis, record, name, color)
    axis.set_ylim(bottom=0)


def _required(record: Record, name: str) -> np.ndarray:
    """Return the values (k,) of a quantity; not a number where the record has it not."""
    values = quantity(record, name)
    if values is None:
        return np.full(len(record), np.nan)
    return values


@style.styled
def figure_misalignment(
    record: Record, *, fig: style.Canvas = None, width: layout.Width = "page"
) -> Figure | None:
    """Draw the angle between the vehicle's x axis and the horizontal direction to the target (AT),
    and tilt (HA).
    """
    rows = (("AT.misalignment", "misalignment", GREEN), ("HA.tilt", "tilt", ORANGE))
    if quantity(record, "AT.misalignment") is None:
        title = "Vehicle: tilt"
    else:
        title = "Vehicle: alignment with the target, and tilt"
    return _quantity_figure(record, rows, title, _linear_panel, (fig, width))


@style.styled
def figure_altitude(
    record: Record, *, fig: style.Canvas = None, width: layout.Width = "page"
) -> Figure | None:
    """Draw the altitude above the floor with the thresholds on it, and a closer view where it comes
    near; `None` without an echo.
    """
    measured = [name for name in _ALTITUDES if np.isfinite(_required(record, name)).any()]
    if not measured:
        return None
    name = measured[0]
    t = record["t"]
    altitude = _required(record, name)
    altitude = np.where(np.isfinite(altitude), altitude, np.nan)
    lowest = int(np.nanargmin(altitude))
    highest = float(np.nanmax(altitude))
    limits = recorded.thresholds(record, name)
    closer_top = 2.5 * max([*limits, float(altitude[lowest])])
    n_panels = 2 if closer_top < highest else 1
    title = "Altitude of the altimeter above the floor"
    figure, axes = layout.stacked(n_panels, PANEL_HEIGHT, title, fig, width)
    for axis in axes:
        axis.plot(t, altitude, color=BLUE, label="altitude")
        for limit in limits:
            marks.threshold(axis, limit, f"landed below {limit:g} m")
    lowest_label = f"lowest: {altitude[lowest]:.3f} m"
    axes[-1].plot(t[lowest], altitude[lowest], "v", color=VERMILLION, ms=5, label=lowest_label)
    label = recorded.axis_label("altitude", name)
    axes[0].set(ylabel=label, ylim=(0, 1.05 * max(highest, 0.1, *limits)))
    if n_panels > 1:
        axes[1].set(ylabel=f"{label},\nnear the floor", ylim=(0, closer_top))
    curve, *_, mark = axes[-1].get_lines()
    layout.heading_legend(figure, [curve, mark])
    marks.mark_time(axes, record)
    return figure


@style.styled
def figure_quantities(
    record: Record, *, fig: style.Canvas = None, width: layout.Width = "page"
) -> Figure | None:
    """Draw what the tasks measure and no other figure shows, own tasks included; `None` where there
    is nothing.
    """
    tasks = (*_tool_tasks(record), *_TASKS_WITH_FIGURES)
    rows = []
    for name in record.meta.quantities:
        task, _, quantity_name = name.rpartition(".")
        has_figure = task in tasks and quantity_name in _QUANTITIES_WITH_FIGURES
        if not has_figure:
            rows.append((name, f"{label_text(name, 24)}\n", BLUE))
    title = "Quantities of other tasks"
    return _quantity_figure(record, rows[:MOST_PANELS], title, _panel, (fig, width))


@style.styled
def figure_of(
    record: Record,
    name: str,
    *names: str,
    ax: style.Panels = None,
    fig: style.Canvas = None,
    width: layout.Width = "page",
) -> Figure:
    """Draw one panel for each of the names: a quantity such as ``T.position_error``, a series such
    as ``thrust``, or a column ``q.z``.

    ax: of the caller's, as many as names, instead of fig. Raises `NameNotFound` for what the record
    has not, and `InvalidInput` where it has nothing to draw, and for another number of axes.
    """
    recorded.require_rows(record)
    names = (name, *names)
    curves = [curves_of(record, name) for name in names]
    title = ", ".join(label_text(name) for name in names[:4])
    title += recorded.estimate_suffix(record)
    if ax is None:
        figure, axes = layout.stacked(len(names), PANEL_HEIGHT, title, fig, width)
    else:
        figure, axes = layout.panels(ax, len(names), fig)
    for axis, curve_name, (lines, unit) in zip(axes, names, curves, strict=True):
        n_before = marks.n_curves(axis)
        labels = label_texts(list(lines), 20)
        curves_by_label = zip(labels, lines.values(), strict=True)
        for k, (line_label, values) in enumerate(curves_by_label, start=n_before):
            axis.plot(
                record["t"],
                values,
                **line_style(k),
                lw=FIRM,
                label=line_label,
                gid=marks.CURVE,
            )
        if not n_before:
            mark_thresholds(axis, record, curve_name)
        axis.set_ylabel(f"{label_text(curve_name, 24)}\n[{unit}]")
        if len(lines) > 1 or n_before:
            layout.legend_beside(axis)
    marks.mark_time(axes, record)
    return figure


def curves_of(record: Record, name: str) -> tuple[dict[str, np.ndarray], str]:
    """Return the lines of a name, by what they are called, and their unit. Raises `NameNotFound`."""
    names = [key for key, series in record.series.items() if series.ndim <= _A_TABLE]
    if name in record.meta.quantities or (name in names and record[name].ndim == 1):
        return {name: record[name]}, tables.unit_of(name, meta=record.meta)
    if name in names:
        series = record[name]
        columns = tables.column_names(name, series.shape[1], record.meta)
        labels = [column.removeprefix(f"{name}.") for column in columns]
        unit = tables.unit_of(name, meta=record.meta)
        return dict(zip(labels, series.T, strict=True)), unit
    places = _columns(record, [key for key in names if record[key].ndim == _A_TABLE])
    if name not in places:
        series_name = name.partition(".")[0]
        similar = [column for column, place in places.items() if place[0] == series_name]
        allowed = [*record.meta.quantities, *names, *similar]
        raise NameNotFound("quantity, series or column", name, allowed)
    series_name, k, unit = places[name]
    return {name: record[series_name][:, k]}, unit


def _columns(record: Record, names: Sequence[str]) -> dict[str, tuple[str, int, str]]:
    """Return, by the name of a column, its series, its index there and its unit."""
    places = {}
    for name in names:
        n_columns = record[name].shape[1]
        columns = tables.column_names(name, n_columns, record.meta)
        units = tables.column_units(name, n_columns, record.meta)
        for k, (column, unit) in enumerate(zip(columns, units, strict=True)):
            places[column] = (name, k, unit)
    return places


@style.styled
def figure_activations(
    record: Record, *, fig: style.Canvas = None, width: layout.Width = "page"
) -> Figure | None:
    """Draw one small panel per task: activation of its rows (internal bell x phase) under the
    phase's own activation.
    """
    tasks = []
    for task in record.meta.tasks:
        if recorded.task_activity(record, task.name) is not None:
            tasks.append(task)
    if not tasks:
        return None
    title = "Activation of the tasks, highest priority on top"
    figure, axes = layout.stacked(len(tasks), _TASK_HEIGHT, title, fig, width)
    for axis, task in zip(axes, tasks, strict=True):
        _activation_panel(axis, record, task)
    marks.mark_time(axes, record, letters_beside=9)
    _legend(figure)
    return figure


def _activation_panel(axis: Axes, record: Record, task: meta_values.TaskMeta) -> None:
    t = record["t"]
    rows = recorded.task_activity(record, task.name)
    gate = recorded.task_gate(record, task.name)
    if rows is None or gate is None:
        return
    _draw_activation(axis, t, rows, gate)
    axis.grid(visible=False, axis="y")
    axis.set_ylabel(label_text(task.name), rotation=0, ha="right", va="center", fontweight="bold")
    look = {"xycoords": "axes fraction", "va": "center", "fontsize": style.points(6.5)}
    marks.note(axis, label_text(task.label), (1.008, 0.5), (0, 0), **look)


@style.styled
def figure_row_activations(
    record: Record, task: str = "JL", *, fig: style.Canvas = None, width: layout.Width = "page"
) -> Figure | None:
    """Draw the activation of every row of a task, such as each joint of JL; `None` where the task
    has no level.
    """
    rows = recorded.task_activity(record, task)
    if rows is None or not rows.shape[1]:
        return None
    n = rows.shape[1]
    title = f"Activation of the rows of {label_text(task)}"
    figure, axes = layout.stacked(n, _ROW_HEIGHT, title, fig, width)
    if n == 1 and len(record.meta.joints) != 1:
        names = [task]
    else:
        names = recorded.axis_names(record, n)
    gate = recorded.task_gate(record, task)
    for axis, name, row in zip(axes, names, rows.T, strict=True):
        _draw_activation(axis, record["t"], row[:, None], gate)
        axis.set_ylabel(label_text(name), rotation=0, ha="right", va="center")
    marks.mark_time(axes, record)
    _legend(figure)
    return figure


def _draw_activation(axis: Axes, t: np.ndarray, rows: np.ndarray, gate: np.ndarray | None) -> None:
    axis.fill_between(t, rows.max(axis=1, initial=0.0), color=BLUE, alpha=0.25, lw=EDGELESS)
    axis.plot(t, rows, color=BLUE, lw=LIGHT)
    if gate is not None:
        axis.plot(t, gate, color=VERMILLION, lw=PLAIN, ls="--")
    axis.set(ylim=(-0.08, 1.12), yticks=(0, 1))


def _legend(figure: Figure) -> None:
    """Add the legend of the two lines of every panel of activations."""
    rows = Line2D([], [], color=BLUE, lw=PLAIN, label="rows: own bell × phase")
    phase = Line2D([], [], color=VERMILLION, lw=PLAIN, ls="--", label="phase")
    layout.heading_legend(figure, [rows, phase])
