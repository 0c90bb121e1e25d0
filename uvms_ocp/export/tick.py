"""One tick of the whole controller as one kernel, with its inputs and outputs: the same structures for C and Python."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np

from uvms_ocp.checks import unchecked_constructor
from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector, view
from uvms_ocp.control.force.tick import ForceMemory, force_step
from uvms_ocp.control.velocity.tick import VelocityController, is_blind, is_stopped, prepare_tick, solve_and_finish
from uvms_ocp.control.velocity.tick_memory import TickMemory
from uvms_ocp.estimation.degraded_modes import CHANNELS, ENCODERS
from uvms_ocp.mission.progress import is_over
from uvms_ocp.robot.signals import Command, Measurement, Trust

# What the controller in C is given at every tick, and what it tells: the same structures for C and Python.

_command = unchecked_constructor(Command)
_PLACE = {name: place for place, name in enumerate(CHANNELS)}


class ControllerInputs(Layout):
    """What was measured, as `Measurement` has it. Numbers that are none are a sensor that fails."""

    t: float
    """[s] time of the tick; they follow each other by the control period."""
    q: Annotated[Vector, Sized("n_q")]
    """(n_q,) [m, rad] configuration: position of B in W, its quaternion xyzw, joints."""
    v: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] velocity: linear and angular of B in B, joints."""
    altimeter_range: float
    """[m] along the beam; NAN without an echo."""
    age: float
    """[s] of the oldest reading that the measurement needs; INFINITY before the first."""
    joint_age: float
    """[s] of the joint positions alone."""
    trust: Annotated[list[int], Sized(len(CHANNELS))]
    """How far each channel can be trusted: 0 good, 1 suspect, 2 lost."""
    since: Annotated[Vector, Sized(len(CHANNELS))]
    """[s] since when."""


class ControllerOutputs(Layout):
    """What the robot is to do, and what the mission has come to."""

    v: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] reference velocity."""
    thrust: Annotated[Vector, Sized("n_thrusters")]
    """(n_thrusters,) [N] of each thruster."""
    torque: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [N m or N] of each joint."""
    hold: bool
    """The measured velocity of the vehicle is not to be trusted."""
    stop: bool
    """Cut the thrust."""
    brakes: bool
    """Lock the joints."""
    finished: bool
    """The mission is over."""
    phase: int
    """Where it is: a place in CONTROLLER_PHASES."""
    freshness: int
    """0 the measurement is fresh, 1 too old: the robot holds, 2 lost: it stops."""
    status: int
    """Of the hierarchy: a place in CONTROLLER_STATUSES."""
    viable_share: float
    """Of the hierarchy's velocity that a stop allows."""
    quantities: Annotated[Vector, Sized("n_quantities")]
    """[m, rad, ...] those of CONTROLLER_QUANTITIES; NAN where nothing tells."""


def write_measurement(inputs: Any, measurement: Measurement, t: float) -> None:
    """A measurement at time t [s] into `ControllerInputs`."""
    inputs.t, inputs.altimeter_range = t, measurement.altimeter_range
    inputs.age, inputs.joint_age = measurement.age, measurement.joint_age
    view(inputs.q)[:], view(inputs.v)[:] = measurement.q, measurement.v
    for place in range(len(CHANNELS)):
        inputs.trust[place], inputs.since[place] = Trust.GOOD, 0.0
    for item in measurement.health:
        place = _PLACE[item.channel]
        inputs.trust[place], inputs.since[place] = item.trust, item.since


def command_in(outputs: Any, *, forces: bool) -> Command:
    """The command in `ControllerOutputs`, without thrust and torque unless there are forces."""
    v, thrust, torque = (np.array(getattr(outputs, name)) for name in ("v", "thrust", "torque"))
    return _command(
        v=v,
        thrust=thrust if forces else None,
        torque=torque if forces else None,
        hold=bool(outputs.hold),
        stop=bool(outputs.stop),
        brakes=bool(outputs.brakes),
        finished=bool(outputs.finished),
    )


# One tick of the whole controller as one kernel, on one memory.

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
    _read_inputs(m, given)
    prepare_tick(m)
    told.phase = m.mission.phase
    told.status = solve_and_finish(c)
    _write_outputs(m, told)


def control_force(c: ForceController, given: ControllerInputs, told: ControllerOutputs) -> None:
    """One tick down to thrust and torque. A motion that needs forces that are no numbers cuts the thrust."""
    m, f = c.velocity.tick, c.force
    control_velocity(c.velocity, given, told)
    _write_force_inputs(f, m, told)
    possible = force_step(f)
    for i in range(f.sharing.count):
        told.thrust[i] = f.told.command[i] if possible else 0.0
    for i in range(len(f.told.torque)):
        told.torque[i] = f.told.torque[i] if possible else 0.0
    told.stop = told.stop or not possible
    told.brakes = f.locks
    _feed_back_actuation(m, f)


def _read_inputs(m: TickMemory, given: ControllerInputs) -> None:
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


def _write_outputs(m: TickMemory, told: ControllerOutputs) -> None:
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


def _write_force_inputs(f: ForceMemory, m: TickMemory, told: ControllerOutputs) -> None:
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
    f.encoders_trusted = less.level[_ENCODERS] == Trust.GOOD and less.level[_RATES] == Trust.GOOD


def _feed_back_actuation(m: TickMemory, f: ForceMemory) -> None:
    """In the next tick: what the layer of forces met."""
    m.distress.short = f.sharing.saturated
    m.distress.push = f.told.push[0]
    if f.look.changed:
        m.distress.fault = f.gives_up
        for j in range(f.look.joints.count):
            m.jammed[f.look.n_vehicle + j] = f.look.joints.jammed[j]
