"""What lies behind the curves of every figure over time: the phases of the mission, and what went wrong on purpose."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes

from uvms_ocp.exceptions import plain_line
from uvms_ocp.record import Record
from uvms_ocp.viz.series import fault_spans, phase_spans
from uvms_ocp.viz.style import VERMILLION, shade_phases

_ABOVE_PHASES, _LINE = 13, 8  # [points]
_LONGEST = 40  # letters of what one moment is marked with


def mark_time(axes: Sequence[Axes], record: Record, *, named: bool = True, share: float = 1.0) -> None:
    """Phases and faults on every panel, named on the first unless told otherwise; share [-] of the page's width is theirs."""
    shade_phases(axes, phase_spans(record), named=named, share=share)
    begun: dict[float, list[str]] = {}
    for fault in fault_spans(record):
        begun.setdefault(fault.start, []).append(fault.name)
        for axis in axes:
            axis.axvline(fault.start, color=VERMILLION, lw=0.9, ls=(0, (4, 2)), zorder=1.4)
            if fault.ended:
                axis.axvline(fault.end, color=VERMILLION, lw=0.9, ls=(0, (1, 2)), zorder=1.4)
    for line, (start, names) in enumerate(begun.items() if named else ()):
        _name(axes[0], start, plain_line(", ".join(names), _LONGEST), line)


def room_above(record: Record) -> float:
    """[points] that the names of phases and faults take above a panel."""
    return _ABOVE_PHASES + _LINE * len({fault.start for fault in fault_spans(record)})


def _name(axis: Axes, start: float, text: str, line: int) -> None:
    """Above the names of the phases, from its onset on or up to it; each a line higher than the one before."""
    begin, end = axis.get_xlim()
    late = start - begin > 0.5 * (end - begin)
    axis.annotate(
        text,
        (start, 1.0),
        xycoords=("data", "axes fraction"),
        xytext=(-3 if late else 3, _ABOVE_PHASES + _LINE * line),
        textcoords="offset points",
        ha="right" if late else "left",
        va="bottom",
        fontsize=6.5,
        color=VERMILLION,
    )
