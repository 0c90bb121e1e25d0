"""Check: the sensors can tell whether the thresholds of a mission are met."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from uvms_ocp.control.navigation.accuracy import spread_at_rest
from uvms_ocp.mission.conditions import Below
from uvms_ocp.model.kinematics import Kinematics
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.sensing import IDEAL_SENSORS
from uvms_ocp.model.spatial import quaternion_to_matrix
from uvms_ocp.preflight.findings import Finding, Severity
from uvms_ocp.preflight.setup import Setup
from uvms_ocp.tasks.pose import PoseTask, ToolPosition
from uvms_ocp.tasks.task import Task

_PARTS = {"position_error": np.s_[:3], "horizontal_error": np.s_[:2], "orientation_error": np.s_[3:]}


def quantity_spreads(setup: Setup, q: np.ndarray, spread: np.ndarray | None = None) -> dict[str, float]:
    """By ``task.quantity``, what the sensors allow to know at q (n_q,) [m, rad]: a standard deviation [m] or [rad].

    Of the distances and angles of frames from their goals, the root of the sum of the variances of their axes, from `spread`
    (n_v,) [m, rad], that of the configuration as in `Measurement.spread`, or from `spread_at_rest`. Empty with ideal sensors,
    which allow everything. Joints may be beyond their limits, where a fault has pushed them.
    """
    tasks = [task for task in setup.mission.hierarchy.tasks if isinstance(task, (PoseTask, ToolPosition))]
    if setup.sensors == IDEAL_SENSORS or not tasks:
        return {}
    kinematics = Kinematics(_without_limits(setup.robot), q)
    variance = np.diag((spread_at_rest(setup.robot, setup.sensors) if spread is None else spread) ** 2)
    if setup.robot.n_vehicle:  # Jacobians take the velocity of B in B
        R_WB = quaternion_to_matrix(q[3:7])
        variance[:3, :3] = R_WB.T @ variance[:3, :3] @ R_WB
    return {
        f"{task.name}.{name}": float(np.sqrt(np.trace((J @ variance @ J.T)[rows, rows])))
        for task in tasks
        for J in [kinematics.jacobian(task.frame)]
        for name, rows in _quantities(task).items()
    }


def _without_limits(robot: Robot) -> Robot:
    unlimited = np.full(robot.n_joints, np.inf)
    return replace(robot, limits=replace(robot.limits, position_lower=-unlimited, position_upper=unlimited))


def _quantities(task: Task) -> dict[str, slice]:
    return {"position_error": _PARTS["position_error"]} if isinstance(task, ToolPosition) else _PARTS


def check_accuracy(setup: Setup) -> Iterator[Finding]:
    """A threshold below what the sensors allow, in the posture of the start."""
    allowed = quantity_spreads(setup, setup.start)
    for phase in setup.mission.phases:
        conditions = {condition for transition in phase.transitions for condition in transition.when}
        for condition in sorted(conditions, key=lambda item: item.quantity):
            sigma = allowed.get(condition.quantity, 0.0)
            if isinstance(condition, Below) and condition.limit < sigma:
                yield _below_the_noise(phase.name, condition, sigma)


def _below_the_noise(phase: str, condition: Below, sigma: float) -> Finding:
    text = (
        f"{condition.quantity} < {condition.limit:g} is asked for, but the sensors tell it to {sigma:.2g} only (one "
        "standard deviation): the phase may end early, or never; raise the limit or take better sensors"
    )
    figures = {"limit": condition.limit, "sensors_allow": sigma}
    return Finding(severity=Severity.WARNING, check="accuracy", phase=phase, text=text, figures=figures)
