"""Figure of the vehicle's path over the floor."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uvms_ocp.arguments import checked
from uvms_ocp.record import Record
from uvms_ocp.viz.series import floor_heights, has_vehicle, labelled, phase_spans
from uvms_ocp.viz.style import BLACK, LINES, WIDTH, RecordFigure, shown, styled

_SAND = "#8C6D46"


@checked
@styled
def figure_path(record: Record) -> Figure | None:
    """The vehicle's path from above and from the side, coloured by phase, with the markers of the scenario."""
    if not has_vehicle(record):
        return None
    figure = RecordFigure(figsize=(WIDTH, 3.3))
    figure.suptitle("Path of the vehicle", fontsize=10, fontweight="bold", x=0.01, ha="left")
    above, side = figure.subplots(1, 2)
    for axis, (i, j) in ((above, (0, 1)), (side, (0, 2))):
        _path_panel(axis, record, i, j)
        axis.set(**{f"{side}label": labelled("xyz"[k], "q", "position") for side, k in (("x", i), ("y", j))})
        axis.set_aspect("equal", adjustable="datalim")
        axis.margins(0.14)
    _draw_floor(side, record)
    above.set_title("from above")
    side.set_title("from the side")
    side.legend(loc="best")
    return figure


def _draw_floor(axis: Axes, record: Record) -> None:
    """A line for a flat floor, else the floor below the path."""
    below = floor_heights(record, record["q"][:, :2])
    if below is None:
        return
    if record.meta.surroundings.floor is None:
        axis.axhline(below[0], color=_SAND, lw=2, label="floor")
    else:
        axis.plot(record["q"][:, 0], below, color=_SAND, lw=2, label="floor below")


def _path_panel(axis: Axes, record: Record, i: int, j: int) -> None:
    t, p = record["t"], record["q"][:, :3]
    for k, span in enumerate(phase_spans(record)):
        part = (t >= span.start) & (t <= span.end)
        axis.plot(p[part, i], p[part, j], color=LINES[k % len(LINES)], lw=2, label=shown(span.label))
    axis.plot(p[0, i], p[0, j], "o", color=BLACK, ms=4)
    for marker in record.meta.surroundings.markers:
        place = marker.position[i], marker.position[j]
        axis.plot(*place, "*", color=BLACK, ms=7)
        axis.annotate(shown(marker.name), place, xytext=(5, 4), textcoords="offset points", fontsize=7)
