"""The variables of the NLP: those of step after step, then the state of the last node; units are those of z."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.functions import BufferedFunction
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.trajectory import Trajectory, has_thrusters, made_trajectory
from uvms_ocp.ocp.transcription.stage import StageModel


class NodeVariables(NamedTuple):
    """The variables as columns, node by node."""

    steps: ca.MX
    """(n_z, N) z of all steps"""
    last: ca.MX
    """(n_z,) z of the last node, zero but for its state"""
    following: ca.MX
    """(n_state, N) state at the end of each step"""


@dataclass(frozen=True, kw_only=True, eq=False)
class VariableLayout:
    """Where the entries of z of every node are among the variables x (n_x,), and how trajectories become variables."""

    model: StageModel

    @property
    def N(self) -> int:
        return self.model.problem.n_steps

    @property
    def free(self) -> bool:
        """Durations are variables."""
        return self.model.problem.free_time

    @cached_property
    def _column(self) -> np.ndarray:
        """(n_z,) place of every entry of z among the variables of its step; -1 where it is none."""
        kept = np.ones(self.model.layout.n_z, dtype=bool)
        kept[self.model.layout.h] = self.free
        return np.where(kept, np.cumsum(kept) - 1, -1)

    @cached_property
    def n_step(self) -> int:
        """Variables of a step."""
        return self.model.layout.n_z - (not self.free)

    @cached_property
    def n_state(self) -> int:
        """Variables of the last node."""
        return self.model.layout.h + self.free

    @cached_property
    def n_x(self) -> int:
        return self.N * self.n_step + self.n_state

    def columns(self, node: int) -> np.ndarray:
        """Index in x of every entry of z at a node (n_z,); -1 where it is no variable."""
        columns = np.where(self._column >= 0, self._column + node * self.n_step, -1)
        if node == self.N:
            columns[self.model.layout.h + 1 :] = -1
        return columns

    @cached_property
    def all_columns(self) -> np.ndarray:
        """(N + 1, n_z) of all nodes."""
        return np.array([self.columns(k) for k in range(self.N + 1)])

    @cached_property
    def _inputs(self) -> BufferedFunction:
        """``z (n_z, N), water (3, N) -> thrust, torque`` in shares of their limits."""
        return BufferedFunction(self.model.inputs_function.map(self.N))

    def nodes(self, x: ca.MX, h: ca.MX) -> NodeVariables:
        """Columns of the variables x (n_x,); h (N,) [s]: lengths of the steps where they are no variables."""
        layout, n = self.model.layout, self.N * self.n_step
        W, end = ca.reshape(x[:n], self.n_step, self.N), x[n:]
        return NodeVariables(
            steps=W if self.free else ca.vertcat(W[: layout.h, :], h.T, W[layout.h :, :]),
            last=ca.vertcat(end, ca.MX.zeros(layout.n_z - self.n_state)),
            following=ca.horzcat(W[: self.n_state, 1:], end),
        )

    def bounds(self, problem: OcpProblem) -> tuple[np.ndarray, np.ndarray]:
        """Bounds (n_x,) of the variables: limits of the robot, durations of a problem of the same shape."""
        lower, upper = self._step_bounds()
        low, up = np.full(self.n_x, -np.inf), np.full(self.n_x, np.inf)
        for k in range(self.N + 1):
            columns = self.columns(k)
            used = columns >= 0
            low[columns[used]], up[columns[used]] = lower[used], upper[used]
        if self.free:
            self._bound_durations(problem, low, up)
        if problem.fixed_start:
            # It is given by rows; bounds on it could only contradict them.
            first = self.columns(0)[: self.model.layout.h]
            low[first], up[first] = -np.inf, np.inf
        return low, up

    def _bound_durations(self, problem: OcpProblem, low: np.ndarray, up: np.ndarray) -> None:
        phases = [phase for phase in problem.phases for _ in range(phase.n_steps)]
        for k, phase in enumerate([*phases, phases[-1]]):
            shortest, longest = phase.range
            # A range of no width would leave interior points no inside.
            slack = 0.0 if phase.free else 1e-6
            h = self.columns(k)[self.model.layout.h]
            low[h], up[h] = (shortest - slack) / phase.n_steps, (longest + slack) / phase.n_steps

    def _step_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        robot, layout, actuators = self.model.robot, self.model.layout, self.model.actuators
        lower, upper = np.full(layout.n_z, -np.inf), np.full(layout.n_z, np.inf)
        if not self.model.problem.limited:
            return lower, upper
        first = robot.n_vehicle
        for joint in robot.joints:
            if joint.n_q == joint.n_v:
                own = slice(joint.idx_v - first, joint.idx_v - first + joint.n_v)
                lower[joint.q], upper[joint.q] = robot.limits.position_lower[own], robot.limits.position_upper[own]
        for part, limit in ((layout.v, robot.limits.velocity), (layout.a, robot.limits.acceleration)):
            lower[part], upper[part] = -limit, limit
        lower[layout.thrust], upper[layout.thrust] = actuators.thrust_lower, actuators.thrust_upper
        lower[layout.torque], upper[layout.torque] = -actuators.torque_limit, actuators.torque_limit
        return lower, upper

    def pack(self, trajectory: Trajectory) -> np.ndarray:
        """Variables (n_x,) of a trajectory; times are taken as they are where durations are free.

        Raises `InvalidInput` for a trajectory of another number of steps.
        """
        if len(trajectory.a) != self.N:
            raise InvalidInput(
                f"the guess has {len(trajectory.a)} steps; give one of {self.N}, such as `through` makes"
            )
        actuators = self.model.actuators
        shares = (trajectory.thrust / actuators.thrust_unit, trajectory.torque / actuators.torque_unit)
        inputs = shares if self.model.decides_forces else ()
        steps = np.hstack([np.diff(trajectory.t)[:, None], trajectory.a, *inputs])
        Z = np.hstack([trajectory.q, trajectory.v, np.vstack([steps, steps[-1:]])])
        x, used = np.zeros(self.n_x), self.all_columns >= 0
        x[self.all_columns[used]] = Z[used]
        return x

    def unpack(self, x: np.ndarray, problem: OcpProblem) -> Trajectory:
        """The trajectory of variables x (n_x,) [unit of x]; where durations are fixed, with those of the problem.

        Numbers that are not finite stay so: the status of a result says whether they are, and receding horizon goes by it.
        """
        layout, actuators = self.model.layout, self.model.actuators
        Z, used = np.zeros((self.N + 1, layout.n_z)), self.all_columns >= 0
        Z[used] = x[self.all_columns[used]]
        steps = Z[:-1, layout.h] if self.free else np.diff(problem.nominal_times())
        Z[:-1, layout.h] = steps
        thrust, torque = (part.reshape(-1, self.N).T for part in self._inputs(Z[:-1].T, problem.currents.T))
        parts = {
            "t": np.concatenate([[0.0], np.cumsum(steps)]),
            "q": Z[:, layout.q].copy(),
            "v": Z[:, layout.v].copy(),
            "a": Z[:-1, layout.a].copy(),
            "thrust": thrust * actuators.thrust_unit,
            "torque": torque * actuators.torque_unit,
        }
        for part in parts.values():
            part.flags.writeable = False
        return made_trajectory(**parts, of_wrench=not has_thrusters(self.model.problem))
