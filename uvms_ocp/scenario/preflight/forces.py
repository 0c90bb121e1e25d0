"""Check that thrusters and motors can hold the robot still, how far it tilts where they cannot, and
whether its load can be learnt.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.control.force.allocation import Allocation, AllocationResult, allocation_of
from uvms_ocp.control.payload import require_learnable
from uvms_ocp.errors import UvmsError
from uvms_ocp.robot.dynamics import Dynamics, robot_dynamics
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.size import size
from uvms_ocp.robot.static_balance import rotation_at_rest, tilt_when_driven
from uvms_ocp.robot.thrusters import (
    AXES,
    largest_force,
    unactuated_axes,
    without_free_motions,
)
from uvms_ocp.scenario.preflight.findings import Finding, Severity
from uvms_ocp.scenario.preflight.phase_forecast import Visit, threshold_of
from uvms_ocp.scenario.preflight.robot_check import LARGEST_TILT, tilt_text
from uvms_ocp.scenario.preflight.setup import Setup
from uvms_ocp.sim.currents import water_at
from uvms_ocp.tasks import attitude
from uvms_ocp.tasks.pose import VehiclePose

FORCES = "forces"
CURRENT_TIMES = np.linspace(0.0, 120.0, 9)
"""Times (9,) [s] at which a current that varies is sampled."""

_FULL = 0.8  # share of a limit above which holding still is called tight
_TILTED = 0.1  # [rad] that is worth a warning where no task asks for a level vehicle
_NEGLIGIBLE_SHARE = 1e-4
"""Share of the largest force that thrusters give along an axis, below which none is missing."""
# speeds at which drag may make up for a missing force: shares of the root of gravity times the robot's size,
# and over it, such as 5 mm/s and mrad/s for 15 kg, which is 0.3 m in a minute
_NEGLIGIBLE_SPEED = 3.2e-3
_NEGLIGIBLE_RATE = 8e-4


def check_forces(setup: Setup, visits: Sequence[Visit]) -> Iterator[Finding]:
    """Check that thrusters and motors can hold the robot still in the current, and move it against
    that as fast as the way point task asks.

    The finding is of the phase with the largest load. A current on a plant without water is a
    finding of its own.
    """
    if not setup.with_forces:
        yield from _check_ignored_current(setup)
        return
    if not setup.robot.description.thrusters:
        return
    dynamics = robot_dynamics(setup.robot)
    loads = [_hold(setup, dynamics, visit) for visit in visits]
    worst = max(range(len(visits)), key=lambda k: (loads[k].missing, loads[k].thrust))
    yield _force_finding(setup.robot, visits[worst], loads[worst])
    for visit, load in zip(visits, loads, strict=True):
        task = visit.active(VehiclePose)
        if task is None or load.is_short:
            continue
        speed = min(float(setup.robot.limits.velocity[:3].min()), task.saturation_linear)
        moving = _hold(setup, dynamics, visit, speed=speed)
        if moving.is_short:
            text = (
                f"thrust is short by {moving.missing:.2g} N against the current at full speed: the"
                " approach is slower"
            )
            yield Severity.WARNING.finding(FORCES, text, visit.phase.name)


def _check_ignored_current(setup: Setup) -> Iterator[Finding]:
    place = setup.start[None, :3]
    current = setup.environment.current
    speed = max(float(np.linalg.norm(current.velocity(place, t))) for t in CURRENT_TIMES)
    if speed > 0:
        text = f"the kinematic plant ignores the current of {speed:.2g} m/s; use the dynamic plant"
        yield Severity.WARNING.finding(FORCES, text, current_m_s=speed)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class DriveLoad:
    """Load of holding one stance on thrusters and motors."""

    thrust: float
    """Largest thrust as a share of its limit; above 1 the thruster cannot give it."""
    torque: float
    """Largest torque of a joint as a share of its limit; above 1 its motor cannot give it."""
    missing: float
    """[N] norm of the part of the wrench that is missing, of moments over the robot's size."""
    is_short: bool
    """True where along some axis more than `_NEGLIGIBLE_SHARE` is missing."""
    axes: str
    """Description of what is missing on each axis."""
    drifts: bool
    """True where drag makes up for what is missing only at more than `_negligible_velocity`."""


def _force_finding(robot: Robot, visit: Visit, load: DriveLoad) -> Finding:
    figures = {"thrust_share": load.thrust, "torque_share": load.torque, "missing_N": load.missing}
    thrust = f"{100 * load.thrust:.0f} % of the thrust"
    if load.is_short:
        thrust = f"{load.axes} more than the thrusters give"
    text = f"to hold still takes {thrust} and {100 * load.torque:.0f} % of the joint torque"
    if not load.is_short and load.torque <= 1.0:
        is_tight = max(load.thrust, load.torque) > _FULL
        severity = Severity.WARNING if is_tight else Severity.NOTE
        return severity.finding(FORCES, text, visit.phase.name, **figures)
    if load.drifts or load.torque > 1.0:
        text += "; wait for less current, trim the robot, or take a stronger one"
    else:
        speed, *_, rate = 1e3 * _negligible_velocity(robot)
        text += (
            f"; the vehicle gives way by at most {speed:.1g} mm/s or {rate:.1g} mrad/s,"
            " until its drag makes up for that"
        )
    is_error = load.drifts or load.torque > 1.0
    severity = Severity.ERROR if is_error else Severity.WARNING
    return severity.finding(FORCES, text, visit.phase.name, **figures)


def _hold(setup: Setup, dynamics: Dynamics, visit: Visit, speed: float = 0.0) -> DriveLoad:
    """Return the largest load over the times of the current.

    speed: [m/s] over ground, against the current.
    """
    q = visit.stances[0].configuration(setup)
    # What is refused is refused before anything is compiled.
    allocation = allocation_of(setup.robot, compiled=False)
    at_rest = np.zeros(setup.robot.n_v)
    times = dict[bytes, float]()  # by the force at rest: a single time in a steady current
    for t in CURRENT_TIMES:
        times[_forces(setup, dynamics, q, t, speed, at_rest).tobytes()] = t
    loads = []
    for t in times.values():
        forces = partial(_forces, setup, dynamics, q, t, speed)
        loads.append(_load(setup, allocation, forces))
    return max(loads, key=lambda load: (load.missing, load.thrust))


def _forces(
    setup: Setup, dynamics: Dynamics, q: np.ndarray, t: float, speed: float, v: np.ndarray
) -> np.ndarray:
    """Return the generalized force (n_v,) [N, N m] that the controller asks for at a steady
    velocity (n_v,) over ground, in water that is faster by `speed` [m/s].
    """
    water = water_at(setup.environment.current, dynamics.link_positions(q), t)
    water_speed = np.linalg.norm(water.velocity, axis=1, keepdims=True)
    factor = 1.0 + speed / np.maximum(water_speed, 1e-9)
    faster_water = replace(water, velocity=water.velocity * factor)
    tau = dynamics.inverse_dynamics(q, v, np.zeros(setup.robot.n_v), faster_water)
    M = ca.DM(dynamics.mass_matrix(q))
    return np.array(without_free_motions(setup.robot, M, ca.DM(tau))).ravel()


def _load(
    setup: Setup, allocation: Allocation, forces: Callable[[np.ndarray], np.ndarray]
) -> DriveLoad:
    """Return the load of holding still.

    forces: gives the generalized force (n_v,) [N, N m] of a velocity (n_v,) [m/s, rad/s].
    """
    robot = setup.robot
    v = np.zeros(robot.n_v)
    tau = forces(v)
    result = allocation.allocate(tau[robot.vehicle_v])
    thruster_limits = [thruster.largest_thrust for thruster in robot.description.thrusters]
    thrust_shares = np.abs(result.thrust) / np.array(thruster_limits)
    torque_shares = np.abs(tau[robot.joint_v]) / robot.limits.effort
    lack = _missing_wrench(robot, result)
    missing_forces = lack / np.repeat([1.0, size(robot.model)], 3)  # [N]
    missing = float(np.linalg.norm(missing_forces))
    short_axes = _short_axes(robot, lack)
    drifts = False
    if short_axes:
        v[robot.vehicle_v] = -_negligible_velocity(robot) * missing_forces / missing
        moving = allocation.allocate(forces(v)[robot.vehicle_v])
        drifts = bool(_short_axes(robot, _missing_wrench(robot, moving)))
    return DriveLoad(
        thrust=float(np.max(thrust_shares)),
        torque=float(np.max(torque_shares, initial=0.0)),
        missing=missing,
        is_short=bool(short_axes),
        axes=", ".join(_axis_text(axis, lack[axis]) for axis in short_axes),
        drifts=drifts,
    )


def _negligible_velocity(robot: Robot) -> np.ndarray:
    """Return the velocity (6,) [m/s, rad/s] by which a vehicle may give way along each axis."""
    gravity = np.linalg.norm(robot.model.gravity.linear)
    length = size(robot.model)
    speed = _NEGLIGIBLE_SPEED * np.sqrt(gravity * length)
    rate = _NEGLIGIBLE_RATE * np.sqrt(gravity / length)
    return np.repeat([speed, rate], 3)


def _missing_wrench(robot: Robot, result: AllocationResult) -> np.ndarray:
    """Return the wrench (6,) [N, N m] that thrusters at their limits do not give along the axes
    that they drive.
    """
    lack = np.zeros(6)
    if result.saturated:
        driven = [axis for axis in range(6) if axis not in unactuated_axes(robot)]
        lack[driven] = result.unreachable[driven]
    return lack


def _short_axes(robot: Robot, lack: np.ndarray) -> list[int]:
    """Return the axes along which what is missing, lack (6,) [N, N m], is more than negligible."""
    negligible = _NEGLIGIBLE_SHARE * largest_force(robot)[:6]
    return np.flatnonzero(np.abs(lack) > negligible).tolist()


def _axis_text(axis: int, lack: float) -> str:
    force = abs(lack)
    size = f"{force:.0f}" if force >= 1.0 else f"{force:.1g}"
    unit = "N" if axis < 3 else "N m"
    return f"{size} {unit} of {AXES[axis]}"


def check_rest(setup: Setup, visits: Sequence[Visit]) -> Iterator[Finding]:
    """Check the attitude in which weight and buoyancy leave the vehicle, with the arm as at the
    start, and how far thrust at its limits tilts it.

    An error where a phase waits for less tilt than that.
    """
    if not (setup.with_forces and setup.robot.description.thrusters):
        return
    driven_tilt = tilt_when_driven(setup.robot)
    if driven_tilt is not None and driven_tilt.angle > LARGEST_TILT:
        yield Severity.WARNING.finding(
            "attitude under thrust", tilt_text(driven_tilt), tilt_rad=driven_tilt.angle
        )
    R_WB = rotation_at_rest(setup.robot, setup.start)
    tilt = np.arccos(np.clip(R_WB[2, 2], -1.0, 1.0))
    roll, pitch, _ = pin.rpy.matrixToRpy(R_WB)
    missed = []  # phases whose task to be level is given up at this tilt, with the task
    waiting = []  # those of them that wait for less tilt
    for visit in visits:
        task = visit.active(attitude.HorizontalAttitude)
        if task is None or tilt <= task.activation.end:
            continue
        missed.append((visit.phase, task))
        limit = threshold_of(visit.phase, f"{task.name}.tilt")
        if limit and limit < tilt:
            waiting.append((visit.phase, task))
    if not missed and tilt <= _TILTED:
        return
    text = (
        "where no thruster drives it the vehicle will rest at"
        f" roll {np.rad2deg(roll):.0f} deg, pitch {np.rad2deg(pitch):.0f} deg"
    )
    phase_name = ""
    if missed:
        phase, task = (waiting or missed)[0]
        phase_name = phase.name
        text += f": {task.name} is on, and its goal, a tilt of {task.aim:.2g} rad, is missed"
    text += "; trim the robot (`check-robot` tells by what)"
    severity = Severity.ERROR if waiting else Severity.WARNING
    figures = {"roll_rad": float(roll), "pitch_rad": float(pitch), "tilt_rad": float(tilt)}
    yield severity.finding("attitude at rest", text, phase_name, **figures)


def check_load(setup: Setup) -> Iterator[Finding]:
    """Check a load that is to be learnt: an error where our controller would refuse, and what comes
    of it elsewhere.
    """
    if setup.load_bandwidth is None:
        return
    severity = Severity.WARNING
    if not setup.with_forces:
        text = "the kinematic plant carries no load, and none is learnt; use the dynamic plant"
    elif "controller" in setup.own_parts:
        text = "a controller of your own learns no load by itself; the toolkit's does"
    else:
        severity = Severity.NOTE
        text = (
            "the load at the tool is learnt: its net weight from forces, its mass once the tool"
            " accelerates"
        )
        try:
            require_learnable(setup.robot, observed=bool(setup.load_bandwidth))
        except UvmsError as error:
            severity = Severity.ERROR
            text = str(error)
    yield severity.finding("load", text)
