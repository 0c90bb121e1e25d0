"""Brake: the stop of the robot along a straight line of velocities, and lower speeds in degraded
modes.

All axes slow down in proportion, as fast as the first of them can: what glides along an obstacle
goes on gliding along it until it stands, while axes that stop one after the other would swing into
it. Lower speeds keep the direction, and so all priorities; neither changes a velocity by more than
the acceleration limits allow.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated

import casadi as ca
import numpy as np

from uvms_ocp.codegen.kernel_layout import FunctionField, Layout, Sized, Vector
from uvms_ocp.robot import Robot, SymbolicModel, limits
from uvms_ocp.tasks.approach_speed import ENDLESS, stopping_speed

_AT_REST = 1e-12  # [s] to rest
NONE = -1
"""Number that stands for no limit."""


class StopMemory(Layout):
    """State of a robot on its way to rest, and how far it may go before limits are to be looked
    at.
    """

    step: FunctionField
    """Function ``q, v, time to rest [s] -> q, v`` one tick later on the way to rest."""
    slower: FunctionField
    """Function ``q, v, time to rest [s] -> v`` of a velocity one tick nearer to rest, at q itself.
    """
    acceleration: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s2, rad/s2] acceleration of each axis as it brakes, finite."""
    dt: float
    """[s] control period."""
    time: float
    """[s] time to rest from v."""
    done: bool
    """The robot has come to rest."""
    q: Annotated[Vector, Sized("n_q")]
    """(n_q,) [m, rad] configuration at the end of the tick."""
    v: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] velocity of the next tick."""
    velocity: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] velocity of the tick."""
    next_q: Annotated[Vector, Sized("n_q")]
    next_v: Annotated[Vector, Sized("n_v")]
    n_limits: int
    """Number of limits that count."""
    reach: Annotated[list[Vector], Sized("n_limits", "n_v")]
    """(n_limits, n_v) [m, or 1] upper bound on the rate of each position per unit of velocity."""
    room: Annotated[Vector, Sized("n_limits")]
    """(n_limits,) [m] room that is left before each limit, or less."""


def time_to_rest(acceleration: Vector, v: Vector, n: int) -> float:
    """Return the time [s] that the slowest of n axes needs to rest from v [m/s, rad/s] at its
    `acceleration` [m/s2, rad/s2]. A kernel.
    """
    time = 0.0
    for i in range(n):
        time = max(time, abs(v[i]) / acceleration[i])
    return time


def slow_down(stop: StopMemory, q: Vector, v: Vector, slower: Vector) -> None:
    """Write the velocity [m/s, rad/s] one tick nearer to rest than v, at q [m, rad]. A kernel."""
    stop.slower(q, v, time_to_rest(stop.acceleration, v, len(stop.v)), slower)


def begin_stop(stop: StopMemory, q: Vector, v: Vector) -> None:
    """Begin a stop at q [m, rad] with v [m/s, rad/s]. A kernel."""
    stop.q[:] = q
    stop.v[:] = v
    stop.time = time_to_rest(stop.acceleration, stop.v, len(stop.v))
    stop.done = False


def step_stop(stop: StopMemory) -> None:
    """Advance the stop by a tick. A kernel."""
    stop.step(stop.q, stop.v, stop.time, stop.next_q, stop.next_v)
    stop.q[:] = stop.next_q
    stop.velocity[:] = stop.v
    stop.v[:] = stop.next_v
    stop.time = time_to_rest(stop.acceleration, stop.v, len(stop.v))
    stop.done = not stop.time >= _AT_REST  # also where v is not a number


def advance_stop(stop: StopMemory) -> int:
    """Advance the stop by the ticks in which no limit can be reached; return the limit that may be
    reached then, or `NONE` where the robot rests before. A kernel.
    """
    while True:
        for k in range(stop.n_limits):
            if stop.room[k] < 0.0:
                return k
        if stop.done:
            return NONE
        step_stop(stop)
        for k in range(stop.n_limits):
            reach = stop.reach[k]
            way = 0.0
            for i in range(len(stop.v)):
                way += reach[i] * abs(stop.velocity[i])
            stop.room[k] -= way * stop.dt


def stop_functions(robot: Robot, dt: float) -> dict[str, ca.Function]:
    """Return the functions of a `StopMemory` at control period dt [s]."""
    step, slower = _functions(robot, dt)
    return {"step": step, "slower": slower}


def finite_acceleration(robot: Robot) -> np.ndarray:
    """Return the limits (n_v,) [m/s2, rad/s2] of acceleration by which a robot comes to rest."""
    return np.minimum(robot.limits.acceleration, ENDLESS)


@lru_cache(maxsize=8)
def _functions(robot: Robot, dt: float) -> tuple[ca.Function, ca.Function]:
    """Make the functions ``q, v, time to rest -> q, v`` one tick later, and ``q, v, time to rest ->
    v`` at q.
    """
    acceleration = finite_acceleration(robot)
    q = ca.SX.sym("q", robot.n_q)
    v = ca.SX.sym("v", robot.n_v)
    time = ca.SX.sym("time")
    moved = ca.densify(SymbolicModel(robot.model).integrate(q, v * dt))
    step = [moved, _slower(robot, acceleration, dt, moved, v, time)]
    alone = [_slower(robot, acceleration, dt, q, v, time)]
    return ca.Function("step_to_rest", [q, v, time], step, {"cse": True}), ca.Function(
        "slower", [q, v, time], alone
    )


def _slower(
    robot: Robot, acceleration: np.ndarray, dt: float, q: ca.SX, v: ca.SX, time: ca.SX
) -> ca.SX:
    """Return v one tick nearer to rest: in proportion, where no joint has to brake harder before
    its limit.
    """
    slower = ca.if_else(time > dt, v * (1.0 - dt / time), 0.0 * v)
    for joint, lower, upper in limits.bounded_joints(robot.joints, robot.limits):
        i = joint.idx_v
        at = joint.position(q)
        down = stopping_speed(at - lower, deceleration=acceleration[i], dt=dt)
        up = stopping_speed(upper - at, deceleration=acceleration[i], dt=dt)
        slower[i] = ca.fmax(ca.fmin(slower[i], up), -down)
    reach = ca.DM(acceleration * dt)
    return ca.densify(ca.fmax(ca.fmin(slower, v + reach), v - reach))
