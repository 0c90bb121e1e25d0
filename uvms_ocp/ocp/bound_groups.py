"""Group the bounds of the variables and the rows of the constraints of a problem that are loosened
together, and name them.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.transcription.layout import FIXED
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.robot.thrusters import AXES

# of the strongest axis from which others are named, and how many
_AXIS_SHARE = 0.2
_MOST_AXES = 3


class RelaxationUnit(Enum):
    """Measure in which a group gives way, and the words for it."""

    SHARE = "{name} would have to be {amount:.0%} higher"
    POSITION = "{name} would have to be {amount:.3g} rad (m) wider"
    ROW = "{name} would have to give way by {amount:.3g}"


@dataclass(frozen=True, kw_only=True, slots=True)
class BoundGroup:
    """Bounds or rows of one kind."""

    name: str
    measure: RelaxationUnit

    def named(self, axes: tuple[str, ...]) -> str:
        """Name the group, with the axes that matter."""
        if axes:
            return f"{self.name} ({', '.join(axes)})"
        return self.name

    def change(self, amount: float, axes: tuple[str, ...] = ()) -> str:
        """Describe a change by an amount [-, or unit of the row] in its measure."""
        return self.measure.value.format(name=self.named(axes), amount=amount)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class GroupIndex:
    """Groups, and to which of them variables or rows belong."""

    groups: tuple[BoundGroup, ...]
    number: np.ndarray
    """(n,) of the group; -1 for what nobody can loosen."""
    scale: np.ndarray
    """(n,) [unit of the variable or row] that an amount of 1 in the measure of its group is."""
    axes: tuple[str, ...]
    """(n,) of what; empty where the group says it."""

    def strongest(self, group: int, strengths: np.ndarray) -> tuple[str, ...]:
        """Axes of a group on which most lies, for strengths (n,) [any] of all variables or rows."""
        total: dict[str, float] = {}
        for i in np.flatnonzero((self.number == group) & (strengths > 0)).tolist():
            total[self.axes[i]] = total.get(self.axes[i], 0.0) + float(strengths[i])
        most = max(total.values(), default=0.0)
        ranked = sorted(total, key=lambda axis: -total[axis])
        return tuple(axis for axis in ranked if axis and total[axis] >= _AXIS_SHARE * most)[
            :_MOST_AXES
        ]


def variable_groups(transcription: Transcription) -> GroupIndex:
    """Group the bounds of the variables (n_x,)."""
    labels, scales, axes = _labels(transcription)
    layout = transcription.variables
    groups = tuple(dict.fromkeys(label for label in labels if label))
    place = {group: i for i, group in enumerate(groups)}
    numbers = np.array([place[label] if label else -1 for label in labels])
    nodes, entries = np.nonzero((layout.all_columns >= 0) & (numbers >= 0))
    columns = layout.all_columns[nodes, entries]
    number = np.full(layout.n_x, -1)
    scale = np.ones(layout.n_x)
    names = np.full(layout.n_x, "", dtype=object)
    number[columns] = numbers[entries]
    scale[columns] = np.array(scales)[entries]
    names[columns] = np.array(axes, dtype=object)[entries]
    return GroupIndex(groups=groups, number=number, scale=scale, axes=tuple(names.tolist()))


def _labels(transcription: Transcription) -> tuple[list[BoundGroup | None], list[float], list[str]]:
    """Return the group, unit and axis of every entry of z."""
    model = transcription.model
    robot = model.robot
    layout = model.layout
    limits = model.robot.limits
    axes = [
        *AXES[: robot.n_vehicle],
        *(joint.name for joint in robot.joints for _ in range(joint.n_v)),
    ]
    labels: list[BoundGroup | None] = [None] * layout.n_z
    scales = [1.0] * layout.n_z
    names = [""] * layout.n_z

    def set_part(part: slice, kind: str, units: np.ndarray, of: list[str]) -> None:
        group = BoundGroup(name=f"the {kind} limits", measure=RelaxationUnit.SHARE)
        for i, unit, axis in zip(range(part.start, part.stop), units, of, strict=True):
            labels[i] = group
            scales[i] = float(unit) if np.isfinite(unit) else 1.0
            names[i] = axis

    for joint in robot.joints:
        for i in range(joint.q.start, joint.q.stop):
            labels[i] = BoundGroup(name="the joint limits", measure=RelaxationUnit.POSITION)
            names[i] = joint.name
    set_part(layout.v, "velocity", limits.velocity, axes)
    set_part(layout.a, "acceleration", limits.acceleration, axes)
    thrusters = [item.name for item in robot.description.thrusters][: layout.n_thrust]
    set_part(
        layout.thrust, "thrust", np.ones(layout.n_thrust), thrusters or axes[: layout.n_thrust]
    )
    set_part(
        layout.torque,
        "torque",
        np.ones(layout.n_torque),
        axes[robot.n_vehicle :][: layout.n_torque],
    )
    return labels, scales, names


def row_groups(transcription: Transcription, problem: OcpProblem) -> GroupIndex:
    """Group the constraints (n_constraints,) in the numbering of the program."""
    names = tuple(
        transcription.row_layout.names[row] for row in transcription.row_layout.constraints.tolist()
    )
    roots = {term.name: float(np.sqrt(term.weight)) for term in reversed(problem.constraints)}
    found = {
        name: i for i, name in enumerate(name for name in dict.fromkeys(names) if name not in FIXED)
    }
    return GroupIndex(
        groups=tuple(
            BoundGroup(name=f"constraint {name!r}", measure=RelaxationUnit.ROW) for name in found
        ),
        number=np.array([found.get(name, -1) for name in names], dtype=int),
        scale=np.array([roots.get(name, 1.0) for name in names]),
        axes=("",) * len(names),
    )


def together(rows: GroupIndex, variables: GroupIndex) -> GroupIndex:
    """The groups of rows, then those of variables, numbered as one."""
    return GroupIndex(
        groups=(*rows.groups, *variables.groups),
        number=np.concatenate(
            [rows.number, np.where(variables.number < 0, -1, variables.number + len(rows.groups))]
        ),
        scale=np.concatenate([rows.scale, variables.scale]),
        axes=(*rows.axes, *variables.axes),
    )
