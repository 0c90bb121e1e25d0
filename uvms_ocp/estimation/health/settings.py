"""Set up the state of the health monitor: the sensors of the robot, and what its limits allow."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from uvms_ocp.codegen.kernel_layout import structure_of
from uvms_ocp.estimation.filter_memory import N_CHANNELS, NUMBER
from uvms_ocp.estimation.health.channel_state import N_ESTIMATES, TOO_LATE, ChannelMemory, HealthMemory
from uvms_ocp.estimation.health.floor import POSITION, init_floor
from uvms_ocp.estimation.health.plausibility import CHANCE, init_repetitions
from uvms_ocp.estimation.health.redundancy import init_comparisons
from uvms_ocp.estimation.health.tuning import HealthTuning
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import SensorSpec
from uvms_ocp.types import Array

_SIGMAS = 8.0  # of the channel's noise, which noise passes once in 1e15 readings
# How wrong an estimate can be beyond noise, of a robot that manoeuvres in gusts.
_POSITION_DRIFT = (
    0.05  # [m/s] of a position that a DVL carries, or of a depth that anything does: its bias, and the attitude's
)
_ATTITUDE = 0.05  # [rad]
_ATTITUDE_DRIFT = 0.02  # [rad/s] of an attitude that a gyro carries: ten times the noise of the gyro
_VELOCITY = 0.25  # [m/s]: a vehicle that accelerates with 1 m/s2 between two readings of a DVL
_VELOCITY_DRIFT = 0.02  # [m/s2] of a velocity that position fixes carry
_RATE = 0.2  # [rad/s] of the vehicle: a blow
_RATE_DRIFT = 0.1  # [rad/s2] of a rate that attitudes carry
_JOINTS = 0.05  # [rad or m] of joint positions
_JOINT_RATE = 0.5  # [rad/s or m/s] of joint velocities: a joint that meets its stop
_ENCODER_TRAVEL = 0.02  # [rad or m] that is asked of a joint while its encoder does not change by a bit
_BRISK = 1.5  # by how much water and blows move a vehicle faster than it can by itself
_ANY = 1e12  # [unit of the channel] growth of what has no limits
_FASTEST = 10.0  # [rad/s or m/s] of a joint without limits
_WHOLE = ("attitude",)  # whose components cannot be judged one by one: some hardly change
_RATES = ("angular_velocity", "linear_velocity", "joint_velocities")
"""Exact ones may belong to a plant whose velocities jump, as the paper's does."""
_RIVALS = {
    "attitude": ("angular_velocity",),
    "angular_velocity": ("attitude",),
    "position": ("linear_velocity", "depth"),
    "depth": ("position", "linear_velocity"),
    "linear_velocity": ("position",),
}
"""Channels that may be why the estimate does not agree with one."""


def health_memory(robot: Robot, specs: Mapping[str, SensorSpec], tuning: HealthTuning) -> HealthMemory:
    """A `HealthMemory`; specs: of every channel that the robot has."""
    made = structure_of(
        HealthMemory,
        n_q=robot.n_q,
        n_v=robot.n_v,
        n_joints=robot.n_joints,
        n_width=max(4, *sizes_of(robot)["joint_positions"]),
        n_estimates=N_ESTIMATES,
    )()
    made.n, made.order[: len(specs)] = len(specs), [int(NUMBER[name]) for name in specs]
    made.clean, made.clock, made.late = tuning.clean, tuning.clock, tuning.late
    made.history.length = max((spec.delay for spec in specs.values()), default=0.0) + TOO_LATE
    made.history.spacing = made.history.length / (N_ESTIMATES - 2)
    for c in range(N_CHANNELS):
        _set_nothing(made.channels[c], c)
    for name, spec in specs.items():
        _set_channel(made.channels[NUMBER[name]], robot, name, spec)
    _set_gates(made, robot, specs, tuning)
    delay = specs["joint_positions"].delay if "joint_positions" in specs else 0.0
    fastest = np.minimum(robot.limits.velocity[robot.joint_v], _FASTEST)
    made.encoders.allowed[: robot.n_joints] = (_ENCODER_TRAVEL + delay * fastest).tolist()
    made.encoders.n = robot.n_joints if _is_plain(robot) and robot.n_joints == len(robot.joint_names) else 0
    _set_comparisons(made, specs, tuning)
    return made


def sizes_of(robot: Robot) -> dict[str, tuple[int, ...]]:
    """The shape of the value of each channel."""
    return {
        "position": (3,),
        "depth": (),
        "attitude": (4,),
        "angular_velocity": (3,),
        "linear_velocity": (3,),
        "specific_force": (3,),
        "joint_positions": (robot.joint_q.stop - robot.joint_q.start,),
        "joint_velocities": (robot.n_joints,),
        "altimeter_range": (),
    }


def _set_nothing(c: ChannelMemory, number: int) -> None:
    c.number, c.rival, c.other_rival, c.gate.by, c.gate.or_by = number, -1, -1, -1, -1
    c.used = c.refused_at = c.impossible_at = c.bad_at = c.excluded_until = c.compared_at = -math.inf
    c.taken = c.used_at = math.nan


def _set_channel(c: ChannelMemory, robot: Robot, name: str, spec: SensorSpec) -> None:
    c.present, c.size = True, math.prod(sizes_of(robot)[name])
    c.delay, c.period, c.losses = spec.delay, 1.0 / spec.rate, _losses(spec.dropout)
    c.rival, c.other_rival = _two(_RIVALS.get(name, ()))
    plain = not name.startswith("joint") or _is_plain(robot)
    init_repetitions(c.repeats, spec.sigma, size=c.size, each=plain and name not in _WHOLE)


def _is_plain(robot: Robot) -> bool:
    """Tell whether each degree of freedom of the joints is one number in q."""
    return sizes_of(robot)["joint_positions"] == (robot.n_joints,)


def _losses(dropout: float) -> float:
    """How many readings in a row a sensor that drops some loses by chance."""
    if dropout <= 0.0:
        return 0.0
    return math.inf if dropout >= 1.0 else math.log(CHANCE) / math.log(dropout)


def _two(names: tuple[str, ...]) -> tuple[int, int]:
    """Numbers of up to two channels, -1 for none."""
    first, second, *_ = (*(int(NUMBER[name]) for name in names), -1, -1)
    return first, second


def _set_gates(memory: HealthMemory, robot: Robot, specs: Mapping[str, SensorSpec], tuning: HealthTuning) -> None:
    """The gate of each channel that has one, by what the robot's limits allow."""
    allowed = _joint_gates(robot) | (_vehicle_gates(robot, tuning) if robot.n_vehicle else {})
    for name, spec in specs.items():
        if name not in allowed or (spec.exact and name in _RATES):
            continue
        gate, of = memory.channels[NUMBER[name]].gate, allowed[name]
        gate.exists, gate.channel, gate.size = True, int(NUMBER[name]), memory.channels[NUMBER[name]].size
        gate.start, gate.supported, gate.alone, gate.most = of.start, of.supported, of.alone, math.inf
        gate.base = of.base + _SIGMAS * spec.sigma + max(map(abs, spec.biases)) + _unforeseen(of, spec, specs)
        gate.by, gate.or_by = _two(of.by)
    if robot.n_vehicle:
        v, w = _brisk(robot.limits.velocity)
        memory.channels[NUMBER["angular_velocity"]].gate.most = 4 * w + _RATE
        memory.channels[NUMBER["linear_velocity"]].gate.most = v + tuning.current


class _Allowed(NamedTuple):
    """Return by how much an estimate may be off."""

    start: int
    """Where the value begins in q or v."""
    base: float
    supported: float
    """Growth while it is carried."""
    alone: float
    by: tuple[str, ...]
    """The channels that carry it."""
    pull: float = math.inf
    """Growth of the growth itself, where the rate of the value is known at first."""


def _unforeseen(of: _Allowed, spec: SensorSpec, specs: Mapping[str, SensorSpec]) -> float:
    """Compute how far the robot may have moved unknown to the estimate when the reading was taken.

    A late reading meets an estimate of its time that had been carried on by itself for as long, at worst with full acceleration
    the other way.
    """
    blind = min([spec.delay, *(specs[name].delay for name in of.by if name in specs)])
    moved = min(of.alone * blind, of.pull * blind**2) if of.pull < math.inf else of.alone * blind
    return moved + of.supported * (spec.delay - blind)


def _vehicle_gates(robot: Robot, tuning: HealthTuning) -> dict[str, _Allowed]:
    v, w = _brisk(robot.limits.velocity)
    a, alpha = _brisk(robot.limits.acceleration)
    fixes = ("position", "linear_velocity")
    return {
        "position": _Allowed(0, POSITION, _POSITION_DRIFT, v + tuning.current, fixes[1:], a),
        "depth": _Allowed(2, POSITION, _POSITION_DRIFT, v + tuning.current, fixes, a),
        "attitude": _Allowed(3, _ATTITUDE, _ATTITUDE_DRIFT, w, ("angular_velocity",), alpha),
        "angular_velocity": _Allowed(3, _RATE, _RATE_DRIFT, alpha, ("attitude",)),
        "linear_velocity": _Allowed(0, _VELOCITY, _VELOCITY_DRIFT, a, fixes[:1]),
    }


def _brisk(limits: Array) -> tuple[float, float]:
    """Norms of the linear and the angular limits (n_v,) of a vehicle in water."""
    linear, angular = (_BRISK * float(np.linalg.norm(_finite(limits[part]))) for part in (slice(0, 3), slice(3, 6)))
    return linear, angular


def _joint_gates(robot: Robot) -> dict[str, _Allowed]:
    v, a = (_finite(limit[robot.joint_v]) for limit in (robot.limits.velocity, robot.limits.acceleration))
    fastest, quickest = _BRISK * float(v.max(initial=0.0)), _BRISK * float(a.max(initial=0.0))
    return {
        "joint_positions": _Allowed(robot.joint_q.start, _JOINTS, fastest, fastest, (), quickest),
        "joint_velocities": _Allowed(robot.joint_v.start, _JOINT_RATE, quickest, quickest, ()),
    }


def _finite(limits: Array) -> Array:
    return np.minimum(limits, _ANY)


def _set_comparisons(memory: HealthMemory, specs: Mapping[str, SensorSpec], tuning: HealthTuning) -> None:
    noise = {
        name: spec.sigma + max(map(abs, spec.biases)) if (spec := specs.get(name)) else 0.0
        for name in ("position", "attitude", "depth")
    }
    init_comparisons(memory.velocity, memory.rate, memory.depth, noise)
    init_floor(memory.floor, specs["altimeter_range"].sigma if "altimeter_range" in specs else 0.0, tuning)
