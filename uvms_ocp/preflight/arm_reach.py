"""Inverse kinematics of the arm on a vehicle that stands still."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from uvms_ocp.model.robot import Robot

REACHED = 1e-3  # [m, rad] what counts as reached: the thresholds at which a tool task ends
_MARGIN = 1e-3  # share of the range by which starts keep away from the limits


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Reach:
    """The nearest that the tool comes to its goal."""

    joints: np.ndarray
    """(n_joints,) [rad or m]"""
    position: float
    """[m] distance missing."""
    orientation: float
    """[rad] angle missing; 0 where it is free."""

    @property
    def reached(self) -> bool:
        return self.position < REACHED and self.orientation < REACHED

    @property
    def cost(self) -> float:
        return self.position**2 + self.orientation**2


class ArmReach:
    """Searches postures within the joint limits for a frame to meet a pose, from many starts (bounded least squares).

    The error is that of a tool task: metres and radians count the same. rotation_weight [-]: 0 leaves orientation free.
    """

    def __init__(
        self, robot: Robot, frame: str, *, n_starts: int = 12, seed: int = 0, rotation_weight: float = 1.0
    ) -> None:
        self._robot, self._frame, self._weight = robot, robot.frame_id(frame), rotation_weight
        self._data = robot.model.createData()
        limits = robot.limits
        self._lower = np.where(np.isfinite(limits.position_lower), limits.position_lower, -np.pi)
        self._upper = np.where(np.isfinite(limits.position_upper), limits.position_upper, np.pi)
        rng = np.random.default_rng(seed)
        self._starts = [self._lower + (self._upper - self._lower) * rng.random(robot.n_joints) for _ in range(n_starts)]

    def solve(
        self, X_WB: pin.SE3, goal: pin.SE3, near: Sequence[np.ndarray] = (), n_random: int | None = None
    ) -> Reach:
        """The best posture for the vehicle at X_WB and the goal X_WF.

        `near` are further starts (n_joints,) [rad or m], tried first; `n_random` is how many of its own follow, default all.
        """
        best: Reach | None = None
        for start in (*near, *self._starts[:n_random]):
            for found in self._from(X_WB, goal, start):
                best = found if best is None or found.cost < best.cost else best
            if best is not None and (best.reached if self._weight else best.position < REACHED):
                break
        if best is None:
            return self._reach(X_WB, goal, 0.5 * (self._lower + self._upper))
        return best

    def _from(self, X_WB: pin.SE3, goal: pin.SE3, start: np.ndarray) -> Iterator[Reach]:
        """With the rotation weighed lightly first: it finds its way around more obstacles than the full error."""
        x = start
        for weight in (0.1 * self._weight, self._weight) if self._weight else (0.0,):
            x = self._minimise(X_WB, goal, x, weight)
        yield self._reach(X_WB, goal, x)

    def _minimise(self, X_WB: pin.SE3, goal: pin.SE3, start: np.ndarray, weight: float) -> np.ndarray:
        from scipy.optimize import least_squares  # half a second, which few need

        weights = np.repeat([1.0, weight], 3)
        span = _MARGIN * (self._upper - self._lower)
        result = least_squares(
            lambda x: weights * self._error(X_WB, goal, x)[0],
            np.clip(start, self._lower + span, self._upper - span),
            lambda x: weights[:, None] * self._error(X_WB, goal, x)[1],
            bounds=(self._lower, self._upper),
            xtol=1e-10,
            max_nfev=60,
        )
        return np.asarray(result.x)

    def _error(self, X_WB: pin.SE3, goal: pin.SE3, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Error (6,) of the frame, frame minus goal, and its derivative (6, n_joints)."""
        model, data = self._robot.model, self._data
        pin.computeJointJacobians(model, data, self._configuration(X_WB, joints))
        X_WF = pin.updateFramePlacement(model, data, self._frame)
        J = pin.getFrameJacobian(model, data, self._frame, pin.LOCAL_WORLD_ALIGNED)[:, self._robot.joint_v]
        R = X_WF.rotation @ goal.rotation.T
        error = np.concatenate([X_WF.translation - goal.translation, pin.log3(R)])
        return error, np.vstack([J[:3], pin.Jlog3(R).T @ J[3:]])

    def _reach(self, X_WB: pin.SE3, goal: pin.SE3, joints: np.ndarray) -> Reach:
        error, _ = self._error(X_WB, goal, joints)
        return Reach(
            joints=joints,
            position=float(np.linalg.norm(error[:3])),
            orientation=float(np.linalg.norm(error[3:])) if self._weight else 0.0,
        )

    def _configuration(self, X_WB: pin.SE3, joints: np.ndarray) -> np.ndarray:
        v = np.zeros(self._robot.n_v)
        v[self._robot.joint_v] = joints
        q = pin.integrate(self._robot.model, pin.neutral(self._robot.model), v)
        if self._robot.n_vehicle:
            q[:7] = pin.SE3ToXYZQUAT(X_WB)
        return q
