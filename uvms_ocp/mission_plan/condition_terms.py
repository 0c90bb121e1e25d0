"""Conditions of transitions as terms: what has to be reached to leave a phase, and what must not happen meanwhile."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.mission.conditions import Below, Condition
from uvms_ocp.mission_plan.margins import Margins, inside
from uvms_ocp.mission_plan.mission_terms import RowsWithin
from uvms_ocp.ocp.terms import At, TaskTerm, Term
from uvms_ocp.tasks.altitude import LandingAltitude, MinimumAltitude
from uvms_ocp.tasks.attitude import AngleTask
from uvms_ocp.tasks.joints import JointTracking
from uvms_ocp.tasks.pose import PoseTask, ToolPosition
from uvms_ocp.tasks.task import Task

_ROWS: dict[tuple[type[Task], str], tuple[int, ...]] = {
    (PoseTask, "position_error"): (0, 1, 2),
    (PoseTask, "orientation_error"): (3, 4, 5),
    (PoseTask, "horizontal_error"): (0, 1),
    (ToolPosition, "position_error"): (0, 1, 2),
}
"""Of residuals, whose norm is the quantity."""
_ANGLES = ("tilt", "misalignment", "angle")


@dataclass(frozen=True, kw_only=True, slots=True)
class Place:
    """Where a condition counts."""

    phase: str
    """Of the mission, for errors."""
    stretch: str
    """Of the horizon."""
    at: At

    def rows(self, task: Task, rows: tuple[int, ...], lower: float = -np.inf, upper: float = np.inf) -> RowsWithin:
        """Of the residual of a task, at least `lower` and at most `upper` [unit of the rows]."""
        return RowsWithin(task=task, rows=rows, lower=lower, upper=upper, at=self.at, phase=self.stretch)


def condition_term(tasks: Sequence[Task], condition: Condition, place: Place, margins: Margins, *, met: bool) -> Term:
    """Rows that make a condition hold, or where it is not to be `met`, fail.

    tasks: with the goals that they have in the phase. Raises `InvalidInput` where no residual states the quantity.
    """
    name, _, quantity = condition.quantity.rpartition(".")
    task = next(task for task in tasks if task.name == name)
    limit, below = condition.limit, isinstance(condition, Below) is met
    if isinstance(task, AngleTask) and quantity in _ANGLES and below:
        return TaskTerm(task=replace(task, aim=inside(limit, margins.angle)), at=place.at, phase=place.stretch)
    if isinstance(task, (LandingAltitude, MinimumAltitude)) and quantity == "altitude":
        lower, upper = _heights(task, limit, margins.altitude, below)
        return place.rows(task, (0,), lower, upper)
    rows = _rows_of(task, quantity)
    if not (rows and below):
        raise _refused(condition, place, below)
    margin = margins.angle if quantity == "orientation_error" else margins.position
    # A box inside the ball that the condition asks for.
    most = inside(limit, margin) / np.sqrt(len(rows))
    return place.rows(task, rows, -most, most)


def _refused(condition: Condition, place: Place, below: bool) -> InvalidInput:
    return InvalidInput(
        f"phase {place.phase!r} looks at {condition.quantity} {'<' if below else '>'} {condition.limit:g}, which no residual "
        f"states; fly this mission without a plan, or look at the error of a pose, an angle or an altitude"
    )


def _heights(task: LandingAltitude | MinimumAltitude, limit: float, margin: float, below: bool) -> tuple[float, float]:
    """Range of the residual [m] for an altitude below the limit [m], or above."""
    level = inside(limit, margin) if below else limit + margin
    if isinstance(task, LandingAltitude):
        # Its residual is the altitude of rest less the altitude.
        gap = task.rest_altitude - level
        return (gap, np.inf) if below else (-np.inf, gap)
    return (-np.inf, level) if below else (level, np.inf)


def _rows_of(task: Task, quantity: str) -> tuple[int, ...]:
    if isinstance(task, JointTracking) and quantity == "posture_error":
        return tuple(range(len(task.joints)))
    found = (rows for (kind, name), rows in _ROWS.items() if isinstance(task, kind) and name == quantity)
    return next(found, ())
