"""Less than the hierarchy asks for: slower, no descent, the arm held; never by more than the acceleration limits allow."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from uvms_ocp.control.navigation.degraded import Restriction
from uvms_ocp.model.kinematics import AltimeterBeam
from uvms_ocp.model.robot import Robot

_STILL = 1e-12  # [m/s, rad/s]


class Restraint:
    """The velocity that a restriction leaves of what is wanted."""

    def __init__(self, robot: Robot, *, dt: float, altimeter: str | None) -> None:
        """dt [s]: control period. altimeter: its frame, if the robot has one."""
        self._robot, self._step = robot, robot.limits.acceleration * dt
        self._beam = None if altimeter is None or not robot.has_frame(altimeter) else AltimeterBeam(robot, altimeter)

    def kept(
        self, restriction: Restriction, *, q: np.ndarray, wanted: np.ndarray, previous: np.ndarray, pace: float
    ) -> tuple[np.ndarray, float]:
        """The velocity for this tick in place of `wanted` (n_v,) [m/s, rad/s], and the pace [-] that it is at.

        q (n_q,) [m, rad]: now. previous (n_v,) [m/s, rad/s]: of the tick before, which was at `pace` [-] of what was wanted
        then. Slower keeps the direction, and so all priorities; joints that are held brake as fast as they can; what sinks is
        lifted straight up.
        """
        pace = self._pace(wanted, previous, pace, restriction.speed)
        v = pace * wanted
        if restriction.joints_held:
            v[self._robot.joint_v] = 0.0
        v = self._within(v, previous)
        if restriction.no_descent and self._robot.n_vehicle:
            v[:3] += self._lift(q, v)
            v = self._within(v, previous)
        return v, pace

    def _pace(self, wanted: np.ndarray, previous: np.ndarray, pace: float, speed: float) -> float:
        """As near to `speed` as the acceleration limits let it come in this tick; they always let it stay where it is."""
        moving = np.abs(wanted) > _STILL
        ends = (previous[moving] + np.array([[-1.0], [1.0]]) * self._step[moving]) / wanted[moving]
        low, high = float(ends.min(axis=0).max(initial=0.0)), float(ends.max(axis=0).min(initial=1.0))
        return min(max(speed, min(low, pace)), max(high, pace))

    def _within(self, v: np.ndarray, previous: np.ndarray) -> np.ndarray:
        return np.asarray(np.clip(v, previous - self._step, previous + self._step))

    def _lift(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Linear velocity (3,) [m/s] in B after whose addition neither vehicle nor altimeter sinks."""
        R_WB = pin.Quaternion(q[3:7]).matrix()
        rises = [float(R_WB[2] @ v[:3])]
        if self._beam is not None:
            rises.append(float(self._beam.moving(q, v)[1][2]))
        return np.asarray(R_WB[2] * max(0.0, -min(rises)))
