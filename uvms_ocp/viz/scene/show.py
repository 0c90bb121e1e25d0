"""The scene of a record, a plan or a robot: a file, or a value that a notebook displays."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.arguments import checked
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.files.library import list_robots
from uvms_ocp.model.loading import load_robot
from uvms_ocp.model.robot import Robot
from uvms_ocp.ocp.plan import Plan
from uvms_ocp.record import Record
from uvms_ocp.viz.scene.animation import Frames, beam_clip, draw_beam, draw_robot, frames_of, joint_clips, joint_node
from uvms_ocp.viz.scene.arrows import arrow_groups
from uvms_ocp.viz.scene.ghosts import NO_GHOSTS, Ghost, ghosts_of, require_fit
from uvms_ocp.viz.scene.legend import legend
from uvms_ocp.viz.scene.meshcat_parts import Visualizer
from uvms_ocp.viz.scene.page.viewer import CommandLog, ScenePage, build_page
from uvms_ocp.viz.scene.page_details import page_details
from uvms_ocp.viz.scene.posed import posed_page
from uvms_ocp.viz.scene.readouts import readouts
from uvms_ocp.viz.scene.shapes import shifted
from uvms_ocp.viz.scene.surroundings import draw_goals, draw_obstacles, draw_trails, middle
from uvms_ocp.viz.scene.time_line import time_line
from uvms_ocp.viz.scene.witness import witness_lines

_MOST_FPS = 1000  # [Hz]


@checked
def write_scene(
    record: Record, robot: Robot, path: Path | str, fps: float = 25, *, ghosts: Mapping[str, Record | Plan] = NO_GHOSTS
) -> Path:
    """Write the animated scene as one HTML file without outside references; returns its path.

    fps [Hz]: frames per second. ghosts, by name: other motions of the robot, drawn translucent beside it. Raises
    `InvalidInput` as `show`, and `OutputError` where `path` cannot be written.
    """
    return show(record, robot, ghosts=ghosts, fps=fps).write(path)


@checked
def show(
    what: Record | Plan | Robot,
    robot_or_q: Robot | np.ndarray | None = None,
    *,
    ghosts: Mapping[str, Record | Plan] = NO_GHOSTS,
    fps: float = 25,
    height: int = 520,
) -> ScenePage:
    """A record or a plan as an animation, a robot with sliders for its joints: a page that notebooks display `height` [px] high.

    robot_or_q: the robot of a record, unless it is one of `list_robots`, or the configuration q (n_q,) [m, rad] of a robot,
    at home by default; a plan knows its own robot. ghosts, by name: other motions of the same robot, drawn translucent at
    the same times, such as another run or the plan that was followed. fps [Hz]: frames per second. Raises `InvalidInput`
    where a record is not of this robot or has nothing to draw, and for an fps that is not positive.
    """
    if not 0 < fps <= _MOST_FPS:
        raise InvalidInput(f"fps = {fps}; give a number > 0, of {_MOST_FPS} at most")
    if isinstance(what, Robot):
        if ghosts or isinstance(robot_or_q, Robot):
            raise InvalidInput("a robot alone does not move; give show(robot, q), or a record and its robot")
        return posed_page(what, _configuration(what, robot_or_q), height)
    if isinstance(robot_or_q, np.ndarray):
        raise InvalidInput("a record and a plan know their configurations; give show(robot, q) for one of your own")
    robot = what.robot if isinstance(what, Plan) else robot_or_q or robot_of(what)
    others = {name: _record_of(ghost) for name, ghost in ghosts.items()}
    return _page(_record_of(what), robot, others, fps, height)


def _configuration(robot: Robot, q: np.ndarray | None) -> np.ndarray:
    """A checked q (n_q,) [m, rad]; at home where none is given."""
    try:
        return robot.configuration() if q is None else robot.check_configuration(q)
    except InvalidInput as error:
        raise InvalidInput(f"robot_or_q: {error}") from error


def robot_of(record: Record) -> Robot:
    """The robot of that name in the library. Raises `InvalidInput` where there is none."""
    name = record.meta.robot
    if name not in list_robots():
        raise InvalidInput(f"a record of {name} does not hold its robot; give it: --robot DIR, or show(record, robot)")
    return load_robot(name)


def _record_of(what: Record | Plan) -> Record:
    return what.to_record() if isinstance(what, Plan) else what


def _page(record: Record, robot: Robot, others: Mapping[str, Record], fps: float, height: int) -> ScenePage:
    require_fit(record, robot)
    frames, ghosts = frames_of(record, robot, fps), list(ghosts_of(others, robot, fps))
    centre = middle(record, frames)
    log = CommandLog()
    root = log.visualizer()["scene"]
    root.set_transform(shifted(-centre))  # keeps 32-bit floats exact and the lights near
    trails, beam = _draw(log, root, record, robot, frames, ghosts, fps)
    details = page_details(record, robot, frames, centre) | time_line(record) | readouts(record, frames)
    details |= {
        "trails": [*trails, *(trail for ghost in ghosts for trail in _ghost_trails(root, robot, ghost))],
        "arrows": arrow_groups(record, robot, frames, details["size"]),
        "witness": witness_lines(record, robot, frames, centre),
        "legend": legend(record, trails, ghosts, beam=beam),
        "annotations": ["trails", "goals", "beam", *(ghost.node for ghost in ghosts)],
        "joints": (),
    }
    details["duration"] = max(frames.t[-1], *(ghost.frames.t[-1] for ghost in ghosts), 0.0)
    return build_page(log, title=f"{record.meta.scenario}: {record.meta.robot}", details=details, height=height)


def _draw(
    log: CommandLog, root: Visualizer, record: Record, robot: Robot, frames: Frames, ghosts: list[Ghost], fps: float
) -> tuple[list[dict[str, Any]], bool]:
    """Everything that meshcat draws and moves; returns the trails, and whether there is a beam."""
    draw_robot(root["robot"], robot)
    for ghost in ghosts:
        draw_robot(root[ghost.node], robot, ghost.rgba)
    draw_goals(root["goals"], record)
    draw_obstacles(root["obstacles"], record)
    clips: dict[Any, Any] = {}
    for node, moved in (("robot", frames), *((ghost.node, ghost.frames) for ghost in ghosts)):
        clips |= {root[node][joint_node(robot.model, j)].path: clip for j, clip in joint_clips(robot, moved, fps)}
    beam = frames.altimeter is not None and "altimeter_range" in record.series
    if beam:
        draw_beam(root["beam"])
        clips[root["beam"].path] = beam_clip(frames, record["altimeter_range"][frames.row], fps)
    log.animate(clips)
    return draw_trails(root["trails"], robot, frames), beam


def _ghost_trails(root: Visualizer, robot: Robot, ghost: Ghost) -> list[dict[str, Any]]:
    """Those of a ghost, which stand below its node."""
    return draw_trails(root[ghost.node]["trails"], robot, ghost.frames, (ghost.rgb, ghost.rgb))
