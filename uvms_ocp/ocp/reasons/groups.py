"""What the bounds of variables and the rows of constraints stand for, in groups that are loosened together."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.transcription.row_layout import FIXED
from uvms_ocp.ocp.transcription.transcription import Transcription

_SHARE, _MOST = 0.2, 3  # of the strongest axis from which others are named, and how many
_VEHICLE = ("surge", "sway", "heave", "roll", "pitch", "yaw")


class Measure(Enum):
    """In what a group gives way, and how that is said."""

    SHARE = "{name} would have to be {amount:.0%} higher"
    POSITION = "{name} would have to be {amount:.3g} rad (m) wider"
    ROW = "{name} would have to give way by {amount:.3g}"
    LEVEL = "{name} would have to give up {amount:.3g} of its residual"


@dataclass(frozen=True, kw_only=True, slots=True)
class Group:
    """Bounds or rows of one kind."""

    name: str
    measure: Measure

    def named(self, axes: tuple[str, ...]) -> str:
        """With the axes that matter."""
        return f"{self.name} ({', '.join(axes)})" if axes else self.name

    def change(self, amount: float, axes: tuple[str, ...] = ()) -> str:
        """What would have to change, by an amount [-, or unit of the row] in its measure."""
        return self.measure.value.format(name=self.named(axes), amount=amount)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Grouped:
    """Groups, and to which of them variables or rows belong."""

    groups: tuple[Group, ...]
    number: np.ndarray
    """(n,) [-] of the group; -1 for what nobody can loosen."""
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
        return tuple(axis for axis in ranked if axis and total[axis] >= _SHARE * most)[:_MOST]


def variable_groups(transcription: Transcription) -> Grouped:
    """Of the bounds of the variables (n_x,)."""
    labels, scales, axes = _labels(transcription)
    layout, groups = transcription.variables, tuple(dict.fromkeys(label for label in labels if label))
    place = {group: i for i, group in enumerate(groups)}
    numbers = np.array([place[label] if label else -1 for label in labels])
    nodes, entries = np.nonzero((layout.all_columns >= 0) & (numbers >= 0))
    columns = layout.all_columns[nodes, entries]
    number, scale, names = np.full(layout.n_x, -1), np.ones(layout.n_x), np.full(layout.n_x, "", dtype=object)
    number[columns], scale[columns] = numbers[entries], np.array(scales)[entries]
    names[columns] = np.array(axes, dtype=object)[entries]
    return Grouped(groups=groups, number=number, scale=scale, axes=tuple(names.tolist()))


def _labels(transcription: Transcription) -> tuple[list[Group | None], list[float], list[str]]:
    """Of every entry of z: its group, unit and axis."""
    model = transcription.model
    robot, layout, limits = model.robot, model.layout, model.robot.limits
    axes = [*_VEHICLE[: robot.n_vehicle], *(joint.name for joint in robot.joints for _ in range(joint.n_v))]
    labels: list[Group | None] = [None] * layout.n_z
    scales, names = [1.0] * layout.n_z, [""] * layout.n_z

    def set_part(part: slice, kind: str, units: np.ndarray, of: list[str]) -> None:
        group = Group(name=f"the {kind} limits", measure=Measure.SHARE)
        for i, unit, axis in zip(range(part.start, part.stop), units, of, strict=True):
            labels[i], scales[i], names[i] = group, float(unit) if np.isfinite(unit) else 1.0, axis

    for joint in robot.joints:
        for i in range(joint.q.start, joint.q.stop):
            labels[i], names[i] = Group(name="the joint limits", measure=Measure.POSITION), joint.name
    set_part(layout.v, "velocity", limits.velocity, axes)
    set_part(layout.a, "acceleration", limits.acceleration, axes)
    thrusters = [item.name for item in robot.description.thrusters][: layout.n_thrust]
    set_part(layout.thrust, "thrust", np.ones(layout.n_thrust), thrusters or axes[: layout.n_thrust])
    set_part(layout.torque, "torque", np.ones(layout.n_torque), axes[robot.n_vehicle :][: layout.n_torque])
    return labels, scales, names


def row_groups(transcription: Transcription, problem: OcpProblem) -> Grouped:
    """Of the constraints (n_constraints,) in the numbering of the program."""
    names = transcription.constraint_names
    roots = {term.name: float(np.sqrt(term.weight)) for term in reversed(problem.constraints)}
    found = {name: i for i, name in enumerate(name for name in dict.fromkeys(names) if name not in FIXED)}
    number = np.array([found.get(name, -1) for name in names], dtype=int)
    return Grouped(
        groups=tuple(Group(name=f"constraint {name!r}", measure=Measure.ROW) for name in found),
        number=number,
        scale=np.array([roots.get(name, 1.0) for name in names]),
        axes=("",) * len(names),
    )
