"""One plan by optimal control from what an engineer asks for: with water, thrusters and torques, among obstacles."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated

import numpy as np
import pinocchio as pin

from uvms_ocp.arguments import AtLeastOne, Magnitude, Positive, Range, Shape, checked
from uvms_ocp.arrays import Array
from uvms_ocp.collision.coal_distances import CoalDistances
from uvms_ocp.collision.collision_scene import CollisionScene, Nearest, collision_scene
from uvms_ocp.collision.coordinates import coordinates
from uvms_ocp.collision.obstacle_file import build_obstacles
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.state import State
from uvms_ocp.obstacle_data import ObstacleData
from uvms_ocp.ocp.capsule_clearance import CapsuleClearance, capsule_clearance, nearest_capsules
from uvms_ocp.ocp.plan import OcpStatus, Plan
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.plans.motion_series import sample_times
from uvms_ocp.ocp.problem import OcpLevel, OcpProblem, single_phase
from uvms_ocp.ocp.terms import AtRest, Effort, Posture, Smoothness, TaskTerm
from uvms_ocp.planning.goals import FiniteTriple, Goal, check_way
from uvms_ocp.solvers.nlp.lexicographic_nlp import NlpOptions
from uvms_ocp.solvers.nlp.watch import Progress


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class OcpRequest:
    """What to plan: first the goal, at rest and within all limits, then little effort on smooth ways."""

    robot: Robot
    start: Annotated[Array, Shape("robot.n_q"), Range(open=True)]
    """(n_q,) [m, rad] configuration."""
    goal: Goal
    obstacles: tuple[ObstacleData, ...] = ()
    clearance: Magnitude = 0.06
    """[m] kept from obstacles by the capsules that cover the links."""
    duration: Positive = 8.0
    """[s]"""
    n_steps: AtLeastOne = 40
    current: FiniteTriple = (0.0, 0.0, 0.0)
    """[m/s] of the water in W."""
    plugin: str = "ipopt"
    time_limit: Positive = 20.0
    """[s] for the solver."""


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class OcpResult:
    """The plan, and what its true shapes keep from each other; of a plan that is not usable that means nothing."""

    request: OcpRequest
    scene: CollisionScene
    plan: Plan

    @cached_property
    def samples(self) -> tuple[Array, Array]:
        """Times (n,) [s], and configurations (n, n_q) [m, rad] on their manifold, within the limits of the joints."""
        robot, trajectory = self.request.robot, self.plan.trajectory
        t = sample_times(self.plan.duration)
        q = np.array([trajectory.state_at(robot.model, moment)[0] for moment in t])
        return t, np.array([_within(robot, row) for row in q])

    @cached_property
    def coordinates(self) -> Array:
        """(n, n_axes) [m, rad] coordinates of the scene at the samples."""
        return np.array([self.scene.coordinates.x(q) for q in self.samples[1]])

    @cached_property
    def distances(self) -> Array:
        """(n, n_pairs) [m] of all pairs of shapes at the samples."""
        return CoalDistances(self.scene).distances(self.coordinates)

    @property
    def nearest(self) -> Nearest:
        """The smallest distance at any sample."""
        return self.scene.nearest(self.samples[0], self.distances)

    @property
    def collision_free(self) -> bool:
        """True if no two shapes touch at any sample."""
        return self.nearest.distance > 0.0


@checked
def solve_ocp(request: OcpRequest, *, progress: Progress | None = None) -> OcpResult:
    """Plan by lexicographic optimal control; progress is told every iteration of the solver.

    Raises `NameNotFound` for an unknown joint, frame or NLP solver, `InvalidInput` for a goal outside limits, a start in
    collision, two obstacles of one name, obstacles of shapes that capsules do not cover, and numbers out of their range.
    """
    check_way(request.robot, request.start, request.goal)
    planned = coordinates(request.robot, reference=request.start)
    scene = collision_scene(planned, build_obstacles(request.obstacles))
    clearance = capsule_clearance(scene, margin=request.clearance)
    problem = _problem(request, clearance)
    scene.check_apart(CoalDistances(scene).distances(planned.x(request.start)[None])[0], "the start")
    plan = Planner(problem, NlpOptions(plugin=request.plugin, time_limit=request.time_limit)).plan(progress=progress)
    if plan.status is OcpStatus.OBSTRUCTED and clearance.pairs:
        plan = replace(plan, reason=_too_near(request, clearance) or plan.reason)
    return OcpResult(request=request, scene=scene, plan=plan)


def _problem(request: OcpRequest, clearance: CapsuleClearance) -> OcpProblem:
    robot, tasks = request.robot, request.goal.as_tasks(request.robot, request.start)
    return single_phase(
        robot=robot,
        start=State(q=request.start, v=np.zeros(robot.n_v)),
        duration=request.duration,
        n_steps=request.n_steps,
        levels=[
            OcpLevel(name="goal", terms=tuple(TaskTerm(task=task) for task in tasks)),
            # Links seldom meet near the posture of the start, and no constraint keeps them apart.
            OcpLevel(name="effort", terms=(Effort(), Smoothness(weight=0.09), Posture(q=request.start, weight=4.0))),
        ],
        constraints=(AtRest(), clearance) if clearance.pairs else (AtRest(),),
        current=np.asarray(request.current, dtype=float),
        water=bool(robot.hydrodynamics),
    )


def _too_near(request: OcpRequest, clearance: CapsuleClearance) -> str | None:
    """Which shapes are too near at the start and by how much; `None` where none are."""
    gap, pair = nearest_capsules(clearance, request.robot, request.start)
    if gap >= clearance.margin:
        return None
    state = f"{gap:.3g} m apart" if gap >= 0 else f"{-gap:.3g} m inside each other"
    return (
        f"{pair}: the capsules that cover them, wider than the shapes, are {state} at the start; "
        f"move them {clearance.margin - gap:.3g} m farther apart for a clearance of {clearance.margin:g} m"
    )


def _within(robot: Robot, q: Array) -> Array:
    """q with unit quaternions and its joints inside their limits, which a solver keeps but for its tolerance."""
    inside: Array = pin.normalize(robot.model, q)
    for joint in robot.joints:
        if joint.n_q == joint.n_v:
            own = slice(joint.idx_v - robot.n_vehicle, joint.idx_v - robot.n_vehicle + joint.n_v)
            inside[joint.q] = np.clip(q[joint.q], robot.limits.position_lower[own], robot.limits.position_upper[own])
    return inside
