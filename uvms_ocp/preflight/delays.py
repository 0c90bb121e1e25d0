"""Check: the loops bear what the sensors are late by, with the weight and buoyancy that they carry."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from uvms_ocp.control.force.velocity_law import OWN, dead_time_borne, dead_times
from uvms_ocp.model.dynamics import known_dynamics
from uvms_ocp.preflight.arm_reach import ArmReach
from uvms_ocp.preflight.findings import Finding, Severity
from uvms_ocp.preflight.forecast import Visit
from uvms_ocp.preflight.setup import Setup
from uvms_ocp.preflight.tool import goals_of
from uvms_ocp.tasks.pose import ToolPose, ToolPosition
from uvms_ocp.tasks.velocity import NullVelocity

CHECK = "delays"
_SPARE = 1.25  # by how much longer dead times the loops have to bear than those that are known
_STEP = 1e-5  # [m, rad] of the difference quotients


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Late:
    """Axes that are known late."""

    what: str
    axes: slice
    delay: float
    """[s]"""
    loop: Mapping[str, float]
    """Bandwidth and reset [1/s], observer [rad/s]."""


def check_delays(setup: Setup, visits: Sequence[Visit] = ()) -> Iterator[Finding]:
    """One finding at most: of the axes, and of the posture foreseen, that bear least of what they are late by.

    A DVL may be as late as it will: it tells of nothing that weight or buoyancy depends on.
    """
    late = [one for one in _late(setup) if one.delay > 0.0]
    if not (late and setup.with_forces) or "controller" in setup.own_parts:
        return
    own, stiffness = OWN * setup.dt, [(phase, _stiffness(setup, q)) for phase, q in _postures(setup, visits)]
    found = [(dead_time_borne(S[one.axes, one.axes], **one.loop), phase, one) for phase, S in stiffness for one in late]
    borne, phase, worst = min(found, key=lambda entry: entry[0] / (entry[2].delay + own))
    if worst.delay + own > borne / _SPARE:
        yield _finding(worst, phase, max(borne - own, 0.0), max(borne / _SPARE - own, 0.0))


def _finding(late: Late, phase: str, borne: float, allowed: float) -> Finding:
    text = (
        f"{late.what} {late.delay:.3g} s late, allowed {allowed:.2g} s: loops that carry the weight by where it was "
        f"swing from {borne:.2g} s on; take quicker ones, or a posture in better balance"
    )
    figures = {"delay_s": late.delay, "allowed_s": allowed, "swings_from_s": borne}
    severity = Severity.ERROR if late.delay > borne else Severity.WARNING
    return Finding(severity=severity, check=CHECK, phase=phase, text=text, figures=figures)


def _late(setup: Setup) -> Iterator[Late]:
    """Where both are late, what is between them is known to neither."""
    times, robot, gains = dead_times(setup.sensors), setup.robot, setup.gains
    observer = (gains.observer_joints or gains.observer_vehicle) if gains.observer_vehicle else 0.0
    joints = {"bandwidth": gains.joints, "reset": gains.joints_reset, "observer": observer}
    vehicle = {"bandwidth": gains.vehicle, "reset": gains.vehicle_reset, "observer": gains.observer_vehicle}
    if robot.n_joints:
        yield Late(what="encoders are", axes=robot.joint_v, delay=times.joints, loop=joints)
    if robot.n_vehicle:
        yield Late(what="gyro and attitude are", axes=robot.vehicle_v, delay=times.turning, loop=vehicle)
    if robot.n_joints and robot.n_vehicle:
        both = min(times.turning, times.joints)
        yield Late(what="attitude and encoders are", axes=slice(None), delay=both, loop=joints)


def _postures(setup: Setup, visits: Sequence[Visit]) -> Iterator[tuple[str, np.ndarray]]:
    """By phase, q (n_q,) [m, rad] at the start and wherever a tool has to reach from a vehicle that stands still."""
    yield "", setup.start
    joints = setup.start[setup.robot.joint_q]
    for visit in visits:
        task = visit.active(ToolPose) or visit.active(ToolPosition)
        if task is not None and visit.active(NullVelocity) is not None and setup.robot.n_joints == len(joints):
            arm = ArmReach(setup.robot, task.frame, rotation_weight=float(isinstance(task, ToolPose)))
            stance, goal = visit.stances[0], goals_of(setup, task.name, task.goal)[0]
            q, joints = stance.configuration(setup), arm.solve(stance.X_WB, goal, (joints,)).joints
            q[setup.robot.joint_q] = joints
            yield visit.phase.name, q


def _stiffness(setup: Setup, q: np.ndarray) -> np.ndarray:
    """(n_v, n_v) [1/s2] acceleration per displacement from q (n_q,) [m, rad] by which weight and buoyancy bring it back."""
    dynamics, model, still = known_dynamics(setup.robot), setup.robot.model, np.zeros(setup.robot.n_v)

    def force(step: np.ndarray) -> np.ndarray:
        return dynamics.inverse_dynamics(pin.integrate(model, q, step), still, still)

    slopes = [force(step) - force(-step) for step in _STEP * np.eye(setup.robot.n_v)]
    return np.linalg.solve(dynamics.mass_matrix(q), np.transpose(slopes) / (2 * _STEP))
