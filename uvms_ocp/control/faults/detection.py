"""Detect faults of thrusters and joints in one sample after the other, and judge the authority that
is left without them, as kernels.
"""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.codegen.kernel_layout import FunctionField, Layout, Sized, Vector
from uvms_ocp.control.faults.authority import AuthorityMemory, judge_authority
from uvms_ocp.control.faults.joint_faults import JointFaultMemory, detect_joint_faults, reset_joints
from uvms_ocp.control.faults.thruster_faults import ThrusterFaultMemory, detect_thruster_faults
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
    """True while the robot settles after a verdict, and its authority is still to be judged."""
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
    """(n_v,) [N, N m] disturbance that the controller makes up for."""
    asked: Annotated[Vector, Sized("n_thrusters")]
    """(n_thrusters,) [N] thrust that was commanded."""
    way: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] velocity that was commanded."""
    encoders_trusted: bool
    """The encoders are to be trusted."""
    # of the robot
    joint_way: FunctionField
    """``q, q -> (n_joints,)`` [rad or m] way of each joint from the first configuration to the
    second.
    """
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
    """(n_q,) [m, rad] configuration at the last sample."""
    step: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad or m] way of the joints since the last sample."""
    gone: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad or m] way of the joints since the start: positions of joints that turn
    without end are no single numbers.
    """
    asked_way: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad or m] way of the joints that was commanded since the last sample."""
    resistance: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [N m or N] force on each joint that neither its motor nor the model explains."""
    wrench: Annotated[Vector, Sized(6)]
    """(6,) [N, N m] wrench of thrusters that holds the robot still."""
    upright: Annotated[Vector, Sized(6)]
    """(6,) [N, N m] the same wrench with the vehicle level, in still water."""
    tilted: Annotated[Vector, Sized("n_tilted")]
    """(n_q,) [m, rad] configuration with the vehicle tilted, to weigh what rights it."""
    judged: bool
    """True once the authority has been judged after a verdict."""
    # found
    thruster: int
    """Thruster found faulty in this sample; -1 for none."""
    jam: bool
    """A joint was found jammed in this sample."""
    judgement: bool
    """True where the authority was judged in this sample."""
    changed: bool
    """True where a verdict, the authority or the suspected thruster changed in this sample."""


def pause_detection(detection: FaultDetection) -> None:
    """Pause detection while the estimate is not trusted."""
    if not detection.paused:
        detection.paused = True
        detection.thrusters.started = False
        reset_joints(detection.joints)
        begin_wrench_balance(detection.wrench_balance, math.inf)


def detect_faults(detection: FaultDetection, t: float) -> bool:
    """Look for faults in the sample in memory at time t [s]; return whether anything was found
    faulty.
    """
    detection.paused = False
    _go_on(detection)
    if not detection.encoders_trusted:
        reset_joints(detection.joints)
    detection.jam = detection.encoders_trusted and detect_joint_faults(
        detection.joints, detection.asked_way, detection.gone, detection.resistance, t
    )
    suspect = detection.thrusters.suspect
    detection.thruster = detect_thruster_faults(
        detection.thrusters, detection.effectiveness, detection.residual, detection.asked, t
    )
    detection.judgement = _judge(detection, t)
    detection.judged = detection.judged or detection.judgement
    is_found = detection.jam or detection.thruster >= 0
    detection.changed = is_found or detection.judgement or detection.thrusters.suspect != suspect
    return is_found


def _go_on(detection: FaultDetection) -> None:
    """Add what the joints have gone since the last sample to `gone`; `asked_way` and `resistance`
    become those of this sample.
    """
    if detection.started:
        detection.joint_way(detection.before, detection.q, detection.step)
    detection.started = True
    for j in range(detection.joints.count):
        detection.gone[j] += detection.step[j]
        detection.asked_way[j] = detection.way[detection.n_vehicle + j] * detection.dt
        detection.resistance[j] = detection.residual[detection.n_vehicle + j]
    detection.before[:] = detection.q


def _judge(detection: FaultDetection, t: float) -> bool:
    """Judge the authority once the robot has settled after a verdict; return whether it was judged
    now.
    """
    if detection.thruster >= 0:
        begin_wrench_balance(detection.wrench_balance, t)
        detection.wrench_balance.runs = True
    elif detection.wrench_balance.runs:
        detection.weight(detection.q, detection.wrench)
        for k in range(6):
            detection.wrench[k] -= detection.disturbance[k]
        if update_wrench_balance(detection.wrench_balance, detection.wrench, t):
            _find_trim(detection)
            judge_authority(detection.authority, detection.effectiveness)
            return True
    return False


def begin_wrench_balance(balance: WrenchBalance, t: float) -> None:
    """Begin to wait at time t [s]; at infinity where the last samples are not to be trusted: then
    the wait begins with the next.
    """
    balance.began = t
    balance.count = 0
    for k in range(6):
        balance.total[k] = 0.0


def update_wrench_balance(balance: WrenchBalance, wrench: Vector, t: float) -> bool:
    """Add a wrench (6,) [N, N m] at time t [s]; return whether it is time to judge."""
    balance.began = min(balance.began, t)
    if t - balance.began > 0.5 * _SETTLING_TIME:
        balance.count += 1
        for k in range(6):
            balance.total[k] += wrench[k]
    if t - balance.began < _SETTLING_TIME or balance.count == 0:
        return False
    for k in range(6):
        balance.mean[k] = balance.total[k] / balance.count
    balance.runs = False
    return True


def _find_trim(detection: FaultDetection) -> None:
    """Find the wrench that holds the robot still, and the moments of weight and buoyancy within the
    allowed tilt from level.
    """
    detection.tilted[: len(detection.q)] = detection.q[: len(detection.q)]
    _tilt(detection, 0, 0.0)
    detection.weight(detection.tilted, detection.upright)
    for axis in range(6):
        detection.authority.trim[axis] = detection.wrench_balance.mean[axis]
        detection.authority.righting[axis] = 0.0
        if 3 <= axis <= 4:
            _tilt(detection, axis - 3, _TILT)
            detection.weight(detection.tilted, detection.wrench)
            detection.authority.righting[axis] = max(
                detection.wrench[axis] - detection.upright[axis], 0.0
            )


def _tilt(detection: FaultDetection, axis: int, angle: float) -> None:
    """Turn the vehicle from level about an axis of B by an angle [rad]."""
    for k in range(3):
        if k == axis:
            detection.tilted[3 + k] = math.sin(0.5 * angle)
        else:
            detection.tilted[3 + k] = 0.0
    detection.tilted[6] = math.cos(0.5 * angle)
