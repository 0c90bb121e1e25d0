"""Robots with one joint as few have them, each beside a twin of usual joints that moves alike."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.linalg import block_diag
from tiny_robots import ENDLESS, LIMIT, Tiny, robot_of

import uvms_ocp as uo
from uvms_ocp.robot.robot import Robot
from uvms_ocp.tasks import (
    HorizontalAttitude,
    JointLimits,
    MinimumAltitude,
    ToolPosition,
    VehiclePose,
)

_FIRST = ("revolute", "0 0 1", LIMIT)
_LAST = ("revolute", "0 1 0", LIMIT)
_FAST = '<limit lower="-50" upper="50" effort="1e3" velocity="0.8"/>'
_SLIDES = f"""<link name="aside"/><link name="ahead"/>
<joint name="slide0" type="prismatic"><parent link="arm0"/><child link="ahead"/><origin xyz="0.3 0 0"/>
  <axis xyz="1 0 0"/>{_FAST}</joint>
<joint name="slide1" type="prismatic"><parent link="ahead"/><child link="aside"/>
  <axis xyz="0 1 0"/>{_FAST}</joint>
<joint name="turn1" type="revolute"><parent link="aside"/><child link="arm1"/>
  <axis xyz="0 0 1"/>{_FAST}</joint>"""


class _SlidingTwin(Tiny):
    """Its second joint is two that slide and one that turns, as fast as a planar joint is taken to
    be.
    """

    def write(self, folder: Path) -> Path:
        super().write(folder)
        urdf = folder / "robot.urdf"
        water = folder / "hydrodynamics.yaml"
        before, _, after = urdf.read_text(encoding="utf-8").partition('<joint name="turn1"')
        urdf.write_text(before + _SLIDES + after.partition("</joint>")[2], encoding="utf-8")
        quick = (
            "joints: {slide0: {acceleration: 2.0}, slide1: {acceleration: 2.0}, turn1:"
            " {acceleration: 2.0}}\n"
        )
        water.write_text(water.read_text(encoding="utf-8") + quick, encoding="utf-8")
        return folder


def _with(kind: str, axis: str, limit: str) -> Tiny:
    return Tiny(joints=(_FIRST, (kind, axis, limit), _LAST))


_NO_RANGE = '<limit lower="0" upper="0" effort="8" velocity="0.7"/>'
_TURN = '<limit lower="-3.1" upper="3.1" effort="8" velocity="0.7"/>'
ODD = {
    "continuous": (_with(*ENDLESS), _with("revolute", "0 1 0", _TURN)),
    "planar": (
        _with("planar", "0 0 1", ""),
        _SlidingTwin(joints=(_FIRST, ("revolute", "0 0 1", ""), _LAST)),
    ),
    "zero range": (_with("revolute", "0 1 0", _NO_RANGE), _with("fixed", "0 1 0", "")),
}
"""The one with the joint, its second of three, and its twin."""


PLANE = slice(8, 12)
"""Of the configuration, the numbers of the planar joint: along, across, cosine and sine of its
turn.
"""


@dataclass(frozen=True)
class Pair:
    kind: str
    odd: Robot
    twin: Robot

    def of_twin(self, q: np.ndarray) -> np.ndarray:
        """The configuration (n_q,) of the twin at one of the odd robot."""
        first, *between, last = self.odd.joint_values(q)
        if self.kind == "planar":
            x, y, c, s = q[PLANE]
            between = [x, y, np.arctan2(s, c)]
        if self.kind == "zero range":
            between = []
        vehicle_moved = np.concatenate([q[:7], np.zeros(self.twin.n_joints)])
        return self.twin.with_joint_values(vehicle_moved, np.array([first, *between, last]))

    def velocities(self, q: np.ndarray) -> np.ndarray:
        """(n_v of the twin, n_v) from velocities of the odd robot at q (n_q,) to those of the
        twin.
        """
        if self.kind == "zero range":
            return np.delete(np.eye(self.odd.n_v), 7, axis=0)
        if self.kind == "continuous":
            return np.eye(self.odd.n_v)
        c, s = q[PLANE][2:]  # the velocity of a planar joint is along its own axes
        return block_diag(np.eye(7), [[c, -s], [s, c]], np.eye(2))


@cache
def pair_of(kind: str) -> Pair:
    return Pair(kind, *map(robot_of, ODD[kind]))


def start_of(robot: Robot) -> np.ndarray:
    return robot.configuration(
        position=(0.0, 0.0, -5.0), rpy=(0.0, 0.0, 0.2), joints={"turn0": 0.3, "turn2": -0.5}
    )


def places(robot: Robot, q: np.ndarray) -> np.ndarray:
    """(n, 6) [m] of vehicle and tool at configurations (n, n_q)."""
    data = robot.model.createData()
    frames = [robot.frame_id(name) for name in ("base_link", "tool")]
    rows = []
    for row in np.atleast_2d(q):
        pin.framesForwardKinematics(robot.model, data, row)
        rows.append(np.concatenate([data.oMf[frame].translation for frame in frames]))
    return np.array(rows)


def reach_of(robot: Robot, **options: Any) -> uo.Scenario:
    """A tool to its target, and the vehicle near where it is."""
    start = start_of(robot)
    tool = places(robot, start)[0, 3:] + [0.25, 0.15, -0.1]
    vehicle = VehiclePose(goal=uo.pose_at((0.1, 0.05, -5.0), (0.0, 0.0, 0.3)))
    tasks = [
        JointLimits(),
        MinimumAltitude(),
        HorizontalAttitude(),
        ToolPosition(goal=uo.pose_at(tuple(tool))),
        vehicle,
    ]
    arrived = uo.Below(quantity="TP.position_error", limit=0.02)
    end = uo.Transition(to=uo.DONE, when=(arrived,), hold=0.5)
    phase = uo.Phase(
        name="reach", activations={task.name: 1.0 for task in tasks}, transitions=(end,)
    )
    return uo.Scenario(
        name="odd",
        robot=robot,
        mission=uo.Mission(hierarchy=uo.Hierarchy(tasks), phases=(phase,)),
        environment=uo.Environment(seafloor=uo.FlatSeafloor(z=-10.0)),
        start=start,
        dt=0.02,
        duration=12.0,
        **options,
    )
