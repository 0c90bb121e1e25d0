"""The health of all thrusters and joints of a robot, what is left without the faulty ones, and what to say about it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from uvms_ocp.control.actuator_health.authority import Authority, authority_of
from uvms_ocp.control.actuator_health.effect import Effect
from uvms_ocp.control.actuator_health.joint_monitor import JointMonitor
from uvms_ocp.control.actuator_health.thresholds import HealthTuning
from uvms_ocp.control.actuator_health.thruster_monitor import ThrusterMonitor
from uvms_ocp.control.actuator_health.verdicts import joint_alarm, thruster_alarm
from uvms_ocp.model.dynamics import Dynamics
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.thrusters import thrust_limits, thruster_matrix

_TILT = 0.1  # [rad] in which the righting moment may balance what thrusters no longer can


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Seen:
    """What one tick shows of the actuators."""

    q: np.ndarray
    """(n_q,) [m, rad] measured."""
    v: np.ndarray
    """(n_v,) [m/s, rad/s] measured."""
    reference: np.ndarray
    """(n_v,) [m/s, rad/s] that the robot should follow."""
    residual: np.ndarray
    """(n_v,) [N, N m] that the observer finds beside model and commands, one lag behind."""
    disturbance: np.ndarray
    """(n_v,) [N, N m] the same, as it is made up for."""
    asked: np.ndarray
    """(n_thrusters,) [N] thrust now, of thrusters that all follow their commands."""


class ActuatorMonitor:
    """Judges all actuators and logs what it finds in `alarms`. Holds what was seen: build one per run."""

    def __init__(
        self,
        robot: Robot,
        dynamics: Dynamics,
        *,
        bandwidth: float,
        dt: float,
        alarms: list[tuple[float, str]],
        tuning: HealthTuning | None = None,
    ) -> None:
        """bandwidth [rad/s] of the observer; dt [s] of a tick; alarms: time [s] and text of each, appended to."""
        tuning = tuning or HealthTuning()
        self._robot, self._dynamics, self.alarms = robot, dynamics, alarms
        self._matrix, (self._lower, self._upper) = thruster_matrix(robot), thrust_limits(robot)
        self.thrusters = ThrusterMonitor(
            self._matrix, self._lower, self._upper, tuning=tuning, bandwidth=bandwidth, dt=dt
        )
        self.joints = JointMonitor(robot.limits.effort, tuning=tuning, dt=dt)
        self.authority: Authority | None = None
        """What thrusters can still reach; `None` while all are sound."""

    @property
    def effect(self) -> Effect:
        """What thrusters make of their commands, by the verdicts."""
        return self.thrusters.effect

    @property
    def can_go_on(self) -> bool:
        """Whether what is left is enough for a mission."""
        return self.authority is None or self.authority.can_go_on

    def pause(self) -> None:
        """What is measured is not to be trusted."""
        self.thrusters.pause()
        self.joints.pause()

    def update(self, seen: Seen, t: float) -> bool:
        """Take in a tick at time t [s]; whether anything was found faulty."""
        n = self._robot.n_vehicle
        jammed = self.joints.update(seen.reference[n:], seen.v[n:], seen.residual[n:], t)
        before = self.effect
        faulty = self.thrusters.update(seen.residual[:n], seen.asked, t)
        for j in jammed:
            self.alarms.append((t, joint_alarm(j + 1, self._robot.joint_names[j], self.joints.verdicts[j])))
        if faulty:
            self._tell(faulty, seen, before, t)
        return bool(faulty or jammed)

    def telemetry(self) -> dict[str, Any]:
        """For the record: shares (n_thrusters,) [-], constants (n_thrusters,) [N], verdicts as whole numbers."""
        return {
            "thruster_share": self.effect.share,
            "thruster_constant": self.effect.constant,
            "thruster_health": np.array([verdict.health for verdict in self.thrusters.verdicts], dtype=np.int8),
            "joint_health": np.array([verdict.health for verdict in self.joints.verdicts], dtype=np.int8),
        }

    def _tell(self, faulty: tuple[int, ...], seen: Seen, before: Effect, t: float) -> None:
        names = [thruster.name for thruster in self._robot.description.thrusters]
        for i in faulty:
            self.alarms.append((t, thruster_alarm(i + 1, names[i], self.thrusters.verdicts[i])))
        shift = self._matrix @ (before.given(seen.asked) - self.effect.given(seen.asked))
        rest = np.zeros(self._robot.n_v)
        weight = self._dynamics.inverse_dynamics(seen.q, rest, rest)[:6]
        self.authority = authority_of(
            self._matrix,
            self._lower,
            self._upper,
            self.effect,
            weight - seen.disturbance[:6] - shift,
            self._righting(seen.q),
        )
        end = "" if self.authority.can_go_on else "; the mission cannot go on"
        self.alarms.append((t, f"{self.authority}{end}"))

    def _righting(self, q: np.ndarray) -> np.ndarray:
        """(6,) [N, N m] moments of weight and buoyancy about roll and pitch within the allowed tilt from level."""
        level = q.copy()
        level[3:7] = 0.0, 0.0, 0.0, 1.0
        rest = np.zeros(self._robot.n_v)
        upright = self._dynamics.inverse_dynamics(level, rest, rest)
        moments = np.zeros(6)
        for axis in (3, 4):
            tilted = level.copy()
            tilted[axis] = np.sin(0.5 * _TILT)
            tilted[6] = np.cos(0.5 * _TILT)
            moments[axis] = max(self._dynamics.inverse_dynamics(tilted, rest, rest)[axis] - upright[axis], 0.0)
        return moments
