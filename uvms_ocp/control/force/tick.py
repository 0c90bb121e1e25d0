"""One tick of the force layer in order, as one kernel: from a reference velocity to thrust and
torque.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Annotated, Any

import numpy as np

from uvms_ocp.codegen.kernel_layout import (
    FunctionField,
    Layout,
    Sized,
    Vector,
    arrays_of,
    column_view,
    structure_of,
)
from uvms_ocp.codegen.kernels import make_memory
from uvms_ocp.control.faults.detection import FaultDetection, detect_faults, pause_detection
from uvms_ocp.control.faults.monitor import detection_parts, write_detection
from uvms_ocp.control.faults.tuning import ActuatorHealthTuning
from uvms_ocp.control.faults.verdicts import ThrusterEffectiveness, effective_thrust
from uvms_ocp.control.force import allocation as thrust_allocation, tick_functions
from uvms_ocp.control.force.overspeed import (
    OverspeedMemory,
    is_carried_off,
    locks_at_overspeed,
    start_overspeed,
)
from uvms_ocp.control.velocity.tick import damps_turns, is_blind, is_stopped
from uvms_ocp.control.velocity.tick_memory import TickMemory
from uvms_ocp.errors import InvalidInput
from uvms_ocp.estimation.degraded_modes import ENCODERS, JOINT_RATES
from uvms_ocp.estimation.fallbacks import level_attitude
from uvms_ocp.robot.channels import CHANNELS
from uvms_ocp.robot.signals import SAME_TIME, Trust
from uvms_ocp.robot.thrusters import undriven_axes

_ENCODER_SILENCE = (
    0.1  # [s] after which joints are no longer fed back; a joint falls faster than a vehicle drifts
)

_WEIGHING = 2.0  # [s] after a fall in which the observer of the vehicle comes to what brakes hold
_AGAIN = (
    10.0  # [s] after a load was weighed in which an arm that falls all the same is not let go early
)
_RAISED = 0.1  # [s] before and after a lock in which a doubt begins that the fall itself raises
_EXPLAINED = 0.7  # share of what the vehicle bears that a load has to explain
_SIZEABLE = 0.02  # share of the effort of a joint by which a load is more than what is known

_POSITIONS = CHANNELS.index(ENCODERS)
_RATES = CHANNELS.index(JOINT_RATES)


class ForceMemory(Layout):
    """Memory of a tick: functions, inputs, state and outputs."""

    carry: FunctionField
    """Functions of a tick, in their order: `carry_function`, `weigh_function`, `transfer_function`,
    `observe_function`, `control_function` and `command_function` make them.
    """
    weigh: FunctionField
    transfer: FunctionField
    observe: FunctionField
    control: FunctionField
    command: FunctionField
    watched: bool
    """Faulty thrusters and joints are searched for."""
    bandwidth_share: float
    """Largest share of their bandwidth that the loops of the vehicle may use, less than 1 where
    sensors are late.
    """
    joint_bandwidth_share: float
    """Largest share of their bandwidth that the loops of the joints may use."""
    joints_late: float
    """[s] delay of the encoders that is known."""
    n_joint_q: int
    """Entries of q that are of joints."""
    joint_efforts: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [N m or N] largest efforts of the motors."""
    measures_joint_rates: bool
    """Sensors of their own tell the joints' rates."""
    # inputs of a tick; of `inputs` all but `joints`, which the tick finds
    t: float
    """[s] time of the tick."""
    inputs: tick_functions.ForceInputs
    brakes: bool
    """Joints are to be locked."""
    attitude_open: bool
    """The attitude may be off by any angle: forces are those of a level vehicle, whose turns are damped
    alone.
    """
    joint_age: float
    """[s] age of the encoder readings."""
    encoders_trusted: bool
    """The encoders are not distrusted."""
    joint_rates_lost: bool
    """The sensors of joint rates are lost."""
    # remembered
    effectiveness: ThrusterEffectiveness
    """Effectiveness of the thrusters that commands reckon with."""
    state: tick_functions.ForceState
    detection: FaultDetection
    overspeed: OverspeedMemory
    allocation: thrust_allocation.AllocationMemory
    fallen: int
    """Joint that fell until brakes locked it, whose load is not weighed yet; -1 for none."""
    fell_upwards: bool
    """True where it fell towards positive positions."""
    doubted_since: float
    """[s] time since when encoders are distrusted; infinite where they are not."""
    weighed_t: float
    """[s] time of the last load that was weighed."""
    locked: bool
    """Brakes have locked joints whose posture was known in the tick before."""
    # found
    carried: Annotated[Vector, Sized("n_v")]
    """(n_v,) [N, N m] disturbance with which locked joints go on to be held."""
    beyond: Annotated[Vector, Sized("n_v")]
    """(n_v,) [N, N m] what it would be more without its limit."""
    weighed: Annotated[Vector, Sized("n_v")]
    """(n_v,) [N, N m] disturbance with a load that the vehicle bears."""
    explained: Annotated[Vector, Sized(1)]
    """(1,) share of what the vehicle bears that it explains."""
    transferred: tick_functions.ForceState
    """State at another share of the bandwidth, in a tick that changes it."""
    observed: tick_functions.ForceState
    """State after the observer, before the commands of this tick."""
    desired: tick_functions.DesiredForce
    allocated: tick_functions.AllocatedThrust
    outputs: tick_functions.ForceOutputs
    locks: bool
    """Joints are to be locked; without joints, whether the vehicle holds."""
    possible: bool
    """The force of the tick is finite and below `LARGEST_WRENCH`."""
    gives_up: bool
    """The remaining authority is not enough for a mission."""


def begin_force(force: ForceMemory) -> None:
    """Initialise the memory: all thrusters are sound, and no impossible force was asked for."""
    force.possible = True
    for i in range(len(force.state.share)):
        force.state.share[i] = (
            force.bandwidth_share if i < force.detection.n_vehicle else force.joint_bandwidth_share
        )
    for i in range(force.allocation.count):
        force.detection.effectiveness.share[i] = 1.0
    apply_detected_effectiveness(force)
    start_overspeed(force.overspeed)
    force.fallen = -1
    force.doubted_since = math.inf
    force.weighed_t = -math.inf


def force_step(force: ForceMemory) -> bool:
    """Run one tick and return whether its force is finite and below `LARGEST_WRENCH`; if not,
    outputs stay, and state but for what `carry` changes of it.

    On an axis that is not to be trusted feed-forward goes on alone: feedback from a frozen velocity
    would accelerate the robot without end.
    """
    if force.attitude_open:
        level_attitude(force.inputs.q)
    force.inputs.feedback[0] = min(force.inputs.feedback[0], force.bandwidth_share)
    if force.measures_joint_rates and not force.joint_rates_lost:
        # Whatever is wrong with positions, the rates that are fed back are in time.
        force.inputs.joint_feedback[0] = 1.0
    force.inputs.joint_feedback[0] = min(
        force.inputs.joint_feedback[0], force.joint_bandwidth_share
    )
    if force.encoders_trusted:
        force.doubted_since = math.inf
    elif force.doubted_since == math.inf:
        force.doubted_since = force.t
    if force.fallen >= 0:
        _weigh_load(force)
    too_fast = locks_at_overspeed(
        force.overspeed,
        force.detection.n_vehicle,
        force.inputs.v,
        force.inputs.reference,
        not force.encoders_trusted,
        force.t,
    )
    if force.overspeed.joint >= 0:
        _note_fall(force)
    if force.brakes or too_fast or force.joint_age > _ENCODER_SILENCE + force.joints_late:
        force.inputs.joints[0] = 0.0
    else:
        force.inputs.joints[0] = 1.0
    force.locks = (
        force.inputs.joints[0] == 0.0
        if force.detection.joints.count > 0
        else force.inputs.hold[0] != 0.0
    )
    _carry_locked(force)
    if _share_changes(force):
        force.transfer(force.inputs, force.state, force.transferred)
        force.observe(force.inputs, force.effectiveness, force.transferred, force.observed)
    else:
        force.observe(force.inputs, force.effectiveness, force.state, force.observed)
    if force.attitude_open:
        _leave_turns(force)
    force.detection.changed = False
    if force.watched:
        _detect_faults(force)
    force.control(force.inputs, force.observed, force.desired)
    force.possible = _is_possible(force) and thrust_allocation.allocate_thrust(force.allocation)
    if force.possible:
        n = force.allocation.count
        force.allocated.thrust[:n] = force.allocation.thrust[:n]
        force.allocated.reached[:] = force.allocation.within
        force.allocated.unreachable[:] = force.allocation.unreachable
        force.command(
            force.inputs,
            force.effectiveness,
            force.observed,
            force.desired,
            force.allocated,
            force.state,
            force.outputs,
        )
    return force.possible


def apply_detected_effectiveness(force: ForceMemory) -> None:
    """Adopt the effectiveness that fault detection found: thrust that was missing has been taken
    for water so far.
    """
    for i in range(force.allocation.count):
        thrust = force.observed.thrust[i]
        lost = effective_thrust(force.effectiveness, i, thrust) - effective_thrust(
            force.detection.effectiveness, i, thrust
        )
        for k in range(force.detection.n_vehicle):
            force.observed.estimate[k] += force.allocation.matrix[k][i] * lost
        force.effectiveness.share[i] = force.detection.effectiveness.share[i]
        force.effectiveness.constant[i] = force.detection.effectiveness.constant[i]
        force.allocation.share[i] = force.effectiveness.share[i]
        force.allocation.constant[i] = force.effectiveness.constant[i]
    thrust_allocation.apply_effectiveness(force.allocation)
    # Jammed joints are left to their brakes: nothing is compensated on axes that do not move, and
    # they have not been moving.
    for j in range(force.detection.joints.count):
        if force.detection.joints.jammed[j]:
            k = force.detection.n_vehicle + j
            force.observed.estimate[k] = 0.0
            force.observed.integral[k] = 0.0
            force.observed.before[k] = 0.0
            force.inputs.reference[k] = 0.0


def _leave_turns(force: ForceMemory) -> None:
    """Learn nothing about turns, and find no faults by them: what holds a vehicle in an attitude that
    is wrong turns it over.
    """
    for k in range(min(3, force.detection.n_vehicle), force.detection.n_vehicle):
        force.observed.estimate[k] = force.state.estimate[k]
        force.observed.integral[k] = 0.0
    force.observed.watch[0] = float(tick_functions.MonitorStep.PAUSED)


def _note_fall(force: ForceMemory) -> None:
    """Note which joint fell, unless readings were doubted before or its loop shook it: then it is no
    load.
    """
    force.fallen = -1
    doubted_before = force.doubted_since < force.t - _RAISED - SAME_TIME
    if not doubted_before and not force.overspeed.shaking:
        k = force.detection.n_vehicle + force.overspeed.joint
        force.fallen = force.overspeed.joint
        force.fell_upwards = force.inputs.v[k] > force.inputs.reference[k]


def _weigh_load(force: ForceMemory) -> None:
    """Once the vehicle bears what brakes hold, take its weight for what made a joint fall, where it
    explains both: an arm that brakes let go would fall again by a load that nobody knows of.

    One that fell again soon stays locked for as long as it is to be; its load is weighed at the end.
    Nor is the load of an arm weighed whose vehicle is carried off: what it bears is not the load
    alone, then or soon after, and its arm stays locked for as long as it is to be.
    """
    overspeed = force.overspeed
    is_over = force.t >= overspeed.locked_until - SAME_TIME
    is_steady = force.t >= overspeed.locked_at + _WEIGHING - SAME_TIME
    doubted_later = not force.encoders_trusted and (
        force.doubted_since > overspeed.locked_at + _RAISED + SAME_TIME
    )
    if doubted_later or overspeed.moved:
        force.fallen = -1
    is_due = is_over or (is_steady and force.t > force.weighed_t + _AGAIN)
    if force.fallen < 0 or not is_due or not force.encoders_trusted:
        return
    if not is_steady:
        overspeed.locked_until = overspeed.locked_at + _WEIGHING
        return
    first = force.detection.n_vehicle
    if not is_over and is_carried_off(overspeed, first, force.inputs.v, force.inputs.reference):
        force.fallen = -1
        return
    force.weigh(force.inputs, force.state, force.weighed, force.explained)
    if _explains_fall(force):
        for k in range(force.detection.n_vehicle, len(force.weighed)):
            force.state.estimate[k] = force.weighed[k]
            force.state.beyond[k] = 0.0
        overspeed.locked_until = force.t
        force.weighed_t = force.t
    force.fallen = -1


def _explains_fall(force: ForceMemory) -> bool:
    """Return whether a load explains what the vehicle bears, and that the joint fell as it did."""
    k = force.detection.n_vehicle + force.fallen
    more = force.weighed[k] - force.state.estimate[k]
    is_sizeable = abs(more) > _SIZEABLE * force.joint_efforts[force.fallen]
    return force.explained[0] > _EXPLAINED and is_sizeable and (more > 0.0) == force.fell_upwards


def _carry_locked(force: ForceMemory) -> None:
    """Go on to hold joints by the torque that they had one tick after they were locked: what changes in
    the posture of an arm under its brakes is its readings, and no weight. In the tick in which they
    lock it may still have moved.
    """
    first = len(force.inputs.q) - force.n_joint_q
    finite = True
    for k in range(first):
        force.inputs.q_before[k] = force.inputs.q[k]
    for k in range(len(force.inputs.q)):
        finite = finite and math.isfinite(force.inputs.q[k])
    if force.locked and finite:
        force.carry(force.inputs, force.state, force.carried, force.beyond)
        for k in range(len(force.carried)):
            force.state.estimate[k] = force.carried[k]
            force.state.beyond[k] = force.beyond[k]
    force.locked = finite and force.inputs.joints[0] == 0.0 and math.isfinite(force.joint_age)
    for k in range(first, len(force.inputs.q)):
        force.inputs.q_before[k] = force.inputs.q[k]


def _share_changes(force: ForceMemory) -> bool:
    changes = False
    for i in range(len(force.state.share)):
        required = (
            force.inputs.feedback[0]
            if i < force.detection.n_vehicle
            else force.inputs.joint_feedback[0]
        )
        changes = changes or force.state.share[i] != required
    return changes


def _detect_faults(force: ForceMemory) -> None:
    """Detect faults of thrusters and joints, and do without what is faulty from now on."""
    if force.observed.watch[0] == tick_functions.MonitorStep.PAUSED:
        pause_detection(force.detection)
    elif force.observed.watch[0] == tick_functions.MonitorStep.DUE and _write_observation(force):
        if detect_faults(force.detection, force.t):
            apply_detected_effectiveness(force)
        force.gives_up = force.detection.judged and not force.detection.authority.can_go_on


def _write_observation(force: ForceMemory) -> bool:
    """Write the observation for fault detection; return whether it is finite: a nan would never
    leave its filters.
    """
    finite = True
    force.detection.encoders_trusted = force.encoders_trusted
    for k in range(len(force.inputs.q)):
        force.detection.q[k] = force.inputs.q[k]
        finite = finite and math.isfinite(force.inputs.q[k])
    for k in range(len(force.observed.estimate)):
        force.detection.residual[k] = force.observed.estimate[k] + force.observed.lead[k]
        force.detection.disturbance[k] = force.observed.estimate[k]
        force.detection.way[k] = force.observed.way[k]
        finite = (
            finite
            and math.isfinite(force.detection.residual[k])
            and math.isfinite(force.detection.way[k])
        )
    n = force.allocation.count
    force.detection.asked[:n] = force.observed.asked[:n]
    return finite


def _is_possible(force: ForceMemory) -> bool:
    possible = True
    for k in range(len(force.desired.force)):
        possible = possible and abs(force.desired.force[k]) < thrust_allocation.LARGEST_WRENCH
    force.allocation.wrench[:] = force.desired.wrench
    return possible


# Between the layers of velocities and of forces.


def ask_forces(tick: TickMemory, force: ForceMemory) -> None:
    """Give the force layer the velocity to track. A kernel."""
    less = tick.restriction
    force.inputs.q[:] = tick.q
    force.inputs.v[:] = tick.v
    force.inputs.reference[:] = tick.command
    force.inputs.feedback[0] = less.feedback
    force.inputs.joint_feedback[0] = less.joint_feedback
    force.inputs.hold[0] = 1.0 if is_blind(tick) else 0.0
    force.inputs.turning[0] = 1.0 if damps_turns(tick) else 0.0
    force.inputs.stop[0] = 1.0 if is_stopped(tick) else 0.0
    force.brakes = less.joints_held
    force.attitude_open = less.attitude_open
    force.t = tick.t
    force.joint_age = tick.joint_age
    force.encoders_trusted = (
        less.level[_POSITIONS] == Trust.GOOD and less.level[_RATES] == Trust.GOOD
    )
    force.joint_rates_lost = less.level[_RATES] == Trust.LOST


def hear_forces(tick: TickMemory, force: ForceMemory) -> None:
    """Tell the velocity layer what the force layer met in the last tick. A kernel."""
    tick.distress.short = force.allocation.saturated
    tick.distress.push = force.outputs.push[0]
    tick.distress.spent = force.state.spent[0]
    if force.detection.changed:
        tick.distress.fault = force.gives_up
        for j in range(force.detection.joints.count):
            tick.jammed[force.detection.n_vehicle + j] = force.detection.joints.jammed[j]


class ForceTick:
    """Track a reference velocity by thrust and torque.

    Holds its state: build one per run. Not for use from two threads at once.
    """

    def __init__(self, laws: tick_functions.ForceLaws, *, compiled: bool = True) -> None:
        """compiled: in C where there is a compiler."""
        structure = structure_of(ForceMemory, laws.dimensions, **_parts(laws))
        self.memory: ForceMemory
        """Memory of the kernel."""
        self.memory, (begin, self.kernel, self._adapt) = make_memory(
            structure, (begin_force, force_step, apply_detected_effectiveness), compiled=compiled
        )
        self.inputs: tick_functions.ForceInputs = arrays_of(self.memory.inputs)
        """Inputs of the next tick, which `ask_forces` writes, with those in `memory`."""
        self.observed: tick_functions.ForceState = arrays_of(self.memory.observed)
        """State of the last tick after its observer."""
        self.state: tick_functions.ForceState = arrays_of(self.memory.state)
        """State that the next tick starts from."""
        self._outputs = column_view(self.memory.outputs)
        self._places = tuple(
            tick_functions.column_places(tick_functions.ForceOutputs, laws.dimensions).values()
        )
        self._write(laws)
        begin(self.memory)

    def step(self) -> list[np.ndarray]:
        """Run the tick of the inputs and return the parts of `ForceOutputs`, which the caller owns.

        Raises `InvalidInput` for a force that is not finite, or that is beyond `LARGEST_WRENCH`.
        """
        self.kernel(self.memory)
        self.require_possible()
        outputs = self._outputs.copy()
        return [outputs[place] for place in self._places]

    def require_possible(self) -> None:
        """Raise `InvalidInput` for a force of the last tick that is not finite, or that is beyond
        `LARGEST_WRENCH`.
        """
        if not self.memory.possible:
            force = np.array(self.memory.desired.force)
            largest = thrust_allocation.LARGEST_WRENCH
            raise InvalidInput(
                f"a motion that needs the force {force} [N, N m]; give one of finite forces below"
                f" {largest:g}"
            )

    def places(self) -> dict[str, np.ndarray]:
        """Return the parts of `ForceOutputs` by name, in memory."""
        names = tick_functions.ForceOutputs.__dataclass_fields__
        parts = dict[str, np.ndarray]()
        for name, place in zip(names, self._places, strict=True):
            parts[name] = self._outputs[place]
        return parts

    @property
    def observes(self) -> bool:
        """True where the last tick was given velocities that the observer may learn from."""
        inputs = self.inputs
        if inputs.hold[0] or inputs.stop[0]:
            return False
        without_joints = not self.memory.detection.joints.count
        return without_joints or bool(inputs.joints[0])

    def _write(self, laws: tick_functions.ForceLaws) -> None:
        memory = self.memory
        robot = laws.robot
        derating = laws.derating
        memory.bandwidth_share = derating.vehicle
        memory.joint_bandwidth_share = derating.joints
        memory.joints_late = derating.joints_late
        memory.measures_joint_rates = laws.measures_joint_rates
        thrust_allocation.allocation_of(robot).write(memory.allocation)
        memory.detection.n_vehicle = robot.n_vehicle
        memory.detection.joints.count = robot.n_joints
        memory.n_joint_q = robot.n_q - robot.joint_q.start
        efforts = robot.limits.effort.tolist()
        memory.joint_efforts[: robot.n_joints] = efforts
        memory.overspeed.count = robot.n_joints
        memory.overspeed.late = derating.joints_late
        memory.overspeed.steadies = bool(undriven_axes(robot))
        joint_limits = robot.limits.velocity[robot.joint_v].tolist()
        memory.overspeed.limit[: robot.n_joints] = joint_limits
        vehicle_limits = robot.limits.velocity[: robot.n_vehicle].tolist()
        memory.overspeed.vehicle_limit[: robot.n_vehicle] = vehicle_limits
        if (
            laws.search is not None
            and laws.residual_filter is not None
            and laws.observer is not None
        ):
            memory.watched = True
            bandwidth = derating.vehicle * float(laws.observer.bandwidth[0])
            write_detection(
                memory.detection,
                robot,
                laws.search,
                laws.residual_filter,
                bandwidth=bandwidth,
                dt=laws.velocity.dt,
            )


@lru_cache(maxsize=8)
def _parts(laws: tick_functions.ForceLaws) -> dict[str, Any]:
    """Return what a `ForceMemory` has beside the dimensions of the robot."""
    period = laws.velocity.dt
    if laws.residual_filter is not None:
        period *= laws.residual_filter.every
    symbolic = laws.velocity.dynamics
    search = laws.search or ActuatorHealthTuning()
    return {
        **detection_parts(laws.robot, symbolic, search, period),
        "allocation": thrust_allocation.allocation_type(laws.dimensions.n_thrusters),
        "carry": tick_functions.with_gains(tick_functions.carry_function, laws),
        "weigh": tick_functions.with_gains(tick_functions.weigh_function, laws),
        "transfer": tick_functions.with_gains(tick_functions.transfer_function, laws),
        "observe": tick_functions.with_gains(tick_functions.observe_function, laws),
        "control": tick_functions.with_gains(tick_functions.control_function, laws),
        "command": tick_functions.with_gains(tick_functions.command_function, laws),
    }
