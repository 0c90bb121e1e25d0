"""Group the bounds of the variables and the rows of the constraints of a problem that are loosened
together, and name them.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.transcription.layout import EQUAL_STEPS, FORCES, MOTION, START
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.robot.thrusters import AXES

# rows that every plan keeps: laws of motion and the given start, which nobody asks for
_FIXED = (MOTION, FORCES, START, EQUAL_STEPS)
_AXIS_SHARE = 0.2  # share of what lies on the strongest axis, from which others are named too
_NAMED_AXES = 3  # at most
_NO_GROUP = -1  # of entries whose bounds are not loosened


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
    """Measure in which it gives way."""

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
    """(n,) index of the group; -1 for what nobody can loosen."""
    scale: np.ndarray
    """(n,) [unit of the variable or row] size of an amount of 1, in the measure of the group."""
    axes: tuple[str, ...]
    """(n,) axis of each variable or row; empty where the group says it."""

    def strongest(self, group: int, strengths: np.ndarray) -> tuple[str, ...]:
        """Return the axes of a group on which most lies, for strengths (n,) [any] of all variables
        or rows.
        """
        total: dict[str, float] = {}
        for i in np.flatnonzero((self.number == group) & (strengths > 0)).tolist():
            total[self.axes[i]] = total.get(self.axes[i], 0.0) + float(strengths[i])
        smallest = _AXIS_SHARE * max(total.values(), default=0.0)
        ranked = sorted(total, key=lambda axis: -total[axis])
        named = [axis for axis in ranked if axis and total[axis] >= smallest]
        return tuple(named[:_NAMED_AXES])


def variable_groups(transcription: Transcription) -> GroupIndex:
    """Group the bounds of the variables (n_x,)."""
    group_of_entry, scale_of_entry, axis_of_entry = _entry_groups(transcription)
    layout = transcription.variables
    groups = tuple(dict.fromkeys(group for group in group_of_entry if group))
    index: dict[BoundGroup | None, int] = {group: i for i, group in enumerate(groups)}
    number_of_entry = np.array([index.get(group, _NO_GROUP) for group in group_of_entry])
    nodes, entries = np.nonzero((layout.all_columns >= 0) & (number_of_entry != _NO_GROUP))
    columns = layout.all_columns[nodes, entries]
    number = np.full(layout.n_x, -1)
    scale = np.ones(layout.n_x)
    axes = np.full(layout.n_x, "", dtype=object)
    number[columns] = number_of_entry[entries]
    scale[columns] = np.array(scale_of_entry)[entries]
    axes[columns] = np.array(axis_of_entry, dtype=object)[entries]
    return GroupIndex(groups=groups, number=number, scale=scale, axes=tuple(axes.tolist()))


def _entry_groups(
    transcription: Transcription,
) -> tuple[list[BoundGroup | None], list[float], list[str]]:
    """Return the group, unit and axis of every entry of z."""
    model = transcription.model
    robot = model.robot
    layout = model.layout
    limits = robot.limits
    axis_names = [*AXES[: robot.n_vehicle]]
    for joint in robot.joints:
        axis_names += [joint.name] * joint.n_v
    groups: list[BoundGroup | None] = [None] * layout.n_z
    scales = [1.0] * layout.n_z
    axes = [""] * layout.n_z

    def set_part(part: slice, kind: str, units: np.ndarray, names: list[str]) -> None:
        group = BoundGroup(name=f"the {kind} limits", measure=RelaxationUnit.SHARE)
        for i, unit, name in zip(range(part.start, part.stop), units, names, strict=True):
            groups[i] = group
            scales[i] = float(unit) if np.isfinite(unit) else 1.0
            axes[i] = name

    for joint in robot.joints:
        for i in range(joint.q.start, joint.q.stop):
            groups[i] = BoundGroup(name="the joint limits", measure=RelaxationUnit.POSITION)
            axes[i] = joint.name
    set_part(layout.v, "velocity", limits.velocity, axis_names)
    set_part(layout.a, "acceleration", limits.acceleration, axis_names)
    n_thrust = layout.n_thrust
    thrusters = [thruster.name for thruster in robot.description.thrusters][:n_thrust]
    set_part(layout.thrust, "thrust", np.ones(n_thrust), thrusters or axis_names[:n_thrust])
    n_torque = layout.n_torque
    joint_axes = axis_names[robot.n_vehicle :]
    set_part(layout.torque, "torque", np.ones(n_torque), joint_axes[:n_torque])
    return groups, scales, axes


def row_groups(transcription: Transcription, problem: OcpProblem) -> GroupIndex:
    """Group the constraints (n_constraints,) in the numbering of the program."""
    layout = transcription.row_layout
    names = [layout.names[row] for row in layout.constraints.tolist()]
    roots = {term.name: float(np.sqrt(term.weight)) for term in reversed(problem.constraints)}
    loosenable = [name for name in dict.fromkeys(names) if name not in _FIXED]
    index = {name: i for i, name in enumerate(loosenable)}
    groups = [
        BoundGroup(name=f"constraint {name!r}", measure=RelaxationUnit.ROW) for name in loosenable
    ]
    return GroupIndex(
        groups=tuple(groups),
        number=np.array([index.get(name, -1) for name in names], dtype=int),
        scale=np.array([roots.get(name, 1.0) for name in names]),
        axes=("",) * len(names),
    )


def join_groups(rows: GroupIndex, variables: GroupIndex) -> GroupIndex:
    """Return the groups of rows, then those of variables, numbered as one."""
    is_hard = variables.number < 0
    variable_number = np.where(is_hard, -1, variables.number + len(rows.groups))
    return GroupIndex(
        groups=(*rows.groups, *variables.groups),
        number=np.concatenate([rows.number, variable_number]),
        scale=np.concatenate([rows.scale, variables.scale]),
        axes=(*rows.axes, *variables.axes),
    )
