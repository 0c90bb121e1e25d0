"""One inverse-kinematics step of pink on Case 1's robot: ``python hierarchy_pink.py ROBOT.urdf RESULT.npz``.

Tasks, weighted (pink has no strict levels): pose of the vehicle, pose of the tool, posture; limits of configuration and
velocity. Needs pin-pink, daqp and numpy only, so that it runs in an environment of its own.
"""

from __future__ import annotations

import sys
import time

import numpy as np
import pinocchio as pin
from pink import Configuration, solve_ik
from pink.tasks import FrameTask, PostureTask

DT, TICKS = 1 / 200, 2000


def main(urdf: str, result: str) -> None:
    """Write the times [s] of ticks that approach a goal 1 m away."""
    model = pin.buildModelFromUrdf(urdf, pin.JointModelFreeFlyer())
    model.lowerPositionLimit[:7], model.upperPositionLimit[:7] = -100.0, 100.0
    configuration = Configuration(model, model.createData(), pin.neutral(model))
    tool, vehicle = FrameTask("tool", 1.0, 1.0), FrameTask("base_link", 0.1, 0.1)
    posture = PostureTask(cost=1e-3)
    tasks = [tool, vehicle, posture]
    for task in (tool, vehicle):
        task.set_target_from_configuration(configuration)
        task.transform_target_to_world.translation[:] += [1.0, 0.2, -0.3]
    posture.set_target_from_configuration(configuration)
    times = []
    for _ in range(TICKS):
        start = time.perf_counter()
        v = solve_ik(configuration, tasks, DT, solver="daqp", safety_break=False)
        times.append(time.perf_counter() - start)
        configuration.integrate_inplace(v, DT)
    np.savez(result, time=np.array(times))


if __name__ == "__main__":
    main(*sys.argv[1:3])
