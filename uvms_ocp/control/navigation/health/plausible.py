"""Whether a reading can be true, given where the robot was estimated to be when it was taken."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from uvms_ocp.control.navigation.health.history import Estimate
from uvms_ocp.control.navigation.health.tuning import HealthTuning
from uvms_ocp.model.limits import Limits
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.sensing import SensorSpec
from uvms_ocp.model.state import Reading

_SIGMAS = 8.0
_BRISK = 1.5  # by how much water and blows move a vehicle faster than it can by itself
_CONFIRMED = 5
"""Readings in a row that must agree before one that does not is refused: an estimate is made of those before."""
_ANY = 1e12  # [unit of the channel] growth of what has no limits


class Gate(NamedTuple):
    """By how much a reading may differ from the estimate: at once, and by how much more for every second without any."""

    error: Callable[[Any, Estimate], float]
    """Of a value against an estimate [unit of the channel]."""
    base: float
    """[unit of the channel]"""
    supported: float
    """[unit of the channel / s] growth while another channel carries the estimate."""
    alone: float
    """[unit of the channel / s] growth otherwise: what is physically possible."""
    by: tuple[str, ...] = ()
    """Channels of which any carries the estimate."""
    most: float = math.inf
    """[unit of the channel] norm that no value exceeds."""
    unit: str = ""

    def objection(self, reading: Reading[Any], estimate: Estimate, last: float, *, carried: bool) -> str | None:
        """Why the value cannot be, against the estimate; last [s]: when the last reading was taken that was used.

        The gate grows with the time since without end, so that it never shuts a channel out for good.
        """
        error = self.error(reading.value, estimate)
        growth = (self.supported if carried else self.alone) * max(reading.t - last, 0.0)
        allowed = self.base + growth + self.alone * abs(reading.t - estimate.t)
        if not error <= allowed:
            return f"{error:.3g} {self.unit} off the estimate, allowed {allowed:.2g}"
        return None

    def impossible(self, value: Any) -> str | None:
        """Why no robot of this kind can ever read the value."""
        size = float(np.linalg.norm(value)) if self.most < math.inf else 0.0
        return None if size <= self.most else f"{size:.3g} {self.unit}, more than the {self.most:.2g} that can be"


def gates_of(robot: Robot, specs: Mapping[str, SensorSpec], tuning: HealthTuning) -> dict[str, Gate]:
    """The gate of each channel that has one, by what the robot's limits allow."""
    makers = {**_joint_gates(robot, tuning), **(_vehicle_gates(robot.limits, tuning) if robot.n_vehicle else {})}
    return {
        name: gate._replace(base=gate.base + _SIGMAS * spec.sigma + max(map(abs, spec.biases)))
        for name, spec in specs.items()
        if (gate := makers.get(name)) is not None and not (spec.exact and name in _RATES)
    }


_RATES = ("angular_velocity", "linear_velocity", "joint_velocities")
"""Exact ones may belong to a plant whose velocities jump, as the paper's does."""


def _vehicle_gates(limits: Limits, tuning: HealthTuning) -> dict[str, Gate]:
    v, w = (_BRISK * float(np.linalg.norm(_finite(limits.velocity[part]))) for part in (slice(0, 3), slice(3, 6)))
    a, alpha = (
        _BRISK * float(np.linalg.norm(_finite(limits.acceleration[part]))) for part in (slice(0, 3), slice(3, 6))
    )
    v += tuning.current
    fixes = ("position", "linear_velocity")
    return {
        "position": Gate(_position, tuning.position, tuning.position_drift, v, fixes[1:], unit="m"),
        "depth": Gate(_depth, tuning.position, tuning.position_drift, v, fixes, unit="m"),
        "attitude": Gate(_attitude, tuning.attitude, tuning.attitude_drift, w, ("angular_velocity",), unit="rad"),
        "angular_velocity": Gate(
            _angular_velocity, tuning.rate, tuning.rate_drift, alpha, ("attitude",), 4 * w + tuning.rate, "rad/s"
        ),
        "linear_velocity": Gate(_velocity, tuning.velocity, tuning.velocity_drift, a, fixes[:1], v, "m/s"),
    }


def _joint_gates(robot: Robot, tuning: HealthTuning) -> dict[str, Gate]:
    v, a = (_finite(limit[robot.joint_v]) for limit in (robot.limits.velocity, robot.limits.acceleration))
    fastest, quickest = _BRISK * float(v.max(initial=0.0)), _BRISK * float(a.max(initial=0.0))
    joint_q, joint_v = robot.joint_q, robot.joint_v

    def position(value: np.ndarray, estimate: Estimate) -> float:
        return float(np.abs(value - estimate.q[joint_q]).max(initial=0.0))

    def velocity(value: np.ndarray, estimate: Estimate) -> float:
        return float(np.abs(value - estimate.v[joint_v]).max(initial=0.0))

    return {
        "joint_positions": Gate(position, tuning.joints, fastest, fastest, unit="rad or m"),
        "joint_velocities": Gate(velocity, tuning.joint_rate, quickest, quickest, unit="rad/s or m/s"),
    }


def _finite(limits: np.ndarray) -> np.ndarray:
    return np.minimum(limits, _ANY)


def _position(value: np.ndarray, estimate: Estimate) -> float:
    return float(np.linalg.norm(value - estimate.q[:3]))


def _depth(value: float, estimate: Estimate) -> float:
    return abs(value - float(estimate.q[2]))


def _attitude(value: np.ndarray, estimate: Estimate) -> float:
    return 2.0 * math.acos(min(1.0, abs(float(value @ estimate.q[3:7]))))


def _angular_velocity(value: np.ndarray, estimate: Estimate) -> float:
    return float(np.linalg.norm(value - estimate.v[3:6]))


def _velocity(value: np.ndarray, estimate: Estimate) -> float:
    return float(np.linalg.norm(value - estimate.v[:3]))


def confirmed(agreed: int) -> bool:
    """Whether a channel has agreed with the estimate often enough to be contradicted by it."""
    return agreed >= _CONFIRMED
