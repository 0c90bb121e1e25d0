"""How a robot comes to rest: all axes slow down in proportion, as fast as the first of them can.

What glides along an obstacle goes on gliding along it until it stands, while axes that stop one after the other would
swing into it.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Annotated, Any

import casadi as ca
import numpy as np

from uvms_ocp.functions.kernels.layout import Layout, Sized, Vector, doubles, structure_of, view
from uvms_ocp.functions.kernels.smooth import Smooth
from uvms_ocp.model.limits import bounded_joints
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.symbolic.tree import SymbolicModel
from uvms_ocp.tasks.limits import ENDLESS, stopping_speed

_STILL = 1e-12  # [s] to rest
NONE = -1
"""No limit asks to be looked at."""


class WayToRest(Layout):
    """Where a robot is on its way to rest, and how far it may go before limits are to be looked at."""

    step: Smooth
    """q, v and the time to rest from it [s], to q one tick on and v then."""
    slower: Smooth
    """q, v and the same time, to v one tick nearer to rest at q itself."""
    acceleration: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s2, rad/s2] finite."""
    dt: float
    """[s] control period."""
    time: float
    """[s] to rest from v."""
    done: bool
    """It stands."""
    q: Annotated[Vector, Sized("n_q")]
    """(n_q,) [m, rad] at the end of the tick."""
    v: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] of the next tick."""
    velocity: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] of the tick."""
    next_q: Annotated[Vector, Sized("n_q")]
    next_v: Annotated[Vector, Sized("n_v")]
    n_limits: int
    """[-] that count."""
    reach: Annotated[list[Vector], Sized("n_limits", "n_v")]
    """(n_limits, n_v) [m, or 1] as that of `PositionLimit`, finite."""
    room: Annotated[Vector, Sized("n_limits")]
    """(n_limits,) [m] that is left before each limit at least."""


def time_to_rest(acceleration: Vector, v: Vector, n: int) -> float:
    """[s] that the slowest of n axes needs to rest from v [m/s, rad/s] at its `acceleration` [m/s2, rad/s2]. A kernel."""
    time = 0.0
    for i in range(n):
        time = max(time, abs(v[i]) / acceleration[i])
    return time


def slow_down(m: WayToRest, q: Vector, v: Vector, slower: Vector) -> None:
    """v [m/s, rad/s] one tick nearer to rest, at q [m, rad]. A kernel."""
    m.slower(q, v, time_to_rest(m.acceleration, v, len(m.v)), slower)


def set_out(m: WayToRest, q: Vector, v: Vector) -> None:
    """Begin at q [m, rad] with v [m/s, rad/s]. A kernel."""
    for i in range(len(m.q)):
        m.q[i] = q[i]
    for i in range(len(m.v)):
        m.v[i] = v[i]
    m.time = time_to_rest(m.acceleration, m.v, len(m.v))
    m.done = False


def step_on(m: WayToRest) -> None:
    """One tick nearer to rest. A kernel."""
    m.step(m.q, m.v, m.time, m.next_q, m.next_v)
    for i in range(len(m.q)):
        m.q[i] = m.next_q[i]
    for i in range(len(m.v)):
        m.velocity[i] = m.v[i]
        m.v[i] = m.next_v[i]
    m.time = time_to_rest(m.acceleration, m.v, len(m.v))
    m.done = not m.time >= _STILL  # also where v is not a number


def go_on(m: WayToRest) -> int:
    """Ticks until a limit may be reached, which one that is, or `NONE` where the robot rests before. A kernel."""
    while True:
        for k in range(m.n_limits):
            if m.room[k] < 0.0:
                return k
        if m.done:
            return NONE
        step_on(m)
        for k in range(m.n_limits):
            reach, way = m.reach[k], 0.0
            for i in range(len(m.v)):
                way += reach[i] * abs(m.velocity[i])
            m.room[k] -= way * m.dt


def stop_sizes(robot: Robot, dt: float) -> dict[str, Any]:
    """Of a `WayToRest` at control period dt [s], but for `n_limits`."""
    step, slower = _functions(robot, dt)
    return {"n_q": robot.n_q, "n_v": robot.n_v, "step": step, "slower": slower}


class Stop:
    """The velocity of the next tick on the way to rest as a function of this one's. Not for use from two threads at once."""

    def __init__(self, robot: Robot, dt: float, memory: Any = None) -> None:
        """dt [s] is the control period; memory: a `WayToRest` of the caller's, which is set up."""
        if memory is None:
            memory = structure_of(WayToRest, n_limits=1, **stop_sizes(robot, dt))()
        self.way: Any = memory
        """The `WayToRest`."""
        self.acceleration = np.minimum(robot.limits.acceleration, ENDLESS)
        """(n_v,) [m/s2, rad/s2] finite."""
        memory.dt = dt
        view(memory.acceleration)[:] = self.acceleration

    def slower(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """v (n_v,) [m/s, rad/s] one tick nearer to rest.

        Joints brake harder where their position limit, not far from q (n_q,) [m, rad], asks for it.
        """
        found = doubles(np.zeros(len(v)))
        slow_down(self.way, doubles(q), doubles(v), found)
        return np.array(found)

    def path(self, q: np.ndarray, v: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Configuration at the end of every tick and velocity during it, until rest.

        From q (n_q,) [m, rad] with v (n_v,) [m/s, rad/s].
        """
        set_out(self.way, doubles(q), doubles(v))
        while not self.way.done:
            step_on(self.way)
            yield np.array(self.way.q), np.array(self.way.velocity)


@lru_cache(maxsize=8)
def _functions(robot: Robot, dt: float) -> tuple[ca.Function, ca.Function]:
    """q, v, time to rest -> q one tick on, v then; and v alone, at q."""
    acceleration = np.minimum(robot.limits.acceleration, ENDLESS)
    q, v, time = ca.SX.sym("q", robot.n_q), ca.SX.sym("v", robot.n_v), ca.SX.sym("time")
    symbolic = SymbolicModel(robot.model)
    moved = ca.densify(symbolic.integrate(q, v * dt))
    step = [moved, _slower(robot, acceleration, dt, moved, v, time)]
    alone = [_slower(robot, acceleration, dt, q, v, time)]
    return ca.Function("step_to_rest", [q, v, time], step, {"cse": True}), ca.Function("slower", [q, v, time], alone)


def _slower(robot: Robot, acceleration: np.ndarray, dt: float, q: ca.SX, v: ca.SX, time: ca.SX) -> ca.SX:
    """v one tick nearer to rest: in proportion, where no joint has to brake harder before its limit."""
    slower = ca.if_else(time > dt, v * (1.0 - dt / time), 0.0 * v)
    for joint, lower, upper in bounded_joints(robot.joints, robot.limits):
        i, at = joint.idx_v, q[joint.idx_q]
        down, up = (stopping_speed(room, deceleration=acceleration[i], dt=dt) for room in (at - lower, upper - at))
        slower[i] = ca.fmax(ca.fmin(slower[i], up), -down)
    reach = ca.DM(acceleration * dt)
    return ca.densify(ca.fmax(ca.fmin(slower, v + reach), v - reach))
