"""What a task asks for at a configuration, in numbers."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.control.velocity.goals import task_parameters
from uvms_ocp.control.velocity.levels import tick_symbols
from uvms_ocp.robot.robot import Robot
from uvms_ocp.tasks.task import Task

OUTPUTS = ("jacobian", "rate", "lower", "upper", "activation")


def task_function(robot: Robot, task: Task, dt: float = 0.005) -> ca.Function:
    symbols = tick_symbols(robot, dt)
    parameters = ca.SX.sym("parameters", task.n_parameters(robot))
    rows = task.rows(symbols, parameters)
    outputs = [getattr(rows, name) for name in OUTPUTS]
    names = [*OUTPUTS, *rows.quantities]
    return ca.Function(
        "task",
        [symbols.q, symbols.velocity, symbols.altimeter_range, parameters],
        [*outputs, *rows.quantities.values()],
        ["q", "v", "range", "parameters"],
        names,
    )


def evaluate(
    robot: Robot,
    task: Task,
    q: np.ndarray,
    v: np.ndarray | None = None,
    altimeter_range: float = 2.0,
) -> dict[str, np.ndarray]:
    function = task_function(robot, task)
    velocity = np.zeros(robot.n_v) if v is None else v
    values = function.call(
        [q, velocity, altimeter_range, task_parameters(task, task.reference(0.0), q)]
    )
    return {name: np.array(value) for name, value in zip(function.name_out(), values, strict=True)}


def random_configuration(robot: Robot, rng: np.random.Generator) -> np.ndarray:
    q = pin.neutral(robot.model)
    q[:3] = rng.uniform(-2, 2, 3)
    q[3:7] = pin.Quaternion(pin.exp3(rng.uniform(-1, 1, 3))).coeffs()
    q[robot.joint_q] = rng.uniform(robot.limits.position_lower, robot.limits.position_upper)
    return q
