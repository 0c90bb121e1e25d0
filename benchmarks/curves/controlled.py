"""The scenes of curves, by optimal control in water."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from recording.timing import once

from curves.scenes import Problem
from uvms_ocp.ocp.clearance_certificate import SteppedMotion
from uvms_ocp.ocp.plan import Plan
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.problem import OcpLevel, OcpProblem, single_phase
from uvms_ocp.ocp.request import along_curve
from uvms_ocp.ocp.shape_clearance import ShapeClearance
from uvms_ocp.ocp.terms import AtRest, Effort, Smoothness, TaskTerm
from uvms_ocp.planning.distances import CoalDistances
from uvms_ocp.planning.soft_collision import CollisionPlan, plan_soft_collision
from uvms_ocp.robot.kinematics import Kinematics
from uvms_ocp.robot.signals import State
from uvms_ocp.solvers.nlp.options import NlpOptions
from uvms_ocp.tasks.joints import JointTracking
from uvms_ocp.tasks.pose import VehiclePose
from uvms_ocp.trajectories.segment_times import MotionLimits
from uvms_ocp.types import Array

N_STEPS = 24
OPTIONS = NlpOptions(convergence=1e-6, time_limit=60.0)


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """A plan for one scene, its distances and the time that it took."""

    seed: int
    plan: Plan
    distances: Array
    """(n, n_pairs) [m] at dense samples."""
    curve_time: float
    """[s] of the processor."""
    plan_time: float
    """[s] of the processor, proof included."""

    @property
    def nearest(self) -> float:
        """[m]"""
        return float(self.distances.min())


def collides(outcome: Outcome) -> bool:
    """Whether any sample does."""
    return outcome.nearest <= 0.0


class Scenes:
    """A planner for all scenes of one robot, built from the first."""

    samples = 2000
    slower = 1.3
    clearance = 0.01

    def __init__(self, first: Problem) -> None:
        built = once(lambda: Planner(self._problem(first, 1.0), OPTIONS))
        self._planner = built.value
        self.build_time = built.cpu

    def solved(self, item: Problem) -> Outcome:
        """Plan from the curve around the obstacles of a scene."""
        curve = once(lambda: _curve(item))
        problem = self._problem(item, self.slower * curve.value.trajectory.duration)
        plan = once(lambda: self._planned(item, problem, curve.value))
        term = problem.constraints[1]
        path = plan.value.trajectory
        assert isinstance(term, ShapeClearance)
        t = np.linspace(0.0, path.t[-1], self.samples)
        q = SteppedMotion(term=term, trajectory=path).configurations(t)
        return Outcome(
            seed=item.seed,
            plan=plan.value,
            distances=CoalDistances(item.scene).distances_at(q),
            curve_time=curve.cpu,
            plan_time=plan.cpu,
        )

    def _planned(self, item: Problem, problem: OcpProblem, curve: CollisionPlan) -> Plan:
        guess = along_curve(problem, item.scene.coordinates, curve.trajectory)
        return self._planner.plan(problem, guess=guess, diagnose=False)

    def _problem(self, item: Problem, duration: float) -> OcpProblem:
        robot = item.scene.coordinates.robot
        q = item.scene.coordinates.configurations(item.ends)
        vehicle = VehiclePose(goal=Kinematics(robot, q[1]).pose("base_link"))
        posture = JointTracking(joints=robot.joint_names, goal=q[1, robot.n_q - robot.n_joints :])
        distances_at_ends = CoalDistances(item.scene).distances(item.ends).min(axis=0)
        margins = np.minimum(self.clearance, distances_at_ends)
        return single_phase(
            robot=robot,
            start=State(q=q[0], v=np.zeros(robot.n_v)),
            duration=duration,
            n_steps=N_STEPS,
            levels=[
                OcpLevel(name="goal", terms=(TaskTerm(task=vehicle), TaskTerm(task=posture))),
                OcpLevel(name="effort", terms=(Effort(), Smoothness(weight=0.09))),
            ],
            constraints=(AtRest(), ShapeClearance(scene=item.scene, margins=margins)),
        )


def _curve(item: Problem) -> CollisionPlan:
    robot = item.scene.coordinates.robot
    limits = MotionLimits(velocity=robot.limits.velocity, acceleration=robot.limits.acceleration)
    return plan_soft_collision(item.scene, item.ends, limits=limits)
