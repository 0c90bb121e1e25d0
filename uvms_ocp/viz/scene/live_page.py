"""The page of a run that goes on: the scene as the run begins, and what the page's script needs to move it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.model.robot import Robot
from uvms_ocp.record import Record
from uvms_ocp.viz.scene.animation import draw_robot, frames_of, joint_node
from uvms_ocp.viz.scene.ghosts import require_fit
from uvms_ocp.viz.scene.legend import legend
from uvms_ocp.viz.scene.page.viewer import CommandLog, ScenePage, build_page
from uvms_ocp.viz.scene.page_details import page_details
from uvms_ocp.viz.scene.posed import STILL
from uvms_ocp.viz.scene.readouts import readout
from uvms_ocp.viz.scene.shapes import shifted
from uvms_ocp.viz.scene.surroundings import draw_goals, draw_obstacles, middle

_FPS = 1.0  # [Hz] of the frames of the beginning, of which the first is shown


def live_page(record: Record, robot: Robot, height: int) -> ScenePage:
    """record: how a run of `robot` begins. height [px] of its frame in a notebook. Raises `InvalidInput` as `show`."""
    require_fit(record, robot)
    frames = frames_of(record, robot, _FPS)
    centre, log = middle(record, frames), CommandLog()
    root = log.visualizer()["scene"]
    root.set_transform(shifted(-centre))
    draw_robot(root["robot"], robot)
    for joint in range(1, robot.model.njoints):
        X_WJ = pin.XYZQUATToSE3(frames.placements[0, joint])
        root["robot"][joint_node(robot.model, joint)].set_transform(X_WJ.homogeneous)
    draw_goals(root["goals"], record)
    draw_obstacles(root["obstacles"], record)
    log.animate({})
    details = STILL | page_details(record, robot, frames, centre) | _still(record) | {"live": _moved(record, robot)}
    return build_page(
        log, title=f"{record.meta.scenario}: {record.meta.robot}", details=details, height=height, live=True
    )


def _still(record: Record) -> dict[str, Any]:
    """JSON values of a page without a time line, whose readouts are filled in frame by frame."""
    return {
        "duration": 0.0,
        "speeds": (),
        "annotations": ["goals"],
        "legend": legend(record, [], [], beam=False),
        "readouts": [readout(name, np.full(1, np.nan)) for name in record.meta.quantities],
        "joints": (),
    }


def _moved(record: Record, robot: Robot) -> dict[str, Any]:
    """JSON values: nodes in the order of a frame's poses, and phases by their numbers."""
    nodes = [["meshcat", "scene", "robot", joint_node(robot.model, j)] for j in range(1, robot.model.njoints)]
    phases = [{"name": p.name, "title": p.title, "tasks": list(p.tasks), "start": 0.0} for p in record.meta.phases]
    return {"nodes": nodes, "phases": phases}
