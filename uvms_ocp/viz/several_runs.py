"""Several runs or plans in the same panels: a colour for each, a dash for each column of a series,
and bands where one name stands for many runs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.record import Record
from uvms_ocp.viz import layout, marks, style, task_figures
from uvms_ocp.viz.colours import DASHES, LINES, THRESHOLD
from uvms_ocp.viz.label_text import label_text, label_texts
from uvms_ocp.viz.line_widths import EDGELESS, FIRM
from uvms_ocp.viz.series import require_rows
from uvms_ocp.viz.time_spans import PhaseSpan, phase_spans

BAND = (5.0, 95.0)
"""Percentiles [%] of many runs that a band reaches from and to, about their median."""

_SAME_PHASE = 0.01  # share of the longest run by which phases may begin earlier or later
_POINTS_OF_BANDS = 600
_DASHES: tuple[Any, ...] = (
    *DASHES,
    (0, (1, 1)),
    (0, (4, 1, 1, 1, 1, 1)),
    (0, (8, 2)),
    (0, (1, 3)),
    (0, (8, 2, 2, 2)),
)
"""Dashes of the columns of a series, one after the other."""

_Line = tuple[np.ndarray, np.ndarray, np.ndarray | None]
"""Times [s], values, and the edges (2, n) of a band around them, or none."""


@dataclass(frozen=True, kw_only=True)
class RunGroup:
    """Runs that have one name and one colour: a run, or many runs that are drawn as a band.

    Raises `InvalidInput` for no runs, and for one with nothing to draw.
    """

    name: str
    """Name in the legend."""
    records: tuple[Record, ...]
    """Records of one or more runs, each of two rows or more."""

    def __post_init__(self) -> None:
        if not self.records:
            raise InvalidInput(f"{self.name}: no runs; give a Record or Plan, or several")
        for record in self.records:
            require_rows(record)

    def lines(self, quantity: str) -> tuple[dict[str, _Line], str]:
        """Return the lines of a quantity, series or column by their labels, and its unit.

        Raises `NameNotFound` for a name that a record lacks.
        """
        curves = [task_figures.curves_of(record, quantity) for record in self.records]
        labels, unit = curves[0]
        if len(self.records) == 1:
            t = self.records[0]["t"]
            return {label: (t, values, None) for label, values in labels.items()}, unit
        t = self._common_times()
        lines = dict[str, _Line]()
        for label in labels:
            values = []
            for record, (run_lines, _) in zip(self.records, curves, strict=True):
                if label in run_lines:
                    values.append(np.interp(t, record["t"], run_lines[label], right=np.nan))
            low, middle, high = np.nanpercentile(values, (BAND[0], 50.0, BAND[1]), axis=0)
            lines[label] = (t, middle, np.array([low, high]))
        return lines, unit

    def _common_times(self) -> np.ndarray:
        """Return times [s] from the earliest start to the latest end of the runs."""
        begin = min(float(record["t"][0]) for record in self.records)
        end = max(float(record["t"][-1]) for record in self.records)
        return np.linspace(begin, end, _POINTS_OF_BANDS)


@style.styled
def figure_several_runs(
    runs: Mapping[str, Record | Sequence[Record]],
    *names: str,
    differences: bool = False,
    ax: style.Panels = None,
    fig: style.Canvas = None,
    width: layout.Width = "page",
) -> Figure:
    """Draw runs or plans in the same panels, one for each of the names: a quantity, a series or a
    column, as in `figure_of`; by default every quantity that all of them measure.

    runs: by the name that the legend shows, each a record, or several of which the median and a
    band from the 5th to the 95th percentile is drawn. differences: draw the difference of each from
    the first. Phases are shaded where all runs have the same, and marked in each run's colour where
    they differ. ax: axes of the caller's, as many as names. Raises `InvalidInput` for no runs and
    where there is nothing to draw, and `NameNotFound` for a name that one of the records lacks.
    """
    groups = _groups(runs)
    if differences and len(groups) < 2:
        raise InvalidInput("differences of one run; give two or more, the first is what counts")
    if not names:
        names = _shared_quantities(groups)
    contents = []
    for name in names:
        contents.append([group.lines(name) for group in groups])
    title = ", ".join(label_text(name) for name in names[:4])
    if differences:
        title += f" less that of {label_text(groups[0].name)}"
    if ax is None:
        figure, axes = layout.stacked(len(names), task_figures.PANEL_HEIGHT, title, fig, width)
    else:
        figure, axes = layout.panels(ax, len(names), fig)
    for axis, name, lines_and_units in zip(axes, names, contents, strict=True):
        lines_of_groups = [lines for lines, _ in lines_and_units]
        if differences:
            lines_of_groups = _less_the_first(lines_of_groups)
        else:
            task_figures.mark_thresholds(axis, groups[0].records[0], name)
        _draw(axis, lines_of_groups)
        unit = lines_and_units[0][1]
        axis.set_ylabel(f"{label_text(name, 24)}\n[{unit}]")
    _mark_phases(axes, groups)
    handles = []
    for k, group in enumerate(groups):
        handles.append(Line2D([], [], color=_color(k), label=label_text(group.name)))
    layout.heading_legend(figure, handles)
    return figure


def _groups(runs: Mapping[str, Record | Sequence[Record]]) -> list[RunGroup]:
    """Return the runs of each name. Raises `InvalidInput` where there are none."""
    groups = []
    for name, records in runs.items():
        group_records = (records,) if isinstance(records, Record) else tuple(records)
        groups.append(RunGroup(name=name, records=group_records))
    if not groups:
        raise InvalidInput("runs = {}; give one or more, such as {'strict': record}")
    return groups


def _all_records(groups: Sequence[RunGroup]) -> list[Record]:
    records = list[Record]()
    for group in groups:
        records += group.records
    return records


def _shared_quantities(groups: Sequence[RunGroup]) -> tuple[str, ...]:
    """Return the quantities that all records measure, in the order of the first, 12 at most."""
    records = _all_records(groups)
    shared = list(records[0].meta.quantities)
    for record in records[1:]:
        shared = [name for name in shared if name in record.meta.quantities]
    if not shared:
        raise InvalidInput("the runs measure no quantity in common; give names such as 'q', 'q.z'")
    return tuple(shared[: task_figures.MOST_PANELS])


def _less_the_first(lines_of_groups: list[dict[str, _Line]]) -> list[dict[str, _Line]]:
    """Return the differences of the lines of each group from those of the first, at the same times;
    none for the first.
    """
    reference = lines_of_groups[0]
    differences = list[dict[str, _Line]]()
    for lines in lines_of_groups:
        group_differences = {}
        for label, (t, values, band) in lines.items():
            if lines is reference or label not in reference:
                continue
            first_t, first_values, _ = reference[label]
            base = np.interp(t, first_t, first_values, left=np.nan, right=np.nan)
            group_differences[label] = (t, values - base, None if band is None else band - base)
        differences.append(group_differences)
    return differences


def _draw(axis: Axes, lines_of_groups: Sequence[Mapping[str, _Line]]) -> None:
    """Draw lines of a group in its colour, each column of a series with its dashes, named once."""
    labels = dict[str, None]()  # each once, in their order
    for lines in lines_of_groups:
        labels |= dict.fromkeys(lines)
    dashes = {label: _DASHES[k % len(_DASHES)] for k, label in enumerate(labels)}
    for k, lines in enumerate(lines_of_groups):
        for label, (t, values, band) in lines.items():
            axis.plot(t, values, color=_color(k), ls=dashes[label], lw=FIRM)
            if band is not None:
                axis.fill_between(t, *band, color=_color(k), alpha=0.2, lw=EDGELESS)
    if len(labels) > 1:
        for name, dash in zip(label_texts(list(labels), 20), dashes.values(), strict=True):
            axis.plot([], [], color=THRESHOLD, ls=dash, label=name)
        layout.legend_beside(axis)


def _color(k: int) -> str:
    return LINES[k % len(LINES)]


def _mark_phases(axes: Sequence[Axes], groups: Sequence[RunGroup]) -> None:
    """Shade the phases that all runs have at the same times; else mark, in each run's colour, where
    its phases begin. Bands of many runs have no phases of their own.
    """
    records = _all_records(groups)
    last = max(float(record["t"][-1]) for record in records)
    first = min(float(record["t"][0]) for record in records)
    spans_of_groups = []
    for k, group in enumerate(groups):
        if len(group.records) == 1:
            spans_of_groups.append((k, phase_spans(group.records[0])))
    if spans_of_groups and _agree(spans_of_groups, last):
        marks.shade_phases(axes, max((spans for _, spans in spans_of_groups), key=_end))
    else:
        for line, (k, spans) in enumerate(spans_of_groups):
            marks.mark_phase_starts(axes, spans, _color(k), line)
    for axis in axes:
        axis.set_xlim(first, last)


def _end(spans: Sequence[PhaseSpan]) -> float:
    return spans[-1].end


def _agree(spans_of_groups: Sequence[tuple[int, Sequence[PhaseSpan]]], last: float) -> bool:
    """Tell whether all runs have the same phases at the same times, within 1 % of the longest."""
    _, reference = spans_of_groups[0]
    for _, spans in spans_of_groups[1:]:
        if [span.name for span in spans] != [span.name for span in reference]:
            return False
        for span, reference_span in zip(spans, reference, strict=True):
            if abs(span.start - reference_span.start) > _SAME_PHASE * last:
                return False
    return True
