"""Figure of how far each sensor could be trusted."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from uvms_ocp.arguments import checked
from uvms_ocp.meta_values import AlarmMeta
from uvms_ocp.record import Record
from uvms_ocp.viz.series import labelled, phase_spans, stays
from uvms_ocp.viz.style import GREEN, ORANGE, VERMILLION, WIDTH, RecordFigure, shade_phases, shown, styled

_COLORS = {"good": GREEN, "suspect": ORANGE, "lost": VERMILLION}
_MOST_WORDS = 8  # alarms written below the bars
_HEIGHT = 0.62  # of a bar, of the space of a channel
_LINE = 0.17  # [in] of text


@checked
@styled
def figure_health(record: Record) -> Figure | None:
    """One bar over time per channel, green where it was good, and below the bars what was said against channels."""
    if record.meta.kind != "run" or "health" not in record.series or not record.meta.channels:
        return None
    names, told = record.meta.channels, _told(record)
    figure = RecordFigure(figsize=(WIDTH, 1.0 + 0.26 * len(names) + _LINE * len(told)))
    figure.suptitle("Health of the sensors", fontsize=10, fontweight="bold", x=0.01, ha="left")
    axis = figure.subplots()
    for row, codes in enumerate(record["health"].T):
        _bar(axis, record["t"], row, codes)
    axis.set_yticks(range(len(names)), [shown(name) for name in names])
    axis.set_ylim(len(names) - 0.5, -0.5)
    axis.grid(visible=False, axis="y")
    axis.set_xlabel(labelled("time", "t"))
    if told:
        figure.supxlabel("\n".join(told), x=0.01, ha="left", fontsize=7)
    shade_phases([axis], phase_spans(record), share=0.85)
    patches = [Patch(color=color, label=name) for name, color in _COLORS.items()]
    figure.legend(handles=patches, loc="outside upper right", ncols=len(patches))
    return figure


def _bar(axis: Axes, t: np.ndarray, row: int, codes: np.ndarray) -> None:
    """The channel of a row: a piece for every stay in one state."""
    for code, color in enumerate(_COLORS.values()):
        pieces = [(t[i], t[j] - t[i]) for i, j, state in stays(codes) if state == code]
        axis.broken_barh(pieces, (row - _HEIGHT / 2, _HEIGHT), facecolors=color, lw=0)


def _told(record: Record) -> list[str]:
    """The first alarms on channels, a line each."""
    alarms = [alarm for alarm in record.run_meta.alarms if _of_channel(alarm, record.run_meta.channels)]
    lines = [shown(f"{alarm.t:.2f} s  {alarm.text}", 110) for alarm in alarms[:_MOST_WORDS]]
    rest = len(alarms) - len(lines)
    return [*lines, f"and {rest} more"] if rest else lines


def _of_channel(alarm: AlarmMeta, channels: tuple[str, ...]) -> bool:
    return alarm.text.partition(" ")[0] in channels
