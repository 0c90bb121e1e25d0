"""The health of all thrusters and joints of a robot, what is left without the faulty ones, and what to say about it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.control.actuator_health.authority import Authority, authority_of
from uvms_ocp.control.actuator_health.balance import Balance
from uvms_ocp.control.actuator_health.effect import Effect
from uvms_ocp.control.actuator_health.intake import Intake, intake_of
from uvms_ocp.control.actuator_health.joint_monitor import JointMonitor
from uvms_ocp.control.actuator_health.thresholds import ActuatorHealthTuning
from uvms_ocp.control.actuator_health.thruster_monitor import ThrusterMonitor
from uvms_ocp.control.actuator_health.verdicts import (
    joint_alarm,
    joints_named,
    thruster_alarm,
    thrusters_named,
)
from uvms_ocp.model.dynamics import Dynamics
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.thrusters import thrust_limits, thruster_matrix

_TILT = 0.1  # [rad] in which the righting moment may balance what thrusters no longer can


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Look:
    """What one look shows of the actuators."""

    q: np.ndarray
    """(n_q,) [m, rad] measured."""
    residual: np.ndarray
    """(n_v,) [N, N m] that the observer finds beside model and commands, one lag behind."""
    disturbance: np.ndarray
    """(n_v,) [N, N m] the same, as it is made up for."""
    asked: np.ndarray
    """(n_thrusters,) [N] as `Asked.thrust`."""
    way: np.ndarray
    """(n_v,) [m/s, rad/s] as `Asked.way`."""
    joints_known: bool = True
    """Whether the encoders are to be trusted."""


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
        tuning: ActuatorHealthTuning | None = None,
    ) -> None:
        """bandwidth [rad/s] of the observer; dt [s] of a tick; alarms: time [s] and text of each, appended to."""
        tuning = tuning or ActuatorHealthTuning()
        self._robot, self._dynamics, self.alarms = robot, dynamics, alarms
        self.intake: Intake = intake_of(tuning, bandwidth=bandwidth, dt=dt)
        """Of every tick that is not paused; it says when a look is due."""
        self._matrix, (self._lower, self._upper) = thruster_matrix(robot), thrust_limits(robot)
        self.thrusters = ThrusterMonitor(
            self._matrix, self._lower, self._upper, tuning=tuning, bandwidth=bandwidth, period=self.intake.every * dt
        )
        self._before: np.ndarray | None = None
        self._gone = np.zeros(robot.n_joints)
        self.joints = JointMonitor(robot.limits.effort, tuning=tuning)
        self._dt, self._joints = dt, robot.joint_v
        self._paused = False
        self._balance = Balance(tuning.judged_after)
        self.authority: Authority | None = None
        """What thrusters can still reach; `None` while all are sound, and until that is judged."""
        self._told = self._telemetry()

    @property
    def effect(self) -> Effect:
        """What thrusters make of their commands, by the verdicts."""
        return self.thrusters.effect

    @property
    def can_go_on(self) -> bool:
        """Whether what is left is enough for a mission."""
        return self.authority is None or self.authority.can_go_on

    @property
    def faulty(self) -> str:
        """All that is faulty, in a few words; nothing where nothing is."""
        return ", ".join((*thrusters_named(self.thrusters.verdicts), *joints_named(self.joints.verdicts)))

    def pause(self) -> None:
        """What is measured is not to be trusted."""
        if not self._paused:
            self._paused = True
            self.thrusters.pause()
            self.joints.pause()
            self._balance.clear()

    def look(self, seen: Look, t: float) -> bool:
        """At time t [s]; whether anything was found faulty."""
        self._paused = False
        n, way = self._robot.n_vehicle, seen.way[self._joints] * self._dt
        if not seen.joints_known:
            self.joints.pause()
        gone = self._gone_by(seen.q)
        jammed = self.joints.look(way, gone, seen.residual[n:], t) if seen.joints_known else ()
        suspect = self.thrusters.suspect
        faulty = self.thrusters.look(seen.residual[:n], seen.asked, t)
        for j in jammed:
            self.alarms.append((t, joint_alarm(j + 1, self._robot.joint_names[j])))
        for i in faulty:
            name = self._robot.description.thrusters[i].name
            self.alarms.append((t, thruster_alarm(i + 1, name, self.thrusters.verdicts[i])))
        self._judge(seen, faulty, t)
        found = bool(faulty or jammed)
        if found or self.thrusters.suspect != suspect:
            self._told = self._telemetry()
        return found

    def _gone_by(self, q: np.ndarray) -> np.ndarray:
        """(n_joints,) [rad or m] that the joints went until q (n_q,) [m, rad]; some turn without end, and are no numbers."""
        if self._before is not None:
            self._gone = self._gone + pin.difference(self._robot.model, self._before, q)[self._joints]
        self._before = q.copy()
        return self._gone

    def telemetry(self) -> dict[str, Any]:
        """For the record: shares (n_thrusters,) [-], constants (n_thrusters,) [N], verdicts as whole numbers."""
        return self._told

    def _telemetry(self) -> dict[str, Any]:
        return {
            "thruster_share": self.effect.share,
            "thruster_constant": self.effect.constant,
            "thruster_health": np.array([verdict.health for verdict in self.thrusters.verdicts], dtype=np.int8),
            "joint_health": np.array([verdict.health for verdict in self.joints.verdicts], dtype=np.int8),
        }

    def _judge(self, seen: Look, faulty: tuple[int, ...], t: float) -> None:
        """What is left of the thrusters, once the robot has settled after a verdict."""
        if faulty:
            self._balance.begin(t)
            return
        if not self._balance.runs:
            return
        rest = np.zeros(self._robot.n_v)
        weight = self._dynamics.inverse_dynamics(seen.q, rest, rest)[:6]
        mean = self._balance.take_in(weight - seen.disturbance[:6], t)
        if mean is None:
            return
        limits = (self._matrix, self._lower, self._upper)
        self.authority = authority_of(*limits, self.effect, mean, self._righting(seen.q))
        end = "" if self.authority.can_go_on else "; the mission cannot go on"
        self.alarms.append((t, f"without {self.faulty}: {self.authority}{end}"))

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
