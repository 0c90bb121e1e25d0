"""Check thrust, torque and attitude at rest, delays that the loops can bear, and whether the load
can be learnt.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pinocchio as pin

from uvms_ocp.control.force.allocation import Allocation, allocation_of
from uvms_ocp.control.force.velocity_law import CONTROLLER_DEAD_TIME, dead_times, largest_dead_time
from uvms_ocp.control.payload import require_learnable
from uvms_ocp.errors import UvmsError
from uvms_ocp.robot.dynamics import Dynamics, cached_dynamics, robot_dynamics
from uvms_ocp.robot.static_balance import rotation_at_rest, static_residual
from uvms_ocp.robot.thrusters import (
    AXES,
    driven_turns,
    free_motions,
    unactuated_axes,
    undriven_axes,
)
from uvms_ocp.scenario.preflight.reachability import ArmReach, goals_of
from uvms_ocp.scenario.preflight.setup import Finding, Setup, Severity, Visit, threshold_of
from uvms_ocp.sim.currents import water_at
from uvms_ocp.tasks import attitude, goals
from uvms_ocp.tasks.pose import NullVelocity, PoseTask, ToolPose, ToolPosition, VehiclePose

# Checks: thrusters and motors can hold the robot still in the current and move it against that, and
# where they cannot hold its attitude, how far it will tilt.

FORCES = "forces"
_TIMES = np.linspace(0.0, 120.0, 9)  # [s] at which a current that varies is sampled
_FULL = 0.8  # share of a limit above which holding still is called tight
_TILTED = 0.1  # [rad] that is worth a word where no task asks for a level vehicle
_SHORT = 1e-3  # [N, N m] of force missing that counts
# [m/s, rad/s] at which drag makes up for what is missing, and which is not worth a refusal: 0.3 m
# in a minute
_GIVES_WAY = 5e-3
_UNDRIVEN = "axes without thrust"
# axes of the vehicle: up, how many are lengths, and the heading
_SWAY = 1
_HEAVE = 2
_LINEAR = 3
_YAW = 5
_ASKEW = 0.4  # [rad] of another rotation that a free one takes along
_WHERE = ("ahead of or behind", "beside", "above or below")
_ADRIFT = 0.5  # [N] out of trim: against a drag of 100 N/(m/s) 0.3 m in a minute

DELAYS = "delays"
_SPARE = 1.25  # by how much longer dead times the loops have to bear than those that are known
_STEP = 1e-5  # [m, rad] of the difference quotients

_CHECK = "load"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class DriveLoad:
    """Load of one stance on the drives."""

    thrust: float
    """Largest share of a limit; above 1 the force is not there."""
    torque: float
    """Largest share of a limit; above 1 the torque is not there."""
    missing: float
    """[N, N m] norm of the part of the wrench that is missing."""
    axes: str
    """Text that says what is missing on each axis."""
    drifts: bool
    """The vehicle gives way faster than `_GIVES_WAY` until its drag makes up for it."""


def check_forces(setup: Setup, visits: Sequence[Visit]) -> Iterator[Finding]:
    """The largest load over all phases of holding still, and of moving as fast as the way point
    task asks.

    A current on a plant without water is a finding of its own.
    """
    if not setup.with_forces:
        speed = max(
            float(np.linalg.norm(setup.environment.current.velocity(setup.start[None, :3], t)))
            for t in _TIMES
        )
        if speed > 0:
            text = (
                f"the kinematic plant ignores the current of {speed:.2g} m/s; use the dynamic plant"
            )
            yield Severity.WARNING.finding(FORCES, text, current_m_s=speed)
    if not (setup.with_forces and setup.robot.description.thrusters):
        return
    dynamics = robot_dynamics(setup.robot)
    still = [_hold(setup, dynamics, visit) for visit in visits]
    worst = max(range(len(visits)), key=lambda k: (still[k].missing, still[k].thrust))
    yield _force_finding(visits[worst], still[worst])
    for visit, load in zip(visits, still, strict=True):
        task = visit.active(VehiclePose)
        if task is None or load.missing > _SHORT:
            continue
        speed = min(float(setup.robot.limits.velocity[:3].min()), task.saturation_linear)
        short = _hold(setup, dynamics, visit, speed=speed).missing
        if short > _SHORT:
            text = (
                f"thrust is short by {short:.2g} N against the current at full speed: the approach"
                " is slower"
            )
            yield Severity.WARNING.finding(FORCES, text, visit.phase.name)


def _force_finding(visit: Visit, load: DriveLoad) -> Finding:
    figures = {"thrust_share": load.thrust, "torque_share": load.torque, "missing_N": load.missing}
    if load.missing > _SHORT or load.torque > 1.0:
        excess = f"{load.axes or 'nothing'} more than the thrusters give"
        text = f"to hold still takes {excess} and {100 * load.torque:.0f} % of the joint torque"
        slowly = (
            f"; the vehicle gives way by at most {1e3 * _GIVES_WAY:.0f} mm/s or mrad/s, until its"
            " drag makes up for that"
        )
        text += (
            "; wait for less current, trim the robot, or take a stronger one"
            if load.drifts
            else slowly
        )
        if load.drifts or load.torque > 1.0:
            severity = Severity.ERROR
        else:
            severity = Severity.WARNING
    else:
        text = (
            f"to hold still takes {100 * load.thrust:.0f} % of the thrust and"
            f" {100 * load.torque:.0f} % of the joint torque"
        )
        severity = Severity.WARNING if max(load.thrust, load.torque) > _FULL else Severity.NOTE
    return severity.finding(FORCES, text, visit.phase.name, **figures)


def _hold(setup: Setup, dynamics: Dynamics, visit: Visit, speed: float = 0.0) -> DriveLoad:
    """The largest load over the times; `speed` [m/s] is over ground, against the current."""
    q = visit.stances[0].configuration(setup)
    allocation = allocation_of(
        setup.robot, compiled=False
    )  # what is refused is refused before anything is compiled
    still = np.zeros(setup.robot.n_v)
    times = {
        _forces(setup, dynamics, q, t, speed, still).tobytes(): t for t in _TIMES
    }.values()  # one in a steady current
    loads = [
        _load(setup, allocation, partial(_forces, setup, dynamics, q, t, speed)) for t in times
    ]
    return max(loads, key=lambda load: (load.missing, load.thrust))


def _forces(
    setup: Setup, dynamics: Dynamics, q: np.ndarray, t: float, speed: float, v: np.ndarray
) -> np.ndarray:
    """Generalized force (n_v,) at a steady velocity (n_v,) over ground, in water that is faster by
    `speed`.
    """
    water = water_at(setup.environment.current, dynamics.link_positions(q), t)
    size = np.linalg.norm(water.velocity, axis=1, keepdims=True)
    faster = replace(water, velocity=water.velocity * (1.0 + speed / np.maximum(size, 1e-9)))
    return dynamics.inverse_dynamics(q, v, np.zeros(setup.robot.n_v), faster)


def _load(
    setup: Setup, allocation: Allocation, forces: Callable[[np.ndarray], np.ndarray]
) -> DriveLoad:
    """Load of holding still; forces (n_v,) [N, N m] are those of a velocity (n_v,) [m/s, rad/s]."""
    robot = setup.robot
    v = np.zeros(setup.robot.n_v)
    tau = forces(v)
    result = allocation.allocate(tau[robot.vehicle_v])
    actuated = [axis for axis in range(6) if axis not in unactuated_axes(robot)]
    if result.saturated:
        missing = float(np.linalg.norm(result.unreachable[actuated]))
    else:
        missing = 0.0
    v[actuated] = -_GIVES_WAY * result.unreachable[actuated] / max(missing, 1e-9)
    if missing > _SHORT:
        remainder = allocation.allocate(forces(v)[robot.vehicle_v]).unreachable
    else:
        remainder = result.unreachable
    if result.saturated:
        shares = [(abs(result.unreachable[k]), k) for k in actuated]
    else:
        shares = []
    short = [
        (f"{force:.0f}" if force >= 1.0 else f"{force:.1g}", k)
        for force, k in shares
        if force > _SHORT
    ]
    axes = [f"{force} N{' m' if k >= _LINEAR else ''} of {AXES[k]}" for force, k in short]
    limits = np.array(
        [max(thruster.maximum, -thruster.minimum) for thruster in robot.description.thrusters]
    )
    return DriveLoad(
        thrust=float(np.max(np.abs(result.thrust) / limits)),
        torque=float(np.max(np.abs(tau[robot.joint_v]) / robot.limits.effort, initial=0.0)),
        missing=missing,
        axes=", ".join(axes),
        drifts=missing > _SHORT and bool(np.linalg.norm(remainder[actuated]) > _SHORT),
    )


def check_depth(setup: Setup, visits: Sequence[Visit]) -> Iterator[Finding]:
    """Errors where nothing moves the vehicle along an axis: it keeps its place there, or, out of
    trim, does not.
    """
    still = [axis for axis in unactuated_axes(setup.robot) if axis < _LINEAR]
    if not (setup.with_forces and setup.robot.description.thrusters and still):
        return
    lift, _ = static_residual(setup.robot, setup.start)
    if _HEAVE in still and abs(lift) > _ADRIFT:
        text = (
            f"the vehicle is {abs(lift):.2g} N too {'light' if lift > 0 else 'heavy'}, and no"
            " thruster holds its depth"
        )
        yield Severity.ERROR.finding(FORCES, f"{text}: trim it", lift_N=lift)
    for visit, begin in zip(
        visits,
        [setup.start[:_LINEAR], *(visit.stances[0].position for visit in visits)],
        strict=False,
    ):
        task = visit.active(VehiclePose)
        if task is None:
            limit = None
        else:
            limit = threshold_of(visit.phase, f"{task.name}.position_error")
        if task is None or limit is None:
            continue
        goal = goals_of(setup, task.name, task.goal)[-1]
        alignment = visit.active(attitude.Alignment)
        bow = goal.rotation
        if alignment is not None:  # which turns it there
            x, y, _ = goals.evaluate_vector(alignment.name, alignment.goal, 0.0)[0] - begin
            bow = pin.rpy.rpyToMatrix(0.0, 0.0, float(np.arctan2(y, x)))
        ways = np.abs(bow.T @ (goal.translation - begin))
        axis = max(still, key=lambda axis: ways[axis])
        flow = np.array(
            [setup.environment.current.velocity(goal.translation[None], t)[0] for t in _TIMES]
        )
        speed = min(float(setup.robot.limits.velocity[:_LINEAR].max()), task.saturation_linear)
        adrift = np.abs(flow @ bow).max(axis=0) * float(np.linalg.norm(ways)) / speed
        adrift[_SWAY] *= alignment is None  # it keeps its bow on the goal meanwhile
        carried = max(still, key=lambda axis: adrift[axis])
        if adrift[carried] > limit:
            way = f"{adrift[carried]:.2f} m along {AXES[carried]}, and no thruster drives that"
            cure = (
                "turn its bow there with an Alignment"
                if carried == _SWAY
                else "wait for less of it"
            )
            text = f"the current carries the vehicle {way}, until {task.name} is there; {cure}"
            yield Severity.ERROR.finding(
                FORCES, text, visit.phase.name, adrift_m=float(adrift[carried])
            )
        if ways[axis] > limit:
            text = (
                f"{task.name} waits for a goal {ways[axis]:.2f} m {_WHERE[axis]} where the vehicle"
                " is then"
            )
            text += (
                f", and no thruster drives {AXES[axis]}; give it thrust there, or goals where the"
                " other axes lead"
            )
            yield Severity.ERROR.finding(FORCES, text, visit.phase.name, way_m=float(ways[axis]))


def check_undriven(setup: Setup, visits: Sequence[Visit]) -> Iterator[Finding]:
    """Tell once which axes no thruster drives, and which tasks ask for less for it; an error where
    a phase waits for nothing.
    """
    undriven = undriven_axes(setup.robot)
    turns = ", ".join(AXES[axis] for axis in undriven if axis >= 3)
    less: dict[str, None] = {}
    for visit in visits:
        for task in visit.tasks:
            if (
                not (turns and isinstance(task, attitude.AngleTask | PoseTask))
                or driven_turns(setup.robot, task.frame) is None
            ):
                continue
            if isinstance(task, attitude.AngleTask):
                directions = task.turning_directions(setup.robot)
            else:
                directions = None
            if directions is None or directions.shape[1]:
                less |= (
                    {task.name: None}
                    if isinstance(task, PoseTask) or directions is not None
                    else {}
                )
                continue
            awaited = any(
                threshold_of(visit.phase, f"{task.name}.{name}")
                for name in ("misalignment", "angle")
            )
            text = (
                f"{task.name} is on but left out: no thruster drives {turns}, and no other axis"
                f" turns {task.frame} to its goal"
            )
            yield (Severity.ERROR if awaited else Severity.WARNING).finding(
                _UNDRIVEN, f"{text}; switch it off", visit.phase.name
            )
    if less:
        text = (
            f"no thruster drives {', '.join(AXES[axis] for axis in undriven)}: {', '.join(less)}"
            " ask for the other axes alone"
        )
        yield Severity.NOTE.finding(_UNDRIVEN, text)
    for axis, motion in zip(undriven, free_motions(setup.robot)[0].T, strict=True):
        others = {AXES[k]: abs(float(motion[k])) for k in range(_LINEAR, 6) if k != axis}
        largest = max(others, key=lambda name: others[name])
        if (
            setup.with_forces
            and less
            and axis >= _LINEAR
            and (axis == _YAW or others[largest] > _ASKEW)
        ):
            why = (
                f"which takes {others[largest]:.1f} rad of {largest} along for each of its own:"
                " they are no two axes"
            )
            why = "and nothing rights it: the vehicle turns as it likes" if axis == _YAW else why
            text = (
                f"no thruster drives {AXES[axis]}, {why}; place thrusters elsewhere, or give it"
                " more of them"
            )
            yield Severity.ERROR.finding(_UNDRIVEN, text)


def check_rest(setup: Setup, visits: Sequence[Visit]) -> Iterator[Finding]:
    """The attitude in which weight and buoyancy leave the vehicle, with the arm as at the start.

    An error where a phase waits for less tilt than that.
    """
    if not (setup.with_forces and setup.robot.description.thrusters):
        return
    R = rotation_at_rest(setup.robot, setup.start)
    tilt = np.arccos(np.clip(R[2, 2], -1.0, 1.0))
    (roll, pitch, _) = pin.rpy.matrixToRpy(R)
    on = [
        (visit.phase, task)
        for visit in visits
        if (task := visit.active(attitude.HorizontalAttitude)) is not None
    ]
    missed = [
        (phase, task) for phase, task in on if tilt > task.activation.end
    ]  # in which it lets the vehicle be
    waiting = [
        (phase, task)
        for phase, task in missed
        if (threshold_of(phase, f"{task.name}.tilt") or np.inf) < tilt
    ]
    text = f"will rest at roll {np.rad2deg(roll):.0f} deg, pitch {np.rad2deg(pitch):.0f} deg"
    name = ""
    for phase, task in (waiting or missed)[:1]:
        text = f"{text}: {task.name} is on, and its goal, a tilt of {task.aim:.2g} rad, is missed"
        name = phase.name
    if missed or tilt > _TILTED:
        text = (
            f"where no thruster drives it the vehicle {text}; trim the robot (`check-robot` tells"
            " by what)"
        )
        figures = {"roll_rad": float(roll), "pitch_rad": float(pitch), "tilt_rad": float(tilt)}
        yield (Severity.ERROR if waiting else Severity.WARNING).finding(
            "attitude at rest", text, name, **figures
        )


# Check: the loops bear what the sensors are late by, with the weight and buoyancy that they carry.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class DelayedAxes:
    """Axes that are known late."""

    what: str
    axes: slice
    delay: float
    """[s]"""
    loop: Mapping[str, float]
    """Bandwidth and reset [1/s], observer [rad/s]."""


def check_delays(setup: Setup, visits: Sequence[Visit] = ()) -> Iterator[Finding]:
    """One finding at most: of the axes, and of the posture foreseen, that bear least of what they
    are late by.

    A DVL may be as late as it will: it tells of nothing that weight or buoyancy depends on.
    """
    late = [source for source in _late(setup) if source.delay > 0.0]
    if not (late and setup.with_forces) or "controller" in setup.own_parts:
        return
    controller_delay = CONTROLLER_DEAD_TIME * setup.dt
    stiffness = [(phase, _stiffness(setup, q)) for phase, q in _postures(setup, visits)]
    bounds = [
        (largest_dead_time(S[source.axes, source.axes], **source.loop), phase, source)
        for phase, S in stiffness
        for source in late
    ]
    borne, phase, worst = min(
        bounds, key=lambda entry: entry[0] / (entry[2].delay + controller_delay)
    )
    if worst.delay + controller_delay > borne / _SPARE:
        bears = max(borne - controller_delay, 0.0)
        allowed = max(borne / _SPARE - controller_delay, 0.0)
        text = (
            f"{worst.what} {worst.delay:.3g} s late, allowed {allowed:.2g} s: loops that carry the"
            " weight by where it was"
        )
        text += f" swing from {bears:.2g} s on; take quicker ones, or a posture in better balance"
        figures = {"delay_s": worst.delay, "allowed_s": allowed, "swings_from_s": bears}
        yield (Severity.ERROR if worst.delay > bears else Severity.WARNING).finding(
            DELAYS, text, phase, **figures
        )


def _late(setup: Setup) -> Iterator[DelayedAxes]:
    """Give the axes on which both sensors and actuators are late: what is under way between them is
    known to neither.
    """
    times = dead_times(setup.sensors)
    robot = setup.robot
    gains = setup.gains
    observer = (gains.observer_joints or gains.observer_vehicle) if gains.observer_vehicle else 0.0
    joints = {"bandwidth": gains.joints, "reset": gains.joints_reset, "observer": observer}
    vehicle = {
        "bandwidth": gains.vehicle,
        "reset": gains.vehicle_reset,
        "observer": gains.observer_vehicle,
    }
    if robot.n_joints:
        yield DelayedAxes(what="encoders are", axes=robot.joint_v, delay=times.joints, loop=joints)
    if robot.n_vehicle:
        yield DelayedAxes(
            what="gyro and attitude are", axes=robot.vehicle_v, delay=times.turning, loop=vehicle
        )
    if robot.n_joints and robot.n_vehicle:
        yield DelayedAxes(
            what="attitude and encoders are",
            axes=slice(None),
            delay=min(times.turning, times.joints),
            loop=joints,
        )


def _postures(setup: Setup, visits: Sequence[Visit]) -> Iterator[tuple[str, np.ndarray]]:
    """Map phases to q (n_q,) [m, rad] at the start and wherever a tool has to reach from a vehicle
    that stands still.
    """
    yield "", setup.start
    joints = setup.robot.joint_values(setup.start)
    for visit in visits:
        task = visit.active(ToolPose) or visit.active(ToolPosition)
        if task is not None and visit.active(NullVelocity) is not None:
            arm = ArmReach.of_task(setup, task)
            stance = visit.stances[0]
            goal = goals_of(setup, task.name, task.goal)[0]
            joints = arm.solve(stance.X_WB, goal, (joints,)).joints
            yield (
                visit.phase.name,
                setup.robot.with_joint_values(stance.configuration(setup), joints),
            )


def _stiffness(setup: Setup, q: np.ndarray) -> np.ndarray:
    """(n_v, n_v) [1/s2] acceleration per displacement from q (n_q,) [m, rad] by which weight and
    buoyancy bring it back.
    """
    dynamics = cached_dynamics(setup.robot)
    model = setup.robot.model
    still = np.zeros(setup.robot.n_v)

    def force(step: np.ndarray) -> np.ndarray:
        return dynamics.inverse_dynamics(pin.integrate(model, q, step), still, still)

    slopes = [force(step) - force(-step) for step in _STEP * np.eye(setup.robot.n_v)]
    return np.linalg.solve(dynamics.mass_matrix(q), np.transpose(slopes) / (2 * _STEP))


# Check: what the tool carries can be learnt by this robot, on this plant.


def check_load(setup: Setup) -> Iterator[Finding]:
    """Check a load that is to be learnt: an error where our controller would refuse, and what comes
    of it elsewhere.
    """
    if setup.load_bandwidth is None:
        return
    learnt = (
        "the load at the tool is learnt: its net weight from forces, its mass once the tool"
        " accelerates"
    )
    severity = Severity.NOTE
    text = learnt
    if not setup.with_forces:
        severity = Severity.WARNING
        text = "the kinematic plant carries no load, and none is learnt; use the dynamic plant"
    elif "controller" in setup.own_parts:
        severity = Severity.WARNING
        text = "a controller of your own learns no load by itself; the toolkit's does"
    else:
        try:
            require_learnable(setup.robot, observed=bool(setup.load_bandwidth))
        except UvmsError as error:
            severity = Severity.ERROR
            text = str(error)
    yield severity.finding(_CHECK, text)
