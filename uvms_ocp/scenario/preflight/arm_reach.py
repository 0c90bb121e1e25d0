"""Inverse kinematics of an arm from many starts: the nearest that a tool comes to its goal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from uvms_ocp.control.velocity.swing import swinging_axes
from uvms_ocp.robot.limits import from_joint_values
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.static_balance import rotation_at_rest
from uvms_ocp.scenario.preflight.setup import Setup
from uvms_ocp.tasks.pose import ToolPose, ToolPosition

REACHED = 1e-3  # [m, rad] what counts as reached: the thresholds at which a tool task ends
_STARTS = 12  # random postures from which the search begins
_MARGIN = 1e-3  # share of the range by which starts keep away from the limits
_LIGHT = 0.1  # share of the weight of the rotation in the first search
_ITERATIONS = 60
_DAMPING = 1e-3  # damping of the first step
_CONVERGED = 1e-9  # share of the cost, or [rad or m] of a step, that is none; least damping
_LEAN_STEP = 1e-5  # [rad or m] of the difference quotients of the attitude at rest


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ReachResult:
    """The nearest that the tool comes to its goal."""

    joints: np.ndarray
    """(n_joints,) [rad or m] posture."""
    position: float
    """[m] distance of the frame from the goal."""
    orientation: float
    """[rad] angle of the frame from the goal; 0 where the orientation is free."""

    @property
    def reached(self) -> bool:
        """True where the frame is at its goal."""
        return self.position < REACHED and self.orientation < REACHED

    @property
    def cost(self) -> float:
        """Squared error [m^2 + rad^2]."""
        return self.position**2 + self.orientation**2


class ArmReach:
    """Inverse kinematics of an arm: Levenberg-Marquardt within the joint limits, from many starts.

    The error is that of a tool task: metres and radians count the same. rotation_weight: 0 leaves
    orientation free. leans: the vehicle comes to rest in the roll and pitch that no thruster
    drives, with the arm as it is.
    """

    def __init__(
        self,
        robot: Robot,
        frame: str,
        *,
        seed: int = 0,
        rotation_weight: float = 1.0,
        leans: bool = False,
    ) -> None:
        """seed: of the postures from which it starts."""
        self._robot = robot
        self._frame = robot.frame_id(frame)
        self._weight = rotation_weight
        self._leans = leans
        self._data = robot.model.createData()
        limits = robot.limits
        self._lower = np.where(np.isfinite(limits.position_lower), limits.position_lower, -np.pi)
        self._upper = np.where(np.isfinite(limits.position_upper), limits.position_upper, np.pi)
        rng = np.random.default_rng(seed)
        self._starts = []
        for _ in range(_STARTS):
            shares = rng.random(robot.n_joints)
            self._starts.append(self._lower + (self._upper - self._lower) * shares)

    @classmethod
    def of_task(
        cls, setup: Setup, task: ToolPose | ToolPosition, *, turned: bool = False
    ) -> ArmReach:
        """Build it for the frame of a task, with its orientation free where the task, or `turned`,
        leaves it.
        """
        leans = setup.with_forces and bool(swinging_axes(setup.robot))
        return cls(
            setup.robot,
            task.frame,
            rotation_weight=float(isinstance(task, ToolPose) and not turned),
            leans=leans,
        )

    def solve(
        self,
        X_WB: pin.SE3,
        goal: pin.SE3,
        near: Sequence[np.ndarray] = (),
        n_random: int | None = None,
    ) -> ReachResult:
        """Return the best posture for the vehicle at X_WB and the goal X_WF.

        `near` are further starts (n_joints,) [rad or m], tried first; `n_random` is how many of its
        own follow, default all.
        """
        best: ReachResult | None = None
        for start in (*near, *self._starts[:n_random]):
            candidate = self._from(X_WB, goal, start)
            if best is None or candidate.cost < best.cost:
                best = candidate
            if self._weight:
                is_reached = best.reached
            else:
                is_reached = best.position < REACHED
            if is_reached:
                break
        if best is None:
            return self._reach(X_WB, goal, 0.5 * (self._lower + self._upper))
        return best

    def _from(self, X_WB: pin.SE3, goal: pin.SE3, start: np.ndarray) -> ReachResult:
        """Search with the rotation weighed lightly first: that finds its way around more obstacles
        than the full error.
        """
        joints = start
        rotation_weights = [0.0]
        if self._weight:
            rotation_weights = [_LIGHT * self._weight, self._weight]
        for rotation_weight in rotation_weights:
            joints = self._minimise(X_WB, goal, joints, rotation_weight)
        return self._reach(X_WB, goal, joints)

    def _minimise(
        self, X_WB: pin.SE3, goal: pin.SE3, start: np.ndarray, rotation_weight: float
    ) -> np.ndarray:
        """Minimise the error by Levenberg-Marquardt; joints at a limit that a step would push
        beyond it stand still, others stop there.
        """
        weights = np.repeat([1.0, rotation_weight], 3)
        damping = _DAMPING
        lower = self._lower
        upper = self._upper
        margin = _MARGIN * (upper - lower)
        x = np.clip(start, lower + margin, upper - margin)
        error, slope = self._error(X_WB, goal, x)
        for _ in range(_ITERATIONS):
            residual = weights * error
            J = weights[:, None] * slope
            gradient = J.T @ residual
            pushed_below = (x <= lower) & (gradient > 0.0)
            pushed_above = (x >= upper) & (gradient < 0.0)
            is_free = ~(pushed_below | pushed_above)
            if not is_free.any():
                break
            H = J[:, is_free].T @ J[:, is_free]
            step = np.zeros(len(x))
            step[is_free] = np.linalg.solve(H + damping * np.eye(len(H)), -gradient[is_free])
            candidate = np.clip(x + step, lower, upper)
            candidate_error, candidate_slope = self._error(X_WB, goal, candidate)
            candidate_residual = weights * candidate_error
            cost = residual @ residual
            gain = cost - candidate_residual @ candidate_residual
            if gain <= 0.0:
                damping = 4.0 * damping
            else:
                x = candidate
                error = candidate_error
                slope = candidate_slope
                damping = max(0.2 * damping, _CONVERGED)
            if abs(gain) < _CONVERGED * cost or np.abs(step).max() < _CONVERGED:
                break
        return x

    def _error(
        self, X_WB: pin.SE3, goal: pin.SE3, joints: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute the error (6,) of the frame, frame minus goal, and its derivative (6, n_joints)."""
        model = self._robot.model
        data = self._data
        lean = np.eye(3)
        if self._leans:
            lean = self._lean_at_rest(joints)
        q = pin.neutral(model)
        if self._robot.n_vehicle:
            q[:7] = pin.SE3ToXYZQUAT(pin.SE3(X_WB.rotation @ lean, X_WB.translation))
        pin.computeJointJacobians(model, data, from_joint_values(model, joints, q))
        X_WF = pin.updateFramePlacement(model, data, self._frame)
        frame_jacobian = pin.getFrameJacobian(model, data, self._frame, pin.LOCAL_WORLD_ALIGNED)
        # Pinocchio returns a vector for a single joint.
        frame_jacobian = np.reshape(frame_jacobian, (6, model.nv))
        J = frame_jacobian[:, self._robot.joint_v]
        if self._leans:
            steps = np.copysign(_LEAN_STEP, 0.5 * (self._lower + self._upper) - joints)
            J = J + frame_jacobian[:, 3:6] @ self._turns(joints, steps, lean) / steps
        rotation_error = X_WF.rotation @ goal.rotation.T
        error = np.concatenate([X_WF.translation - goal.translation, pin.log3(rotation_error)])
        return error, np.vstack([J[:3], pin.Jlog3(rotation_error).T @ J[3:]])

    def _turns(self, joints: np.ndarray, steps: np.ndarray, lean: np.ndarray) -> np.ndarray:
        """Compute the turns (3, n_joints) [rad] of the vehicle from its lean, by a step [rad or m]
        of each joint.
        """
        turns = []
        for step in np.diag(steps):
            moved_lean = self._lean_at_rest(np.clip(joints + step, self._lower, self._upper))
            turns.append(pin.log3(lean.T @ moved_lean))
        return np.column_stack(turns)

    def _lean_at_rest(self, joints: np.ndarray) -> np.ndarray:
        """Return the rotation (3, 3) to which the vehicle comes to rest with the arm in a posture."""
        return rotation_at_rest(self._robot, self._robot.configuration(joints=joints))

    def _reach(self, X_WB: pin.SE3, goal: pin.SE3, joints: np.ndarray) -> ReachResult:
        """Measure how far the frame is from its goal."""
        error, _ = self._error(X_WB, goal, joints)
        orientation_error = 0.0
        if self._weight:
            orientation_error = float(np.linalg.norm(error[3:]))
        position_error = float(np.linalg.norm(error[:3]))
        return ReachResult(joints=joints, position=position_error, orientation=orientation_error)
