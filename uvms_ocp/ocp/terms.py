"""Terms of an optimal control problem: rows of state and input that serve as objectives and as
constraints alike.

In a level the distance of the rows to their range is minimised; as a constraint the range is kept.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Annotated, ClassVar, TypeAlias

import casadi as ca
import numpy as np

from uvms_ocp.checks import checked, checked_dataclass
from uvms_ocp.errors import InvalidInput
from uvms_ocp.ocp.node_margins import NodeMargins
from uvms_ocp.record.meta_values import ObstacleMeta
from uvms_ocp.robot.limits import bounded_joints
from uvms_ocp.robot.robot import Robot
from uvms_ocp.tasks.goals import VectorGoal, evaluate_vector
from uvms_ocp.tasks.task import Residual, Task, TickSymbols, zero_residual
from uvms_ocp.types import Array, Bound, Magnitude, Range

# share of the limit below which powers flatten out, so that they can be differentiated at 0
_ROUNDING = 0.02

Bounds: TypeAlias = Bound | Annotated[np.ndarray, Range()]
OwnRows = Callable[..., ca.SX]
"""``stage -> rows``, or ``stage, parameters -> rows`` for a term that has parameters; rows (m,) as
CasADi SX.
"""


class At(Enum):
    """Nodes at which a term counts: along its phase, or at the phase's end."""

    PATH = "path"
    END = "end"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class StageSymbols:
    """State and input of one step. Inputs are shares of their limits; see
    `uvms_ocp.ocp.transcription.stage`.
    """

    tick: TickSymbols
    acceleration: ca.SX
    """(n_v,) [m/s2, rad/s2] accelerations."""
    thrust: ca.SX
    """(n_thrusters,) [N]; with `Actuation.WRENCH` (n_vehicle,) [N, N m]."""
    thrust_share: ca.SX
    """(n_thrusters,) thrust in shares of the limits."""
    torque: ca.SX
    """(n_joints,) [N m or N] torques of the joints."""
    torque_share: ca.SX
    """(n_joints,) torque in shares of the limits."""


@checked_dataclass(eq=False)
class Term(ABC):
    """Rows over a horizon. Raises `InvalidInput` for a weight that is not finite and positive."""

    state_only: ClassVar[bool] = True
    """True where no row depends on inputs."""
    is_goal: ClassVar[bool] = True
    """True for goals, which a plan misses where it leaves their range; False for costs."""
    minimises_time: ClassVar[bool] = False
    """True where the cost is the duration."""
    has_sides: ClassVar[bool] = False
    """True where references tell on which side of a thin obstacle a node stays; see
    `NodeMargins.sides`.
    """
    rows_are_quantities: ClassVar[bool] = True
    """True where the range is that of the rows themselves, False where rows stand for other
    quantities.
    """
    needs_powers: ClassVar[bool] = False
    """True where rows are electrical powers."""
    at: At = At.END
    """Nodes at which it counts."""
    weight: float = 1.0
    """[1/unit of the row^2] Factor on the squares of the rows, so that the rows are scaled by its
    root.
    """
    phase: str | None = None
    """Name of the phase in which it counts; by default all along, or at the very end."""

    def __post_init__(self) -> None:
        if not (np.isfinite(self.weight) and self.weight > 0):
            raise InvalidInput(f"{self.name}: weight = {self.weight}; give a finite value > 0")

    @property
    @abstractmethod
    def name(self) -> str:
        """Name of the term, for reports."""

    @abstractmethod
    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        """Return the rows; `parameters` holds what `reference` returns at the time of the node."""

    def n_parameters(self, robot: Robot) -> int:
        """Return the length of the vector that `reference` returns."""
        return 0

    def reference(self, t: float) -> np.ndarray:
        """Return the parameters (n_parameters,) of the rows at time t [s]: goals and obstacles,
        which may be replaced in a planner that is kept.
        """
        return np.zeros(0)

    def references(
        self, times: Sequence[float], q: np.ndarray, tightened: NodeMargins | None = None
    ) -> np.ndarray:
        """Return `reference` (n, n_parameters) at nodes of times (n,) [s] and configurations q (n,
        n_q) [m, rad].

        tightened: margins beyond the range, for terms with `has_sides`; the bounds of other terms
        are narrowed instead.
        """
        if type(self).reference is Term.reference:
            return np.zeros((len(times), 0))
        return np.array([self.reference(t) for t in times])

    def scenery(self, t: float) -> tuple[ObstacleMeta, ...]:
        """Return the obstacles to draw at time t [s]."""
        return ()


@checked_dataclass(eq=False)
class TaskRows(Term):
    """Rows of a task of the velocity hierarchy, with its name, goal and environment."""

    task: Task
    """Task whose rows these are."""

    @property
    def name(self) -> str:
        return self.task.name

    def n_parameters(self, robot: Robot) -> int:
        return self.task.n_parameters(robot)

    def reference(self, t: float) -> np.ndarray:
        return self.task.reference(t)


@checked_dataclass(eq=False)
class TaskTerm(TaskRows):
    """A task of the velocity hierarchy over the horizon, by its `Task.residual`.

    Raises `InvalidInput` for a tolerance that is negative or not finite.
    """

    tolerance: Magnitude = 0.0
    """[unit of the row] Width by which the range of every row is widened."""

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        residual = self.task.residual(stage.tick, parameters)
        return Residual(
            value=residual.value,
            lower=residual.lower - self.tolerance,
            upper=residual.upper + self.tolerance,
        )


@checked_dataclass(eq=False)
class AtRest(Term):
    """All velocities are zero, in shares of their limits."""

    name = "at rest"

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        unit = finite_or(stage.tick.robot.limits.velocity, 1.0)
        return zero_residual(stage.tick.velocity / ca.DM(unit))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _PathCost(Term):
    """A cost along the path, an integral over time that has the name of its class."""

    is_goal: ClassVar[bool] = False
    at: At = At.PATH

    @property
    def name(self) -> str:
        return type(self).__name__.lower()


@checked_dataclass(eq=False)
class Effort(_PathCost):
    """Thrust and torque, in shares of their limits: the integral of their squares."""

    state_only: ClassVar[bool] = False

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        return zero_residual(ca.vertcat(stage.thrust_share, stage.torque_share))


@checked_dataclass(eq=False)
class Energy(_PathCost):
    """Electrical energy: rows whose squares are the powers of thrusters and joints [kW], smooth at
    zero.

    Thruster ``k |T|^n`` and joint ``|tau q_dot| / efficiency``, as in the robot's description. For
    a vehicle it needs the power of every thruster, and thrusters instead of a wrench: `OcpProblem`
    refuses what it would leave out.
    """

    state_only: ClassVar[bool] = False
    needs_powers: ClassVar[bool] = True

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        description = stage.tick.robot.description
        rows = []
        for i, thruster in enumerate(description.thrusters):
            power = thruster.power
            if power is not None:
                root = _root_of_power(stage.thrust[i] / power.thrust, power.exponent)
                rows.append(np.sqrt(power.watts / 1e3) * root)
        rates = stage.tick.velocity[stage.tick.robot.joint_v]
        for torque, rate in zip(ca.vertsplit(stage.torque), ca.vertsplit(rates), strict=True):
            power_kw = torque * rate / (1e3 * description.joint_efficiency)
            rows.append(_root_of_power(power_kw, 1.0))
        return zero_residual(ca.vertcat(ca.SX(0, 1), *rows))


@checked_dataclass(eq=False)
class Smoothness(_PathCost):
    """Accelerations, in shares of their limits: the integral of their squares."""

    state_only: ClassVar[bool] = False

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        unit = finite_or(stage.tick.robot.limits.acceleration, 1.0)
        return zero_residual(stage.acceleration / ca.DM(unit))


@checked_dataclass(eq=False)
class Duration(_PathCost):
    """Time: a row of ones, whose integral is the duration. Of use where durations are free."""

    state_only: ClassVar[bool] = False
    minimises_time: ClassVar[bool] = True

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        return zero_residual(ca.SX(1))


@checked_dataclass(eq=False)
class Posture(_PathCost):
    """Distance of the joints from a preferred posture, in shares of their range, or of a turn where
    they are endless: the integral of the squares.
    """

    q: Annotated[np.ndarray, Range(open=True)]
    """(n_q,) [m, rad] configuration, of which joints with two limits and endless ones are used."""

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        robot = stage.tick.robot
        ranges = []
        for joint, lower, upper in bounded_joints(robot.joints, robot.limits):
            width = upper - lower
            if 0.0 < width < np.inf:
                ranges.append((joint, width))
        for joint in robot.joints:
            if joint.endless:
                ranges.append((joint, 2 * np.pi))
        rows = []
        for joint, width in ranges:
            rows.append(joint.way(parameters, joint.position(stage.tick.q)) / width)
        return zero_residual(ca.vertcat(ca.SX(0, 1), *rows))

    def n_parameters(self, robot: Robot) -> int:
        return robot.n_q

    def reference(self, t: float) -> np.ndarray:
        return self.q


def finite_or(limit: np.ndarray, unit: float) -> np.ndarray:
    """Return each limit (n,) [any], or `unit` where there is none, for rows to be scaled by."""
    return np.where(np.isfinite(limit) & (limit > 0), limit, unit)


def _root_of_power(x: ca.SX, exponent: float) -> ca.SX:
    """Return the signed square root of ``|x|^exponent``, linear near zero."""
    return x * (x**2 + _ROUNDING**2) ** ((exponent / 2 - 1) / 2)


@checked_dataclass(eq=False)
class _FunctionTerm(Term):
    """Term whose rows a user's function computes, within bounds."""

    label: str
    """Name of the term."""
    rows: OwnRows
    """Function that computes the rows."""
    lower: Bounds
    """[unit of the row] lower bound of all rows, or of each (m,)."""
    upper: Bounds
    """[unit of the row] upper bound of all rows, or of each (m,)."""
    parameters: VectorGoal | None
    """Parameters that the function is given; `None` for a function of the stage alone."""
    # What holds for all terms of a package's class holds here for one term.
    state_only: bool = True  # type: ignore[misc]
    is_goal: bool = True  # type: ignore[misc]

    @property
    def name(self) -> str:
        return self.label

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        if self.parameters is None:
            value = self.rows(stage)
        else:
            value = self.rows(stage, parameters)
        if not isinstance(value, ca.SX) or value.shape[1] != 1 or not value.shape[0]:
            kind = type(value).__name__
            shape = getattr(value, "shape", ())
            raise InvalidInput(
                f"{self.label}: its function gave {kind} of shape {shape}; give a column (m, 1) of"
                " casadi.SX"
            )
        if self.state_only and _reads_inputs(value, stage):
            raise InvalidInput(
                f"{self.label}: its rows depend on acceleration, thrust or torque; give inputs=True"
            )
        m = value.shape[0]
        lower = _bound(self.label, self.lower, m)
        upper = _bound(self.label, self.upper, m)
        if not (lower <= upper).all():
            raise InvalidInput(
                f"{self.label}: bounds {lower} to {upper} are swapped; give lower <= upper"
            )
        return Residual(value=value, lower=lower, upper=upper)

    def n_parameters(self, robot: Robot) -> int:
        if self.parameters is None:
            return 0
        return len(self.reference(0.0))

    def reference(self, t: float) -> np.ndarray:
        if self.parameters is None:
            return np.zeros(0)
        return evaluate_vector(self.label, self.parameters, t)[0].ravel()


@checked
def residual_term(
    name: str,
    rows: OwnRows,
    *,
    lower: Bounds = 0.0,
    upper: Bounds = 0.0,
    at: At = At.END,
    weight: float = 1.0,
    phase: str | None = None,
    goal: bool = True,
    inputs: bool = False,
    parameters: VectorGoal | None = None,
) -> Term:
    """Make a term of a function ``rows(stage)`` that gives expressions (m,) of a `StageSymbols`, as
    `casadi.SX`.

    In a level the distance of the rows to ``[lower, upper]`` is minimised, as a constraint the
    range is kept; bounds are one number or (m,) [unit of the row]. at, weight [1/unit of the
    row^2], phase: as `Term` has them. goal: to be reached, so that a plan which leaves it has
    missed it; else a cost. inputs: rows read acceleration, thrust or torque. parameters (n,) [any],
    or a function ``t -> (value, rate)`` of the time [s] of the node: given to ``rows(stage,
    parameters)``, and replaceable in a planner that is kept. Raises `InvalidInput`, as the term does
    when a planner is built, for rows that are no column of SX, bounds that do not fit them, and
    rows that read inputs without `inputs`.
    """
    return _FunctionTerm(
        label=name,
        rows=rows,
        lower=lower,
        upper=upper,
        at=at,
        weight=weight,
        phase=phase,
        is_goal=goal,
        state_only=not inputs,
        parameters=parameters,
    )


def _bound(name: str, bound: Bounds, m: int) -> Array:
    """Return a bound (m,) [unit of the row] of m rows."""
    if np.shape(bound) not in ((), (m,)):
        raise InvalidInput(
            f"{name}: a bound has shape {np.shape(bound)}; give one number, or {m} of them"
        )
    return np.array(np.broadcast_to(np.asarray(bound, dtype=float), (m,)))


def _reads_inputs(value: ca.SX, stage: StageSymbols) -> bool:
    """Check whether any symbol of acceleration or force is in the rows."""
    inputs = ca.vertcat(stage.acceleration, stage.thrust_share, stage.torque_share)
    state = ca.vertcat(stage.tick.q, stage.tick.velocity)
    input_symbols = {symbol.__hash__() for symbol in ca.symvar(inputs)}
    state_symbols = {symbol.__hash__() for symbol in ca.symvar(state)}
    row_symbols = {symbol.__hash__() for symbol in ca.symvar(value)}
    return not row_symbols.isdisjoint(input_symbols - state_symbols)
