"""One tick of the force layer in order, as one kernel: from a reference velocity to thrust and torque."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np

from uvms_ocp.codegen.kernel_layout import Layout, Smooth, column_view, structure_of
from uvms_ocp.codegen.kernels import make_memory
from uvms_ocp.control.faults.detection import FaultDetection, detect_faults, pause_detection
from uvms_ocp.control.faults.monitor import detection_sizes, write_detection
from uvms_ocp.control.faults.verdicts import ActuatorHealthTuning, ThrusterEffectiveness, effective_thrust
from uvms_ocp.control.force.allocation import (
    LARGEST_WRENCH,
    AllocationMemory,
    allocate_thrust,
    allocation_of,
    allocation_sizes,
    apply_effectiveness,
)
from uvms_ocp.control.force.tick_functions import (
    AllocatedThrust,
    DesiredForce,
    ForceInputs,
    ForceLaws,
    ForceOutputs,
    ForceState,
    MonitorStep,
    column_places,
    follow_function,
    observe_function,
    views_of,
    want_function,
)
from uvms_ocp.control.force.velocity_law import BandwidthDerating
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.signals import Command

# A tick of the force layer as one kernel: from a velocity to thrust and torque, and what is faulty of thrusters and joints.

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
    """share of their bandwidth that the loops of the vehicle never exceed: what is known late bears less."""
    joint_bandwidth_share: float
    """The same of the joints."""
    joints_late: float
    """[s] by which encoders are known to be late."""
    # given; of `given` all but whether joints are to be trusted
    t: float
    """[s] time of the tick."""
    given: ForceInputs
    brakes: bool
    """Joints are to be locked."""
    joint_age: float
    """[s] of what encoders tell."""
    encoders_trusted: bool
    """They are not doubted."""
    # remembered
    effect: ThrusterEffectiveness
    """What thrusters make of their commands, as far as it is known."""
    known: ForceState
    look: FaultDetection
    sharing: AllocationMemory
    # found
    now: ForceState
    """What is known before it acts."""
    wanted: DesiredForce
    allocated: AllocatedThrust
    told: ForceOutputs
    locks: bool
    """Joints are to be locked; without joints, whether the vehicle holds."""
    gives_up: bool
    """What is left is not enough for a mission."""


def begin_force(m: ForceMemory) -> None:
    """Before the first tick: all thrusters are sound."""
    for i in range(len(m.known.share)):
        m.known.share[i] = m.bears if i < m.look.n_vehicle else m.joint_bandwidth_share
    for i in range(m.sharing.count):
        m.look.effect.share[i] = 1.0
    apply_detected_effectiveness(m)


def force_step(m: ForceMemory) -> bool:
    """A tick; whether the force for it is finite and below `LARGEST_WRENCH`: if not, nothing is told, and what is known stays.

    On an axis that is not to be trusted feed-forward goes on alone: feedback from a frozen velocity would accelerate the robot
    without end.
    """
    m.given.feedback[0] = min(m.given.feedback[0], m.bears)
    m.given.joint_feedback[0] = min(m.given.joint_feedback[0], m.joint_bandwidth_share)
    m.given.joints[0] = 0.0 if m.brakes or m.joint_age > _ENCODER_SILENCE + m.joints_late else 1.0
    m.locks = m.given.joints[0] == 0.0 if m.look.joints.count > 0 else m.given.hold[0] != 0.0
    m.observe(m.given, m.effect, m.known, m.now)
    m.look.changed = False
    if m.watched:
        _detect_faults(m)
    m.want(m.given, m.now, m.wanted)
    possible = _is_possible(m) and allocate_thrust(m.sharing)
    if possible:
        _act(m)
    return possible


def apply_detected_effectiveness(m: ForceMemory) -> None:
    """To the effect that a look has found: what thrusters failed to give has been taken for water so far."""
    for i in range(m.sharing.count):
        thrust = m.now.thrust[i]
        lost = effective_thrust(m.effect, i, thrust) - effective_thrust(m.look.effect, i, thrust)
        for k in range(m.look.n_vehicle):
            m.now.estimate[k] += m.sharing.matrix[k][i] * lost
        m.effect.share[i] = m.look.effect.share[i]
        m.effect.constant[i] = m.look.effect.constant[i]
        m.sharing.share[i] = m.effect.share[i]
        m.sharing.constant[i] = m.effect.constant[i]
    apply_effectiveness(m.sharing)
    _leave_jammed(m)


def _leave_jammed(m: ForceMemory) -> None:
    """To the brakes: nothing is made up for on axes that do not move."""
    for j in range(m.look.joints.count):
        if m.look.joints.jammed[j]:
            m.now.estimate[m.look.n_vehicle + j] = 0.0
            m.now.integral[m.look.n_vehicle + j] = 0.0


def _detect_faults(m: ForceMemory) -> None:
    """Look for faults of thrusters and joints, and do without what is faulty from now on."""
    if m.now.watch[0] == MonitorStep.PAUSED:
        pause_detection(m.look)
    elif m.now.watch[0] == MonitorStep.DUE and _write_observation(m):
        if detect_faults(m.look, m.t):
            apply_detected_effectiveness(m)
        m.gives_up = m.look.judged and not m.look.authority.can_go_on


def _write_observation(m: ForceMemory) -> bool:
    """What there is to see; whether all of it is numbers: what is not would never be forgotten."""
    finite = True
    m.look.encoders_trusted = m.encoders_trusted
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
        possible = possible and abs(m.wanted.force[k]) < LARGEST_WRENCH
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


# A tick of the force layer in Python: its memory, made once, and the kernel that works on it.


class ForceTick:
    """From a reference velocity to commands.

    Holds what is known: build one per run. Not for use from two threads at once.
    """

    def __init__(self, laws: ForceLaws, borne: BandwidthDerating | None = None, *, compiled: bool = True) -> None:
        """borne: of what the sensors are like. compiled: in C where there is a compiler."""
        structure = structure_of(ForceMemory, **_sizes(laws))
        self.memory: Any
        """A `ForceMemory`"""
        self.memory, (begin, self._step, self._adapt) = make_memory(
            structure, (begin_force, force_step, apply_detected_effectiveness), compiled=compiled
        )
        self.given: ForceInputs = views_of(ForceInputs, laws.sizes, self.memory.given)
        """What the next tick is given."""
        parts = {name: getattr(self.memory.given, name) for name in ForceInputs.__dataclass_fields__}
        self._flags = ForceInputs(**parts)  # of ctypes, which take single numbers sooner than NumPy
        self.now: ForceState = views_of(ForceState, laws.sizes, self.memory.now)
        """What was known in the last one."""
        self.known: ForceState = views_of(ForceState, laws.sizes, self.memory.known)
        """What the next one goes on from."""
        self._told = column_view(self.memory.told)
        self._places = tuple(column_places(ForceOutputs, laws.sizes).values())
        self._write(laws, borne or BandwidthDerating())
        begin(self.memory)

    def give(self, q: np.ndarray, v: np.ndarray, command: Command, feedback: tuple[float, float]) -> None:
        """The robot at q (n_q,) [m, rad] and v (n_v,) [m/s, rad/s] as measured, and the command of the velocities.

        feedback: of vehicle and joints, as `Given` has it.
        """
        given = self.given
        given.q[:], given.v[:], given.reference[:] = q, v, command.v
        flags = self._flags
        flags.feedback[0], flags.joint_feedback[0] = feedback
        flags.hold[0], flags.stop[0] = command.hold, command.stop
        self.memory.brakes = command.brakes

    def step(self, t: float, joint_age: float = 0.0, encoders_trusted: bool = True) -> list[np.ndarray]:
        """A tick at time t [s]: the parts of `Told`, which the caller owns.

        joint_age [s] and encoders_trusted: as `ForceMemory` has them. Raises `InvalidInput` for a force that is not finite, or
        that is beyond `LARGEST_WRENCH`.
        """
        memory = self.memory
        memory.t, memory.joint_age, memory.encoders_trusted = t, joint_age, encoders_trusted
        if not self._step(memory):
            force = np.array(memory.wanted.force)
            raise InvalidInput(
                f"a motion that needs the force {force} [N, N m]; give one of finite forces below {LARGEST_WRENCH:g}"
            )
        told = self._told.copy()
        return [told[place] for place in self._places]

    @property
    def observes(self) -> bool:
        """Whether the last tick was given velocities that the observer may learn from."""
        flags, without_joints = self._flags, not self.memory.look.joints.count
        return not (flags.hold[0] or flags.stop[0]) and (without_joints or bool(flags.joints[0]))

    def adapt(self) -> None:
        """To the effect in the memory of the look, as a tick does that has found one."""
        self._adapt(self.memory)

    def _write(self, laws: ForceLaws, borne: BandwidthDerating) -> None:
        memory, robot = self.memory, laws.robot
        memory.bears, memory.joint_bandwidth_share, memory.joints_late = borne.vehicle, borne.joints, borne.joints_late
        allocation_of(robot).write(memory.sharing)
        memory.look.n_vehicle, memory.look.joints.count = robot.n_vehicle, robot.n_joints
        if laws.search is not None and laws.residual_filter is not None and laws.observer is not None:
            memory.watched, bandwidth = True, float(laws.observer.bandwidth[0])
            write_detection(
                memory.look, robot, laws.search, laws.residual_filter, bandwidth=bandwidth, dt=laws.velocity.dt
            )


@lru_cache(maxsize=2)
def _sizes(laws: ForceLaws) -> dict[str, Any]:
    """Sizes and functions of a `ForceMemory`."""
    period = laws.velocity.dt * (laws.residual_filter.every if laws.residual_filter else 1)
    symbolic, search = laws.velocity.dynamics, laws.search or ActuatorHealthTuning()
    return {
        **detection_sizes(laws.robot, symbolic, search, period),
        **allocation_sizes(len(laws.robot.description.thrusters)),
        **laws.sizes,
        "observe": observe_function(laws),
        "want": want_function(laws),
        "follow": follow_function(laws),
    }
