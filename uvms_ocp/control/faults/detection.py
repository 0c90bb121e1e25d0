"""Detect faults of thrusters and joints, and the authority that is left without them: one look
after the other, as kernels.
"""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.codegen.kernel_layout import FunctionField, Layout, Sized, Vector
from uvms_ocp.control.faults.authority import AuthorityMemory, judge_authority
from uvms_ocp.control.faults.joint_faults import JointFaultMemory, detect_joint_faults, reset_joints
from uvms_ocp.control.faults.thrusters import ThrusterFaultMemory, detect_thruster_faults
from uvms_ocp.control.faults.verdicts import ThrusterEffectiveness

_TILT = 0.1
"""[rad] Tilt in which the righting moment may balance what thrusters no longer can."""
_SETTLING_TIME = 6.0
"""[s] Time from a verdict to the judgement on what can still be reached, by the wrench that was
needed in the second half.
"""


class WrenchBalance(Layout):
    """The wrench that holds the robot still, averaged once it has settled after a fault."""

    runs: bool
    """There is anything to wait for."""
    began: float
    """[s] time at which the wait began."""
    total: Annotated[Vector, Sized(6)]
    """(6,) [N, N m] sum of the wrenches in the second half of the wait."""
    count: int
    """Number of these."""
    mean: Annotated[Vector, Sized(6)]
    """(6,) [N, N m] their mean, once it is time to judge."""


class FaultDetection(Layout):
    """Memory of fault detection: one sample of the actuators, the samples before, and the
    verdicts.
    """

    # given
    q: Annotated[Vector, Sized("n_q")]
    """(n_q,) [m, rad] measured."""
    residual: Annotated[Vector, Sized("n_v")]
    """(n_v,) [N, N m] that the observer finds beside model and commands, one lag behind."""
    disturbance: Annotated[Vector, Sized("n_v")]
    """(n_v,) [N, N m] the same, as it is made up for."""
    asked: Annotated[Vector, Sized("n_thrusters")]
    """(n_thrusters,) [N] thrust that was commanded."""
    way: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] velocity that was commanded."""
    encoders_trusted: bool
    """The encoders are to be trusted."""
    # of the robot
    joint_way: FunctionField
    """``q, q -> (n_joints,)`` [rad or m] from one to the other."""
    weight: FunctionField
    """``q -> (6,)`` [N, N m] of thrusters that would hold the robot still in still water."""
    dt: float
    """[s] of a tick."""
    n_vehicle: int
    # remembered
    thrusters: ThrusterFaultMemory
    joints: JointFaultMemory
    wrench_balance: WrenchBalance
    authority: AuthorityMemory
    effectiveness: ThrusterEffectiveness
    """Effectiveness of the thrusters, by the verdicts."""
    paused: bool
    started: bool
    before: Annotated[Vector, Sized("n_q")]
    """(n_q,) [m, rad] of the last look."""
    step: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad or m] from there."""
    gone: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad or m] that the joints went so far; some turn without end, and are no
    numbers.
    """
    asked_way: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad or m] since the last look."""
    resistance: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [N m or N]"""
    wrench: Annotated[Vector, Sized(6)]
    """(6,) [N, N m]"""
    upright: Annotated[Vector, Sized(6)]
    """(6,) [N, N m]"""
    tilted: Annotated[Vector, Sized("n_tilted")]
    """(n_q,) [m, rad] and room for the quaternion of a vehicle."""
    judged: bool
    """The authority is that of what is left; before, nobody has judged."""
    # found
    thruster: int
    """Thruster found faulty in this sample; -1 for none."""
    jam: bool
    """A joint was found jammed in this look."""
    judgement: bool
    """There is a new one."""
    changed: bool
    """Any of that, or another thruster is suspect."""


def pause_detection(m: FaultDetection) -> None:
    """Pause detection while the estimate is not trusted."""
    if not m.paused:
        m.paused = True
        m.thrusters.started = False
        reset_joints(m.joints)
        begin_wrench_balance(m.wrench_balance, math.inf)


def detect_faults(m: FaultDetection, t: float) -> bool:
    """At time t [s]; whether anything was found faulty."""
    m.paused = False
    _go_on(m)
    if not m.encoders_trusted:
        reset_joints(m.joints)
    m.jam = m.encoders_trusted and detect_joint_faults(
        m.joints, m.asked_way, m.gone, m.resistance, t
    )
    suspect = m.thrusters.suspect
    m.thruster = detect_thruster_faults(m.thrusters, m.effectiveness, m.residual, m.asked, t)
    m.judgement = _judge(m, t)
    m.judged = m.judged or m.judgement
    is_found = m.jam or m.thruster >= 0
    m.changed = is_found or m.judgement or m.thrusters.suspect != suspect
    return is_found


def _go_on(m: FaultDetection) -> None:
    """Remember the positions of the joints, and what they were asked for."""
    if m.started:
        m.joint_way(m.before, m.q, m.step)
    m.started = True
    for j in range(m.joints.count):
        m.gone[j] += m.step[j]
        m.asked_way[j] = m.way[m.n_vehicle + j] * m.dt
        m.resistance[j] = m.residual[m.n_vehicle + j]
    m.before[:] = m.q


def _judge(m: FaultDetection, t: float) -> bool:
    """Judge the authority once the robot has settled after a verdict; return whether it was judged
    now.
    """
    if m.thruster >= 0:
        begin_wrench_balance(m.wrench_balance, t)
        m.wrench_balance.runs = True
    elif m.wrench_balance.runs:
        m.weight(m.q, m.wrench)
        for k in range(6):
            m.wrench[k] -= m.disturbance[k]
        if update_wrench_balance(m.wrench_balance, m.wrench, t):
            _find_trim(m)
            judge_authority(m.authority, m.effectiveness)
            return True
    return False


def begin_wrench_balance(b: WrenchBalance, t: float) -> None:
    """Begin to wait at time t [s]; at infinity where the last samples are not to be trusted: then
    the wait begins with the next.
    """
    b.began = t
    b.count = 0
    for k in range(6):
        b.total[k] = 0.0


def update_wrench_balance(b: WrenchBalance, wrench: Vector, t: float) -> bool:
    """Add a wrench (6,) [N, N m] at time t [s]; return whether it is time to judge."""
    b.began = min(b.began, t)
    if t - b.began > 0.5 * _SETTLING_TIME:
        b.count += 1
        for k in range(6):
            b.total[k] += wrench[k]
    if t - b.began < _SETTLING_TIME or b.count == 0:
        return False
    for k in range(6):
        b.mean[k] = b.total[k] / b.count
    b.runs = False
    return True


def _find_trim(m: FaultDetection) -> None:
    """The wrench that holds the robot still, and moments of weight and buoyancy within the allowed
    tilt from level.
    """
    m.tilted[: len(m.q)] = m.q[: len(m.q)]
    _tilt(m, 0, 0.0)
    m.weight(m.tilted, m.upright)
    for axis in range(6):
        m.authority.trim[axis] = m.wrench_balance.mean[axis]
        m.authority.righting[axis] = 0.0
        if 3 <= axis <= 4:
            _tilt(m, axis - 3, _TILT)
            m.weight(m.tilted, m.wrench)
            m.authority.righting[axis] = max(m.wrench[axis] - m.upright[axis], 0.0)


def _tilt(m: FaultDetection, axis: int, angle: float) -> None:
    """The quaternion xyzw, from level."""
    for k in range(3):
        if k == axis:
            m.tilted[3 + k] = math.sin(0.5 * angle)
        else:
            m.tilted[3 + k] = 0.0
    m.tilted[6] = math.cos(0.5 * angle)
