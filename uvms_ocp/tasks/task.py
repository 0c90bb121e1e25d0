"""A task: rows ``y`` of the velocity hierarchy, written once as CasADi expressions ([Gao2022] section 3).

Every task turns the symbols of one tick into `Rows`. The rows serve both kinds of solver: the regularised
pseudo-inverse reads ``rate`` and ``activation``, the strict hierarchy ``lower`` and ``upper``
(`uvms_ocp.solvers.hierarchy.level`). `Residual` is the same task over a horizon.
"""

from __future__ import annotations

import enum
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from uvms_ocp.arguments import checked, late
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.limits import PositionLimit
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.symbolic.tree import SymbolicKinematics
from uvms_ocp.tasks.nearest_pairs import NearestPairs


class TaskClass(enum.IntEnum):
    """Classes of tasks; the smaller value has the higher priority ([Gao2022] section 'Task planning')."""

    CONSTRAINT = 0
    SAFETY = 1
    PREREQUISITE = 2
    ACTION = 3
    OPTIMIZATION = 4

    @property
    def letters(self) -> str:
        """The abbreviation used in the paper's tables."""
        return ("C", "S", "P", "AD", "O")[self]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TickSymbols:
    """The symbols that one tick knows, given to every task."""

    robot: Robot
    """Whose tick it is."""
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
        """Jacobian (m, n_v) that selects generalized velocities."""
        return ca.SX.eye(self.robot.n_v)[indices, :]


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Rows:
    """What a task asks of v: ``jacobian @ v`` at `rate`, or within ``[lower, upper]``."""

    jacobian: ca.SX
    """(m, n_v) [unit of the task / m, or / rad]"""
    rate: ca.SX
    """(m,) [unit of the task / s]"""
    lower: ca.SX
    """(m,) [unit of the task / s]"""
    upper: ca.SX
    """(m,) [unit of the task / s]"""
    activation: ca.SX
    """(m,) [-] internal bell in [0, 1]."""
    quantities: Mapping[str, ca.SX] = field(default_factory=dict)
    """Scalars for transitions, plots and reports, such as errors and distances."""

    @property
    def n_rows(self) -> int:
        return int(self.jacobian.shape[0])


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Residual:
    """What a task asks of a state: `value` within ``[lower, upper]``; an equality has lower = upper.

    Smooth in the state, so that it can be optimised over a horizon; `Rows` are its velocity-level counterpart.
    """

    value: ca.SX
    """(m,) [unit of the task]"""
    lower: np.ndarray
    """(m,) [unit of the task]"""
    upper: np.ndarray
    """(m,) [unit of the task]"""

    @property
    def n_rows(self) -> int:
        return int(self.value.shape[0])


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Task(ABC):
    """Base of all tasks. Fields of every task can be changed with `dataclasses.replace`.

    Gains, saturations and margins that are not > 0, and goals that are not finite, raise `InvalidInput`.
    """

    name: str
    """Unique in a hierarchy."""
    task_class: TaskClass
    """Which decides its priority unless an order is given."""
    reactive: ClassVar[bool] = True
    """Whether it follows what is measured."""
    equality: ClassVar[bool] = True
    """Whether its rows ask for one value, and not for a range."""
    needs_altimeter: ClassVar[bool] = False
    """Whether it reads the range of the altimeter."""

    @property
    def rest_altitude(self) -> float:
        """[m] at which a task that reads the altimeter lets nothing sink; it stands in until the first echo has come."""
        return 0.0

    @property
    def nearest_pairs(self) -> NearestPairs | None:
        """The distances that this task asks to be measured at every tick, if any: the last of its parameters."""
        return None

    @property
    def still(self) -> bool:
        """Whether `reference` is the same at all times, so that a phase asks for it once: without a goal that moves.

        Never of a class of one's own that has its own `reference`.
        """
        return self.is_told_by_goal and not callable(getattr(self, "goal", None))

    @property
    def is_told_by_goal(self) -> bool:
        """Whether `reference` depends on nothing but the goal, as that of every class but one's own that has its own does."""
        return type(self).reference.__module__.startswith("uvms_ocp.")

    @abstractmethod
    def rows(self, symbols: TickSymbols, parameters: ca.SX) -> Rows:
        """The rows of this task; `parameters` (n_parameters,) are its reference, ending with the `nearest_pairs` it has."""

    def residual(self, symbols: TickSymbols, parameters: ca.SX) -> Residual:
        """The error or quantity that this task keeps at a value or in a range, for planning over a horizon.

        Raises `InvalidInput` for a task that exists at velocity level only.
        """
        raise InvalidInput(
            f"{self.name}: {type(self).__name__} has no residual over a horizon; leave it to the velocity hierarchy"
        )

    def position_limit(self, robot: Robot) -> PositionLimit | None:
        """The limit on positions that this task stands for, if it is one beyond the joints' own."""
        return None

    def n_parameters(self, robot: Robot) -> int:
        """Length of the vector that `reference` returns."""
        return 0

    @late
    def reference(self, t: float) -> np.ndarray:
        """Goal at time t [s] as a parameter vector (n_parameters,); for `nearest_pairs`, that nothing is near."""
        return np.zeros(0)

    def with_goal(self, goal: Any) -> Task:
        """This task with another goal; raises `InvalidInput` where the task has none."""
        if "goal" not in {item.name for item in fields(self)}:
            raise InvalidInput(
                f"{self.name}: {type(self).__name__} has no goal to replace; drop it from the phase's goals"
            )
        return replace(self, goal=goal)  # type: ignore[call-arg]

    @property
    def label(self) -> str:
        """The paper's bracket, such as ``[R,E,AD]``."""
        reactive = "R" if self.reactive else "NR"
        kind = "E" if self.equality else "I"
        return f"[{reactive},{kind},{self.task_class.letters}]"


def equality_rows(jacobian: ca.SX, rate: ca.SX, quantities: Mapping[str, ca.SX] | None = None) -> Rows:
    """Rows that ask for ``jacobian @ v = rate``, always active inside."""
    return Rows(
        jacobian=jacobian,
        rate=rate,
        lower=rate,
        upper=rate,
        activation=ca.SX.ones(rate.shape),
        quantities=quantities or {},
    )


def zero_residual(value: ca.SX) -> Residual:
    """A residual that asks for ``value = 0``."""
    zeros = np.zeros(value.shape[0])
    return Residual(value=value, lower=zeros, upper=zeros)


def bounded_residual(value: ca.SX, *, lower: float = -np.inf, upper: float = np.inf) -> Residual:
    """A residual that asks for ``lower <= value <= upper`` [unit of the task], row by row."""
    m = value.shape[0]
    return Residual(value=value, lower=np.full(m, lower), upper=np.full(m, upper))


def require_positive(task: str, **values: float) -> None:
    """Raise `InvalidInput` unless every value is finite and positive."""
    for name, value in values.items():
        if not (np.isfinite(value) and value > 0):
            raise InvalidInput(f"{task}: {name} = {value}; give a finite value > 0")
