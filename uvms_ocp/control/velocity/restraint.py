"""Less than the hierarchy asks for: slower, no descent, the arm held; never by more than the acceleration limits allow."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from uvms_ocp.control.navigation.degraded import Restriction
from uvms_ocp.model.kinematics import AltimeterBeam
from uvms_ocp.model.robot import Robot


class Restraint:
    """The velocity that a restriction leaves of what is wanted."""

    def __init__(self, robot: Robot, *, dt: float, altimeter: str | None) -> None:
        """dt [s]: control period. altimeter: its frame, if the robot has one."""
        self._robot, self._step = robot, robot.limits.acceleration * dt
        self._beam = None if altimeter is None or not robot.has_frame(altimeter) else AltimeterBeam(robot, altimeter)

    def kept(self, restriction: Restriction, *, q: np.ndarray, wanted: np.ndarray, previous: np.ndarray) -> np.ndarray:
        """The velocity for this tick in place of `wanted` (n_v,) [m/s, rad/s], which keeps joint and acceleration limits.

        q (n_q,) [m, rad]: now. previous (n_v,) [m/s, rad/s]: of the tick before. Slower keeps the direction; joints that are
        held brake as fast as they can; what sinks is lifted straight up.
        """
        limit = restriction.speed * self._robot.limits.velocity
        v = wanted / np.max(np.abs(wanted) / limit, initial=1.0)
        if restriction.joints_held:
            v[self._robot.joint_v] = 0.0
        v = self._within(v, previous)
        if restriction.no_descent and self._robot.n_vehicle:
            v[:3] += self._lift(q, v)
            v = self._within(v, previous)
        return v

    def _within(self, v: np.ndarray, previous: np.ndarray) -> np.ndarray:
        return np.asarray(np.clip(v, previous - self._step, previous + self._step))

    def _lift(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Linear velocity (3,) [m/s] in B after whose addition neither vehicle nor altimeter sinks."""
        R_WB = pin.Quaternion(q[3:7]).matrix()
        rises = [float(R_WB[2] @ v[:3])]
        if self._beam is not None:
            rises.append(float(self._beam.moving(q, v)[1][2]))
        return np.asarray(R_WB[2] * max(0.0, -min(rises)))
