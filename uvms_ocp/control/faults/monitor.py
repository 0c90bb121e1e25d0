"""Report the health of thrusters and joints: verdicts, alarms and telemetry."""

from __future__ import annotations

import math
from typing import Any

import casadi as ca
import numpy as np

from uvms_ocp.codegen.kernel_layout import assign
from uvms_ocp.control.faults import authority, residual_filter, verdicts
from uvms_ocp.control.faults.detection import FaultDetection
from uvms_ocp.control.faults.fault_isolation import EARLY, FORCE_SCALE, LATE, MOMENT_SCALE
from uvms_ocp.control.faults.joint_faults import JAM_TRAVEL, JointFaultMemory
from uvms_ocp.control.faults.thruster_faults import ThrusterFaultMemory
from uvms_ocp.control.faults.tuning import ActuatorHealthTuning
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.size import joint_units
from uvms_ocp.robot.symbolic_dynamics import SymbolicDynamics
from uvms_ocp.robot.thrusters import thrust_limits, thruster_matrix


def detection_parts(
    robot: Robot, symbolic: SymbolicDynamics, tuning: ActuatorHealthTuning, period: float
) -> dict[str, Any]:
    """Return what `structure_of` a `FaultDetection` needs beside the dimensions of the robot; period
    [s] of its samples.
    """
    return {
        "n_looks": window_capacity(tuning, period),
        "program": authority.authority_program(len(robot.description.thrusters)),
        "weight": _weight_function(robot, symbolic),
        "joint_way": _joint_way_function(robot, symbolic),
    }


def window_capacity(tuning: ActuatorHealthTuning, period: float) -> int:
    """Return how many samples an `IsolationWindow` has room for; period [s] of them."""
    return 2 * _window_length(tuning, period) + LATE + EARLY


def write_detection(
    memory: FaultDetection,
    robot: Robot,
    tuning: ActuatorHealthTuning,
    residual_filter: residual_filter.ResidualFilter,
    *,
    bandwidth: float,
    dt: float,
) -> None:
    """Initialise a `FaultDetection`; bandwidth [rad/s] of the observer; dt [s] of a tick."""
    matrix = thruster_matrix(robot)
    limits = thrust_limits(robot)
    memory.dt = dt
    memory.n_vehicle = robot.n_vehicle
    memory.thruster = -1
    assign(memory.effectiveness, share=1.0)
    assign(memory.authority, matrix=matrix, lower=limits[0], upper=limits[1])
    write_thruster_watch(
        memory.thrusters,
        matrix,
        *limits,
        tuning=tuning,
        bandwidth=bandwidth,
        period=residual_filter.every * dt,
    )
    write_joint_watch(memory.joints, robot.limits.effort, JAM_TRAVEL * joint_units(robot))


def write_thruster_watch(
    watch: ThrusterFaultMemory,
    matrix: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    *,
    tuning: ActuatorHealthTuning,
    bandwidth: float,
    period: float,
) -> None:
    """Initialise a `ThrusterFaultMemory` of sound thrusters.

    matrix (6, n) [N/N, N m/N]; lower, upper (n,) [N] limits; bandwidth [rad/s] of the residual;
    period [s] of samples.
    """
    assign(
        watch,
        suspect=-1,
        last=-1,
        settling=tuning.settling,
        lower=lower,
        upper=upper,
        since=math.nan,
    )
    watch.fault_fit.bandwidth = bandwidth
    reach = np.abs(matrix) @ np.maximum(upper, -lower)
    scale = np.maximum(
        np.repeat([FORCE_SCALE, MOMENT_SCALE], 3) * reach, 1e-6 * (reach.max(initial=0.0) or 1.0)
    )
    directions = matrix / scale[:, None]
    assign(
        watch.window,
        directions=directions,
        square=np.sum(directions**2, axis=0),
        scale=scale,
        length=_window_length(tuning, period),
        least_explained=tuning.explained,
        least_lead=tuning.lead,
    )


def write_joint_watch(watch: JointFaultMemory, effort: np.ndarray, travel: np.ndarray) -> None:
    """Initialise a `JointFaultMemory` of sound joints; effort (n_joints,) [N m or N] limits, travel
    (n_joints,) [rad or m] that a jammed one is asked to go.
    """
    assign(watch, count=len(effort), effort=effort, travel=travel, since=math.inf)


def thruster_verdicts(
    watch: ThrusterFaultMemory, effectiveness: verdicts.ThrusterEffectiveness, n: int
) -> list[verdicts.ThrusterVerdict]:
    """Return the verdict of a `ThrusterFaultMemory` on each of n thrusters; effectiveness: in memory."""
    thruster_list = list[verdicts.ThrusterVerdict]()
    for i in range(n):
        verdict = verdicts.ThrusterVerdict(
            health=verdicts.ActuatorHealth(watch.health[i]),
            kind=verdicts.FaultKind(watch.kind[i]),
            share=effectiveness.share[i],
            constant=effectiveness.constant[i],
            confidence=watch.confidence[i],
            since=watch.since[i],
        )
        thruster_list.append(verdict)
    return thruster_list


def joint_verdicts(watch: JointFaultMemory) -> list[verdicts.JointVerdict]:
    """Return the verdict of a `JointFaultMemory` on each joint."""
    joint_list = [verdicts.JointVerdict()] * watch.count
    for j in range(watch.count):
        if watch.jammed[j]:
            joint_list[j] = verdicts.JointVerdict(
                health=verdicts.ActuatorHealth.FAULTY,
                kind=verdicts.FaultKind.JAMMED,
                since=watch.since[j],
            )
    return joint_list


def _window_length(tuning: ActuatorHealthTuning, period: float) -> int:
    return max(round(tuning.window / period), 4)


def _weight_function(robot: Robot, symbolic: SymbolicDynamics) -> ca.Function:
    q = ca.SX.sym("q", robot.n_q)
    at_rest = ca.SX(robot.n_v, 1)
    still = ca.SX(3, len(symbolic.links))
    tau = symbolic.inverse_dynamics(q, at_rest, at_rest, still, still)
    n = robot.n_vehicle
    wrench = ca.cse(ca.densify(ca.vertcat(tau[:n, :], ca.SX.zeros(6 - n))))
    return ca.Function("weight", [q], [wrench], ["q"], ["wrench"])


def _joint_way_function(robot: Robot, symbolic: SymbolicDynamics) -> ca.Function:
    before = ca.SX.sym("before", robot.n_q)
    q = ca.SX.sym("q", robot.n_q)
    way = ca.densify(symbolic.symbolic.difference(before, q)[robot.n_vehicle :])
    return ca.Function("joint_way", [before, q], [ca.cse(way)], ["before", "q"], ["way"])


class ActuatorMonitor:
    """Report the verdicts of a `FaultDetection`, and log alarms."""

    def __init__(
        self, robot: Robot, memory: FaultDetection, alarms: list[tuple[float, str]]
    ) -> None:
        """memory: the `FaultDetection`; alarms: time [s] and text of each, appended to."""
        self._robot = robot
        self._memory = memory
        self.alarms = alarms
        self.thrusters: list[verdicts.ThrusterVerdict] = []
        """Verdict on each thruster."""
        self.joints: list[verdicts.JointVerdict] = []
        """Verdict on each joint."""
        self.authority: authority.Authority | None = None
        """Remaining control authority; `None` while all are sound, and until it is computed."""
        self._telemetry: dict[str, Any] = {}
        self._refresh()

    @property
    def faulty(self) -> str:
        """Faulty thrusters and joints, in a few words, such as ``thruster3 dead, joint2 jammed``;
        empty where all are sound.
        """
        faults = list[str]()
        for k, thruster in enumerate(self.thrusters, start=1):
            if thruster.kind:
                faults.append(f"thruster{k} {thruster.kind.word}")
        for k, joint in enumerate(self.joints, start=1):
            if joint.kind:
                faults.append(f"joint{k} {joint.kind.word}")
        return ", ".join(faults)

    def update(self, t: float) -> None:
        """Take over what detection at time t [s] has changed, and log alarms."""
        self._refresh()
        names = self._robot.joint_of_axis
        thrusters = self._robot.description.thrusters
        i = self._memory.thruster
        for j in range(len(self.joints)):
            if self._memory.joints.found[j]:
                jammed = f"joint{j + 1} jammed ({names[j]})"
                finding = "pushed, and does not move; the others do without it"
                self.alarms.append((t, f"{jammed}: {finding}"))
        if i >= 0:
            alarm = verdicts.thruster_alarm(i + 1, thrusters[i].name, self.thrusters[i])
            self.alarms.append((t, alarm))
        if self._memory.judgement:
            self.authority = authority.authority_in(self._memory.authority)
            end = "" if self.authority.can_go_on else "; the mission cannot go on"
            self.alarms.append((t, f"without {self.faulty}: {self.authority}{end}"))

    def telemetry(self) -> dict[str, Any]:
        """Return series for the record: shares (n_thrusters,), constants (n_thrusters,) [N],
        verdicts as whole numbers.
        """
        return self._telemetry

    def _refresh(self) -> None:
        memory = self._memory
        n = len(self._robot.description.thrusters)
        self.thrusters = thruster_verdicts(memory.thrusters, memory.effectiveness, n)
        self.joints = joint_verdicts(memory.joints)
        thruster_health = [verdict.health for verdict in self.thrusters]
        joint_health = [verdict.health for verdict in self.joints]
        self._telemetry = {
            "thruster_share": np.array(memory.effectiveness.share[:n]),
            "thruster_constant": np.array(memory.effectiveness.constant[:n]),
            "thruster_health": np.array(thruster_health, dtype=np.int8),
            "joint_health": np.array(joint_health, dtype=np.int8),
        }
