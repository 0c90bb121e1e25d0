"""Judge whether a plan may be flown: by bounds and constraints of the motion that the robot would
make, and not by how far the solve of it came.

A plan that keeps the rows of its problem is a motion of the robot, and is flown as it is. Any other
one asks for what the robot cannot do, such as a moment about an axis that no thruster turns. What
the robot would make of it is simulated: the law that tracks plans follows it, with the forces that
thrusters and motors have, on the model of the plan. That motion is judged in place of the plan, and
is what is flown.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from uvms_ocp.codegen.elementwise import interval_excess
from uvms_ocp.control.force.computed_torque import (
    Actuators,
    RateLimiter,
    TrackingGains,
    attained_acceleration,
    feedback_gains,
    undriven_axes,
)
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.trajectory import Trajectory, has_thrusters, hold_guess, intervals_of
from uvms_ocp.ocp.transcription.term_rows import CONSTRAINT, TermBlock, TermNodes, TermNumbers
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.hydrodynamics import Water
from uvms_ocp.robot.signals import State, unchecked_state

_LONGEST_STEP = 0.1
"""[s] longest step of the simulation, in which drag is implicit."""
_PREDICTION_STEP = 0.01
"""[s] step of the simulation up to the beginning of a plan: within it joints follow their motors.
"""

_POSITION = 1e-3
"""[rad or m] by which joints may pass the limits of their positions."""
_RATE = 0.02
"""Share by which rates may pass their limits."""
_FIRST = np.array([0])
"""Number of the first node."""


class PlannedMotion:
    """Simulates how the robot of a problem follows a plan of it, on the model of the plan.

    Semi-implicit Euler steps; thrusters are taken to follow their commands at once, and the water
    to move as the problem has it.
    """

    def __init__(self, problem: OcpProblem, gains: TrackingGains | None) -> None:
        self._problem = problem
        self._robot = problem.robot
        self._dynamics = robot_dynamics(problem.robot)
        gains = gains or TrackingGains()
        self._stiffness, self._damping = feedback_gains(problem.robot, gains)
        self._actuators = Actuators(problem.robot, lead=gains.lead, dt=_LONGEST_STEP)
        rate_limit = np.full(problem.robot.n_v, np.inf)
        if problem.limited:
            rate_limit = problem.robot.limits.velocity
        self._rates = RateLimiter(problem.robot, rate_limit, _LONGEST_STEP)
        self._undriven = undriven_axes(problem.robot)
        self._as_thrust = has_thrusters(problem)

    def of(self, plan: Trajectory, start: State) -> Trajectory:
        """Return the motion from a start, which may differ from the first state of the plan."""
        n_steps = len(plan.a)
        q = np.empty_like(plan.q)
        v = np.empty_like(plan.v)
        thrust = np.empty_like(plan.thrust)
        torque = np.empty_like(plan.torque)
        q[0] = start.q
        v[0] = start.v
        for k in range(n_steps):
            q[k + 1], v[k + 1], thrust[k], torque[k] = self._over(
                plan, plan.t[k], plan.t[k + 1], k, q[k], v[k], _LONGEST_STEP
            )
        a = np.diff(v, axis=0) / np.diff(plan.t)[:, None]
        return Trajectory(
            t=plan.t, q=q, v=v, a=a, thrust=thrust, torque=torque, of_wrench=plan.of_wrench
        )

    def state_after(self, plan: Trajectory, start: State, begin: float, seconds: float) -> State:
        """Return the state after a plan was followed for so many seconds from a start at `begin` [s]
        of its time; after as long as the whole plan the robot is taken to stay where it is.
        """
        end = float(plan.t[-1])
        # Beyond all numbers the end is held, too.
        if not begin < end:
            begin = end
        if not seconds < end:
            seconds = end
        step = int(intervals_of(plan.t, begin))
        q, v, _, _ = self._over(
            plan, begin, begin + seconds, step, start.q, start.v, _PREDICTION_STEP
        )
        return unchecked_state(q=q, v=v)

    def _over(
        self,
        plan: Trajectory,
        begin: float,
        end: float,
        step: int,
        q: np.ndarray,
        v: np.ndarray,
        longest: float,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Follow a plan from `begin` to `end` [s], in the water of a step, from q (n_q,) [m, rad] and
        v (n_v,) [m/s, rad/s], in steps of `longest` [s] at most; return both at the end, and the mean
        thrust and torque.
        """
        model = self._robot.model
        n_parts = max(1, int(np.ceil((end - begin) / longest)))
        h = (end - begin) / n_parts
        thrusts = []
        torques = []
        for part in range(n_parts):
            desired_q, desired_v, a = plan.state_at(model, begin + part * h)
            error = pin.difference(model, q, desired_q)
            rate_error = self._rates.velocity(desired_v) - v
            unlimited = a + self._stiffness * error + self._damping * rate_error
            desired = self._rates.acceleration(unlimited, v)
            acceleration, thrust, torque = self._accelerated(q, v, desired, h, step)
            q = pin.integrate(model, q, h * v + h * h / 2 * acceleration)
            v = v + h * acceleration
            thrusts.append(thrust)
            torques.append(torque)
        return q, v, np.mean(thrusts, axis=0), np.mean(torques, axis=0)

    def _accelerated(
        self, q: np.ndarray, v: np.ndarray, desired: np.ndarray, h: float, step: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the acceleration (n_v,) [m/s2, rad/s2] where `desired` is asked for at q (n_q,)
        [m, rad] and v (n_v,) [m/s, rad/s], over h [s], and the thrust and torque that make it.
        """
        dynamics = self._dynamics
        water = Water(velocity=self._problem.currents[step])
        # drag at the end of h, so that steps overshoot none
        inertia = dynamics.mass_matrix(q) + h * dynamics.drag_slope(q, v, water)
        bias = dynamics.bias_force(q, v, water)
        attained = attained_acceleration(self._undriven, inertia, bias, desired)
        realized = self._actuators.realize(inertia @ attained + bias)
        acceleration = np.linalg.solve(inertia, realized.force - bias)
        if self._as_thrust:
            thrust = realized.allocation.thrust
        else:
            thrust = realized.force[: self._robot.n_vehicle]
        return acceleration, thrust, realized.torque


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class CheckedPlan:
    """A plan after it was judged."""

    motion: Trajectory | None
    """The motion to fly; None where the plan is of no use."""
    reason: str
    """Reason for which the plan is of no use; else empty."""


class PlanCheck:
    """Check of the plans of one problem: whether a motion may be flown.

    A motion may be flown that passes no joint limit by more than `_POSITION`, no limit of a rate by
    more than the share `_RATE`, and no constraint by more than `accuracy`, at its nodes; or by no
    more than the robot passes them where the motion starts, which no plan can undo.
    """

    def __init__(
        self, transcription: Transcription, *, accuracy: float, gains: TrackingGains | None
    ) -> None:
        """accuracy [unit of the scaled row]: of constraints. gains: of the law that tracks."""
        self._whole = transcription
        self._problem = transcription.problem
        self._accuracy = accuracy
        self.planned_motion = PlannedMotion(transcription.problem, gains)
        self._constrained = list[tuple[TermBlock, TermNumbers]]()
        for block in transcription.blocks:
            if (block.rows.level == CONSTRAINT).any():
                self._constrained.append((block, block.rows.numbers))
        # All functions are made before any clock runs.
        hold = hold_guess(self._problem)
        self.unsafe(self.planned_motion.of(hold, self._problem.start), 0.0)

    def judged(self, plan: Trajectory, start: State, t0: float, violation: float) -> CheckedPlan:
        """Judge a plan that begins at t0 [s] in a start.

        violation: of its rows, by a solver that has evaluated them at the plan; infinite for a
        point that no step has led to.
        """
        if not np.isfinite(violation):
            return CheckedPlan(motion=None, reason="no step of the solver came to an end")
        if violation <= self._accuracy:
            return CheckedPlan(motion=plan, reason="")
        motion = self.planned_motion.of(plan, start)
        reason = self.unsafe(motion, t0)
        if reason:
            return CheckedPlan(motion=None, reason=reason)
        return CheckedPlan(motion=motion, reason="")

    def unsafe(self, motion: Trajectory, t0: float) -> str:
        """Describe what a motion that begins at t0 [s] breaks; empty where that is nothing."""
        if not (np.isfinite(motion.q).all() and np.isfinite(motion.v).all()):
            return "the motion that it leads to grows beyond all numbers"
        broken = self._broken_constraint(motion, t0)
        if broken or not self._problem.limited:
            return broken
        return self._passed_position(motion) or self._passed_rate(motion)

    def _passed_position(self, motion: Trajectory) -> str:
        robot = self._problem.robot
        lower, upper = robot.configuration_bounds
        excess = interval_excess(motion.q, lower, upper)[:, robot.joint_q]
        allowed = np.maximum(_POSITION, excess[0])
        over = excess - allowed
        if not (over > 0).any():
            return ""
        node, joint = np.unravel_index(int(over.argmax()), over.shape)
        return f"joint {joint} passes its limit by {excess[node, joint]:.2g} rad or m"

    def _passed_rate(self, motion: Trajectory) -> str:
        share = np.abs(motion.v) / self._problem.robot.limits.velocity
        over = share - np.maximum(1.0 + _RATE, share[0])
        if not (over > 0).any():
            return ""
        node, axis = np.unravel_index(int(over.argmax()), over.shape)
        return f"the rate of axis {axis} is {share[node, axis]:.3g} times its limit"

    def _broken_constraint(self, motion: Trajectory, t0: float) -> str:
        for block, numbers in self._constrained:
            is_constraint = block.rows.level == CONSTRAINT
            excess = self._excess(block, numbers, motion, t0, block.nodes)[:, is_constraint]
            at_start = self._excess(block, numbers, motion, t0, _FIRST)[:, is_constraint]
            over = excess - np.maximum(self._accuracy, np.nan_to_num(at_start))
            # a row that is no number is broken
            bad = ~(over <= 0)
            if bad.any():
                node, row = np.argwhere(bad)[np.argmax(excess[bad])]
                name = np.array(block.rows.names)[is_constraint][row]
                return f"constraint {name!r} is broken by {excess[node, row]:.2g}"
        return ""

    def _excess(
        self,
        block: TermBlock,
        numbers: TermNumbers,
        motion: Trajectory,
        t0: float,
        at: np.ndarray,
    ) -> np.ndarray:
        """Return by how much (n, n_rows) [unit of the scaled row] the rows of a block are broken at
        the nodes numbered `at` (n,).
        """
        nodes = TermNodes(
            times=(t0 + motion.t[at]).tolist(),
            active=[True] * len(at),
            q=motion.q[at],
            tightened={},
        )
        parameters = numbers.parameters(nodes, 1.0 / motion.t[-1]).reshape(len(at), -1)
        currents = self._problem.currents[np.minimum(at, len(motion.a) - 1)]
        z = self._variables(motion)[at]
        rows = list[np.ndarray]()
        for arguments in zip(z, parameters, currents, strict=True):
            rows.append(np.array(block.rows.value(*arguments)).ravel())
        return np.asarray(interval_excess(np.array(rows), numbers.lower, numbers.upper))

    def _variables(self, motion: Trajectory) -> np.ndarray:
        """Return the variables (n_nodes, n_z) of every node; of the last one the state alone."""
        model = self._whole.model
        layout = model.layout
        z = np.zeros((len(motion.t), layout.n_z))
        z[:, layout.q] = motion.q
        z[:, layout.v] = motion.v
        z[:-1, layout.h] = np.diff(motion.t)
        z[:-1, layout.a] = motion.a
        if model.has_force_variables:
            z[:-1, layout.thrust] = motion.thrust / model.actuators.thrust_unit
            z[:-1, layout.torque] = motion.torque / model.actuators.torque_unit
        return z
