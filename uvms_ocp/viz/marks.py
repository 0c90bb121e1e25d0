"""Marks on panels: phases, faults and moments of a record over time, thresholds, and notes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes

from uvms_ocp.errors import plain_line
from uvms_ocp.record.record import Record
from uvms_ocp.viz.colours import FAULT, PHASE_BEGIN, PHASES, THRESHOLD
from uvms_ocp.viz.layout import inches
from uvms_ocp.viz.line_widths import EDGELESS, FINE, PLAIN, THIN
from uvms_ocp.viz.style import points
from uvms_ocp.viz.time_spans import PhaseSpan, fault_spans, phase_spans

CURVE = "curve of a record"
"""Group id of a curve, by which the next record that is drawn on the same axes counts it."""
_PHASE = "phase of a record"
"""Group id of the band of a phase, by which the next record on the same axes sees that there is one.
"""
_IN_TIME: dict[str, Any] = {"xycoords": ("data", "axes fraction")}
"""Coordinates of a note: a time, and a share of the panel's height."""

_FEW = 12  # spans up to which each is named, however short
_MANY = 60  # spans up to which lines separate them; more lines would make the panel grey
_DEFAULT_WIDTH = 0.775  # share of a figure's width that one panel has before the layout
_LETTER = 0.055  # [in] mean width of a letter in a phase's label
_HANDLE = 5  # letters that the line before a legend's text takes
_ABOVE_PHASES = 13  # [points] height of the names of phases
_LINE = 8  # [points] height of the name of a moment
_LONGEST = 40  # letters of the name of a moment


def mark_time(
    axes: Sequence[Axes], record: Record, *, named: bool = True, letters_beside: int = 0
) -> None:
    """Mark phases and faults on every panel.

    named: write their names above the first. letters_beside: length of the longest text beside the
    panels, legends aside: it leaves less room for names.
    """
    shade_phases(axes, phase_spans(record), named=named, letters_beside=letters_beside)
    names_by_start: dict[float, list[str]] = {}
    for fault in fault_spans(record):
        names_by_start.setdefault(fault.start, []).append(fault.name)
        for axis in axes:
            axis.axvline(fault.start, color=FAULT, lw=PLAIN, ls=(0, (4, 2)), zorder=1.4)
            if fault.ended:
                axis.axvline(fault.end, color=FAULT, lw=PLAIN, ls=(0, (1, 2)), zorder=1.4)
    if not named:
        return
    for line, (start, names) in enumerate(names_by_start.items()):
        _name_moment(axes[0], start, plain_line(", ".join(names), _LONGEST), line)


def space_above(record: Record) -> float:
    """Return the height [points] that the names of phases and faults take above a panel."""
    return _ABOVE_PHASES + _LINE * len({fault.start for fault in fault_spans(record)})


def _name_moment(axis: Axes, start: float, text: str, line: int) -> None:
    """Name a moment above the names of the phases, to its right, or its left in the second half.

    start [s]. line: number of names of other moments that are below it.
    """
    begin, end = axis.get_xlim()
    height = _ABOVE_PHASES + _LINE * line
    if start - begin > 0.5 * (end - begin):
        offset = (-3, height)
        side = "right"
    else:
        offset = (3, height)
        side = "left"
    look = {"ha": side, "va": "bottom", "fontsize": points(6.5), "color": FAULT}
    note(axis, text, (start, 1.0), offset, **_IN_TIME, **look)


def shade_phases(
    axes: Sequence[Axes], spans: Sequence[PhaseSpan], *, named: bool = True, letters_beside: int = 0
) -> None:
    """Colour the phases behind every panel.

    named: write their names above the first. letters_beside: length of the longest text beside the
    panels, legends aside: it leaves less room for names.

    Panels that show the phases of another record already keep those, and become as long as both.
    """
    if any(_has_phases(axis) for axis in axes):
        for axis in axes:
            begin, end = axis.get_xlim()
            axis.set_xlim(min(begin, spans[0].start), max(end, spans[-1].end))
        return
    for axis in axes:
        for span in spans:
            band = PHASES[span.index % len(PHASES)]
            axis.axvspan(span.start, span.end, color=band, lw=EDGELESS, zorder=-2, gid=_PHASE)
        if len(spans) <= _MANY:
            for span in spans[1:]:
                axis.axvline(span.start, color=PHASE_BEGIN, lw=FINE, zorder=-1)
        axis.set_xlim(spans[0].start, spans[-1].end)
    if not named:
        return
    # The layout comes later: estimate the width of the panel from its share of the figure, and from
    # the letters that stand beside it.
    figure_share = axes[0].get_position().width / _DEFAULT_WIDTH
    letters_beside += _letters_of_legends(axes)
    width = 0.88 * inches(axes[0].figure) * figure_share - points(_LETTER) * letters_beside
    _name_phases(axes[0], spans, width)


def _has_phases(axis: Axes) -> bool:
    return any(patch.get_gid() == _PHASE for patch in axis.patches)


def _name_phases(axis: Axes, spans: Sequence[PhaseSpan], width: float) -> None:
    """Write full labels where they fit, else names, cut to their room; width [in] of the panel."""
    scale = width / (spans[-1].end - spans[0].start)
    for span in spans:
        room = scale * (span.end - span.start) / points(_LETTER)
        if room < 2.0 and len(spans) > _FEW:
            continue
        if len(span.label) + 1 < room:
            text = span.label
        else:
            text = plain_line(span.name, max(2, int(room)))
        middle = (span.start + span.end) / 2
        look = {"ha": "center", "va": "bottom", "fontsize": points(7.5), "color": "#333333"}
        note(axis, text, (middle, 1.0), (0, 3), **_IN_TIME, **look)


def _letters_of_legends(axes: Sequence[Axes]) -> int:
    """Return the letters that the widest entry of the legends beside panels takes, with its line."""
    widest = 0
    for axis in axes:
        legend = axis.get_legend()
        if legend:
            for text in legend.get_texts():
                widest = max(widest, len(text.get_text()) + _HANDLE)
    return widest


def mark_phase_starts(
    axes: Sequence[Axes], spans: Sequence[PhaseSpan], color: str, line: int
) -> None:
    """Mark in a run's colour where its phases begin, named on a line of its own above the first
    panel; line: how many of other runs are below it.
    """
    for axis in axes:
        for span in spans[1:]:
            axis.axvline(span.start, color=color, lw=THIN, ls=(0, (1, 2)), alpha=0.8, zorder=-1)
    length = spans[-1].end - spans[0].start
    look = {"ha": "left", "va": "bottom", "fontsize": points(6.5), "color": color}
    for span in spans:
        if len(spans) <= _FEW or span.end - span.start > length / _FEW:
            name = plain_line(span.name, _LONGEST)
            note(axes[0], name, (span.start, 1.0), (1, 3 + _LINE * line), **_IN_TIME, **look)


def n_curves(axis: Axes) -> int:
    """Count the curves of records that a panel of the caller's has already."""
    return sum(line.get_gid() == CURVE for line in axis.get_lines())


def threshold(axis: Axes, value: float, text: str, place: float = 0.0) -> None:
    """Draw a dashed line at `value` [unit of the axis], with its meaning `text` written on it; place:
    where the text begins, as a share of the width of the panel.
    """
    axis.axhline(value, color=THRESHOLD, lw=PLAIN, ls=(0, (5, 3)), zorder=1.5)
    # Over curves that run through the text.
    paper = {"facecolor": axis.get_facecolor(), "alpha": 0.8, "lw": 0, "pad": 0.6}
    look = {"ha": "left", "va": "bottom", "fontsize": points(7), "color": THRESHOLD, "bbox": paper}
    note(axis, text, (place, value), (4, 2), xycoords=("axes fraction", "data"), **look)


def note(axis: Axes, text: str, place: Any, offset: tuple[float, float], **look: Any) -> None:
    """Write a text at an offset [points] from a place on the axes; look: options of `Axes.annotate`."""
    axis.annotate(text, place, xytext=offset, textcoords="offset points", **look)
