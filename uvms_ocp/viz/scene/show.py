"""Show a record, a plan or a robot as a page: a file, or a value that a notebook displays."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput
from uvms_ocp.ocp.plan import Plan
from uvms_ocp.record.record import Record
from uvms_ocp.robot import Robot, list_robots, load_robot, recorded_robots
from uvms_ocp.viz.scene import animation, shapes
from uvms_ocp.viz.scene.animation import Frames, draw_robot, joint_node, require_fit
from uvms_ocp.viz.scene.arrows import arrow_groups
from uvms_ocp.viz.scene.colours import GHOST_OPACITY
from uvms_ocp.viz.scene.details import legend, page_details, readouts, time_line
from uvms_ocp.viz.scene.ghosts import NO_GHOSTS, Ghost, ghosts_of
from uvms_ocp.viz.scene.page import CommandLog, ScenePage, Visualizer, build_page
from uvms_ocp.viz.scene.posed import links, posed_page
from uvms_ocp.viz.scene.surroundings import draw_goals, draw_obstacles, draw_trails, middle
from uvms_ocp.viz.scene.witness_lines import witness_lines

_STILLS = 8  # about, moments at which the robot is drawn where scripts do not run

_MOST_FPS = 1000  # [Hz]


@checked
def write_scene(
    record: Record,
    robot: Robot,
    path: Path | str,
    fps: float = 25,
    *,
    ghosts: Mapping[str, Record | Plan] = NO_GHOSTS,
) -> Path:
    """Write the animated scene as one HTML file without outside references; returns its path.

    fps [Hz]: frames per second. ghosts, by name: other motions of the robot, drawn translucent
    beside it. Raises `InvalidInput` as `show`, and `OutputError` where `path` cannot be written.
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
    """Return a record or a plan as an animation, a robot with sliders for its joints: a page that
    notebooks display `height` [px] high.

    robot_or_q: the robot of a record, by default the one of its files or name, or the configuration
    q (n_q,) [m, rad] of a robot, at home by default; a plan knows its own robot. ghosts, by name:
    other motions of the same robot, drawn translucent at the same times, such as another run or the
    plan that was followed. fps [Hz]: frames per second. Raises `InvalidInput` where a record is not
    of this robot or has nothing to draw, and for an fps that is not positive.
    """
    if not 0 < fps <= _MOST_FPS:
        raise InvalidInput(f"fps = {fps}; give a number > 0, of {_MOST_FPS} at most")
    if isinstance(what, Robot):
        if ghosts or isinstance(robot_or_q, Robot):
            raise InvalidInput(
                "a robot alone does not move; give show(robot, q), or a record and its robot"
            )
        return posed_page(what, _configuration(what, robot_or_q), height)
    if isinstance(robot_or_q, np.ndarray):
        raise InvalidInput(
            "a record and a plan know their configurations; give show(robot, q) for one of your own"
        )
    if isinstance(what, Plan):
        robot = what.robot
    else:
        robot = robot_or_q or robot_of(what)
    return _page(
        _record_of(what),
        robot,
        {name: _record_of(ghost) for name, ghost in ghosts.items()},
        fps,
        height,
    )


def _configuration(robot: Robot, q: np.ndarray | None) -> np.ndarray:
    """Return a checked q (n_q,) [m, rad]; at home where none is given."""
    try:
        if q is None:
            return robot.configuration()
        return robot.check_configuration(q)
    except InvalidInput as error:
        raise InvalidInput(f"robot_or_q: {error}") from error


def robot_of(record: Record, folder: Path | None = None) -> Robot:
    """Return the robot of one's own of a record in that folder, or the one of that name in the
    library.

    Raises `InvalidInput` where there is none, or its files have been moved.
    """
    name = record.meta.robot
    files = record.meta.robot_files
    if files is None and name in list_robots():
        return load_robot(name)
    if files is None:
        robot = None
    else:
        robot = recorded_robots.recorded_robot(name, files, folder or Path.cwd())
    if robot is None:
        if files:
            location = f"which is no longer at {files.urdf}"
        else:
            location = "which does not hold its robot"
        raise InvalidInput(
            f"a record of {name}, {location}; give it: --robot DIR, or show(record, robot)"
        )
    return robot


def _record_of(motion: Record | Plan) -> Record:
    if isinstance(motion, Plan):
        return motion.to_record()
    return motion


def _page(
    record: Record, robot: Robot, ghost_records: Mapping[str, Record], fps: float, height: int
) -> ScenePage:
    require_fit(record, robot)
    frames = animation.frames_of(record, robot, fps)
    ghosts = list(ghosts_of(ghost_records, robot, fps))
    centre = middle(record, frames)
    log = CommandLog()
    root = log.visualizer()["scene"]
    root.set_transform(shapes.shifted(-centre))  # keeps 32-bit floats exact and the lights near
    trails, beam = _draw(log, root, record, robot, frames, ghosts, fps)
    ghost_trails: list[dict[str, Any]] = []
    for ghost in ghosts:
        ghost_trails += draw_trails(root[ghost.node]["trails"], robot, ghost.frames, ghost.rgb)
    details = page_details(record, robot, frames, centre)
    details |= time_line(record)
    details |= readouts(record, frames)
    details |= {
        "trails": trails + ghost_trails,
        "arrows": arrow_groups(record, robot, frames, details["size"]),
        "witness": witness_lines(record, robot, frames, centre),
        "legend": legend(record, trails, ghosts, beam=beam),
        "annotations": ["trails", "goals", "beam", *(ghost.node for ghost in ghosts)],
    }
    details["duration"] = max(frames.t[-1], *(ghost.frames.t[-1] for ghost in ghosts), 0.0)
    path = frames.placements[:: max(1, len(frames.t) // 100), 1, :3]
    lines = [path]
    for places in frames.placements[:: max(1, len(frames.t) // _STILLS), :, :3]:
        lines += links(robot, places)
    return build_page(
        log,
        title=f"{record.meta.scenario}: {record.meta.robot}",
        details=details,
        height=height,
        lines=lines,
    )


def _draw(
    log: CommandLog,
    root: Visualizer,
    record: Record,
    robot: Robot,
    frames: Frames,
    ghosts: list[Ghost],
    fps: float,
) -> tuple[list[dict[str, Any]], bool]:
    """Draw everything that meshcat draws and moves; returns the trails, and whether there is a
    beam.
    """
    draw_robot(root["robot"], robot)
    for ghost in ghosts:
        draw_robot(root[ghost.node], robot, (*ghost.rgb, GHOST_OPACITY))
    draw_goals(root["goals"], record)
    draw_obstacles(root["obstacles"], record)
    clips: dict[Any, Any] = {
        root["goals"][name].path: clip for name, clip in animation.goal_clips(record, frames, fps)
    }
    frames_by_node = {"robot": frames}
    for ghost in ghosts:
        frames_by_node[ghost.node] = ghost.frames
    for node, node_frames in frames_by_node.items():
        for joint, clip in animation.joint_clips(robot, node_frames, fps):
            clips[root[node][joint_node(robot.model, joint)].path] = clip
    beam = frames.altimeter is not None and "altimeter_range" in record.series
    if beam:
        animation.draw_beam(root["beam"])
        clips[root["beam"].path] = animation.beam_clip(
            frames, record["altimeter_range"][frames.row], fps
        )
    log.animate(clips)
    return draw_trails(root["trails"], robot, frames), beam
