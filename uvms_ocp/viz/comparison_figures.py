"""Figures of two runs or two paths together ([Gao2022] figures 11-12)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from uvms_ocp.errors import InvalidInput, require_known
from uvms_ocp.record.record import Record
from uvms_ocp.record.run_meta import joint_positions
from uvms_ocp.record.tables import unit_of
from uvms_ocp.viz import layout, series, style
from uvms_ocp.viz.colours import BLACK, BLUE, GREEN, ORANGE, VERMILLION
from uvms_ocp.viz.label_text import label_text
from uvms_ocp.viz.line_widths import FINE, LIGHT, MEDIUM
from uvms_ocp.viz.time_spans import phase_spans

_COLORS = (BLUE, VERMILLION, GREEN, ORANGE)
_SMOOTHNESS = {
    "step": ("step of v / (a_max dt)", 1e-4),
    "jerk": ("jerk [m/s³, rad/s³]", 1e-2),
    "lost": ("lost above [m/s, rad/s]", 1e-18),
}
"""Measures of a phase change: labels, and the least that is drawn on a logarithmic axis."""


@style.styled
def figure_joint_comparison(
    records: Mapping[str, Record],
    phase: str | None = None,
    *,
    fig: style.Canvas = None,
    width: layout.Width = "page",
) -> Figure:
    """Draw the positions of all joints during the last stay in a phase, for runs by name, over time
    since its start.

    phase: by default the last one that all runs have come to. Raises `NameNotFound` where a run has
    no such phase, and `InvalidInput` for no runs, and for runs that do not have the same joints, of
    one axis each.
    """
    joints = _joints_of(records)
    if phase is None:
        phase = _last_shared_phase(records)
    title = (
        f"Joint positions in phase {label_text(phase)}"
        f" [{unit_of('q', 'joints', next(iter(records.values())).meta)}]"
    )
    figure, axes = layout.stacked(len(joints), 0.6, title, fig, width)
    for (_, record), color in zip(records.items(), _COLORS, strict=False):
        spans = {span.name: span for span in phase_spans(record)}
        require_known("phase", phase, spans)
        span = spans[phase]
        rows = (record["t"] >= span.start) & (record["t"] <= span.end)
        positions = joint_positions(record.series, record.meta)[rows]
        for axis, column in zip(axes, positions.T, strict=True):
            axis.plot(record["t"][rows] - span.start, column, color=color, lw=MEDIUM)
    for axis, name in zip(axes, joints, strict=True):
        axis.set_ylabel(label_text(name), rotation=0, ha="right", va="center")
    axes[-1].set_xlabel(series.axis_label(f"time since phase {label_text(phase)} began", "t"))
    _name_runs(figure, records)
    return figure


def _last_shared_phase(records: Mapping[str, Record]) -> str:
    """Return the phase that the first run entered last of those that all runs have been in."""
    names_of_runs = []
    for record in records.values():
        names_of_runs.append([span.name for span in phase_spans(record)])
    for name in reversed(names_of_runs[0]):
        if all(name in names for names in names_of_runs):
            return name
    raise InvalidInput(f"{len(records)} runs have no phase in common; give runs of one mission")


def _name_runs(figure: Figure, names: Iterable[str]) -> None:
    """Add the legend of runs, a colour each."""
    lines = []
    for name, color in zip(names, _COLORS, strict=False):
        lines.append(Line2D([], [], color=color, label=label_text(name)))
    layout.heading_legend(figure, lines)


def _joints_of(records: Mapping[str, Record]) -> tuple[str, ...]:
    """Return the names that all records have for the columns of their joints."""
    joint_names = set[tuple[str, ...]]()
    for record in records.values():
        if joint_positions(record.series, record.meta) is None:
            joint_names.add(())
        else:
            joint_names.add(record.meta.joints)
    if len(joint_names) != 1 or () in joint_names:
        raise InvalidInput(
            f"records = {len(records)} runs; give one or more with the same joints, of one axis"
            " each"
        )
    return joint_names.pop()


@style.styled
def figure_paths(
    paths: Mapping[str, np.ndarray], *, fig: style.Canvas = None, width: layout.Width = "page"
) -> Figure:
    """Draw from above and from the side `paths` (n, 3) [m] in W by name, such as a tool's planned
    and tracked one.
    """
    figure = layout.titled(3.3, "Paths", fig, width)
    views = layout.abreast(figure)
    for axis, (i, j) in zip(views, layout.VIEWS.values(), strict=True):
        for k, (name, path) in enumerate(paths.items()):
            color = _COLORS[k % len(_COLORS)]
            label = label_text(name)
            axis.plot(
                path[:, i],
                path[:, j],
                color=color,
                ls="-" if k else "--",
                label=label,
                zorder=3 - k,
            )
            axis.plot(path[0, i], path[0, j], "o", color=color, ms=4)
            axis.plot(path[-1, i], path[-1, j], "*", color=color, ms=8)
    start = Line2D([], [], color=BLACK, ls="", marker="o", label="start")
    end = Line2D([], [], color=BLACK, ls="", marker="*", label="end")
    path_lines = views[0].get_lines()[::3]  # each path has a line, a start and an end
    layout.heading_legend(figure, [*path_lines, start, end])
    return figure


@style.styled
def figure_transitions(
    runs: Mapping[str, Mapping[str, np.ndarray]],
    *,
    fig: style.Canvas = None,
    width: layout.Width = "page",
) -> Figure:
    """Draw how smoothly runs change phase; thin lines: changes.

    runs: by name, the series (n,) [s, -, m/s3 or rad/s3, m/s or rad/s] that
    `uvms_ocp.report.transition_series` gives.
    """
    figure, axes = layout.stacked(3, 1.5, "Smoothness of phase changes", fig, width)
    for (_, run), color in zip(runs.items(), _COLORS, strict=False):
        for axis, name in zip(axes, _SMOOTHNESS, strict=True):
            axis.plot(run["t"], np.maximum(run[name], _SMOOTHNESS[name][1]), color=color, lw=LIGHT)
            for time in run["changes"]:
                axis.axvline(time, color=color, lw=FINE, alpha=0.6)
    for axis, (label, floor) in zip(axes, _SMOOTHNESS.values(), strict=True):
        layout.logarithmic(axis)
        axis.set_ylabel(label)
        axis.set_ylim(bottom=floor)
    axes[0].axhline(1.0, color=BLACK, lw=FINE, ls="--")
    _name_runs(figure, runs)
    return figure
