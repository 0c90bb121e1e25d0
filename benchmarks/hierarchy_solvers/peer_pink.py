"""The tick of Case 1 with pink: ``python peer_pink.py ROBOT.urdf RESULT.npz [--passes 3] [--ticks
500]``.

What each phase of Case 1 asks for, in pink's own terms: limits of configuration, velocity and
acceleration, a barrier for the least altitude, and tasks of frames, joints and least velocity. pink
has no strict levels: a priority is a weight, ten times that of the next. A tick is what a control
loop repeats: kinematics of the measured configuration, then ``solve_ik``. Needs pin-pink and QP
solvers only, so that it runs in an environment of its own.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import qpsolvers
from pink import Configuration, solve_ik
from pink.barriers import PositionBarrier
from pink.exceptions import NoSolutionFound
from pink.limits import (
    AccelerationLimit,
    ConfigurationLimit,
    FloatingBaseVelocityLimit,
    VelocityLimit,
)
from pink.limits.limit import Limit
from pink.tasks import DampingTask, FrameTask, LinearHolonomicTask, Task

DT = 1 / 200  # [s]
START = np.array([8.5, 38.5, -36.0])
FLOOR = -40.0
# Not every solver accepts every tick: one that fails is named with its failures.
SOLVERS = ("daqp", "quadprog", "osqp", "proxqp", "piqp")


def robot(urdf: str) -> pin.Model:
    """Build the robot on a free flyer, with room to move and velocity limits of the hull."""
    model = pin.buildModelFromUrdf(urdf, pin.JointModelFreeFlyer())
    model.lowerPositionLimit[:7] = -100.0
    model.upperPositionLimit[:7] = 100.0
    return model


def frame_task(
    frame: str, position: object, orientation: object, shift: tuple[float, float, float]
) -> Callable:
    """A task whose target is `shift` [m] away from where the frame is at first."""

    def at(configuration: Configuration) -> FrameTask:
        task = FrameTask(frame, position, orientation, gain=0.01)
        task.set_target_from_configuration(configuration)
        task.transform_target_to_world.translation[:] += shift
        return task

    return at


def wrist(model: pin.Model, cost: float) -> LinearHolonomicTask:
    """The last four joints at rest where they are (MP)."""
    A = np.hstack([np.zeros((4, model.nv - 4)), np.eye(4)])
    return LinearHolonomicTask(A, np.zeros(4), pin.neutral(model), cost=cost, gain=0.01)


def phases(model: pin.Model, configuration: Configuration) -> dict[str, list[Task]]:
    """Tasks of the phases A to D of [Gao2022] Table 4; the barrier and the limits act in all."""
    level = frame_task("base_link", 0.0, (100.0, 100.0, 0.0), (0, 0, 0))(configuration)
    heading = frame_task("base_link", 0.0, (0.0, 0.0, 10.0), (0, 0, 0))(configuration)
    way_point = frame_task("base_link", 10.0, 10.0, (2.3, -1.05, -2.0))(configuration)
    landing = frame_task("base_link", (0.0, 0.0, 1.0), 0.0, (0, 0, -1.0))(configuration)
    tool = frame_task("tool", 10.0, 10.0, (0.3, 0.1, -0.2))(configuration)
    hull = LinearHolonomicTask(
        np.hstack([np.eye(6), np.zeros((6, model.nv - 6))]),
        np.zeros(6),
        configuration.q.copy(),
        cost=1000.0,
    )
    below = [wrist(model, 0.1), DampingTask(cost=0.01)]
    return {
        "A": [level, way_point, *below],
        "B": [level, heading, *below],
        "C": [level, heading, landing, *below],
        "D": [hull, level, tool, *below],
    }


def limits(model: pin.Model) -> list[Limit]:
    """Configuration, velocity, acceleration."""
    return [
        ConfigurationLimit(model),
        VelocityLimit(model),
        FloatingBaseVelocityLimit(model, "base_link", 1.0, 0.6),
        AccelerationLimit(model, np.full(model.nv, 2.0)),
    ]


def run(model: pin.Model, solver: str, ticks: int) -> tuple[np.ndarray, int]:
    """Times [s] of so many ticks of each phase, and the number of ticks that pink could not
    solve.
    """
    q = pin.neutral(model)
    q[:3] = START
    configuration = Configuration(model, model.createData(), q)
    barrier = PositionBarrier("base_link", indices=[2], p_min=np.array([FLOOR + 1.2]), gain=1.0)
    bounds = limits(model)
    times = []
    failed = 0
    for tasks in phases(model, configuration).values():
        for _ in range(ticks):
            start = time.perf_counter()
            configuration.update(q)
            try:
                v = solve_ik(
                    configuration,
                    tasks,
                    DT,
                    solver=solver,
                    limits=bounds,
                    barriers=[barrier],
                    safety_break=False,
                )
            except NoSolutionFound:
                v = np.zeros(model.nv)
                failed = failed + 1
            times.append(time.perf_counter() - start)
            bounds[-1].set_last_integration(v, DT)
            q = pin.integrate(model, q, v * DT)
    return np.array(times), failed


def main() -> None:
    """Times and failures of every installed solver: the shortest of all passes, tick by tick."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("urdf")
    parser.add_argument("result", type=Path)
    parser.add_argument("--passes", type=int, default=3)
    parser.add_argument("--ticks", type=int, default=500, help="of each phase")
    arguments = parser.parse_args()
    model = robot(arguments.urdf)
    results = dict[str, Any](version=version("pin-pink"))
    for solver in SOLVERS:
        if solver in qpsolvers.available_solvers:
            run(model, solver, 1)  # to warm up, as ours
            passes = [run(model, solver, arguments.ticks) for _ in range(arguments.passes)]
            results[f"{solver}/time"] = np.min([seconds for seconds, _ in passes], axis=0)
            results[f"{solver}/failed"] = np.array(passes[-1][1])
    np.savez(arguments.result, **results)


if __name__ == "__main__":
    main()
