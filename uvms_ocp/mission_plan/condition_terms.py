"""Conditions of transitions as terms: what has to be reached to leave a phase, and what must not happen meanwhile."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.mission.conditions import Below, Condition
from uvms_ocp.mission_plan.margins import Margins, inside
from uvms_ocp.mission_plan.rows_within import RowsWithin
from uvms_ocp.ocp.terms import At, TaskTerm, Term
from uvms_ocp.tasks.altitude import LandingAltitude, MinimumAltitude
from uvms_ocp.tasks.attitude import AngleTask
from uvms_ocp.tasks.joints import JointTracking, Manipulability
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


def condition_term(
    tasks: Sequence[Task], phase: str, condition: Condition, margins: Margins, *, met: bool, at: At, stretch: str
) -> Term:
    """Rows that make a condition of a phase hold, or where it is not to be `met`, fail.

    tasks: with the goals that they have in the phase. Raises `InvalidInput` where no residual states the quantity.
    """
    name, _, quantity = condition.quantity.rpartition(".")
    task = next(task for task in tasks if task.name == name)
    below = isinstance(condition, Below) is met
    place = {"at": at, "phase": stretch}
    if isinstance(task, AngleTask) and quantity in _ANGLES and below:
        return TaskTerm(task=replace(task, aim=inside(condition.limit, margins.angle)), **place)
    if isinstance(task, (LandingAltitude, MinimumAltitude)) and quantity == "altitude":
        return _altitude(task, condition.limit, margins.altitude, below, place)
    if isinstance(task, Manipulability) and quantity == "manipulability" and not below:
        return RowsWithin(task=task, rows=(0,), lower=1.1 * condition.limit, **place)
    rows = _rows_of(task, quantity)
    if rows and below:
        margin = margins.angle if quantity == "orientation_error" else margins.position
        # A box inside the ball that the condition asks for.
        most = inside(condition.limit, margin) / np.sqrt(len(rows))
        return RowsWithin(task=task, rows=rows, lower=-most, upper=most, **place)
    asked = "<" if below else ">"
    raise InvalidInput(
        f"phase {phase!r} waits for {condition.quantity} {asked} {condition.limit:g}, which no residual states; "
        f"fly this mission without a plan, or wait for a quantity of a pose, an angle or an altitude"
    )


def _altitude(task: Task, limit: float, margin: float, below: bool, place: dict[str, object]) -> Term:
    level = inside(limit, margin) if below else limit + margin
    if isinstance(task, LandingAltitude):
        # Its residual is the altitude of rest less the altitude.
        gap = task.rest_altitude - level
        return RowsWithin(task=task, rows=(0,), **({"lower": gap} if below else {"upper": gap}), **place)  # type: ignore[arg-type]
    return RowsWithin(task=task, rows=(0,), **({"upper": level} if below else {"lower": level}), **place)  # type: ignore[arg-type]


def _rows_of(task: Task, quantity: str) -> tuple[int, ...]:
    if isinstance(task, JointTracking) and quantity == "posture_error":
        return tuple(range(len(task.joints)))
    found = (rows for (kind, name), rows in _ROWS.items() if isinstance(task, kind) and name == quantity)
    return next(found, ())
