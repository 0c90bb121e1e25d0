"""Goals that exclude each other for a while, over a receding horizon: who gives way, and what comes back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from uvms_ocp.arguments import checked
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.state import State
from uvms_ocp.ocp.clearance.ball_clearance import Ball, BallClearance
from uvms_ocp.ocp.problem import OcpLevel, OcpProblem, single_phase
from uvms_ocp.ocp.terms import At, Effort, Posture, Smoothness, TaskTerm
from uvms_ocp.tasks.attitude import HorizontalAttitude
from uvms_ocp.tasks.pose import ToolPose, VehiclePose
from uvms_ocp.tasks.reference import PoseReference

WAY, SPEED, WAIT = 0.9, 0.3, 0.5
"""[m], [m/s], [s]: how far a goal goes out, how fast, and how long it stays before and between."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class OutAndBack:
    """A goal that moves straight out and back, at rest before, between and after."""

    first: pin.SE3
    direction: np.ndarray
    """(3,) in W."""

    def __call__(self, t: float) -> tuple[pin.SE3, np.ndarray]:
        there = WAIT + WAY / SPEED
        out, back = np.clip(t - WAIT, 0, WAY / SPEED), np.clip(t - there - WAIT, 0, WAY / SPEED)
        rate = SPEED * (float(WAIT < t < there) - float(there + WAIT < t < self.returned))
        place = self.first.translation + SPEED * (out - back) * self.direction
        return pin.SE3(self.first.rotation, place), np.concatenate([rate * self.direction, np.zeros(3)])

    @property
    def returned(self) -> float:
        """[s] when it is back."""
        return 2 * (WAIT + WAY / SPEED)
