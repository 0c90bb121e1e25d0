"""One tick of the whole controller as one kernel, with its inputs and outputs: the same structures
for C and Python.
"""

from __future__ import annotations

from typing import Annotated, Any

from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector, view
from uvms_ocp.control.force.tick import ForceMemory, ask_forces, force_step, hear_forces
from uvms_ocp.control.velocity.tick import (
    VelocityController,
    is_blind,
    is_stopped,
    prepare_tick,
    solve_and_finish,
)
from uvms_ocp.control.velocity.tick_memory import TickMemory
from uvms_ocp.estimation.degraded_modes import write_trust
from uvms_ocp.mission.progress import is_over
from uvms_ocp.robot.channels import CHANNELS
from uvms_ocp.robot.signals import Command, StateEstimate, unchecked_command


class ControllerInputs(Layout):
    """State estimate of a tick, as in `StateEstimate`. Numbers that are not finite are a sensor
    that fails.
    """

    t: float
    """[s] time of the tick; they follow each other by the control period."""
    q: Annotated[Vector, Sized("n_q")]
    """(n_q,) [m, rad] configuration: position of B in W, its quaternion xyzw, joints."""
    v: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] velocity: linear and angular of B in B, joints."""
    altimeter_range: float
    """[m] along the beam; NAN without an echo."""
    age: float
    """[s] age of the oldest reading that the estimate needs; INFINITY before the first."""
    joint_age: float
    """[s] age of the joint positions alone."""
    trust: Annotated[list[int], Sized(len(CHANNELS))]
    """Trust in each channel: 0 good, 1 suspect, 2 lost."""
    since: Annotated[Vector, Sized(len(CHANNELS))]
    """[s] since when."""


class ControllerOutputs(Layout):
    """Command of a tick, and where the mission is."""

    v: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] reference velocity."""
    thrust: Annotated[Vector, Sized("n_thrusters")]
    """(n_thrusters,) [N] thrust of each thruster."""
    torque: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [N m or N] torque of each joint."""
    hold: bool
    """The measured velocity of the vehicle is not to be trusted."""
    stop: bool
    """Cut the thrust."""
    brakes: bool
    """Lock the joints."""
    finished: bool
    """The mission is over."""
    phase: int
    """Index of the phase in CONTROLLER_PHASES."""
    freshness: int
    """0 the measurement is fresh, 1 too old: the robot holds, 2 lost: it stops."""
    status: int
    """Status of the hierarchy: a place in CONTROLLER_STATUSES."""
    viable_share: float
    """Share of the hierarchy's velocity that a stop allows."""
    quantities: Annotated[Vector, Sized("n_quantities")]
    """[m, rad, ...] values of CONTROLLER_QUANTITIES; NAN where unknown."""


def write_measurement(inputs: Any, estimate: StateEstimate, t: float) -> None:
    """Write a measurement at time t [s] into `ControllerInputs`."""
    inputs.t = t
    inputs.altimeter_range = estimate.altimeter_range
    inputs.age = estimate.age
    inputs.joint_age = estimate.joint_age
    view(inputs.q)[:] = estimate.q
    view(inputs.v)[:] = estimate.v
    write_trust(inputs.trust, inputs.since, estimate.health)


def command_in(outputs: Any, arrays: Any, *, forces: bool) -> Command:
    """Read the command in `ControllerOutputs`, without thrust and torque unless there are forces.

    arrays: `arrays_of` the outputs, of the sizes that the robot has; in C an array of none has one
    entry.
    """
    return unchecked_command(
        v=arrays.v.copy(),
        thrust=arrays.thrust.copy() if forces else None,
        torque=arrays.torque.copy() if forces else None,
        hold=bool(outputs.hold),
        stop=bool(outputs.stop),
        brakes=bool(outputs.brakes),
        finished=bool(outputs.finished),
    )


class ForceController(Layout):
    """Memory of a controller of thrust and torque."""

    velocity: VelocityController
    """The layer of velocities."""
    force: ForceMemory
    """The layer of forces."""


def control_velocity(
    controller: VelocityController, inputs: ControllerInputs, outputs: ControllerOutputs
) -> None:
    """Run one tick of velocities alone."""
    tick = controller.tick
    _read_inputs(tick, inputs)
    prepare_tick(tick)
    outputs.phase = tick.mission.phase
    outputs.status = solve_and_finish(controller)
    _write_outputs(tick, outputs)


def control_force(
    controller: ForceController, inputs: ControllerInputs, outputs: ControllerOutputs
) -> None:
    """Run one tick down to thrust and torque; a force that is not finite cuts the thrust.

    The order is that of `uvms_ocp.sim.tick`: what the force layer met in the
    tick before is told between `prepare_tick` and the hierarchy, or what `prepare_tick` smooths of
    it would be a tick ahead.
    """
    tick = controller.velocity.tick
    force = controller.force
    _read_inputs(tick, inputs)
    prepare_tick(tick)
    hear_forces(tick, force)
    outputs.phase = tick.mission.phase
    outputs.status = solve_and_finish(controller.velocity)
    _write_outputs(tick, outputs)
    ask_forces(tick, force)
    possible = force_step(force)
    for i in range(force.allocation.count):
        outputs.thrust[i] = force.outputs.command[i] if possible else 0.0
    for i in range(len(force.outputs.torque)):
        outputs.torque[i] = force.outputs.torque[i] if possible else 0.0
    outputs.stop = outputs.stop or not possible
    outputs.brakes = force.locks


def _read_inputs(tick: TickMemory, inputs: ControllerInputs) -> None:
    tick.t = inputs.t
    tick.q[:] = inputs.q
    tick.v[:] = inputs.v
    tick.altimeter_range = inputs.altimeter_range
    tick.age = inputs.age
    tick.joint_age = inputs.joint_age
    tick.restriction.level[:] = inputs.trust
    tick.restriction.since[:] = inputs.since


def _write_outputs(tick: TickMemory, outputs: ControllerOutputs) -> None:
    outputs.hold = is_blind(tick)
    outputs.stop = is_stopped(tick)
    outputs.brakes = tick.restriction.joints_held
    outputs.finished = is_over(tick.mission)
    outputs.freshness = tick.freshness
    outputs.viable_share = tick.share
    outputs.v[:] = tick.command
    outputs.quantities[:] = tick.reported
