"""Set up the memory of the health monitor: the sensors of a robot, and what its limits allow."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from uvms_ocp.codegen.kernel_layout import structure_of
from uvms_ocp.estimation.filter_memory import NUMBER, numbers_of, unasked_turn
from uvms_ocp.estimation.health import plausibility, redundancy
from uvms_ocp.estimation.health.channel_state import TOO_LATE, ChannelMemory, HealthMemory
from uvms_ocp.estimation.health.floor import POSITION, init_floor
from uvms_ocp.estimation.health.tuning import HealthTuning
from uvms_ocp.robot.channels import CHANNEL_OF, Channel, rows_by_name, shape_of, start_of
from uvms_ocp.robot.dimensions import dimensions_of
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import SensorSpec
from uvms_ocp.robot.unasked_acceleration import unasked_acceleration
from uvms_ocp.types import Array

N_ESTIMATES = 1024
"""Estimates that are remembered: five seconds of ticks of 5 ms; shorter ticks are not all kept."""
_SIGMAS = 8.0  # of the channel's noise, which noise passes once in 1e15 readings
# How wrong an estimate can be beyond noise, of a robot that manoeuvres in gusts.
_POSITION_DRIFT = 0.05
"""[m/s] of a position that a DVL carries, or of a depth that anything does: bias of the DVL, and of
the attitude.
"""
_ATTITUDE = 0.05  # [rad]
_ATTITUDE_DRIFT = 0.002  # [rad/s] of an attitude that a gyro carries: its estimated bias
_VELOCITY = 0.25  # [m/s]: a vehicle that accelerates with 1 m/s2 between two readings of a DVL
_VELOCITY_DRIFT = 0.02  # [m/s2] of a velocity that position fixes carry
_RATE = 0.2  # [rad/s] of the vehicle: a blow
_RATE_DRIFT = 0.1  # [rad/s2] of a rate that attitudes carry
_JOINTS = 0.05  # [rad or m] of joint positions
_JOINT_DRIFT = 0.01  # [rad/s or m/s] of joint positions that sensors of their rates carry
_JOINT_RATE = 0.5  # [rad/s or m/s] of joint velocities: a joint that meets its stop
_ENCODER_TRAVEL = 0.02  # [rad or m] asked of a joint while its encoder does not change by a bit
_BRISK = 1.5  # by how much water and blows move a vehicle faster than it can by itself
_ANY = 1e12  # [unit of the channel] growth of what has no limits
_FASTEST = 10.0  # [rad/s or m/s] of a joint without limits


def health_memory(
    robot: Robot,
    specs: Mapping[str, SensorSpec],
    tuning: HealthTuning,
    own: Sequence[Channel] = (),
) -> HealthMemory:
    """Make a `HealthMemory`; specs: of every channel that the robot has, own: a user's among them."""
    rows = rows_by_name(own)
    numbers = numbers_of(own)
    memory = structure_of(HealthMemory, dimensions_of(robot, own), n_estimates=N_ESTIMATES)()
    memory.n = len(specs)
    memory.order[: len(specs)] = [numbers[name] for name in specs]
    memory.clean = tuning.clean
    memory.clock = tuning.clock
    memory.culprit = -1
    memory.blamed_at = -math.inf
    memory.late = tuning.late
    memory.history.length = max((spec.delay for spec in specs.values()), default=0.0) + TOO_LATE
    memory.history.spacing = memory.history.length / (N_ESTIMATES - 2)
    for number in range(len(numbers)):
        channel = memory.channels[number]
        channel.number = number
        channel.rival = -1
        channel.other_rival = -1
        channel.gate.by = -1
        channel.gate.or_by = -1
        channel.used = -math.inf
        channel.refused_at = -math.inf
        channel.impossible_at = -math.inf
        channel.bad_at = -math.inf
        channel.doubted_at = -math.inf
        channel.excluded_until = -math.inf
        channel.compared_at = -math.inf
        channel.taken = math.nan
        channel.used_at = math.nan
    for name, spec in specs.items():
        _set_channel(memory.channels[numbers[name]], robot, rows[name], spec)
    _set_gates(memory, robot, specs, tuning)
    bias = dict.fromkeys(rows, 0.0)
    sigma = dict.fromkeys(rows, 0.0)
    delay = dict.fromkeys(rows, 0.0)
    for name, spec in specs.items():
        bias[name] = _largest_bias(spec)
        sigma[name] = spec.sigma
        delay[name] = spec.delay
    fastest = np.minimum(robot.limits.velocity[robot.joint_v], _FASTEST)
    allowed_travel = _ENCODER_TRAVEL + delay["joint_positions"] * fastest
    memory.encoders.allowed[: robot.n_joints] = allowed_travel.tolist()
    memory.encoders.n = 0
    if _is_plain(robot) and robot.n_joints == len(robot.joint_names):
        memory.encoders.n = robot.n_joints
    noise = {name: bias[name] + sigma[name] for name in bias}
    redundancy.init_comparisons(
        memory.velocity, memory.rate, memory.depth, memory.encoder, noise, bias
    )
    memory.encoder.n = memory.encoders.n
    init_floor(memory.floor, sigma["altimeter_range"], tuning)
    return memory


def _largest_bias(spec: SensorSpec) -> float:
    return max(abs(bias) for bias in spec.biases)


def _set_channel(channel: ChannelMemory, robot: Robot, row: Channel, spec: SensorSpec) -> None:
    channel.present = True
    channel.size = math.prod(shape_of(row, robot))
    channel.delay = spec.delay
    channel.period = 1.0 / spec.rate
    channel.losses = math.inf if spec.dropout >= 1.0 else 0.0
    if 0.0 < spec.dropout < 1.0:  # so many readings in a row such a sensor loses by chance
        channel.losses = math.log(plausibility.CHANCE) / math.log(spec.dropout)
    channel.rival, channel.other_rival = _two(row.rivals)
    plain = not row.of_joints or _is_plain(robot)
    plausibility.init_repetitions(
        channel.repeats,
        spec.sigma,
        size=channel.size,
        each=plain and not row.of_one_piece,
        alike=not row.of_several_sensors,
    )


def _is_plain(robot: Robot) -> bool:
    """Check that each degree of freedom of the joints is one number in q."""
    return robot.joint_q.stop - robot.joint_q.start == robot.n_joints


def _two(names: tuple[str, ...]) -> tuple[int, int]:
    """Return the numbers of up to two channels, -1 for none."""
    numbers = [int(NUMBER[name]) for name in names]
    numbers += [-1, -1]
    return numbers[0], numbers[1]


def _set_gates(
    memory: HealthMemory, robot: Robot, specs: Mapping[str, SensorSpec], tuning: HealthTuning
) -> None:
    """Set the gate of each channel that has one, by what the robot's limits allow."""
    allowed = _joint_gates(robot, specs)
    if robot.n_vehicle:
        allowed |= _vehicle_gates(robot, tuning)
    for name, spec in specs.items():
        if name not in allowed:
            continue
        row = CHANNEL_OF[name]
        if spec.exact and row.orders == 1:
            # It may belong to a plant whose velocities jump, as the paper's does.
            continue
        gate = memory.channels[NUMBER[name]].gate
        of = allowed[name]
        gate.exists = True
        gate.channel = int(NUMBER[name])
        gate.orders = row.orders
        gate.size = memory.channels[NUMBER[name]].size
        gate.start = start_of(row, robot)
        gate.supported = of.supported
        gate.alone = of.alone
        gate.most = math.inf
        gate.noise = _SIGMAS * spec.sigma + _largest_bias(spec)
        gate.base = of.base + gate.noise + _unforeseen(of, spec, specs)
        gate.by, gate.or_by = _two(of.by)
        gate.jolt = row.jolt
        if name == "angular_velocity":
            gate.push = unasked_turn(robot)
        gate.rates = robot.joint_v.start if name == "joint_positions" else -1
    if robot.n_vehicle:
        v, w = _brisk(robot.limits.velocity)
        memory.channels[NUMBER["angular_velocity"]].gate.most = 4 * w + _RATE
        memory.channels[NUMBER["linear_velocity"]].gate.most = v + tuning.current


class _Allowed(NamedTuple):
    """Error that an estimate may have, in the unit of the channel."""

    base: float
    """Error of an estimate that a reading has just corrected."""
    supported: float
    """Growth [1/s] while other channels support the estimate."""
    alone: float
    """Growth [1/s] while none does."""
    by: tuple[str, ...]
    """Channels that support it."""
    pull: float = math.inf
    """Growth of the growth itself, where the rate of the value is known at first."""
    unasked: float = 0.0
    """Growth [1/s] that forces make which nobody asked for, before another channel shows it."""


def _unforeseen(of: _Allowed, spec: SensorSpec, specs: Mapping[str, SensorSpec]) -> float:
    """Compute how far the robot may have moved unknown to the estimate when the reading was taken.

    A late reading meets an estimate of its time that had been carried on by itself for as long, at
    worst with full acceleration the other way.
    """
    if of.unasked > 0.0:
        return of.unasked * spec.delay
    blind = min([spec.delay, *(specs[name].delay for name in of.by if name in specs)])
    if of.pull < math.inf:
        moved = min(of.alone * blind, of.pull * blind**2)
    else:
        moved = of.alone * blind
    return moved + of.supported * (spec.delay - blind)


def _vehicle_gates(robot: Robot, tuning: HealthTuning) -> dict[str, _Allowed]:
    v, w = _brisk(robot.limits.velocity)
    a, alpha = _brisk(robot.limits.acceleration)
    a = max(a, float(unasked_acceleration(robot)[:3].max()))
    fixes = ("position", "linear_velocity")
    return {
        "position": _Allowed(POSITION, _POSITION_DRIFT, v + tuning.current, fixes[1:], a),
        "depth": _Allowed(POSITION, _POSITION_DRIFT, v + tuning.current, fixes, a),
        "attitude": _Allowed(_ATTITUDE, _ATTITUDE_DRIFT, w, ("angular_velocity",), alpha),
        "angular_velocity": _Allowed(
            _RATE, _RATE_DRIFT, alpha, ("attitude",), unasked=max(alpha, unasked_turn(robot))
        ),
        "linear_velocity": _Allowed(_VELOCITY, _VELOCITY_DRIFT, a, fixes[:1]),
    }


def _brisk(limits: Array) -> tuple[float, float]:
    """Return the norms of the linear and the angular limits (n_v,) of a vehicle in water."""
    linear = _BRISK * float(np.linalg.norm(_finite(limits[:3])))
    angular = _BRISK * float(np.linalg.norm(_finite(limits[3:6])))
    return linear, angular


def _joint_gates(robot: Robot, specs: Mapping[str, SensorSpec]) -> dict[str, _Allowed]:
    """Return the errors allowed to joints.

    A position that jumps while the rates do not is the encoder's: the rates, integrated, tell the
    posture better, and the gate grows by their bias alone while they are good.
    """
    v = _finite(robot.limits.velocity[robot.joint_v])
    a = _finite(robot.limits.acceleration[robot.joint_v])
    fastest = _BRISK * float(v.max(initial=0.0))
    quickest = _BRISK * float(a.max(initial=0.0))
    supported = fastest
    base = _JOINTS
    rates = specs.get("joint_velocities")
    if rates is not None:
        supported = min(fastest, _JOINT_DRIFT + _largest_bias(rates))
        base += min(fastest / rates.rate, quickest / rates.rate**2)
    return {
        "joint_positions": _Allowed(base, supported, fastest, ("joint_velocities",), quickest),
        "joint_velocities": _Allowed(_JOINT_RATE, quickest, quickest, ()),
    }


def _finite(limits: Array) -> Array:
    return np.minimum(limits, _ANY)
