"""What truly became of a run with faults: contact, limits, the way, and whether the robot said what
was wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from studies.fault_table import NEW, NEW_RATES, RATES
from uvms_ocp.record.record import Record
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.hull import skid_points
from uvms_ocp.robot.spatial import quaternion_to_matrix
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim.faults import Fault

LANDED = "D"
"""The phase in which Case 1 rests on the floor."""
_EVERY = 10  # rows between two that are looked at for the arm and the way


@dataclass(frozen=True, kw_only=True, slots=True)
class Contact:
    """Contact of the skid with the floor that was no landing."""

    seconds: float
    """[s]"""
    depth: float
    """[m] of the deepest corner, 0 without any."""
    at_the_end: bool
    """Whether the run ended in it."""


def contact_outside_landing(scenario: Scenario, record: Record, allowed: float = 0.0) -> Contact:
    """Contact deeper than `allowed` [m] that the mission did not take for its landing, by going on
    to rest on the floor.
    """
    depth = _depths(scenario, record["q"]) - allowed
    landed = np.array([phase.name == LANDED for phase in record.meta.phases])[record["phase"]]
    outside = np.zeros(len(depth), dtype=bool)
    for rows in _episodes(depth > 0.0):
        outside[rows] = not landed[rows].any()
    return Contact(
        seconds=float(outside.sum()) * scenario.dt,
        depth=float(np.max(depth, where=outside, initial=0.0)),
        at_the_end=bool(outside[-1]),
    )


def _depths(scenario: Scenario, q: np.ndarray) -> np.ndarray:
    """(n,) [m] of the lowest corner of the skid below the floor, at q (n, n_q); infinite where that
    is no number.
    """
    points = skid_points(scenario.robot)
    height = scenario.environment.seafloor.height
    depths = np.full(len(q), np.inf)
    for row in np.flatnonzero(np.isfinite(q).all(axis=1)):
        corners = points @ quaternion_to_matrix(q[row, 3:7]).T + q[row, :3]
        corner_depths = [height(x, y) - z for x, y, z in corners.tolist()]
        depths[row] = max(corner_depths)
    return depths


def _episodes(touching: np.ndarray) -> list[slice]:
    """Stretches of rows."""
    edges = np.flatnonzero(np.diff(np.r_[0, touching.astype(int), 0]))
    return [slice(begin, end) for begin, end in zip(edges[::2], edges[1::2], strict=True)]


def joint_excess(robot: Robot, q: np.ndarray) -> float:
    """How far [rad] any joint was beyond its limits at q (n, n_q) [m, rad]; infinite where that is
    no number.
    """
    joints = q[:, robot.joint_q]
    limits = robot.limits
    beyond = np.maximum(limits.position_lower - joints, joints - limits.position_upper).max()
    if not np.isfinite(beyond):
        return np.inf
    return max(float(beyond), 0.0)


def rate_share(robot: Robot, v: np.ndarray) -> float:
    """The largest true velocity of a joint at v (n, n_v) [m/s, rad/s], as a share of its limit;
    infinite where no number.
    """
    shares = np.abs(v[:, robot.joint_v]) / robot.limits.velocity[robot.joint_v]
    if not np.isfinite(shares).all():
        return np.inf
    return float(shares.max(initial=0.0))


def passes_rates(robot: Robot, record: Record, onsets: Sequence[float]) -> bool:
    """Whether any joint's true velocity passes its limit by more than it may; onsets [s] of
    faults.
    """
    t = record["t"]
    v = record["v"]
    is_new = np.zeros(len(t), bool)
    for onset in onsets:
        is_new |= (t >= onset) & (t <= onset + NEW)
    passes = False
    if not is_new.all():
        passes |= rate_share(robot, v[~is_new]) > RATES
    if is_new.any():
        passes |= rate_share(robot, v[is_new]) > NEW_RATES
    return passes


def arm_height(scenario: Scenario, q: np.ndarray) -> float:
    """The least height [m] above the floor of any joint of the arm and of the tool at q (n, n_q)
    [m, rad].
    """
    robot = scenario.robot
    floor = scenario.environment.seafloor
    data = robot.model.createData()
    tool = robot.frame_id("tool")
    lowest = np.inf
    for row in q[::_EVERY]:
        if not np.isfinite(row).all():
            return -np.inf
        pin.framesForwardKinematics(robot.model, data, row)
        for X in (*data.oMi[2:], data.oMf[tool]):
            x, y, z = X.translation
            lowest = min(lowest, z - floor.height(x, y))
    return float(lowest)


def astray(way: np.ndarray, q: np.ndarray) -> float:
    """The farthest distance [m] of the vehicle at q (n, n_q) [m, rad] from the points way (m, 3)
    [m]; inf where no number.
    """
    from scipy.spatial import cKDTree  # a quarter of a second, which few need

    places = q[::_EVERY, :3]
    if not np.isfinite(places).all():
        return np.inf
    distances, _ = cKDTree(way).query(places)
    return float(distances.max())


def is_named(faults: Sequence[Fault], robot: Robot, texts: Sequence[str]) -> bool:
    """Whether all that is wrong is named in any of the texts."""
    all_texts = " ".join(texts).lower().replace("_", " ")
    for fault in faults:
        words = _words(fault, robot)
        if not any(word in all_texts for word in words):
            return False
    return True


def _words(fault: Fault, robot: Robot) -> list[str]:
    """Any of which names what the fault strikes."""
    name = fault.target
    number = fault.location.number
    family = fault.location.family
    words = [name, name.removesuffix("_range")]
    if family == "thruster":
        words += [f"thruster {number}", robot.description.thrusters[number - 1].name]
    elif family in ("joint", "encoder"):
        words += [fault.location.channel or name, robot.joint_names[number - 1]]
    elif family in ("current", "payload"):
        words += ["disturbance"]
    return [word.lower().replace("_", " ") for word in words]
