"""Layout of the variables of the NLP: those of step after step, then the state of the last node;
units are those of z.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np

from uvms_ocp.codegen.buffered import BufferedFunction
from uvms_ocp.errors import InvalidInput
from uvms_ocp.ocp.node_margins import NO_TIGHTENING, Tightening
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.trajectory import Trajectory, has_thrusters, unchecked_trajectory
from uvms_ocp.ocp.transcription.stage import StageModel

_FIXED_DURATION_SLACK = 1e-6  # [s] a range of no width would leave interior points no inside


@dataclass(frozen=True, kw_only=True, eq=False)
class VariableLayout:
    """Layout of the entries of z of every node in the variables x (n_x,); converts trajectories to
    variables.
    """

    model: StageModel

    @property
    def N(self) -> int:
        """Number of steps."""
        return self.model.problem.n_steps

    @property
    def free(self) -> bool:
        """Durations are variables."""
        return self.model.problem.free_time

    @cached_property
    def n_step(self) -> int:
        """Number of variables of a step."""
        return self.model.layout.n_z - (not self.free)

    @cached_property
    def n_state(self) -> int:
        """Number of variables of the last node."""
        return self.model.layout.h + self.free

    @cached_property
    def n_x(self) -> int:
        """Number of variables."""
        return self.N * self.n_step + self.n_state

    @cached_property
    def _column(self) -> np.ndarray:
        """(n_z,) index of every entry of z among the variables of its step; -1 where it is none."""
        is_variable = np.ones(self.model.layout.n_z, dtype=bool)
        is_variable[self.model.layout.h] = self.free
        return np.where(is_variable, np.cumsum(is_variable) - 1, -1)

    def columns(self, node: int) -> np.ndarray:
        """Return the index in x of every entry of z at a node (n_z,); -1 where it is no
        variable.
        """
        columns = np.where(self._column >= 0, self._column + node * self.n_step, -1)
        if node == self.N:
            columns[self.model.layout.h + 1 :] = -1
        return columns

    @cached_property
    def all_columns(self) -> np.ndarray:
        """(N + 1, n_z) columns of all nodes."""
        return np.array([self.columns(k) for k in range(self.N + 1)])

    def nodes(self, x: ca.MX, h: ca.MX) -> NodeVariables:
        """Return the variables x (n_x,) as columns; h (N,) [s]: lengths of the steps where they are
        no variables.
        """
        layout = self.model.layout
        n = self.N * self.n_step
        steps = ca.reshape(x[:n], self.n_step, self.N)
        last_state = x[n:]
        following = ca.horzcat(steps[: self.n_state, 1:], last_state)
        if not self.free:
            steps = ca.vertcat(steps[: layout.h, :], h.T, steps[layout.h :, :])
        last = ca.vertcat(last_state, ca.MX.zeros(layout.n_z - self.n_state))
        return NodeVariables(steps=steps, last=last, following=following)

    def bounds(
        self, problem: OcpProblem, tightened: Tightening = NO_TIGHTENING
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return bounds (n_x,) of the variables: limits of the robot, durations of a problem of the
        same shape; narrower where nodes are asked for more.
        """
        step_lower, step_upper = self._step_bounds()
        lower = self._at_all_nodes(step_lower)
        upper = self._at_all_nodes(step_upper)
        self._narrow(tightened, lower, upper)
        if self.free:
            self._bound_durations(problem, lower, upper)
        if problem.fixed_start:
            # It is given by rows; bounds on it could only contradict them.
            start = self.columns(0)[: self.model.layout.h]
            lower[start] = -np.inf
            upper[start] = np.inf
        return lower, upper

    def bounds_around(
        self, q: np.ndarray, radius: float, lower: np.ndarray, upper: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return bounds (n_x,) narrower by joints that go no farther than radius [m, rad] from
        configurations q (N + 1, n_q) [m, rad], the start excepted, which is given.
        """
        positions = self.model.robot.limited_positions
        columns = self.all_columns[1:, positions]
        inside = np.clip(q[1:, positions], lower[columns], upper[columns])
        narrow_lower = lower.copy()
        narrow_upper = upper.copy()
        narrow_lower[columns] = np.maximum(lower[columns], inside - radius)
        narrow_upper[columns] = np.minimum(upper[columns], inside + radius)
        return narrow_lower, narrow_upper

    def _step_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Return bounds (n_z,) of the entries of z."""
        robot = self.model.robot
        layout = self.model.layout
        actuators = self.model.actuators
        lower = np.full(layout.n_z, -np.inf)
        upper = np.full(layout.n_z, np.inf)
        if not self.model.problem.limited:
            return lower, upper
        lower[layout.q], upper[layout.q] = robot.configuration_bounds
        lower[layout.v] = -robot.limits.velocity
        upper[layout.v] = robot.limits.velocity
        lower[layout.a] = -robot.limits.acceleration
        upper[layout.a] = robot.limits.acceleration
        lower[layout.thrust] = actuators.thrust_lower
        upper[layout.thrust] = actuators.thrust_upper
        lower[layout.torque] = -actuators.torque_limit
        upper[layout.torque] = actuators.torque_limit
        return lower, upper

    def _at_all_nodes(self, z: np.ndarray) -> np.ndarray:
        """Return variables (n_x,) with the same z (n_z,) at all nodes."""
        x = np.empty(self.n_x)
        is_variable = self.all_columns >= 0
        x[self.all_columns[is_variable]] = np.broadcast_to(z, is_variable.shape)[is_variable]
        return x

    def _narrow(self, tightened: Tightening, lower: np.ndarray, upper: np.ndarray) -> None:
        """Narrow bounds (n_x,) in place, where nodes are asked for more."""
        layout = self.model.layout
        actuators = self.model.actuators
        positions = self.model.robot.limited_positions
        parts = (
            (tightened.positions, positions, np.ones(len(positions))),
            (tightened.thrust, _indices(layout.thrust), 1.0 / actuators.thrust_unit),
            (tightened.torque, _indices(layout.torque), 1.0 / actuators.torque_unit),
        )
        for margins, entries, unit in parts:
            if margins is None or not len(entries):
                continue
            columns = self.all_columns[:, entries]
            narrow_lower, narrow_upper = margins.narrowed(lower[columns], upper[columns], unit)
            is_variable = columns >= 0
            lower[columns[is_variable]] = narrow_lower[is_variable]
            upper[columns[is_variable]] = narrow_upper[is_variable]

    def _bound_durations(self, problem: OcpProblem, lower: np.ndarray, upper: np.ndarray) -> None:
        """Bound the lengths of steps in place, so that phases last as long as they may."""
        phase_of_node = []
        for phase in problem.phases:
            phase_of_node += [phase] * phase.n_steps
        phase_of_node.append(problem.phases[-1])
        for k, phase in enumerate(phase_of_node):
            shortest, longest = phase.range
            slack = 0.0 if phase.free else _FIXED_DURATION_SLACK
            h = self.columns(k)[self.model.layout.h]
            lower[h] = (shortest - slack) / phase.n_steps
            upper[h] = (longest + slack) / phase.n_steps

    def pack(self, trajectory: Trajectory) -> np.ndarray:
        """Return the variables (n_x,) of a trajectory; times are taken as they are where durations
        are free.

        Raises `InvalidInput` for a trajectory of another number of steps.
        """
        if len(trajectory.a) != self.N:
            raise InvalidInput(
                f"the guess has {len(trajectory.a)} steps; give one of {self.N}, such as `through`"
                " makes"
            )
        parts = [np.diff(trajectory.t)[:, None], trajectory.a]
        if self.model.has_force_variables:
            actuators = self.model.actuators
            parts.append(trajectory.thrust / actuators.thrust_unit)
            parts.append(trajectory.torque / actuators.torque_unit)
        steps = np.hstack(parts)
        steps_and_last = np.vstack([steps, steps[-1:]])
        Z = np.hstack([trajectory.q, trajectory.v, steps_and_last])
        x = np.zeros(self.n_x)
        is_variable = self.all_columns >= 0
        x[self.all_columns[is_variable]] = Z[is_variable]
        return x

    def unpack(self, x: np.ndarray, problem: OcpProblem) -> Trajectory:
        """Return the trajectory of variables x (n_x,) [unit of x]; where durations are fixed, with
        those of the problem.

        Numbers that are not finite stay so: the status of a result says whether they are, and
        receding horizon goes by it.
        """
        layout = self.model.layout
        actuators = self.model.actuators
        Z = np.zeros((self.N + 1, layout.n_z))
        is_variable = self.all_columns >= 0
        Z[is_variable] = x[self.all_columns[is_variable]]
        if self.free:
            steps = Z[:-1, layout.h]
        else:
            steps = np.diff(problem.nominal_times())
        Z[:-1, layout.h] = steps
        thrust, torque = self._inputs(Z[:-1].T, problem.currents.T)
        parts = {
            "t": np.concatenate([[0.0], np.cumsum(steps)]),
            "q": Z[:, layout.q].copy(),
            "v": Z[:, layout.v].copy(),
            "a": Z[:-1, layout.a].copy(),
            "thrust": thrust.reshape(-1, self.N).T * actuators.thrust_unit,
            "torque": torque.reshape(-1, self.N).T * actuators.torque_unit,
        }
        for part in parts.values():
            part.flags.writeable = False
        return unchecked_trajectory(**parts, of_wrench=not has_thrusters(self.model.problem))

    @cached_property
    def _inputs(self) -> BufferedFunction:
        """``z (n_z, N), water (3, N) -> thrust, torque`` in shares of their limits."""
        return BufferedFunction(self.model.inputs_function.map(self.N))


class NodeVariables(NamedTuple):
    """Variables as columns, node by node."""

    steps: ca.MX
    """(n_z, N) z of all steps."""
    last: ca.MX
    """(n_z,) z of the last node, zero but for its state."""
    following: ca.MX
    """(n_state, N) state at the end of each step."""


def _indices(part: slice) -> np.ndarray:
    return np.arange(part.start, part.stop)
