"""Way point, alignment, landing and tool frame as one problem with free durations ([Gao2022] Case 1, without greed).

A mission that is carried out phase by phase makes each phase as good as it can be and leaves the next one what is left:
a landing place from which the tool cannot reach, or thrust spent on haste. Here all phases are decided together.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import pinocchio as pin

from uvms_ocp.arguments import AtLeastOne, Bound, Magnitude, Range, Vector3, checked
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.state import State
from uvms_ocp.ocp.problem import OcpLevel, OcpPhase, OcpProblem
from uvms_ocp.ocp.terms import At, AtRest, Effort, Energy, Smoothness, TaskTerm
from uvms_ocp.tasks.altitude import LandingAltitude, MinimumAltitude
from uvms_ocp.tasks.attitude import Alignment, HorizontalAttitude
from uvms_ocp.tasks.pose import ToolPose, ToolPosition
from uvms_ocp.tasks.velocity import NullVelocity


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class WholeMission:
    """Goals of the four phases, and how long each may take."""

    way_point: pin.SE3
    """X_WB"""
    target: Annotated[Vector3, Range(open=True)]
    """(3,) [m] in W"""
    tool_goal: pin.SE3
    """X_WT"""
    durations: tuple[tuple[Magnitude, Magnitude], ...]
    """[s] shortest and longest of A, B, C, D"""
    n_steps: tuple[AtLeastOne, AtLeastOne, AtLeastOne, AtLeastOne] = (24, 8, 16, 16)
    arrival: Magnitude = 0.1
    """[m] distance to the way point that ends A"""
    misalignment: Magnitude = 0.07
    """[rad] that ends B, and holds through C"""
    altitude: Magnitude = 0.19
    """[m] on the altimeter that ends C; the hull touches at 0.17"""
    minimum_altitude: Magnitude = 1.0
    """[m] in A and B"""
    tilt: Magnitude = 0.1
    """[rad] at most"""
    current: Annotated[Vector3, Range(open=True)] | None = None
    """(3,) [m/s]"""


@checked
def whole_mission(robot: Robot, start: State, mission: WholeMission, *, floor: Bound) -> OcpProblem:
    """One problem over all phases: goals first, energy below them, smoothness of thrust last.

    floor [m]: height of the seafloor.
    """
    names = ("A", "B", "C", "D")
    phases = tuple(
        OcpPhase(name=name, n_steps=n, duration=duration)
        for name, n, duration in zip(names, mission.n_steps, mission.durations, strict=True)
    )
    return OcpProblem(
        robot=robot,
        start=start,
        phases=phases,
        levels=(
            OcpLevel(name="goals", terms=_goals(mission)),
            OcpLevel(name="energy", terms=(Energy(), Smoothness(weight=0.0025), Effort(weight=0.0025))),
        ),
        constraints=_constraints(mission),
        current=np.zeros(3) if mission.current is None else mission.current,
        floor=floor,
    )


def _goals(mission: WholeMission) -> tuple[TaskTerm, ...]:
    aligned = Alignment(goal=mission.target, aim=mission.misalignment)
    way_point = ToolPosition(name="PC", frame="base_link", goal=mission.way_point)
    landing = LandingAltitude(landing_distance=0.0, safeguard=mission.altitude)
    return (
        # A box inside the ball that ends the phase.
        TaskTerm(task=way_point, phase="A", tolerance=mission.arrival / np.sqrt(3)),
        TaskTerm(task=aligned, phase="B"),
        TaskTerm(task=aligned, phase="C"),
        TaskTerm(task=landing, phase="C"),
        TaskTerm(task=ToolPose(goal=mission.tool_goal), phase="D"),
    )


def _constraints(mission: WholeMission) -> tuple[TaskTerm | AtRest, ...]:
    above = MinimumAltitude(threshold=mission.minimum_altitude)
    level = HorizontalAttitude(aim=mission.tilt)
    return (
        TaskTerm(task=above, at=At.PATH, phase="A"),
        TaskTerm(task=above, at=At.PATH, phase="B"),
        TaskTerm(task=level, at=At.PATH),
        TaskTerm(task=NullVelocity(), at=At.PATH, phase="D"),
        AtRest(),
    )
