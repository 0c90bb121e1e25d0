"""Figure of the trust in each sensor over time, with the first alarms."""

from __future__ import annotations

from matplotlib.figure import Figure
from matplotlib.patches import Patch

from uvms_ocp.record.record import Record
from uvms_ocp.viz import layout, marks, style
from uvms_ocp.viz.colours import TRUST
from uvms_ocp.viz.label_text import label_text
from uvms_ocp.viz.line_widths import EDGELESS
from uvms_ocp.viz.series import axis_label
from uvms_ocp.viz.time_spans import intervals_of, phase_spans

_MAX_ALARMS = 8  # alarms written below the bars
_HEIGHT = 0.62  # height of a bar, share of the space of a channel
_LINE = 0.17  # [in] height of a line of text


@style.styled
def figure_health(
    record: Record, *, fig: style.Canvas = None, width: layout.Width = "page"
) -> Figure | None:
    """Draw one bar over time for each channel, green where it was good, and below the bars the
    first alarms on channels.
    """
    if record.meta.kind != "run" or "health" not in record.series or not record.meta.channels:
        return None
    t = record["t"]
    names = record.meta.channels
    alarms = _alarm_lines(record)
    figure = layout.titled(
        1.0 + 0.26 * len(names) + _LINE * len(alarms), "Health of the sensors", fig, width
    )
    axis = figure.subplots()
    for row, codes in enumerate(record["health"].T):
        for code, color in enumerate(TRUST.values()):
            pieces = []
            for start, end, state in intervals_of(codes):
                if state == code:
                    pieces.append((t[start], t[end] - t[start]))
            axis.broken_barh(pieces, (row - _HEIGHT / 2, _HEIGHT), facecolors=color, lw=EDGELESS)
    axis.set_yticks(range(len(names)), [label_text(name) for name in names])
    axis.set_ylim(len(names) - 0.5, -0.5)
    axis.grid(visible=False, axis="y")
    axis.set_xlabel(axis_label("time", "t"))
    if alarms:
        figure.supxlabel("\n".join(alarms), x=0.01, ha="left", fontsize=style.points(7))
    marks.shade_phases([axis], phase_spans(record), letters_beside=12)
    patches = [Patch(color=color, label=name) for name, color in TRUST.items()]
    figure.legend(handles=patches, loc="outside upper right", ncols=len(patches))
    return figure


def _alarm_lines(record: Record) -> list[str]:
    """Return the first alarms on channels, a line each."""
    alarms = []
    for alarm in record.run_meta.alarms:
        channel, _, _ = alarm.text.partition(" ")
        if channel in record.run_meta.channels:
            alarms.append(alarm)
    lines = [label_text(f"{alarm.t:.2f} s  {alarm.text}", 110) for alarm in alarms[:_MAX_ALARMS]]
    n_more = len(alarms) - len(lines)
    if n_more:
        return [*lines, f"and {n_more} more"]
    return lines
