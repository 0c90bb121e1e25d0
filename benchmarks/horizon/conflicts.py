"""Problems whose goals exclude each other, with answers that are known from geometry."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from horizon.problems import tool_reach
from uvms_ocp.ocp.plan import Plan
from uvms_ocp.ocp.problem import OcpLevel, OcpProblem, single_phase
from uvms_ocp.ocp.terms import AtRest, Effort, Smoothness, TaskTerm
from uvms_ocp.robot.kinematics import Kinematics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import State
from uvms_ocp.tasks.pose import ToolPosition

N_LINKS = 11
LINK = 0.1  # [m] length of each link
MARKS = {"shoulder": 3, "elbow": 6, "tool": 11}  # number of joints from the base to each frame
AHEAD = 3.0
"""[m] distance of the goal ahead of the tool."""
CHEAP = OcpLevel(name="effort", terms=(Effort(), Smoothness(weight=0.09)))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Conflict:
    """A problem with levels of goals and a last level of costs."""

    name: str
    """Name of the conflict, for tables."""
    problem: OcpProblem
    """Problem with a level for each goal."""
    goals: tuple[tuple[str, np.ndarray], ...]
    """Frame of each level, and the position (3,) [m] in W that it is to reach."""
    best: tuple[float | None, ...]
    """[m] smallest distance of each frame from its goal that the levels above leave; None where it is
    not known.
    """

    def errors(self, plan: Plan) -> list[float]:
        """Return the distances [m] of the frames from their goals at the end."""
        model = plan.robot.model
        data = plan.robot.model.createData()
        pin.framesForwardKinematics(model, data, plan.trajectory.q[-1])
        errors = []
        for frame, goal in self.goals:
            end = data.oMf[plan.robot.frame_id(frame)].translation
            errors.append(float(np.linalg.norm(end - goal)))
        return errors

    def as_sum(self, weight: float) -> OcpProblem:
        """Return the problem with all terms in one level: residuals of every goal weigh `weight`
        times those of the next, costs once.
        """
        *goals, costs = self.problem.levels
        terms = []
        for i, level in enumerate(goals):
            rank = len(goals) - i
            terms += [replace(term, weight=weight ** (2 * rank)) for term in level.terms]
        return replace(self.problem, levels=(OcpLevel(name="sum", terms=(*terms, *costs.terms)),))


def arm(n_steps: int = 20) -> Conflict:
    """Make the conflict of an arm with 11 joints in a plane: once the tool is at its goal, elbow and
    shoulder cannot both reach theirs.

    The elbow gets as near to its goal as a straight forearm from the tool allows, the shoulder as
    near as a straight upper arm from that elbow.
    """
    tool = np.array([0.9, 0, 0])
    elbow = np.array([0, 0.6, 0])
    shoulder = np.array([-0.3, 0, 0])
    forearm = LINK * (MARKS["tool"] - MARKS["elbow"])
    upper = LINK * (MARKS["elbow"] - MARKS["shoulder"])
    nearest_elbow = tool + forearm * (elbow - tool) / np.linalg.norm(elbow - tool)
    best = (
        0.0,
        float(np.linalg.norm(elbow - tool) - forearm),
        float(np.linalg.norm(shoulder - nearest_elbow) - upper),
    )
    robot = chain()
    problem = single_phase(
        robot=robot,
        start=State(q=np.full(N_LINKS, 0.1), v=np.zeros(N_LINKS)),
        duration=4.0,
        n_steps=n_steps,
        levels=[
            _goal("tool", "tool", tool),
            _goal("elbow", "elbow", elbow),
            _goal("shoulder", "shoulder", shoulder),
            CHEAP,
        ],
        constraints=(AtRest(),),
        water=False,
    )
    return Conflict(
        name="arm, 11 joints",
        problem=problem,
        goals=(("tool", tool), ("elbow", elbow), ("shoulder", shoulder)),
        best=best,
    )


def vehicle(n_steps: int = 20) -> Conflict:
    """Make the conflict of a vehicle of 13 DoF in water that is to stay, while its tool is to reach a
    point which needs the vehicle to move; both cost effort.
    """
    problem = tool_reach(n_steps)
    start = Kinematics(problem.robot, problem.start.q)
    base = start.pose("base_link").translation
    tool = start.pose("tool").translation + np.array([AHEAD, 0, 0])
    levels = (_goal("vehicle", "base_link", base), _goal("tool", "tool", tool), problem.levels[-1])
    return Conflict(
        name="vehicle and arm, 13 DoF, water",
        problem=replace(problem, levels=levels),
        goals=(("base_link", base), ("tool", tool)),
        best=(0.0, None),
    )


def chain() -> Robot:
    """Build a planar arm of equal links; gravity is along its axes."""
    links = "".join(_link(i) for i in range(1, N_LINKS + 1))
    marks = "".join(_mark(name, i) for name, i in MARKS.items())
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "chain.urdf"
        path.write_text(
            f'<robot name="chain"><link name="link0"/>{links}{marks}</robot>', encoding="utf-8"
        )
        return load_robot(urdf=path, base="fixed")


def _mark(name: str, i: int) -> str:
    """Write a frame at the end of a link."""
    return (
        f'<link name="{name}"/><joint name="{name}_mount" type="fixed"><parent link="link{i}"/>'
        f'<child link="{name}"/><origin xyz="{LINK} 0 0"/></joint>'
    )


def _link(i: int) -> str:
    """Write a link with the joint before it."""
    offset = LINK if i > 1 else 0.0
    return (
        f'<link name="link{i}"><inertial><origin xyz="{LINK / 2} 0 0"/><mass value="0.5"/><inertia'
        ' ixx="1e-4" ixy="0" ixz="0" iyy="5e-4" iyz="0" izz="5e-4"/></inertial></link><joint'
        f' name="joint{i}" type="revolute"><parent link="link{i - 1}"/><child'
        f' link="link{i}"/><origin xyz="{offset} 0 0"/><axis xyz="0 0 1"/><limit lower="-6"'
        ' upper="6" velocity="2" effort="20"/></joint>'
    )


def _goal(name: str, frame: str, position: np.ndarray) -> OcpLevel:
    """Make a level in which a frame reaches a position (3,) [m]."""
    task = ToolPosition(name=name, frame=frame, goal=pin.SE3(np.eye(3), position))
    return OcpLevel(name=name, terms=(TaskTerm(task=task),))
