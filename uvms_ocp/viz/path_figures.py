"""Figure of the vehicle's path over the floor, past the obstacles."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uvms_ocp.ocp.separating_planes import support_of
from uvms_ocp.record import meta_values
from uvms_ocp.record.record import Record
from uvms_ocp.robot.shapes.obstacles import build_obstacle
from uvms_ocp.viz import layout, marks, style
from uvms_ocp.viz.colours import BLACK, FLOOR, LINES, OBSTACLE, OBSTACLE_EDGE
from uvms_ocp.viz.label_text import label_text
from uvms_ocp.viz.line_widths import BOLD, LIGHT
from uvms_ocp.viz.series import floor_heights, has_vehicle
from uvms_ocp.viz.time_spans import phase_spans

_ENTRY = 1.4  # [in] width of an entry of the legend
_DIRECTIONS = 48  # directions in which the outermost points of an obstacle are looked for


@style.styled
def figure_path(
    record: Record, *, fig: style.Canvas = None, width: layout.Width = "page"
) -> Figure | None:
    """Draw the vehicle's path from above and from the side, coloured by phase, with the markers and
    obstacles of the scenario.
    """
    if not has_vehicle(record):
        return None
    figure = layout.titled(3.3, "Path of the vehicle", fig, width)
    views = layout.abreast(figure)
    for axis, (i, j) in zip(views, layout.VIEWS.values(), strict=True):
        _path_panel(axis, record, i, j)
        axis.margins(0.14)
    side_view = views[-1]
    _draw_floor(side_view, record)
    lines_by_label = {}
    for line in side_view.get_lines():
        is_named = not str(line.get_label()).startswith("_")
        if is_named:
            lines_by_label[line.get_label()] = line
    n_columns = max(1, int(layout.inches(figure) / style.points(_ENTRY)))
    figure.legend(
        handles=list(lines_by_label.values()),
        loc="outside lower center",
        ncols=min(len(lines_by_label), n_columns),
    )
    return figure


def _draw_floor(axis: Axes, record: Record) -> None:
    """Draw a line for a flat floor, else the floor below the path."""
    below = floor_heights(record, record["q"][:, :2])
    if below is not None and record.meta.surroundings.floor is None:
        axis.axhline(below[0], color=FLOOR, lw=BOLD, label="floor")
    elif below is not None:
        axis.plot(record["q"][:, 0], below, color=FLOOR, lw=BOLD, label="floor below")


def _path_panel(axis: Axes, record: Record, i: int, j: int) -> None:
    t = record["t"]
    p = record["q"][:, :3]
    for span in phase_spans(record):
        part = (t >= span.start) & (t <= span.end)
        color = LINES[span.index % len(LINES)]
        axis.plot(p[part, i], p[part, j], color=color, lw=BOLD, label=label_text(span.label))
    axis.plot(p[0, i], p[0, j], "o", color=BLACK, ms=4)
    for item in record.meta.surroundings.obstacles:
        outline = obstacle_outline(item, i, j)
        axis.fill(
            *outline.T,
            facecolor=OBSTACLE,
            edgecolor=OBSTACLE_EDGE,
            lw=LIGHT,
            alpha=0.55,
            zorder=1,
        )
        below = outline[:, 0].mean(), outline[:, 1].min()
        marks.note(
            axis,
            label_text(item.name, 16),
            below,
            (0, -2),
            ha="center",
            va="top",
            fontsize=style.points(6.5),
        )
    for k, marker in enumerate(record.meta.surroundings.markers):
        # Names stand above and below in turn: markers of two tools are near each other.
        height = 4 - 13 * (k % 2)
        place = marker.position[i], marker.position[j]
        axis.plot(*place, "*", color=BLACK, ms=7)
        marks.note(
            axis,
            label_text(marker.name),
            place,
            (5, height),
            fontsize=style.points(7),
        )


def obstacle_outline(data: meta_values.ObstacleMeta, i: int, j: int) -> np.ndarray:
    """Return corners (n, 2) [m] of what an obstacle covers, seen along the axis of W that is
    neither i nor j; of a mesh its hull.
    """
    from scipy.spatial import ConvexHull  # a quarter of a second, which few need

    points = _surface_points(data, i, j)[:, [i, j]]
    return np.asarray(points[ConvexHull(points).vertices])


def _surface_points(data: meta_values.ObstacleMeta, i: int, j: int) -> np.ndarray:
    """Return points (n, 3) [m] in W, the farthest of the obstacle in every direction of the plane
    of axes i and j among them.
    """
    item = build_obstacle(data)
    rotation = item.X_WO.rotation
    p = item.X_WO.translation
    if data.vertices:
        return np.asarray(np.array(data.vertices) @ rotation.T + p)
    angle = np.linspace(0.0, 2 * np.pi, _DIRECTIONS, endpoint=False)
    directions = np.zeros((_DIRECTIONS, 3))
    directions[:, i] = np.cos(angle)
    directions[:, j] = np.sin(angle)
    towards = directions @ rotation  # in the frame of the shape
    support = support_of(item.shape, -towards, np.zeros((_DIRECTIONS, 3)))
    return np.asarray(
        (support.centres + support.radius * towards[:, None]).reshape(-1, 3) @ rotation.T + p
    )
