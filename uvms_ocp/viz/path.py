"""Figure of the vehicle's path over the floor."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.spatial import ConvexHull

from uvms_ocp.arguments import checked
from uvms_ocp.collision.obstacle_file import build_obstacle
from uvms_ocp.obstacle_data import ObstacleData
from uvms_ocp.ocp.clearance.support_points import support_of
from uvms_ocp.record import Record
from uvms_ocp.viz.series import floor_heights, has_vehicle, labelled, phase_spans
from uvms_ocp.viz.style import BLACK, LINES, WIDTH, RecordFigure, shown, styled

_SAND = "#8C6D46"
_OBSTACLE, _OBSTACLE_EDGE = "#D9B48F", "#8A5A2B"
_MOST_ABREAST = 5  # entries of the legend
_DIRECTIONS = 48  # that an outline is found in


@checked
@styled
def figure_path(record: Record) -> Figure | None:
    """The vehicle's path from above and from the side, coloured by phase, with the markers and obstacles of the scenario."""
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
    named = {line.get_label(): line for line in side.get_lines() if not str(line.get_label()).startswith("_")}
    figure.legend(handles=list(named.values()), loc="outside lower center", ncols=min(len(named), _MOST_ABREAST))
    figure.draw_without_rendering()  # equal scales choose the ticks, which have to be there before they are given room
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
    for item in record.meta.surroundings.obstacles:
        outline = obstacle_outline(item, i, j)
        axis.fill(*outline.T, facecolor=_OBSTACLE, edgecolor=_OBSTACLE_EDGE, lw=0.8, alpha=0.55, zorder=1)
        below = outline[:, 0].mean(), outline[:, 1].min()
        axis.annotate(
            shown(item.name, 16), below, xytext=(0, -2), textcoords="offset points", ha="center", va="top", fontsize=6.5
        )
    for marker in record.meta.surroundings.markers:
        place = marker.position[i], marker.position[j]
        axis.plot(*place, "*", color=BLACK, ms=7)
        axis.annotate(shown(marker.name), place, xytext=(5, 4), textcoords="offset points", fontsize=7)


def obstacle_outline(data: ObstacleData, i: int, j: int) -> np.ndarray:
    """Corners (n, 2) [m] of what an obstacle covers, seen along the axis of W that is neither i nor j [-]; of a mesh its hull."""
    points = _surface_points(data, i, j)[:, [i, j]]
    return np.asarray(points[ConvexHull(points).vertices])


def _surface_points(data: ObstacleData, i: int, j: int) -> np.ndarray:
    """Points (n, 3) [m] in W, the farthest of the obstacle in every direction of the plane of axes i and j [-] among them."""
    item = build_obstacle(data)
    R, p = item.X_WO.rotation, item.X_WO.translation
    if data.vertices:
        return np.asarray(np.array(data.vertices) @ R.T + p)
    angle = np.linspace(0.0, 2 * np.pi, _DIRECTIONS, endpoint=False)
    directions = np.zeros((_DIRECTIONS, 3))
    directions[:, i], directions[:, j] = np.cos(angle), np.sin(angle)
    towards = directions @ R  # in the frame of the shape
    support = support_of(item.shape, -towards, np.zeros((_DIRECTIONS, 3)))
    points = support.centres + support.radius * towards[:, None]
    return np.asarray(points.reshape(-1, 3) @ R.T + p)
