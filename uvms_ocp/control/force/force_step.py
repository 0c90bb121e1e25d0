"""A tick of the force layer as one kernel: from a velocity to thrust and torque, and what is faulty of thrusters and joints."""

from __future__ import annotations

import math

from uvms_ocp.control.actuator_health.actuator_look import ActuatorLook, look_at_actuators, pause_looks
from uvms_ocp.control.actuator_health.effect import Effect, given_by
from uvms_ocp.control.force.thrust_sharing import MOST, ThrustSharing, share_out, take_effect
from uvms_ocp.control.force.tick_columns import Allocated, Given, Known, Told, Wanted, Watch
from uvms_ocp.functions.kernels.layout import Layout
from uvms_ocp.functions.kernels.smooth import Smooth

_ENCODER_SILENCE = 0.1  # [s] after which joints are no longer fed back; a joint falls faster than a vehicle drifts


class ForceMemory(Layout):
    """All that a tick reads and remembers."""

    observe: Smooth
    """As `observe_function` and the others make them."""
    want: Smooth
    follow: Smooth
    watched: bool
    """Faulty thrusters and joints are searched for."""
    bears: float
    """[-] share of their bandwidth that the loops of the vehicle never exceed: what is known late bears less."""
    joints_bear: float
    """[-] the same of the joints."""
    joints_late: float
    """[s] by which encoders are known to be late."""
    # given; of `given` all but whether joints are to be trusted
    t: float
    """[s] time of the tick."""
    given: Given
    brakes: bool
    """Joints are to be locked."""
    joint_age: float
    """[s] of what encoders tell."""
    encoders_known: bool
    """They are not doubted."""
    # remembered
    effect: Effect
    """What thrusters make of their commands, as far as it is known."""
    known: Known
    look: ActuatorLook
    sharing: ThrustSharing
    # found
    now: Known
    """What is known before it acts."""
    wanted: Wanted
    allocated: Allocated
    told: Told
    locks: bool
    """Joints are to be locked; without joints, whether the vehicle holds."""
    gives_up: bool
    """What is left is not enough for a mission."""


def begin_force(m: ForceMemory) -> None:
    """Before the first tick: all thrusters are sound."""
    for i in range(len(m.known.share)):
        m.known.share[i] = m.bears if i < m.look.n_vehicle else m.joints_bear
    for i in range(m.sharing.count):
        m.look.effect.share[i] = 1.0
    adapt(m)


def force_step(m: ForceMemory) -> bool:
    """A tick; whether the force for it is finite and below `MOST`: if not, nothing is told, and what is known stays.

    On an axis that is not to be trusted feed-forward goes on alone: feedback from a frozen velocity would accelerate the robot
    without end.
    """
    m.given.feedback[0] = min(m.given.feedback[0], m.bears)
    m.given.joint_feedback[0] = min(m.given.joint_feedback[0], m.joints_bear)
    m.given.joints[0] = 0.0 if m.brakes or m.joint_age > _ENCODER_SILENCE + m.joints_late else 1.0
    m.locks = m.given.joints[0] == 0.0 if m.look.joints.count > 0 else m.given.hold[0] != 0.0
    m.observe(m.given, m.effect, m.known, m.now)
    m.look.changed = False
    if m.watched:
        _watch(m)
    m.want(m.given, m.now, m.wanted)
    possible = _is_possible(m) and share_out(m.sharing)
    if possible:
        _act(m)
    return possible


def adapt(m: ForceMemory) -> None:
    """To the effect that a look has found: what thrusters failed to give has been taken for water so far."""
    for i in range(m.sharing.count):
        thrust = m.now.thrust[i]
        lost = given_by(m.effect, i, thrust) - given_by(m.look.effect, i, thrust)
        for k in range(m.look.n_vehicle):
            m.now.estimate[k] += m.sharing.matrix[k][i] * lost
        m.effect.share[i] = m.look.effect.share[i]
        m.effect.constant[i] = m.look.effect.constant[i]
        m.sharing.share[i] = m.effect.share[i]
        m.sharing.constant[i] = m.effect.constant[i]
    take_effect(m.sharing)
    _leave_jammed(m)


def _leave_jammed(m: ForceMemory) -> None:
    """To the brakes: nothing is made up for on axes that do not move."""
    for j in range(m.look.joints.count):
        if m.look.joints.jammed[j]:
            m.now.estimate[m.look.n_vehicle + j] = 0.0
            m.now.integral[m.look.n_vehicle + j] = 0.0


def _watch(m: ForceMemory) -> None:
    """Look for faults of thrusters and joints, and do without what is faulty from now on."""
    if m.now.watch[0] == Watch.PAUSED:
        pause_looks(m.look)
    elif m.now.watch[0] == Watch.DUE and _show(m):
        if look_at_actuators(m.look, m.t):
            adapt(m)
        m.gives_up = m.look.judged and not m.look.authority.can_go_on


def _show(m: ForceMemory) -> bool:
    """What there is to see; whether all of it is numbers: what is not would never be forgotten."""
    finite = True
    m.look.joints_known = m.encoders_known
    for k in range(len(m.given.q)):
        m.look.q[k] = m.given.q[k]
        finite = finite and math.isfinite(m.given.q[k])
    for k in range(len(m.now.estimate)):
        m.look.residual[k] = m.now.estimate[k] + m.now.lead[k]
        m.look.disturbance[k] = m.now.estimate[k]
        m.look.way[k] = m.now.way[k]
        finite = finite and math.isfinite(m.look.residual[k]) and math.isfinite(m.look.way[k])
    for i in range(m.sharing.count):
        m.look.asked[i] = m.now.asked[i]
    return finite


def _is_possible(m: ForceMemory) -> bool:
    possible = True
    for k in range(len(m.wanted.force)):
        possible = possible and abs(m.wanted.force[k]) < MOST
    for k in range(6):
        m.sharing.wrench[k] = m.wanted.wrench[k]
    return possible


def _act(m: ForceMemory) -> None:
    for i in range(m.sharing.count):
        m.allocated.thrust[i] = m.sharing.thrust[i]
    for k in range(6):
        m.allocated.reached[k] = m.sharing.reached[k]
        m.allocated.unreachable[k] = m.sharing.unreachable[k]
    m.follow(m.given, m.effect, m.now, m.wanted, m.allocated, m.known, m.told)
