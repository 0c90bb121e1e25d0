"""The scene of a record: a file, or a value that a notebook displays."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from uvms_ocp.arguments import checked
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.robot import Robot
from uvms_ocp.ocp.plan import Plan
from uvms_ocp.record import Record
from uvms_ocp.viz.scene.animation import Frames, beam_clip, draw_beam, draw_robot, frames_of, joint_clips, joint_node
from uvms_ocp.viz.scene.page_details import page_details
from uvms_ocp.viz.scene.shapes import shifted
from uvms_ocp.viz.scene.surroundings import draw_goals, draw_obstacles, draw_trails, extent
from uvms_ocp.viz.scene.viewer import CommandLog, ScenePage, build_page
from uvms_ocp.viz.series import require_rows

_MOST_FPS = 1000  # [Hz]


@checked
def write_scene(record: Record, robot: Robot, path: Path | str, fps: float = 25) -> Path:
    """Write the animated scene as one HTML file without outside references; returns its path.

    fps [Hz]: frames per second. Raises `InvalidInput` as `show`, and `OutputError` where `path` cannot be written.
    """
    return show(record, robot, fps=fps).write(path)


@checked
def show(what: Record | Plan, robot: Robot | None = None, *, fps: float = 25, height: int = 520) -> ScenePage:
    """The same scene as a value that a notebook displays in a frame `height` [px] high.

    robot: of a record; a plan knows its own. fps [Hz]: frames per second. Raises `InvalidInput` where the record is not of
    this robot or has nothing to draw, and for an fps that is not positive.
    """
    if isinstance(what, Plan):
        return _page(what.to_record(), what.robot, fps, height)
    if robot is None:
        raise InvalidInput(f"a record of {what.meta.robot} does not hold its robot; give it: show(record, robot)")
    return _page(what, robot, fps, height)


def _page(record: Record, robot: Robot, fps: float, height: int) -> ScenePage:
    _check(record, robot, fps)
    frames = frames_of(record, robot, fps)
    centre = _centre(record, frames)
    log = CommandLog()
    root = log.visualizer()["scene"]
    root.set_transform(shifted(-centre))  # keeps 32-bit floats exact and the lights near
    draw_robot(root["robot"], robot)
    trails = draw_trails(root["trails"], robot, frames)
    draw_goals(root["goals"], record)
    draw_obstacles(root["obstacles"], record)
    clips = {root["robot"][joint_node(robot.model, j)].path: clip for j, clip in joint_clips(robot, frames, fps)}
    if frames.altimeter is not None and "altimeter_range" in record.series:
        draw_beam(root["beam"])
        clips[root["beam"].path] = beam_clip(frames, record["altimeter_range"][frames.row], fps)
    log.animate(clips)
    details = page_details(record, robot, frames, centre) | {"trails": trails}
    return build_page(log, title=f"{record.meta.scenario}: {record.meta.robot}", details=details, height=height)


def _check(record: Record, robot: Robot, fps: float) -> None:
    require_rows(record)
    if not 0 < fps <= _MOST_FPS:
        raise InvalidInput(f"fps = {fps}; give a number > 0, of {_MOST_FPS} at most")
    if record["q"].shape[1] != robot.n_q:
        given = record["q"].shape[1]
        raise InvalidInput(f"record has {given} configuration values, {robot.name} has {robot.n_q}; give its own robot")


def _centre(record: Record, frames: Frames) -> np.ndarray:
    """Middle (3,) [m] of all that moves and all goals, on the floor where there is one."""
    points = extent(record, frames)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    floor = record.meta.surroundings.floor_z
    return np.array([middle[0], middle[1], middle[2] if floor is None else floor])
