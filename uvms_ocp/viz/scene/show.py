"""Show a record, a plan or a robot as a page: a file, or a value that a notebook displays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput
from uvms_ocp.ocp.plan import Plan
from uvms_ocp.record.record import Record
from uvms_ocp.robot import Robot, list_robots, load_robot, recorded_robots
from uvms_ocp.viz.scene import animation, shapes
from uvms_ocp.viz.scene.animation import (
    NO_GHOSTS,
    Frames,
    Ghost,
    draw_robot,
    joint_node,
    require_fit,
)
from uvms_ocp.viz.scene.details import legend, page_details, readouts, robot_details, time_line
from uvms_ocp.viz.scene.page import CommandLog, ScenePage, Visualizer, build_page
from uvms_ocp.viz.scene.surroundings import (
    arrow_groups,
    draw_goals,
    draw_obstacles,
    draw_trails,
    middle,
    witness_lines,
)

# A robot that stands still in a configuration, and what the page needs to move its joints by
# sliders.

_AROUND = 5.0  # [m] that the vehicle can be moved either way
_N_FREE = 6
_STILLS = 8  # about, moments at which the robot is drawn where scripts do not run
_UNLIMITED = {"turn": np.pi, "slide": 1.0}  # [rad], [m] either way where a joint has no limit

_MOST_FPS = 1000  # [Hz]


def posed_page(
    robot: Robot, q: np.ndarray, height: int, live: Mapping[str, Any] | None = None
) -> ScenePage:
    """Return the page of `robot` in the configuration q (n_q,) [m, rad]; height [px] of its frame
    in a notebook. live: JSON values.
    """
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    places = np.array([X.translation for X in list(data.oMi)[1:]])
    centre = (places.min(axis=0) + places.max(axis=0)) / 2
    log = CommandLog()
    draw_still(log, robot, list(data.oMi), centre)
    log.animate({})
    details = robot_details(robot) | {"scenario": robot.name, "points": (places - centre).tolist()}
    details |= {
        "joints": [joint_motion(robot, joint, q) for joint in range(1, robot.model.njoints)],
        "robot": "",
        "live": live,
    }
    lines = _links(robot, np.vstack([centre, places]))
    return build_page(
        log, title=robot.name, details=details, height=height, live=live is not None, lines=lines
    )


def _links(robot: Robot, places: np.ndarray) -> list[np.ndarray]:
    """Return lines from joint to joint, at their places (n_joints + 1, 3) [m]."""
    return [places[[parent, joint]] for joint, parent in enumerate(robot.model.parents) if parent]


def draw_still(
    log: CommandLog, robot: Robot, placements: Sequence[pin.SE3], centre: np.ndarray
) -> Visualizer:
    """Draw the robot by the placements of its joints; return the root of the scene, whose origin is
    `centre` (3,) [m] in W.
    """
    root = log.visualizer()["scene"]
    root.set_transform(shapes.shifted(-centre))
    draw_robot(root["robot"], robot)
    for joint in range(1, robot.model.njoints):
        root["robot"][joint_node(robot.model, joint)].set_transform(placements[joint].homogeneous)
    return root


def joint_motion(robot: Robot, joint: int, q: np.ndarray) -> dict[str, Any]:
    """Return the transform of a joint of the model, by number, from its values at q (n_q,) [m,
    rad].
    """
    model = robot.model
    model_joint = robot.model.joints[joint]
    data = model_joint.createData()
    model_joint.calc(data, q)
    return {
        "path": ["meshcat", "scene", "robot", joint_node(model, joint)],
        "parent": int(model.parents[joint]) - 1,
        "placement": pin.SE3ToXYZQUAT(model.jointPlacements[joint]).tolist(),
        "name": model.names[joint],
        **_motion(robot, model_joint, data, q),
    }


def _motion(robot: Robot, joint_model: Any, data: Any, q: np.ndarray) -> dict[str, Any]:
    """Return the kind of a joint, its axis (3,), ranges and values [rad] or [m] at q (n_q,) [m,
    rad]; `held`: without.
    """
    if joint_model.nv == _N_FREE and robot.n_vehicle:
        place = data.M.translation
        turn = pin.rpy.matrixToRpy(data.M.rotation)
        ranges = [(x - _AROUND, x + _AROUND) for x in place.tolist()] + [(-np.pi, np.pi)] * 3
        return {"kind": "free", "ranges": ranges, "values": [*place.tolist(), *turn.tolist()]}
    axis = np.asarray(data.S).reshape(6, -1)
    if np.abs(axis[3:]).any():
        kind = "turn"
        along = axis[3:, 0]
    else:
        kind = "slide"
        along = axis[:3, 0]
    if not joint_model.nv:  # it mimics another one
        mimic = joint_model.extract()
        leader = next(
            joint
            for joint in robot.model.joints
            if joint.idx_v == joint_model.idx_v and joint.nv == 1
        )
        follows = [leader.id - 1, mimic.scaling, mimic.offset]
        return {
            "kind": kind,
            "axis": (along / mimic.scaling).tolist(),
            "values": [0.0],
            "follows": follows,
        }
    if joint_model.nv != 1 or (np.abs(axis[:3]).any() and np.abs(axis[3:]).any()):
        return {"kind": "held", "pose": pin.SE3ToXYZQUAT(data.M).tolist(), "values": [0.0]}
    value = (
        q[joint_model.idx_q] if joint_model.nq == 1 else pin.log3(data.M.rotation) @ along
    )  # an endless turn has two numbers
    return {
        "kind": kind,
        "axis": along.tolist(),
        "values": [float(value)],
        "ranges": [_range(robot, joint_model, kind)],
    }


def _range(robot: Robot, joint_model: Any, kind: str) -> tuple[float, float]:
    """Return the range between the joint's limits [rad] or [m]."""
    k = joint_model.idx_v - robot.n_vehicle
    lower = float(robot.limits.position_lower[k])
    upper = float(robot.limits.position_upper[k])
    unlimited = _UNLIMITED[kind]
    if not np.isfinite(lower):
        lower = -unlimited
    if not np.isfinite(upper):
        upper = unlimited
    return lower, upper


# The scene of a record, a plan or a robot: a file, or a value that a notebook displays.


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
        location = (
            f"which is no longer at {files.urdf}" if files else "which does not hold its robot"
        )
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
    ghosts = list(animation.ghosts_of(ghost_records, robot, fps))
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
        lines += _links(robot, places)
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
        draw_robot(root[ghost.node], robot, (*ghost.rgb, animation.OPACITY))
    draw_goals(root["goals"], record)
    draw_obstacles(root["obstacles"], record)
    clips: dict[Any, Any] = {
        root["goals"][name].path: clip for name, clip in animation.goal_clips(record, frames, fps)
    }
    for node, placements in (("robot", frames), *((ghost.node, ghost.frames) for ghost in ghosts)):
        clips |= {
            root[node][joint_node(robot.model, j)].path: clip
            for j, clip in animation.joint_clips(robot, placements, fps)
        }
    beam = frames.altimeter is not None and "altimeter_range" in record.series
    if beam:
        animation.draw_beam(root["beam"])
        clips[root["beam"].path] = animation.beam_clip(
            frames, record["altimeter_range"][frames.row], fps
        )
    log.animate(clips)
    return draw_trails(root["trails"], robot, frames), beam
