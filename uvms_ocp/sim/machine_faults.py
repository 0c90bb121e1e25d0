"""Faults of the machine itself: what thrusters still give, which joints cannot move, what the tool
carries, and whether a robot can have them at all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot import description, static_balance
from uvms_ocp.robot.robot import Robot
from uvms_ocp.sim.faults import Fault

_NEED_WATER = {
    "thruster": "has no thrusters",
    "current": "feels no current",
    "payload": "has no mass",
}
"""Part that the kinematic plant lacks, by the family of a fault's target."""


def active_of(faults: Sequence[Fault], t: float) -> tuple[Fault, ...]:
    """Return the faults that are there at time t [s]."""
    return tuple(fault for fault in faults if fault.active(t))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ThrusterCondition:
    """Condition of all thrusters of a robot: their steady thrust is ``share sound + offset``, with
    that of sound ones.
    """

    share: np.ndarray
    """(n,) 1 sound, less weak, negative reversed, 0 dead or stuck."""
    offset: np.ndarray
    """(n,) [N] thrust at which they are stuck."""
    dead: np.ndarray
    """(n,) True for those that give nothing."""


def thruster_condition(faults: Sequence[Fault], thrust: np.ndarray) -> ThrusterCondition:
    """Return the condition of thrusters under these faults; thrust (n,) [N] that they give now."""
    share = np.ones(len(thrust))
    offset = np.zeros(len(thrust))
    dead = np.zeros(len(thrust), dtype=bool)
    for fault in faults:
        if fault.location.family != "thruster":
            continue
        k = fault.location.number - 1
        effect = THRUSTER_EFFECTS[fault.kind](fault, float(thrust[k]))
        share[k] *= effect.share
        dead[k] |= effect.dead
        if effect.offset is not None:
            offset[k] = effect.offset
    return ThrusterCondition(share=share, offset=np.where(dead, 0.0, offset), dead=dead)


@dataclass(frozen=True, kw_only=True, slots=True)
class ThrusterEffect:
    """What one fault makes of a thruster."""

    share: float
    """Share of its sound thrust that is left."""
    offset: float | None = None
    """[N] thrust at which it is stuck; `None` of faults that do not hold it."""
    dead: bool = False
    """True where it gives nothing, whatever else is wrong with it."""


def _dead(fault: Fault, thrust: float) -> ThrusterEffect:
    return ThrusterEffect(share=0.0, dead=True)


def _stuck(fault: Fault, thrust: float) -> ThrusterEffect:
    if fault.values:
        return ThrusterEffect(share=0.0, offset=fault.values[0])
    return ThrusterEffect(share=0.0, offset=thrust)


def _weak(fault: Fault, thrust: float) -> ThrusterEffect:
    return ThrusterEffect(share=fault.values[0])


def _reversed(fault: Fault, thrust: float) -> ThrusterEffect:
    return ThrusterEffect(share=-1.0)


THRUSTER_EFFECTS: dict[str, Callable[[Fault, float], ThrusterEffect]] = {
    "dead": _dead,
    "stuck": _stuck,
    "weak": _weak,
    "reversed": _reversed,
}
"""Effects of faults of a thruster that gives a thrust [N] now, by kind."""


def jammed_axes(robot: Robot, faults: Sequence[Fault]) -> tuple[int, ...]:
    """Return the entries of v of the joints that cannot move."""
    axes = set[int]()
    for fault in faults:
        if fault.location.family == "joint":
            joint = robot.joints[fault.location.number - 1]
            axes.update(range(joint.v.start, joint.v.stop))
    return tuple(sorted(axes))


def payloads(faults: Sequence[Fault]) -> tuple[Fault, ...]:
    """Return the faults that put something into the tool."""
    return tuple(fault for fault in faults if fault.location.family == "payload")


def loaded(robot: Robot, carried: Sequence[Fault]) -> Robot:
    """Return the robot with these payloads: point masses at the origins of its tools' frames, of
    the first without a number.
    """
    bodies = []
    for k, fault in enumerate(carried, start=1):
        mass = fault.values[0]
        volume = fault.values[1] if len(fault.values) > 1 else 0.0
        tool = robot.tools[max(fault.location.number, 1) - 1]
        body = description.TrimBody(
            name=f"payload {k}", mass=mass, volume=volume, link=tool, position=(0.0, 0.0, 0.0)
        )
        bodies.append(body)
    return static_balance.with_trim(robot, bodies)


def joined_velocity(
    before: np.ndarray, after: np.ndarray, v: np.ndarray, locked: tuple[int, ...] = ()
) -> np.ndarray:
    """Compute the velocity (n_v,) [m/s, rad/s] once the robot has taken hold of something at rest:
    ``after v_next = before v``.

    The momentum of the robot is then that of robot and load. before, after: mass matrices (n_v,
    n_v) [kg, kg m, kg m2]; v (n_v,) [m/s, rad/s]. locked: entries that are and stay at 0.
    """
    import scipy.linalg  # a tenth of a second, for the few that take hold of something

    free = [i for i in range(len(v)) if i not in locked]
    joined = np.zeros(len(v))
    momentum = (before @ v)[free]
    joined[free] = scipy.linalg.solve(after[np.ix_(free, free)], momentum, assume_a="pos")
    return joined


def require_possible(faults: Sequence[Fault], robot: Robot, *, kinematic: bool) -> None:
    """Raise `InvalidInput`, in one line, for a fault of what this robot or plant does not have.
    Sensors look at theirs.
    """
    n_targets = {
        "thruster": len(robot.description.thrusters),
        "joint": len(robot.joints),
        "payload": len(robot.tools),
    }
    for fault in faults:
        family = fault.location.family
        number = fault.location.number
        if kinematic and family in _NEED_WATER:
            raise InvalidInput(
                f"{fault}: the kinematic plant {_NEED_WATER[family]}; use the dynamic plant"
            )
        if family == "payload" and not robot.tools:
            raise InvalidInput(
                f"{fault}: the robot has no frame 'tool' to carry it; leave the fault out"
            )
        if number > n_targets.get(family, number):
            part = "tool" if family == "payload" else family
            raise InvalidInput(
                f"{fault}: the robot has {n_targets[family]} {part}s; give one of them, from 1"
            )
