"""Phases of a mission: conditions on measured quantities, transitions that wait for them, events,
and the abort.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import field
from typing import Annotated, Any, ClassVar, TypeAlias

import numpy as np

from uvms_ocp.checks import checked_dataclass, checked_on_failure
from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.record.display import FieldTable
from uvms_ocp.record.meta_values import (
    ABORT as ABORT,
    DONE as DONE,
    LARGEST,
    OWN_QUANTITIES as OWN_QUANTITIES,
)
from uvms_ocp.types import Count, Finite, Magnitude, Positive, Shape

GoalFunctions: TypeAlias = tuple[tuple[Callable[[float], np.ndarray], bool], ...]
"""Goal of each task as a function of time [s], as `Task.reference` gives it, and whether that time
counts from the start of the phase; highest priority first.
"""


@checked_dataclass()
class Threshold:
    """A measured quantity on the desired side of a limit.

    Raises `InvalidInput` for a limit that is no threshold, or a release that is met later than it.
    """

    sign: ClassVar[str]
    """Sign between quantity and limit."""
    quantity: str
    """``task.quantity``, or one that no task measures: `OWN_QUANTITIES`, ``vehicle.depth`` [m] and
    ``vehicle.speed`` [m/s].
    """
    limit: float
    """[unit of the quantity] more than 0; of depth, speed and load any."""
    release: float | None = None
    """[unit of the quantity] limit while the condition holds, on the other side of `limit`;
    default: `limit`.
    """

    def __post_init__(self) -> None:
        may_be_negative = self.quantity.startswith("vehicle.")
        has_allowed_sign = self.limit > 0 or may_be_negative
        if not (has_allowed_sign and abs(self.limit) <= LARGEST):
            raise InvalidInput(
                f"threshold of {self.quantity} = {self.limit}; give a finite value > 0, at most"
                f" {LARGEST:g}"
            )
        if self.release is None:
            return
        if math.isfinite(self.release) and not is_met(self.release, self.limit, self.is_below):
            return
        allowed = "at least" if self.is_below else "at most"
        raise InvalidInput(
            f"release of {self.quantity} = {self.release}; give {allowed} the limit {self.limit:g}"
        )

    @property
    def is_below(self) -> bool:
        """The quantity has to be below the limit, and not above."""
        return self.sign == "<"

    @checked_on_failure
    def holds(self, quantities: Mapping[str, float], held: bool = False) -> bool:
        """Check that it is true of the quantities [in their units]; held: it was true before.

        Raises `NameNotFound` where they lack its own.
        """
        limit = self.limit
        if held and self.release is not None:
            limit = self.release
        return is_met(measured(self.quantity, quantities), limit, self.is_below)

    def describe(self, quantities: Mapping[str, float]) -> str:
        """Describe the condition with the value among the quantities [in their units], true or
        not.
        """
        value = measured(self.quantity, quantities)
        if math.isnan(value):
            return f"{self.quantity} is not known, asked {self.sign} {self.limit:g}"
        if self.holds(quantities):
            return f"{self.quantity} = {value:.4g} {self.sign} {self.limit:g}"
        return f"{self.quantity} = {value:.4g} not {self.sign} {self.limit:g}"


@checked_dataclass()
class Below(Threshold):
    """True once a measured quantity, named ``task.quantity``, is below `limit`, until it reaches
    `release` again.

    Without `release` there is no hysteresis: both are the same. Raises `InvalidInput` for a limit
    of a task's that is not > 0 and a release below it.
    """

    sign: ClassVar[str] = "<"


@checked_dataclass()
class Above(Threshold):
    """True once a measured quantity exceeds `limit`, and until it falls to `release`; mirror of
    `Below`.

    Raises `InvalidInput` for a limit of a task's that is not > 0 and a release above it.
    """

    sign: ClassVar[str] = ">"


Condition: TypeAlias = Below | Above


@checked_dataclass()
class Transition:
    """Leads to phase `to` (or `DONE`, or `ABORT`) once every condition has held for `hold` seconds
    without a gap.

    A transition to an earlier phase is a back-step. It fires at most `retries` times; the next time
    the mission is given up, with that as the reason. Raises `InvalidInput` where `when` is not a
    tuple or empty, and for a hold or retries below 0.
    """

    to: str
    """Name of a phase, `DONE` or `ABORT`."""
    when: tuple[Condition, ...]
    """Conditions that have to hold, all at once."""
    hold: Magnitude = 0.0
    """[s] time for which the conditions have to hold."""
    retries: Count | None = None
    """Number of times that it may fire; None: as often as it likes."""

    def __post_init__(self) -> None:
        if not self.when:
            raise InvalidInput(f"transition to {self.to!r} has no conditions; give at least one")

    def describe(self, quantities: Mapping[str, float]) -> str:
        """Describe its conditions, with the quantities [in their units]."""
        return ", ".join(condition.describe(quantities) for condition in self.when)


def is_met(value: float, limit: float, below: bool) -> bool:
    """Check that a value is on the desired side of a limit [its unit]: below it, or above. A
    kernel.
    """
    if below:
        return value < limit
    return value > limit


def measured(quantity: str, quantities: Mapping[str, float]) -> float:
    """Return one of the quantities [in its unit]. Raises `NameNotFound` where they lack it."""
    try:
        return quantities[quantity]
    except KeyError:
        raise NameNotFound("quantity", quantity, quantities) from None


@checked_dataclass(eq=False, repr=False)
class Phase(FieldTable):
    """One action: the external activation of each task, and what ends it.

    Raises `InvalidInput` where the transitions are not a tuple, and for an activation outside [0,
    1].
    """

    name: str
    """Name, unique in a mission."""
    title: str = ""
    """A few words, to print beside the name."""
    activations: Mapping[str, float]
    """External activation in [0, 1] by the name of a task; tasks that are not named are off.
    Between 0 and 1 a task has a tolerance with strict solvers (`uvms_ocp.solvers.hierarchy.level`),
    and less weight with `Icat`.
    """
    transitions: tuple[Transition, ...]
    """The first that fires is taken: several to one phase are alternatives."""
    goals: Mapping[str, Any] = field(default_factory=dict)
    """Goals by the name of a task, each of which replaces its own in this phase; one that moves
    starts with the phase.
    """

    def __post_init__(self) -> None:
        outside = {}
        for name, activation in self.activations.items():
            if not 0 <= activation <= 1:
                outside[name] = activation
        if outside:
            raise InvalidInput(
                f"phase {self.name!r}: activations {outside}; give values from 0 to 1"
            )

    @property
    def on(self) -> tuple[str, ...]:
        """Names of the tasks that are on, even a little."""
        return tuple(name for name, activation in self.activations.items() if activation > 0)

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """Conditions of all its transitions."""
        conditions: list[Condition] = []
        for transition in self.transitions:
            conditions += transition.when
        return tuple(conditions)

    def waits_for(self, task: str) -> bool:
        """Check that a condition reads a quantity of the task of that name."""
        return any(condition.quantity.startswith(f"{task}.") for condition in self.conditions)


@checked_dataclass(eq=False)
class MissionState:
    """State of a mission: its phase, and since when."""

    phase: int
    """Index among all phases of the mission."""
    since: float
    """[s] start of the phase."""
    began: Finite = 0.0
    """[s] start of the mission."""
    activations_before: Annotated[np.ndarray, Shape("n_tasks")]
    """(n_tasks,) activations when the phase began; the step leads on from them."""
    held_since: tuple[float | None, ...]
    """[s] since when each transition of the phase holds."""
    completed: bool = False
    """The mission has ended as wanted."""
    aborted: str = ""
    """Reason why the mission was given up."""
    fired: Mapping[tuple[int, int], int] = field(default_factory=dict)
    """Number of times that each transition was taken, by the indices of phase and transition."""
    abort_reason: str = ""
    """Reason why the mission is being given up, in the phase that does so."""
    goals: GoalFunctions | None = None
    """Goals that were made when the phase began, in place of those of the mission."""

    @property
    def over(self) -> bool:
        """The mission has ended, one way or the other."""
        return self.completed or bool(self.aborted)


@checked_dataclass()
class Event:
    """Why a phase ended."""

    t: float
    """[s] time at which it ended."""
    source: str
    """Name of the phase."""
    target: str
    """Name of the next phase, `DONE` or `ABORT`."""
    reason: str
    """The conditions, as measured, or why the mission is given up."""
    conditions: tuple[tuple[Condition, float], ...]
    """Each condition with the value that was measured [unit of the quantity]; none where nothing
    was waited for.
    """


@checked_dataclass(eq=False)
class Abort:
    """A phase that leads to safety, and what enters it beside the loss of sensors
    (`uvms_ocp.estimation.degraded_modes`).

    Raises `InvalidInput` for a transition of that phase to anything but `ABORT`, and where it does
    not have `ascent_task` on.
    """

    phase: Phase
    """Stands beside the phases of the mission: no transition leads there, and its own end the
    mission.
    """
    ascent_task: str = "PC"
    """Name of the task on the vehicle's pose that climbs, upright and where it is, at most as fast
    as its `VehiclePose.saturation_linear`; its goal is made as the phase begins.
    """
    altitude: Positive = 3.0
    """[m] Safe altitude: above the last floor that is known, or where none is, above where the
    phase begins. Of the place, whatever the robot.
    """
    time_limit: Positive = 60.0
    """[s] time after which the mission ends wherever the phase has led to."""
    stall_after: Positive = 60.0
    """[s] time without progress towards any condition that a phase waits for."""
    thrust_after: Positive = 20.0
    """[s] time for which the limits of the thrusters keep them from what is asked for."""
    runaway_after: Positive = 5.0
    """[s] Time in which an error that a phase waits for grows beyond its crests of late, and none
    shrinks, with thrusters at their limits for most of it. Of late: of the last 10 s and more of a
    robot of 15 kg, of larger ones longer by the root of their size.
    """
    contact: Positive = 0.3
    """Upward force that the model does not know, as a share of the thrusters' largest, that counts
    as contact.
    """
    contact_after: Positive = 2.0
    """[s] time for which contact lasts while a minimum altitude is asked for."""
    sunk: Positive | None = None
    """[m] Depth of a corner of the hull, joint or tool in the floor that the altimeter shows, which
    may slope down by 0.3 from there on; default: an eighth of the robot's size, at most 0.03 m.
    """

    def __post_init__(self) -> None:
        targets = sorted({transition.to for transition in self.phase.transitions} - {ABORT})
        if targets:
            raise InvalidInput(
                f"phase {self.phase.name!r} aborts a mission but leads to {targets}; lead to"
                f" {ABORT!r} alone"
            )
        if self.ascent_task not in self.phase.on:
            raise InvalidInput(
                f"abort: ascent_task = {self.ascent_task!r}, off in phase {self.phase.name!r};"
                " name a task that is on in it"
            )
