"""Tasks as rows of the velocity hierarchy, written once as CasADi expressions ([Gao2022] section
3).

The rows serve both kinds of solver: the regularised pseudo-inverse reads ``rate`` and
``activation``, the strict hierarchy ``lower`` and ``upper`` (`uvms_ocp.solvers.hierarchy.level`).
`Residual` is the same task over a horizon.
"""

from __future__ import annotations

import enum
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from uvms_ocp.checks import checked, checked_dataclass, checked_on_failure
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.limits import PositionLimit
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.symbolic_model import SymbolicKinematics
from uvms_ocp.tasks.approach_speed import approach_speed, row_acceleration
from uvms_ocp.tasks.nearest_pairs import NearestPairs

_CLASS_LETTERS = ("C", "S", "P", "AD", "O")
"""Abbreviations of task classes in the tables of [Gao2022], by their value."""
_DETERMINED_BY_GOAL = "_determined_by_goal"
"""Attribute of a `reference` that `determined_by_goal` declares."""


@checked
def determined_by_goal(reference: Callable[..., np.ndarray]) -> Callable[..., np.ndarray]:
    """Declare that a task's `reference` depends on its `goal` and on time alone.

    A controller then calls it once in a phase if the goal is at rest, and samples it beforehand if
    the goal moves until a known `end`; other references it calls at every tick.
    """
    setattr(reference, _DETERMINED_BY_GOAL, True)
    return reference


@checked_dataclass(eq=False)
class Task(ABC):
    """Base of all tasks. Fields of every task can be changed with ``dataclasses.replace``.

    Gains, saturations and margins that are not > 0, and goals that are not finite, raise
    `InvalidInput`.
    """

    name: str
    """Name, unique in a hierarchy."""
    task_class: TaskClass
    """Class, which decides the priority unless an order is given."""
    reactive: ClassVar[bool] = True
    """True for a task that follows a measurement."""
    equality: ClassVar[bool] = True
    """True where its rows ask for one value, and not for a range."""
    needs_altimeter: ClassVar[bool] = False
    """True where it reads the range of the altimeter."""
    symbolic_numbers: ClassVar[tuple[str, ...] | None] = None
    """Names of scalar fields that `rows` gets as CasADi symbols in place of numbers: tasks that
    differ in these alone share compiled rows.

    Declare it, even as ``()``, in a class whose `rows` depend on its fields alone, and on a `goal`
    only through `parameters`. Subclasses do not inherit it, as `rows` of their own may need numbers.
    `None`: rows are compiled for each task.
    """

    @property
    def rest_altitude(self) -> float:
        """[m] altitude at which a task that reads the altimeter asks for no descent; it is used until
        the first echo has come.
        """
        return 0.0

    @property
    def nearest_pairs(self) -> NearestPairs | None:
        """Pairs whose distances are to be measured at every tick, if any; the distances are the last
        of the task's parameters.
        """
        return None

    @property
    def is_constant(self) -> bool:
        """True where `reference` is the same at all times: it is determined by the goal, and the
        goal does not move.
        """
        return self.follows_goal_alone and not callable(getattr(self, "goal", None))

    @property
    def follows_goal_alone(self) -> bool:
        """True where the `reference` of this class was declared by `determined_by_goal`; an override
        has to be declared anew.
        """
        return bool(getattr(type(self).reference, _DETERMINED_BY_GOAL, False))

    @abstractmethod
    def rows(self, symbols: TickSymbols, parameters: ca.SX) -> Rows:
        """Return the rows of this task; `parameters` (n_parameters,) are its reference, ending with
        the `nearest_pairs` it has.
        """

    def residual(self, symbols: TickSymbols, parameters: ca.SX) -> Residual:
        """Return the error or quantity that this task keeps at a value or in a range, for planning
        over a horizon.

        Raises `InvalidInput` for a task that exists at velocity level only.
        """
        raise InvalidInput(
            f"{self.name}: {type(self).__name__} has no residual over a horizon; leave it to the"
            " velocity hierarchy"
        )

    def position_limit(self, robot: Robot) -> PositionLimit | None:
        """Return the limit on positions that this task keeps; `None` for a task that keeps none but
        those of the joints.
        """
        return None

    def n_parameters(self, robot: Robot) -> int:
        """Return the length of the vector that `reference` returns."""
        return 0

    @determined_by_goal
    @checked_on_failure
    def reference(self, t: float) -> np.ndarray:
        """Return the goal at time t [s] as parameters (n_parameters,); where they end with distances
        of `nearest_pairs`, these are those of pairs that are far apart.
        """
        return np.zeros(0)

    def with_goal(self, goal: Any) -> Task:
        """Return the task with another goal. Raises `InvalidInput` where the task has none."""
        if "goal" not in {item.name for item in fields(self)}:
            raise InvalidInput(
                f"{self.name}: {type(self).__name__} has no goal to replace; drop it from the"
                " phase's goals"
            )
        return replace(self, goal=goal)  # type: ignore[call-arg]

    @property
    def label(self) -> str:
        """The paper's bracket, such as ``[R,E,AD]``."""
        reactive = "R" if self.reactive else "NR"
        equality = "E" if self.equality else "I"
        return f"[{reactive},{equality},{self.task_class.letters}]"


class TaskClass(enum.IntEnum):
    """Classes of tasks; the smaller value has the higher priority ([Gao2022] section 'Task
    planning').
    """

    CONSTRAINT = 0
    SAFETY = 1
    PREREQUISITE = 2
    ACTION = 3
    OPTIMIZATION = 4

    @property
    def letters(self) -> str:
        """The abbreviation used in the paper's tables."""
        return _CLASS_LETTERS[self]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TickSymbols:
    """The symbols that one tick knows, given to every task."""

    robot: Robot
    """Robot that the tick controls."""
    kinematics: SymbolicKinematics
    """Forward kinematics at q."""
    q: ca.SX
    """(n_q,) [m, rad] configuration."""
    velocity: ca.SX
    """(n_v,) [m/s, rad/s] measured generalized velocity."""
    altimeter_range: ca.SX
    """() [m] range along -z of the altimeter frame."""
    dt: float
    """[s] control period."""

    def velocity_rows(self, indices: list[int]) -> ca.SX:
        """Return the Jacobian (m, n_v) that selects generalized velocities."""
        return ca.SX.eye(self.robot.n_v)[indices, :]

    @property
    def R_WB(self) -> ca.SX:
        """(3, 3) attitude of the vehicle."""
        return self.kinematics.joint_poses[1].R

    def approach(self, task: Any, distance: ca.SX, row: ca.SX) -> ca.SX:
        """Evaluate `approach_speed` of a task towards a limit whose distance [m or rad] changes by
        `row` (m, n_v).
        """
        deceleration = row_acceleration(row, self.robot.limits.acceleration)
        return approach_speed(
            distance,
            gain=task.gain,
            deceleration=deceleration,
            dt=self.dt,
            saturation=task.saturation,
        )


@checked_dataclass(eq=False)
class Rows:
    """Rows that a task sets on v: ``jacobian @ v`` at `rate`, or within ``[lower, upper]``."""

    jacobian: ca.SX
    """(m, n_v) [unit of the task / m, or / rad] Jacobian."""
    rate: ca.SX
    """(m,) [unit of the task / s] desired rates."""
    lower: ca.SX
    """(m,) [unit of the task / s] lower bounds."""
    upper: ca.SX
    """(m,) [unit of the task / s] upper bounds."""
    activation: ca.SX
    """(m,) internal activation in [0, 1]."""
    quantities: Mapping[str, ca.SX] = field(default_factory=dict)
    """Scalars for transitions, plots and reports, such as errors and distances."""

    @property
    def n_rows(self) -> int:
        return int(self.jacobian.shape[0])


@checked_dataclass(eq=False)
class Residual:
    """Rows that a task sets on a state: `value` within ``[lower, upper]``; an equality has lower =
    upper.

    Smooth in the state, so that it can be optimised over a horizon; `Rows` are its velocity-level
    counterpart.
    """

    value: ca.SX
    """(m,) [unit of the task] rows."""
    lower: np.ndarray
    """(m,) [unit of the task] lower bounds."""
    upper: np.ndarray
    """(m,) [unit of the task] upper bounds."""

    @property
    def n_rows(self) -> int:
        return int(self.value.shape[0])


@checked
def equality_rows(
    jacobian: ca.SX, rate: ca.SX, quantities: Mapping[str, ca.SX] | None = None
) -> Rows:
    """Return rows that ask for ``jacobian @ v = rate``, always active inside."""
    return Rows(
        jacobian=jacobian,
        rate=rate,
        lower=rate,
        upper=rate,
        activation=ca.SX.ones(rate.shape),
        quantities=quantities or {},
    )


@checked
def zero_residual(value: ca.SX) -> Residual:
    """Return a residual that asks for ``value = 0``."""
    zeros = np.zeros(value.shape[0])
    return Residual(value=value, lower=zeros, upper=zeros)


def bounded_residual(value: ca.SX, *, lower: float = -np.inf, upper: float = np.inf) -> Residual:
    """Return a residual that asks for ``lower <= value <= upper`` [unit of the task], row by row."""
    m = value.shape[0]
    return Residual(value=value, lower=np.full(m, lower), upper=np.full(m, upper))
