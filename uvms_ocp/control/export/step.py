"""One tick of the whole controller as one kernel, on one memory."""

from __future__ import annotations

from uvms_ocp.control.export.interface import ControllerInputs, ControllerOutputs
from uvms_ocp.control.force.force_step import ForceMemory, force_step
from uvms_ocp.control.navigation.degraded import CHANNELS, ENCODERS
from uvms_ocp.control.velocity.tick.kernels import before, is_blind, is_stopped
from uvms_ocp.control.velocity.tick.layout import TickMemory
from uvms_ocp.control.velocity.tick.solving import VelocityController, finish
from uvms_ocp.functions.kernels.layout import Layout
from uvms_ocp.mission.progress import is_over
from uvms_ocp.model.health import Trust

_ENCODERS, _RATES = CHANNELS.index(ENCODERS), CHANNELS.index("joint_velocities")


class ForceController(Layout):
    """All that a controller of thrust and torque remembers."""

    velocity: VelocityController
    """The layer of velocities."""
    force: ForceMemory
    """The layer of forces."""


def control_velocity(c: VelocityController, given: ControllerInputs, told: ControllerOutputs) -> None:
    """One tick of velocities alone."""
    m = c.tick
    _take_in(m, given)
    before(m)
    told.phase = m.mission.phase
    told.status = finish(c)
    _tell(m, told)


def control_force(c: ForceController, given: ControllerInputs, told: ControllerOutputs) -> None:
    """One tick down to thrust and torque. A motion that needs forces that are no numbers cuts the thrust."""
    m, f = c.velocity.tick, c.force
    control_velocity(c.velocity, given, told)
    _ask(f, m, told)
    possible = force_step(f)
    for i in range(f.sharing.count):
        told.thrust[i] = f.told.command[i] if possible else 0.0
    for i in range(len(f.told.torque)):
        told.torque[i] = f.told.torque[i] if possible else 0.0
    told.stop = told.stop or not possible
    told.brakes = f.locks
    _feel(m, f)


def _take_in(m: TickMemory, given: ControllerInputs) -> None:
    m.t = given.t
    for i in range(len(m.q)):
        m.q[i] = given.q[i]
    for i in range(len(m.v)):
        m.v[i] = given.v[i]
    m.altimeter_range = given.altimeter_range
    m.age = given.age
    m.joint_age = given.joint_age
    for k in range(len(m.restriction.level)):
        m.restriction.level[k] = given.trust[k]
        m.restriction.since[k] = given.since[k]


def _tell(m: TickMemory, told: ControllerOutputs) -> None:
    told.hold = is_blind(m)
    told.stop = is_stopped(m)
    told.brakes = m.restriction.joints_held
    told.finished = is_over(m.mission)
    told.freshness = m.freshness
    told.viable_share = m.share
    for i in range(len(m.command)):
        told.v[i] = m.command[i]
    for i in range(len(m.reported)):
        told.quantities[i] = m.reported[i]


def _ask(f: ForceMemory, m: TickMemory, told: ControllerOutputs) -> None:
    """Of the layer of forces: what that of velocities has found."""
    less = m.restriction
    for i in range(len(m.q)):
        f.given.q[i] = m.q[i]
    for i in range(len(m.v)):
        f.given.v[i] = m.v[i]
        f.given.reference[i] = m.command[i]
    f.given.feedback[0] = less.feedback
    f.given.joint_feedback[0] = less.joint_feedback
    f.given.hold[0] = 1.0 if told.hold else 0.0
    f.given.stop[0] = 1.0 if told.stop else 0.0
    f.brakes = told.brakes
    f.t = m.t
    f.joint_age = m.joint_age
    f.encoders_known = less.level[_ENCODERS] == Trust.GOOD and less.level[_RATES] == Trust.GOOD


def _feel(m: TickMemory, f: ForceMemory) -> None:
    """In the next tick: what the layer of forces met."""
    m.distress.short = f.sharing.saturated
    m.distress.push = f.told.push[0]
    if f.look.changed:
        m.distress.fault = f.gives_up
        for j in range(f.look.joints.count):
            m.jammed[f.look.n_vehicle + j] = f.look.joints.jammed[j]
