"""Problems that the peers can express, as ours, and as plain numbers for their environments."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import casadi as ca
import numpy as np
import pinocchio as pin

from horizon.problems import reach_goal
from uvms_ocp.ocp.problem import (
    Actuation,
    HessianKind,
    Integrator,
    OcpLevel,
    OcpPhase,
    OcpProblem,
    single_phase,
)
from uvms_ocp.ocp.terms import At, AtRest, Duration, Effort, StageSymbols, TaskTerm, Term
from uvms_ocp.ocp.transcription.actuation import ActuationModel
from uvms_ocp.robot.limits import Limits
from uvms_ocp.robot.loading import load_robot, robot_folder
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import State
from uvms_ocp.robot.symbolic_model import SymbolicModel
from uvms_ocp.tasks.pose import ToolPose
from uvms_ocp.tasks.task import Residual, bounded_residual, zero_residual

ROBOT = "girona_maris7_full"
DURATION = 8.0  # [s]
WEIGHTS = {"control": 1.0, "state": 0.01, "end_state": 1.0, "tool": 1e4}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class StateRegularisation(Term):
    """Distance on the manifold from a configuration, and the velocity."""

    state_only: ClassVar[bool] = (
        False  # a running cost ends with the last step, as that of the peers
    )
    q: np.ndarray

    @property
    def name(self) -> str:
        return "state"

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        tick = stage.tick
        away = SymbolicModel(tick.robot.model).difference(ca.SX(ca.DM(self.q)), tick.q)
        return zero_residual(ca.vertcat(away, tick.velocity))


def shooting_problem(n_steps: int, *, exact: bool = False) -> OcpProblem:
    """13 DoF on a free-flyer, no water, no limits: what differential dynamic programming is made
    for.

    Running cost on control and state, terminal cost on tool pose and state; without gravity, as if
    neutrally buoyant.
    """
    robot = load_robot(ROBOT)
    robot = replace(robot, model=_weightless(robot.model))
    q = robot.configuration(position=(0, 0, -5), rpy=(0, -0.06, 0.5))
    w = WEIGHTS
    terms: tuple[Term, ...] = (
        Effort(weight=w["control"]),
        StateRegularisation(q=q, at=At.PATH, weight=w["state"]),
        StateRegularisation(q=q, at=At.END, weight=w["end_state"]),
        TaskTerm(task=ToolPose(goal=reach_goal(robot, q)), weight=w["tool"]),
    )
    return single_phase(
        robot=robot,
        start=State(q=q, v=np.zeros(robot.n_v)),
        duration=DURATION,
        n_steps=n_steps,
        levels=[OcpLevel(name="cost", terms=terms)],
        integrator=Integrator.EULER,
        actuation=Actuation.WRENCH,
        hessian=HessianKind.EXACT if exact else HessianKind.GAUSS_NEWTON,
        water=False,
        limited=False,
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Control(Term):
    """All forces in units of their own, not in shares of limits."""

    state_only: ClassVar[bool] = False
    is_goal: ClassVar[bool] = False
    at: At = At.PATH
    units: np.ndarray

    @property
    def name(self) -> str:
        return "control"

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        return zero_residual(ca.vertcat(stage.thrust, stage.torque) / ca.DM(self.units))


# What the unlimited motion exceeds by a third and more.
VELOCITY = np.array([0.08, 0.08, 0.04, 0.06, 0.03, 0.04, *[0.08] * 6, 0.25])
EFFORT = np.array([0.45, 1.1, 0.4, 0.18, 0.024, 0.024, 0.004])
ROOM = 0.1  # [rad] of each joint to both sides of where it starts


def limited_problem(n_steps: int) -> OcpProblem:
    """Add hard limits on velocity, torque and position to the shooting problem."""
    problem = shooting_problem(n_steps)
    joints = problem.start.q[7:]
    limits = Limits(
        position_lower=joints - ROOM,
        position_upper=joints + ROOM,
        velocity=VELOCITY,
        effort=EFFORT,
        acceleration=np.full(problem.robot.n_v, np.inf),
    )
    (level,) = problem.levels
    control = Control(units=control_units(problem), weight=WEIGHTS["control"])
    levels = (replace(level, terms=(control, *level.terms[1:])),)
    return replace(
        problem, robot=replace(problem.robot, limits=limits), levels=levels, limited=True
    )


def control_units(problem: OcpProblem) -> np.ndarray:
    """(n_v,) [N, N m] of the forces that the cost counts."""
    first = problem.levels[0].terms[0]
    if isinstance(first, Control):
        return first.units
    actuators = ActuationModel(problem.robot, problem.actuation)
    return np.concatenate([actuators.thrust_unit, actuators.torque_unit])


def limited_numbers(problem: OcpProblem, tolerance: float) -> dict[str, Any]:
    """Write the limited problem as plain numbers, for environments without this package."""
    limits = problem.robot.limits
    return shooting_numbers(problem) | {
        "position_lower": limits.position_lower.tolist(),
        "position_upper": limits.position_upper.tolist(),
        "velocity": limits.velocity.tolist(),
        "effort": limits.effort.tolist(),
        "tolerance": tolerance,
    }


def shooting_numbers(problem: OcpProblem) -> dict[str, Any]:
    """Write the shooting problem as plain numbers, for environments without this package."""
    robot = problem.robot
    q = problem.start.q
    goal = reach_goal(robot, q)
    return {
        "urdf": str(robot_folder(ROBOT) / "robot.urdf"),
        "inertias": [inertia_numbers(inertia) for inertia in robot.model.inertias],
        "duration": DURATION,
        "n_steps": problem.n_steps,
        "q": q.tolist(),
        "goal_position": goal.translation.tolist(),
        "goal_rotation": goal.rotation.tolist(),
        "control_unit": control_units(problem).tolist(),
        "weights": WEIGHTS,
    }


def inertia_numbers(inertia: pin.Inertia) -> dict[str, Any]:
    """Mass [kg], centre of mass [m] and rotational inertia about it [kg m2] of a joint body, trim
    bodies included.
    """
    return {
        "mass": inertia.mass,
        "lever": inertia.lever.tolist(),
        "inertia": inertia.inertia.tolist(),
    }


def write(numbers: Mapping[str, Any], path: Path) -> Path:
    path.write_text(json.dumps(numbers), encoding="utf-8")
    return path


def _weightless(model: pin.Model) -> pin.Model:
    copy = pin.Model(model)
    copy.gravity = pin.Motion.Zero()
    return copy


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Posture(Term):
    """The joints of a fixed robot reach a posture."""

    q: np.ndarray

    @property
    def name(self) -> str:
        return "posture"

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        return zero_residual(stage.tick.q - ca.DM(self.q))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MotionLimits(Term):
    """Velocities and accelerations in shares of their limits."""

    state_only: ClassVar[bool] = False
    at: At = At.PATH

    @property
    def name(self) -> str:
        return "limits of motion"

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        limits = stage.tick.robot.limits
        shares = (
            stage.tick.velocity / ca.DM(limits.velocity),
            stage.acceleration / ca.DM(limits.acceleration),
        )
        return bounded_residual(ca.vertcat(*shares), lower=-1.0, upper=1.0)


SHIFT = np.array([1.2, 0.8, -0.6, -0.9, 0.7, 0.5, -1.0])  # [rad] of each joint


def quickest_problem(n_steps: int) -> OcpProblem:
    """The arm alone, on a fixed base: from one posture to another at rest in the least time.

    Limits on velocity and acceleration only, so that the answer is known: the slowest joint's
    trapezoid.
    """
    robot = load_robot(ROBOT, base="fixed")
    q = arm_start(robot)
    return OcpProblem(
        robot=robot,
        start=State(q=q, v=np.zeros(robot.n_v)),
        phases=(OcpPhase(n_steps=n_steps, duration=(0.5, 10.0)),),
        levels=(OcpLevel(name="time", terms=(Duration(),)),),
        constraints=(Posture(q=q + SHIFT), AtRest(), MotionLimits()),
        water=False,
        limited=False,
    )


def arm_start(robot: Robot) -> np.ndarray:
    """A posture from which `SHIFT` stays within all limits."""
    low, up = robot.limits.position_lower, robot.limits.position_upper
    return np.asarray((low + up) / 2 - SHIFT / 2)


def quickest_numbers(problem: OcpProblem) -> dict[str, Any]:
    """Write the quickest problem as plain numbers, for environments without this package."""
    limits = problem.robot.limits
    return {
        "urdf": str(robot_folder(ROBOT) / "robot.urdf"),
        "start": problem.start.q.tolist(),
        "goal": (problem.start.q + SHIFT).tolist(),
        "position_lower": limits.position_lower.tolist(),
        "position_upper": limits.position_upper.tolist(),
        "velocity": limits.velocity.tolist(),
        "acceleration": limits.acceleration.tolist(),
    }


def least_time(problem: OcpProblem) -> float:
    """[s] of the slowest joint: full acceleration, full velocity if there is room, full
    deceleration.
    """
    v, a = problem.robot.limits.velocity, problem.robot.limits.acceleration
    way = np.abs(SHIFT)
    return float(np.where(way > v**2 / a, way / v + v / a, 2 * np.sqrt(way / a)).max())
