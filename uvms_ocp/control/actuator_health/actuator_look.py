"""A look at all thrusters and joints, and at what is left without the faulty ones, as kernels."""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.control.actuator_health.authority import AuthorityMemory, judge_authority
from uvms_ocp.control.actuator_health.balance import Balance, begin_balance, take_in_balance
from uvms_ocp.control.actuator_health.effect import Effect
from uvms_ocp.control.actuator_health.joint_watch import JointWatch, forget_joints, look_at_joints
from uvms_ocp.control.actuator_health.thruster_watch import ThrusterWatch, look_at_thrusters
from uvms_ocp.functions.kernels.layout import Layout, Sized, Vector
from uvms_ocp.functions.kernels.smooth import Smooth

_TILT = 0.1  # [rad] in which the righting moment may balance what thrusters no longer can


class ActuatorLook(Layout):
    """What one look shows of the actuators, what is remembered of those before, and what comes of them."""

    # given
    q: Annotated[Vector, Sized("n_q")]
    """(n_q,) [m, rad] measured."""
    residual: Annotated[Vector, Sized("n_v")]
    """(n_v,) [N, N m] that the observer finds beside model and commands, one lag behind."""
    disturbance: Annotated[Vector, Sized("n_v")]
    """(n_v,) [N, N m] the same, as it is made up for."""
    asked: Annotated[Vector, Sized("n_thrusters")]
    """(n_thrusters,) [N] as `Asked.thrust`."""
    way: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] as `Asked.way`."""
    joints_known: bool
    """Whether the encoders are to be trusted."""
    # of the robot
    joint_way: Smooth
    """``q, q -> (n_joints,)`` [rad or m] from one to the other."""
    weight: Smooth
    """``q -> (6,)`` [N, N m] of thrusters that would hold the robot still in still water."""
    dt: float
    """[s] of a tick."""
    n_vehicle: int
    # remembered
    thrusters: ThrusterWatch
    joints: JointWatch
    balance: Balance
    authority: AuthorityMemory
    effect: Effect
    """What thrusters make of their commands, by the verdicts."""
    paused: bool
    started: bool
    before: Annotated[Vector, Sized("n_q")]
    """(n_q,) [m, rad] of the last look."""
    step: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad or m] from there."""
    gone: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad or m] that the joints went so far; some turn without end, and are no numbers."""
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
    """That was found faulty in this look; -1 for none."""
    jam: bool
    """A joint was found jammed in this look."""
    judgement: bool
    """There is a new one."""
    changed: bool
    """Any of that, or another thruster is suspect."""


def pause_looks(m: ActuatorLook) -> None:
    """What is measured is not to be trusted."""
    if not m.paused:
        m.paused = True
        m.thrusters.started = False
        forget_joints(m.joints)
        begin_balance(m.balance, math.inf)


def look_at_actuators(m: ActuatorLook, t: float) -> bool:
    """At time t [s]; whether anything was found faulty."""
    m.paused = False
    _go_on(m)
    if not m.joints_known:
        forget_joints(m.joints)
    m.jam = m.joints_known and look_at_joints(m.joints, m.asked_way, m.gone, m.resistance, t)
    suspect = m.thrusters.suspect
    m.thruster = look_at_thrusters(m.thrusters, m.effect, m.residual, m.asked, t)
    m.judgement = _judge(m, t)
    m.judged = m.judged or m.judgement
    found = m.jam or m.thruster >= 0
    m.changed = found or m.judgement or m.thrusters.suspect != suspect
    return found


def _go_on(m: ActuatorLook) -> None:
    """Where the joints went, and what they were asked."""
    if m.started:
        m.joint_way(m.before, m.q, m.step)
    m.started = True
    for j in range(m.joints.count):
        m.gone[j] += m.step[j]
        m.asked_way[j] = m.way[m.n_vehicle + j] * m.dt
        m.resistance[j] = m.residual[m.n_vehicle + j]
    for k in range(len(m.q)):
        m.before[k] = m.q[k]


def _judge(m: ActuatorLook, t: float) -> bool:
    """What is left of the thrusters, once the robot has settled after a verdict; whether it was judged now."""
    if m.thruster >= 0:
        begin_balance(m.balance, t)
        m.balance.runs = True
    elif m.balance.runs:
        m.weight(m.q, m.wrench)
        for k in range(6):
            m.wrench[k] -= m.disturbance[k]
        if take_in_balance(m.balance, m.wrench, t):
            _find_trim(m)
            judge_authority(m.authority, m.effect)
            return True
    return False


def _find_trim(m: ActuatorLook) -> None:
    """The wrench that holds the robot still, and moments of weight and buoyancy within the allowed tilt from level."""
    for k in range(len(m.q)):
        m.tilted[k] = m.q[k]
    _tilt(m, 0, 0.0)
    m.weight(m.tilted, m.upright)
    for axis in range(6):
        m.authority.trim[axis] = m.balance.mean[axis]
        m.authority.righting[axis] = 0.0
        if 3 <= axis <= 4:
            _tilt(m, axis - 3, _TILT)
            m.weight(m.tilted, m.wrench)
            m.authority.righting[axis] = max(m.wrench[axis] - m.upright[axis], 0.0)


def _tilt(m: ActuatorLook, axis: int, angle: float) -> None:
    """The quaternion xyzw, from level."""
    for k in range(3):
        m.tilted[3 + k] = math.sin(0.5 * angle) if k == axis else 0.0
    m.tilted[6] = math.cos(0.5 * angle)
