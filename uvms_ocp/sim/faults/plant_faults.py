"""Faults of the machine itself: which joints cannot move, what the tool carries, and whether a robot can have them at all."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.assembly.trim import with_trim
from uvms_ocp.model.files.description import TrimBody
from uvms_ocp.model.robot import Robot
from uvms_ocp.sim.faults.fault import Fault

_TOOL = "tool"
_NEED_WATER = {
    "thruster": "has no thrusters",
    "current": "feels no current",
    "payload": "has no mass",
}
"""What the kinematic plant lacks, by the family of what a fault strikes."""


def active_of(faults: Sequence[Fault], t: float) -> tuple[Fault, ...]:
    """Those that are there at time t [s]."""
    return tuple(fault for fault in faults if fault.active(t))


def jammed_axes(robot: Robot, faults: Sequence[Fault]) -> tuple[int, ...]:
    """Entries of v [-] of the joints that cannot move."""
    joints = [robot.joints[fault.strikes.number - 1] for fault in faults if fault.strikes.family == "joint"]
    return tuple(sorted({axis for joint in joints for axis in range(joint.v.start, joint.v.stop)}))


def payloads(faults: Sequence[Fault]) -> tuple[Fault, ...]:
    """Those that put something into the tool."""
    return tuple(fault for fault in faults if fault.strikes.family == "payload")


def loaded(robot: Robot, carried: Sequence[Fault]) -> Robot:
    """The robot with these payloads: point masses at the origin of the frame ``tool``."""
    bodies = [
        TrimBody(
            name=f"payload {k + 1}",
            link=_TOOL,
            position=(0.0, 0.0, 0.0),
            mass=fault.values[0],
            volume=fault.values[1] if len(fault.values) > 1 else 0.0,
        )
        for k, fault in enumerate(carried)
    ]
    return with_trim(robot, bodies)


def joined_velocity(before: np.ndarray, after: np.ndarray, v: np.ndarray, locked: tuple[int, ...] = ()) -> np.ndarray:
    """Velocity (n_v,) [m/s, rad/s] once the robot has taken hold of something at rest: ``after v_next = before v``.

    The momentum of the robot is then that of robot and load. before, after: mass matrices (n_v, n_v)
    [kg, kg m, kg m2]; v (n_v,) [m/s, rad/s]. locked: entries [-] that are and stay at 0.
    """
    import scipy.linalg  # a tenth of a second, for the few that take hold of something

    free = [i for i in range(len(v)) if i not in locked]
    joined = np.zeros(len(v))
    joined[free] = scipy.linalg.solve(after[np.ix_(free, free)], (before @ v)[free], assume_a="pos")
    return joined


def require_possible(faults: Sequence[Fault], robot: Robot, *, kinematic: bool) -> None:
    """Raise `InvalidInput`, in one line, for a fault of what this robot or plant does not have. Sensors look at theirs."""
    n_thrusters = len(robot.description.thrusters)
    for fault in faults:
        family, number = fault.strikes.family, fault.strikes.number
        if kinematic and family in _NEED_WATER:
            raise InvalidInput(f"{fault}: the kinematic plant {_NEED_WATER[family]}; use the dynamic plant")
        if family == "thruster" and number > n_thrusters:
            raise InvalidInput(f"{fault}: the robot has {n_thrusters} thrusters; give one of them, from 1")
        if family == "joint" and number > len(robot.joints):
            raise InvalidInput(f"{fault}: the robot has {len(robot.joints)} joints; give one of them, from 1")
        if family == "payload" and not robot.has_frame(_TOOL):
            raise InvalidInput(f"{fault}: the robot has no frame {_TOOL!r} to carry it; leave the fault out")
