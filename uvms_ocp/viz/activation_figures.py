"""Figures of which tasks are on, and how far ([Gao2022] figures 5-10)."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from uvms_ocp.arguments import checked
from uvms_ocp.meta_values import TaskMeta
from uvms_ocp.record import Record
from uvms_ocp.viz.series import axis_names, task_activity, task_gate
from uvms_ocp.viz.style import BLUE, VERMILLION, heading_legend, shown, stacked, styled
from uvms_ocp.viz.time_marks import mark_time


@checked
@styled
def figure_activations(record: Record) -> Figure | None:
    """One small panel per task: activation of its rows (internal bell x phase) under the phase's own activation."""
    tasks = [task for task in record.meta.tasks if task_activity(record, task.name) is not None]
    if not tasks:
        return None
    figure, axes = stacked(len(tasks), 0.56, "Activation of the tasks, highest priority on top")
    for axis, task in zip(axes, tasks, strict=True):
        _activation_panel(axis, record, task)
    mark_time(axes, record)
    _legend(figure)
    return figure


def _activation_panel(axis: Axes, record: Record, task: TaskMeta) -> None:
    t, rows, gate = record["t"], task_activity(record, task.name), task_gate(record, task.name)
    if rows is None or gate is None:
        return
    axis.fill_between(t, rows.max(axis=1, initial=0.0), color=BLUE, alpha=0.25, lw=0)
    axis.plot(t, rows, color=BLUE, lw=0.8)
    axis.plot(t, gate, color=VERMILLION, lw=0.9, ls="--")
    axis.set(ylim=(-0.08, 1.12), yticks=(0, 1))
    axis.grid(visible=False, axis="y")
    axis.set_ylabel(shown(task.name), rotation=0, ha="right", va="center", fontweight="bold")
    axis.annotate(
        shown(task.label), (1.008, 0.5), xycoords="axes fraction", va="center", fontsize=6.5, annotation_clip=False
    )


@checked
@styled
def figure_row_activations(record: Record, task: str = "JL") -> Figure | None:
    """Activation of every row of a task, such as each joint of JL; `None` where the task has no level."""
    rows = task_activity(record, task)
    if rows is None or not rows.shape[1]:
        return None
    figure, axes = stacked(rows.shape[1], 0.5, f"Activation of the rows of {shown(task)}")
    n = rows.shape[1]
    names = [task] if n == 1 and len(record.meta.joints) != 1 else axis_names(record, n)
    gate = task_gate(record, task)
    for axis, name, row in zip(axes, names, rows.T, strict=True):
        axis.fill_between(record["t"], row, color=BLUE, alpha=0.25, lw=0)
        axis.plot(record["t"], row, color=BLUE, lw=0.8)
        if gate is not None:
            axis.plot(record["t"], gate, color=VERMILLION, lw=0.9, ls="--")
        axis.set(ylim=(-0.08, 1.12), yticks=(0, 1))
        axis.set_ylabel(shown(name), rotation=0, ha="right", va="center")
    mark_time(axes, record)
    _legend(figure)
    return figure


def _legend(figure: Figure) -> None:
    """What the two lines of a panel of activations are."""
    rows = Line2D([], [], color=BLUE, lw=0.9, label="rows: own bell × phase")
    heading_legend(figure, [rows, Line2D([], [], color=VERMILLION, lw=0.9, ls="--", label="phase")])
